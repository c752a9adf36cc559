"""How far membranes in contact are compressed, and how firmly contact must then hold them flat (docs/membranes.md).

A membrane of order 2 may ripple within its facets where multipliers of order 1 see nothing, 𝐰 ⟂ their shape functions. A
tension N resists with ∫ N |∇𝐰|², a compression drives it on, and but for contact's ∫ ε 𝐰² nothing stops it. The largest
∫ |∇𝐰|²/∫ 𝐰² of such ripples on a facet is STEEPEST over its width squared, for each direction that is compressed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.compiling import compiled
from dolfinx_mortar_al.membrane import NeoHookeanMembrane
from dolfinx_mortar_al.surface import Facets, GatheredFacets, Surface

__all__ = ["Compression", "Sheet"]

Array = NDArray[np.float64]
#: a membrane's law and the measure of its cells
Sheet = tuple[NeoHookeanMembrane, ufl.Measure]

STEEPEST = 60.0  # of parabolas without moments of order 0 and 1 on intervals and quadrilaterals; on triangles it is 45


class Compression:
    """Of a membrane's surface.

    Args:
        surface: the cells.
        whole: the same, gathered.
        u: the membrane's displacement (m), which it follows.
        sheets: its laws, each with the measure of its cells.
    """

    def __init__(self, surface: Surface, whole: GatheredFacets, u: fem.Function, sheets: Sequence[Sheet]) -> None:
        mesh = surface.mesh
        self._comm, facets = mesh.comm, Facets.of(surface, u.function_space)
        cellwise = fem.functionspace(mesh, ("DG", 0))
        w = ufl.TestFunction(cellwise)
        self._integrals = compiled(
            sum(w * ufl.max_value(-law.smallest_tension(u), 0.0) * dx for law, dx in sheets), mesh
        )
        self._values = fem.Function(cellwise)
        self._dofs = cellwise.dofmap.list[facets.entities, 0]
        self._over = STEEPEST * facets.shape.dim / (facets.areas() * facets.widths() ** 2)
        self._size, self._places = len(whole.facets), self._comm.allgather(whole.places_of(facets))

    def firmness(self) -> Array:
        """(whole nf,) the least ε (Pa/m) that holds each facet flat (collective)."""
        self._values.x.array[:] = 0.0
        fem.assemble_vector(self._values.x.array, self._integrals)
        mine = self._values.x.array[self._dofs] * self._over
        result = np.zeros(self._size)
        for places, values in zip(self._places, self._comm.allgather(mine), strict=True):
            result[places] = values
        return result
