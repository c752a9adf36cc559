"""Two beams, one on the other (section 4.1): one mesh of two bodies that share no node.

python3 -m meshes.two_beams beams.msh
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
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

    def _beam(self, gmsh: Any, y: float, along: int, body: int) -> dict[str, int]:
        """One rectangle (box) above height y, structured, its cells tagged `body`; returns its facets by name."""
        model, d = gmsh.model, self.dim
        size = [self.length, self.height, self.width][:d]
        add = model.occ.addBox if d == 3 else model.occ.addRectangle
        entity = (d, add(0, y, 0, *size))
        model.occ.synchronize()
        facets = model.getBoundary([entity], oriented=False)
        curves = set(model.getBoundary(facets, combined=False, oriented=False)) if d == 3 else facets
        for dim, curve in curves:
            low, high = np.split(np.array(model.getBoundingBox(dim, curve)), 2)
            direction = int(np.argmax(high - low))
            model.mesh.setTransfiniteCurve(curve, (along, self.across, self.through)[direction] + 1)
        for dim, surface in facets if d == 3 else [entity]:
            model.mesh.setTransfiniteSurface(surface)
            if not self.triangles:
                model.mesh.setRecombine(dim, surface)
        if d == 3:
            model.mesh.setTransfiniteVolume(entity[1])
        model.addPhysicalGroup(d, [entity[1]], body)

        def at(axis: int, value: float) -> int:
            return next(f for dim, f in facets if abs(model.occ.getCenterOfMass(dim, f)[axis] - value) < 1e-9)

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
