"""A run to be killed and resumed: an impact with friction, or a quasi-static march; python3 killed_run.py DIR KIND."""

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


def impact(directory):
    mesh, _, tags = Disc(size=0.04, order=1).create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 1, (2,))))
    motion = dynamics.Motion(u, materials.neo_hookean(1.333e6, 0.333), density=6000, step=1e-3, thickness=0.02)
    motion.velocity.interpolate(lambda x: np.stack([3 - 20 * (x[1] - 0.1), -3 + 20 * x[0]]))
    plane = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0])
    contact = Contact(Surface(mesh, tags, RIM), plane, friction=0.3, thickness=0.02)
    problem = ContactProblem(motion.residual, u, contacts=[contact])
    checkpoint = Checkpoint(directory, problem, motion)
    saved = checkpoint.load()
    start, ledger = (saved.at, saved.ledger) if saved else (0.0, None)
    columns = ["time", "kinetic", "strain", "friction", "loss", "spin", "force", "newton_iterations", "wall_time"]
    run = output.Run(problem, directory, columns, {}, resume=start)
    if start < 0.06 - 1e-9:
        for step in dynamics.march(
            problem, motion, to=0.06, start=start, ledger=ledger, move=lambda t: plane.move([0, 0.1 * t])
        ):
            L = step.ledger
            run.record(
                step, step.time, time=step.time, kinetic=L.kinetic, strain=L.strain, friction=L.friction_dissipation,
                loss=L.impact_loss, spin=L.angular_momentum[0], force=step.forces[0][1],
            )  # fmt: skip
            checkpoint.save(step.time, step.ledger)


def bending(directory):
    problem, P = beams(friction=0.3)
    checkpoint = Checkpoint(directory, problem)
    saved = checkpoint.load()
    start = saved.at if saved else 0.0
    run = output.Run(
        problem, directory, ["load", "force", "closed", "newton_iterations", "wall_time"], {}, resume=start
    )
    left = round((20.0 - start) / 0.5)
    if left:
        for step in quasistatic.march(problem, P, to=20.0, increments=left, start=start):
            pair = problem.pairs[0]
            run.record(step, step.load, load=step.load, force=pair.force()[1], closed=pair.closed_fraction())
            checkpoint.save(step.load)


if __name__ == "__main__":
    {"impact": impact, "bending": bending}[sys.argv[2]](Path(sys.argv[1]))
    if MPI.COMM_WORLD.rank == 0:
        print("finished")
