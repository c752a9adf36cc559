"""What lies beside a contact surface on its body's boundary, and is not named (``docs/robustness.md``)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import la, mesh
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.reductions import sum_over
from dolfinx_mortar_al.surface import Surface
from dolfinx_mortar_al.targets import DeformableTarget

__all__ = ["Beyond"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]


class Beyond:
    """The facets of a body's boundary that touch a surface and that no pair names.

    Args:
        surface: of the body, whole on every rank as `target`.
        bodies: of the problem.
        named: surfaces of all pairs.

    Attributes:
        X: (n, gdim) reference positions (m) of their nodes that are not the surface's.
        extent: (n,) of the largest of these facets that a node belongs to (m).
    """

    def __init__(self, surface: Surface, target: DeformableTarget, bodies: Bodies, named: Sequence[Surface]) -> None:
        self._facets: DeformableTarget | None = None
        self.X: Array = np.zeros((0, surface.mesh.geometry.dim))
        self.extent: Array = np.zeros(0)
        self._free: Bool = np.zeros(0, dtype=bool)
        near = None if surface.is_membrane else _beside(surface, named)
        if near is None:
            return
        self._facets = DeformableTarget(near, bodies, uses_rays=False)
        self._free = ~np.isin(self._facets.surface.blocks, target.surface.blocks)
        extent = np.zeros(len(self._free))
        for nodes in self._facets.facets.T:
            np.maximum.at(extent, nodes, self._facets.extents)
        self.X, self.extent = self._facets.surface.X[self._free], extent[self._free]

    def nodes(self) -> Array:
        """(n, gdim) where they are now (m, collective)."""
        if self._facets is None:
            return self.X
        self._facets.refresh()
        return self._facets.nodes[self._free]


def _beside(surface: Surface, named: Sequence[Surface]) -> Surface | None:
    """The facets of the boundary that share a vertex with a surface, but those that are named (collective)."""
    domain, fdim = surface.mesh, surface.mesh.topology.dim - 1
    domain.topology.create_connectivity(fdim, 0)
    of_facets = domain.topology.connectivity(fdim, 0)
    vertices = of_facets.array.reshape(of_facets.num_nodes, -1) if of_facets.num_nodes else np.zeros((0, 1), dtype=int)
    own = surface.owned_facets()
    flags = la.vector(domain.topology.index_map(0))
    flags.array[vertices[own]] = 1.0
    flags.scatter_reverse(la.InsertMode.add)
    flags.scatter_forward()
    known = [other.owned_facets() for other in named if other.mesh is domain and not other.is_membrane]
    rest = np.setdiff1d(mesh.exterior_facet_indices(domain.topology), np.concatenate([own, *known]))
    beside = rest[(flags.array[vertices[rest]] > 0.0).any(axis=1)].astype(np.int32)
    if not sum_over(domain.comm, len(beside)):
        return None
    return Surface(domain, mesh.meshtags(domain, fdim, beside, np.ones(len(beside), dtype=np.int32)), 1)
