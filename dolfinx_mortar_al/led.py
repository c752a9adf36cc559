"""Where led bodies begin a step: moved on with their supports, along the surfaces that they touch.

A step that drags a body begins from the last state with other prescribed values. Newton's first step, with the contact of
that state, shears what sticks by the whole way, and what follows from that is far from where the body comes to. A body whose
prescribed components all move by one vector 𝐰 goes with it instead, but for directions that contact opposes. Where the way
along these is less than a facet Newton's method does without, and what carries a body that contact alone holds waits for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.law import OPEN
from dolfinx_mortar_al.reductions import max_over, sum_over

__all__ = ["lead"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

OPPOSES = 0.1  # of the pressures act along a direction that contact opposes; .3 is as good (docs/newton.md)
ALIKE = 1e-6  # of a way: so much prescribed components of one piece may differ


def lead(bodies: Bodies, pairs: Sequence[ContactPair], touched: Sequence[Bool]) -> None:
    """Move pieces that their supports lead, and that are in contact, with them along the surfaces they touch (collective).

    Args:
        bodies: with the displacements of the last state, or predicted ones, and prescribed values that these miss.
        pairs: in the last state; touched: of each (pieces,) which pieces it acts on.
    """
    ways = _ways(bodies)
    if not ways.any():
        return
    mine, least = np.zeros((bodies.pieces, bodies.gdim, bodies.gdim)), np.zeros(bodies.pieces)
    waiting = bodies.floating() & ~ways.any(axis=1)
    for pair, pieces in zip(pairs, touched, strict=True):
        mine[pieces] += _pressed(pair)
        np.maximum(least, np.inf if (pieces & waiting).any() else pair.target.size, out=least, where=pieces)
    opposed = sum_over(bodies.comm, mine)
    total = np.trace(opposed, axis1=1, axis2=2)
    share, axes = np.linalg.eigh(opposed / np.maximum(total, 1e-300)[:, None, None])
    along = np.einsum("pik,pi->pk", axes, ways) * (share <= OPPOSES)
    along[(total == 0.0) | (np.linalg.norm(along, axis=1) <= least)] = 0.0
    if along.any():
        ways = np.einsum("pik,pk->pi", axes, along)
        bodies.set(bodies.get() + ways[bodies.piece_of_dof[:: bodies.gdim]].ravel())


def _ways(bodies: Bodies) -> Array:
    """(pieces, gdim) by which way (m) each piece's prescribed components still have to move, 0 where they do not agree."""
    d, piece = bodies.gdim, bodies.piece_of_dof[:: bodies.gdim]
    way, given = -bodies.unmet().reshape(-1, d), bodies.prescribed().reshape(-1, d)
    mine = np.zeros((2, bodies.pieces, d))
    np.add.at(mine[0], piece, way)
    np.add.at(mine[1], piece, given)
    total, count = sum_over(bodies.comm, mine)
    mean = total / np.maximum(count, 1.0)
    off = np.zeros(bodies.pieces)
    np.maximum.at(off, piece, np.abs(np.where(given, way - mean[piece], 0.0)).max(axis=1, initial=0.0))
    agree = max_over(bodies.comm, off) <= ALIKE * np.abs(mean).max(axis=1)
    return np.asarray(np.where(agree[:, None], mean, 0.0))


def _pressed(pair: ContactPair) -> Array:
    """(gdim, gdim) Σ p 𝛎 ⊗ 𝛎 over this rank's closed points, weighted by area (N)."""
    closed = pair.state.status != OPEN
    ν, force = pair.at.ν[closed], (pair.j * pair.state.p)[closed]
    return np.asarray(np.einsum("n,ni,nj->ij", np.maximum(force, 0.0), ν, ν))
