"""Cattaneo and Mindlin: bodies pressed together, then sheared, stick inside and slip outside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, log, pi, sqrt
from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al import ContactProblem, Surface
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case
from dolfinx_mortar_al.verify.hertz import Ball, Cylinders
from dolfinx_mortar_al.verify.meshes import build, graded, half_space
from dolfinx_mortar_al.verify.model import (
    elastic_work,
    hold,
    integral,
    make_contact,
    march,
    measures,
    profile,
    space,
    unknowns,
)

__all__ = ["Partial"]

Array = NDArray[np.float64]
FAR, SURFACE, OTHER_FAR, OTHER_SURFACE, SIDE = 1, 2, 3, 4, 10
MU = 0.3


@dataclass(frozen=True)
class Partial:
    """Traction of partial slip, Cattaneo (1938) and Mindlin (1949): that of full slip, μp(r; a), less the same of a
    smaller circle (strip), (c/a) μp(r; c), so that displacements are uniform inside c.

    In the plane c/a = √(1 − Q/μP), in space (1 − Q/μP)^{1/3}. Exact for equal bodies in the plane; in space for ν =
    0, as for ν > 0 the slip is not quite along the force.
    """

    a: float
    peak: float
    share: float
    dim: int

    @property
    def c(self) -> float:
        return self.a * (1 - self.share) ** (1 / 2 if self.dim == 2 else 1 / 3)

    def pressure(self, r: Any) -> Any:
        return self.peak * np.sqrt(np.maximum(0, 1 - (r / self.a) ** 2))

    def traction(self, r: Any) -> Any:
        inner = self.c / self.a * self.peak * np.sqrt(np.maximum(0, 1 - (r / self.c) ** 2))
        return MU * (self.pressure(r) - inner)


@dataclass(frozen=True)
class Scene:
    """Two equal bodies of radius R (m, mm…), pressed by δ and sheared by `shear` (displacements of the far side).

    `a` is about the half width of contact, n cells per `a` on the contactor, `ratio` times as many on the target.
    """

    dim: int
    E: float
    nu: float
    R: float
    a: float
    extent: float
    depth: float
    press: float
    shear: float
    n: int
    ratio: float = 0.8
    order: int = 2
    growth: float = 1.3

    def problem(self, **options: Any) -> tuple[ContactProblem, fem.Function]:
        """The problem, and the displacement of the upper body's far side."""
        d, bodies = self.dim, []
        for k, up in enumerate((True, False)):
            cells = max(1, round(self.n * (1.0, self.ratio)[k]))
            h = self.a / cells
            zone = ceil(1.25 * cells) + k  # contact stays on the contactor's zone, the target's reaches beyond
            half = graded(zone * h, zone, self.extent, self.growth)
            both = np.concatenate([-half[:0:-1], half])
            faces = {(d - 1, 0): (SURFACE, OTHER_SURFACE)[k], (d - 1, -1): (FAR, OTHER_FAR)[k]}
            faces |= {(1, 0): SIDE} if d == 3 else {}
            across = [both] if d == 2 else [both, half]
            depth = graded(h, 1, self.depth, self.growth)
            bodies.append(half_space(across, depth, up, 1 / self.R, faces, order=self.order, near=zone * h))
        domain, cells_, facets = build(bodies)
        V, u = space(domain, self.order)
        dx, _ = measures(domain, cells_, facets)
        top = fem.Function(V)
        bcs = [hold(V, facets, FAR, value=top), hold(V, facets, OTHER_FAR)]
        bcs += [hold(V, facets, SIDE, 1)] if d == 3 else []
        contact = make_contact(
            Surface(domain, facets, SURFACE), Surface(domain, facets, OTHER_SURFACE), friction=MU, **options
        )
        return ContactProblem(elastic_work(u, self.E, self.nu, dx), u, bcs=bcs, contacts=[contact]), top

    def solve(
        self,
        effort: Effort,
        steps: tuple[int, int] = (1, 2),
        each: Callable[[float, Array], None] | None = None,
        **options: Any,
    ) -> ContactProblem:
        """Press, then shear; `each` sees the share of the shear and the force on the contactor after each step of it."""
        problem, top = self.problem(**options)
        d = self.dim

        def look(share: float) -> None:
            if each is not None:
                each(share, problem.pairs[0].force())

        def press(share: float) -> None:
            top.x.array.reshape(-1, d)[:] = np.eye(d)[-1] * -share * self.press

        def shear(share: float) -> None:
            top.x.array.reshape(-1, d)[:] = np.eye(d)[-1] * -self.press + np.eye(d)[0] * share * self.shear

        march(problem, press, to=1.0, increments=steps[0], start=0.0, effort=effort)
        march(problem, shear, to=1.0, increments=steps[1], start=0.0, effort=effort, each=look)
        return problem

    def exact(self, problem: ContactProblem) -> Partial:
        """The solution for the forces that were found (a half of them in space)."""
        force = problem.pairs[0].force() * (1 if self.dim == 2 else 2)
        P, Q, stiffness = float(force[-1]), -float(force[0]), self.E / (1 - self.nu**2) / 2
        if self.dim == 2:
            line = Cylinders(stiffness, self.R / 2, P)
            return Partial(line.half_width, line.peak, Q / (MU * P), 2)
        ball = Ball(stiffness, self.R / 2, P)
        return Partial(ball.radius, ball.peak, Q / (MU * P), 3)

    def compare(self, problem: ContactProblem) -> dict[str, tuple[float, float]]:
        """Computed and exact: half widths of contact and of stick from moments, L2 errors of pressure and traction."""
        exact, pair = self.exact(problem), problem.pairs[0]
        X, p, q = pair.points(), pair.state.p, -pair.state.t[:, 0]
        r2 = np.sum(X[:, :-1] ** 2, axis=1)
        share = 4.0 if self.dim == 2 else 2.5  # ∫p r² = a² ∫p / 4 in the plane, ⅖ a² ∫p in space
        a = sqrt(share * integral(pair, p * r2) / integral(pair, p))
        rest = MU * p - q  # what is missing to slip has the form of p, with c for a
        c = sqrt(share * integral(pair, rest * r2) / integral(pair, rest))
        r = np.sqrt(r2)
        norms = [
            sqrt(integral(pair, (found - right) ** 2) / integral(pair, right**2))
            for found, right in ((p, exact.pressure(r)), (q, exact.traction(r)))
        ]
        return {
            "a": (a, exact.a),
            "c": (c, exact.c),
            "pressure, L2": (norms[0], 0.0),
            "traction, L2": (norms[1], 0.0),
        }


def plane(slope: float, n: int, extent: float, drag: float, **options: Any) -> Scene:
    """Equal cylinders of the printed example (R = 8, E = 200, ν = 0.3), `slope` = a/R, `extent` in a; sheared by
    `drag` μ times what they are pressed."""
    R, E, nu = 8.0, 200.0, 0.3
    a = slope * R
    P = pi * a**2 * E / (1 - nu**2) / 2 / (4 * R / 2)
    # displacement of the far sides of two half planes that are cut at the distance `extent`, roughly: forces are measured
    press = 2 * P * (1 - nu**2) / (pi * E) * (2 * log(2 * extent) - 1)
    return Scene(2, E, nu, R, a, extent * a, extent * a, press, drag * MU * press, n, **options)


def tangential(E: float, nu: float, a: float, P: float, share: float) -> float:
    """Mindlin's displacement of far points of equal balls under Q = `share` μP: (3μP/16a) Σ(2−ν)/G [1 − (1 − Q/μP)^{2/3}]."""
    G = E / (2 * (1 + nu))
    return 3 * MU * P / (16 * a) * 2 * (2 - nu) / G * (1 - (1 - share) ** (2 / 3))


def of_slip(scene: Scene, path: list[tuple[float, float, float]]) -> tuple[float, float]:
    """Computed and exact: what slip adds to the displacement between two loads (displacement, P, Q), over all of it.

    Bodies cut at `extent` have another compliance than half spaces, by a/extent. It is linear in Q but for (a/extent)³:
    δ₂ − δ₁ Q₂/Q₁ leaves it out.
    """
    (δ1, _, Q1), (δ2, P, Q2) = path
    a = Ball(scene.E / (1 - scene.nu**2) / 2, scene.R / 2, P).radius
    exact = [tangential(scene.E, scene.nu, a, P, Q / (MU * P)) for Q in (Q1, Q2)]
    return (δ2 - δ1 * Q2 / Q1) / exact[1], (exact[1] - exact[0] * Q2 / Q1) / exact[1]


def balls(n: int, nu: float, extent: float = 8.0) -> Scene:
    """Equal balls with a/R = 1e-3 on matching meshes, sheared to about 0.8 μP."""
    R, E = 1.0, 1.0
    a = 1e-3 * R
    P = 4 / 3 * E / (1 - nu**2) / 2 * a**3 / (R / 2)
    shear = tangential(E, nu, a, P, 0.8)
    return Scene(3, E, nu, R, a, extent * a, extent * a, 2 * a**2 / R, shear, n, ratio=1.0, order=1, growth=2.0)


def drawing(scene: Scene, problem: ContactProblem) -> Any:
    """Pressure and traction along the interface (in space along the plane of symmetry) beside the exact ones."""
    exact, found = scene.exact(problem), profile(problem)
    near = np.ones(len(found.X), dtype=bool) if scene.dim == 2 else found.X[:, 1] < 0.5 * scene.a / scene.n
    x, p, q = found.X[near, 0] / exact.a, found.pressure[near] / exact.peak, -found.traction[near, 0] / exact.peak

    def draw(axes: Any) -> None:
        line = np.linspace(-1.2, 1.2, 600)
        for right in (MU * exact.pressure(line * exact.a), exact.traction(line * exact.a)):
            axes.plot(line, right / exact.peak, "k-", linewidth=0.7)
        axes.plot(x, MU * p, ".", markersize=2, label="μp")
        axes.plot(x, q, ".", markersize=2, label="q")
        axes.set(xlabel="x / a", ylabel="traction / p₀", xlim=(-1.2, 1.2))
        axes.legend()

    return draw


CATTANEO = "Cattaneo; equal half planes are right to a/R + (a/extent)² = 0.3 %"
CUSP = "; the cusp at c limits L2 to first order"


@case(
    "mindlin-plane",
    "Cattaneo–Mindlin in the plane",
    [
        Quantity("a", CATTANEO, 3e-3, "mm"),
        Quantity("c", CATTANEO, 3e-3, "mm"),
        Quantity("pressure, L2", CATTANEO + "; the edge's root limits it to first order", 1e-2, scale=1.0),
        Quantity("traction, L2", CATTANEO + CUSP, 2e-2, scale=1.0),
    ],
)
def mindlin_plane(quick: bool) -> Outcome:
    """Two equal cylinders (R = 8, E = 200, ν = 0.3, μ = 0.3), order 2, meshes in the ratio 5 : 4, pressed by
    displacements of their far sides in 2 steps, then sheared in 2. In the limit of small loads, a/R = 1e-3, bodies of
    25 a. Half widths come from second moments (of p: a²/4; of μp − q: c²/4), so that they do not hang on single
    points.
    """
    runs = []
    sizes = (8, 16) if quick else (12, 24, 48)
    for n in sizes:
        scene, effort = plane(1e-3, n, 25.0, 0.9, growth=1.4), Effort()
        problem = scene.solve(effort, (2, 2))
        assert isinstance(problem.u, fem.Function)
        runs.append(
            Run(f"{n} per a", 1 / n, scene.compare(problem), effort, unknowns(problem.u), drawing(scene, problem))
        )
    return Outcome(runs, coarse=48 / sizes[-1])


PRINTED = "Cattaneo; its own error at the printed load is of order a/R = 8.5 %"


@case(
    "mindlin-printed",
    "Cattaneo–Mindlin at the printed load, by the increments of pressing",
    [
        Quantity("a", PRINTED, 0.085, "mm"),
        Quantity("c", PRINTED, 0.085, "mm"),
        Quantity("traction, L2", PRINTED, 0.085, scale=1.0),
    ],
    quick=False,
)
def mindlin_printed(quick: bool) -> Outcome:
    """The same cylinders at the load that is printed (a/R = 0.085), 20 cells per a, pressed in 1, 4 and 16 steps. The
    order is that in the number of steps. An open point that closes within a step has the slip of the whole step, its
    approach included, in which surfaces of slope x/R turn to each other; the slip leaves that turn out (theory.md), so
    that the traction hangs on the steps by no more than a/R of itself. Counted from one surface alone, points part by
    about x³/R² before they touch, and one step has a traction that is wrong by a half.
    """
    runs = []
    for steps in (1, 4) if quick else (1, 4, 16):
        scene, effort = plane(0.085, 20, 9.0, 0.5), Effort()
        problem = scene.solve(effort, (steps, 2))
        assert isinstance(problem.u, fem.Function)
        values = {k: v for k, v in scene.compare(problem).items() if not k.startswith("pressure")}
        runs.append(
            Run(
                f"{steps} step{'s' * (steps > 1)}",
                1 / steps,
                values,
                effort,
                unknowns(problem.u),
                drawing(scene, problem),
            )
        )
    return Outcome(runs)


MOMENTS = "; moments of the traction are of up to second order"
MINDLIN = "Mindlin; half spaces are right to a/R + (a/extent)³ = 0.3 %, his stick circle for ν = 0"


@case(
    "mindlin-balls",
    "Cattaneo–Mindlin in space",
    [
        Quantity("a", MINDLIN + MOMENTS, 1e-2, "m", order=2),
        Quantity("c", MINDLIN + MOMENTS, 1e-2, "m", order=2),
        Quantity("share of slip in the displacement", MINDLIN, 1e-2),
        Quantity("pressure, L2", "Hertz; the edge's cells are h/a = 8 % of the radius", 0.08, scale=1.0),
        Quantity(
            "traction, L2", "Mindlin; the cells at the edge and at c are 2h/a = 15 % of the radius", 0.15, scale=1.0
        ),
    ],
)
def mindlin_balls(quick: bool) -> Outcome:
    """Two equal balls, a/R = 1e-3, half of them, hexahedra of order 1, matching meshes, ν = 0: there slip is along the force
    and Mindlin's solution exact. Pressed in one step, sheared in two to about 0.8 μP. Of the displacement what slip adds
    between those two, as a share of the whole: bodies are too small for the whole.
    """
    runs = []
    sizes = (4,) if quick else (4, 6, 13)
    for n in sizes:
        scene, effort, path = balls(n, 0.0), Effort(), list[tuple[float, float, float]]()

        def look(share: float, force: Array, scene: Scene = scene, path: Any = path) -> None:
            path.append((share * scene.shear, 2 * float(force[2]), -2 * float(force[0])))  # half of the balls

        problem = scene.solve(effort, (1, 2), look)
        values = scene.compare(problem) | {"share of slip in the displacement": of_slip(scene, path)}
        assert isinstance(problem.u, fem.Function)
        runs.append(Run(f"{n} per a", 1 / n, values, effort, unknowns(problem.u), drawing(scene, problem)))
    return Outcome(runs, coarse=2.75 if quick else 1.0)
