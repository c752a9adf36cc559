"""Pins that touch their holes at a point and are pressed into them: what fails, rejected trials, iterations.

    ./run python3 benchmarks/pins.py [--space]

A hollow pin, of 0.2 m bore, in the hole of 1 m diameter of a round block held at its outside; a dead traction acts downwards
in the lower half of its bore, in four increments. Nothing but contact holds the pin: whole ones have friction, halves
have a plane of symmetry, in space (`--space`, some minutes) two.
"""

from __future__ import annotations

import itertools
import sys
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

sys.path.append(str(Path(__file__).resolve().parents[1]))
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, quasistatic
from dolfinx_mortar_al.verify.meshes import Body as Mesh
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import hold
from meshes.round_bodies import Round, RoundBodies

OUTSIDE, HOLE, BORE = 1.0, 0.5, 0.2  # radii (m)
E, LOAD, HALF_LOAD = 1e6, 2e5, 3e5  # Pa
CLEARANCES = (0.01, 0.002)  # m, in radius
PIN, BLOCK, LOADED, HELD, SYMMETRY, SLICE, FREE = 1, 2, 4, 5, 10, 11, 12  # tags of halves

Pressed = tuple[ContactProblem, fem.Constant, float]


def pressed(
    u: fem.Function, ds: ufl.Measure, bcs: list[Any], sides: list[Surface], μ: float, clearance: float
) -> Pressed:
    """The problem, the traction (Pa) downwards on `ds` below the pin's middle, and the area (m²) that it acts on."""
    domain, dim = u.function_space.mesh, u.function_space.mesh.geometry.dim
    q = fem.Constant(domain, 0.0)
    below = ufl.conditional(ufl.lt(ufl.SpatialCoordinate(domain)[1], -clearance), 1.0, 0.0)
    area = domain.comm.allreduce(fem.assemble_scalar(fem.form(below * ds)), MPI.SUM)
    push = (ufl.as_vector([0 * q, -q * below, 0 * q][:dim]), ds)
    body = Body(u, materials.neo_hookean(E, 0.3), bcs=bcs, external=push)
    return ContactProblem(body, contacts=[Contact(*sides, friction=μ)]), q, area


def pin(order: int, sizes: tuple[float, float], swap: bool, μ: float, clearance: float) -> Pressed:
    """A whole pin, with cells of `sizes` (m) in block and pin; it is the contactor unless `swap`."""
    rounds = Round((0.0, 0.0), OUTSIDE, HOLE, sizes[0]), Round((0.0, -clearance), HOLE - clearance, BORE, sizes[1])
    bodies = RoundBodies(rounds, order=order)
    domain, _, facets = bodies.create()
    u = fem.Function(fem.functionspace(domain, ("Lagrange", order, (2,))))
    outside = fem.locate_dofs_topological(u.function_space, 1, facets.find(bodies.rim(0)))
    bcs = [fem.dirichletbc(np.zeros(2), outside, u.function_space)]
    sides = [Surface(domain, facets, tag) for tag in (bodies.rim(1), bodies.bore(0))]
    ds = ufl.Measure("ds", domain, subdomain_data=facets)(bodies.bore(1))
    return pressed(u, ds, bcs, sides[::-1] if swap else sides, μ, clearance)


def half_ring(
    radii: tuple[float, float], cells: int, y: float, tags: tuple[int, int], simplices: bool, dim: int
) -> Mesh:
    """A half ring, x ≥ 0, around (0, y), in space a slice of it; `tags` of its inner and outer side."""

    def place(x: np.ndarray) -> np.ndarray:
        return np.column_stack([x[:, 1] * np.sin(x[:, 0]), y - x[:, 1] * np.cos(x[:, 0]), *x[:, 2:].T])

    axes = [np.linspace(0, np.pi, cells + 1), np.linspace(*radii, 3), np.linspace(0, 0.5, 3)][:dim]
    faces = {(0, 0): SYMMETRY, (0, -1): SYMMETRY, (1, 0): tags[0], (1, -1): tags[1], (2, 0): SLICE, (2, -1): FREE}
    return grid(axes, {face: tag for face, tag in faces.items() if face[0] < dim}, simplices=simplices, place=place)


def half_pin(
    dim: int, cells: tuple[int, int], swap: bool, μ: float, clearance: float, simplices: bool = False
) -> Pressed:
    """Half a pin of order 2, with `cells` round pin and block."""
    domain, _, facets = build([
        half_ring((BORE, HOLE - clearance), cells[0], -clearance, (LOADED, PIN), simplices, dim),
        half_ring((HOLE, OUTSIDE), cells[1], 0.0, (BLOCK, HELD), simplices, dim),
    ])  # fmt: skip
    V = fem.functionspace(domain, ("Lagrange", 2, (dim,)))
    bcs = [hold(V, facets, SYMMETRY, 0), *(hold(V, facets, HELD, k) for k in range(dim))]
    bcs += [hold(V, facets, SLICE, k) for k in range(2, dim)]
    sides = [Surface(domain, facets, tag) for tag in ((BLOCK, PIN) if swap else (PIN, BLOCK))]
    ds = ufl.Measure("ds", domain, subdomain_data=facets)(LOADED)
    return pressed(fem.Function(V), ds, bcs, sides, μ, clearance)


def row(name: str, scenes: Iterable[tuple[Pressed, float, int]]) -> None:
    """March scenes, each a problem with its load and increments: a line of the table."""
    failed = tried_again = iterations = rejected = count = 0
    for (problem, q, _), to, increments in scenes:
        count += 1
        try:
            steps = list(quasistatic.march(problem, q, to=to, increments=increments))
        except quasistatic.StepFailure:
            failed += 1
        else:
            again = sum(step.rejected for step in steps)
            tried_again, rejected = tried_again + (again > 0), rejected + again
            iterations += sum(step.iterations for step in steps)
    print(f"| {count} {name} | {failed} | {tried_again} | {iterations} ({rejected}) |", flush=True)


def main() -> None:
    warnings.simplefilter("ignore")
    print("| | failed | with rejected trials | iterations (rejected) of the others |\n|---|---|---|---|")
    meshes = [(2, (0.06, 0.05)), (1, (0.04, 0.06)), (2, (0.12, 0.03)), (2, (0.03, 0.12)), (1, (0.12, 0.03))]
    sides = (False, True)
    if "--space" not in sys.argv:
        whole = itertools.product(meshes, sides, (0.1, 0.4, 1.0), CLEARANCES)
        row("pins with friction", ((pin(*mesh, *rest), LOAD, 4) for mesh, *rest in whole))
    dim, cells = (3, [(8, 10)]) if "--space" in sys.argv else (2, [(12, 16), (20, 9)])
    halves = [(half_pin, (dim, *rest), 4) for rest in itertools.product(cells, sides, (0.0, 0.3), CLEARANCES)]
    halves += [(half_pin, (dim, n, False, 0.3, CLEARANCES[0], True), 1) for n in cells]
    row(f"half pins, {dim}D", ((make(*scene), HALF_LOAD, increments) for make, scene, increments in halves))


if __name__ == "__main__":
    main()
