"""What a march asks of its caller's functions and loads: events alike on all ranks, loads that the problem feels."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from types import TracebackType
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.monitors import ModelWarning
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.targets import RigidTarget

__all__ = ["Event", "LoadWatch"]


class Event:
    """An event that a march ends at, checked to be the same on all ranks.

    Args:
        comm: of the problem.
        until: whether it has happened, asked in converged states; None never happens.

    Raises:
        ValueError: if it is no function.
    """

    def __init__(self, comm: MPI.Comm, until: Callable[[], bool] | None) -> None:
        if until is not None and not callable(until):
            raise ValueError(f"until = {until!r}: pass a function without arguments, such as pair.reaches_end")
        self._comm, self._until = comm, until

    def __call__(self) -> bool:
        """Whether it has happened (collective).

        Raises:
            ValueError: on every rank, if the ranks do not agree.
        """
        if self._until is None:
            return False
        happened = bool(self._until())
        agreed(self._comm, "until()", happened)
        return happened


class LoadWatch:
    """Looks whether setting the load changes anything: bulk's residual, prescribed values, friction or an obstacle's pose.

    Use it as a context around the setting of a load; it stops looking at the first change.
    """

    def __init__(self, problem: ContactProblem, load: Any) -> None:
        self._problem, self._felt, self._b = problem, False, problem.bodies.layout.vector()
        self._constant = isinstance(load, fem.Constant)

    def _state(self) -> NDArray[np.float64]:
        self._problem.bodies.residual(self._b)
        parts = [self._b.array_r, [pair.friction_coefficient for pair in self._problem.pairs]]
        for pair in self._problem.pairs:
            if isinstance(pair.target, RigidTarget):
                pose = pair.target.obstacle.pose
                parts += [pose.translation, pose.rotation.ravel()]
        return np.concatenate(parts)

    def __enter__(self) -> None:
        if not self._felt:
            self._before = self._state()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._felt or error is not None:
            return
        changed = not np.array_equal(self._before, self._state(), equal_nan=True)
        self._felt = bool(self._problem.comm.allreduce(changed, MPI.LOR))
        if self._constant:
            self.report()

    def report(self) -> None:
        """Warn, on rank 0, if no setting of the load has changed anything."""
        if not self._felt and self._problem.comm.rank == 0:
            warnings.warn(
                "load: setting it changes neither the residual nor a prescribed value: does the form have another Constant?",
                ModelWarning,
                stacklevel=4,
            )
        self._felt = True
