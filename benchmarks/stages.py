"""Newton iterations of stages in one march and of marches of their own, as a Markdown table.

    ./run python3 benchmarks/stages.py

Beams (section 4.1, 10 × 2 cells of order 2, μ = 0.3) are bent by 10 N in 8 steps and on to 14 N in 8; the punch of
`ironing.py` is pressed in in 2 steps and dragged in 10, or pressed and lifted in 5 steps each.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests")]
import ironing
from scenes import beams

from dolfinx_mortar_al import quasistatic
from dolfinx_mortar_al.quasistatic import Stage

Way = Sequence[tuple[Any, int]]  # of each stage: where to, increments


def count(build: Callable[[], tuple[Any, Any]], way: Way) -> list[list[int]]:
    """Iterations of each stage, as one march and as marches of their own."""
    problem, load = build()
    together = [0] * len(way)
    for step in quasistatic.march(problem, [Stage(load, *part) for part in way]):
        together[step.stage] += step.iterations
    problem, load = build()
    alone = [sum(step.iterations for step in quasistatic.march(problem, Stage(load, *part))) for part in way]
    return [together, alone]


def punch() -> tuple[Any, Any]:
    return ironing.build(ironing.Scene(), {})


CASES: dict[str, tuple[Callable[[], tuple[Any, Any]], Way]] = {
    "beams, 10 N in 8 steps and 14 N in 8": (lambda: beams(friction=0.3), [(10.0, 8), (14.0, 8)]),
    "punch, pressed in 2 steps and dragged in 10": (punch, [((0.0, -0.2), 2), ((2.0, -0.2), 10)]),
    "punch, pressed and lifted in 5 steps each": (punch, [((0.0, -0.2), 5), ((0.0, 0.0), 5)]),
}

if __name__ == "__main__":
    print("| scene | iterations in one march | in marches of their own |\n|---|---|---|")
    for name, case in CASES.items():
        print(f"| {name} | {' | '.join(' + '.join(map(str, counts)) for counts in count(*case))} |", flush=True)
