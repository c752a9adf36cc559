"""Two membranes facing each other (section 4.2): one mesh of two lines (two rectangles in 3D) that share no node.

python3 -m meshes.two_membranes membranes.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from meshes.gmsh_session import distribute, main

__all__ = ["EDGE", "LOWER", "UPPER", "TwoMembranes"]

LOWER, UPPER = 1, 2  # cells
EDGE = 11  # the fixed ends (edges)


@dataclass(frozen=True)
class TwoMembranes:
    """Sizes in metres; `cells` counts elements along each membrane (lower, upper), `through` over the width in 3D.

    The lower membrane spans x ∈ [0, length] at y = 0, the upper one x ∈ [shift, shift + length] at y = height, both
    z ∈ [0, width] in three dimensions.
    """

    length: float = 1.0
    shift: float = 1.0
    height: float = 1.0
    width: float = 1.0
    cells: tuple[int, int] = (80, 80)
    through: int = 8
    dim: int = 2
    triangles: bool = False

    def _membrane(self, gmsh: Any, x: float, y: float, cells: int, body: int) -> list[int]:
        """One membrane, its cells tagged `body`; returns its fixed ends (edges)."""
        occ, model = gmsh.model.occ, gmsh.model
        line = occ.addLine(occ.addPoint(x, y, 0), occ.addPoint(x + self.length, y, 0))
        sheet = [line]
        if self.dim == 3:
            sheet = [tag for dim, tag in occ.extrude([(1, line)], 0, 0, self.width) if dim == 2]
        occ.synchronize()
        edges = model.getBoundary([(self.dim - 1, sheet[0])], oriented=False)
        for dim, curve in [(1, line)] if self.dim == 2 else edges:
            along = abs(model.occ.getCenterOfMass(dim, curve)[0] - x - self.length / 2) < 1e-9 * self.length
            model.mesh.setTransfiniteCurve(curve, (cells if along else self.through) + 1)
        if self.dim == 3:
            model.mesh.setTransfiniteSurface(sheet[0])
            if not self.triangles:
                model.mesh.setRecombine(2, sheet[0])
        model.addPhysicalGroup(self.dim - 1, sheet, body)
        return [tag for _, tag in edges]

    def build(self, gmsh: Any) -> None:
        """Add the two membranes to the current gmsh model and mesh it."""
        edges = self._membrane(gmsh, 0.0, 0.0, self.cells[0], LOWER)
        edges += self._membrane(gmsh, self.shift, self.height, self.cells[1], UPPER)
        gmsh.model.addPhysicalGroup(self.dim - 2, edges, EDGE)
        gmsh.model.mesh.generate(self.dim - 1)

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, edge tags), distributed over `comm`."""
        return distribute(self.build, comm, self.dim)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], TwoMembranes().build, "two_membranes.msh")
