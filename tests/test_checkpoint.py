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
from mpi4py import MPI
from scenes import beams

from dolfinx_mortar_al import Checkpoint

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


def lines(directory):
    path = directory / "history.csv"
    return path.read_text().count("\n") if path.exists() else 0


def rows(directory):
    return np.genfromtxt(directory / "history.csv", delimiter=",", names=True)


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
@pytest.mark.parametrize("kind, ranks", [("impact", 1), ("impact", 2), ("bending", 1)])
def test_killed_at_random_times_and_resumed(tmp_path, kind, ranks):
    """SIGKILL at four random moments, the first during start-up, then to the end; every number but times to 1e-9 (impact;
    what round-off of another order of assembly leaves after a few dozen steps). The slip histories and the contact states
    resume exactly; the predictor of a quasi-static march does not, which Newton's tolerance allows 1e-7."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*launcher, sys.executable, SCRIPT]
    subprocess.run([*command, str(tmp_path / "whole"), kind], check=True, capture_output=True, timeout=300)
    rng, killed = np.random.default_rng(ranks + len(kind)), 0
    for kill_after in [0, *rng.integers(3, 15, size=3), 10_000]:
        run = subprocess.Popen(
            [*command, str(tmp_path / "cut"), kind], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
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
    assert killed >= 3
    whole, cut = rows(tmp_path / "whole"), rows(tmp_path / "cut")
    assert len(whole) == len(cut)
    for name in whole.dtype.names:
        if name not in ("wall_time", "newton_iterations"):
            size = np.abs(whole[name]).max()
            assert np.allclose(cut[name], whole[name], rtol=0, atol=(1e-9 if kind == "impact" else 1e-7) * size), name


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
