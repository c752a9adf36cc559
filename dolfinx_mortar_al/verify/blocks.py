"""Blocks that slide: on an incline under a push (NAFEMS CGS-4), and down a plane at the angle of friction."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan, cos, degrees, sin
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_mortar_al import ContactProblem, Surface, reaction
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import elastic_work, hold, make_contact, march, mean, measures, space, unknowns

__all__ = ["push"]

HELD, TRACK, SOLE, BACK = 1, 2, 3, 4
SLOPE, STIFF, NU = 0.1, 1e6, 0.3  # tan α; E in G/m², of which the mean pressure is a half


def push(μ: float, slope: float = SLOPE) -> float:
    """Horizontal force over weight that pushes a block up an incline of tan α = `slope`: (tan α + μ)/(1 − μ tan α)."""
    return (slope + μ) / (1 - μ * slope)


def block_on_track(n: int, α: float, track: float) -> tuple[Any, Any, Any]:
    """A block of 2 × 1, n × n/2 cells, above the first part of a track of length `track`, all turned by α."""
    Q = np.array([[cos(α), sin(α)], [-sin(α), cos(α)]])
    lower = [np.linspace(0, track, round(0.7 * n * track / 2) + 1), np.linspace(-1, 0, max(2, n // 3) + 1)]
    upper = [np.linspace(0.5, 2.5, n + 1), np.linspace(0, 1, max(2, n // 2) + 1)]
    return build(
        [
            grid(lower, {(1, 0): HELD, (1, -1): TRACK}, order=1, place=lambda x: x @ Q),
            grid(upper, {(1, 0): SOLE, (0, 0): BACK}, order=1, place=lambda x: x @ Q),
        ]
    )


def pushed(n: int, μ: float) -> tuple[float, Effort, Any, int]:
    """(F/G, effort, (push, F/G) on the way, unknowns) of a block of weight G = 1 pushed by one of its facets' lengths and
    more; F is what its back is led with."""
    domain, cells, facets = block_on_track(n, atan(SLOPE), 5.0)
    V, u = space(domain, 2)
    dx, _ = measures(domain, cells, facets)
    weight, back, effort = fem.Constant(domain, 0.0), fem.Function(V.sub(0).collapse()[0]), Effort()
    F = elastic_work(u, STIFF, NU, dx) + weight / 2 * ufl.TestFunction(V)[1] * dx(2)
    bcs = [hold(V, facets, HELD), hold(V, facets, BACK, 0, back)]
    contact = make_contact(Surface(domain, facets, SOLE), Surface(domain, facets, TRACK), friction=μ)
    problem, path = ContactProblem(F, u, bcs=bcs, contacts=[contact]), []

    def move(distance: float) -> None:
        back.x.array[:] = distance

    def look(distance: float) -> None:
        path.append((distance, float(reaction(problem, bcs[1]).force[0])))

    march(problem, weight, to=1.0, increments=1, effort=effort)
    march(problem, move, to=2.0, increments=8, start=0.0, effort=effort, each=look)
    return path[-1][1], effort, path, unknowns(u)


FRICTIONS = (0.0, 0.1, 0.2, 0.3)
RIGID = "NAFEMS CGS-4 (R0081), rigid bodies: elastic ones tilt by p/E = 1e-6; FrontISTR has 0.412168 at μ = 0.3"


@case(
    "incline",
    "Block pushed up an incline (NAFEMS CGS-4)",
    [Quantity(f"F/G, μ = {μ}", RIGID, 1e-5, order=0) for μ in FRICTIONS],
)
def incline(quick: bool) -> Outcome:
    """A block of weight G, 2 m × 1 m, is pushed horizontally by its back over a track with tan α = 0.1, over more
    than a facet at each of 8 steps: F/G = (tan α + μ)/(1 − μ tan α). Order 2, meshes that do not match, E = 1e6 G/m²
    so that bodies are all but rigid.
    """
    runs = []
    for n in (6,) if quick else (6, 12):
        values, total, paths = {}, Effort(), []
        for μ in FRICTIONS:
            found, effort, path, count = pushed(n, μ)
            values[f"F/G, μ = {μ}"] = (found, push(μ))
            paths.append((μ, path))
            total = _sum([total, effort])

        def draw(axes: Any, paths: Any = paths) -> None:
            for μ, path in paths:
                axes.plot(*np.array(path).T, "o-", markersize=3, label=f"μ = {μ}")
                axes.axhline(push(μ), color="k", linewidth=0.7)
            axes.set(xlabel="pushed by (m)", ylabel="F / G")
            axes.legend()

        runs.append(Run(f"{n} facets", 1 / n, values, total, count, draw))
    return Outcome(runs)


def _sum(efforts: Sequence[Effort]) -> Effort:
    return Effort(*(sum(getattr(e, name) for e in efforts) for name in ("iterations", "rejected", "seconds")))


# ---------------------------------------------------------------- the angle of friction

MU, SPRING = 0.3, 0.3  # spring over weight, per length
ANGLE = atan(MU)


def slide(α: float) -> float:
    """Where a block of weight 1 on a spring rests at the angle α: (sin α − μ cos α)/k once it slides."""
    return max(0.0, (sin(α) - MU * cos(α)) / SPRING)


@case(
    "friction-angle",
    "Slipping block at the angle of friction",
    [
        Quantity(
            "angle at which all slips",
            "atan μ; the event is met to 1/64 of an increment of 1/16",
            1e-3,
            "degrees",
            order=0,
        ),
        Quantity("slide at 1.5 atan μ", "balance of a rigid block, elastic to p/E = 1e-6", 1e-5, "m", order=0),
        Quantity("slide at 0.99 atan μ", "no slide, elastic to p/E = 1e-6", 1e-5, "m", 1.0, order=0),
    ],
)
def friction_angle(quick: bool) -> Outcome:
    """A block of 2 m × 1 m on a track, held by a soft spring along it; gravity turns from 0 to 1.5 atan μ, μ = 0.3.
    It rests until atan μ = 16.699°, then slides to (sin α − μ cos α) G/k. `quasistatic.march(until=…)` finds the
    angle at which no point sticks.
    """
    runs = []
    for n in (6,) if quick else (6, 12):
        domain, cells, facets = block_on_track(n, 0.0, 5.0)
        V, u = space(domain, 2)
        dx, _ = measures(domain, cells, facets)
        g, v = fem.Constant(domain, np.zeros(2)), ufl.TestFunction(V)
        F = elastic_work(u, STIFF, NU, dx) + (SPRING * u[0] * v[0] - ufl.inner(g, v)) / 2 * dx(2)
        contact = make_contact(Surface(domain, facets, SOLE), Surface(domain, facets, TRACK), friction=MU)
        problem = ContactProblem(F, u, bcs=[hold(V, facets, HELD)], contacts=[contact])
        effort, path = Effort(), list[tuple[float, float]]()

        def fall(weight: float, g: Any = g) -> None:
            g.value[:] = [0.0, -weight]

        def turn(share: float, g: Any = g) -> None:
            g.value[:] = [sin(share * ANGLE), -cos(share * ANGLE)]

        def look(share: float, u: Any = u, path: Any = path, dx: Any = dx) -> None:
            path.append((share, mean(u, 0, dx(2))))

        def slips(pair: Any = problem.pairs[0]) -> bool:
            return bool(pair.stick_fraction() == 0.0)

        march(problem, fall, to=1.0, increments=1, start=0.0, effort=effort)
        march(problem, turn, to=0.99, increments=2, start=0.0, effort=effort, each=look)
        before = path[-1][1]
        begin = march(problem, turn, to=1.24, increments=4, start=0.99, effort=effort, each=look, until=slips)
        march(problem, turn, to=1.5, increments=4, start=begin, effort=effort, each=look)
        values = {
            "angle at which all slips": (degrees(begin * ANGLE), degrees(ANGLE)),
            "slide at 1.5 atan μ": (path[-1][1], slide(1.5 * ANGLE)),
            "slide at 0.99 atan μ": (before, 0.0),
        }

        def draw(axes: Any, path: Any = path) -> None:
            line = np.linspace(0.8, 1.5, 200)
            axes.plot(line, [slide(x * ANGLE) for x in line], "k-", linewidth=0.7, label="rigid")
            axes.plot(*np.array(path).T, "o", markersize=3, label="computed")
            axes.set(xlabel="angle / atan μ", ylabel="slide (m)", xlim=(0.8, 1.5))
            axes.legend()

        runs.append(Run(f"{n} facets", 1 / n, values, effort, unknowns(u), draw))
    return Outcome(runs)
