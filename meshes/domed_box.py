"""Boxes of hexahedra or tetrahedra of first or second order, the bottom flat or a dome.

python3 -c "from meshes.domed_box import DomedBox; DomedBox((0, 0, 0), (1, 1, 0.5), 10, radius=1.0).create()"
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

__all__ = ["BOTTOM", "TOP", "DomedBox"]

BOTTOM, TOP = 1, 2  # facets


@dataclass(frozen=True)
class DomedBox:
    """A box by its lowest corner and sides (m) with about `per_metre` cells per metre. With a `radius` (m) the bottom is the
    paraboloid r²/(2 radius) about its middle, which the cells follow as far as their order does."""

    corner: tuple[float, float, float]
    sides: tuple[float, float, float]
    per_metre: float
    radius: float | None = None
    tetrahedra: bool = False
    order: int = 1

    @property
    def cells(self) -> tuple[int, ...]:
        """Along each side."""
        return tuple(max(1, round(side * self.per_metre)) for side in self.sides)

    def unknowns(self) -> int:
        """Of a displacement of the same order."""
        return 3 * int(np.prod([self.order * n + 1 for n in self.cells]))

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[mesh.Mesh, Any]:
        """(mesh, facet tags), distributed over `comm`."""
        low, high = np.array(self.corner), np.add(self.corner, self.sides)
        kind = mesh.CellType.tetrahedron if self.tetrahedra else mesh.CellType.hexahedron
        domain = mesh.create_box(comm, [low, high], self.cells, kind)
        if self.order == 2:
            domain = _of_second_order(domain)
        ends = [mesh.locate_entities_boundary(domain, 2, lambda x, z=z: np.isclose(x[2], z)) for z in (low[2], high[2])]
        facets = np.concatenate(ends)
        tags = np.repeat([BOTTOM, TOP], [len(some) for some in ends]).astype(np.int32)
        order = np.argsort(facets)
        if self.radius is not None:
            x = domain.geometry.x
            r2 = np.sum((x[:, :2] - (low + high)[:2] / 2) ** 2, axis=1)
            x[:, 2] += r2 / (2 * self.radius) * (high[2] - x[:, 2]) / self.sides[2]
        return domain, mesh.meshtags(domain, 2, facets[order], tags[order])


def _of_second_order(domain: mesh.Mesh) -> mesh.Mesh:
    """The same cells with nodes on their edges, and what else the order has."""
    V = fem.functionspace(domain, ("Lagrange", 2))
    numbers, owned = V.dofmap.index_map, domain.topology.index_map(domain.topology.dim).size_local
    cells = V.dofmap.list[:owned]
    nodes = numbers.local_to_global(cells.ravel()).reshape(cells.shape)
    x = V.tabulate_dof_coordinates()[: numbers.size_local]
    element = basix.ufl.element("Lagrange", domain.basix_cell(), 2, shape=(domain.geometry.dim,))
    return mesh.create_mesh(domain.comm, cells=nodes, x=x, e=element)
