"""What lies next to a contact surface on its body's boundary, and is not named (``docs/robustness.md``)."""

from __future__ import annotations

import numpy as np
from dolfinx import mesh
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.reductions import sum_over
from dolfinx_mortar_al.surface import Facets, Surface
from dolfinx_mortar_al.targets import DeformableTarget

__all__ = ["Beyond"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]


class Beyond:
    """The facets of a body's boundary that touch a surface and do not belong to it.

    Args:
        surface: of the body, whole on every rank as `target`.
        bodies: of the problem.

    Attributes:
        X: (n, gdim) reference positions (m) of their nodes that are not the surface's; extent: (n,) of the largest facet that
            a node belongs to (m).
    """

    def __init__(self, surface: Surface, target: DeformableTarget, bodies: Bodies) -> None:
        self._facets: DeformableTarget | None = None
        self.X: Array = np.zeros((0, surface.mesh.geometry.dim))
        self.extent: Array = np.zeros(0)
        self._free: Bool = np.zeros(0, dtype=bool)
        near = None if surface.is_membrane else _touching(surface, target, bodies)
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


def _touching(surface: Surface, target: DeformableTarget, bodies: Bodies) -> Surface | None:
    """The facets of the boundary that share a node with a surface, but those of the surface (collective)."""
    domain, fdim = surface.mesh, surface.mesh.topology.dim - 1

    def marked(facets: NDArray[np.int32]) -> Surface | None:
        if not sum_over(domain.comm, len(facets)):
            return None
        return Surface(domain, mesh.meshtags(domain, fdim, facets, np.ones(len(facets), dtype=np.int32)), 1)

    rest = np.setdiff1d(mesh.exterior_facet_indices(domain.topology), surface.owned_facets())
    others, V = marked(rest), bodies.bodies[bodies.index(domain)].space
    if others is None:
        return None
    dofs = Facets.of(others, V).dofs
    every = V.dofmap.index_map.local_to_global(dofs.ravel().astype(np.int32)).reshape(dofs.shape)
    return marked(rest[np.isin(every, target.surface.blocks).any(axis=1)])
