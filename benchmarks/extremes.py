"""Stiff and extreme cases, each far out in one direction from a plain scene, judged automatically.

    ./run python3 benchmarks/extremes.py [--only WORD] [--jobs 2] [--full]

The plain scene: a block with rounded edges (1 m × 0.5 m, 12 facets) is pressed into a slab (2.4 m × 0.5 m, 20 facets) by 5 %
of its height in 5 increments and dragged by five facets in 5, E = 1 MPa, ν = 0.3, μ = 0.3, neo-Hookean, second order. In
statics verdicts are those of `robustness.py`: forces against runs of the same scene with more increments, penetration and
balance against the bodies' own; where two runs must agree (another unit of length, another ε, one step for many), the miss is
given. In impact they are those of `collisions.py`: energy never above that of the start, momenta kept, nothing passed
through. "refused": an error that says why. "wrong" is a defect. One process each; results go to results/extremes.jsonl, the
table is printed as Markdown.
"""

import argparse
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from robustness import judge, march
from robustness_scenes import Body, Scene, Stage

ROOT = Path(__file__).resolve().parents[1]
AGREE = 0.01  # of the force, between runs that must have one answer
E, NU, FACET = 1e6, 0.3, 0.12

Verdict = tuple[str, str]


# ---------------------------------------------------------------- statics


def body(up: bool, size: tuple[float, ...], cells: tuple[int, ...], **changes: Any) -> Body:
    """A block that touches with its lower face and sides if it is the upper one, else with its top."""
    faces: dict[str, Any] = {"contact": ("bottom", "left", "right") if up else ("top",)}
    faces["held"] = ("top",) if up else ("bottom",)
    plain = {"shape": "block", "size": size, "cells": cells, "E": E, "nu": NU, "material": "neo_hookean"}
    return Body(**plain | faces | changes)


def plain(
    lower: Body | None = None, upper: Body | None = None, stages: tuple[Stage, ...] | None = None, **changes: Any
) -> Scene:
    lower = body(False, (2.4, 0.5), (20, 4)) if lower is None else lower
    upper = body(True, (1.0, 0.5), (12, 4), profile=("round", 0.1)) if upper is None else upper
    fields = {
        "seed": 0, "number": 0, "family": "blocks", "dim": 2, "order": 2, "geometry_order": 2, "simplices": False, "gap": 0.0,
        "friction": 0.3, "swap": False, "stages": pressed_and_dragged() if stages is None else stages,
    }  # fmt: skip
    return Scene(lower=lower, upper=upper, **fields | changes)


def pressed_and_dragged(
    depth: float = 0.025, way: float = 5 * FACET, increments: tuple[int, int] = (5, 5), facet: float = FACET
) -> tuple[Stage, Stage]:
    press, drag = increments
    return (
        Stage("press", press, (0.0, -depth)),
        Stage("drag", drag, (way, -depth), slide=abs(way) / drag / facet),
    )


def judged(scene: Scene) -> Verdict:
    """The verdict of `robustness.py`; an overlap that a finding tells has warned."""
    run = march(scene)
    verdict, reason = judge(scene, run, partial(march, scene))
    told = [name for name in run["findings"] if "overlap" in name]
    return ("warned", f"{reason}; findings: {', '.join(told)}") if verdict == "wrong" and told else (verdict, reason)


def of_one_answer(scene: Scene, force: float, other: dict[str, Any]) -> Verdict:
    """Whether a scene, its forces scaled by `force`, has the answer of another run."""
    run = march(scene)
    if run["error"] or other["error"]:
        return ("refused" if run["kind"] == "step StepFailure" else "failed"), run["error"] or other["error"]
    ends = np.array(run["forces"]) * force, np.array(other["forces"])
    miss = float(np.abs(ends[0] - ends[1]).max() / np.abs(ends[1]).max())
    cut = any(rejected for _, rejected, _ in run["steps"])
    return ("right with rejections" if cut else "right") if miss <= AGREE else "wrong", f"forces within {miss:.1e}"


def with_ε(scale: float) -> Verdict:
    """ε at another scale has the same answer, within what the mesh leaves open."""
    from robustness_model import Model

    scene = plain()
    default = Model(scene).pair.epsilon.normal
    other, run, finer = march(scene), march(scene, ε=scale * default), march(meshes(40, 24))
    if run["error"]:
        return "refused" if run["kind"] == "step StepFailure" else "failed", run["error"]
    forces, size = (np.array(r["forces"]) for r in (run, other, finer)), np.abs(other["forces"]).max()
    mine, default_ε, fine = forces
    miss, mesh = (float(np.abs(f - default_ε).max() / size) for f in (mine, fine))
    cut = any(rejected for _, rejected, _ in run["steps"])
    said = f"forces within {miss:.1e}; those of a mesh twice as fine within {mesh:.1e}"
    warned = [name for name in run["findings"] if "epsilon" in name]
    if miss > max(AGREE, mesh) and warned:
        return "warned", f"{said}; findings: {', '.join(warned)}"
    return ("right with rejections" if cut else "right") if miss <= max(AGREE, mesh) else "wrong", said


def in_unit(unit: float) -> Verdict:
    """All lengths times `unit`: forces per depth scale with it."""
    lower, upper = body(False, (2.4 * unit, 0.5 * unit), (20, 4)), body(True, (unit, 0.5 * unit), (12, 4))
    upper = replace(upper, profile=("round", 0.1 * unit))
    scene = plain(lower, upper, pressed_and_dragged(0.025 * unit, 5 * FACET * unit, facet=FACET * unit))
    return of_one_answer(scene, 1 / unit, march(plain()))


def stiffness(ratio: float) -> Scene:
    """The block `ratio` times as stiff as the slab."""
    return plain(upper=body(True, (1.0, 0.5), (12, 4), profile=("round", 0.1), E=ratio * E))


def poisson(nu: float) -> Scene:
    return plain(
        body(False, (2.4, 0.5), (20, 4), nu=nu), body(True, (1.0, 0.5), (12, 4), nu=nu, profile=("round", 0.1))
    )


def meshes(lower: int, upper: int) -> Scene:
    """Other numbers of facets along the slab and the block."""
    cells = lambda n, width: (n, max(2, min(4, round(n * 0.5 / width))))  # noqa: E731
    parts = body(False, (2.4, 0.5), cells(lower, 2.4)), body(True, (1.0, 0.5), cells(upper, 1.0))
    return plain(*parts, stages=pressed_and_dragged(facet=2.4 / lower))


def beams(slenderness: float) -> Scene:
    """Two cantilevers of 1 m, the upper one's tip driven down by a tenth of it."""
    sides = {"size": (1.0, 1 / slenderness), "cells": (40, 1), "held": ("left",)}
    lower = Body("block", E=E, nu=NU, material="saint_venant_kirchhoff", contact=("top",), **sides)
    upper = replace(lower, contact=("bottom",), loaded=("right",))
    bend = (Stage("bend", 10, (0.0, -0.1)),)
    return plain(lower, upper, bend, family="beams", load="tip")


def flat_cells(aspect: float) -> Scene:
    """Layers whose cells are `aspect` times as long as high."""
    thick = 2 / aspect  # two cells of 1 / aspect
    parts = body(False, (20.0, thick), (20, 2)), body(True, (10.0, thick), (7, 2), contact=("bottom",))
    return plain(*parts, stages=pressed_and_dragged(0.02 * thick, 2.0 * thick, facet=1.0))


def fast(facets: float) -> Scene:
    """Dragged over that many facets in one increment, over a long slab."""
    n = 2 * int(facets) + 24
    lower = body(False, (n * 0.12, 0.5), (n, 4), centre=facets * 0.12)
    return plain(lower, stages=pressed_and_dragged(way=2 * facets * 0.12, increments=(5, 2)))


def over_the_end() -> Scene:
    """Dragged off a slab, beyond its end, and back to where it has been pressed."""
    away = Stage("away", 12, (1.6, -0.025), slide=1.6 / 12 / FACET)
    back = Stage("back", 12, (0.0, -0.025), slide=1.6 / 12 / FACET)
    slab = body(False, (2.4, 0.5), (20, 4), contact=("top", "left", "right"))
    return plain(slab, stages=(Stage("press", 5, (0.0, -0.025)), away, back))


def tilted(lower: float, upper: float, dim: int = 2, **changes: Any) -> Scene:
    """Blocks turned by angles (°) so that an edge or vertex touches, pressed by 2 % of their height (in
    space, where facets are larger, by 8 %: what overlaps less than the first Gauss point is not felt)."""
    n = 5 if dim == 2 else 2
    size, cells = (0.6, 0.6, 0.6)[:dim], (2 * n, 2 * n, 2 * n)[:dim] if dim == 2 else (n, n, n)
    touches = ("top", "right"), ("bottom", "left")
    parts = [body(bool(k), size, cells, contact=touches[k], held=("bottom" if k == 0 else "top",)) for k in (0, 1)]
    if not lower:
        wide = (1.8, 0.6, 1.8)[:dim], (15, 4) if dim == 2 else (5, 2, 5)
        parts[0] = body(False, *wide)
    press = (Stage("press", 5, (0.0, -0.012 if dim == 2 else -0.048, 0.0)[:dim]),)
    tilt = (math.radians(lower), math.radians(upper))
    return plain(*parts, press, tilt=tilt, dim=dim, order=2 if dim == 2 else 1, geometry_order=1, **changes)


def edge_on_edge() -> Scene:
    """Cubes in space whose edges meet across each other, between the contactor's integration points at first."""
    size, cells = (0.6, 0.6, 0.6), (2, 2, 2)
    lower = body(False, size, cells, contact=("top", "front", "back"))
    upper = body(True, size, cells, contact=("bottom", "left", "right"))
    press, tilt = (Stage("press", 5, (0.0, -0.048, 0.0)),), (math.pi / 4, math.pi / 4)
    return plain(lower, upper, press, tilt=tilt, dim=3, order=1, geometry_order=1)


def by_contact_alone(friction: float) -> Scene:
    """A block that nothing but contact and, along the slab, friction holds, under its weight; then pushed by half of what
    friction bears."""
    block = body(True, (1.0, 0.5), (12, 4), held=(), contact=("bottom",))
    weight = 0.02 * E
    stages = (
        Stage("weigh", 4, (0.0, 0.0), load=(0.0, -weight)),
        Stage("push", 4, (0.0, 0.0), load=(0.5 * friction * weight, -weight)),
    )
    return plain(upper=block, stages=stages, friction=friction, load="weight", held="not")


def reversals(n: int) -> Verdict:
    """Sheared to and fro below full sliding: after the first few cycles each must repeat the one before."""
    from robustness_model import Model

    from dolfinx_mortar_al import quasistatic

    parts = body(False, (1.2, 0.5), (4, 2)), body(True, (0.5, 0.25), (3, 1), contact=("bottom",))
    way = 0.002
    ends = Stage("press", 4, (0.0, -0.01)), *(Stage("shear", 1, (way * s, -0.01)) for s in (1, -1))
    model = Model(plain(*parts, ends, order=1, geometry_order=1))
    rejected, forces = 0, []
    for step in quasistatic.march(model.problem, model.set_load(0), to=1.0, increments=4, start=0.0):
        rejected += step.rejected
    model.scene = replace(model.scene, stages=(ends[1], ends[2]))
    for k in range(n):
        # between the ends of the shear: from the first to the second and back
        start, to = (0.0, 1.0) if k % 2 == 0 else (1.0, 0.0)
        for step in quasistatic.march(model.problem, model.set_load(1), to=to, increments=1, start=start):
            rejected += step.rejected
        forces.append(model.pair.force()[:2])
    cycles = np.array(forces).reshape(-1, 2, 2)
    drift = float(np.abs(cycles[10:] - cycles[10]).max() / np.abs(cycles).max())
    verdict = "right" if drift < 1e-9 else "wrong"  # Newton's tolerance
    return verdict, f"forces at the turning points the same to {drift:.1e} in {n} reversals, {rejected} rejected"


def locking() -> None:
    """Force of the pressed block against that of order 2 on a mesh four times as fine, as ν tends to 1/2."""

    def force(nu: float, order: int, finer: int) -> float:
        lower = body(False, (2.4, 0.5), (20 * finer, 4 * finer), nu=nu)
        upper = body(True, (1.0, 0.5), (12 * finer, 4 * finer), nu=nu, profile=("round", 0.1))
        press = pressed_and_dragged(facet=FACET / finer)[:1]
        return float(march(plain(lower, upper, press, order=order, geometry_order=order))["forces"][0][1])

    print("| ν | order 1 | order 1, mesh twice as fine | order 2 | order 2, mesh twice as fine |\n" + "|---" * 5 + "|")
    for nu in (0.3, 0.45, 0.49, 0.499, 0.4999):
        exact = force(nu, 2, 4)
        misses = (force(nu, order, finer) / exact - 1 for order in (1, 2) for finer in (1, 2))
        print(f"| {nu} | {' | '.join(f'{miss:+.1%}' for miss in misses)} |", flush=True)


# ---------------------------------------------------------------- impact


def collision(speed: float, courant: float, friction: float = 0.3) -> Verdict:
    """Two discs of 0.1 m, off-centre, at `speed` wave speeds each; Δt in `courant` times an element's transit."""
    from collisions import DENSITY, Collision, watch
    from collisions import Body as Flying

    from meshes.round_bodies import Round

    R, h = 0.1, 0.025
    c = math.sqrt(1e6 * (1 - NU) / (DENSITY * (1 + NU) * (1 - 2 * NU)))
    v, n = speed * c, np.array([0.3, math.sqrt(0.91)])
    below = Round(radius=R, bore=0.0, size=h)
    above = replace(below, centre=tuple((2 * R + 0.01 * R) * n))
    step = courant * h / c
    bodies = Flying(above, 1e6, tuple(-v * n)), Flying(below, 1e6, tuple(v * n))
    scene = Collision(bodies, step, friction, order=2)
    to = max(min(0.01 * R / v + 8 * R / c, 200 * step), 4 * step)
    seen = watch(scene, to, h)
    said = f"E/E₀ − 1 ≤ {seen.above:.0e}, momenta {seen.momentum:.0e} {seen.spin:.0e}, "
    said += f"penetration {seen.deepest:.1%} of a facet, {seen.steps} steps, {seen.rejected} rejected"
    if seen.failure:
        return "refused", f"{seen.failure}; until then {said}"
    if not seen.sound or seen.deepest > 0.25:
        return "wrong", said
    return "right with rejections" if seen.rejected else "right", said


# ---------------------------------------------------------------- the matrix


def matrix(full: bool) -> dict[str, Callable[[], Verdict]]:
    """Each cell by its name."""
    scenes: dict[str, Scene] = {"plain": plain()}
    scenes |= {f"stiffness ratio {r:.0e}": stiffness(r) for r in (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)}
    scenes |= {f"ν = {nu}": poisson(nu) for nu in (0.0, 0.49, 0.499, 0.4999)}
    scenes |= {f"μ = {mu}": plain(friction=mu) for mu in (0.0, 0.01, 1.0)}
    stuck = pressed_and_dragged(way=2 * FACET)  # by half the block's height: it shears instead of sliding
    scenes |= {f"μ = {mu}": plain(friction=mu, stages=stuck) for mu in (3.0, 10.0)}
    scenes |= {f"slenderness {s}, two beams": beams(s) for s in (100, 1000)}
    scenes |= {f"aspect {a} of all cells": flat_cells(a) for a in (100, 1000)}
    for name, counts in {"1:10": (24, 100), "1:50": (12, 250), "10:1": (96, 4), "50:1": (240, 2)}.items():
        sides = ("fine", "coarse") if name.startswith("1:") else ("coarse", "fine")
        scenes |= {
            f"facets {name}, contactor {side}": replace(meshes(*counts), swap=swap)
            for swap, side in zip((False, True), sides, strict=True)
        }
    scenes |= {f"{n} facets of sliding in an increment": fast(n) for n in (10, 100)}
    scenes["beyond the slab's end and back"] = over_the_end()
    scenes |= {"corner on flat": tilted(0, 45), "corner on flat, swapped": tilted(0, 45, swap=True)}
    scenes |= {"vertex on vertex, 45°": tilted(-45, 45), "vertex on vertex, swapped": tilted(-45, 45, swap=True)}
    scenes["edge on flat in space"] = tilted(0, 45, dim=3)
    scenes["edge on edge in space"] = edge_on_edge()
    scenes["overlap of half a facet"] = plain(gap=-0.04)
    scenes["gap of 1e-12 m"] = plain(gap=1e-12)
    scenes |= {f"held by contact alone, μ = {mu}": by_contact_alone(mu) for mu in (0.3, 1.0)}
    cells: dict[str, Callable[[], Verdict]] = {name: partial(judged, scene) for name, scene in scenes.items()}
    giant = plain(stages=pressed_and_dragged(increments=(1, 1)))
    cells["one increment per stage"] = partial(judged, giant)
    deep = pressed_and_dragged(depth=0.1, increments=(1, 1))
    cells["one increment, four times as deep, μ = 0"] = partial(judged, plain(stages=deep, friction=0.0))
    cells |= {f"ε × {s:.0e}": partial(with_ε, s) for s in (1e-6, 1e-3, 1e-1, 1e1, 1e3, 1e6)}
    cells |= {f"unit of length {u:.0e} m": partial(in_unit, u) for u in (1e-9, 1e-3, 1e3)}
    n = 10_000 if full else 400
    cells[f"{n} load reversals"] = partial(reversals, n)
    speeds = (1e-6, 1e-3, 0.1, 0.5, 1.0, 2.0)
    cells |= {f"impact at {v:g} wave speeds each": partial(collision, v, min(1.0, 0.1 / v)) for v in speeds}
    cells |= {f"impact, Δt of {k:g} transits of an element": partial(collision, 0.02, k) for k in (1e-3, 1e-1, 10, 1e3)}
    return cells


def one(name: str, full: bool) -> None:
    start = time.perf_counter()
    verdict, reason = matrix(full)[name]()
    record = {"case": name, "verdict": verdict, "reason": reason, "seconds": round(time.perf_counter() - start, 1)}
    print(json.dumps(record), flush=True)


def call(name: str, full: bool, timeout: float) -> dict[str, Any]:
    command = [sys.executable, str(Path(__file__)), "--one", name, *(["--full"] if full else [])]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, cwd=ROOT)
    except subprocess.TimeoutExpired:
        return {"case": name, "verdict": "failed", "reason": f"no answer in {timeout:g} s", "seconds": timeout}
    said = [line for line in done.stdout.splitlines() if line.startswith("{")]
    end = f"exit status {done.returncode}: {done.stderr.strip()[-300:]}"
    return json.loads(said[-1]) if said else {"case": name, "verdict": "failed", "reason": end, "seconds": 0.0}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", metavar="WORD", help="cells with this in their name")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time (%(default)s)")
    parser.add_argument("--full", action="store_true", help="10,000 load reversals in place of 400")
    parser.add_argument("--timeout", type=float, default=600.0, help="of a cell in s (%(default)s)")
    parser.add_argument("--results", type=Path, default=ROOT / "results/extremes.jsonl", help="(%(default)s)")
    parser.add_argument("--one", metavar="NAME", help="run this cell here and print JSON")
    parser.add_argument("--locking", action="store_true", help="only a table of what elements make of ν near 1/2")
    args = parser.parse_args()
    if args.one:
        return one(args.one, args.full)
    if args.locking:
        return locking()
    names = [name for name in matrix(args.full) if args.only in name]
    args.results.parent.mkdir(parents=True, exist_ok=True)
    timeout = 10 * args.timeout if args.full else args.timeout
    found: dict[str, dict[str, Any]] = {}
    with ThreadPoolExecutor(args.jobs) as pool, args.results.open("a") as out:
        for k, future in enumerate(as_completed([pool.submit(call, n, args.full, timeout) for n in names]), start=1):
            record = future.result()
            found[record["case"]] = record
            print(f"{k}/{len(names)} {record['case']}: {record['verdict']}", file=sys.stderr, flush=True)
            out.write(json.dumps(record) + "\n")
            out.flush()
    print("| case | verdict | | s |\n|---|---|---|---|")
    for name in names:
        r = found[name]
        print(f"| {name} | {r['verdict']} | {r['reason']} | {r['seconds']:.0f} |")
    sys.exit(any(r["verdict"] in ("wrong", "failed") for r in found.values()))


if __name__ == "__main__":
    main()
