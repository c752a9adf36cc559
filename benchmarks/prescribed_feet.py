"""Feet whose motion is prescribed, finer than the block that they press, drawn from a seed, as a Markdown table.

    ./run python3 benchmarks/prescribed_feet.py --seed 1 --draws 40 [--plain]

The foot is the contactor: flat, tilted or round, narrower or wider than the block, 1 to 8 times as fine, of order 1 or 2, μ
from 0 to 1; it is pressed by 2 to 8 % of the height in 1 to 8 steps and dragged by up to a fifth of its width in as many.
Forces are compared with those of the other roles, in which the block alone carries the multiplier and nothing is held smooth.
`--plain` leaves multipliers as they are.
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, quasistatic
from dolfinx_mortar_al.contact_pair import ContactPair

E = 100.0  # of the block (Pa)
Array = NDArray[np.float64]
SHAPES = ("flat", "tilted", "round")


def body(corners: Any, cells: tuple[int, int], order: int, y: float) -> tuple[Any, ...]:
    """A rectangle of quadrilaterals: displacement, and its face at height y as tags."""
    domain = mesh.create_rectangle(MPI.COMM_SELF, corners, cells, mesh.CellType.quadrilateral)
    facets = np.sort(mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], y)))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", order, (2,))))
    return domain, u, Surface(domain, mesh.meshtags(domain, 1, facets, np.full(len(facets), 1, np.int32)), 1)


def press(dice: dict[str, Any], swap: bool) -> tuple[list[int], list[Array]]:
    """Steps, iterations and rejected trials; the foot's forces after the press and after the drag."""
    width, n, order = dice["width"], dice["cells"], dice["order"]
    fine = max(2, round(dice["ratio"] * n * width))
    corners = [[0.5 - width / 2, 1.0], [0.5 + width / 2, 1.0 + width / 4]]
    foot, uf, bottom = body(corners, (fine, max(1, fine // 4)), order, 1.0)
    _, ub, top = body([[0.0, 0.0], [1.0, 1.0]], (n, n), order, 1.0)
    ξ = foot.geometry.x[:, 0] - 0.5
    bend = {"flat": 0.0, "tilted": 0.05 * (ξ + width / 2), "round": dice["curvature"] * ξ**2}[dice["shape"]]
    foot.geometry.x[:, 1] += bend
    moved, Vb = fem.Function(uf.function_space), ub.function_space
    held = fem.locate_dofs_geometrical(Vb, lambda x: np.isclose(x[1], 0.0))
    every = np.arange(uf.function_space.dofmap.index_map.size_local, dtype=np.int32)
    bodies = [
        Body(uf, materials.neo_hookean(E=E, nu=0.3), bcs=[fem.dirichletbc(moved, every)]),
        Body(ub, materials.neo_hookean(E=E, nu=0.3), bcs=[fem.dirichletbc(np.zeros(2), held, Vb)]),
    ]
    sides = (top, bottom) if swap else (bottom, top)
    problem = ContactProblem(bodies, contacts=[Contact(*sides, friction=dice["friction"])])
    pair, forces, counts = problem.pairs[0], list[Array](), [0, 0, 0]
    for stage in (0, 1):

        def move(t: float, stage: int = stage) -> None:
            down, along = dice["depth"] * (t if stage == 0 else 1.0), dice["drag"] * width * (t if stage == 1 else 0.0)
            moved.x.array.reshape(-1, 2)[:] = (along, -down)

        for step in quasistatic.march(problem, move, to=1.0, start=0.0, increments=dice["increments"]):
            counts = [counts[0] + 1, counts[1] + step.iterations, counts[2] + step.rejected]
        forces.append(pair.force() * (-1 if swap else 1))
    return counts, forces


def draw(seed: int, number: int) -> dict[str, Any]:
    """A foot, uniformly over these ranges, ratios of facets log-uniformly."""
    rng = np.random.default_rng([seed, number])
    return {
        "shape": SHAPES[number % 3], "width": rng.uniform(0.4, 1.4), "cells": int(rng.integers(6, 21)),
        "order": int(rng.integers(1, 3)), "ratio": float(np.exp(rng.uniform(0.0, np.log(8.0)))),
        "curvature": rng.uniform(0.1, 1.0), "friction": float(rng.choice([0.0, rng.uniform(0.0, 1.0)])),
        "depth": rng.uniform(0.02, 0.08), "drag": rng.uniform(0.0, 0.2), "increments": int(rng.integers(1, 9)),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--plain", action="store_true", help="hold nothing smooth")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    hold = ContactPair._hold_smooth
    print("| draw | foot | facets per facet | order | μ | steps | iterations | rejected | force off (press, drag) |")
    print("|" + "---|" * 9)
    failed, total = 0, np.zeros(3, dtype=int)
    for number in range(args.draws):
        dice = draw(args.seed, number)
        ContactPair._hold_smooth = (lambda self: None) if args.plain else hold  # type: ignore[method-assign]
        head = f"| {number} | {dice['shape']} | {dice['ratio']:.1f} | {dice['order']} | {dice['friction']:.2f} |"
        try:
            counts, forces = press(dice, False)
            total += counts
        except quasistatic.StepFailure as error:
            failed += 1
            print(f"{head} failed: {str(error)[:60]} | | | |", flush=True)
            continue
        try:
            _, others = press(dice, True)
            size = np.linalg.norm(others[0])
            off = [f"{100 * np.linalg.norm(a - b) / size:.1f} %" for a, b in zip(forces, others, strict=True)]
        except quasistatic.StepFailure:
            off = ["other roles failed"]
        print(f"{head} {counts[0]} | {counts[1]} | {counts[2]} | {', '.join(off)} |", flush=True)
    print(f"\n{failed} of {args.draws} failed; {total[0]} steps, {total[1]} iterations, {total[2]} rejected trials")


if __name__ == "__main__":
    main()
