"""The two membranes (section 4.2) against the exact solution: error against elements and run time, lock, load steps.

    ./run python3 benchmarks/two_membranes.py --tables 1 2 3 --cells 40 80 160 320

Every row is demos/two_membranes.py as a whole process, after a warm-up that compiles the forms. Its contact traction comes
from a second run in this process: means over facets against the exact p·l without friction; the largest deviation counts, 6
facets and more inside the zone of contact, as the edges' oscillation fades from facet to facet.
The edge of contact falls inside a facet, elsewhere in each mesh, so errors fall irregularly: orders are given from mesh to
mesh and as the least-squares slope over all meshes.
"""

import argparse
import contextlib
import io
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
from demos.two_membranes import simulate
from exact.two_membranes import TwoMembranes as Exact

CASES = [(0.0, 3500.0, 10), (0.0, 4023.0, 10), (0.5, 3500.0, 20), (0.5, 4400.0, 20)]  # friction, pressure, increments
AWAY = 6  # facets between the edge of contact and those whose mean traction counts
LARGEST = 160  # cells per membrane in the third table


def run(friction: float, pressure: float, increments: int, cells: int, order: int, *more: str, n: int = 0) -> Any:
    """summary.json of the demo as a process, under mpirun on `n` ranks if not 0, with its wall time as "seconds"."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["mpirun", "-n", f"{n}"] if n else []
        command += [sys.executable, "demos/two_membranes.py", "--no-figure", "--output", folder, "--shift", "1", *more]
        command += ["--friction", f"{friction}", "--pressure", f"{pressure}", "--increments", f"{increments}"]
        command += ["--cells", f"{cells}", f"{cells}", "--order", f"{order}"]
        start = time.perf_counter()
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True, cwd=ROOT)
        seconds = time.perf_counter() - start
        return json.loads((Path(folder) / "summary.json").read_text()) | {"seconds": seconds}


def midpoint(said: Any) -> NDArray[np.float64]:
    """Displacement of the lower midpoint (m) in the last row."""
    return np.array([said["last"]["mid_ux"], said["last"]["mid_uy"]])


def traction_error(pressure: float, increments: int, cells: int, order: int) -> float:
    """Largest relative deviation of a facet's mean traction from p·l without friction, away from the edges of contact;
    nan where contact has too few facets."""
    args = argparse.Namespace(
        cells=(cells, cells), order=order, increments=increments, dim=2, swap=False, paraview=False, checkpoint=False
    )
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        history, _, profile = simulate(args, (0.0, 1.0, pressure), Path(folder))
    if history.column("pressure")[-1] != pressure:
        return math.nan
    facet = np.floor(profile.X[:, 0] * cells).astype(int) % cells  # membranes of 1 m, shifted by as much
    mean = np.bincount(facet, profile.area * profile.pressure) / np.bincount(facet, profile.area)
    inside = np.flatnonzero(mean > 0)[AWAY:-AWAY]
    if not len(inside):
        return math.nan
    return float(np.abs(mean[inside] / Exact(shift=1.0).state(pressure).multiplier[0] - 1).max())


def slopes(cells: Sequence[int], errors: Sequence[float]) -> list[float]:
    """Orders of convergence: nan, then from each mesh to the next, then by least squares over three meshes or more."""
    x, y = np.log(np.array(cells)), -np.log(np.array(errors))
    known = np.isfinite(y)
    fit = float(np.polyfit(x[known], y[known], 1)[0]) if known.sum() > 2 else math.nan
    return [math.nan, *(np.diff(y) / np.diff(x)).tolist(), fit]


def shown(x: float, form: str) -> str:
    return "–" if math.isnan(x) else f"{x:{form}}"


def row(*columns: object) -> None:
    print("| " + " | ".join(map(str, columns)) + " |", flush=True)


def head(*columns: str) -> None:
    row(*columns)
    print("|" + "---|" * len(columns))


def errors(cells: Sequence[int]) -> None:
    print("Relative errors against the exact solution, shift 1 m:\n")
    measured = [f"{name}{more}" for name in ("midpoint", "stretch", "traction") for more in ("", ": order")]
    head("μ", "p (Pa)", "element", "cells", *measured, "Newton iterations", "rejected steps", "wall s")
    for friction, pressure, increments in CASES:
        exact = Exact(friction=friction, shift=1.0).state(pressure)
        u = exact.midpoint_displacement
        for order in (1, 2):
            said = [run(friction, pressure, increments, n, order) for n in cells]
            found: list[list[float]] = []
            for n, one in zip(cells, said, strict=True):
                if one["last"] is None or one["last"]["pressure"] != pressure:
                    found.append([math.nan] * 3)
                    continue
                traction = traction_error(pressure, increments, n, order) if friction == 0 else math.nan
                found.append([
                    float(np.linalg.norm(midpoint(one) - u) / np.linalg.norm(u)),
                    abs(one["last"]["stretch_max"] / exact.stretch_max - 1), traction,
                ])  # fmt: skip
            orders = [slopes(cells, column) for column in zip(*found, strict=True)]
            lead = (f"{friction:g}", f"{pressure:g}", f"P{order}")
            for k, (n, one) in enumerate(zip(cells, said, strict=True)):
                numbers = [t for j in range(3) for t in (shown(found[k][j], ".1e"), shown(orders[j][k], ".1f"))]
                row(*lead, n, *numbers, one["newton_iterations"], one["rejected_steps"], f"{one['seconds']:.2f}")
            fits = [text for column in orders for text in ("", shown(column[-1], ".1f"))]
            row(*lead, "least squares", *fits, "", "", "")


def lock(cells: Sequence[int]) -> None:
    print("\nPressure at which the line of contact reaches the fixed edges, 20 steps towards 5420 Pa:\n")
    head("μ", "element", "cells", "p (Pa)", "exact", "error", "Newton iterations", "rejected steps", "wall s", "end")
    for friction in (0.0, 0.5):
        exact = Exact(friction=friction, shift=1.0).lock_pressure()
        for order in (1, 2):
            for n in cells:
                said = run(friction, 5420.0, 20, n, order)
                p, end = said["last"]["pressure"], said["parameters"]["end"]
                row(
                    f"{friction:g}", f"P{order}", n, f"{p:.2f}", f"{exact:.2f}", f"{p / exact - 1:+.1e}",
                    said["newton_iterations"], said["rejected_steps"], f"{said['seconds']:.2f}",
                    "lock" if "lock" in end else end,
                )  # fmt: skip


def steps(cells: int) -> None:
    print(f"\nLoad steps, μ = 0 to 4023 Pa, P2, {cells} cells:\n")
    head("steps", "Δp (Pa)", "u_x (m)", "u_y (m)", "difference (m)", "Newton iterations", "rejected steps", "wall s")
    first = None
    for increments in (402, 80, 40, 20, 10):
        said = run(0.0, 4023.0, increments, cells, 2)
        u = midpoint(said)
        first = u if first is None else first
        row(
            increments, f"{4023 / increments:.0f}", f"{u[0]:.12f}", f"{u[1]:.12f}", f"{np.linalg.norm(u - first):.1e}",
            said["newton_iterations"], said["rejected_steps"], f"{said['seconds']:.2f}",
        )  # fmt: skip
    reference = run(0.0, 4023.0, 20, cells, 2)
    others = {"`--swap`": run(0.0, 4023.0, 20, cells, 2, "--swap")}
    others |= {f"{n} rank{'s' * (n > 1)}": run(0.0, 4023.0, 20, cells, 2, n=n) for n in (1, 2, 3)}
    lines = [
        f"{name} {np.linalg.norm(midpoint(said) - midpoint(reference)):.1e} m ({said['newton_iterations']} iterations, "
        f"{said['seconds']:.1f} s)"
        for name, said in others.items()
    ]
    print("\nDifference of the midpoint to the 20 steps above: " + ", ".join(lines) + ".")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", type=int, nargs="+", default=(1, 2, 3), choices=(1, 2, 3), help="which (all)")
    parser.add_argument("--cells", type=int, nargs="+", default=(40, 80, 160, 320), help="per membrane (%(default)s)")
    args = parser.parse_args()
    for order in (1, 2):
        run(0.0, 3500.0, 10, min(args.cells), order)
    if 1 in args.tables:
        errors(args.cells)
    if 2 in args.tables:
        lock([n for n in args.cells if n <= LARGEST])
    if 3 in args.tables:
        steps(min(LARGEST, max(args.cells)))


if __name__ == "__main__":
    main()
