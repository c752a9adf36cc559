"""Discs and rings in the plane, their elements following the circles.

python3 -m meshes.round_bodies discs.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from meshes.gmsh_session import distribute, main

__all__ = ["Round", "RoundBodies"]


@dataclass(frozen=True)
class Round:
    """A disc, or with `bore` > 0 a ring; all in metres.

    Args:
        centre: where.
        radius, bore: outer and inner radius.
        size: of the elements.
    """

    centre: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.1
    bore: float = 0.0
    size: float = 0.01


@dataclass(frozen=True)
class RoundBodies:
    """Round bodies of one mesh. Body k = 0, 1, … has cells `cells(k)`, outer rim `rim(k)` and bore `bore(k)`.

    `order` is that of the geometry: with 2, edges on the circles are parabolas, with 1, chords.
    """

    bodies: tuple[Round, ...]
    order: int = 2

    @staticmethod
    def cells(k: int) -> int:
        """Tag of the cells of body k."""
        return 1 + k

    @staticmethod
    def rim(k: int) -> int:
        """Tag of the outer circle of body k."""
        return 31 + k

    @staticmethod
    def bore(k: int) -> int:
        """Tag of the inner circle of body k."""
        return 61 + k

    def build(self, gmsh: Any) -> None:
        """Add the bodies to the current gmsh model and mesh them."""
        occ, model = gmsh.model.occ, gmsh.model
        groups = []
        for body in self.bodies:
            circles = [occ.addCircle(*body.centre, 0.0, radius) for radius in (body.radius, body.bore) if radius > 0]
            surface = occ.addPlaneSurface([occ.addCurveLoop([circle]) for circle in circles])
            groups.append((surface, circles))
        occ.synchronize()
        for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
        model.mesh.setSizeCallback(lambda dim, tag, x, y, z, size: self._size(x, y))
        for k, (surface, circles) in enumerate(groups):
            model.addPhysicalGroup(2, [surface], self.cells(k))
            for circle, tag in zip(circles, (self.rim(k), self.bore(k)), strict=False):
                model.addPhysicalGroup(1, [circle], tag)
        model.mesh.generate(2)
        model.mesh.setOrder(self.order)

    def _size(self, x: float, y: float) -> float:
        """The element size of the body about (x, y)."""
        reach = [((x - b.centre[0]) ** 2 + (y - b.centre[1]) ** 2) ** 0.5 / b.radius for b in self.bodies]
        return self.bodies[reach.index(min(reach))].size

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return distribute(self.build, comm, 2)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], RoundBodies((Round(), Round(centre=(0.08, 0.19)))).build, "discs.msh")
