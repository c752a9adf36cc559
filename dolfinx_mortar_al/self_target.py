"""A surface that is its own target (``docs/self_contact.md``).

A point's ray leaves its facet and its neighbours on the side that they face, so that a hit in front of the point, whose
normal opposes the ray, is another part of the surface. Behind the point the ray runs through the point's own body: what it
meets nearer than the body's far side is an overlap, the far side itself is not. So hits behind count up to half the
thickness of the body there, as it is now; and not where the way to them has been through the body from the start, as to
a hole beside a thick part of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import mesh
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.projection import Projection, TargetPoint, combine, dot
from dolfinx_mortar_al.rays import DEEP, Hits, hits
from dolfinx_mortar_al.roles import assign, precedes
from dolfinx_mortar_al.search import ray_candidates
from dolfinx_mortar_al.surface import Facets, GatheredFacets, Surface, surface_normal
from dolfinx_mortar_al.targets import ContactorPoints, DeformableTarget

__all__ = ["SelfTarget"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

# of the thickness: an overlap is less than the body's far side away, however that moves in an iteration; of the length of
# what lies between two points: less, or as little of it now, is no stretch that matter is expected to bear; of the cell
# behind a facet: nearer than that the undeformed body has no far side, and what lies there overlaps it
HALF = 0.5


class SelfTarget(DeformableTarget):
    """The target's side of a surface in contact with itself.

    Args:
        surface: the surface.
        facets: it, as this rank owns it.
        bodies: of the problem.

    Attributes:
        role: (nf,) of all its facets, 0 for contactor, 1 for target, as `roles.py` says.
        own: (own nf,) which of all facets this rank's are.
    """

    is_contactor = True

    def __init__(self, surface: Surface, facets: Facets, bodies: Bodies) -> None:
        self._thickness: _Thickness | None = None
        super().__init__(surface, bodies, uses_rays=True)
        self.own = self.surface.places_of(facets)
        self.role: Index = np.zeros(len(self.facets), dtype=np.int64)
        self._own_nodes, self._own_orientation = facets.X, facets.orientation
        self._least = np.zeros(0) if surface.is_membrane else HALF * facets.cell_depths()
        self._depth: Array = np.full(facets.size, DEEP * self.size)  # of a membrane, which has no thickness
        if not surface.is_membrane:
            self._thickness = _Thickness(surface.mesh, facets, bodies, self._least)
            self.refresh()

    def refresh(self) -> None:
        super().refresh()
        if self._thickness is not None:
            self._depth = HALF * self._thickness.now(self._body.u.x.array)

    def counts(self, points: ContactorPoints) -> Callable[[Hits], Bool]:
        def counts(found: Hits) -> Bool:
            near = found.d >= -self._depth[points.facet[found.row]]
            if self._thickness is not None:
                behind = np.flatnonzero(near & (found.d < 0.0))
                near[behind] = ~self._is_far_side(points, found.take(behind))
            return np.asarray(near)

        return counts

    def _is_far_side(self, points: ContactorPoints, found: Hits) -> Bool:
        """(m,) hits behind points with the body's own matter in between: in the undeformed body the one lies behind the
        other, and about as far away as now, but no nearer than the body has cells for."""
        nodes = self._own_nodes[points.facet[found.row]]
        N, dN = self.surface.shape.tabulate(points.η[found.row], 1)
        inward = -surface_normal(dN @ nodes) * self._own_orientation[points.facet[found.row], None]
        way = combine(found.N, self.surface.X[self.facets[found.facet]]) - combine(N, nodes)
        length = np.linalg.norm(way, axis=1)
        into = dot(way, inward) >= HALF * length * np.linalg.norm(inward, axis=1)
        into &= length >= self._least[points.facet[found.row]]
        return np.asarray(into & (-found.d >= HALF * length) & (HALF * -found.d <= length))

    def opposite(self, points: ContactorPoints, nodes: Array) -> tuple[TargetPoint, Bool]:
        return self.faced(points, nodes)

    def admits(self, facet: Index, at: TargetPoint) -> Bool:
        return precedes(self.role, self.own[facet], at.facet)

    def crossable(self, points: ContactorPoints, which: Index) -> Callable[[Index, Index], Bool]:
        """Facets that a point is contactor of and that oppose its normal: a surface does not pass through itself nearby."""
        middle = self.surface.shape.tabulate(self.surface.shape.corners.mean(axis=0)[None], 1)[1][0]
        m = surface_normal(middle @ self.nodes[self.facets]) * self.surface.orientation[:, None]
        own, normal = self.own[points.facet[which]], points.normal[which]

        def counts(point: Index, facet: Index) -> Bool:
            result: Bool = precedes(self.role, own[point], facet) & (dot(m[facet], normal[point]) < 0)
            return result

        return counts

    def divide(self, facet: Index, at: Projection, closed: Bool, comm: MPI.Intracomm) -> bool:
        """Give the facets their roles for what the points on `facet` (n,) face now; couples with `closed` points keep theirs.
        Whether any has changed (collective)."""
        seen = np.flatnonzero(at.facing & (self.own[facet] != at.point.facet))
        key = self.own[facet[seen]] * len(self.facets) + at.point.facet[seen]
        couple, inverse = np.unique(key, return_inverse=True)
        gap, holds = np.full(len(couple), np.inf), np.zeros(len(couple), dtype=bool)
        np.minimum.at(gap, inverse, np.abs(at.g[seen]))
        np.logical_or.at(holds, inverse, closed[seen])
        couple, gap, holds = (np.concatenate(comm.allgather(mine)) for mine in (couple, gap, holds))
        couples = np.stack(np.divmod(couple, len(self.facets)), axis=1)
        held = np.zeros(len(self.facets), dtype=bool)
        held[couples[holds].ravel()] = True
        before = self.role
        self.role = assign(couples, gap, self.size, self.neighbours, self.extents, before, held)
        return not np.array_equal(before, self.role)


class _Thickness:
    """How far the body reaches behind each facet of a contact surface: the distance of a few points of the facet from the
    material points straight behind them, on the far side of the undeformed body, at `least` (nf,) so far behind (m)."""

    def __init__(self, domain: mesh.Mesh, facets: Facets, bodies: Bodies, least: Array) -> None:
        domain.topology.create_connectivity(domain.topology.dim - 1, domain.topology.dim)
        outer = mesh.exterior_facet_indices(domain.topology)
        tags = mesh.meshtags(domain, domain.topology.dim - 1, np.sort(outer), np.ones(len(outer), dtype=np.int32))
        self._far = DeformableTarget(Surface(domain, tags, 1), bodies, uses_rays=False)
        self._facets = facets
        self._η = facets.shape.quadrature(2 * facets.shape.order)[0]
        self._N, self._dN = facets.shape.tabulate(self._η, 1)
        x, normal = self._points(facets.X)
        self._behind, self._found = _far_side(self._far.surface, x, normal, np.repeat(least, len(self._η)))
        self._weights = self._far.weights(self._behind)

    def _points(self, nodes: Array) -> tuple[Array, Array]:
        """Positions and outward unit normals (nf × points, gdim) of the points, with the facets' nodes (nf, k, gdim)."""
        d = nodes.shape[2]
        normal = surface_normal(np.einsum("qak,fki->fqai", self._dN, nodes)) * self._facets.orientation[:, None, None]
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        return (self._N @ nodes).reshape(-1, d), normal.reshape(-1, d)

    def now(self, u: Array) -> Array:
        """(nf,) the least thickness behind each facet at the displacements u (m), collective."""
        self._far.refresh()
        d = self._facets.X.shape[2]
        x, normal = self._points(self._facets.X + u.reshape(-1, d)[self._facets.dofs])
        thickness = -dot(self._far.positions(self._behind, self._weights) - x, normal)
        thickness = np.where(self._found, np.maximum(thickness, 0.0), np.inf)
        return np.asarray(thickness.reshape(-1, len(self._η)).min(axis=1, initial=np.inf))


def _far_side(outer: GatheredFacets, x: Array, normal: Array, least: Array) -> tuple[TargetPoint, Bool]:
    """Where the rays from 𝐱 (n, gdim) against `normal` leave the undeformed body through its boundary, at `least` (n,) so far
    behind (m): what is nearer overlaps. And (n,) whether one was found."""
    nodes = outer.X[outer.facets]
    found = hits(outer.shape, nodes, x, normal, *ray_candidates(x, normal, nodes, 0.0))
    found = found.take(found.d < -least[found.row])
    order = np.lexsort([-found.d, found.row])
    first = found.take(order[np.r_[True, np.diff(found.row[order]) > 0]] if len(order) else order)
    point = TargetPoint(np.zeros(len(x), dtype=np.int64), np.zeros((len(x), outer.shape.dim)))
    leaves = np.zeros(len(x), dtype=bool)
    leaves[first.row] = True
    point.facet[first.row], point.η[first.row] = first.facet, first.η
    return point, leaves
