"""Two beams, one on the other (section 4.1): one mesh of two bodies that share no node.

python3 -m meshes.two_beams beams.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from meshes.boxes import Box, boxes_in_gmsh, create_boxes
from meshes.gmsh_session import main

__all__ = ["CLAMP", "LOWER", "LOWER_TOP", "TIP", "UPPER", "UPPER_BOTTOM", "TwoBeams"]

LOWER, UPPER = 1, 2  # cells
CLAMP, LOWER_TOP, UPPER_BOTTOM, TIP = 11, 12, 13, 14  # facets


@dataclass(frozen=True)
class TwoBeams:
    """Sizes in metres; `along` (lower, upper), `across` and `through` count elements along length, height and width.

    The interface is at y = 0 and the clamped ends at x = 0. With `gap` the upper beam starts that far above (or, negative,
    inside) the lower one.
    """

    length: float = 1.0
    height: float = 0.05
    width: float = 0.1
    along: tuple[int, int] = (40, 40)
    across: int = 4
    through: int = 1
    dim: int = 2
    triangles: bool = False
    gap: float = 0.0

    def _boxes(self) -> list[Box]:
        size, through = [self.length, self.height, self.width][: self.dim], [self.through] * (self.dim - 2)
        clamped = {(0, 0): CLAMP}
        return [
            Box([0.0, y, 0.0][: self.dim], size, [along, self.across, *through], tag, clamped | faces)
            for y, along, tag, faces in (
                (-self.height, self.along[0], LOWER, {(1, 1): LOWER_TOP}),
                (self.gap, self.along[1], UPPER, {(1, 0): UPPER_BOTTOM, (0, 1): TIP}),
            )
        ]

    def build(self, gmsh: Any) -> None:
        """Add the two beams to the current gmsh model and mesh it."""
        boxes_in_gmsh(gmsh, self._boxes(), self.triangles)

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return create_boxes(comm, self._boxes(), self.triangles)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], TwoBeams().build, "two_beams.msh")
