"""Ironing: a punch pressed into a slab and dragged over it, in the plane and in space, as Markdown tables.

    ./run python3 benchmarks/ironing.py --only plane --lines '*μ = 0*'
    ./run python3 benchmarks/ironing.py --pressure

In the plane the punch (St Venant–Kirchhoff, ten times the slab's stiffness) is pressed down by 0.2 m and dragged by 2 m; f
multiplies its 12 × 6 and the slab's 48 × 8 cells, and "10 + 40" are the steps of the two marches. In space (neo-Hookean) it
is pressed by 0.15 m in 5 steps and dragged obliquely in 10. Unless a row says otherwise μ = 0.3, the punch is the
contactor and, in the plane, the elements are quadrilaterals of order 2. Iterations are those of the steps that
converged, their rejected trials included. Forces are those on the punch: upwards, and against the motion.

The pressures are those of the punch pressed in without friction, whatever of the two is softer at E = 100 Pa, nominal and
at the contactor's integration points: the largest relative difference within 70 % of the contact's half width from a
reference with order 2, f = 8 and segments. Order 1 has f = 8, order 2 has f = 4 and a bottom that is a true parabola: a
dozen facets per half width, so that what counts is three facets away from the edge, where the pressure is a root that no
mesh resolves.

Every row is a process of its own. Its result is a line of a file of results, and rows that have one there are not run
again; delete the file to measure anew.
"""

from __future__ import annotations

import argparse
import contextlib
import fnmatch
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

ROOT = Path(__file__).resolve().parents[1]
from dolfinx_mortar_al import Contact, ContactProblem, Surface, materials, quasistatic
from meshes.ironing import PUNCH, PUNCH_BOTTOM, PUNCH_TOP, SLAB, SLAB_BOTTOM, SLAB_TOP, Ironing

SOFT, NU = 100.0, 0.32  # Young's modulus of the softer body (Pa), Poisson's ratio of both
DEPTH, DRAG = {2: 0.2, 3: 0.15}, {2: (2.0,), 3: (1.2, 0.4)}  # prescribed displacement of the punch's top (m)
PRESSING, DEPTH_PRESSING = (5, 0), 0.1  # steps and depth (m) for the pressures
INNER = 0.7  # of the contact's half width, where pressures are compared
FINE = 96  # cells of the pressures' reference
KINDS = {
    f"order {order}, {integration}": (order, {"integration": integration})
    for order in (2, 1)
    for integration in ("gauss", "segments")
}
SPARE = 60  # s, after its time a row is killed if it has not come to its end by itself


@dataclass(frozen=True)
class Scene:
    """A row: `cells` as in `Ironing`, `steps` of pressing and of dragging, `ratio` of the punch's stiffness to the slab's."""

    dim: int = 2
    cells: int = 12
    order: int = 2
    simplices: bool = False
    friction: float = 0.3
    slab_is_contactor: bool = False
    steps: tuple[int, int] = (10, 40)
    depth: float | None = None
    ratio: float = 10.0
    curved: bool = False

    @property
    def elements(self) -> str:
        return {2: ["quadrilaterals", "triangles"], 3: ["hexahedra", "tetrahedra"]}[self.dim][self.simplices]

    @property
    def name(self) -> str:
        """What the row is called in its table; of no other row."""
        if self.dim == 2:
            parts = [f"f = {self.cells // 12}", f"{self.steps[0]} + {self.steps[1]}", f"μ = {self.friction:g}"]
            parts += [f"order {self.order}"] * (self.order != 2) + ["triangles"] * self.simplices
        else:
            parts = [f"{self.elements} P{self.order}", f"{self.cells} cells", f"μ = {self.friction:g}"]
        return ", ".join(parts + ["slab as contactor"] * self.slab_is_contactor)

    @property
    def pressure_name(self) -> str:
        contactor = "slab" if self.slab_is_contactor else "punch"
        return f"pressure, E ratio {self.ratio:g}, {contactor} as contactor"


def tables() -> dict[str, dict[str, Scene]]:
    """The tables' rows by name."""
    base, space = Scene(), Scene(dim=3, cells=7, order=1, steps=(5, 10))
    steps = [(10, 40), (2, 10)]
    plane = [replace(base, cells=12 * f, steps=s, friction=μ) for μ in (0.3, 0.0) for f in (1, 2, 4) for s in steps]
    for change in ({"order": 1}, {"slab_is_contactor": True}, {"simplices": True}):
        plane += [replace(base, steps=s, friction=μ, **change) for μ in (0.3, 0.0) for s in steps]
    solids = [replace(space, order=order, simplices=s) for order in (1, 2) for s in (False, True)]
    rows = {"plane": plane, "space": list(solids)}
    rows["space"] += [replace(one, slab_is_contactor=True) for one in solids]
    rows["space"] += [replace(one, friction=0.0) for one in solids]
    rows["meshes"] = [replace(space, cells=n, simplices=s) for s in (False, True) for n in (4, 7, 10, 14)]
    pressed = replace(base, friction=0.0, steps=PRESSING, depth=DEPTH_PRESSING, cells=FINE, curved=True)
    pressures = [
        replace(pressed, ratio=10.0**k, slab_is_contactor=slab) for slab in (False, True) for k in range(-3, 4)
    ]
    named = {table: {row.name: row for row in scenes} for table, scenes in rows.items()}
    return named | {"pressure": {row.pressure_name: row for row in pressures}}


# ---------------------------------------------------------------- one row


class Alarm:
    """Raises TimeoutError after some seconds wherever the process is, then every five: the first may be taken for
    another error, or be lost, on its way."""

    def __init__(self, seconds: int) -> None:
        self.rang = False
        signal.signal(signal.SIGALRM, self._ring)
        signal.setitimer(signal.ITIMER_REAL, seconds, 5.0)

    def _ring(self, *_: Any) -> None:
        self.rang = True
        raise TimeoutError

    def off(self) -> None:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def build(scene: Scene, options: dict[str, Any]) -> tuple[ContactProblem, fem.Constant]:
    """The problem, and the displacement of the punch's top (m)."""
    geometry = Ironing(
        dim=scene.dim, cells=scene.cells, triangles=scene.simplices, order=2 if scene.curved else 1
    )  # fmt: skip
    mesh, cells, facets = geometry.create(MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", scene.order, (scene.dim,)))
    u, top = fem.Function(V), fem.Constant(mesh, np.zeros(scene.dim))
    law = {2: materials.saint_venant_kirchhoff, 3: materials.neo_hookean}[scene.dim]
    young = {SLAB: SOFT * max(1.0, 1 / scene.ratio), PUNCH: SOFT * max(1.0, scene.ratio)}
    dx = ufl.Measure("dx", mesh, subdomain_data=cells)
    F = sum(law(E, NU).virtual_work(u, dx=dx(body)) for body, E in young.items())
    held = {SLAB_BOTTOM: fem.Constant(mesh, np.zeros(scene.dim)), PUNCH_TOP: top}
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V, scene.dim - 1, facets.find(tag)), V)
        for tag, value in held.items()
    ]
    sides = [Surface(mesh, facets, PUNCH_BOTTOM), Surface(mesh, facets, SLAB_TOP)]
    contactor, target = reversed(sides) if scene.slab_is_contactor else sides
    contact = Contact(contactor, target, friction=scene.friction, **options)
    return ContactProblem(F, u, bcs=bcs, contacts=[contact]), top


def iron(scene: Scene, problem: ContactProblem, top: fem.Constant) -> Iterator[tuple[str, quasistatic.Step]]:
    """March through pressing and dragging: what is going on, and each step, whose load goes from 0 to 1 in either."""
    down = -(DEPTH[scene.dim] if scene.depth is None else scene.depth)
    ends = ((0.0,) * (scene.dim - 1) + (down,), (*DRAG[scene.dim], down))
    stages = [quasistatic.Stage(top, to, n) for to, n in zip(ends, scene.steps, strict=True) if n]
    for step in quasistatic.march(problem, stages):
        yield ("pressing", "dragging")[step.stage], step


def measure(scene: Scene, options: dict[str, Any], alarm: Alarm) -> tuple[dict[str, Any], ContactProblem]:
    """March to the end or to a failure: what the tables show, and the problem in its last state."""
    problem, top = build(scene, options)
    V = problem.bodies.bodies[0].u.function_space
    said: dict[str, Any] = {"unknowns": V.dofmap.index_map.size_global * V.dofmap.index_map_bs}
    said |= {"steps": 0, "iterations": 0, "rejected": 0, "failed": None}
    at = "at the start"
    begin = time.perf_counter()
    try:
        for doing, step in iron(scene, problem, top):
            said["steps"] += 1
            said["iterations"] += step.iterations
            said["rejected"] += step.rejected
            at = f"after {step.load:.3g} of the {doing}"
    except quasistatic.StepFailure as failure:
        said["failed"], said["message"] = f"FAILED {at}", str(failure)
    except Exception as error:  # whatever ends a row is a finding
        alarm.off()
        said["failed"] = f"TIMEOUT {at}" if alarm.rang else f"FAILED {at} ({type(error).__name__})"
        said["message"] = str(error)
    said["seconds"] = time.perf_counter() - begin
    if said["failed"]:
        return said, problem
    force = problem.pairs[0].force() * (-1 if scene.slab_is_contactor else 1)
    along = np.array(DRAG[scene.dim]) / np.linalg.norm(DRAG[scene.dim])
    said["force"] = [float(force[-1]), float(-force[:-1] @ along)]
    return said, problem


def pressures(scene: Scene, options: dict[str, Any], alarm: Alarm) -> dict[str, Any]:
    """The largest relative difference of the pressure to that of the reference `scene`, away from the edges of contact, of
    each of KINDS."""
    said, problem = measure(scene, options | {"integration": "segments"}, alarm)
    if said["failed"]:
        return said | {"failed": f"reference: {said['failed']}"}
    reference = problem.pairs[0].fields_on_root()
    assert reference is not None
    closed = reference.X[reference.status > 0, 0]
    middle, half = (closed.max() + closed.min()) / 2, (closed.max() - closed.min()) / 2
    said |= {"half_width": half, "differences": {}}
    for kind, (order, integration) in KINDS.items():
        coarse = replace(scene, order=order, curved=order == 2, cells=FINE // order)
        result, problem = measure(coarse, options | integration, alarm)
        for count in ("steps", "iterations", "rejected", "seconds"):
            said[count] += result[count]
        if result["failed"]:
            return said | {"failed": f"{kind}: {result['failed']}"}
        found = problem.pairs[0].fields_on_root()
        assert found is not None
        inside = np.abs(found.X[:, 0] - middle) < INNER * half
        p = np.interp(found.X[inside, 0], reference.X[:, 0], reference.pressure)
        said["differences"][kind] = float(np.max(np.abs(found.pressure[inside] / p - 1)))
    return said


def one(name: str, options: dict[str, Any], timeout: int) -> dict[str, Any]:
    """The row of that name, stopped after `timeout` seconds."""
    alarm = Alarm(timeout)
    for table, scenes in tables().items():
        if name in scenes:
            scene = scenes[name]
            said = pressures(scene, options, alarm) if table == "pressure" else measure(scene, options, alarm)[0]
            return {"name": name, "contact": options, "timeout": timeout} | said
    raise SystemExit(f"no row is called {name!r}")


# ---------------------------------------------------------------- all rows


def process(name: str, options: dict[str, Any], timeout: int) -> dict[str, Any]:
    """The row of that name as a process of its own."""
    command = [sys.executable, __file__, "--one", name, "--timeout", f"{timeout}"]
    command += [a for key, value in options.items() for a in ("--contact", f"{key}={json.dumps(value)}")]
    said = {"name": name, "contact": options, "timeout": timeout}
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=timeout + SPARE)
    except subprocess.TimeoutExpired:
        return said | {"failed": "TIMEOUT"}
    with contextlib.suppress(IndexError, ValueError):
        return dict(json.loads(done.stdout.strip().splitlines()[-1]))
    message = (done.stderr.strip().splitlines() or ["nothing said"])[-1]
    return said | {"failed": "FAILED (crash)", "message": message}


def known(path: Path, options: dict[str, Any], timeout: int) -> dict[str, dict[str, Any]]:
    """Results on file by name, without those a longer time may better."""
    lines = path.read_text().splitlines() if path.exists() else []
    results = {said["name"]: said for said in map(json.loads, lines) if said["contact"] == options}
    return {
        name: said
        for name, said in results.items()
        if not ("TIMEOUT" in (said["failed"] or "") and said["timeout"] < timeout)
    }


def row(*columns: object) -> None:
    print("| " + " | ".join(map(str, columns)) + " |", flush=True)


def head(*columns: str) -> None:
    row(*columns)
    print("|" + "---|" * len(columns))


def show(table: str, results: Sequence[dict[str, Any]]) -> None:
    """A table in Markdown."""
    print(f"\n{table.capitalize()}:\n")
    results_of = [*KINDS] if table == "pressure" else ["force at the end (N: vertical, horizontal)"]
    head("scene", "unknowns", "steps", "iterations", "per step", "rejected", *results_of, "seconds")
    for said in results:
        steps, n = said.get("steps", 0), said.get("iterations", 0)
        if said["failed"]:
            result = [said["failed"], *[""] * (len(results_of) - 1)]
        elif table == "pressure":
            result = [f"{100 * said['differences'][kind]:.1f} %" for kind in KINDS]
        else:
            result = ["{:.3f}, {:.3f}".format(*said["force"])]
        per_step = f"{n / steps:.1f}" if steps else "–"
        seconds = f"{said['seconds']:.1f}" if "seconds" in said else "–"
        row(said["name"], said.get("unknowns", "–"), steps, n, per_step, said.get("rejected", "–"), *result, seconds)


def option(text: str) -> tuple[str, Any]:
    """KEY=VALUE of the command line, the value as JSON or else a string."""
    key, _, value = text.partition("=")
    with contextlib.suppress(ValueError):
        return key, json.loads(value)
    return key, value


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=("plane", "space", "meshes"), help="which tables (all three)")
    parser.add_argument("--pressure", action="store_true", help="the table of pressures; with --only, it too")
    parser.add_argument(
        "--lines", default="*", metavar="PATTERN", help="only rows whose name matches, such as '*slab*'"
    )
    parser.add_argument("--list", action="store_true", help="the names of the rows, nothing is run")
    parser.add_argument("--one", metavar="NAME", help="run this row here and print its result as a line of JSON")
    parser.add_argument("--jobs", type=int, default=1, help="rows run at the same time (%(default)s)")
    parser.add_argument("--timeout", type=int, default=600, help="seconds after which a row ends (%(default)s)")
    parser.add_argument("--results", type=Path, default=ROOT / "results/ironing.jsonl", help="the file of results")
    parser.add_argument(
        "--contact",
        type=option,
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="an argument of Contact, all rows",
    )
    args = parser.parse_args()
    options = dict(args.contact)
    if args.one:
        print(json.dumps(one(args.one, options, args.timeout), ensure_ascii=False))
        return
    wanted = args.only or ([] if args.pressure else ["plane", "space", "meshes"])
    wanted += ["pressure"] * args.pressure
    chosen = {t: [n for n in rows if fnmatch.fnmatch(n, args.lines)] for t, rows in tables().items() if t in wanted}
    names = list(dict.fromkeys(name for rows in chosen.values() for name in rows))
    if args.list:
        print("\n".join(names))
        return
    results = known(args.results, options, args.timeout)
    args.results.parent.mkdir(parents=True, exist_ok=True)
    with args.results.open("a") as file, ThreadPoolExecutor(args.jobs) as pool:
        runs = [pool.submit(process, name, options, args.timeout) for name in names if name not in results]
        for number, run in enumerate(as_completed(runs), start=1):
            said = run.result()
            results[said["name"]] = said
            file.write(json.dumps(said, ensure_ascii=False) + "\n")
            file.flush()
            print(f"{number}/{len(runs)} {said['name']}: {said['failed'] or 'done'}", file=sys.stderr)
    for table, rows in chosen.items():
        if rows:
            show(table, [results[name] for name in rows])


if __name__ == "__main__":
    main()
