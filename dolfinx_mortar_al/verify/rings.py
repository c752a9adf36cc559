"""Nested rings: a curved interface that stays closed all round."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_mortar_al import ContactProblem, Surface
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case
from dolfinx_mortar_al.verify.meshes import build, grid
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

__all__ = ["contact_pressure"]

OUTER, MIDDLE, INNER = 1.0, 0.6, 0.2  # radii (m)
E_OUTER, NU, PRESSURE = 1e9, 0.2, 1e6  # Pa
HOLE, OUTSIDE, INSIDE, RIM, X_AXIS, Y_AXIS = 1, 2, 3, 4, 10, 11


def contact_pressure(E1: float, E2: float, nu: float = NU, p: float = PRESSURE) -> float:
    """Pressure (Pa) between an outer ring (E1) under an outer pressure p and an inner one (E2), plane stress.

    Lamé: a ring b < r < a has u(r) = [(1−ν)(p_b b² − p_a a²) r + (1+ν)(p_b − p_a) a² b²/r] / (E (a² − b²)); equal
    displacements at the interface give p_c.
    """
    a, b, c = OUTER, MIDDLE, INNER
    # outer ring: p_a = p, p_b = p_c at r = b; inner ring: p_a = p_c at r = b, hole free
    by_p = 2 * a**2 * b / (E1 * (a**2 - b**2)) * p
    outer = ((1 - nu) * b**3 + (1 + nu) * a**2 * b) / (E1 * (a**2 - b**2))
    inner = ((1 - nu) * b**3 + (1 + nu) * b * c**2) / (E2 * (b**2 - c**2))
    return by_p / (outer + inner)


def ring(inner: float, outer: float, cells: tuple[int, int], tags: tuple[int, int]) -> Any:
    """A quarter of a ring of order 2, `cells` along r and around."""
    axes = [np.linspace(inner, outer, cells[0] + 1), np.linspace(0, np.pi / 2, cells[1] + 1)]
    faces = {(0, 0): tags[0], (0, -1): tags[1], (1, 0): X_AXIS, (1, -1): Y_AXIS}
    return grid(axes, faces, place=lambda x: x[:, :1] * np.column_stack([np.cos(x[:, 1]), np.sin(x[:, 1])]))


def solve(n: int, E2: float) -> Run:
    """4n facets on the inner ring against 3n on the outer."""
    domain, cells, facets = build(
        [ring(INNER, MIDDLE, (2 * n, 4 * n), (HOLE, OUTSIDE)), ring(MIDDLE, OUTER, (2 * n, 3 * n), (INSIDE, RIM))]
    )
    V, u = space(domain, 2)
    dx, ds = measures(domain, cells, facets)
    p, effort = fem.Constant(domain, 0.0), Effort()
    F = elastic_work(u, E2, NU, dx(1), plane_stress=True) + elastic_work(u, E_OUTER, NU, dx(2), plane_stress=True)
    F += p * ufl.inner(ufl.FacetNormal(domain), ufl.TestFunction(V)) * ds(RIM)
    bcs = [hold(V, facets, X_AXIS, 1), hold(V, facets, Y_AXIS, 0)]
    contact = make_contact(Surface(domain, facets, OUTSIDE), Surface(domain, facets, INSIDE), integration="segments")
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    march(problem, p, to=PRESSURE, increments=1, effort=effort)
    pair, exact = problem.pairs[0], contact_pressure(E_OUTER, E2)
    average = integral(pair, pair.state.p) / pair.area
    L2 = np.sqrt(integral(pair, (pair.state.p / exact - 1) ** 2) / pair.area)
    name = "equal rings" if E2 == E_OUTER else "inner ring ten times stiffer"
    values = {f"{name}: mean pressure": (average, exact), f"{name}: pressure, L2": (float(L2), 0.0)}
    found = profile(problem)

    def draw(axes: Any) -> None:
        angle = np.degrees(np.arctan2(found.X[:, 1], found.X[:, 0]))
        axes.plot(angle, found.pressure / exact, ".", markersize=3)
        axes.set(xlabel="angle (degrees)", ylabel="pressure / exact", title=name)

    return Run(f"{4 * n}:{3 * n}", 1 / n, values, effort, unknowns(u), draw)


LAME = "SSNP152 (code_aster V6.03.152), Lamé's rings, exact; of h⁴ in the mean, h³ in L2; tested there to 0.2 … 0.8 %"


@case(
    "rings",
    "Nested rings",
    [
        Quantity(f"{name}: {what}", LAME, *bound)
        for name in ("equal rings", "inner ring ten times stiffer")
        for what, bound in (("mean pressure", (2e-5, "Pa", None, 4.0)), ("pressure, L2", (1e-4, "", 1.0, 3.0)))
    ],
)
def rings(quick: bool) -> Outcome:
    """Two rings of radii 0.2, 0.6 and 1 m, plane stress, E = 1 GPa (the inner one also 10 GPa), ν = 0.2, 1 MPa from
    outside; a quarter of it. With equal rings the interface is felt by nobody: 925 925.93 Pa. Order 2, also of the
    geometry; 4n facets on the inner ring, the contactor, against 3n. Axisymmetric displacements make the gap linear
    in them, so that the theory of small displacements is exact at any load.
    """
    sizes = (2, 4) if quick else (2, 4, 8)
    return Outcome([_both(n) for n in sizes], coarse=8 / sizes[-1])


def _both(n: int) -> Run:
    equal, stiff = solve(n, E_OUTER), solve(n, 10 * E_OUTER)
    total = Effort(
        equal.effort.iterations + stiff.effort.iterations,
        equal.effort.rejected + stiff.effort.rejected,
        equal.effort.seconds + stiff.effort.seconds,
    )
    return Run(equal.mesh, equal.size, {**equal.values, **stiff.values}, total, equal.unknowns, stiff.draw)
