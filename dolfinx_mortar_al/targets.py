"""The target's side of a contact pair: a deformable surface, or a rigid obstacle without unknowns.

Both answer the same questions: what does a contactor point face, where is a material point now, which unknowns move it. A
rigid obstacle has no nodes, so that every array over target nodes is empty; it is projected onto in closed form.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.closest_point import ClosestPoint, project
from dolfinx_mortar_al.obstacles import Obstacle, Pose
from dolfinx_mortar_al.projection import Projection, TargetPoint, combine
from dolfinx_mortar_al.rays import Hits, RayHit, cast, extend
from dolfinx_mortar_al.search import CandidateSearch, RaySearch, candidates, ray_candidates
from dolfinx_mortar_al.surface import Facets, Surface

__all__ = ["ContactorPoints", "DeformableTarget", "Place", "RigidTarget", "Target", "target_of"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

IN_PLANE = 1e-6  # of a facet: nodes that near a plane lie in it
#: present positions (nodes, gdim) of a deformable target's nodes (m), or a rigid one's pose
Place = Array | Pose


@dataclass(frozen=True)
class ContactorPoints:
    """Where n contactor points are now.

    Attributes:
        x: (n, gdim) positions (m); normal: (n, gdim) outward unit normals; tangents: (n, dim, gdim) 𝐚₁_α (m).
        facet: (n,) of this rank's contactor facets, the one each lies on; η: (n, dim) where on it.
    """

    x: Array
    normal: Array
    tangents: Array
    facet: Index
    η: Array

    def at(self, which: Index) -> ContactorPoints:
        """Some of them."""
        return ContactorPoints(
            self.x[which], self.normal[which], self.tangents[which], self.facet[which], self.η[which]
        )


class Target(ABC):
    """What a contact pair needs to know of its target.

    Attributes:
        facets: (nf, k) nodes of each facet, indices into `blocks`; neighbours: (nf, m) facets that share a side with each.
        blocks: (nodes,) numbers of the target's nodes among all bodies'.
        fixed: (nodes, gdim) whether a component is prescribed; end_nodes: (nodes,) whether a node lies on an end.
        size: largest diameter of a facet (m), the length by which gaps are judged; reach: of an obstacle, the length that its
            surface is computed with (m), 0 for bodies.
        extents: (nf,) reference area of each facet to the power 1/dim (m), infinite for an obstacle; widths: (nf,) the
            same, or less of facets that are longer than wide.
        spacing: of neighbouring nodes, in extents.
        dim: of the surface; is_rigid: whether it is an obstacle; uses_rays: whether it is projected onto along the
            contactor's normals.
    """

    facets: Index
    neighbours: Index
    blocks: Index
    fixed: NDArray[np.bool_]
    end_nodes: NDArray[np.bool_]
    size: float
    reach = 0.0
    extents: Array
    widths: Array
    spacing: float
    dim: int
    uses_rays: bool
    is_rigid = False

    @abstractmethod
    def refresh(self) -> None:
        """Take up the present displacements or pose (collective)."""

    @abstractmethod
    def project(self, points: ContactorPoints, place: Place | None = None) -> Projection:
        """What the points face on the target as it is now, or was at another place. Facets near them are kept for the next
        time."""

    @abstractmethod
    def closest(self, x: Array) -> ClosestPoint:
        """The target's closest points to 𝐱 (n, gdim), whether they are faced or not."""

    @abstractmethod
    def distances(self, x: Array, place: Place) -> Array:
        """(n,) from positions 𝐱 (n, gdim) to the target when it is, or was, at a place (m)."""

    @abstractmethod
    def faced(self, points: ContactorPoints, nodes: Array) -> tuple[TargetPoint, NDArray[np.bool_]]:
        """Material points that `points` face, or else the closest ones, with the target's nodes at `nodes` (m); (n,) which
        are faced."""

    #: whether the contactor is the target itself
    is_contactor = False

    def admits(self, facet: Index, at: TargetPoint) -> NDArray[np.bool_]:
        """(n,) whether points on the contactor's facets `facet` (n,) may touch the target at the points `at` they face."""
        return np.ones(len(facet), dtype=bool)

    @property
    @abstractmethod
    def nodes(self) -> Array:
        """(nodes, gdim) where its nodes are now (m)."""

    @abstractmethod
    def weights(self, point: TargetPoint) -> Array:
        """(n, k) shape functions of the target's nodes at material points."""

    @abstractmethod
    def derivatives(self, point: TargetPoint) -> Array:
        """(n, dim, k) derivatives N,α of the shape functions at material points."""

    def tangents(self, point: TargetPoint, derivatives: Array, nodes: Array | None = None) -> Array:
        """(n, dim, gdim) tangents 𝐚_α at material points now, or with its nodes elsewhere (m)."""
        nodes = self.nodes if nodes is None else nodes
        return np.asarray(derivatives @ nodes[self.facets[point.facet]])

    @abstractmethod
    def positions(self, point: TargetPoint, weights: Array, place: Place | None = None) -> Array:
        """(n, gdim) where material points are now, φ₂(Y, t), or were."""

    @property
    @abstractmethod
    def place(self) -> Place:
        """Where the target is now, to hand to :meth:`project` and :meth:`positions` later."""

    @abstractmethod
    def is_at(self, place: Place) -> bool:
        """Whether it has not moved from there."""

    @abstractmethod
    def stiffness(self, diagonals: Sequence[fem.Function], thickness: float) -> float:
        """Mean nodal stiffness per area (Pa/m), from the diagonals (N/m) of the bodies' matrices."""


class DeformableTarget(Target):
    """A surface of a body or membrane, whole on every rank; only its positions travel."""

    def __init__(self, surface: Surface, bodies: Bodies, uses_rays: bool) -> None:
        k = bodies.index(surface.mesh)
        self._body = bodies.bodies[k]
        self.surface = Facets.of(surface, self._body.space).gather()
        self.uses_rays = uses_rays
        self._near, self._on_rays = CandidateSearch(self.surface), RaySearch(self.surface)
        self.facets, self.neighbours = self.surface.facets, self.surface.neighbours
        self.blocks, self.end_nodes = bodies.common(k, self.surface.blocks), self.surface.end_nodes
        self.size, self.dim = self.surface.size_of_facets, self.surface.shape.dim
        self.extents, self.spacing = self.surface.extents(), self.surface.shape.spacing
        self.widths = self.surface.widths()
        self._gdim = bodies.gdim
        where = PETSc.IS().createBlock(self._gdim, self.surface.blocks.astype(np.int32), comm=PETSc.COMM_SELF)
        self._vec = PETSc.Vec().createSeq(len(self.surface.blocks) * self._gdim)
        self._scatter = PETSc.Scatter().create(self._body.u.x.petsc_vec, where, self._vec, None)
        self.fixed = self.at_nodes(self._body.prescribed()) > 0
        self.refresh()

    def at_nodes(self, u: fem.Function) -> Array:
        """(nodes, gdim) values of a Function of the target's body at its nodes (collective)."""
        self._scatter.scatter(u.x.petsc_vec, self._vec)
        return np.asarray(self._vec.array_r.reshape(-1, self._gdim).copy())

    def is_of(self, u: fem.Function) -> bool:
        """Whether u is a Function of the target's body."""
        return u.function_space is self._body.space

    def refresh(self) -> None:
        self._nodes = self.surface.X + self.at_nodes(self._body.u)

    @property
    def place(self) -> Place:
        return self._nodes

    def is_at(self, place: Place) -> bool:
        return isinstance(place, np.ndarray) and np.array_equal(place, self._nodes)

    @property
    def nodes(self) -> Array:
        return self._nodes

    def project(self, points: ContactorPoints, place: Place | None = None) -> Projection:
        nodes = self._nodes if place is None else place
        assert isinstance(nodes, np.ndarray)
        if not self.uses_rays:
            return project(self.surface, nodes, points.x, self._near(points.x, nodes))
        return self._cast(points, nodes, self._on_rays(points.x, points.normal, nodes))

    def _cast(self, points: ContactorPoints, nodes: Array, couples: tuple[Index, Index]) -> RayHit:
        """What the points' rays meet of the facets in `couples`, with the target's nodes at `nodes` (m)."""
        x, normal, counts = points.x, points.normal, self.counts(points)
        return cast(self.surface, nodes, x, normal, points.tangents, couples, counts)

    def counts(self, points: ContactorPoints) -> Callable[[Hits], NDArray[np.bool_]] | None:
        """Which hits of the points' rays (m,) count; None for those that closest points confirm where they are deep."""
        return None

    def opposite(self, points: ContactorPoints, nodes: Array) -> tuple[TargetPoint, NDArray[np.bool_]]:
        """What contactor points face of the target with its nodes at `nodes` (nodes, gdim) in metres, and (n,) whether it is
        near enough to count."""
        at = self._closest(points.x, nodes)
        return at.point, np.linalg.norm(points.x - at.y, axis=1) <= self.size

    def holds_plane(self, X: Array) -> NDArray[np.bool_]:
        """(n, gdim) whether a component is prescribed at all of the target's nodes that have the same reference coordinate
        along it as a point X (n, gdim), and there are any: in a plane of symmetry or of a slice."""
        held, slack = np.zeros(X.shape, dtype=bool), IN_PLANE * self.size
        for i in range(X.shape[1]):
            order = np.argsort(self.surface.X[:, i])
            free = np.concatenate([[0], np.cumsum(~self.fixed[order, i])])
            first, end = (np.searchsorted(self.surface.X[order, i], X[:, i] + way) for way in (-slack, slack))
            held[:, i] = (end > first) & (free[end] == free[first])
        return held

    def project_once(self, points: ContactorPoints, nodes: Array) -> RayHit:
        """As :meth:`project` with rays and the target's nodes at `nodes` (m), of points that do not come back."""
        return self._cast(points, nodes, ray_candidates(points.x, points.normal, nodes[self.facets], 0.0))

    def faced(self, points: ContactorPoints, nodes: Array) -> tuple[TargetPoint, NDArray[np.bool_]]:
        at = self.project_once(points, nodes)
        lost = np.flatnonzero(~at.facing)
        if len(lost):
            near = self._closest(points.x[lost], nodes).point
            at.point.facet[lost], at.point.η[lost] = near.facet, near.η
        return at.point, at.facing

    def extend(self, at: RayHit, points: ContactorPoints, which: Index) -> Index:
        """Let points `which` (m,), which face nothing, face the facet nearest to each, or a neighbour of it, as it goes on
        beyond the target's end; returns those that do."""
        near = self.neighbours[self.closest(points.x[which]).point.facet]
        return extend(at, self.surface, self._nodes, points.x, which, near)

    def closest(self, x: Array) -> ClosestPoint:
        return self._closest(x, self._nodes)

    def distances(self, x: Array, place: Place) -> Array:
        assert isinstance(place, np.ndarray)
        return np.asarray(np.linalg.norm(x - self._closest(x, place).y, axis=1))

    def _closest(self, x: Array, nodes: Array) -> ClosestPoint:
        return project(self.surface, nodes, x, candidates(x, nodes[self.facets], 0.0))

    def crossable(self, points: ContactorPoints, which: Index) -> Callable[[Index, Index], NDArray[np.bool_]] | None:
        """Whether points out of `which` (m,) must not pass through facets: a function of both; None if none may."""
        return None

    def at_reference(self, X: Array) -> ClosestPoint:
        """The closest-point map of reference points onto the reference target."""
        return self._closest(X, self.surface.X)

    def weights(self, point: TargetPoint) -> Array:
        return self.surface.shape.tabulate(point.η)[0]

    def derivatives(self, point: TargetPoint) -> Array:
        return self.surface.shape.tabulate(point.η, 1)[1]

    def bends(self, point: TargetPoint) -> Array:
        """(n, dim, dim, gdim) 𝐚_α,β at material points now."""
        second = self.surface.shape.tabulate(point.η, 2)[2]
        return np.einsum("nabk,nki->nabi", second, self._nodes[self.facets[point.facet]])

    def positions(self, point: TargetPoint, weights: Array, place: Place | None = None) -> Array:
        nodes = self._nodes if place is None else place
        assert isinstance(nodes, np.ndarray)
        return combine(weights, nodes[self.facets[point.facet]])

    def stiffness(self, diagonals: Sequence[fem.Function], thickness: float) -> float:
        own = next(d for d in diagonals if d.function_space is self._body.space)
        k = self.at_nodes(own)[self.facets].mean(axis=(1, 2))
        return float(np.mean(k / (self.surface.areas() * thickness)))


class RigidTarget(Target):
    """A rigid obstacle; `size` is that of the contactor's facets."""

    is_rigid = True

    def __init__(self, obstacle: Obstacle, gdim: int, size: float) -> None:
        if obstacle.gdim != gdim:
            raise ValueError(f"target: an obstacle in {obstacle.gdim} dimensions for bodies in {gdim}")
        self.obstacle, self.size, self.dim, self.reach = obstacle, size, gdim - 1, obstacle.reach
        self.facets, self.neighbours = np.zeros((1, 0), dtype=np.int64), np.zeros((1, 1), dtype=np.int64)
        self.blocks, self.end_nodes = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
        self.fixed = np.zeros((0, gdim), dtype=bool)
        self.uses_rays, self.spacing = False, 1.0
        self.extents = self.widths = np.full(1, np.inf)

    def refresh(self) -> None:
        pass

    @property
    def place(self) -> Place:
        return self.obstacle.pose

    def is_at(self, place: Place) -> bool:
        return isinstance(place, Pose) and place == self.obstacle.pose

    @property
    def nodes(self) -> Array:
        return np.zeros((0, self.fixed.shape[1]))

    def faced(self, points: ContactorPoints, nodes: Array) -> tuple[TargetPoint, NDArray[np.bool_]]:
        at = self.obstacle.project(points.x)
        return at.point, at.facing

    def project(self, points: ContactorPoints, place: Place | None = None) -> Projection:
        return self.obstacle.project(points.x)

    def closest(self, x: Array) -> ClosestPoint:
        return self.obstacle.project(x)

    def distances(self, x: Array, place: Place) -> Array:
        assert isinstance(place, Pose)
        moved = self.obstacle.carried(x, place)
        return np.asarray(np.linalg.norm(moved - self.obstacle.project(moved).y, axis=1))

    def weights(self, point: TargetPoint) -> Array:
        return np.zeros((len(point.facet), 0))

    def derivatives(self, point: TargetPoint) -> Array:
        return np.zeros((len(point.facet), self.dim, 0))

    def positions(self, point: TargetPoint, weights: Array, place: Place | None = None) -> Array:
        assert place is None or isinstance(place, Pose)
        return self.obstacle.positions(point.η, place)

    def stiffness(self, diagonals: Sequence[fem.Function], thickness: float) -> float:
        return np.inf


def target_of(target: Surface | Obstacle, bodies: Bodies, size: float, uses_rays: bool) -> Target:
    """The target of a contact description; `size`: of the contactor's facets (m)."""
    if isinstance(target, Obstacle):
        return RigidTarget(target, bodies.gdim, size)
    return DeformableTarget(target, bodies, uses_rays)
