"""How wide what is in contact is about each facet of the contactor: its local thickness, beside what the target can follow.

The thickness of a zone at a place is the diameter of the largest disc (interval, in the plane) inside the zone that has the
place in it (T. Hildebrand and P. Rüegsegger, J. Microsc. 185, 1997, doi:10.1046/j.1365-2818.1997.1340694.x): long narrow
zones are thin, and the places beside the edge of a wide one are in a wide zone.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.surface import GatheredFacets

__all__ = ["ZoneWidth"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

WIDE = 6.0  # distances of the target's nodes across a zone, see below
STEP = 2.0**-0.25  # from one width that is told apart to the next


class ZoneWidth:
    """The contactor's facets, as all ranks see them (collective). A zone does not end where the contactor does: beyond a
    plane of symmetry it goes on, and a body that is in contact with all of its surface has no edge of contact.

    Args:
        contactor: all of its facets; own: (nf,) which of them are this rank's.
        h: (nf,) distances (m) of the nodes of the target's facets that this rank's face.
    """

    def __init__(self, contactor: GatheredFacets, own: Index, h: Array, comm: MPI.Comm) -> None:
        self._mine, self._comm = own, comm
        self._h = np.zeros(len(contactor.facets))
        for places, distances in comm.allgather((own, h)):
            self._h[places] = distances
        self._centres = contactor.X[contactor.facets].mean(axis=1)
        self._lengths = contactor.extents()
        self._zone = np.zeros(len(self._centres), dtype=bool)
        self._share: Array = np.zeros(len(self._centres))

    def share(self, zone: Bool) -> Array:
        """(nf,) what compliance each of this rank's facets may have, as a share of what the target's facets lack, when these
        (nf,) are in contact: (w/(WIDE h))³ where the zone is w wide, rounded down to a power of STEP³, and all of it beyond
        (collective).

        Under a pressure that varies over w a body yields in proportion to w, and κ ~ h³ in proportion to h³/w²: as shares of
        the first all that κ adds are alike, and small.
        """
        touching = np.zeros(len(self._zone), dtype=bool)
        for places in self._comm.allgather(self._mine[zone]):
            touching[places] = True
        if (touching != self._zone).any():
            self._zone, self._share = touching, self._shares(touching)
        return self._share[self._mine]

    def _shares(self, zone: Bool) -> Array:
        """(nf,) of all facets, when these (nf,) are in contact."""
        centres, own, wide = self._centres[zone], self._lengths[zone], WIDE * self._h[zone]
        inscribed: Array = np.maximum(own, 2 * _distance(centres, self._centres[~zone]) - own)
        found, left, width = np.zeros(len(own)), np.arange(len(own)), 1.0
        while len(left):
            reach = 0.5 * width * wide[left] + own[left]
            amid = _distance(centres[left], centres[inscribed >= width * wide]) <= reach
            found[left[amid]] = width**3
            left, width = left[~amid], STEP * width
        share = np.zeros(len(zone))
        share[zone] = found
        return share


def _distance(x: Array, others: Array) -> Array:
    """(n,) from each of x (n, gdim) to the nearest of the others (m, gdim), infinite if there are none."""
    from scipy.spatial import KDTree  # slow to import

    return np.asarray(KDTree(others).query(x)[0]) if len(others) else np.full(len(x), np.inf)
