"""Whether points lie in the body behind a surface, which may be thin and is only a part of the body's boundary."""

from __future__ import annotations

import numpy as np
from dolfinx import mesh
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.pieces import seen_by_any
from dolfinx_mortar_al.projection import dot
from dolfinx_mortar_al.rays import hits
from dolfinx_mortar_al.search import ray_candidates
from dolfinx_mortar_al.surface import Surface, surface_normal
from dolfinx_mortar_al.targets import DeformableTarget

__all__ = ["Inside"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

AT_SURFACE = 1e-6  # of a facet: what is crossed nearer than that to a line's ends are the surfaces that it joins

ANY_WAY = np.sqrt([2.0, 3.0, 5.0])  # along no edge or face of a mesh that was made with a purpose


class Inside:
    """The body behind a surface.

    Args:
        surface: of it.
        bodies: of the problem.
    """

    def __init__(self, surface: Surface, bodies: Bodies) -> None:
        self._surface, self._bodies = surface, bodies
        self._boundary: DeformableTarget | None = None  # is needed seldom

    def __call__(self, x: Array, y: Array) -> Bool:
        """(n,) whether 𝐱 (n, gdim), behind the surface's points 𝐲 (n, gdim) closest to them, lie in the body: whether the
        straight line from one to the other does not cross the body's present boundary, nor lies outside, as one that comes to
        the surface's rim from beyond its end. Never in a membrane (collective)."""
        if self._surface.is_membrane:
            return np.zeros(len(x), dtype=bool)
        boundary = self._present()
        length = np.linalg.norm(y - x, axis=1)
        along = (y - x) / np.maximum(length, 1e-300)[:, None]
        surface = boundary.surface
        nodes = boundary.nodes[surface.facets]
        found = hits(surface.shape, nodes, x, along, *ray_candidates(x, along, nodes, 0.0))
        slack = AT_SURFACE * surface.size_of_facets
        result = length > slack
        result[found.row[(found.d > slack) & (found.d < length[found.row] - slack)]] = False
        return result & self._is_enclosed(boundary, x)

    def _is_enclosed(self, boundary: DeformableTarget, x: Array) -> Bool:
        """(n,) whether a line from 𝐱 (n, gdim) leaves the body once more than it enters it."""
        surface, nodes = boundary.surface, boundary.nodes[boundary.surface.facets]
        way = np.tile(ANY_WAY[: x.shape[1]] / np.linalg.norm(ANY_WAY[: x.shape[1]]), (len(x), 1))
        found = hits(surface.shape, nodes, x, way, *ray_candidates(x, way, nodes, 0.0))
        m = surface_normal(found.dN @ nodes[found.facet]) * surface.orientation[found.facet, None]
        leaves = np.where(found.d > 0.0, np.sign(dot(m, way[found.row])), 0.0)
        return np.asarray(np.bincount(found.row, leaves, minlength=len(x)) > 0.0)

    def may_be(self, x: Array) -> Bool:
        """(n,) whether 𝐱 (n, gdim) lie in the box round the body, without which they are not in it (collective)."""
        if self._surface.is_membrane:
            return np.zeros(len(x), dtype=bool)
        nodes = self._present().nodes
        return np.asarray(((x >= nodes.min(axis=0)) & (x <= nodes.max(axis=0))).all(axis=1))

    def _present(self) -> DeformableTarget:
        """The body's boundary as it is now (collective)."""
        if self._boundary is None:
            self._boundary = DeformableTarget(self._outer(), self._bodies, uses_rays=False)
        self._boundary.refresh()
        return self._boundary

    def _outer(self) -> Surface:
        """The whole boundary of the connected pieces that the surface belongs to (collective)."""
        domain = self._surface.mesh
        topology, d = domain.topology, domain.topology.dim
        body = self._bodies.bodies[self._bodies.index(domain)]
        topology.create_connectivity(d - 1, d)
        cell_of = topology.connectivity(d - 1, d)

        def pieces(facets: NDArray[np.int32]) -> NDArray[np.int64]:
            cells = cell_of.array[cell_of.offsets[facets]]
            return np.asarray(body.piece[body.space.dofmap.list[cells][:, 0]])

        behind = seen_by_any(domain.comm, pieces(self._surface.owned_facets()))
        outer = np.sort(mesh.exterior_facet_indices(topology))
        outer = outer[np.isin(pieces(outer), behind)]
        return Surface(domain, mesh.meshtags(domain, d - 1, outer, np.ones(len(outer), dtype=np.int32)), 1)
