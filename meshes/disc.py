"""A disc above the line y = 0 (section 4.4), its elements following the circle.

python3 -m meshes.disc disc.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from meshes.gmsh_session import distribute, main

__all__ = ["DISC", "RIM", "Disc"]

DISC = 1  # cells
RIM = 31  # facets

GROWTH = 0.25  # of the element size per length, from the rim inwards
BLOSSOM_FULL_QUAD = 3  # gmsh's recombination that leaves no triangle


# nodes of a mirrored gmsh element (3- and 6-node triangle, 4- and 9-node quadrilateral, lines) in the order that keeps it
# right side out
MIRRORED = {
    2: [0, 2, 1],
    9: [0, 2, 1, 5, 4, 3],
    3: [0, 3, 2, 1],
    10: [0, 3, 2, 1, 7, 6, 5, 4, 8],
    1: [0, 1],
    8: [0, 1, 2],
}


def _mirror(model: Any, surface: int, curves: list[int]) -> dict[tuple[int, int], int]:
    """Add the image of a meshed surface and its curves under x → −x, nodes on the axis shared: (tag, dimension) → tag."""
    tags, x, _ = model.mesh.getNodes(2, surface, includeBoundary=True)
    tags, first = np.unique(tags.astype(np.int64), return_index=True)
    x = x.reshape(-1, 3)[first]
    on_axis = np.abs(x[:, 0]) < 1e-9 * np.abs(x).max()
    image = tags.copy()
    image[~on_axis] = tags.max() + 1 + np.arange(np.sum(~on_axis))  # DOLFINx wants numbers without gaps
    result = {}
    for dim, entity in [(2, surface), *((1, curve) for curve in curves)]:
        copy = model.addDiscreteEntity(dim)
        if dim == 2:
            model.mesh.addNodes(2, copy, image[~on_axis], (x[~on_axis] * [-1, 1, 1]).ravel())
        for kind, nodes in zip(*model.mesh.getElements(dim, entity)[::2], strict=True):
            nodes = image[np.searchsorted(tags, nodes.astype(np.int64))].reshape(-1, len(MIRRORED[kind]))
            model.mesh.addElementsByType(copy, kind, [], nodes[:, MIRRORED[kind]].ravel())
        result[entity, dim] = copy
    return result


@dataclass(frozen=True)
class Disc:
    """Sizes in metres; the centre is at (0, height), `height` being the radius, so that the disc touches y = 0, by default.

    `size` is the element size inside (radius/10 by default) and `rim_size` on the circle (`size` by default). The circle has
    a multiple of four equal elements, with a node at its lowest point. `order` is that of the geometry: with 2, edges on
    the rim are parabolas through three points of the circle; with 1, chords. The mesh is its own mirror image in x.
    """

    radius: float = 0.1
    height: float | None = None
    size: float | None = None
    rim_size: float | None = None
    order: int = 2
    triangles: bool = True

    def _grade(self, gmsh: Any, y: float, size: float, rim_size: float) -> None:
        """Let the element size go from `rim_size` on the rim to `size` inside."""
        layer = min(abs(size - rim_size) / GROWTH, 0.9 * self.radius)
        field = gmsh.model.mesh.field
        ball = field.add("Ball")
        sizes = {"VIn": size, "VOut": rim_size, "Radius": self.radius - layer, "Thickness": layer, "YCenter": y}
        for name, value in sizes.items():
            field.setNumber(ball, name, value)
        field.setAsBackgroundMesh(ball)
        for source in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{source}", 0)

    def build(self, gmsh: Any) -> None:
        """Add the disc to the current gmsh model and mesh it."""
        model, R = gmsh.model, self.radius
        y = R if self.height is None else self.height
        size = R / 10 if self.size is None else self.size
        rim_size = size if self.rim_size is None else self.rim_size
        bottom, top = model.occ.addPoint(0, y - R, 0), model.occ.addPoint(0, y + R, 0)
        right, centre = model.occ.addPoint(R, y, 0), model.occ.addPoint(0, y, 0)
        arcs = [model.occ.addCircleArc(bottom, centre, right), model.occ.addCircleArc(right, centre, top)]
        half = model.occ.addPlaneSurface([model.occ.addCurveLoop([*arcs, model.occ.addLine(top, bottom)])])
        model.occ.remove([(0, centre)])
        model.occ.synchronize()
        self._grade(gmsh, y, size, rim_size)
        if not self.triangles:
            model.mesh.setRecombine(2, half)
            gmsh.option.setNumber("Mesh.RecombinationAlgorithm", BLOSSOM_FULL_QUAD)
        model.mesh.generate(2)
        model.mesh.setOrder(self.order)
        mirrored = _mirror(model, half, arcs)
        model.addPhysicalGroup(2, [half, mirrored[half, 2]], DISC)
        model.addPhysicalGroup(1, [*arcs, *(mirrored[arc, 1] for arc in arcs)], RIM)

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return distribute(self.build, comm, 2)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], Disc().build, "disc.msh")
