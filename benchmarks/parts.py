"""What each scene leaves out: unknowns, memory, modules and seconds, beside the same scene with everything on.

    ./run python3 benchmarks/parts.py

"Everything on" is friction with a coefficient that is a Constant of value 0 (or the scene's own), hence vector multipliers
and a slip history, and segments: what a code that knows one general contact element would carry. The rows go into
docs/work_precision/parts.csv and docs/parts.md. Each row is a demo as a process of its own; seconds are of the processor,
after a run that compiles the forms.
"""

import argparse
import contextlib
import csv
import io
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "work_precision"
PARTS = (
    "start",
    "forms",
    "contact set-up",
    "bulk",
    "contact",
    "projection",
    "search",
    "linear solve",
    "newton",
    "rest",
)
HEAVY = ("gmsh", "matplotlib", "pyvista", "scipy", "tqdm", "adios4dolfinx")
COLUMNS = [
    "scene",
    "configuration",
    "bodies",
    "multipliers",
    "steps",
    "iterations",
    "memory",
    "seconds",
    *PARTS,
    "modules",
]
SCENES = {
    "two_beams": (["--increments", "20"], (0.0,)),
    "two_membranes": (["--increments", "10", "--cells", "80", "80"], ((0.0, 1.0, 3500.0),)),
    "two_bars": (["--cells", "40"], ()),
    "spinning_disc": (["--size", "0.02"], ("slice",)),
    "two_rings": (["--time", "0.01"], ()),
}
HEAD = """# What a scene does not need
Made by `./run python3 benchmarks/parts.py`, whose docstring says what "everything on" means; the numbers are those of
[work_precision/parts.csv](work_precision/parts.csv). Seconds are of the processor, whole processes; "start" is importing and
all before the mesh is there. A scene without friction has one multiplier per node and no slip history, one without segments
no cut facets, one without a figure no matplotlib. The disc's two rows are one computation (a rigid plane has no segments, and
there is friction anyway): they differ by the machine's noise.
"""


def one(name: str, everything: bool) -> dict[str, Any]:
    """Measure a row in this process."""
    import resource
    import time
    from importlib import import_module

    from dolfinx_mortar_al import stopwatch

    vars(stopwatch)["perf_counter"] = time.process_time
    module = import_module(f"demos.{name}")
    argv, more = SCENES[name]
    sys.argv = [name, *argv, "--no-figure"]
    args = module.options()
    start = time.process_time()
    if everything:
        vars(module)["Contact"] = lambda *a, make=module.Contact, **k: make(*a, **k | _everything(a[0], k))
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        args.output = Path(folder)
        module.simulate(args, *more, Path(folder))
        said = json.loads(next(Path(folder).rglob("summary.json")).read_text())
    used = resource.getrusage(resource.RUSAGE_SELF)
    seconds, parts = used.ru_utime + used.ru_stime, said["wall_time"] | {"start": start}
    multipliers = sum(n for field, n in said["unknowns"].items() if field.startswith("multiplier"))
    parts["rest"] = seconds - sum(s for part, s in parts.items() if part in PARTS)
    return {
        "scene": name, "configuration": "everything on" if everything else "as it is",
        "bodies": sum(said["unknowns"].values()) - multipliers, "multipliers": multipliers, "steps": said["steps"],
        "iterations": said["newton_iterations"], "memory": round(used.ru_maxrss / 2**20, 3), "seconds": round(seconds, 2),
        **{part: round(parts.get(part, 0.0), 2) for part in PARTS},
        "modules": " ".join(heavy for heavy in HEAVY if heavy in sys.modules),
    }  # fmt: skip


def _everything(contactor: Any, given: dict[str, Any]) -> dict[str, Any]:
    from dolfinx import fem

    return {"friction": fem.Constant(contactor.mesh, float(given.get("friction", 0.0))), "integration": "segments"}


def page(rows: list[dict[str, str]]) -> str:
    """The page from the rows."""
    shown = [column for column in COLUMNS if any(row[column] not in ("0.0", "") for row in rows)]
    table = [f"| {' | '.join(shown)} |", "|" + "---|" * len(shown)]
    table += [f"| {' | '.join(row[column] for column in shown)} |" for row in rows]
    saved = []
    for name in SCENES:
        lean, full = (
            next(row for row in rows if row["scene"] == name and row["configuration"] == c)
            for c in ("as it is", "everything on")
        )
        ratio = float(full["seconds"]) / float(lean["seconds"])
        saved.append(f"{name} {ratio:.2f} ({lean['multipliers']} of {full['multipliers']} multipliers)")
    saving = f"Everything on costs so many times the seconds: {'; '.join(saved)}."
    return "\n".join([HEAD, *table, "", saving]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--one", nargs=2, metavar=("SCENE", "EVERYTHING"), help="one row, as JSON")
    args = parser.parse_args()
    if args.one:
        print(json.dumps(one(args.one[0], args.one[1] == "True")))
        return
    rows = []
    for name in SCENES:
        for everything in (False, True):
            command = [sys.executable, __file__, "--one", name, str(everything)]
            for _ in range(2):  # the first compiles the forms
                done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
            rows.append(json.loads(done.stdout.strip().splitlines()[-1]))
            print(rows[-1], file=sys.stderr, flush=True)
    with (FOLDER / "parts.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    with (FOLDER / "parts.csv").open() as file:
        (FOLDER.parent / "parts.md").write_text(page(list(csv.DictReader(file))))


if __name__ == "__main__":
    main()
