"""A domed block pressed onto a larger one and dragged over it with friction, from 1e4 to 1e6 unknowns, as a Markdown table.

    ./run python3 benchmarks/scaling.py --sizes 1e4 3e4 1e5
    ./run python3 benchmarks/scaling.py --sizes 1e5 --ranks 1 2 --solvers iterative -contact_ksp_rtol 1e-8

Both blocks are neo-Hookean, the upper one 1 × 1 × 0.5 m and ten times as stiff as the lower one of 2 × 1.5 × 0.8 m, whose
cells are 1/0.7 as large, so that the meshes never match; each is a mesh of its own. The top is pressed down by 0.12 m in two
steps and dragged obliquely by 0.22 m in four, or fewer of them (--steps). Hexahedra, order 1 and μ = 0.3 unless said.


Every row is a process of its own, or an mpirun of them. Seconds are those of a Newton iteration, processor time (the largest
of the ranks), which other work on the machine lengthens less than wall time. Memory is the largest resident set, summed over
the ranks. Options that begin with -contact_ go to PETSc.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))
from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, materials, quasistatic
from dolfinx_mortar_al.command_line import split

LOWER, UPPER = (2.0, 1.5, 0.8), (1.0, 1.0, 0.5)  # sizes (m)
CORNER = (0.35, 0.25, 0.8)  # of the upper block
COARSER = 0.7  # cells per metre of the lower block over those of the upper one
SOFT, RATIO, NU, RADIUS = 100.0, 10.0, 0.3, 1.0  # moduli (Pa), ratio of stiffness, Poisson's, radius of the dome (m)
PRESSED, DRAGGED = 0.12, (0.2, 0.09)  # displacement of the top (m)
STEPS = (2, 4)
BOTTOM, TOP = 1, 2


@dataclass(frozen=True)
class Row:
    """What is run: displacement unknowns asked for, solver, and how the scene differs from the plain one."""

    size: float = 1e4
    solver: str = "iterative"
    order: int = 1
    tetrahedra: bool = False
    friction: float = 0.3
    ranks: int = 1
    steps: tuple[int, int] = STEPS

    @property
    def cells(self) -> int:
        """Cells along the upper block that come nearest to the size."""
        counts = range(2, 400)
        return min(counts, key=lambda n: abs(_unknowns(n, self.order) - self.size))


def _counts(size: tuple[float, ...], per_metre: float) -> list[int]:
    return [max(1, round(length * per_metre)) for length in size]


def _unknowns(cells: int, order: int) -> int:
    bodies = (_counts(UPPER, cells), _counts(LOWER, COARSER * cells))
    return sum(3 * int(np.prod([order * n + 1 for n in counts])) for counts in bodies)


def block(
    comm: MPI.Intracomm, corner: tuple[float, ...], size: tuple[float, ...], per_metre: float, row: Row, dome: bool
) -> Any:
    """A box and its bottom and top facets; with `dome` the bottom is the paraboloid r²/(2 RADIUS)."""
    kind = mesh.CellType.tetrahedron if row.tetrahedra else mesh.CellType.hexahedron
    ends = [np.array(corner), np.add(corner, size)]
    domain = mesh.create_box(comm, ends, _counts(size, per_metre), kind)
    found = [
        mesh.locate_entities_boundary(domain, 2, lambda x, z=z: np.isclose(x[2], z)) for z in (ends[0][2], ends[1][2])
    ]
    order = np.argsort(np.concatenate(found))
    tags = np.repeat([BOTTOM, TOP], [len(f) for f in found]).astype(np.int32)
    facets = mesh.meshtags(domain, 2, np.concatenate(found)[order], tags[order])
    if dome:
        x = domain.geometry.x
        r2 = np.sum((x[:, :2] - ends[0][:2] - np.array(size[:2]) / 2) ** 2, axis=1)
        x[:, 2] += r2 / (2 * RADIUS) * (1 - (x[:, 2] - ends[0][2]) / size[2])
    return domain, facets


def build(row: Row, comm: MPI.Intracomm = MPI.COMM_WORLD) -> tuple[ContactProblem, fem.Constant]:
    """The problem, and the displacement of the upper block's top (m)."""
    lower, lower_facets = block(comm, (0.0, 0.0, 0.0), LOWER, COARSER * row.cells, row, dome=False)
    upper, upper_facets = block(comm, CORNER, UPPER, float(row.cells), row, dome=True)
    u = [fem.Function(fem.functionspace(domain, ("Lagrange", row.order, (3,)))) for domain in (upper, lower)]
    F = [materials.neo_hookean(E, NU).virtual_work(v) for E, v in zip((RATIO * SOFT, SOFT), u, strict=True)]
    top, held = fem.Constant(upper, np.zeros(3)), fem.Constant(lower, np.zeros(3))
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V, 2, facets.find(tag)), V)
        for value, V, facets, tag in (
            (top, u[0].function_space, upper_facets, TOP),
            (held, u[1].function_space, lower_facets, BOTTOM),
        )
    ]
    contact = Contact(Surface(upper, upper_facets, BOTTOM), Surface(lower, lower_facets, TOP), friction=row.friction)
    return ContactProblem(F, u, bcs=bcs, contacts=[contact]), top


def press_and_drag(
    problem: ContactProblem, top: fem.Constant, solver: NewtonSolver, steps: tuple[int, int] = STEPS
) -> Iterator[tuple[str, quasistatic.Step]]:
    """March through so many steps of both: what is going on, and each step."""

    def press(share: float) -> None:
        top.value[2] = -PRESSED * share

    def drag(share: float) -> None:
        top.value[:2] = share * np.array(DRAGGED)

    for doing, load, whole, increments in zip(("pressed", "dragged"), (press, drag), STEPS, steps, strict=True):
        if increments:
            to = increments / whole
            for step in quasistatic.march(problem, load, to=to, increments=increments, start=0.0, solver=solver):
                yield doing, step


def measure(row: Row) -> dict[str, Any]:
    """March to the end or to a failure: what the table shows."""
    begin = time.process_time()
    problem, top = build(row)
    problem.stopwatch.clock = time.process_time
    from petsc4py import PETSc

    PETSc.Options()["contact_linear_solver"] = row.solver
    solver = NewtonSolver(problem)
    counts: list[int] = []
    solver.snes.getKSP().setMonitor(lambda ksp, n, norm: counts.append(n))
    comm, pair = problem.comm, problem.pairs[0]
    start = time.process_time()
    said: dict[str, Any] = asdict(row) | {"unknowns": problem.unknowns, "steps": []}
    said |= {"contact_options": [a for a in sys.argv if a.startswith("-contact_")], "failed": None}
    try:
        for doing, step in press_and_drag(problem, top, solver, row.steps):
            state = {"closed": pair.closed_fraction(), "stick": pair.stick_fraction()}
            said["steps"].append({"doing": doing, "newton": step.iterations, "rejected": step.rejected} | state)
            if comm.rank == 0:
                print(said["steps"][-1], file=sys.stderr, flush=True)
    except quasistatic.StepFailure as failure:
        said["failed"] = str(failure)
    newton = sum(step["newton"] for step in said["steps"])
    ends = [a for a, b in zip(counts, [*counts[1:], 0], strict=True) if b == 0]
    linear = [n for n in ends if n > 0]
    said |= {"newton": newton, "linear": linear, "force": pair.force().tolist()}
    said["set_up"] = comm.allreduce(start - begin, MPI.MAX)
    said["processor"] = comm.allreduce(time.process_time() - start, MPI.MAX)
    parts = sorted(problem.stopwatch.seconds)
    said["seconds"] = {part: comm.allreduce(problem.stopwatch.seconds[part], MPI.MAX) for part in parts}
    said["memory"] = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, MPI.SUM)
    said["linear_solver"], said["fallbacks"] = str(solver.linear), solver.linear.failures
    return said


def process(row: Row, options: list[str], timeout: int) -> dict[str, Any]:
    """The row as a process of its own."""
    command = [sys.executable, __file__, "--one", json.dumps(asdict(row)), *options]
    command = command if row.ranks == 1 else ["mpirun", "-n", str(row.ranks), *command]
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, timeout=timeout)
        # PETSc may have a word to add about options that a solver does not take
        return dict(json.loads([line for line in done.stdout.splitlines() if line.startswith("{")][-1]))
    except subprocess.TimeoutExpired:
        return asdict(row) | {"failed": f"not done in {timeout} s"}
    except (IndexError, ValueError):
        return asdict(row) | {"failed": f"exit status {done.returncode}"}


PARTS = ("bulk", "linear solve", "contact iteration", "projection", "contact", "guard")
COLUMNS = ("solver", "unknowns u + λ", "ranks", "Newton iterations by step", "rejected", "linear: mean, most")
COLUMNS += ("s per Newton iteration", *(f"{part}" for part in PARTS), "peak GB")


def show(said: dict[str, Any]) -> None:
    """A row of the table."""
    if "newton" not in said:
        columns = [said["solver"], f"{said['size']:.3g}", said["ranks"], said["failed"]]
    else:
        n, steps = max(said["newton"], 1), said["steps"]
        linear = said["linear"] or [0]
        columns = [said["solver"], " + ".join(str(k) for k in said["unknowns"].values()), said["ranks"]]
        columns += [", ".join(str(step["newton"]) for step in steps), sum(step["rejected"] for step in steps)]
        columns += [f"{np.mean(linear):.1f}, {max(linear)}", f"{said['processor'] / n:.3g}"]
        columns += [f"{said['seconds'].get(part, 0.0) / n:.2g}" for part in PARTS] + [f"{said['memory']:.2f}"]
        columns += [said["failed"]] if said["failed"] else []
    print("| " + " | ".join(map(str, columns)) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", type=float, default=[1e4, 3e4, 1e5], help="displacement unknowns")
    parser.add_argument("--solvers", nargs="+", default=["direct", "iterative"], choices=("direct", "iterative"))
    parser.add_argument("--direct-up-to", type=float, default=1.5e5, help="no direct rows above (%(default)g)")
    parser.add_argument("--ranks", nargs="+", type=int, default=[1])
    parser.add_argument("--order", type=int, default=1)
    parser.add_argument("--tetrahedra", action="store_true")
    parser.add_argument("--friction", type=float, default=0.3)
    parser.add_argument("--steps", nargs=2, type=int, default=STEPS, help="only the first of pressing and of dragging")
    parser.add_argument("--timeout", type=int, default=7200, help="seconds after which a row ends (%(default)s)")
    parser.add_argument(
        "--results", type=Path, default=ROOT / "results/scaling.jsonl", help="rows are added to this file"
    )
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args, options = split(parser)
    if args.one:
        said = measure(Row(**json.loads(args.one)))
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(said), flush=True)
        return
    args.results.parent.mkdir(parents=True, exist_ok=True)
    print(f"Load of the machine at the start: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
    for size in args.sizes:
        for ranks in args.ranks:
            for solver in args.solvers:
                if solver == "direct" and size > args.direct_up_to:
                    continue
                row = Row(size, solver, args.order, args.tetrahedra, args.friction, ranks, tuple(args.steps))
                said = process(row, options, args.timeout)
                with args.results.open("a") as file:
                    file.write(json.dumps(said) + "\n")
                show(said)


if __name__ == "__main__":
    main()
