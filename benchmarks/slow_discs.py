"""Two discs meet centrally, slowly and without friction: largest force against statics at the same approach, restitution.

    ./run python3 benchmarks/slow_discs.py

An impact is quasi-static if it lasts long beside the discs' lowest period. In the plane its length hardly depends on the
speed, so that a core of mass M makes it longer: ρ = 1000 kg/m³ (1 + k (1 − r²/R²)²⁰), M the disc's mass over that with k = 0.
Speeds are divided by √M, so that approaches are alike. The row "pressed" has no impact: body forces, uniform in ρ, grow
within 0.4 s like a half cosine.

The static reference is one disc pressed onto a rigid plane, the plane of symmetry, by the same body force, as inertia
presses it, with elements of half the size: a disc may turn on the plane, and how facets of 0.006 m lie to the contact is
worth up to 3 % of the approach, with half of that 0.1 %. Approach is that of the centres of mass. Both columns of forces
are means over the steps about the closest approach in which the centres move by less than 2 % of it.

"Expected" is the ratio by a model of a few unknowns: the centre of mass d, moving against the force F(t) between the discs,
and the amplitudes of the lowest free modes of a disc (ω_n, φ_n of unit mass at the contact along the normal),

    m d″ = −F,   q_n″ + ω_n² q_n = φ_n F,   d − Σ φ_n q_n = d_static(F) − Σ φ_n² F/ω_n²,

whose last line has the static approach and takes the modes' share of it from statics to dynamics.
"""

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from collisions import DENSITY, NU, RoundBodies
from dolfinx import fem
from scipy.integrate import solve_ivp
from scipy.sparse.linalg import eigsh

from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, dynamics, materials, obstacles
from meshes.round_bodies import Round

R, E, SHARP = 0.1, 1e6, 20
MODES = 24  # of a free disc, three rigid ones among them
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


@dataclass(frozen=True)
class Static:
    """Two discs pressed together: approach of the centres (m) and force (N per m of thickness); a disc's mass (kg/m)."""

    approach: np.ndarray
    force: np.ndarray
    mass: float

    def at(self, approach: np.ndarray) -> np.ndarray:
        """The forces (N/m) at approaches (m)."""
        return np.interp(approach, self.approach, self.force)


def static(size: float, largest: float, mass: float, loads: int = 8) -> Static:
    """One disc on its plane of symmetry, with forces up to `largest`."""
    u, rim, ρ = disc((0.0, R), size, mass)
    load, v, dx = (
        fem.Constant(u.function_space.mesh, 0.0),
        ufl.TestFunction(u.function_space),
        materials.cell_measure(u),
    )
    F = materials.neo_hookean(E, NU).virtual_work(u) + load * ρ * v[1] * dx
    problem = ContactProblem(F, u, contacts=[Contact(rim, obstacles.RigidPlane([0, 0], [0, 1]))])
    solver, total = NewtonSolver(problem), fem.assemble_scalar(fem.form(ρ * dx))
    centre = fem.form(-ρ * u[1] / total * dx)
    found = [(0.0, 0.0)]
    for share in np.arange(1, loads + 1) / loads:
        load.value = share * largest / total
        result = solver.solve()
        if not result.converged:
            raise RuntimeError(result.message)
        problem.commit()
        found.append((2 * fem.assemble_scalar(centre), problem.pairs[0].force()[1]))
    approach, force = np.array(found).T
    return Static(approach, force, total)


def modes(size: float, mass: float, force: float) -> tuple[np.ndarray, np.ndarray]:
    """ω_n² (1/s²) and φ_n² (1/kg) of a free disc's lowest elastic modes, φ_n the mean along the radius at θ = 0 with the
    weights of Hertz' pressure for a force between two discs (N/m)."""
    u, _, ρ = disc((0.0, 0.0), size, mass)
    V, dx = u.function_space, materials.cell_measure(u)
    v, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    stiffness = ufl.derivative(materials.neo_hookean(E, NU).virtual_work(u), u)
    K, M = (fem.assemble_matrix(fem.form(a)).to_scipy() for a in (stiffness, ρ * ufl.inner(v, w) * dx))
    values, vectors = eigsh(K, k=MODES, M=M, sigma=-1e3)
    elastic = values > 1e-3 * values.max()
    X, half_width = V.tabulate_dof_coordinates(), np.sqrt(4 * force * (R / 2) * 2 * (1 - NU**2) / (np.pi * E))
    near = np.flatnonzero((np.hypot(X[:, 0], X[:, 1]) > R * (1 - 1e-6)) & (X[:, 0] > 0) & (abs(X[:, 1]) < half_width))
    weight = np.sqrt(1 - (X[near, 1] / half_width) ** 2)
    φ = weight @ vectors[2 * near][:, elastic] / weight.sum()
    return values[elastic], φ**2


def expected(reference: Static, lowest: tuple[np.ndarray, np.ndarray], speed: float) -> float:
    """The ratio of forces by the model; `speed` of the discs relative to each other."""
    ω2, φ2 = lowest
    local = reference.approach / 2 - (φ2 / ω2).sum() * reference.force

    def force(d: np.ndarray, q: np.ndarray) -> np.ndarray:
        """q: Σ over the modes of φ_n² times amplitudes by φ_n."""
        return np.interp(d - q, local, reference.force, left=0.0)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        d, v, q, q_rate = y[0], y[1], y[2 : 2 + len(ω2)], y[2 + len(ω2) :]
        F = force(d, φ2 @ q)
        return np.r_[v, -F / reference.mass, q_rate, F - ω2 * q]

    y0 = np.r_[0.0, speed / 2, np.zeros(2 * len(ω2))]

    def parted(t: float, y: np.ndarray) -> float:
        return float(y[1])

    parted.terminal = True  # type: ignore[attr-defined]
    half = solve_ivp(rate, (0.0, 10.0), y0, events=parted, rtol=1e-8, atol=1e-12, max_step=2e-4)
    whole = solve_ivp(rate, (0.0, 1.3 * half.t[-1]), y0, rtol=1e-8, atol=1e-12, max_step=2e-4)
    d = whole.y[0]
    near = d > 0.98 * d.max()
    t, found = whole.t[near], force(d, φ2 @ whole.y[2 : 2 + len(ω2)])[near]
    return float(np.trapezoid(found, t) / np.trapezoid(reference.at(2 * d[near]), t))


@dataclass(frozen=True)
class Seen:
    """Closest approach (m), approaches and forces (N/m) of the steps near it, seconds of contact, restitution, loss / E₀."""

    closest: float
    approach: np.ndarray
    force: np.ndarray
    lasts: float = np.nan
    restitution: float = np.nan
    loss: float = np.nan


def impact(size: float, speed: float, mass: float, step: float, press: float = 0.0) -> Seen:
    """Discs with ±speed/2 (m/s), or pressed together by `press` (N/m)."""
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
    problem = ContactProblem(motions, contacts=[Contact(*rims)])

    def move(t: float) -> None:
        for load, largest in loads:
            load.value = largest * (1 - np.cos(np.pi * min(t / RAMP, 1.0))) / 2

    energy, start = sum(sum(m.energies()) for m in motions), motions[0].momenta()[1]
    rows = []
    for now in dynamics.march(problem, to=RAMP if press else 0.045 * np.sqrt(mass), move=move):
        approach = sum(motion.integral(form) for motion, form in zip(motions, centres, strict=True))
        rows.append((approach, -now.forces[0][1], now.ledger.impact_loss))
    approach, force, loss = np.array(rows).T
    closest = float(approach.max())
    if press:
        return Seen(closest, approach[-1:], force[-1:])
    middle = (approach + np.concatenate([[0.0], approach[:-1]])) / 2  # forces are means of steps
    near, lasts = middle > 0.98 * closest, np.count_nonzero(force > 0) * step
    return Seen(closest, middle[near], force[near], lasts, -motions[0].momenta()[1] / start, loss[-1] / energy)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--size", type=float, default=0.006, help="of the elements in m (%(default)s)")
    add("--speed", type=float, default=0.3, help="relative, without a core (m/s) (%(default)s)")
    add("--masses", type=float, nargs="+", default=[1.0, 10.0, 100.0], help="M, 0 for the row pressed (%(default)s)")
    add("--step", type=float, default=5e-4, help="Δt in s, times √M; four times that for pressed (%(default)s)")
    args = parser.parse_args()
    print(
        "| M | v (m/s) | approach / R | lasts (s) | force (N/m) | static | ratio | expected | restitution | impact loss |",
        flush=True,
    )
    print("|" + "---|" * 10)
    for mass in args.masses:
        root = np.sqrt(max(mass, 1.0))
        speed, press = (args.speed / root, 0.0) if mass else (0.0, 620.0)
        seen = impact(args.size, speed, max(mass, 1.0), args.step * (root if mass else 4.0), press)
        force = seen.force.mean()
        reference = static(args.size / 2, 1.3 * force, max(mass, 1.0))
        at = reference.at(seen.approach).mean()
        model = expected(reference, modes(args.size, mass, force), speed) if mass else 1.0
        print(
            f"| {f'{mass:g}' if mass else 'pressed'} | {speed:.3g} | {seen.closest / R:.4f} | {seen.lasts:.3f} | {force:.0f} "
            f"| {at:.0f} | {force / at:.3f} | {model:.3f} | {seen.restitution:.4f} | {seen.loss:.2%} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
