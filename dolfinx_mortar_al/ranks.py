"""What ranks have to do alike: share out a mesh, and fail, together, with one message, or the run ends.

A failure that one rank alone notices leaves the others waiting for it in their next collective call. Whatever one rank does
for all, or each for itself, therefore goes through :func:`on_root` or :func:`together`, which let all ranks know and raise
alike; values that must be the same everywhere go through :func:`agreed`. What nobody foresaw, such as an exception in a
user's callback on one rank, reaches the hook that :func:`end_together` installs: it prints the traceback and ends the job.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, TypeVar

from mpi4py import MPI

__all__ = ["agreed", "agreed_on_group", "end_together", "on_root", "share_out_alike", "together"]

Result = TypeVar("Result")

OPT_OUT = "DOLFINX_MORTAR_AL_NO_ABORT"  # environment variable that keeps `end_together` from installing its hook
PATIENCE = 2.0  # s that a rank with an exception waits for the others to fail, too, before it ends the job
TAG = 29876  # of the hook's messages: any that nobody else uses


def share_out_alike() -> None:
    """From now on a mesh is partitioned alike in each run on as many ranks, as checkpoints need it and results to the last
    digit do: PT-Scotch works with threads whose race decides (``docs/parallel.md``), unless it is told to use one."""
    os.environ.setdefault("SCOTCH_PTHREAD_NUMBER", "1")


def on_root(comm: MPI.Comm, action: Callable[[], Result]) -> Result:
    """action() on rank 0; its result, which must be picklable, or its exception on all ranks (collective)."""
    result, error = None, None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as caught:
            error = caught
    shared, trouble = comm.bcast((result, _portable(error)), root=0)
    if trouble is not None:
        raise error if error is not None else trouble
    return shared


def together(comm: MPI.Comm, action: Callable[[], Result]) -> Result:
    """action() on every rank, each with its own result; where it fails on some, the exception of the first of them on all
    (collective). `action` must not be collective itself, unless it fails before or after its collective part."""
    error: Exception | None = None
    try:
        result = action()
    except Exception as caught:
        error = caught
    failures = [(rank, e) for rank, e in enumerate(comm.allgather(_portable(error))) if e is not None]
    if failures:
        rank, first = failures[0]
        if comm.rank == rank and error is not None:
            raise error
        raise first
    return result


def agreed(comm: MPI.Comm, name: str, value: Any) -> None:
    """Refuse a value that is not the same on all ranks, and ranks that compare different ones (collective).

    Raises:
        ValueError: on every rank.
    """
    names, said = zip(*comm.allgather((name, repr(value))), strict=True)
    for rank, other in enumerate(names):
        if other != names[0]:
            raise ValueError(
                f"ranks are at different calls: {names[0]!r} is looked at on rank 0, {other!r} on rank {rank}; make the same "
                "calls in the same order on all ranks"
            )
    for rank, other in enumerate(said):
        if other != said[0]:
            raise ValueError(
                f"{name}: {said[0]} on rank 0, {other} on rank {rank}; must be the same on all ranks: pass the "
                "same on each, made from values that all have (comm.allreduce, comm.bcast)"
            )


def agreed_on_group(comm: MPI.Intracomm, name: str, value: Any) -> None:
    """As :func:`agreed`, where ranks may have named different communicators of the same ranks: each mesh has its own, and
    ranks that begin with different ones would wait for ever (collective).

    Raises:
        ValueError: on every rank.
    """
    group = comm.Get_group()
    common = MPI.COMM_WORLD.Create_group(group)
    try:
        agreed(common, name, value)
    finally:
        common.Free()
        group.Free()


def _portable(error: Exception | None) -> Exception | None:
    """The exception, or one that says the same and can be sent."""
    if error is None:
        return None
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def end_together() -> None:
    """Where the program runs on several ranks, see to it that an uncaught exception on some of them ends the job instead of
    leaving the others waiting: `sys.excepthook` prints the traceback, once if all ranks raise alike, and aborts MPI unless
    all have failed. Set the environment variable DOLFINX_MORTAR_AL_NO_ABORT to keep Python's own hook."""
    if MPI.COMM_WORLD.size == 1 or os.environ.get(OPT_OUT) or getattr(sys.excepthook, "ends_together", False):
        return
    previous = sys.excepthook

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        _end(lambda: previous(kind, error, trace), f"{kind.__name__}: {error}")

    hook.ends_together = True  # type: ignore[attr-defined]
    sys.excepthook = hook


def _end(show: Callable[[], None], text: str) -> None:
    """Tell the other ranks of a failure with this `text`, listen for theirs, and end the job unless all have failed."""
    if MPI.Is_finalized():
        show()
        return
    comm = MPI.COMM_WORLD
    said, sent = {comm.rank: text}, [comm.isend(text, k, TAG) for k in range(comm.size) if k != comm.rank]
    give_up, status = time.monotonic() + PATIENCE, MPI.Status()
    while len(said) < comm.size and time.monotonic() < give_up:
        if comm.iprobe(MPI.ANY_SOURCE, TAG, status):
            said[status.source] = comm.recv(None, status.source, TAG)
        else:
            time.sleep(0.01)
    if comm.rank == min(rank for rank, other in said.items() if other == text):
        show()
    if len(said) < comm.size:
        if comm.rank == min(said):
            failed = ", ".join(map(str, sorted(said)))
            print(f"rank {failed} of {comm.size} failed while others went on: the run ends", file=sys.stderr)
        sys.stdout.flush()
        sys.stderr.flush()
        comm.Abort(1)
    MPI.Request.waitall(sent)
