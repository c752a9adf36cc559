"""Coulomb's law by Tresca's: friction bounds that are frozen, brought up to date, and freed (``docs/newton.md``).

With frozen bounds stick and slip do not cycle. A round solves with bounds b; the pressures that come of it ask for μp, and b
moves by θ (μp − b) until it stands still: a fixed point of Tresca's problems (C. Licht, E. Pratt and M. Raous, 1991). θ
follows Aitken's rule for vectors (B. M. Irons and R. C. Tuck, Int. J. Numer. Methods Engrg. 1, 1969): where a share ρ of the
last round's error is left along itself, θ ← θ/(1 − ρ). What swings (ρ < 0) is damped, what creeps (0 < ρ < 1)
extrapolated. Where errors grow along themselves (ρ > 1) the equilibrium that they leave is unstable, as friction makes the
pressure that makes it; Aitken's rule would lead back there, and θ is doubled: on to where the bodies come to rest.
"""

from __future__ import annotations

import numpy as np

from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import sum_over

__all__ = ["FrictionBounds"]

NEARLY = 0.05  # error of frozen bounds, as a share of the largest μp, below which they are freed,
NEARER = 0.1  # and, where they had to be frozen again, below this share of the error that they were freed with
FASTER = 2.0  # θ grows at most so much from round to round,
FARTHEST = 0.1  # and beyond one as long as no bound moves by more than this share of the largest μp


class FrictionBounds:
    """The friction bounds of a problem's pairs in a solve.

    Attributes:
        rounds: in this solve.
        leave: whether they have led away from an unstable equilibrium in this solve.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self._problem = problem
        self.begin()

    def begin(self) -> None:
        """A new solve, in which all are free."""
        self.rounds, self.leave, self._nearly, self._θ = 0, False, NEARLY, 1.0

    def freeze(self) -> bool:
        """Freeze the bounds that are free; whether there were any."""
        free = bool(self._problem.freeze_bounds())
        if free:
            self._θ = 1.0
        return free

    @property
    def error(self) -> float:
        """Largest difference between frozen bounds and μp, as a share of the largest μp (collective)."""
        pairs = self._problem.frozen_bounds
        return max([pair.active.staleness(pair.state, pair.friction_coefficient) for pair in pairs], default=0.0)

    def renew(self, error: float) -> None:
        """A state has converged in which they have an `error`: free them if they are nearly right, or bring them up to
        date (collective)."""
        pairs = self._problem.frozen_bounds
        self.rounds += 1
        if error < self._nearly:
            self._nearly = NEARER * error
            for pair in pairs:
                pair.active.thaw()
            return
        shares = [pair.active.compare_bounds(pair.state, pair.friction_coefficient) for pair in pairs]
        along, last = sum_over(self._problem.comm, np.sum(shares, axis=0))
        if last > 0.0:
            ρ = along / last
            self.leave |= bool(ρ > 1.0)
            self._θ *= FASTER if ρ > 1.0 - 1.0 / FASTER else 1.0 / (1.0 - ρ)
            self._θ = min(self._θ, max(1.0, FARTHEST / error))
        for pair in pairs:
            pair.active.move_bounds(self._θ)
