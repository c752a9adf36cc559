"""Two discs meet centrally, slowly and without friction: largest force against statics at the same approach, restitution.

    ./run python3 benchmarks/slow_discs.py

An impact is quasi-static if it lasts long beside the discs' lowest period. In the plane its length hardly depends on the
speed, so that a core of mass M makes it longer: ρ = 1000 kg/m³ (1 + k (1 − r²/R²)²⁰), M the disc's mass over that with k = 0.
Speeds are divided by √M, so that approaches are alike. The row "pressed" has no impact: body forces, uniform in ρ, grow
within 0.4 s like a half cosine.

The static reference is one disc pressed onto a rigid plane, the plane of symmetry, by the same body force, as inertia
presses it; approach is that of the centres of mass. The force in dynamics is the mean over the steps about the closest
approach in which the centres move by less than 2 % of it.
"""

import argparse
from typing import Any

import numpy as np
import ufl
from collisions import DENSITY, NU, RoundBodies
from dolfinx import fem

from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, dynamics, materials, obstacles
from meshes.round_bodies import Round

R, E, SHARP = 0.1, 1e6, 20
RAMP = 0.4  # s in which the body force of the row "pressed" grows


def density(mesh: Any, centre: tuple[float, float], mass: float) -> Any:
    """ρ (kg/m³) of a disc with a core, `mass` over that without."""
    x, middle = ufl.SpatialCoordinate(mesh), ufl.as_vector(centre)
    inside = 1 - ufl.dot(x - middle, x - middle) / R**2
    return DENSITY * (1 + (mass - 1) * (SHARP + 1) * ufl.max_value(inside, 0.0) ** SHARP)


def disc(centre: tuple[float, float], size: float, mass: float) -> tuple[fem.Function, Surface, Any]:
    """Displacement, rim and density."""
    mesh, _, tags = RoundBodies((Round(centre, R, 0.0, size),)).create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (2,))))
    return u, Surface(mesh, tags, RoundBodies.rim(0)), density(mesh, centre, mass)


def static(size: float, largest: float, mass: float, loads: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Approach of two discs' centres (m) and force (N per m of thickness), up to `largest`."""
    u, rim, ρ = disc((0.0, R), size, mass)
    load, v, dx = (
        fem.Constant(u.function_space.mesh, 0.0),
        ufl.TestFunction(u.function_space),
        materials.cell_measure(u),
    )
    F = materials.neo_hookean(E, NU).virtual_work(u) + load * ρ * v[1] * dx
    problem = ContactProblem(F, u, contacts=[Contact(rim, obstacles.RigidPlane([0, 0], [0, 1]))])
    solver, total = NewtonSolver(problem), fem.assemble_scalar(fem.form(ρ * dx))
    found = [(0.0, 0.0)]
    for share in np.arange(1, loads + 1) / loads:
        load.value = share * largest / total
        result = solver.solve()
        if not result.converged:
            raise RuntimeError(result.message)
        problem.commit()
        found.append((-2 * fem.assemble_scalar(fem.form(ρ * u[1] * dx)) / total, problem.pairs[0].force()[1]))
    approach, force = np.array(found).T
    return approach, force


def impact(size: float, speed: float, mass: float, step: float, press: float = 0.0) -> tuple[float, ...]:
    """Closest approach (m), force there (N/m), seconds of contact, restitution, impact loss / E₀, of discs with ±speed/2 or
    pressed together by `press` (N/m)."""
    motions, rims, centres, loads = [], [], [], []
    for k, sign in ((0, 1), (1, -1)):
        u, rim, ρ = disc((0.0, 2 * R * k), size * (1 + 0.3 * k), mass)
        dx, load = materials.cell_measure(u), fem.Constant(u.function_space.mesh, 0.0)
        total = fem.assemble_scalar(fem.form(ρ * dx))
        pull = load * ρ * ufl.TestFunction(u.function_space)[1] * dx
        law = materials.neo_hookean(E, NU)
        motion = dynamics.Motion(u, law, density=ρ, step=step, external=pull if press else None)
        motion.velocity.interpolate(lambda X, v=sign * speed / 2: np.outer([0, v], np.ones(X.shape[1])))
        motions.append(motion)
        rims.append(rim)
        centres.append(fem.form(sign * ρ / total * motion.old[1] * dx))
        loads.append((load, sign * press / total))
    problem = ContactProblem([m.residual for m in motions], [m.u for m in motions], contacts=[Contact(*rims)])

    def move(t: float) -> None:
        for load, largest in loads:
            load.value = largest * (1 - np.cos(np.pi * min(t / RAMP, 1.0))) / 2

    energy, start = sum(sum(m.energies()) for m in motions), motions[0].momenta()[1]
    rows = []
    for now in dynamics.march(problem, motions, to=RAMP if press else 0.045 * np.sqrt(mass), move=move):
        approach = sum(motion.integral(form) for motion, form in zip(motions, centres, strict=True))
        rows.append((approach, -now.forces[0][1], now.ledger.impact_loss))
    approach, force, loss = np.array(rows).T
    closest = approach.max()
    if press:
        return approach[-1], force[-1], np.nan, np.nan, np.nan
    near, lasts = force[approach > 0.98 * closest].mean(), np.count_nonzero(force > 0) * step
    return closest, near, lasts, -motions[0].momenta()[1] / start, loss[-1] / energy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--size", type=float, default=0.006, help="of the elements in m (%(default)s)")
    add("--speed", type=float, default=0.3, help="relative, without a core (m/s) (%(default)s)")
    add("--masses", type=float, nargs="+", default=[1.0, 10.0, 100.0], help="M, 0 for the row pressed (%(default)s)")
    add("--step", type=float, default=5e-4, help="Δt in s, times √M; four times that for pressed (%(default)s)")
    args = parser.parse_args()
    print(
        "| M | v (m/s) | approach / R | lasts (s) | force (N/m) | static | ratio | restitution | impact loss |",
        flush=True,
    )
    print("|" + "---|" * 9)
    for mass in args.masses:
        root = np.sqrt(max(mass, 1.0))
        speed, press = (args.speed / root, 0.0) if mass else (0.0, 620.0)
        found = impact(args.size, speed, max(mass, 1.0), args.step * (root if mass else 4.0), press)
        closest, force, lasts, restitution, loss = found
        approach, forces = static(args.size, 1.2 * force, max(mass, 1.0))
        at = float(np.interp(closest, approach, forces))
        print(
            f"| {f'{mass:g}' if mass else 'pressed'} | {speed:.3g} | {closest / R:.4f} | {lasts:.3f} | {force:.0f} "
            f"| {at:.0f} | {force / at:.3f} | {restitution:.4f} | {loss:.2%} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
