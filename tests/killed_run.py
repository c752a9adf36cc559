"""A run to be interrupted and resumed: an impact with friction, or a quasi-static march.

    python3 killed_run.py DIR impact|bending [--steps N] [--fault KIND --calls N --delay SECONDS --rank RANK]

A fault strikes one rank of the march once its load has been set N times (0: from the start of the program): an exception in
that callback or in the next file that is written, or, some time later, anywhere in Python or as SIGKILL.
"""

import argparse
import errno
import os
import signal
import sys
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]
from scenes import beams

from dolfinx_mortar_al import (
    Checkpoint,
    Contact,
    ContactProblem,
    Surface,
    dynamics,
    materials,
    obstacles,
    output,
    quasistatic,
)
from meshes.disc import RIM, Disc


def impact(directory, steps, faults):
    mesh, _, tags = Disc(size=0.04, order=1).create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 1, (2,))))
    motion = dynamics.Motion(u, materials.neo_hookean(1.333e6, 0.333), density=6000, step=1e-3, thickness=0.02)
    motion.velocity.interpolate(lambda x: np.stack([3 - 20 * (x[1] - 0.1), -3 + 20 * x[0]]))
    plane = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0])
    contact = Contact(Surface(mesh, tags, RIM), plane, friction=0.3, thickness=0.02)
    problem = ContactProblem(motion, contacts=[contact])
    checkpoint = Checkpoint(directory, problem)
    saved = checkpoint.load()
    start, ledger = (saved.at, saved.ledger) if saved else (0.0, None)
    columns = ["time", "kinetic", "strain", "friction", "loss", "spin", "force", "newton_iterations", "wall_time"]
    run = output.Run(problem, directory, columns, {}, resume=start)
    if start < 0.06 - 1e-9:
        for step in dynamics.march(
            problem, to=0.06, start=start, ledger=ledger, move=lambda t: plane.move([0, 0.1 * t])
        ):
            L = step.ledger
            run.record(
                step, step.time, time=step.time, kinetic=L.kinetic, strain=L.strain, friction=L.friction_dissipation,
                loss=L.impact_loss, spin=L.angular_momentum[0], force=step.forces[0][1],
            )  # fmt: skip
            checkpoint.save(step.time, step.ledger)


FAULT = "thrown in for a test"


class Faults:
    """What is to go wrong, and when."""

    def __init__(self, args):
        self.kind, self.delay = args.fault, args.delay
        self.left = args.calls if self.kind and MPI.COMM_WORLD.rank == args.rank else np.inf
        self._open = Path.open
        if self.left == 0:
            self._arm()

    def _arm(self):
        if self.kind == "write":
            Path.open = lambda path, *mode, **options: self._write(path, *mode, **options)
        elif self.kind in ("anywhere", "kill"):
            signal.signal(signal.SIGALRM, self._strike)
            signal.setitimer(signal.ITIMER_REAL, max(self.delay, 1e-3))

    def _strike(self, *_):
        if self.kind == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        raise RuntimeError(FAULT)

    def _write(self, path, mode="r", **options):
        if mode != "r":
            raise OSError(errno.ENOSPC, FAULT)
        return self._open(path, mode, **options)

    def callback(self):
        """To be called by the load's callback."""
        self.left -= 1
        if self.left == 0:
            self._arm()
        if self.left <= 0 and self.kind == "callback":
            raise RuntimeError(FAULT)


def bending(directory, steps, faults):
    problem, P = beams(order=1 if steps > 40 else 2, friction=0.3)

    def load(value):
        faults.callback()
        P.value = value

    checkpoint = Checkpoint(directory, problem)
    saved = checkpoint.load()
    start = saved.at if saved else 0.0
    run = output.Run(
        problem, directory, ["load", "force", "closed", "newton_iterations", "wall_time"], {}, resume=start
    )
    left = round((20.0 - start) / 20.0 * steps)
    if left:
        for step in quasistatic.march(problem, load, to=20.0, increments=left, start=start):
            pair = problem.pairs[0]
            run.record(step, step.load, load=step.load, force=pair.force()[1], closed=pair.closed_fraction())
            if step.nominal:
                checkpoint.save(step.load)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("directory", type=Path)
    parser.add_argument("kind", choices=("impact", "bending"))
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--fault", choices=("anywhere", "callback", "write", "kill"))
    parser.add_argument("--calls", type=int, default=0)
    parser.add_argument("--delay", type=float, default=0.0)
    parser.add_argument("--rank", type=int, default=0)
    args = parser.parse_args()
    {"impact": impact, "bending": bending}[args.kind](args.directory, args.steps, Faults(args))
    if MPI.COMM_WORLD.rank == 0:
        print("finished")
