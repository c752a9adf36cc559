"""Two beams, one on the other (section 4.1): one mesh of two bodies that share no node.

python3 -m meshes.two_beams beams.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from meshes.gmsh_session import distribute, main, structured_box

__all__ = ["CLAMP", "LOWER", "LOWER_TOP", "TIP", "UPPER", "UPPER_BOTTOM", "TwoBeams"]

LOWER, UPPER = 1, 2  # cells
CLAMP, LOWER_TOP, UPPER_BOTTOM, TIP = 11, 12, 13, 14  # facets


@dataclass(frozen=True)
class TwoBeams:
    """Sizes in metres; `cells` counts elements along the length (lower, upper), over the height and over the width.

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

    def _beam(self, gmsh: Any, y: float, along: int, body: int) -> dict[str, int]:
        """One rectangle (box) above height y, structured, its cells tagged `body`; returns its facets by name."""
        size, cells = [self.length, self.height, self.width], [along, self.across, self.through]
        facets = structured_box(gmsh, [0, y, 0], size[: self.dim], cells, self.triangles, body)

        def at(axis: int, value: float) -> int:
            centre = {f: gmsh.model.occ.getCenterOfMass(self.dim - 1, f)[axis] for f in facets}
            return next(f for f in facets if abs(centre[f] - value) < 1e-9)

        return {"clamp": at(0, 0.0), "end": at(0, self.length), "bottom": at(1, y), "top": at(1, y + self.height)}

    def build(self, gmsh: Any) -> None:
        """Add the two beams to the current gmsh model and mesh it."""
        lower = self._beam(gmsh, -self.height, self.along[0], LOWER)
        upper = self._beam(gmsh, self.gap, self.along[1], UPPER)
        groups = {CLAMP: [lower["clamp"], upper["clamp"]], TIP: [upper["end"]]}
        groups |= {LOWER_TOP: [lower["top"]], UPPER_BOTTOM: [upper["bottom"]]}
        for tag, entities in groups.items():
            gmsh.model.addPhysicalGroup(self.dim - 1, entities, tag)
        gmsh.model.mesh.generate(self.dim)

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return distribute(self.build, comm, self.dim)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], TwoBeams().build, "two_beams.msh")
