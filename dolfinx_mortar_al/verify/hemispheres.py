"""Hertz' contact of balls as others print it: whole hemispheres, pressed by displacements at which a/R is not small."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, pi, sqrt
from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al import ContactProblem, Surface, obstacles
from dolfinx_mortar_al.contact_fields import ContactFields
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case
from dolfinx_mortar_al.verify.hertz import Ball
from dolfinx_mortar_al.verify.meshes import Body, build, glue, graded, grid
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

__all__ = ["quarter"]

Array = NDArray[np.float64]
FLAT, POLE, SIDE, LOWER = 1, 2, 10, 100  # the lower body's tags are LOWER more
ZONE = 1.3  # of the contact's radius: where cells are equal
CORE = 0.5  # half the side of the box inside, in radii
GROWTH = 1.6


def quarter(radius: float, a: float, n: int, order: int, lower: bool = False) -> Body:
    """A quarter of a hemisphere, x, y ≥ 0, of hexahedra of an `order`: it stands with its pole on the origin, or, if it is
    the `lower` one, hangs from it. Cells are n per `a` (m) up to ZONE × `a` from the pole, then grow.
    """
    angle, count = 4 / pi * a / radius / n, ceil(ZONE * n)  # of rays through (tan πs/4, tan πt/4, 1), uniform in s, t
    across = np.tan(pi / 4 * graded(angle * count, count, 1.0, GROWTH))
    down = graded(a / n / radius / (1 - CORE), 1, 1.0, GROWTH)  # 0 on the sphere, 1 on the box
    high = np.linspace(0.0, 1.0, 4)
    flat, x_side, y_side = (tag + lower * LOWER for tag in (FLAT, SIDE, SIDE + 1))

    def stand(x: Array) -> Array:
        z = radius + x[:, 2]
        return np.column_stack([x[:, :2], -z if lower else z])

    def shell(ray: Callable[[Array], tuple[Any, Any, Any]]) -> Callable[[Array], Array]:
        def place(x: Array) -> Array:
            box = CORE * radius * np.column_stack(np.broadcast_arrays(*ray(x)))
            ball = radius * box / np.linalg.norm(box, axis=1)[:, None]
            return stand(ball + x[:, 2:] * (box - ball))

        return place

    def core(x: Array) -> Array:
        return stand(CORE * radius * x * [1, 1, -1])

    sides = {(0, 0): x_side, (1, 0): y_side}
    pole = {(2, 0): POLE + lower * LOWER} | sides
    near = float(across[count])
    parts = [
        grid([across, across, high], {(2, 0): flat} | sides, order=order, place=core),
        grid([across, across, down], pole, order=order, place=shell(lambda x: (x[:, 0], x[:, 1], -1.0)), near=near),
    ]
    for side, ray in ((y_side, lambda x: (1.0, x[:, 0], -x[:, 1])), (x_side, lambda x: (x[:, 0], 1.0, -x[:, 1]))):
        parts.append(grid([across, high, down], {(0, 0): side, (1, 0): flat}, order=order, place=shell(ray)))
    return glue(parts, 1e-7 * radius)


def press(
    radius: float, moduli: tuple[float, float], approach: float, n: int, order: int, steps: int, on_plane: bool
) -> tuple[ContactProblem, Effort]:
    """A hemisphere whose flat face is lowered by `approach` (m) onto a rigid plane, or raised and lowered by it with another,
    0.8 times as fine, below; small strains, elements of an order."""
    a = sqrt(radius * approach)
    bodies = [quarter(radius, a, n, order)] + (
        [] if on_plane else [quarter(radius, a, max(2, round(0.8 * n)), order, lower=True)]
    )
    domain, cells, facets = build(bodies)
    V, u = space(domain, order)
    dx, _ = measures(domain, cells, facets)
    lowered, raised = (fem.Function(V.sub(2).collapse()[0]) for _ in range(2))
    bcs = [hold(V, facets, FLAT, 2, lowered)] + [hold(V, facets, SIDE + axis, axis) for axis in (0, 1)]
    target: Any = obstacles.RigidPlane([0, 0, 0], [0, 0, 1])
    if not on_plane:
        bcs += [hold(V, facets, LOWER + FLAT, 2, raised)] + [hold(V, facets, LOWER + SIDE + k, k) for k in (0, 1)]
        target = Surface(domain, facets, LOWER + POLE)
    contact = make_contact(Surface(domain, facets, POLE), target)
    problem = ContactProblem(elastic_work(u, *moduli, dx), u, bcs=bcs, contacts=[contact])

    def move(share: float) -> None:
        lowered.x.array[:], raised.x.array[:] = -share * approach, share * approach

    effort = Effort()
    march(problem, move, to=1.0, increments=steps, start=0.0, effort=effort)
    return problem, effort


def compare(pair: ContactPair, exact: Ball) -> dict[str, tuple[float, float]]:
    """Computed and exact: p₀ of the least squares of p² over r² inside 0.7 a, a from the second moment of p, the force."""
    X, p = pair.points(), pair.state.p
    r2 = X[:, 0] ** 2 + X[:, 1] ** 2
    a = sqrt(2.5 * integral(pair, p * r2) / integral(pair, p))
    inside = r2 < (0.7 * exact.radius) ** 2
    M = np.array([[integral(pair, inside * r2 ** (i + j)) for i in (0, 1)] for j in (0, 1)])
    p0 = sqrt(np.linalg.solve(M, [integral(pair, inside * p**2 * r2**i) for i in (0, 1)])[0])
    return {"p₀": (p0, exact.peak), "a": (a, exact.radius), "force": (4 * float(pair.force()[2]), exact.P)}


def drawing(found: ContactFields, exact: Ball) -> Callable[[Any], None]:
    def draw(axes: Any) -> None:
        x = np.linspace(0, 1, 200)
        axes.plot(x, np.sqrt(1 - x**2), "k-", linewidth=0.7, label="Hertz")
        r = np.hypot(found.X[:, 0], found.X[:, 1]) / exact.radius
        axes.plot(r, found.pressure / exact.peak, ".", markersize=2, label="computed")
        axes.set(xlabel="r / a", ylabel="p / p₀", xlim=(0, 1.3))
        axes.legend()

    return draw


def strain(p0: float, E: float, nu: float) -> float:
    """Radial strain of the surface under Hertz' pressure p₀, (1 − 2ν)(1 + ν)p₀/(2E), which his theory leaves out."""
    return (1 - 2 * nu) * (1 + nu) * p0 / (2 * E)


def series(
    radius: float, moduli: tuple[float, float], approach: float, on_plane: bool, quick: bool
) -> tuple[list[Run], float]:
    """Runs from coarse to fine, and how many times coarser than in the full suite the last one is."""
    E, nu = moduli
    a = sqrt(radius * approach)
    stiffness, curved = (E / (1 - nu**2), radius) if on_plane else (E / (1 - nu**2) / 2, radius / 2)
    exact = Ball(stiffness, curved, 4 / 3 * stiffness * a**3 / curved)
    runs, sizes = [], (3,) if quick else (3, 5, 10)
    for n in sizes:
        problem, effort = press(radius, moduli, approach, n, 1, 2, on_plane)
        values = compare(problem.pairs[0], exact)
        of_force = Ball(stiffness, curved, values["force"][0])
        values["p₀ for the force found"] = values["p₀"][0], of_force.peak
        values["a for the force found"] = values["a"][0], of_force.radius
        assert isinstance(problem.u, fem.Function)
        runs.append(Run(f"{n} per a", 1 / n, values, effort, unknowns(problem.u), drawing(profile(problem), exact)))
    return runs, 10 / sizes[-1]


def quantities(source: str, slope: float, stretch: float, units: tuple[str, str, str]) -> list[Quantity]:
    """What is compared, to a/R as printed and to the radial strain for the force found."""
    names, own = ("p₀", "a", "force"), f"{source}; its own error is of order a/R = {slope:.0%}"
    made = [Quantity(name, own, slope, unit, order=0) for name, unit in zip(names, units, strict=True)]
    found = f"Hertz for that force, which leaves out the surface's radial strain, {stretch:.1%}"
    return made + [
        Quantity(f"{name} for the force found", found, stretch, unit)
        for name, unit in zip(names[:2], units[:2], strict=True)
    ]


GLASS = (2e4, 0.3)  # MPa
SSNV104 = (
    "code_aster's models test the stress at the pole, −2798.3 MPa, to 14 % and more, and find −3176 MPa on coarse meshes "
    "of wedges."
)


@case(
    "hertz-spheres",
    "Hertz: two balls (SSNV104)",
    quantities("SSNV104 (code_aster V6.04.104), −2798.3 MPa", 0.2, strain(2798.3, *GLASS), ("MPa", "mm", "N")),
)
def hertz_spheres(quick: bool) -> Outcome:
    """Two hemispheres, R = 50 mm, E = 20 GPa, ν = 0.3, their flat faces moved towards each other by 2 mm each:
    p₀ = E/(π(1 − ν²)) √(2h/R) with h = 4 mm in all, a = 10 mm. A quarter of each, hexahedra of order 1 that do not
    match, small strains. a/R is 0.2: what is found is that of this problem, not Hertz' limit. Nominal pressures.
    """
    runs, coarse = series(50.0, GLASS, 2.0, False, quick)
    return Outcome(runs, [SSNV104], coarse=coarse)


RUBBER = (1.40625e7, 0.25)  # Pa


@case(
    "hertz-moose",
    "Hertz: ball on a plane at the printed load (MOOSE)",
    quantities("Hertz, as MOOSE prints it", 0.1, strain(9.55e5, *RUBBER), ("Pa", "m", "N")),
)
def hertz_moose(quick: bool) -> Outcome:
    """A hemisphere, R = 1 m, E = 14.0625 MPa, ν = 0.25, whose flat face is lowered by 0.01 m onto a rigid plane:
    a = 0.1 m, p₀ = 9.55e5 Pa. A quarter of it, hexahedra of order 1, small strains; a/R is 0.1. The limit that Hertz
    describes is `hertz-ball`.
    """
    runs, coarse = series(1.0, RUBBER, 0.01, True, quick)
    return Outcome(runs, coarse=coarse)
