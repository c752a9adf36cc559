"""All figures of the paper and one page with pictures, tables and the commands behind them.

Each line of the list below is a command that anyone may run alone. They run one after the other, each in its own process;
what is through is kept, so that an interrupted run goes on where it was, and the page is written anew after each command.

    ./run python3 demos/reproduce.py              # the paper's scenes as the paper has them
    ./run python3 demos/reproduce.py --quick      # coarser, in a few minutes
    ./run python3 demos/reproduce.py --full --keep docs/full_run    # and every benchmark: some three hours, unattended
    ./run python3 demos/reproduce.py --quick --ranks 2 --against results/reproduce/quick   # the same numbers on two ranks?

The page is report.html in results/reproduce/ (quick/, paper/, or their ranks_2/ …); it needs nothing beside it.
"""

import argparse
import json
import platform
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import dolfinx
from petsc4py import PETSc
from tqdm import tqdm

from demos.report_kept import keep
from demos.report_page import Section, page
from demos.report_tables import against, effort, histories, last_rows

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Task:
    """A command of the list: what `--quick` adds to it, whether it is in `--full` alone, a guess of its seconds."""

    name: str
    title: str
    command: str
    quick: str | None = None
    full: bool = False
    seconds: float = 60.0


DEMO = "demos/{0}.py --checkpoint --output {{folder}}/{0}"
VERIFY = "-m dolfinx_mortar_al.verify --report {folder}/verify"
TASKS = [
    Task("two_beams", "Two beams (section 4.1)", DEMO.format("two_beams"), "--increments 5", seconds=8),
    Task("two_membranes", "Two membranes (section 4.2)", DEMO.format("two_membranes"), "--cells 40 40", seconds=90),
    Task("two_bars", "Two bars (section 4.3)", DEMO.format("two_bars"), "", seconds=20),
    Task("spinning_disc", "A spinning disc (section 4.4)", DEMO.format("spinning_disc"), "--size 0.04", seconds=120),
    Task("two_rings", "Two rings collide", DEMO.format("two_rings"), "--time 0.03", seconds=120),
    Task("flattened_ring", "A ring pressed flat", DEMO.format("flattened_ring"), "--size 0.015", seconds=15),
    Task("verify", "Cases with known answers", VERIFY, "--quick", seconds=350),
    Task("work_precision", "Error against run time", "benchmarks/work_precision.py --page", full=True, seconds=20),
    Task("beams", "Beams: wall time", "benchmarks/two_beams.py", full=True, seconds=900),
    Task("membranes", "Membranes: error", "benchmarks/two_membranes.py --tables 1", full=True, seconds=1500),
    Task("bars", "Bars: error", "benchmarks/two_bars.py", full=True, seconds=600),
    Task("discs", "Two discs: energy and momenta", "benchmarks/two_discs.py", full=True, seconds=3600),
    Task("patch", "Patch tests", "benchmarks/patch_test.py", full=True, seconds=300),
    Task("extremes", "Stiff and extreme cases", "benchmarks/extremes.py --full", full=True, seconds=2000),
]  # fmt: skip


def run(task: Task, args: argparse.Namespace) -> dict:
    """Run a command to its end: the command as said, seconds, exit status, what it printed."""
    more = task.quick if args.quick and task.quick else ""
    if args.again:  # or a demo's checkpoint would say that all is done
        shutil.rmtree(args.output / task.name, ignore_errors=True)
    words = [sys.executable, *shlex.split(f"{task.command.format(folder=shlex.quote(str(args.output)))} {more}")]
    if args.ranks > 1 and task.quick is not None:
        words = ["mpirun", "-n", str(args.ranks), *words]
    start = time.perf_counter()
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    broke = done.returncode != 0 and ("Traceback" in done.stderr or not done.stdout.strip())
    said = done.stdout + (done.stderr[-2000:] if broke else "")
    shown = shlex.join(["./run", *("python3" if word == sys.executable else word for word in words)])
    shown, said = (text.replace(f"{ROOT}/", "") for text in (shown, said))
    return {"command": shown, "seconds": time.perf_counter() - start, "status": done.returncode, "said": said}


def made_with(ranks: int) -> str:
    """Versions, machine, ranks and date."""
    petsc, python = ".".join(map(str, PETSc.Sys.getVersion())), platform.python_version()
    versions = f"DOLFINx {dolfinx.__version__}, PETSc {petsc}, Python {python}"
    return f"{versions}, {platform.machine()}, {ranks} rank{'s' * (ranks > 1)}, {date.today()}"


def report(tasks: Sequence[Task], done: dict[str, dict], args: argparse.Namespace) -> None:
    """Write the page from what the finished commands have left, and the files to keep."""
    through = f"{len(done)} of {len(tasks)} commands through"
    sections = [Section("What this was made with", f"{made_with(args.ranks)}; {through}")]
    for task in (task for task in tasks if task.name in done):
        it, folder = done[task.name], args.output / task.name
        tables = [("Effort", effort(folder))] if histories(folder) else []
        tables += [(f"{path.parent.name}: the last rows of history.csv", last_rows(path)) for path in histories(folder)]
        took, pictures = f"{it['seconds']:.0f} s", sorted(folder.glob("figure*.png"))
        sections.append(Section(task.title, took, [it["command"]], pictures, tables, it["said"], it["status"] != 0))
    if args.against:
        sections.append(Section(f"Against {args.against}", tables=[("", against(args.output, args.against))]))
    (args.output / "report.html").write_text(page("dolfinx_mortar_al: the paper's scenes", sections))
    if args.keep:
        keep({task.name: task.title for task in tasks}, done, made_with(args.ranks), args.output, args.keep)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarser meshes, a few minutes")
    parser.add_argument("--full", action="store_true", help="the benchmarks, too: hours")
    parser.add_argument("--ranks", type=int, default=1, help="of each scene (%(default)s)")
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="compare with the numbers of another run")
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="CSV files and pictures of the run, and a page of them"
    )
    parser.add_argument("--again", action="store_true", help="run what is through already, too")
    parser.add_argument("--output", type=Path, default=Path("results/reproduce"), help="folder (%(default)s)")
    args = parser.parse_args()
    args.output /= "quick" if args.quick else "paper"
    args.output = (args.output / f"ranks_{args.ranks}" if args.ranks > 1 else args.output).resolve()
    args.output.mkdir(parents=True, exist_ok=True)
    tasks = [task for task in TASKS if args.full or not task.full]
    kept = args.output / "done.json"
    done = json.loads(kept.read_text()) if kept.exists() and not args.again else {}
    shown = "{l_bar}{bar}| {elapsed} so far, {remaining} left{postfix}"
    bar = tqdm(total=sum(task.seconds for task in tasks), bar_format=shown)
    for task in tasks:
        bar.set_postfix_str(task.title)
        if task.name not in done or done[task.name]["status"]:
            done[task.name] = run(task, args)
            kept.write_text(json.dumps(done, indent=1))
            report(tasks, done, args)
        bar.update(task.seconds)
    bar.close()
    report(tasks, done, args)
    print(f"wrote {args.output / 'report.html'}")
    failed = [name for name, it in done.items() if it["status"]]
    print(f"failed: {', '.join(failed) or 'none'}")
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
