"""Two beams, one on the other (section 4.1): one mesh of two bodies that share no node.

    python3 -m meshes.two_beams beams.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from meshes.gmsh_session import distribute, main

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

    def _beam(self, gmsh: Any, y: float, cells: int, body: int, interface: int) -> dict[int, list[int]]:
        """One rectangle (box): its cells tagged `body`, its facets returned as {tag: entities}."""
        geo, L = gmsh.model.geo, self.length
        corners = [(0, y), (L, y), (L, y + self.height), (0, y + self.height)]
        p = [geo.addPoint(a, b, 0) for a, b in corners]
        lines = [geo.addLine(p[i], p[(i + 1) % 4]) for i in range(4)]  # bottom, end, top, clamp
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        for line, n in zip(lines, [cells, self.across, cells, self.across], strict=True):
            geo.mesh.setTransfiniteCurve(line, n + 1)
        geo.mesh.setTransfiniteSurface(surface, arrangement="Left" if body == LOWER else "Right")
        if not self.triangles:
            geo.mesh.setRecombine(2, surface)
        sides = dict(zip(["bottom", "end", "top", "clamp"], lines, strict=True))
        if self.dim == 3:
            out = geo.extrude([(2, surface)], 0, 0, self.width, numElements=[self.through], recombine=not self.triangles)
            sides = dict(zip(sides, [tag for _, tag in out[2:]], strict=True))
            surface = out[1][1]
        geo.synchronize()
        gmsh.model.addPhysicalGroup(self.dim, [surface], body)
        return {CLAMP: [sides["clamp"]], interface: [sides["top" if body == LOWER else "bottom"]], TIP: [sides["end"]]}

    def build(self, gmsh: Any) -> None:
        """Add the two beams to the current gmsh model and mesh it."""
        lower = self._beam(gmsh, -self.height, self.along[0], LOWER, LOWER_TOP)
        upper = self._beam(gmsh, self.gap, self.along[1], UPPER, UPPER_BOTTOM)
        groups = {CLAMP: lower[CLAMP] + upper[CLAMP], TIP: upper[TIP]}
        groups |= {LOWER_TOP: lower[LOWER_TOP], UPPER_BOTTOM: upper[UPPER_BOTTOM]}
        for tag, entities in groups.items():
            gmsh.model.addPhysicalGroup(self.dim - 1, entities, tag)
        gmsh.model.mesh.generate(self.dim)

    def create(self, comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[Any, Any, Any]:
        """(mesh, cell tags, facet tags), distributed over `comm`."""
        return distribute(self.build, comm, self.dim)


if __name__ == "__main__":
    main(__doc__.splitlines()[0], TwoBeams().build, "two_beams.msh")
