"""The block of `scaling.py`, pressed and dragged, on several numbers of ranks, as Markdown tables.

    ./run python3 benchmarks/ranks.py answers --size 3e3 --ranks 1 2 3 7
    ./run python3 benchmarks/ranks.py shares --size 1e5 --ranks 1 2 4 8 16

`answers`: do all numbers of ranks give the same? Forces, norm of the displacements, largest pressure and area against those
of the first number; FGMRES solves to 1e-10 unless an option says otherwise. `shares`: what a rank owns, holds and receives,
counted with the upper block lowered by 0.06 m as it is, nothing solved. Every row is an mpirun, on more ranks than cores if
need be.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT), str(ROOT / "benchmarks")]
from scaling import Row, build, press_and_drag

from dolfinx_mortar_al import NewtonSolver
from dolfinx_mortar_al.command_line import split
from dolfinx_mortar_al.search import MARGIN, ray_candidates
from dolfinx_mortar_al.targets import DeformableTarget

LOWERED = 0.06  # m
TIGHT = 1e-10  # tolerance of FGMRES where answers are compared
ANSWERS = ("ranks", "solver", "Newton iterations by step", "linear: most", "force", "displacements", "pressure", "area")
ANSWERS += ("closed", "stick")
SHARES = (
    "u + λ",
    "ranks",
    "u per rank: mean, most",
    "contactor facets: mean, most",
    "ranks without",
    "target held, kB",
)
SHARES += ("positions received, kB: mean, most", "within reach, kB: mean, most", "a product's ghosts, kB: mean, most")


def answers(row: Row) -> dict[str, Any]:
    """What comes out of the march (collective)."""
    options = PETSc.Options()
    options["contact_linear_solver"] = row.solver
    if row.solver == "iterative" and not options.hasName("contact_ksp_rtol"):
        options["contact_ksp_rtol"] = TIGHT
    problem, top = build(row)
    solver = NewtonSolver(problem)
    linear: list[int] = []
    solver.snes.getKSP().setMonitor(lambda ksp, n, norm: linear.append(n))
    newton = [step.iterations for _, step in press_and_drag(problem, top, solver, row.steps)]
    pair = problem.pairs[0]
    squares = [fem.assemble_scalar(fem.form(ufl.inner(b.u, b.u) * ufl.dx)) for b in problem.bodies.bodies]
    said = {"newton": newton, "linear": max(linear), "force": pair.force().tolist()}
    said |= {"displacements": float(np.sqrt(problem.comm.allreduce(sum(squares), MPI.SUM)))}
    said |= {"pressure": pair.largest_pressure(), "area": pair.contact_area()}
    return said | {"closed": pair.closed_fraction(), "stick": pair.stick_fraction()}


def shares(row: Row) -> dict[str, Any]:
    """What each rank owns, holds and receives (collective)."""
    problem, _ = build(row)
    upper = problem.bodies.bodies[0].u
    upper.x.array[2::3] = -LOWERED
    problem.evaluate()
    pair = problem.pairs[0]
    target = pair.target
    assert isinstance(target, DeformableTarget)
    surface, points = target.surface, pair.kinematics.contactor()
    margin = MARGIN * surface.size_of_facets
    met = np.unique(ray_candidates(points.x, points.normal, target.nodes[surface.facets], margin)[1])
    first, last = problem.bodies.bodies[1].space.dofmap.index_map.local_range
    foreign = (surface.blocks < first) | (surface.blocks >= last)
    needed = np.zeros(len(foreign), dtype=bool)
    needed[surface.facets[met]] = True
    maps = [body.space.dofmap.index_map for body in problem.bodies.bodies]
    bytes_of_node = 8 * problem.gdim
    held = [
        surface.facets,
        surface.blocks,
        surface.X,
        surface.orientation,
        target.nodes,
        target.neighbours,
        target.fixed,
    ]
    mine = {
        "u": problem.bodies.layout.sizes[0],
        "facets": pair.facets.size,
        "held": sum(array.nbytes for array in held) / 1e3,
        "received": bytes_of_node * int(foreign.sum()) / 1e3,
        "needed": bytes_of_node * int((foreign & needed).sum()) / 1e3,
        "ghosts": bytes_of_node * sum(int(m.num_ghosts) for m in maps) / 1e3,
    }
    every = problem.comm.allgather(mine)
    return {"unknowns": problem.unknowns, "ranks": {name: [of[name] for of in every] for name in mine}}


def process(what: str, row: Row, options: list[str], timeout: int) -> dict[str, Any]:
    """The row as an mpirun of its own.

    Raises:
        RuntimeError: if it does not come to its end.
    """
    command = [
        "mpirun",
        "-n",
        str(row.ranks),
        sys.executable,
        __file__,
        what,
        "--one",
        json.dumps(row.__dict__),
        *options,
    ]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, timeout=timeout)
    found = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if not found:
        raise RuntimeError(f"{row.ranks} ranks, {row.solver}: exit status {done.returncode}")
    return dict(json.loads(found[-1]))


def line(columns: list[Any]) -> None:
    print("| " + " | ".join(map(str, columns)) + " |", flush=True)


def show_answers(row: Row, said: dict[str, Any], reference: dict[str, Any]) -> None:
    """A row of the first table: relative differences from the reference."""
    differences = [np.linalg.norm(np.subtract(said["force"], reference["force"])) / np.linalg.norm(reference["force"])]
    names = ("displacements", "pressure", "area", "closed", "stick")
    differences += [abs(said[name] - reference[name]) / max(abs(reference[name]), 1e-300) for name in names]
    counts = [row.ranks, row.solver, ", ".join(map(str, said["newton"])), said["linear"]]
    line([*counts, *(f"{d:.0e}" if d else "0" for d in differences)])


def show_shares(row: Row, said: dict[str, Any]) -> None:
    """A row of the second table."""
    each = said["ranks"]

    def both(name: str) -> str:
        return f"{np.mean(each[name]):.4g}, {max(each[name]):.4g}"

    without = sum(n == 0 for n in each["facets"])
    unknowns = " + ".join(map(str, said["unknowns"].values()))
    owned = [unknowns, row.ranks, both("u"), both("facets"), without, f"{max(each['held']):.4g}"]
    line(owned + [both(name) for name in ("received", "needed", "ghosts")])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("answers", "shares"))
    parser.add_argument("--size", type=float, default=3e3, help="displacement unknowns (%(default)g)")
    parser.add_argument("--ranks", nargs="+", type=int, default=[1, 2, 3, 7])
    parser.add_argument("--solvers", nargs="+", default=["direct", "iterative"], choices=("direct", "iterative"))
    parser.add_argument("--order", type=int, default=1)
    parser.add_argument("--steps", nargs=2, type=int, default=(1, 2), help="of pressing and of dragging (%(default)s)")
    parser.add_argument("--timeout", type=int, default=3600, help="seconds after which a row ends (%(default)s)")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    args, options = split(parser)
    if args.one:
        said = (answers if args.what == "answers" else shares)(Row(**json.loads(args.one)))
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(said), flush=True)
        return
    columns = ANSWERS if args.what == "answers" else SHARES
    line(list(columns))
    print("|---" * len(columns) + "|")
    for solver in args.solvers if args.what == "answers" else args.solvers[:1]:
        reference: dict[str, Any] = {}
        for ranks in args.ranks:
            row = Row(args.size, solver, args.order, ranks=ranks, steps=tuple(args.steps))
            said = process(args.what, row, options, args.timeout)
            reference = reference or said
            if args.what == "answers":
                show_answers(row, said, reference)
            else:
                show_shares(row, said)


if __name__ == "__main__":
    main()
