"""What each of Newton's rules is worth: beams, ironing and membranes with one rule changed at a time.

    ./run python3 benchmarks/contact_decisions.py [--rules PATTERN]

The rules are described in docs/newton.md; their constants are those of `active_set.py`, `newton.py`, `predictor.py`,
`quasistatic.py` and `augmentation.py`. Beams are section 4.1 in 20 steps to 20 N, ironing that of `ironing.py`, membranes
section 4.2 with 160 cells in 20 steps to 4023 Pa (μ = 0) and 4400 Pa (μ = 0.5). Iterations, with rejected steps in brackets.
"""

from __future__ import annotations

import argparse
import fnmatch
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]
import ironing
from scenes import beams, membranes

from dolfinx_mortar_al import active_set, augmentation, newton, predictor, quasistatic

RULES: dict[str, list[tuple[ModuleType, str, float]]] = {
    "as shipped": [],
    "gaps trusted whatever their error": [(active_set, "TRUST", 0.0)],
    "points close as readily as they open": [(active_set, "CLOSES", 1.0)],
    "no weak points opened in the first solve": [(active_set, "WEAK", 0.0)],
    "all three off: plain semi-smooth Newton": [(active_set, "TRUST", 0.0), (active_set, "WEAK", 0.0)],
    "linear predictor": [(predictor, "MAX_ORDER", 1)],
    "predictor of the order that was best, by however little": [(predictor, "BETTER", 1.0)],
    "ε 3 times larger": [(augmentation, "SOFTER", 3 * augmentation.SOFTER)],
    "ε 3 times smaller": [(augmentation, "SOFTER", augmentation.SOFTER / 3)],
    "slides of an iteration limited to 1 facet": [(newton, "LONGEST", 1.0)],
    "slides of an iteration not limited": [(newton, "LONGEST", 1e9)],
    "a failed increment always halved": [(quasistatic, "CUT_WITHOUT_PROGRESS", 0.5)],
}


def two_beams(cells: int, friction: float) -> Iterator[Any]:
    problem, P = beams(friction=friction, mesh={"along": (cells, cells), "across": cells // 10})
    yield from quasistatic.march(problem, P, to=20.0, increments=20)


def two_membranes(friction: float, pressure: float) -> Iterator[Any]:
    problem, p = membranes(friction=friction, cells=(160, 160))
    yield from quasistatic.march(problem, p, to=pressure, increments=20)


def punch(**parameters: Any) -> Iterator[Any]:
    scene = ironing.Scene(**parameters)
    yield from (step for _, step in ironing.iron(scene, *ironing.build(scene, {})))


CASES: dict[str, Callable[[], Iterator[Any]]] = {
    "beams 40×4, μ = 0": lambda: two_beams(40, 0.0),
    "40×4, 0.3": lambda: two_beams(40, 0.3),
    "80×8, 0": lambda: two_beams(80, 0.0),
    "80×8, 0.3": lambda: two_beams(80, 0.3),
    "ironing 10 + 40, μ = 0.3": lambda: punch(),
    "f = 2, 2 + 10, 0.3": lambda: punch(cells=24, steps=(2, 10)),
    "2 + 10, 0": lambda: punch(steps=(2, 10), friction=0.0),
    "slab as contactor, 2 + 10, 0.3": lambda: punch(steps=(2, 10), slab_is_contactor=True),
    "hexahedra P1, 0.3": lambda: punch(dim=3, cells=7, order=1, steps=(5, 10)),
    "membranes μ = 0": lambda: two_membranes(0.0, 4023.0),
    "membranes 0.5": lambda: two_membranes(0.5, 4400.0),
}


def run(case: Callable[[], Iterator[Any]], changes: list[tuple[ModuleType, str, float]]) -> str:
    """Newton iterations and, where there were any, rejected steps."""
    shipped = [(module, name, getattr(module, name)) for module, name, _ in changes]
    for module, name, value in changes:
        setattr(module, name, value)
    iterations = rejected = 0
    try:
        for step in case():
            iterations, rejected = iterations + step.iterations, rejected + step.rejected
        return f"{iterations}" + (f" ({rejected})" if rejected else "")
    except quasistatic.StepFailure:
        return "fails"
    finally:
        for module, name, value in shipped:
            setattr(module, name, value)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rules", default="*", help="which rows, a pattern (%(default)s)")
    pattern = parser.parse_args().rules
    sys.argv[1:] = []
    print("| rule | " + " | ".join(CASES) + " |")
    print("|" + "---|" * (len(CASES) + 1))
    for rule, changes in RULES.items():
        if fnmatch.fnmatch(rule, pattern):
            print(f"| {rule} | " + " | ".join(run(case, changes) for case in CASES.values()) + " |", flush=True)
