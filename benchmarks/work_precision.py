"""Error against run time of the paper's scenes and one in space: sweeps of mesh, order, multiplier, steps and integration.

    ./run python3 benchmarks/work_precision.py                    # every row that docs/work_precision/*.csv has not yet
    ./run python3 benchmarks/work_precision.py --scenes bars --again
    ./run python3 benchmarks/work_precision.py --page             # only the diagrams and docs/work_precision.md, from the CSV

A row is a demo's scene as a process of its own, with one of its settings changed. Its seconds are those of the processor,
imports and set-up included, so that other work on the machine counts little; a run on the family's coarsest mesh goes before,
which compiles the forms. The error of membranes and bars is against the exact solution; that of beams and disc against the
finest runs of the sweep, extrapolated, whose own uncertainty is a line in the diagram. GetFEM does the beams beside it.
"""

import argparse
import contextlib
import csv
import io
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "work_precision"
COLUMNS = ["family", "mesh", "value", "iterations", "rejected", "unknowns", "seconds", "contact_seconds", "memory"]
GETFEM = "GetFEM, multiplier P"
Row = dict[str, Any]


@dataclass(frozen=True)
class Scene:
    """A scene's rows.

    Attributes:
        title, error: in words; the error of one quantity is absolute, of several relative.
        families: name → settings, of which "meshes" are swept; the first is the default.
        run: (mesh, settings) → the quantities that the error is of, and the demo's summary.
        exact: the exact quantities, 0 where the quantity is an error already; None: extrapolated from the finest runs.
        order: of the reference's convergence, where it is extrapolated.
        reference: family and meshes of the two runs that are extrapolated.
        why: the defaults are what they are, where others are on the front, too.
    """

    title: str
    error: str
    families: dict[str, Row]
    run: Callable[[float, Row], tuple[list[float], Row]]
    exact: Callable[[], list[float]] | None = None
    reference: tuple[str, float, float] | None = None
    order: float = 2.0
    why: str = ""


def _demo(name: str, simulate: Callable[..., Any], settings: Row, *more: Any) -> tuple[Any, Row]:
    """Run a demo's `simulate` with its own options changed, and another Contact where the settings ask for it."""
    module = sys.modules[f"demos.{name}"]
    contact = {k: settings[k] for k in ("multiplier_order", "integration") if k in settings}
    vars(module)["Contact"] = lambda *a, make=module.Contact, **k: make(*a, **k | contact)
    sys.argv = [name, *settings["argv"], "--no-figure"]
    args = module.options()
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        args.output = Path(folder)
        history = simulate(args, *more, Path(folder))
        said = json.loads((Path(folder) / "summary.json").read_text())
    return history[0] if isinstance(history, tuple) else history, said


def beams(n: float, settings: Row) -> tuple[list[float], Row]:
    from demos.two_beams import simulate

    argv = ["--cells", f"{10 * n:.0f}", f"{n:.0f}", *settings.get("argv", [])]
    history, said = _demo("two_beams", simulate, settings | {"argv": argv}, 0.0)
    return [history.rows[-1]["tip_uy"]], said


def membranes(n: float, settings: Row) -> tuple[list[float], Row]:
    from demos.two_membranes import simulate

    argv = ["--cells", f"{n:.0f}", f"{n:.0f}", "--increments", "10", *settings.get("argv", [])]
    history, said = _demo("two_membranes", simulate, settings | {"argv": argv}, (0.0, 1.0, 3500.0))
    return [history.rows[-1]["mid_ux"], history.rows[-1]["mid_uy"]], said


def exact_membranes() -> list[float]:
    from exact.two_membranes import TwoMembranes

    return [float(x) for x in TwoMembranes(shift=1.0).state(3500.0).midpoint_displacement]


def bars(n: float, settings: Row) -> tuple[list[float], Row]:
    from benchmarks.two_bars import tip_error
    from demos.two_bars import simulate

    argv = ["--cells", f"{n:.0f}", "--step", f"{0.1 / n * settings.get('courant', 1.0)}", *settings.get("argv", [])]
    history, said = _demo("two_bars", simulate, settings | {"argv": argv})
    return [tip_error(history.column("time"), history.column("tip1_u"))], said


def disc(n: float, settings: Row) -> tuple[list[float], Row]:
    from demos.spinning_disc import simulate

    argv = ["--size", f"{0.1 / n}", "--spin", "slice", *settings.get("argv", [])]
    history, said = _demo("spinning_disc", simulate, settings | {"argv": argv}, "slice")
    last = history.rows[-1]
    return [last["velocity_x"], last["velocity_y"], 0.1 * last["spin"]], said


def press_and_drag(n: float, settings: Row) -> tuple[list[float], Row]:
    from demos.press_and_drag import simulate

    argv = ["--cells", f"{n:.0f}", *settings.get("argv", [])]
    history, said = _demo("press_and_drag", simulate, settings | {"argv": argv})
    return [history.rows[-1][name] for name in ("normal_force", "drag")], said


SCENES = {
    "beams": Scene(
        "Two beams, μ = 0, 20 N",
        "deflection of the tip (m)",
        {
            "Q2, multiplier 1, 20 steps": {"meshes": (1, 2, 4, 8, 16)},
            "5 steps": {"meshes": (1, 2, 4, 8), "argv": ["--increments", "5"]},
            "multiplier 2": {"meshes": (2, 4, 8), "multiplier_order": 2},
            "segments": {"meshes": (2, 4, 8), "integration": "segments"},
            "triangles P2": {"meshes": (1, 2, 4, 8), "argv": ["--triangles"]},
            "Q1": {"meshes": (4, 8, 16), "argv": ["--order", "1"]},
            f"{GETFEM}1": {"meshes": (2, 4, 8)},
            f"{GETFEM}2": {"meshes": (2, 4, 8)},
        },
        beams,
        reference=("Q2, multiplier 1, 20 steps", 8, 16),
        why="Without friction five steps are as good as the twenty of figure 1. Multipliers of order 2 have a fifth to a "
        "half less error, but half the inf-sup constant of order 1 ([integration.md](integration.md#inf-sup)). Where facets "
        "match, segments are what Gauss points are.",
    ),
    "membranes": Scene(
        "Two membranes, μ = 0, 3500 Pa",
        "displacement of the lower midpoint, relative to the exact one",
        {
            "P2, multiplier 2, 10 steps": {"meshes": (20, 40, 80, 160)},
            "multiplier 1": {"meshes": (20, 40, 80, 160), "multiplier_order": 1},
            "segments": {"meshes": (20, 40, 80, 160), "integration": "segments"},
            "P1": {"meshes": (40, 80, 160, 320), "argv": ["--order", "1"]},
            "20 steps": {"meshes": (20, 40, 80, 160), "argv": ["--increments", "20"]},
        },
        membranes,
        exact=exact_membranes,
        why="The demo has the paper's equal orders; no other setting is better on every mesh. Multipliers of order 1 have "
        "half to six times the error.",
    ),
    "bars": Scene(
        "Impact of two bars",
        "displacement of a contact face, L2 over time, relative",
        {
            "P1, a wave crosses a cell in a step": {"meshes": (10, 20, 40, 80, 160)},
            "half the step": {"meshes": (10, 20, 40, 80), "courant": 0.5},
            "twice the step": {"meshes": (20, 40, 80, 160), "courant": 2.0},
            "trapezoidal force": {"meshes": (10, 20, 40, 80), "argv": ["--force", "trapezoidal"]},
            "P2": {"meshes": (10, 20, 40, 80), "argv": ["--order", "2"]},
        },
        bars,
        exact=lambda: [0.0],
        why="Half the step on half as many cells is as good, for as much time.",
    ),
    "disc": Scene(
        "A soft spinning disc, sliced",
        "velocity of the centre and of the rim after the impact, relative",
        {
            "P2, Δt 1 ms": {"meshes": (2.5, 5, 10)},
            "Δt 0.5 ms": {"meshes": (2.5, 5, 10), "argv": ["--step", "5e-4"]},
            "Δt 0.25 ms": {"meshes": (5, 10, 20), "argv": ["--step", "2.5e-4"]},
            "P1, Δt 0.5 ms": {"meshes": (5, 10, 20), "argv": ["--order", "1", "--step", "5e-4"]},
            "multiplier 1": {"meshes": (2.5, 5, 10), "multiplier_order": 1},
        },
        disc,
        reference=("Δt 0.25 ms", 10, 20),
        order=1.0,
        why="Most errors are near the reference's own; the demo has the paper's orders.",
    ),
    "press_and_drag": Scene(
        "A domed block pressed and dragged in space, μ = 0.3",
        "normal force and drag at the end, relative",
        {
            "Q1, 2 and 4 steps": {"meshes": (4, 8, 16, 32)},
            "Q2": {"meshes": (4, 8, 16), "argv": ["--order", "2"]},
            "Q2, multiplier 2": {"meshes": (4, 8), "multiplier_order": 2, "argv": ["--order", "2"]},
            "tetrahedra P1": {"meshes": (4, 8, 16), "argv": ["--tetrahedra"]},
            "tetrahedra P2": {"meshes": (4, 8), "argv": ["--tetrahedra", "--order", "2"]},
            "segments": {"meshes": (4, 8, 16), "integration": "segments"},
            "4 and 8 steps": {"meshes": (4, 8, 16), "argv": ["--increments", "4", "8"]},
        },
        press_and_drag,
        reference=("Q2", 8, 16),
        why="To a few tenths of a per cent second order takes less time; first order is the default for what a demo is first "
        "asked for, 1 % in seconds, and for sizes up to a million unknowns ([scaling.md](scaling.md)).",
    ),
}  # fmt: skip


def one(name: str, family: str, mesh: float) -> Row:
    """Measure a row in this process."""
    import resource
    import time

    from dolfinx_mortar_al import stopwatch

    vars(stopwatch)["perf_counter"] = time.process_time  # what the summary's parts are measured with
    scene = SCENES[name]
    value, said = scene.run(mesh, scene.families[family])
    parts, used = said["wall_time"], resource.getrusage(resource.RUSAGE_SELF)
    bulk = ("bulk", "forms", "linear solve", "newton", "output")
    return {
        "family": family,
        "mesh": mesh,
        "value": json.dumps(value),
        "iterations": said["newton_iterations"],
        "rejected": said["rejected_steps"],
        "unknowns": sum(said["unknowns"].values()),
        "seconds": round(used.ru_utime + used.ru_stime, 2),
        "contact_seconds": round(sum(s for part, s in parts.items() if part not in bulk), 2),
        "memory": round(used.ru_maxrss / 2**20, 3),
    }


def peer(family: str, mesh: float) -> Row:
    """GetFEM's beams as a process, by its processor time."""
    order = family.removeprefix(GETFEM)
    script = ["benchmarks/getfem_two_beams.py", "--cells", f"{10 * mesh:.0f}", f"{mesh:.0f}", "--multiplier", order]
    with tempfile.TemporaryFile("w+") as out:
        process = subprocess.Popen([sys.executable, *script], stdout=out, stderr=subprocess.DEVNULL, cwd=ROOT)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = status
        out.seek(0)
        said = json.loads(out.read().strip().splitlines()[-1])
    return {
        "family": family, "mesh": mesh, "value": json.dumps([said["tip_uy_20N"]]), "iterations": said["newton_iterations"],
        "rejected": "", "unknowns": "", "seconds": round(used.ru_utime + used.ru_stime, 2), "contact_seconds": "",
        "memory": round(used.ru_maxrss / 2**20, 3),
    }  # fmt: skip


def process(name: str, family: str, mesh: float) -> Row:
    """The row in a process of its own, or GetFEM's."""
    if family.startswith(GETFEM):
        return peer(family, mesh)
    command = [sys.executable, __file__, "--one", name, family, f"{mesh}"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    if done.returncode:
        raise RuntimeError(f"{name}, {family}, {mesh}: {done.stderr[-1000:]}")
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))


# -------------------------------------------------------------------- files


def load(name: str) -> list[Row]:
    """The rows on disk, numbers as numbers."""
    path = FOLDER / f"{name}.csv"
    if not path.exists():
        return []
    with path.open() as file:
        rows = list(csv.DictReader(file))
    texts = ("family", "value")
    return [{k: v if k in texts or v == "" else float(v) for k, v in row.items()} for row in rows]


def save(name: str, rows: Iterable[Row]) -> None:
    """All rows, in the order of the families."""
    order = list(SCENES[name].families)
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / f"{name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(sorted(rows, key=lambda row: (order.index(row["family"]), row["mesh"])))


def measure(name: str, again: bool) -> None:
    """Measure what a scene's file has not yet; it is written after each row."""
    scene, rows = SCENES[name], [] if again else load(name)
    have = {(row["family"], float(row["mesh"])) for row in rows}
    todo = [(f, float(m)) for f, s in scene.families.items() for m in s["meshes"] if (f, float(m)) not in have]
    bar, warm = tqdm(todo, desc=name), set()
    for family, mesh in bar:
        bar.set_postfix_str(f"{family}, {mesh:g}")
        if family not in warm:
            process(name, family, float(scene.families[family]["meshes"][0]))
            warm.add(family)
        rows.append(process(name, family, mesh))
        save(name, rows)


# -------------------------------------------------------------------- errors, diagram, page


def errors(scene: Scene, rows: list[Row]) -> tuple[list[float], float]:
    """The rows' errors, and the uncertainty of what they are against."""
    values = [np.array(json.loads(row["value"])) for row in rows]
    if scene.exact is not None:
        exact, uncertain = np.array(scene.exact()), 0.0
    else:
        assert scene.reference is not None
        family, *meshes = scene.reference
        coarse, fine = (
            v for v, r in zip(values, rows, strict=True) if r["family"] == family and r["mesh"] in meshes
        )  # fmt: skip
        correction = (fine - coarse) / (2**scene.order - 1)
        exact, uncertain = fine + correction, float(np.linalg.norm(correction))
    relative = len(exact) > 1
    scale = float(np.linalg.norm(exact)) if relative else 1.0
    return [float(np.linalg.norm(v - exact)) / scale for v in values], uncertain / scale


def front(rows: list[Row], error: list[float], uncertain: float) -> set[int]:
    """Rows that none beats in both seconds and error; errors below the reference's uncertainty count as equal."""
    e = np.maximum(error, uncertain)
    s = np.array([row["seconds"] for row in rows])
    best = (
        (e[None, :] <= e[:, None])
        & (s[None, :] <= s[:, None])
        & ((e[None, :] < e[:, None]) | (s[None, :] < s[:, None]))
    )
    return set(np.flatnonzero(~best.any(axis=1)).tolist())


def draw(name: str, rows: list[Row], error: list[float], uncertain: float) -> None:
    """The work–precision diagram."""
    import matplotlib.pyplot as plt

    plt.rcParams["svg.hashsalt"] = name  # the same file from the same numbers
    figure, axis = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    pairs = zip(rows, error, strict=True)
    for k, (family, found) in enumerate(groupby(pairs, key=lambda pair: pair[0]["family"])):
        points = np.array([(row["seconds"], e) for row, e in found])
        style = "k" if family.startswith(GETFEM) else f"C{k}"
        axis.loglog(*points.T, "os^vDP*X"[k % 8] + "-", color=style, label=family, markersize=5, linewidth=1 + (k == 0))
    if uncertain:
        axis.axhspan(axis.get_ylim()[0], uncertain, color="0.9", label="uncertainty of the reference")
    axis.set(xlabel="processor time (s)", ylabel="error", title=SCENES[name].title)
    axis.grid(True, which="both", color="0.93")
    axis.legend(fontsize=8)
    figure.savefig(FOLDER / f"{name}.svg", metadata={"Date": None})
    plt.close(figure)


def section(name: str, rows: list[Row]) -> str:
    """A scene's part of the page, from its rows alone."""
    scene = SCENES[name]
    error, uncertain = errors(scene, rows)
    best = front(rows, error, uncertain)
    out = [f"## {scene.title}", "", f"Error: {scene.error}."]
    if uncertain:
        out[-1] += f" The reference is extrapolated from the finest runs; its uncertainty is {uncertain:.1e}."
    out += ["", f"![Error against run time]({FOLDER.name}/{name}.svg)", ""]
    out += [
        "| settings | mesh | unknowns | error | Newton iterations | steps cut | s | of it contact | GB | on the front |"
    ]
    out += ["|---|---|---|---|---|---|---|---|---|---|"]
    for k, (row, e) in enumerate(zip(rows, error, strict=True)):
        whole = [f"{row[c]:.0f}" if row[c] != "" else "–" for c in ("iterations", "rejected")]
        unknowns = f"{row['unknowns']:.0f}" if row["unknowns"] != "" else "–"
        contact = f"{row['contact_seconds']:.2f}" if row["contact_seconds"] != "" else "–"
        shown = f"{e:.1e}" if e > uncertain else f"< {uncertain:.0e}"
        out.append(
            f"| {row['family']} | {row['mesh']:g} | {unknowns} | {shown} | {' | '.join(whole)} "
            f"| {row['seconds']:.1f} | {contact} | {row['memory']:.2f} | {'yes' if k in best else ''} |"
        )
    default = next(iter(scene.families))
    ours = [k for k in sorted(best) if not rows[k]["family"].startswith(GETFEM)]
    mine = sum(rows[k]["family"] == default for k in ours)
    others = sorted({rows[k]["family"] for k in best} - {default})
    out += ["", f"Of the {len(best)} rows on the front {mine} have the default settings ({default})"]
    out[-1] += f"; the others: {', '.join(others)}. {scene.why}" if others else "."
    return "\n".join(out)


HEAD = """# Error against run time
Made by `./run python3 benchmarks/work_precision.py`, whose docstring says what is measured and how; the numbers are those of
the CSV files in [work_precision/](work_precision). The first settings of each scene are the demo's own, each other family
changes what its name says. "Mesh": cells across a beam, along a membrane or a bar, along the disc's radius, along the block.
A row is on the front if no other one has both a smaller error and less time. Cases with exact solutions in
[verification.md](verification.md) have diagrams of their own; [full_run.md](full_run.md) compares wall times with GetFEM's.
"""


def page() -> str:
    """The whole page from the files."""
    return "\n\n".join([HEAD.rstrip(), *(section(name, load(name)) for name in SCENES if load(name))]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--again", action="store_true", help="measure what the files have already, too")
    parser.add_argument("--page", action="store_true", help="measure nothing")
    parser.add_argument("--one", nargs=3, metavar=("SCENE", "FAMILY", "MESH"), help="one row, as JSON")
    args = parser.parse_args()
    if args.one:
        name, family, mesh = args.one
        print(json.dumps(one(name, family, float(mesh))))
        return
    for name in args.scenes if not args.page else ():
        measure(name, args.again)
    for name in (name for name in SCENES if load(name)):
        draw(name, load(name), *errors(SCENES[name], load(name)))
    (FOLDER.parent / "work_precision.md").write_text(page())


if __name__ == "__main__":
    main()
