"""Pressure at the points against Hertz' exact one: a cylinder on a block, either as contactor, E from 1e-3 to 1e3 times.

    ./run python3 benchmarks/hertz_pressure.py [--order 1 2] [--integration gauss segments]

The scene is that of `verify --case hertz-plane` at its small load (a/R = 1e-3, bodies of 40 a), where Hertz' solution is
right to 0.2 %, with n cells of the cylinder and 0.8 n of the block per half width a of contact: the largest relative
difference of the pressure from p₀√(1 − x²/a²) at the integration points within 70 % of a. With order 1 the cylinder is a
polygon.
"""

from __future__ import annotations

import argparse
import sys
from math import pi
from pathlib import Path

import numpy as np
from mpi4py import MPI

sys.path.append(str(Path(__file__).resolve().parents[1]))
from dolfinx_mortar_al.verify.hertz import RADIUS, Cylinders, effective, press

RATIOS = [10.0**k for k in range(-3, 4)]  # of the cylinder's E to the block's
CELLS = (5, 10, 20)  # of the cylinder per half width
INNER = 0.7  # of the half width: at its edge the pressure is a root, which no mesh resolves point by point
SLOPE, SIZE, SOFT = 1e-3, 40, 1e3  # a/R; of the bodies, in half widths; E of the block (MPa)


def difference(ratio: float, cells: int, order: int, block_is_contactor: bool, integration: str) -> float:
    """Largest relative difference of the pressure inside."""
    young = (ratio * SOFT, SOFT)
    hertz = Cylinders(effective(young), RADIUS, pi * SLOPE**2 * RADIUS * effective(young) / 4)
    a = hertz.half_width
    problem, _ = press(
        hertz.P, cells, SIZE * a, (SIZE * a, SIZE * a), young, order, block_is_contactor, integration=integration
    )
    pair = problem.pairs[0]
    ξ = pair.points()[:, 0] / a
    inside = np.abs(ξ) < INNER
    wrong = np.abs(pair.state.p[inside] / (hertz.peak * np.sqrt(1 - ξ[inside] ** 2)) - 1)
    return float(problem.comm.allreduce(wrong.max(initial=0.0), MPI.MAX))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--order", type=int, nargs="+", choices=(1, 2), default=[1, 2])
    parser.add_argument("--integration", nargs="+", choices=("gauss", "segments"), default=["gauss", "segments"])
    args = parser.parse_args()
    print("| order, contactor, points | n | " + " | ".join(f"{ratio:g}" for ratio in RATIOS) + " |")
    print("|" + "---|" * (len(RATIOS) + 2))
    for order in args.order:
        for integration in args.integration:
            for block in (False, True):
                for n in CELLS:
                    found = [f"{100 * difference(ratio, n, order, block, integration):.1f} %" for ratio in RATIOS]
                    name = f"{order}, {'block' if block else 'cylinder'}, {integration}"
                    print(f"| {name} | {n} | " + " | ".join(found) + " |", flush=True)


if __name__ == "__main__":
    main()
