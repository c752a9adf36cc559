"""Random contact scenes (`robustness_scenes`), each marched stage by stage through the public interface and judged.

    ./run python3 benchmarks/robustness.py --seed 1 --scenes 300 --jobs 2 [--peer] [--families punch "half ring"]
    ./run python3 benchmarks/robustness.py --one 1 17 [--verbose]

Each scene runs in a process of its own; results go to results/robustness/seed-N.jsonl, and what is there is not run again.

- right: it went through. Its contact forces at the end of each stage agree with runs of twice (and, where these differ, four
  times) as many increments within 2 % of the largest force and three times what first-order convergence in the increments
  explains. No point of the contactor is deeper in the target than a quarter of a facet (a fiftieth, without a contact
  force); contact force and reaction balance.
- right with rejections: the same, some steps after a cut of the increment. Unverified: the finer runs did not go through.
- right (coarse): with friction the answer of a few long increments may be far off that of many. Where forces disagree in such
  a scene, it is run again with another ε, on which the answer of the same increments must not depend.
- refused: an error that names a true reason (REASONS; or a ValueError at set-up). A finer run that goes through shows that
  the reason was not true: failed.
- failed: any other failure, or no answer in time. Wrong: it went through with another answer.

Percentages and means count asked-for increments that were reached, iterations those of rejected trials, too. Sliding is
that of the drive: how many target facets an increment passes if nothing sticks or bends.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
from robustness_scenes import FAMILIES, PLANE, Scene, draw

REASONS = ("unstable", "inverted cell", "limit point")  # in the message of a StepFailure that counts as refused
AGREE = 0.02  # of the largest force
DEEPEST = 0.25  # of a facet
UNFELT = 0.02  # of a facet, without a contact force
BALANCE = 1e-5  # of the contact force
COARSE = (8, 1.0)  # fewer increments in a stage, or more facets of sliding in one, may be far from their limit
VERDICTS = ("right", "right with rejections", "right (coarse)", "right (unverified)", "refused", "failed", "wrong")


def march(
    scene: Scene,
    refinement: int = 1,
    other_ε: bool = False,
    verbose: bool = False,
    integration: str = "gauss",
    ε: float | None = None,
    smallest: float = 2.0**-10,
) -> dict[str, Any]:
    """One run of a scene, with `refinement` times as many increments, none less than `smallest` of them.

    The result has steps (per asked-for increment the iterations, rejected trials and facets of sliding), forces at the end of
    each stage, error, names of findings, checks of the last state.
    """
    from robustness_model import Model

    from dolfinx_mortar_al import quasistatic

    start = time.perf_counter()
    result: dict[str, Any] = {"steps": [], "forces": [], "error": None, "kind": None, "findings": []}
    kind = "set-up"
    try:
        model = Model(scene, other_ε, integration, ε)
        kind = "step"
        for k, stage in enumerate(scene.stages):
            count = [0, 0]
            steps = quasistatic.march(
                model.problem,
                model.set_load(k),
                to=1.0,
                increments=refinement * stage.increments,
                start=0.0,
                smallest=smallest,
            )
            for step in steps:
                count = [count[0] + step.iterations, count[1] + step.rejected]
                result["findings"] += [f.name for f in step.findings if f.name not in result["findings"]]
                if verbose:
                    print(stage.name, step.load, *count, model.pair.force(), flush=True)
                if step.nominal:
                    result["steps"].append([*count, stage.slide / refinement])
                    count = [0, 0]
            result["forces"].append(model.pair.force().tolist())
        kind = "check"
        result |= {"penetration": model.penetration(), "balance": model.balance(), "floor": model.force_floor()}
    except Exception as error:  # whatever ends a run is its result
        result |= {"error": f"{type(error).__name__}: {error}", "kind": f"{kind} {type(error).__name__}"}
    return result | {"seconds": round(time.perf_counter() - start, 2)}


def judge(scene: Scene, run: dict[str, Any], again: Callable[..., dict[str, Any]]) -> tuple[str, str]:
    """Verdict and reason; `again(k)` is the same scene with k times as many increments, `again(1, True)` with another ε."""
    if run["error"]:
        if run["kind"] == "set-up ValueError":
            return "refused", run["error"]
        if run["kind"] == "step StepFailure" and any(reason in run["error"] for reason in REASONS):
            untrue = "but twice as many increments go through: "
            return ("refused", run["error"]) if again(2)["error"] else ("failed", untrue + run["error"])
        return "failed", run["error"]
    if run["penetration"] > DEEPEST:
        return "wrong", f"a point of the contactor is {run['penetration']:.2g} facets inside the target"
    if np.linalg.norm(run["forces"][-1]) < run["floor"] and run["penetration"] > UNFELT:
        return "wrong", f"no contact force where the bodies overlap by {run['penetration']:.2g} facets"
    if run["balance"] is not None and run["balance"] > BALANCE:
        return "wrong", f"contact force and internal forces differ by {run['balance']:.1e} of the force"
    right = "right with rejections" if any(rejected for _, rejected, _ in run["steps"]) else "right"
    runs = [run, again(2)]
    while len(runs) < 4:
        if runs[-1]["error"]:
            return "right (unverified)", f"{2 ** (len(runs) - 1)} times as many increments: {runs[-1]['error']}"
        forces = [np.array(r["forces"]) for r in runs]
        size = max(np.linalg.norm(forces[-1], axis=1).max(), run["floor"])
        miss = [np.linalg.norm(f - forces[-1], axis=1).max() / size for f in forces[:-1]]
        # errors of C/n: the first run's is three times the second's, both against the third
        if miss[0] <= AGREE + (9 * miss[1] if len(miss) == 2 else 0.0):
            return right, f"forces within {miss[0]:.1e}"
        runs.append(again(4) if len(runs) == 2 else {})
    reason = f"forces {miss[0]:.1%} off those with four times as many increments, with twice as many {miss[1]:.1%}"
    if scene.friction and any(s.increments < COARSE[0] or s.slide > COARSE[1] for s in scene.stages):
        other = again(1, True)
        if other["error"]:
            return "right (unverified)", f"{reason}; with another ε: {other['error']}"
        miss.append(np.linalg.norm(forces[0] - other["forces"], axis=1).max() / size)
        reason += f", with another ε {miss[2]:.1%}"
        if miss[2] <= AGREE:
            return "right (coarse)", reason
    return "wrong", reason


def one(seed: int, number: int, verbose: bool, integration: str) -> None:
    """Run and judge a scene; a line of JSON after its own run, and another after the finer ones."""
    scene = draw(seed, number)
    run = march(scene, verbose=verbose, integration=integration)
    record = {"code": "ours", "seed": seed, "number": number, "family": scene.family} | run
    unverified = {"verdict": "right (unverified)", "reason": "no time for finer runs"}
    print(
        json.dumps(record | ({"verdict": "failed", "reason": run["error"]} if run["error"] else unverified)), flush=True
    )
    finer = partial(march, scene, verbose=verbose, integration=integration)
    verdict, reason = judge(scene, run, finer)
    print(json.dumps(record | {"verdict": verdict, "reason": reason}), flush=True)


def call(command: list[str], record: dict[str, Any], timeout: float) -> dict[str, Any]:
    """The last line of JSON of a process, or what became of it."""
    start = time.perf_counter()
    try:
        done = subprocess.run([sys.executable, *command], capture_output=True, text=True, timeout=timeout, cwd=ROOT)
        printed, end = done.stdout, f"exit status {done.returncode}: {done.stderr.strip()[-300:]}"
    except subprocess.TimeoutExpired as expired:
        printed, end = (expired.stdout or b"").decode(), f"no answer after {timeout:g} s"
    said = [line for line in printed.splitlines() if line.startswith("{")]
    if said:
        return json.loads(said[-1])
    lost = {"steps": [], "forces": [], "verdict": "failed", "reason": end}
    return record | lost | {"seconds": round(time.perf_counter() - start, 2)}


def ours(scene: Scene, timeout: float, integration: str = "gauss") -> dict[str, Any]:
    record = {"code": "ours", "seed": scene.seed, "number": scene.number, "family": scene.family}
    command = ["benchmarks/robustness.py", "--integration", integration]
    return call([*command, "--one", str(scene.seed), str(scene.number)], record, timeout)


def peer(scene: Scene, timeout: float) -> dict[str, Any]:
    """The scene in GetFEM: the same mesh and increments."""
    record = {"code": "GetFEM", "seed": scene.seed, "number": scene.number, "family": scene.family}
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / name) for name in ("scene.json", "mesh.npz")]
        Path(files[0]).write_text(json.dumps(scene.json()))
        export = ["benchmarks/robustness.py", "--export", str(scene.seed), str(scene.number), files[1]]
        subprocess.run([sys.executable, *export], capture_output=True, cwd=ROOT)
        return record | call(["benchmarks/getfem_robustness.py", *files], record, timeout)


CODES: dict[str, Callable[..., dict[str, Any]]] = {"ours": ours, "GetFEM": peer}


def mean(values: list[float]) -> str:
    return f"{np.mean(values):.1f}" if len(values) else "–"


def table(records: list[dict[str, Any]]) -> None:
    """Per family and in all; then each failed or wrong scene."""
    print("| family | scenes | " + " | ".join(VERDICTS), end=" | ")
    print(
        "% of steps rejected | iterations per step | up to a facet of sliding | s |\n"
        + "|---" * (len(VERDICTS) + 6)
        + "|"
    )
    for family in (*FAMILIES, "all"):
        of = [r for r in records if family in (r["family"], "all")]
        if not of:
            continue
        counts = " | ".join(str(sum(r["verdict"] == v for r in of)) for v in VERDICTS)
        steps = [step for r in of for step in r["steps"]]
        rejected = 100 * sum(step[1] for step in steps) / max(len(steps), 1)
        iterations = mean([step[0] for step in steps]), mean([step[0] for step in steps if step[2] <= 1])
        print(f"| {family} | {len(of)} | {counts} | {rejected:.1f} | {iterations[0]} | {iterations[1]} ", end="")
        print(f"| {mean([r['seconds'] for r in of])} |")
    for verdict in ("wrong", "failed", "refused"):
        for r in (r for r in records if r["verdict"] == verdict):
            print(f"\n{verdict}: {r['family']}, ./run python3 benchmarks/robustness.py --one {r['seed']} {r['number']}")
            print(f"  {r['reason']}")


def beside(mine: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> None:
    """Failures of both codes on the common scenes; on those where neither failed iterations, and the median difference of the
    forces at the end, which have the error of the mesh."""
    peers = {r["number"]: r for r in theirs}
    print("\n| family | common scenes | failed | GetFEM failed | both went through ", end="")
    print("| iterations | GetFEM's iterations | forces differ by |\n" + "|---" * 8 + "|")
    for family in (*PLANE, "all"):
        both = [(r, peers[r["number"]]) for r in mine if r["number"] in peers and family in (r["family"], "all")]
        if not both:
            continue
        bad = [[r["verdict"] in ("failed", "wrong", "refused") for r in pair] for pair in both]
        through = [pair for pair, failed in zip(both, bad, strict=True) if not any(failed)]
        counts = [sum(step[0] for pair in through for step in pair[k]["steps"]) for k in (0, 1)]
        failures = " | ".join(str(sum(b[k] for b in bad)) for k in (0, 1))
        ends = [np.array([r["forces"][-1] for r in pair]) for pair in through]
        miss = [np.linalg.norm(a - b) / max(np.linalg.norm(a), np.linalg.norm(b), 1e-300) for a, b in ends]
        differ = f"{100 * np.median(miss):.2g} %" if miss else "–"
        print(f"| {family} | {len(both)} | {failures} | {len(through)} | {counts[0]} | {counts[1]} | {differ} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="of all scenes (%(default)s)")
    parser.add_argument("--scenes", type=int, default=33, help="numbers 0 … this − 1, families in turn (%(default)s)")
    parser.add_argument(
        "--families", nargs="+", choices=FAMILIES, default=FAMILIES, metavar="FAMILY", help="only these"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time (%(default)s)")
    parser.add_argument("--peer", action="store_true", help="GetFEM beside it, on the plane families it can do")
    parser.add_argument(
        "--timeout", type=float, default=300.0, help="of a scene in s, finer runs included (%(default)s)"
    )
    parser.add_argument("--results", type=Path, default=ROOT / "results/robustness", help="folder (%(default)s)")
    parser.add_argument("--integration", choices=("gauss", "segments"), default="gauss", help="of ours (%(default)s)")
    parser.add_argument("--one", type=int, nargs=2, metavar=("SEED", "NUMBER"), help="run this scene here, print JSON")
    parser.add_argument("--export", nargs=3, metavar=("SEED", "NUMBER", "FILE.npz"), help="write this scene's mesh")
    parser.add_argument("--verbose", action="store_true", help="with --one: each step, too")
    args = parser.parse_args()
    if args.one:
        return one(*args.one, args.verbose, args.integration)
    if args.export:
        from robustness_model import export

        return export(draw(*map(int, args.export[:2])), Path(args.export[2]))

    scenes = [s for s in (draw(args.seed, k) for k in range(args.scenes)) if s.family in args.families]
    tasks = [(code, s) for s in scenes for code in CODES if code == "ours" or (args.peer and s.family in PLANE)]
    args.results.mkdir(parents=True, exist_ok=True)
    path = args.results / f"seed-{args.seed}{'-segments' if args.integration == 'segments' else ''}.jsonl"
    codes = CODES | {"ours": partial(ours, integration=args.integration)}
    lines = path.read_text().splitlines() if path.exists() else []
    done = {(r["code"], r["number"]): r for r in map(json.loads, lines)}
    todo = [(code, s) for code, s in tasks if (code, s.number) not in done]
    with ThreadPoolExecutor(args.jobs) as pool, path.open("a") as out:
        running = [pool.submit(codes[code], scene, args.timeout) for code, scene in todo]
        for k, future in enumerate(as_completed(running), start=1):
            r = future.result()
            done[r["code"], r["number"]] = r
            out.write(json.dumps(r) + "\n")
            out.flush()
            said = f"{k}/{len(todo)} {r['code']} {r['family']} {r['number']}: {r['verdict']}"
            print(said, file=sys.stderr, flush=True)
    wanted = [done[code, s.number] for code, s in tasks]
    table([r for r in wanted if r["code"] == "ours"])
    if args.peer:
        beside(*([r for r in wanted if r["code"] == code] for code in ("ours", "GetFEM")))


if __name__ == "__main__":
    main()
