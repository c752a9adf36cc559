"""A disc above the line y = 0 (section 4.4), its elements following the circle.

python3 -m meshes.disc disc.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

from mpi4py import MPI

from meshes.gmsh_session import distribute, main

__all__ = ["DISC", "RIM", "Disc"]

DISC = 1  # cells
RIM = 31  # facets

GROWTH = 0.25  # of the element size per length, from the rim inwards
BLOSSOM_FULL_QUAD = 3  # gmsh's recombination that leaves no triangle


@dataclass(frozen=True)
class Disc:
    """Sizes in metres; the centre is at (0, height), `height` being the radius, so that the disc touches y = 0, by default.

    `size` is the element size inside (radius/10 by default) and `rim_size` on the circle (`size` by default). The circle has
    a multiple of four equal elements, with a node at its lowest point. `order` is that of the geometry: with 2, edges on
    the rim are parabolas through three points of the circle; with 1, chords.
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
        quarters = [model.occ.addCircle(0, y, 0, R, angle1=k * pi / 2, angle2=(k + 1) * pi / 2) for k in range(4)]
        disc = model.occ.addPlaneSurface([model.occ.addCurveLoop(quarters)])
        model.occ.remove([(1, curve) for curve in quarters], recursive=True)  # but for those that the disc has kept
        model.occ.synchronize()
        rim = [curve for _, curve in model.getBoundary([(2, disc)], oriented=False)]
        self._grade(gmsh, y, size, rim_size)
        if not self.triangles:
            model.mesh.setRecombine(2, disc)
            gmsh.option.setNumber("Mesh.RecombinationAlgorithm", BLOSSOM_FULL_QUAD)
        model.addPhysicalGroup(2, [disc], DISC)
        model.addPhysicalGroup(1, rim, RIM)
        model.mesh.generate(2)
        model.mesh.setOrder(self.order)

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return distribute(self.build, comm, 2)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], Disc().build, "disc.msh")
