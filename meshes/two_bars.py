"""Two bars in line, end to end (section 4.3): one mesh of two bodies that share no node.

python3 -m meshes.two_bars bars.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from meshes.gmsh_session import distribute, main, structured_box

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

    def _bar(self, gmsh: Any, x: float, body: int) -> tuple[list[int], list[int], list[int]]:
        """One rectangle (box) from x on, structured, its cells tagged `body`; its left, right and lateral facets."""
        size, cells = [self.length, self.height, self.width], [self.along, self.across, self.across]
        facets = structured_box(gmsh, [x, 0, 0], size[: self.dim], cells, self.triangles, body)
        centre = {f: (gmsh.model.occ.getCenterOfMass(self.dim - 1, f)[0] - x) / self.length for f in facets}
        left, right = ([f for f in centre if abs(centre[f] - end) < 1e-9] for end in (0, 1))
        return left, right, [f for f in centre if f not in left + right]

    def build(self, gmsh: Any) -> None:
        """Add the two bars to the current gmsh model and mesh it."""
        free1, face1, sides1 = self._bar(gmsh, 0.0, BAR1)
        face2, free2, sides2 = self._bar(gmsh, self.length + self.gap, BAR2)
        groups = {FREE1: free1, FACE1: face1, FACE2: face2, FREE2: free2, SIDES1: sides1, SIDES2: sides2}
        for tag, entities in groups.items():
            gmsh.model.addPhysicalGroup(self.dim - 1, entities, tag)
        gmsh.model.mesh.generate(self.dim)

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return distribute(self.build, comm, self.dim)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], TwoBars().build, "two_bars.msh")
