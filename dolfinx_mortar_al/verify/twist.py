"""Two cylinders pressed together and twisted."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_mortar_al import ContactProblem, Surface
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case
from dolfinx_mortar_al.verify.meshes import build, disc
from dolfinx_mortar_al.verify.model import elastic_work, hold, make_contact, march, measures, profile, space, unknowns

__all__ = ["full_slip", "stick"]

E, P, MU, R, L = 1.0, 1e-5, 0.3, 1.0, 1.0  # Pa, Pa; radius and length of each (m)
RIM, TOP, SOLE, FLOOR, TABLE = 9, 1, 2, 3, 4


def full_slip() -> float:
    """Moment of a disc under a uniform pressure that slips all over: ∫ μ p r dA = ⅔ μ (pπR²) R."""
    return 2 / 3 * MU * P * pi * R**3


def stick(θ: float) -> float:
    """Moment of the two cylinders as one: torsion, G (πR⁴/2) θ/(2L), G = E/2 (ν = 0)."""
    return E / 2 * pi * R**4 / 2 * θ / (2 * L)


FIRST = 2 * L * MU * P / (E / 2 * R)  # the twist at which the rim begins to slip


@case(
    "twist",
    "Twist with friction in space",
    [
        Quantity("moment, all slips", "⅔ μPR, exact for a uniform pressure", 1e-3, "N m"),
        Quantity(
            "moment, all sticks",
            "torsion of one shaft, exact but for the circle, whose sides are parabolas: fourth order",
            1e-4,
            "N m",
            order=4,
        ),
    ],
)
def twist(quick: bool) -> Outcome:
    """Two cylinders, radius 1 m and 1 m long each, E = 1 Pa, ν = 0 (so that nothing but contact acts at the interface
    and the pressure is uniform), pressed by 1e-5 E, μ = 0.3, and twisted by their far ends: first to half of the
    angle at which the rim slips, where they are one shaft, then to 16 times that angle, where all but the middle
    slips: ⅔ μPR. Hexahedra of order 2 that follow the circle; the lower cylinder's mesh does not match.
    """
    runs = []
    sizes = (4,) if quick else (2, 4, 6)
    for n in sizes:
        upper = disc(R, n, 1 if n < 6 else 2, RIM, height=np.array([0.0, L]), ends=(SOLE, TOP))
        lower = disc(R, n + 2, 1, RIM, height=np.array([-L, 0.0]), ends=(FLOOR, TABLE), square=0.6)
        domain, cells, facets = build([upper, lower])
        V, u = space(domain, 2)
        dx, ds = measures(domain, cells, facets)
        pressure, effort = fem.Constant(domain, 0.0), Effort()
        held = [fem.Function(V.sub(axis).collapse()[0]) for axis in (0, 1)]
        F = elastic_work(u, E, 0.0, dx) + pressure * ufl.TestFunction(V)[2] * ds(TOP)
        bcs = [hold(V, facets, FLOOR), *(hold(V, facets, TOP, axis, held[axis]) for axis in (0, 1))]
        contact = make_contact(Surface(domain, facets, SOLE), Surface(domain, facets, TABLE), friction=MU)
        problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
        pair, path = problem.pairs[0], list[tuple[float, float]]()

        def turn(share: float, held: Any = held) -> None:
            θ = share * FIRST
            held[0].interpolate(lambda x: -θ * x[1])
            held[1].interpolate(lambda x: θ * x[0])

        def look(share: float, pair: Any = pair, path: Any = path) -> None:
            path.append((share, -float(pair.moment([0, 0, 0])[2])))

        march(problem, pressure, to=P, increments=1, effort=effort)
        march(problem, turn, to=0.5, increments=1, start=0.0, effort=effort, each=look)
        sticking = path[-1][1]
        march(problem, turn, to=16.0, increments=6, start=0.5, effort=effort, each=look)
        found = profile(problem)

        def draw(axes: Any, found: Any = found) -> None:
            t = found.traction[:, :2] / (MU * P)
            few = slice(None, None, max(1, len(t) // 400))
            X, t = found.X[few], t[few]
            axes.quiver(X[:, 0], X[:, 1], t[:, 0], t[:, 1], scale=20, width=4e-3, color="C0")
            axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="friction on the upper cylinder")

        values = {"moment, all slips": (path[-1][1], full_slip()), "moment, all sticks": (sticking, stick(0.5 * FIRST))}
        runs.append(Run(f"{4 * n}:{4 * (n + 2)} on the rim", 1 / n, values, effort, unknowns(u), draw))
    return Outcome(runs, coarse=6 / sizes[-1])
