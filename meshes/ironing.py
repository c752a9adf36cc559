"""A punch with a parabolic bottom on a slab: one mesh of two structured bodies that share no node, in the plane or in space.

python3 -m meshes.ironing ironing.msh
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from meshes.gmsh_session import distribute, main, structured_box

__all__ = ["PUNCH", "PUNCH_BOTTOM", "PUNCH_TOP", "SLAB", "SLAB_BOTTOM", "SLAB_TOP", "Ironing"]

SLAB, PUNCH = 1, 2  # cells
SLAB_BOTTOM, SLAB_TOP, PUNCH_BOTTOM, PUNCH_TOP = 11, 12, 21, 22  # facets

# by dimension, the last axis up (m): sizes, where the punch stands, cells per cell along the punch
SLAB_SIZE, SLAB_CELLS = {2: (6.0, 2.0), 3: (3.0, 2.0, 0.8)}, {2: (4.0, 2 / 3), 3: (2.4, 1.6, 0.64)}
PUNCH_SIZE, PUNCH_CELLS = {2: (1.2, 0.6), 3: (1.0, 1.0, 0.5)}, {2: (1.0, 0.5), 3: (1.0, 1.0, 0.5)}
START = {2: (1.0,), 3: (0.3, 0.3)}


@dataclass(frozen=True)
class Ironing:
    """A slab, 6 × 2 m (in space 3 × 2 × 0.8 m), and a punch above it, 1.2 × 0.6 m (1 × 1 × 0.5 m), the last axis up.

    The punch's bottom is the parabola (paraboloid) r²/(2 radius) above its lowest point, which is `gap` above the slab;
    its cells follow, the top stays flat. `order` is that of the geometry: with 1 the bottom has its nodes on the parabola,
    with 2 it is the parabola.

    `cells` counts the cells along the punch; all others are in proportion: 12f in the plane make 48f × 8f in the slab and
    12f × 6f in the punch, and 4, 7, 10, 14 in space make 1.1, 4.2, 11 and 30 thousand displacements of order 1. `ratio`
    multiplies the cells of the slab and of the punch, along each axis.
    """

    dim: int = 2
    cells: int = 12
    ratio: tuple[float, float] = (1.0, 1.0)
    triangles: bool = False
    order: int = 1
    radius: float = 1.0
    gap: float = 0.0

    def _body(
        self, gmsh: Any, origin: Sequence[float], size: Sequence[float], cells: Sequence[float], body: int
    ) -> None:
        """One rectangle (box), structured, its cells, bottom and top tagged `body`, 10 `body` + 1 and 10 `body` + 2."""
        counts = [max(1, round(self.cells * self.ratio[body - SLAB] * share)) for share in cells]
        facets = structured_box(gmsh, [*origin, 0.0][:3], size, counts, self.triangles, body)
        height = {f: gmsh.model.occ.getCenterOfMass(self.dim - 1, f)[self.dim - 1] - origin[-1] for f in facets}
        for tag, level in (10 * body + 1, 0.0), (10 * body + 2, size[-1]):
            bottom_or_top = [f for f in facets if abs(height[f] - level) < 1e-9]
            gmsh.model.addPhysicalGroup(self.dim - 1, bottom_or_top, tag)

    def _bend(self, gmsh: Any, corner: Sequence[float], size: Sequence[float]) -> None:
        """Move the punch's nodes so that its bottom is curved."""
        mesh, across, up = gmsh.model.mesh, slice(self.dim - 1), self.dim - 1
        (body,) = gmsh.model.getEntitiesForPhysicalGroup(self.dim, PUNCH)
        tags, x, _ = mesh.getNodes(self.dim, body, includeBoundary=True)
        x = x.reshape(-1, 3)
        r2 = np.sum((x[:, across] - np.array(corner[across]) - np.array(size[across]) / 2) ** 2, axis=1)
        x[:, up] += r2 / (2 * self.radius) * (1 - (x[:, up] - corner[up]) / size[up])
        for tag, node in zip(tags, x, strict=True):
            mesh.setNode(tag, node, [])

    def build(self, gmsh: Any) -> None:
        """Add slab and punch to the current gmsh model and mesh them."""
        d = self.dim
        corner = [*START[d], SLAB_SIZE[d][-1] + self.gap]
        self._body(gmsh, [0.0] * d, SLAB_SIZE[d], SLAB_CELLS[d], SLAB)
        self._body(gmsh, corner, PUNCH_SIZE[d], PUNCH_CELLS[d], PUNCH)
        gmsh.model.mesh.generate(d)
        gmsh.model.mesh.setOrder(self.order)
        self._bend(gmsh, corner, PUNCH_SIZE[d])

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return distribute(self.build, comm, self.dim)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], Ironing().build, "ironing.msh")
