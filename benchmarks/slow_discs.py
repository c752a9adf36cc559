"""Two discs meet centrally, slowly and without friction: largest force against statics at the same approach, restitution.

    ./run python3 benchmarks/slow_discs.py

The static reference is one disc pressed onto a rigid plane, the plane of symmetry, by a uniform body force, as inertia
presses it; approach is that of the centres of mass. The force in dynamics is the mean over the steps about the closest
approach in which the centres move by less than 2 % of it.
"""

import argparse

import numpy as np
import ufl
from collisions import DENSITY, NU, Body, Collision, Round, RoundBodies
from dolfinx import fem

from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, dynamics, materials, obstacles

R, E = 0.1, 1e6


def static(size: float, largest: float, loads: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Approach of two discs' centres (m) and force (N per m of thickness), up to `largest`."""
    mesh, _, tags = RoundBodies((Round((0.0, R), R, 0.0, size),)).create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (2,))))
    load, v, dx = fem.Constant(mesh, 0.0), ufl.TestFunction(u.function_space), materials.cell_measure(u)
    F = materials.neo_hookean(E, NU).virtual_work(u) + load * v[1] * dx
    plane = obstacles.RigidPlane([0, 0], [0, 1])
    problem = ContactProblem(F, u, contacts=[Contact(Surface(mesh, tags, RoundBodies.rim(0)), plane)])
    solver, area = NewtonSolver(problem), fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * dx))
    found = [(0.0, 0.0)]
    for share in np.arange(1, loads + 1) / loads:
        load.value = share * largest / area
        result = solver.solve()
        if not result.converged:
            raise RuntimeError(result.message)
        problem.commit()
        found.append((-2 * fem.assemble_scalar(fem.form(u[1] * dx)) / area, problem.pairs[0].force()[1]))
    approach, force = np.array(found).T
    return approach, force


def impact(size: float, speed: float, step: float) -> tuple[float, float, float, float]:
    """Closest approach (m), force there (N/m), restitution, impact loss / E₀, of discs with ±speed/2."""
    lower = Body(Round((0.0, 0.0), R, 0.0, size), E, (0.0, speed / 2))
    upper = Body(Round((0.0, 2 * R), R, 0.0, 1.3 * size), E, (0.0, -speed / 2))
    scene = Collision((lower, upper), step)
    centres = [fem.form(m.old[1] * m.dx) for m in scene.motions]
    energy, m = scene.energy, scene.masses()
    rows = []
    for now in dynamics.march(scene.problem, scene.motions, to=0.06):
        y = [motion.integral(form) for motion, form in zip(scene.motions, centres, strict=True)]
        rows.append(((y[0] / m[0] - y[1] / m[1]) * DENSITY, -now.forces[0][1], now.ledger.impact_loss))
    approach, force, loss = np.array(rows).T
    p = scene.momenta()[:, 1] / m
    closest = approach.max()
    return closest, force[approach > 0.98 * closest].mean(), (p[1] - p[0]) / speed, loss[-1] / energy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=float, default=0.01, help="of the elements in m (%(default)s)")
    parser.add_argument("--speeds", type=float, nargs="+", default=[1.0, 0.3, 0.1], help="relative (m/s) (%(default)s)")
    parser.add_argument("--step", type=float, default=5e-4, help="Δt in s (%(default)s)")
    args = parser.parse_args()
    print(
        "| v (m/s) | v/c | approach / R | force (N/m) | static | ratio | restitution | impact loss |\n"
        + "|---" * 8
        + "|"
    )
    c = np.sqrt(E * (1 - NU) / (DENSITY * (1 + NU) * (1 - 2 * NU)))
    for speed in args.speeds:
        closest, force, restitution, loss = impact(args.size, speed, args.step)
        approach, forces = static(args.size, 1.2 * force)
        at = float(np.interp(closest, approach, forces))
        print(
            f"| {speed:g} | {speed / c:.4f} | {closest / R:.4f} | {force:.0f} | {at:.0f} | {force / at:.3f} "
            f"| {restitution:.4f} | {loss:.2%} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
