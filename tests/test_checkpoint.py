"""A run killed at any moment and resumed has the history of one that was not."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem, mesh
from killed_run import FAULT
from mpi4py import MPI
from scenes import beams

from dolfinx_mortar_al import (
    Body,
    Checkpoint,
    Contact,
    ContactProblem,
    Surface,
    dynamics,
    materials,
    obstacles,
    quasistatic,
)
from meshes.two_beams import LOWER_TOP, UPPER_BOTTOM, TwoBeams

SCRIPT = str(Path(__file__).with_name("killed_run.py"))


def processes(word):
    """Ids of the processes, launcher and ranks, that have `word` among their arguments."""
    found = []
    for cmdline in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # one that has just ended
            if word.encode() in cmdline.read_bytes().split(b"\0"):
                found.append(int(cmdline.parent.name))
    return found


def kill_all(word):
    """SIGKILL to all of a run, ranks that its launcher was about to start included."""
    quiet = 0
    while quiet < 10:
        running = processes(word)
        for process in running:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        quiet = 0 if running else quiet + 1
        time.sleep(0.02)


def history(directory):
    """history.csv of the run in a directory; a demo with several cases has a folder for each."""
    return next(directory.glob("**/history.csv"), directory / "history.csv")


def lines(directory):
    path = history(directory)
    return path.read_text().count("\n") if path.exists() else 0


def rows(directory):
    return np.genfromtxt(history(directory), delimiter=",", names=True)


DEMOS = {
    "two_beams": ["--cells", "10", "1", "--increments", "12", "--friction", "0.3"],
    "two_membranes": ["--cells", "12", "12", "--increments", "12", "--friction", "0"],
    "two_bars": ["--cells", "6"],
    "spinning_disc": ["--size", "0.04", "--spin", "slice"],
    "two_rings": ["--size", "0.02", "--step", "1e-3", "--time", "0.012"],
}


def command(kind, ranks, directory):
    """The run `kind`: of killed_run.py, or a demo."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    if kind not in DEMOS:
        return [*launcher, sys.executable, SCRIPT, str(directory), kind]
    script = Path(__file__).parents[1] / "demos" / f"{kind}.py"
    options = ["--no-figure", "--checkpoint", "--output", str(directory)]
    return [*launcher, sys.executable, str(script), *DEMOS[kind], *options]


def assert_same_history(cut, whole, share):
    """Every number but times and iterations, to a share of the column's largest; what is below 1e-6 of the largest number at
    all, such as the defect of an energy balance that is met, counts as that much. A penetration is the difference of
    positions, metres: where contact is closed it is their round-off, of which 1e-6 would ask for the digits."""
    cut, whole = rows(cut), rows(whole)
    assert len(whole) == len(cut)
    largest = max(np.abs(whole[name]).max() for name in whole.dtype.names)
    for name in whole.dtype.names:
        if name not in ("wall_time", "newton_iterations"):
            floor = (1e-4 if name == "penetration" else 1e-6) * largest
            size = max(np.abs(whole[name]).max(), floor)
            assert np.allclose(cut[name], whole[name], rtol=0, atol=share * size), name


@pytest.mark.one_rank
@pytest.mark.parametrize(
    "kind, ranks, kills", [("impact", 1, 3), ("impact", 2, 3), ("bending", 1, 3), *((demo, 1, 2) for demo in DEMOS)]
)
def test_killed_at_random_times_and_resumed(tmp_path, kind, ranks, kills):
    """SIGKILL at random moments, the first during start-up, then to the end; every number but times to 1e-9 (dynamics; what
    round-off of another order of assembly leaves after a few dozen steps). The slip histories and the contact states resume
    exactly; the predictor of a quasi-static march does not, which Newton's tolerance allows 1e-7."""
    subprocess.run(command(kind, ranks, tmp_path / "whole"), check=True, capture_output=True, timeout=300)
    rng, killed = np.random.default_rng(ranks + len(kind)), 0
    for kill_after in [0, *rng.integers(2, 5 if kind in DEMOS else 15, size=kills), 10_000]:
        run = subprocess.Popen(
            command(kind, ranks, tmp_path / "cut"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wanted = lines(tmp_path / "cut") + kill_after
        while run.poll() is None and lines(tmp_path / "cut") < wanted:
            time.sleep(0.002)
        time.sleep(rng.uniform(0.0, 0.1))  # somewhere in a step, in writing a row or a checkpoint
        if run.poll() is None:
            threading.Thread(target=run.wait).start()  # a killed process stays in /proc until it is waited for
            kill_all(str(tmp_path / "cut"))
            killed += 1
        run.wait()
    assert run.returncode == 0
    assert killed >= kills
    statics = kind in ("bending", "two_beams", "two_membranes")
    assert_same_history(tmp_path / "cut", tmp_path / "whole", 1e-7 if statics else 1e-9)


def run_with_faults(directory, steps, seed, faults):
    """The quasi-static run on two ranks until it is through, with `faults` faults on a random rank at random moments: in
    start-up or within the steps that each has for itself, so that all strike however fast the machine is. Returns their
    kinds. Each ends the job within a minute of its moment with one message, or none of its own where a rank is killed."""
    rng, struck = np.random.default_rng(seed), []
    while True:
        kind = str(rng.choice(["anywhere", "callback", "write", "kill"]))
        calls, delay = rng.integers(steps // (faults + 1)), rng.uniform(0.0, 0.05)
        fault = ["--fault", kind, "--calls", str(calls), "--delay", str(delay), "--rank", str(rng.integers(2))]
        call = [*command("bending", 2, directory), "--steps", str(steps), *(fault if len(struck) < faults else [])]
        run = subprocess.run(call, capture_output=True, text=True, timeout=60 + steps, check=False)
        if run.returncode == 0:
            return struck
        if kind != "kill":
            assert run.stderr.count(f"Error: {FAULT}") + run.stderr.count(f"] {FAULT}") == 1, run.stderr
        struck.append(kind)


@pytest.mark.one_rank
def test_faults_on_one_rank_end_the_job_and_lose_nothing(tmp_path):
    """Exceptions, full disks and kills on one rank of two: the numbers of an undisturbed run (to 1e-7, the predictor)."""
    subprocess.run(command("bending", 2, tmp_path / "whole"), check=True, capture_output=True, timeout=300)
    assert len(run_with_faults(tmp_path / "cut", steps=40, seed=1, faults=4)) == 4
    assert_same_history(tmp_path / "cut", tmp_path / "whole", 1e-7)


def test_a_damaged_checkpoint_is_replaced_by_the_one_before(shared_path):
    problem, P = beams(order=1)
    keeper = Checkpoint(shared_path, problem)
    for at in (1.0, 2.0, 3.0):
        P.value = at
        keeper.save(at)
    MPI.COMM_WORLD.Barrier()
    last = shared_path / f"checkpoint_1_{MPI.COMM_WORLD.size - 1}.npz"
    if MPI.COMM_WORLD.rank == 0:
        last.write_bytes(last.read_bytes()[:-200])
    MPI.COMM_WORLD.Barrier()
    warned = pytest.warns(UserWarning, match="at 2") if problem.comm.rank == 0 else contextlib.nullcontext()
    with warned:
        assert Checkpoint(shared_path, problem).load().at == 2.0


@pytest.mark.parametrize("other, words", [({"friction": 0.4}, "friction of pair contact: 0.3 then, 0.4 now"),
                                          ({"young": 3e6}, "another form"), ({"unit": 2.0}, "another geometry")])  # fmt: skip
def test_a_checkpoint_says_in_what_a_problem_differs(shared_path, other, words):
    problem, _ = beams(order=1, friction=0.3)
    Checkpoint(shared_path, problem).save(0.0)
    changed, _ = beams(order=1, **{"friction": 0.3} | other)
    with pytest.raises(ValueError, match=words):
        Checkpoint(shared_path, changed).load()


def test_another_problem_is_refused(shared_path):
    problem, _ = beams()
    Checkpoint(shared_path, problem).save(0.0)
    other, _ = beams(order=1)
    with pytest.raises(ValueError, match="made by another problem"):
        Checkpoint(shared_path, other).load()
    assert Checkpoint(shared_path, problem).load().at == 0.0


def test_nothing_saved_yet(shared_path):
    problem, _ = beams()
    assert Checkpoint(shared_path, problem).load() is None


def test_a_checkpoint_is_loaded_twice_in_motion(shared_path):
    """With segments, where some ranks have no facet of the contactor: all of them find the target's nodes anew."""
    domain, _, tags = TwoBeams(height=0.5, width=0.5, along=(4, 5), across=2, through=2).create()
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    motion = dynamics.Motion(Body(u, materials.neo_hookean(1e3, 0.3), density=1.0), step=1e-3)
    sides = [Surface(domain, tags, tag) for tag in (UPPER_BOTTOM, LOWER_TOP)]
    problem = ContactProblem(motion, contacts=[Contact(*sides, integration="segments", friction=0.3)])
    list(dynamics.march(problem, to=2e-3))
    checkpoint = Checkpoint(shared_path, problem)
    checkpoint.save(2e-3)
    assert [checkpoint.load().at for _ in range(3)] == [2e-3] * 3
    (step,) = dynamics.march(problem, start=2e-3, to=3e-3)
    assert step.rejected == 0


def test_a_body_that_friction_holds_is_held_after_a_restart(shared_path):
    """A block pressed between planes is no longer known to be held once its load is taken away, and is again with the state
    of before: where no step leads on, it may be let go at once."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    sides = [mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, 1.0)]
    facets = np.sort(np.concatenate(sides))
    tags = mesh.meshtags(domain, 1, facets, np.isin(facets, sides[1]).astype(np.int32))
    planes = [obstacles.RigidPlane((0.0, 0.0), (0.0, 1.0)), obstacles.RigidPlane((0.0, 1.0), (0.0, -1.0))]
    contacts = [Contact(Surface(domain, tags, k), planes[k], friction=0.5, name=f"{k}") for k in (0, 1)]

    def block():
        u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
        return ContactProblem(Body(u, materials.neo_hookean(1e3, 0.3)), contacts=contacts)

    problem = block()
    list(quasistatic.march(problem, lambda d: planes[1].move((0.0, -d)), to=0.02, increments=2))
    assert problem.standing.held
    Checkpoint(shared_path, problem).save(0.02)
    other = block()
    assert not other.standing.held
    Checkpoint(shared_path, other).load()
    assert other.standing.held
