"""Run the suite, print its table, and fail if a case misses its tolerance.

./run python3 -m dolfinx_mortar_al.verify --quick
./run python3 -m dolfinx_mortar_al.verify --case rings --case klang
./run python3 -m dolfinx_mortar_al.verify --report docs
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

from dolfinx_mortar_al.command_line import parse
from dolfinx_mortar_al.verify import report
from dolfinx_mortar_al.verify.case import CASES, Row, is_root, rows

__all__ = ["main"]

#: in the order of the page
ORDER = (
    "patch-2d", "patch-3d", "patch-ssnp170", "patch-ssnp121", "cubes-ssnv167", "rings",
    "hertz-plane", "hertz-ball", "hertz-spheres", "hertz-moose", "mindlin-plane", "mindlin-printed", "mindlin-balls",
    "incline", "friction-angle", "klang", "ironing", "twist", "bar-on-wall",
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> list[Row]:
    """Run the cases that the command line names; returns the table's lines."""
    parser = argparse.ArgumentParser(prog="python3 -m dolfinx_mortar_al.verify", description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--quick", action="store_true", help="few and coarse meshes, under a minute, tolerances in proportion")
    add(
        "--case",
        action="append",
        choices=ORDER,
        metavar="NAME",
        help=f"only this one, may be repeated: {', '.join(ORDER)}",
    )
    add("--report", type=Path, metavar="FOLDER", help="write FOLDER/verification.md and its pictures")
    args = parse(parser, arguments)
    names = args.case or [name for name in ORDER if CASES[name].quick or not args.quick]
    done, lines = {}, []
    for name in names:
        begin = perf_counter()
        outcome = CASES[name].run(args.quick)
        done[name] = CASES[name], outcome
        lines += rows(CASES[name], outcome)
        if is_root():
            print(f"{name}: {perf_counter() - begin:.1f} s", file=sys.stderr, flush=True)
    if is_root():
        print(report.table(lines))
        if args.report is not None:
            print(f"\nwrote {report.write(args.report, done)}")
        missed = [line for line in lines if not line.hit]
        print(
            f"\n{len(lines) - len(missed)} of {len(lines)} quantities within tolerance; {len(missed)} missed:",
            flush=True,
        )
        for line in missed:
            print(f"- {line.case}, {line.quantity.name}", flush=True)
    return lines


if __name__ == "__main__":
    sys.exit(any(not line.hit for line in main()))
