"""What the law needs to know of a pair's points: positions, projection, slip, and their variation.

Two strategies of one interface: :class:`PositionLevel` (statics: gap and slip of the present positions) and
:class:`VelocityLevel` (Moreau's scheme: gap and slip are Δt × relative velocities on a frozen geometry).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.projection import Projection, TargetPoint
from dolfinx_mortar_al.targets import ContactorPoints, Target
from dolfinx_mortar_al.variation import Slots, Variation, vary, vary_frozen

__all__ = ["Kinematics", "PositionLevel", "VelocityLevel", "contactor_points"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]


class Kinematics(ABC):
    """A pair's points as they move.

    Args:
        points: of integration on the contactor.
        u: displacement of the contactor's body; ghosts are up to date.
        target: what the points face.
        friction: whether a slip is kept.

    Attributes:
        x: (n, gdim) contactor points now (m); at: what they face; s: (n, gdim) slip increment (m), None without friction.
        may_close: (n,) points that contact may take part in at all.
        touch: gaps below are round-off (m).
    """

    x: Array
    at: Projection
    s: Array | None
    may_close: Bool

    def __init__(self, points: IntegrationPoints, u: fem.Function, target: Target, friction: bool) -> None:
        self.points, self.target, self.friction = points, target, friction
        self.touch = 1e-12 * target.size
        self._u = u
        self.history = TargetPoint(np.zeros(points.size, dtype=np.int64), np.zeros((points.size, points.η.shape[1])))

    # ---------------------------------------------------------------- where the contactor is

    def nodes(self) -> Array:
        """(nf, nodes, gdim) present positions of the contactor's facets' nodes (m)."""
        facets = self.points.facets
        return np.asarray(facets.X + self._u.x.array.reshape(-1, facets.X.shape[2])[facets.dofs])

    def positions(self) -> Array:
        """(n, gdim) present positions of the points (m)."""
        return self.points.interpolate(self.nodes())

    def contactor(self) -> ContactorPoints:
        """The points with the contactor's normals and tangents, now."""
        return contactor_points(self.points, self.nodes())

    # ---------------------------------------------------------------- the present state

    @abstractmethod
    def evaluate(self) -> None:
        """Bring x, at and s up to date with the displacements."""

    @abstractmethod
    def vary(self, act: Index, slots: Slots) -> Variation:
        """Variation of gap, normal and slip at the points `act`."""

    # ---------------------------------------------------------------- slip history

    def take(self, points: IntegrationPoints, contactor: Array, target: Array) -> None:
        """Other points from now on. What they faced when the last step had converged is found anew, with the nodes of
        contactor (nf, nodes, gdim) and target (nodes, gdim) where they were then (m): history belongs to the bodies, not to
        the points."""
        self.points = points
        if self.friction:
            self.set_history(self.target.faced(contactor_points(points, contactor), target))
        else:
            self.history = TargetPoint(np.zeros(points.size, dtype=np.int64), np.zeros_like(points.η))

    def commit(self) -> None:
        """The step has converged: Y_{n−1} ← Y."""
        point = self.at.point.copy()
        lost = np.flatnonzero(~self.at.facing)
        if self.friction and len(lost):  # the slip of what comes back is counted from the nearest point
            near = self.target.closest(self.x[lost]).point
            point.facet[lost], point.η[lost] = near.facet, near.η
        self.set_history(point)

    def set_history(self, point: TargetPoint) -> None:
        """Count the slip from these material points of the target."""
        self.history = point
        self.weights: Array = self.target.weights(point)

    def positions_of_history(self) -> Array:
        """(n, gdim) where the points Y_{n−1} are now, φ₂(Y_{n−1}, t) (m)."""
        return self.target.positions(self.history, self.weights)


def contactor_points(points: IntegrationPoints, nodes: Array) -> ContactorPoints:
    """Integration points with the contactor's normals and tangents, its nodes at `nodes` (nf, nodes, gdim)."""
    tangents = points.tangents(nodes)
    normal = points.normals(tangents)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return ContactorPoints(points.interpolate(nodes), normal, tangents)


class PositionLevel(Kinematics):
    """Gap and slip of the present positions: eq. (1) as it stands."""

    def evaluate(self) -> None:
        self.target.refresh()
        now = self.contactor()
        self.x, self.at = now.x, self.target.project(now)
        self.may_close = self.at.facing
        self.s = self.slip() if self.friction else None

    def slip(self) -> Array:
        """s = V_T Δt, eq. (5): (n, gdim) in m, of which only the tangential part counts. From 𝐲 − φ₂(Y_{n−1}, t) with the
        closest point; with rays from 𝐱 − φ₂(Y_{n−1}, t), whose tangential part is the same."""
        here = self.x if self.target.uses_rays else self.at.y
        return here - self.positions_of_history()

    def vary(self, act: Index, slots: Slots) -> Variation:
        return vary(self.at.take(act), slots)


class VelocityLevel(Kinematics):
    """Contact between velocities, for Moreau's scheme, on the geometry of a time step.

    With the predictor 𝐮_m = 𝐮_n + (1−θ)Δt 𝐯_n the θ-scheme says Δt 𝐯_{n+1} = (𝐮_{n+1} − 𝐮_m)/θ. Points that touch at 𝐮_m
    have eq. (1) with Δt × the relative velocity in place of gap and slip; all others are open. Projection and normals are
    those of 𝐮_m and do not move within the step.
    """

    def __init__(self, before: Kinematics, θ: float) -> None:
        super().__init__(before.points, before._u, before.target, before.friction)
        self.x, self.at, self.s, self.may_close = before.x, before.at, before.s, before.may_close
        self.set_history(before.history)
        self.θ, self.step, self._x = θ, before.at, before.x

    def predict(self) -> None:
        """Take the step's geometry from the present (predicted) positions."""
        self.target.refresh()
        now = self.contactor()
        self.step, self._x = self.target.project(now), now.x
        self.may_close = self.step.facing & (self.step.g >= -self.touch)
        self.at = self.step
        self.set_history(self.step.point)

    def moving_points(self) -> tuple[Array, Array]:
        """Contactor points (n, gdim) and the step's target points (n, gdim), where they are now (m)."""
        self.target.refresh()
        return self.positions(), self.target.positions(self.step.point, self.step.N)

    def evaluate(self) -> None:
        self.x, y = self.moving_points()
        motion: Array = np.asarray(((self.x - self._x) - (y - self.step.y)) / self.θ, dtype=np.float64)
        self.at = replace(self.step, g=-np.einsum("ni,ni->n", self.step.ν, motion))
        self.s = motion if self.friction else None

    def vary(self, act: Index, slots: Slots) -> Variation:
        return vary_frozen(self.at.take(act), slots, self.θ)
