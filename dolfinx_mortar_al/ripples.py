"""What is added to ε lest surfaces ripple within their facets, where multipliers of a lower order see nothing.

On the slope of a ripple as long as a facet a pressure p acts along the surface, and only the body and ε resist it: where p
comes near a solid's moduli ε grows with it (docs/newton.md). Membranes have none but under compression (docs/membranes.md).
Segments and multipliers of the displacement's order see ripples, and obstacles have none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.compression import Compression
from dolfinx_mortar_al.contact import Contact
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over
from dolfinx_mortar_al.surface import GatheredFacets, Surface

__all__ = ["FLAT", "CompressedSheets", "firmness_under_pressure"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

FLAT = 50.0  # of a membrane's stiffness: what a compression by half asks for (docs/membranes.md); wild iterates ask for more
RIPPLING = 2 * np.pi  # slope of a wave as long as a facet, over its amplitude in facets
OWN = 0.5  # of the bulk's stiffness holds such waves, whatever contact does (docs/newton.md)


def firmness_under_pressure(
    pressed: Array, slopes: Sequence[Array], stiffnesses: Sequence[float], comm: MPI.Comm
) -> float:
    """What solids lack to hold such ripples under a pressure (Pa/m), 0 if nothing (collective).

    Args:
        pressed: (n,) p dS₀ at this rank's points (N).
        slopes: of either side (n,) p over the extent of the facet there (Pa/m).
        stiffnesses: of either side (Pa/m).
        comm: the ranks.
    """
    *driving, force = sum_over(comm, np.array([*(pressed @ slope for slope in slopes), pressed.sum()]))
    if not force > 0:
        return 0.0
    lacking = max(drive / force - OWN * stiffness for drive, stiffness in zip(driving, stiffnesses, strict=True))
    return RIPPLING * max(0.0, lacking)


class CompressedSheets:
    """Those of a pair's sides that are membranes of order 2.

    Args:
        contact: the pair's.
        wholes: contactor and target, gathered; None for a target that does not deform.
        bodies: which have the membranes' laws.
    """

    def __init__(self, contact: Contact, wholes: Sequence[GatheredFacets | None], bodies: Bodies) -> None:
        self._comm = bodies.comm
        self._sides: dict[int, Compression] = {}
        for k, (surface, whole) in enumerate(zip((contact.contactor, contact.target), wholes, strict=True)):
            if isinstance(surface, Surface) and surface.is_membrane and whole is not None and whole.shape.order > 1:
                body = bodies.bodies[bodies.index(surface.mesh)]
                if body.sheets:
                    self._sides[k] = Compression(surface, whole, body.u, body.sheets)

    def firmness(self, own: Index, faced: Index) -> float:
        """What keeps them from rippling (Pa/m) where they are in contact: at facets `own` (n,) of the whole contactor and
        `faced` (n,) of the target, of this rank (collective)."""
        if not self._sides or not any_over(self._comm, len(own) > 0):
            return 0.0
        touched = own, faced
        worst = [float(c.firmness()[touched[k]].max(initial=0.0)) for k, c in self._sides.items()]
        return max_over(self._comm, max(worst))
