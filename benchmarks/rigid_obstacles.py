"""Rigid discs, balls and cylinders pressed into blocks of order 2 and dragged, drawn from a seed: which order of multipliers?

    ./run python3 benchmarks/rigid_obstacles.py --seed 1 --draws 40

A block 1 × .4 (× 1) whose bottom is held, with 4 to 20 facets along its top (3 to 6 in space), of triangles, quadrilaterals,
tetrahedra or hexahedra; a radius of half a facet to ten, at most 1; μ = 0 or up to 1. The obstacle is led in by .05 to .8 of
its radius, by .15 at most, in 1 to 8 steps and dragged by a tenth of a facet to three a step. Forces are compared with those
of a mesh four times as fine in the plane, twice in space, with multipliers of order 1, in the mean over the steps.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import warnings
from typing import Any

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, quasistatic

HEIGHT, DEEPEST = 0.4, 0.15  # m
RADII = (0.5, 1, 1.5, 2, 3, 4, 6, 10)  # facets
Array = NDArray[np.float64]


def draw(rng: np.random.Generator) -> dict[str, Any]:
    """One scene."""
    dim = 3 if rng.random() < 0.15 else 2
    cells = int(rng.integers(3, 7) if dim == 3 else rng.integers(4, 21))
    radius = min(1.0, float(np.exp(rng.uniform(np.log(0.5), np.log(10.0)))) / cells)
    steps = int(rng.integers(1, 9))
    return {
        "dim": dim,
        "cells": cells,
        "simplices": bool(rng.random() < 0.5),
        "cylinder": dim == 3 and bool(rng.random() < 0.5),
        "radius": radius,
        "depth": min(DEEPEST, radius * rng.uniform(0.05, 0.8)),
        "place": 0.5 + rng.uniform(-0.5, 0.5) / cells,
        "friction": 0.0 if rng.random() < 0.3 else float(rng.uniform(0.0, 1.0)),
        "steps": steps,
        "way": min(0.2, steps * float(np.exp(rng.uniform(np.log(0.1), np.log(3.0)))) / cells),
    }


def block(dice: dict[str, Any], finer: int) -> tuple[Surface, fem.Function, fem.DirichletBC]:
    """The block's top, its displacement and what holds it."""
    d, n = dice["dim"], dice["cells"] * finer
    high = [1.0] * (d - 1) + [HEIGHT]
    cells = [n] * (d - 1) + [max(2, round(HEIGHT * n))]
    if d == 2:
        kind = mesh.CellType.triangle if dice["simplices"] else mesh.CellType.quadrilateral
        domain = mesh.create_rectangle(MPI.COMM_WORLD, [np.zeros(2), np.array(high)], cells, kind)
    else:
        kind = mesh.CellType.tetrahedron if dice["simplices"] else mesh.CellType.hexahedron
        domain = mesh.create_box(MPI.COMM_WORLD, [np.zeros(3), np.array(high)], cells, kind)
    top = np.sort(mesh.locate_entities_boundary(domain, d - 1, lambda x: np.isclose(x[d - 1], HEIGHT)))
    bottom = mesh.locate_entities_boundary(domain, d - 1, lambda x: np.isclose(x[d - 1], 0.0))
    V = fem.functionspace(domain, ("Lagrange", 2, (d,)))
    held = fem.dirichletbc(np.zeros(d), fem.locate_dofs_topological(V, d - 1, bottom), V)
    return (
        Surface(domain, mesh.meshtags(domain, d - 1, top, np.ones(len(top), dtype=np.int32)), 1),
        fem.Function(V),
        held,
    )


def press(dice: dict[str, Any], order: int, finer: int = 1) -> tuple[Array, int, int]:
    """The forces (steps, gdim) of a press and a drag; iterations and rejected trials."""
    d, r = dice["dim"], dice["radius"]
    top, u, held = block(dice, finer)
    centre = [dice["place"]] * (d - 1) + [HEIGHT + r]
    ball = obstacles.RigidCylinder(centre, [0, 1, 0], r) if dice["cylinder"] else obstacles.RigidSphere(centre, r)
    contact = Contact(top, ball, friction=dice["friction"], multiplier_order=order)
    problem = ContactProblem(Body(u, materials.neo_hookean(1.0, 0.3), bcs=[held]), contacts=[contact])
    along, down = np.eye(d)[0] * dice["way"], -np.eye(d)[-1] * dice["depth"]
    forces, spent = [], np.zeros(2, dtype=int)
    for lead in (lambda s: ball.move(s * down), lambda s: ball.move(down + s * along)):
        for step in quasistatic.march(problem, lead, to=1.0, increments=dice["steps"]):
            spent += [step.iterations, step.rejected]
            if np.isclose(step.load * dice["steps"], round(step.load * dice["steps"])):
                forces.append(problem.pairs[0].force())
    return np.array(forces), *map(int, spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draws", type=int, default=40)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(args.seed)
    total: dict[int, list[Any]] = {1: [], 2: []}
    radii: list[float] = []
    print("| scene | steps | iterations, rejected, error: order 1 | order 2 |\n|---|---|---|---|")
    for _ in range(args.draws):
        dice = draw(rng)
        try:
            reference = press(dice, 1, finer=2 if dice["dim"] == 3 else 4)[0]
        except (quasistatic.StepFailure, ValueError) as error:
            print(f"| {dice} | | no reference: {str(error)[:80]} | |", flush=True)
            continue
        said: list[str] = []
        radii.append(dice["radius"] * dice["cells"])
        for order, results in total.items():
            try:
                forces, iterations, rejected = press(dice, order)
                off = np.linalg.norm(forces - reference, axis=1).mean() / np.linalg.norm(reference, axis=1).mean()
                results.append((iterations, rejected, float(off), 2 * dice["steps"]))
                said.append(f"{iterations}, {rejected}, {off:.3f}")
            except quasistatic.StepFailure as error:
                results.append(None)
                said.append(str(error)[:80])
        kind = f"{dice['dim']}D{' cylinder' if dice['cylinder'] else ''}, {dice['cells']}{' simplices' * dice['simplices']}"
        scene = f"{kind}, R {dice['radius'] * dice['cells']:.1f} facets, μ {dice['friction']:.2f}"
        print(f"| {scene} | {2 * dice['steps']} | {said[0]} | {said[1]} |", flush=True)
    print("\nIterations a step, rejected trials, error in the median and at most:\n")
    print("| radius in facets | scenes | order 1 | order 2 |\n|---|---|---|---|")
    for low, high in itertools.pairwise(RADII):
        rows = [k for k, radius in enumerate(radii) if low <= radius < high]
        said = [told([results[k] for k in rows]) for results in total.values()]
        print(f"| {low:g} to {high:g} | {len(rows)} | {said[0]} | {said[1]} |")


def told(results: list[Any]) -> str:
    """Of some scenes."""
    done = [result for result in results if result is not None]
    failed = f"{len(results) - len(done)} failed; " if len(done) < len(results) else ""
    if not done:
        return failed
    iterations, rejected, off, steps = map(np.array, zip(*done, strict=True))
    return f"{failed}{iterations.sum() / steps.sum():.2f}, {rejected.sum()}, {np.median(off):.3f}, {off.max():.3f}"


if __name__ == "__main__":
    sys.exit(main())
