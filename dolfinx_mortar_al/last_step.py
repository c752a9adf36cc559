"""What slip is counted from where points have moved since the last step: history belongs to the bodies, not to the points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.projection import TargetPoint

__all__ = ["LastStep"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class LastStep:
    """How the last step ended, at the points that it ended with.

    Attributes:
        points: n of them.
        history: (n,) the target's points Y_{n−1} that slip is counted from; ρ: (n, gdim) what they were apart then, in the
            target's frame.
        owed: (n, gdim) the slip (m) from there.
        stuck: (n,) which stick, and keep the Y_{n−1} and ρ from which they do.
    """

    points: IntegrationPoints
    history: TargetPoint
    ρ: Array
    owed: Array
    stuck: Bool

    @classmethod
    def none(cls, points: IntegrationPoints, history: TargetPoint, ρ: Array) -> LastStep:
        """Before the first one."""
        return cls(points, history, ρ, np.zeros_like(ρ), np.zeros(points.size, dtype=bool))

    def owed_at(self, points: IntegrationPoints, which: Index | None = None) -> Array:
        """(n, gdim) what is `owed` at other points, or at some of them: between those that it is known of, as the nearest of
        them may change with the last digit of where points are."""
        if points is self.points:
            return self.owed if which is None else self.owed[which]
        facet, η = (points.facet, points.η) if which is None else (points.facet[which], points.η[which])
        return self.points.between(self.owed, facet, η)

    def stuck_at(self, points: IntegrationPoints) -> Bool:
        """(n,) of other points, whether the nearest sticks."""
        return self.stuck if points is self.points else self.stuck[self.points.nearest(points.facet, points.η)]

    def kept_at(self, points: IntegrationPoints, moved: Index) -> tuple[Index, TargetPoint, Array]:
        """Which of the points `moved` lie where points stick, their Y_{n−1} and their ρ (n, gdim): in line with those of the
        stuck points on the same facet whose Y_{n−1} are on one facet of the target, too. With ones found anew from step to
        step, stuck bodies that are moved to and fro creep."""
        if not self.stuck.any():
            moved = moved[:0]
        near = self.points.nearest(points.facet[moved], points.η[moved])
        moved, near = moved[self.stuck[near]], near[self.stuck[near]]
        facet, η = points.facet[moved], points.η[moved]
        alike = np.where(self.stuck, self.history.facet, -1)
        fields = np.concatenate([self.history.η, self.ρ], axis=1)
        values, enough = self.points.in_line(fields, alike, alike[near], facet, η)
        keeps = np.flatnonzero(enough)
        dim = self.history.η.shape[1]
        return moved[keeps], TargetPoint(self.history.facet[near[keeps]], values[keeps, :dim]), values[keeps, dim:]
