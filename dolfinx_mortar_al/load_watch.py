"""Does the problem feel a load?"""

from __future__ import annotations

from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.monitors import warn
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import any_over
from dolfinx_mortar_al.targets import RigidTarget

__all__ = ["LoadWatch"]


class LoadWatch:
    """Looks whether setting the load changes anything: bulk's residual, prescribed values, friction or an obstacle's pose.

    Use it as a context around the setting of a load; it stops looking at the first change.

    Args:
        problem: the problem.
        at_once: whether the first setting must change something already, as that of a Constant does; a function may begin
            to act later.
    """

    def __init__(self, problem: ContactProblem, at_once: bool) -> None:
        self._problem, self._felt, self._b = problem, False, problem.bodies.layout.vector()
        self._at_once = at_once

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
        self._felt = any_over(self._problem.comm, changed)
        if self._at_once:
            self.report()

    def report(self) -> None:
        """Warn, on rank 0, if no setting of the load has changed anything."""
        if not self._felt and self._problem.comm.rank == 0:
            warn(
                "load: setting it changes neither the residual nor a prescribed value: does the form have another Constant?"
            )
        self._felt = True
