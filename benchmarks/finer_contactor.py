"""Pressure where the contactor is stiffer, against the ratio of facets, as a Markdown table.

    ./run python3 benchmarks/finer_contactor.py [--order 1 2] [--ratios 1 3 10 1000] [--slab 0.5 0.75 1 1.2 1.3 2]

The punch of `ironing.py` pressed in without friction, the punch the contactor with 40 cells per metre (order 2: 20); `slab`
multiplies the slab's cells, 32 (16) per metre. Largest relative difference of the pressure within 70 % of the half width from
a run of order 2 with segments and slab = 1.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from functools import partial

import ironing
import numpy as np

from dolfinx_mortar_al import ContactProblem, quasistatic

CELLS = {1: 48, 2: 24}  # of the punch
PRESSED = ironing.Scene(friction=0.0, steps=ironing.PRESSING, depth=ironing.DEPTH_PRESSING)
MESH = ironing.Ironing


def pressed(ratio: float, order: int, slab: float, integration: str) -> ContactProblem:
    """The punch in its deepest state; `ratio` of its stiffness to the slab's."""
    ironing.Ironing = partial(MESH, ratio=(slab, 1.0))  # type: ignore[misc, assignment]
    scene = replace(PRESSED, ratio=ratio, order=order, curved=order == 2, cells=CELLS[order])
    problem, top = ironing.build(scene, {"integration": integration})
    for _ in ironing.iron(scene, problem, top):
        pass
    return problem


def difference(problem: ContactProblem, reference: ContactProblem) -> float:
    found, exact = (p.pairs[0].fields_on_root() for p in (problem, reference))
    assert found is not None and exact is not None
    closed = exact.X[exact.status > 0, 0]
    ξ = (found.X[:, 0] - (closed.max() + closed.min()) / 2) / (np.ptp(closed) / 2)
    inside = np.abs(ξ) < ironing.INNER
    p = np.interp(found.X[inside, 0], exact.X[:, 0], exact.pressure)
    return float(np.max(np.abs(found.pressure[inside] / p - 1)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--order", type=int, nargs="+", choices=(1, 2), default=[1, 2])
    parser.add_argument("--ratios", type=float, nargs="+", default=[1.0, 3.0, 10.0, 1000.0])
    parser.add_argument("--slab", type=float, nargs="+", default=[0.5, 0.75, 1.0, 1.2, 1.3, 2.0])
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    columns = [f"{0.8 * slab:.2f}" for slab in args.slab]
    print("| order, integration | E ratio | facets of the punch over the slab's: " + " | ".join(columns) + " |")
    print("|" + "---|" * (len(columns) + 2))
    for ratio in args.ratios:
        reference = pressed(ratio, 2, 1.0, "segments")
        for order in args.order:
            for integration in ("gauss", "segments"):
                row = []
                for slab in args.slab:
                    try:
                        problem = pressed(ratio, order, slab, integration)
                        row.append(f"{100 * difference(problem, reference):.1f} %")
                    except quasistatic.StepFailure:
                        row.append("failed")
                print(f"| {order}, {integration} | {ratio:g} | " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
