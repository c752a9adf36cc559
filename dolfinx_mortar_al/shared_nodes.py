"""Nodes that the contactors of several pairs share, in which their multipliers have no part.

Where a body touches two obstacles with a corner and sticks to both, the multipliers of both hold its node still, and what
each of them bears there is undetermined: the system is singular. So it is without friction where a face is cut in two
surfaces. As at the cross points of mortar methods for decomposed domains (C. Bernardi, Y. Maday and A. T. Patera, 1994)
multipliers have no node of their own there, and are extrapolated from the facet's other nodes (``docs/projection.md``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.reductions import any_over, max_over
from dolfinx_mortar_al.surface import ASKEW, SHARP, Facets
from dolfinx_mortar_al.targets import Target

__all__ = ["SharedNodes"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

TOUCHING = 0.1  # of a facet: nodes farther from a target are not in contact with it, but in front of it


class Sharer(Protocol):
    """What is asked of a contact pair."""

    comm: MPI.Intracomm
    friction: bool
    facets: Facets
    multiplier_order: int
    target: Target

    def near(self, share: float) -> Bool:
        """(nf, nodes) which of the contactor's nodes lie within a share of their facet's length from the target."""

    def held(self) -> Bool:
        """(nf, nodes) nodes at which supports leave the multiplier nothing to enforce."""

    def leave_out_shared(self, nodes: Bool) -> None:
        """Let the multiplier have no part in these of its nodes (nf, nodes), and in all others that are shared."""


class SharedNodes:
    """Nodes in which the multipliers of two pairs may hold the same components of the displacement (collective).

    Args:
        pairs: of a problem. Multipliers of a lower order than the displacement leave it enough between its corners; two
            without friction hold different components where their surfaces meet at a sharp angle; a surface in contact with
            itself is near its target everywhere, whatever it touches.
    """

    def __init__(self, pairs: Sequence[Sharer]) -> None:
        others = [pair for pair in pairs if not pair.target.is_contactor]
        equal = [pair for pair in others if pair.multiplier_order == pair.facets.shape.order]
        self._values = {id(pair.facets.space): fem.Function(pair.facets.space) for pair in equal}
        normals = [pair.facets.normals() for pair in equal]
        #: pairs, others, and (nf, nodes) which nodes of the first are the other's, too
        self._couples: list[tuple[Sharer, Sharer, Bool]] = []
        for pair, mine in zip(equal, normals, strict=True):
            for other, theirs in zip(equal, normals, strict=True):
                if other is pair or other.facets.space is not pair.facets.space:
                    continue
                across = self._on_facets(pair, other, theirs)
                size, along = np.linalg.norm(across, axis=2), np.einsum("fai,fai->fa", across, mine)
                shared = size > 0.0 if pair.friction or other.friction else along > SHARP * size
                if any_over(pair.comm, shared.any()):
                    self._couples.append((pair, other, np.asarray(shared)))

    def leave_out(self, everywhere: bool) -> None:
        """Let multipliers have no part in nodes that they share with others, where both touch their targets, or `everywhere`
        that surfaces of two targets meet of which one is rigid; but a facet keeps one node, if it can one that no pair before
        has kept."""
        pairs = {id(pair): pair for pair, _, _ in self._couples}
        near = {
            k: np.ones(pair.facets.dofs.shape, dtype=bool) if everywhere else pair.near(TOUCHING)
            for k, pair in pairs.items()
        }
        out = {k: np.zeros(pair.facets.dofs.shape, dtype=bool) for k, pair in pairs.items()}
        for pair, other, shared in self._couples:
            theirs = near[id(pair)] & shared & self._marked(pair, other, near[id(other)])
            if everywhere:  # but not all over a surface that both have
                common = np.isin(pair.facets.entities, other.facets.entities)[:, None]
                theirs &= ~self._marked(pair, pair, common & np.ones_like(theirs))
                theirs &= pair.target.is_rigid or other.target.is_rigid
            out[id(pair)] |= theirs
        kept: list[tuple[Sharer, Bool]] = []
        for k, pair in pairs.items():
            mine = self._kept(pair, out[k], kept)
            pair.leave_out_shared(out[k] & ~mine)
            kept.append((pair, mine))

    def _kept(self, pair: Sharer, out: Bool, before: Sequence[tuple[Sharer, Bool]]) -> Bool:
        """(nf, nodes) of the nodes `out` (nf, nodes) of a pair one on each facet of which all would be out, or have nothing
        to enforce. Which one does not hang on the ranks' parts of the mesh."""
        held, along = pair.held(), pair.facets.X @ ASKEW[: pair.facets.X.shape[-1]]
        far = 2.0 * max_over(pair.comm, float(np.abs(along).max(initial=0.0)))
        taken = np.any([np.zeros_like(out), *(self._marked(pair, *one) for one in before)], axis=0)
        score = np.where(out & ~held, along + far * taken, np.inf)
        first = score.argmin(axis=1)[:, None] == np.arange(out.shape[1])
        return self._marked(pair, pair, first & out & ~held & (out | held).all(axis=1, keepdims=True))

    def _marked(self, pair: Sharer, other: Sharer, nodes: Bool) -> Bool:
        """(nf, nodes) which nodes of a pair are among `nodes` (nf, nodes) of another."""
        marks = np.zeros((*nodes.shape, pair.facets.X.shape[-1]))
        marks[nodes, 0] = 1.0
        return np.asarray(self._on_facets(pair, other, marks)[..., 0] > 0)

    def _on_facets(self, pair: Sharer, other: Sharer, values: Array) -> Array:
        """(nf, nodes, gdim) at a pair's nodes the sums over facets of another's values (nf, nodes, gdim), of all ranks."""
        field = self._values[id(pair.facets.space)]
        field.x.array[:] = 0.0
        nodal = field.x.array.reshape(-1, values.shape[-1])
        np.add.at(nodal, other.facets.dofs, values)
        field.x.scatter_reverse(InsertMode.add)
        field.x.scatter_forward()
        return np.asarray(nodal[pair.facets.dofs])
