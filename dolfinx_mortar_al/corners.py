"""Sharp corners and edges of a contactor, where a multiplier's node serves faces that meet at an angle.

At such a node the facets fall into faces, smooth parts round the node. Where one face is closed and another is open, the
traction is that of the closed face up to the corner: the node has no part in the open one (``docs/projection.md``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.surface import SHARP, Facets, GatheredFacets

__all__ = ["SharpCorners"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

HALF = 0.5  # of the most closed face's share: more open ones have no part in a corner's node
ROUND_OFF = 1e-9  # of a share: on any number of ranks the same


@dataclass(frozen=True)
class SharpCorners:
    """Nodes at which sharp corners or edges divide a contactor's facets into faces.

    Attributes:
        comm: of the problem.
        facet, place: (k,) of this rank's facets those with such a node, and which of the multiplier's nodes on it that is.
        face: (k,) the face about the node that the facet belongs to, of `corner`'s.
        corner: (faces,) the corner that each face has part in, the same on all ranks.
    """

    comm: MPI.Intracomm
    facet: Index
    place: Index
    face: Index
    corner: Index

    @classmethod
    def of(cls, facets: Facets, surface: GatheredFacets, nodes: Index, comm: MPI.Intracomm) -> SharpCorners | None:
        """Those of a contactor, this rank's `facets` of its whole `surface`, in the reference configuration; None if it has
        none. `nodes`: which of the displacement's nodes on a facet are the multiplier's, in its order."""
        count, k = len(surface.facets), len(nodes)
        face, corner = _faces(surface.facets[:, nodes].ravel(), surface.normals()[:, nodes].reshape(count * k, -1))
        if not len(corner):
            return None
        mine = face.reshape(count, k)[surface.places_of(facets)]
        facet, place = np.nonzero(mine >= 0)
        return cls(comm, facet, place, mine[facet, place], corner)

    def left_out(self, weight: Array, closed: Array) -> Bool:
        """(nf, nodes) nodes that have no part in a facet, as its face is less than half as closed as the corner's most closed
        one. Of the integral `weight` (nf, nodes) of a node's shape function on a facet, `closed` is that over closed points
        (collective)."""
        sums = np.zeros((2, len(self.corner)))
        for total, values in zip(sums, (weight, closed), strict=True):
            np.add.at(total, self.face, values[self.facet, self.place])
        self.comm.Allreduce(MPI.IN_PLACE, sums)
        share = sums[1] / sums[0]
        most = np.zeros(self.corner.max() + 1)
        np.maximum.at(most, self.corner, share)
        out = np.zeros(weight.shape, dtype=bool)
        out[self.facet, self.place] = (share < HALF * most[self.corner] - ROUND_OFF)[self.face]
        return out


def _faces(node: Index, normal: Array) -> tuple[Index, Index]:
    """Faces of facets' nodes `node` (n,) with unit normals (n, gdim) there: (n,) the face of each, −1 where the surface is
    smooth, and the corner (faces,) that each is of. Of one face are facets whose normals differ little, or that others
    between them join."""
    first = np.unique(node, return_index=True, return_inverse=True)
    turn = np.einsum("ni,ni->n", normal, normal[first[1]][first[2].ravel()])
    half = np.sqrt((1.0 + SHARP) / 2.0)  # of two normals one is half as far or more from the first
    some = np.flatnonzero(np.isin(node, node[turn < half]))
    some = some[np.argsort(node[some], kind="stable")]
    _, start, corner, count = np.unique(node[some], return_index=True, return_inverse=True, return_counts=True)
    rank = np.arange(len(some)) - start[corner]
    table = np.zeros((len(count), count.max(initial=0), normal.shape[1]))
    table[corner, rank] = normal[some]
    there = np.arange(table.shape[1]) < count[:, None]
    joined = (np.einsum("nai,nbi->nab", table, table) > SHARP) & there[:, :, None] & there[:, None]
    label = np.broadcast_to(np.arange(table.shape[1]), there.shape)
    while True:  # the least label that is joined to each, as far as that spreads
        least = np.where(joined, label[:, None], table.shape[1]).min(axis=2, initial=table.shape[1])
        if np.array_equal(least, label):
            break
        label = least
    label = label[corner, rank]
    sharp = np.zeros(len(count), dtype=bool)
    sharp[corner[label > 0]] = True
    face = np.full(len(node), -1)
    if not sharp.any():
        return face, np.zeros(0, dtype=np.int64)
    faces, number = np.unique(np.stack([corner, label])[:, sharp[corner]], axis=1, return_inverse=True)
    face[some[sharp[corner]]] = number.ravel()
    return face, faces[0]
