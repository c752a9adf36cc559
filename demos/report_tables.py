"""Tables of what runs have left in a folder: history.csv and summary.json."""

import csv
import json
from pathlib import Path

import numpy as np

__all__ = ["against", "effort", "histories", "last_rows"]

SAME = 1e-6  # of a column's largest number, between two runs: Newton's tolerance, carried through a path
SHOWN = 6  # last rows of a history, at most
UNLIKE = ("wall_time", "newton_iterations")


def histories(folder: Path) -> list[Path]:
    return sorted(folder.rglob("history.csv"))


def last_rows(path: Path) -> list[list[str]]:
    """Head and the last few rows of a history."""
    with path.open() as lines:
        head, *rows = csv.reader(lines)
    return [head, *([f"{float(value):.5g}" for value in row] for row in rows[-SHOWN:])]


def effort(folder: Path) -> list[list[str]]:
    """Unknowns, iterations and time of each run in a folder, from its summary.json."""
    head = ["run", "unknowns", "steps", "rejected", "Newton iterations", "s", "of it in"]
    rows = [head]
    for path in sorted(folder.rglob("summary.json")):
        said = json.loads(path.read_text())
        parts = sorted(said["wall_time"].items(), key=lambda part: -part[1])[:3]
        unknowns, keys = sum(said["unknowns"].values()), ("steps", "rejected_steps", "newton_iterations")
        total = f"{sum(said['wall_time'].values()):.1f}"
        spent = ", ".join(f"{name} {seconds:.1f}" for name, seconds in parts)
        rows.append([path.parent.name, str(unknowns), *(str(said[key]) for key in keys), total, spent])
    return rows


def against(here: Path, there: Path) -> list[list[str]]:
    """How far the numbers of this run are from those of another one, as a share of each column's largest."""
    rows = [["history", "rows", "largest difference", "column", f"same to {SAME:g}"]]
    for path in histories(here):
        other = there / path.relative_to(here)
        if other.exists():
            name, miss, length = _farthest(path, other)
            said = "yes" if miss <= SAME else "no"
            rows.append([str(path.parent.relative_to(here)), str(length), f"{miss:.1e}", name, said])
    return rows


def _farthest(path: Path, other: Path) -> tuple[str, float, int]:
    """(column, difference, rows) where two histories differ most."""
    a, b = (np.atleast_1d(np.genfromtxt(p, delimiter=",", names=True)) for p in (path, other))
    if len(a) != len(b):
        return "number of rows", np.inf, len(a)
    names = [name for name in a.dtype.names or () if name not in UNLIKE]
    size = max(np.abs(b[name]).max() for name in names)  # what is below SAME of the largest of all is round-off
    miss = {name: float(np.abs(a[name] - b[name]).max() / max(np.abs(b[name]).max(), SAME * size)) for name in names}
    worst = max(miss, key=lambda name: miss[name])
    return worst, miss[worst], len(a)
