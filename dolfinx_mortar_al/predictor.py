"""Prediction of the next state by polynomials through the last ones, along a straight line of loading."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.petsc_blocks import Layout
from dolfinx_mortar_al.problem import ContactProblem, Snapshot
from dolfinx_mortar_al.reductions import sum_over

__all__ = ["Predictor"]

MAX_ORDER = 4  # of the polynomial
BETTER = 3.0  # factor by which a higher order must have been better to be used: measured, docs/newton.md


class Predictor:
    """The last converged states and their abscissae, for extrapolation and for undoing a failed step.

    Args:
        problem: in its start state, whose contact is a guess.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self.problem = problem
        self._abscissae: list[float] = []
        self._states: list[Snapshot] = []
        self._guesses = 1  # among the states: the start's contact
        self._touching: list[bool] = []  # of each pair, in the last state
        self._pressing: list[list[float]] = []  # each pair's force in the states (N)
        self._slack = problem.slack.copy()
        #: of each predicted array, the polynomial order to predict it with
        self._order = dict.fromkeys(self._owned, 1)

    @cached_property
    def _owned(self) -> dict[tuple[str, str], int]:
        """What is extrapolated, member and name of arrays of a snapshot: how many of its first values are this rank's."""
        problem = self.problem
        layouts = {("bodies", "u"): problem.bodies.layout}
        for k, pair in enumerate(problem.pairs):
            layouts[f"pair{k}", "multiplier"] = Layout.of(pair.multiplier.field.function_space)
        return {array: layout.sizes[0] for array, layout in layouts.items()}

    def add(self, abscissa: float, afresh: bool = False) -> None:
        """A state has converged; choose the polynomial orders that would have predicted it well. Where a pair has touched or
        parted since the last one, or the bodies have leapt and all begins `afresh`, the states before say nothing of what
        comes; nor does one without stiffness, such as that of a flat membrane, from which displacements grow as a root of
        the load (collective)."""
        state = self.problem.snapshot()
        touching = self._touch()
        tautened = bool((self._slack & ~self.problem.slack).any())
        if self._states and (afresh or touching != self._touching or tautened):
            self._forget(keep=0)
        self._touching, self._slack = touching, self.problem.slack.copy()
        for array in self._order:
            self._order[array] = self._best_order(state, array, abscissa)
        self._abscissae, self._states = [*self._abscissae, abscissa], [*self._states, state]
        self._pressing.append([pair.pressing() for pair in self.problem.pairs])
        if len(self._states) > MAX_ORDER + 1:
            del self._abscissae[0], self._states[0], self._pressing[0]
            self._guesses = 0

    def torn_off(self, abscissa: float) -> list[bool]:
        """Of each pair, whether it touched in the last state and does not now, at an abscissa, though its force was not on
        its course to zero (collective)."""
        lost = [before and not now for before, now in zip(self._touching, self._touch(), strict=True)]
        if len(self._states) < 2:
            return lost
        (x, y), (earlier, last) = self._abscissae[-2:], self._pressing[-2:]
        beyond = (abscissa - y) / (y - x)
        return [gone and b + (b - a) * beyond > 0.0 for gone, a, b in zip(lost, earlier, last, strict=True)]

    def _touch(self) -> list[bool]:
        """Of each pair, whether anything is in contact (collective)."""
        return [pair.closed_fraction() > 0.0 for pair in self.problem.pairs]

    def turn(self, scale: float) -> None:
        """From here on the abscissa is another: 0 at the last state and `scale` times the distances there were; 0 where
        loading takes another direction, in which the states before say nothing of what comes."""
        if scale <= 0.0 and len(self._states) > 1:
            self._forget(keep=1)
        self._abscissae = [scale * (x - self._abscissae[-1]) for x in self._abscissae]

    def _forget(self, keep: int) -> None:
        """All but the last `keep` states."""
        last = len(self._states) - keep
        del self._abscissae[:last], self._states[:last], self._pressing[:last]
        self._guesses = 0
        self._order = dict.fromkeys(self._order, 1)

    def restore(self) -> None:
        """Undo: back to the last converged state."""
        self.problem.restore(self._states[-1])

    @property
    def extrapolates(self) -> bool:
        """Whether there is a direction to extrapolate in."""
        return len(self._states) > 1

    def predict(self, abscissa: float) -> None:
        """Displacement and multipliers extrapolated to an abscissa; and λ̂_N, which says what points to expect closed,
        linearly and half the way only: too much closed costs more iterations than too little (docs/newton.md). The last
        state itself, where an extrapolated one has inverted cells."""
        self._states[-1]["loads"] = self.problem.loads.snapshot()  # the caller may have moved others since
        if len(self._states) < 2:
            self.restore()
            return
        problem, order = self.problem, self._order
        predicted = {name: dict(member) for name, member in self._states[-1].items()}
        for array in order:
            predicted[array[0]][array[1]] = self._extrapolated(array, abscissa, order[array])
        problem.bodies.restore(predicted["bodies"])
        if problem.inverted_volume() > 0:
            self.restore()
            return
        if len(self._states) - self._guesses > 1:
            for name in (name for name, _ in order if name != "bodies"):
                half = (abscissa + self._abscissae[-1]) / 2
                predicted[name]["points_λN_hat"] = self._extrapolated((name, "points_λN_hat"), half, 1)
        problem.restore(predicted)

    def _extrapolated(self, array: tuple[str, str], abscissa: float, order: int) -> NDArray[np.float64]:
        """An array of the last order + 1 snapshots, extrapolated to an abscissa by Lagrange's polynomial."""
        x = np.array(self._abscissae[-order - 1 :])
        weights = np.array([np.prod([(abscissa - b) / (a - b) for b in x if b != a]) for a in x])
        member, name = array
        return np.asarray(weights @ np.stack([state[member][name] for state in self._states[-len(x) :]]))

    def _best_order(self, state: Snapshot, array: tuple[str, str], abscissa: float) -> int:
        """The order that would have predicted `state` best; a higher one only where it is BETTER times as good."""
        member, name = array
        best, least = 1, np.inf
        for order in range(1, min(MAX_ORDER + 1, len(self._states))):
            miss = (state[member][name] - self._extrapolated(array, abscissa, order))[: self._owned[array]]
            size = np.sqrt(sum_over(self.problem.comm, float(miss @ miss)))
            if size * BETTER < least:
                best, least = order, size
        return best
