"""Two bars in line, end to end (section 4.3): one mesh of two bodies that share no node.

python3 -m meshes.two_bars bars.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from meshes.boxes import Box, boxes_in_gmsh, create_boxes
from meshes.gmsh_session import main

__all__ = ["BAR1", "BAR2", "FACE1", "FACE2", "FREE1", "FREE2", "SIDES1", "SIDES2", "TwoBars"]

BAR1, BAR2 = 1, 2  # cells
FREE1, FACE1, FACE2, FREE2, SIDES1, SIDES2 = 21, 22, 23, 24, 25, 26  # facets


@dataclass(frozen=True)
class TwoBars:
    """Sizes in metres; `along` counts elements along each bar, `across` over its height and over its width.

    Bar 1 lies in x ∈ [0, length], bar 2 in [length + gap, 2 length + gap], both in y ∈ [0, height], z ∈ [0, width]. The faces
    FACE1 and FACE2 look at each other, FREE1 and FREE2 are the far ends, SIDES1 and SIDES2 all that is parallel to x.
    """

    length: float = 10.0
    height: float = 1.0
    width: float = 1.0
    along: int = 20
    across: int = 1
    dim: int = 2
    triangles: bool = False
    gap: float = 0.0

    def _boxes(self) -> list[Box]:
        size, cells = [self.length, self.height, self.width], [self.along, self.across, self.across]
        lateral = [(axis, end) for axis in range(1, self.dim) for end in (0, 1)]
        return [
            Box(
                [x, 0.0, 0.0][: self.dim],
                size[: self.dim],
                cells[: self.dim],
                tag,
                {(0, 0): left, (0, 1): right} | dict.fromkeys(lateral, sides),
            )
            for x, tag, left, right, sides in (
                (0.0, BAR1, FREE1, FACE1, SIDES1),
                (self.length + self.gap, BAR2, FACE2, FREE2, SIDES2),
            )
        ]

    def build(self, gmsh: Any) -> None:
        """Add the two bars to the current gmsh model and mesh it."""
        boxes_in_gmsh(gmsh, self._boxes(), self.triangles)

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return create_boxes(comm, self._boxes(), self.triangles)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], TwoBars().build, "two_bars.msh")
