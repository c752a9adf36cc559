"""Ties of pieces that contact alone holds and that nothing keeps from sliding (``docs/newton.md``).

A body squeezed between flat plates may lie anywhere along them, and what pressures leave along the plates, an error of the
mesh, has nothing to resist it: as a rule there is no equilibrium. So such a piece is tied to where it was in the last one,

    𝐟 = ∑ κ 𝐦 (𝐦·(𝐮 − 𝐚)),

with the rigid motions 𝐦 that next to nothing resists, orthonormal over the nodes, so that a tie bears a slide and nothing
else. When Newton has converged the piece is tied to where it is then, and the solve goes on: where something does resist the
slide the tie bears less each time; where nothing does it bears the same again.

What friction or a plane of symmetry holds needs no tie but at the start, where a pin, say, touches its hole at a point and
nothing is pressed yet: if a first solve fails it is tied until Newton has converged.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.pieces import rigid_motions

__all__ = ["Ties"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STIFFNESS = 0.1  # of a tie, as a share of what a piece resists a deformation of its own size with
NEUTRAL = 0.1  # share of a tie below which what resists a motion leaves it free
HELD = 1e-6  # norm over prescribed components of a rigid motion, one in the mean over the nodes, that is let be
SAME = 0.1  # difference of two projections onto motions that count as the same
WEAK = 1e-6  # share of a tie that springs at the nodes have, which make the sparse Jacobian regular,
WEAK_TO_MULTIGRID = 1e-3  # where multigrid inverts it


class Ties:
    """Ties of the pieces that contact alone holds, along the rigid motions that conditions let be.

    Args:
        bodies: all of them.
        diagonal: (owned dofs,) of the bodies' stiffness (N/m), 0 where nothing is to be tied.
        resisted: (pieces,) of which some component is prescribed, or which touch something with friction. Those are tied only
            if a first solve insists, until Newton has converged.

    Attributes:
        anchor: (owned dofs,) displacement where the ties bear nothing (m).
        resistance: (pieces, motions, motions) to the rigid motions of each piece in the last equilibrium (N/m), 0 where that
            is not known.
        insists: whether a first solve ties what is `resisted`, too.
        borne: (pieces,) what ties bear in the last equilibrium, as a share of the contact forces.
        motions, stiffness, piece: (ties, owned dofs), (ties,) in N/m and (ties,) of the ties in use.
    """

    def __init__(self, bodies: Bodies, diagonal: Array, resisted: NDArray[np.bool_]) -> None:
        self._bodies, d = bodies, bodies.gdim
        self._piece, self._prescribed = bodies.piece_of_dof[::d], bodies.prescribed().reshape(-1, d)
        each = np.stack([np.ones(len(self._piece)), diagonal.reshape(-1, d).mean(axis=1)])
        count, total = bodies.comm.allreduce(self._by_piece(each.T), MPI.SUM).T
        self._nodes = np.maximum(count, 1.0)
        # n springs of k at n nodes: k n^(2/d) is what a body resists a deformation of its size with, k its nodes' stiffness
        self._k = STIFFNESS * total / self._nodes ** (1.0 + 2.0 / d)
        self._all: Index = np.flatnonzero(self._k)
        self._pieces: Index = np.flatnonzero((self._k > 0) & ~resisted)
        self.insists = False
        m = 3 * (d - 1)
        self.anchor: Array = bodies.get()
        self.resistance: Array = np.zeros((bodies.pieces, m, m))
        self.borne: Array = np.zeros(bodies.pieces)
        self._free = np.zeros_like(self.resistance)  # projects onto the motions that are tied
        self.motions: Array = np.zeros((0, len(diagonal)))
        self.stiffness: Array = np.zeros(0)
        self.piece: Index = np.zeros(0, dtype=np.int64)

    @property
    def acts(self) -> bool:
        """Whether anything is tied."""
        return len(self.stiffness) > 0

    @property
    def leaves_out(self) -> bool:
        """Whether some pieces are tied only if a solve insists."""
        return len(self._pieces) < len(self._all)

    def _by_piece(self, values: Array) -> Array:
        """(pieces, ...) sums of nodal values (owned nodes, ...) of this rank."""
        total = np.zeros((self._bodies.pieces, *values.shape[1:]))
        np.add.at(total, self._piece, values)
        return total

    # ---------------------------------------------------------------- which motions

    def engage(self, *, everything: bool = False) -> bool:
        """Tie motions that next to nothing resists, or all; whether they are others than before (collective)."""
        before, self._free = self._free, np.zeros_like(self._free)
        pieces = self._all if everything and self.insists else self._pieces
        rows, piece = [np.zeros((0, self.anchor.size))], [np.zeros(0, dtype=np.int64)]
        R = self._rigid_motions() if len(pieces) else np.zeros(0)
        for p, free in zip(pieces, self._admissible(R, pieces) if everything else self._soft(pieces), strict=True):
            self._free[p] = free @ free.T
            mine = (self._piece == p)[:, None, None] * R @ free / np.sqrt(self._nodes[p])
            rows.append(mine.reshape(self.anchor.size, -1).T)
            piece.append(np.full(free.shape[1], p))
        self.motions, self.piece = np.concatenate(rows), np.concatenate(piece)
        self.stiffness = self._k[self.piece]
        return bool(np.abs(self._free - before).max(initial=0.0) > SAME)

    def _soft(self, pieces: Index) -> list[Array]:
        """(motions, ·) of each of the pieces an orthonormal basis of the rigid motions that next to nothing resists."""
        resistance = self.resistance[pieces]
        share, axes = np.linalg.eigh((resistance + np.swapaxes(resistance, 1, 2)) / 2)
        soft = (share < NEUTRAL * self._k[pieces, None]) & np.any(resistance, axis=(1, 2), keepdims=True)[:, :, 0]
        return [v[:, free] for v, free in zip(axes, soft, strict=True)]

    def _admissible(self, R: Array, pieces: Index) -> list[Array]:
        """(motions, ·) of each of the pieces an orthonormal basis of those rigid motions R that its conditions let be
        (collective)."""
        if not len(pieces):
            return []
        fixed = R * self._prescribed[:, :, None]
        gram = self._bodies.comm.allreduce(self._by_piece(np.swapaxes(fixed, 1, 2) @ fixed), MPI.SUM)
        square, axes = np.linalg.eigh(gram[pieces])
        return [v[:, s < HELD**2] for s, v in zip(square, axes, strict=True)]

    def measure(self, response: Callable[[Array], Array]) -> None:
        """What resists rigid motions: from the displacements that nodal forces (owned dofs,) lead to (collective)."""
        if not len(self._pieces):
            return
        R = self._rigid_motions()
        for p in self._pieces:
            m = ((self._piece == p)[:, None, None] * R / np.sqrt(self._nodes[p])).reshape(self.anchor.size, -1)
            flexibility = m.T @ np.stack([response(column) for column in m.T], axis=1)
            self.resistance[p] = np.linalg.pinv(self._bodies.comm.allreduce(flexibility, MPI.SUM))

    def _rigid_motions(self) -> Array:
        """(owned nodes, gdim, motions) of the piece that each node is of, at the present positions, orthonormal in the mean
        over the piece's nodes (collective)."""
        b, d = self._bodies, self._bodies.gdim
        x = b.owned_positions() + b.get().reshape(-1, d)
        x = x - (b.comm.allreduce(self._by_piece(x), MPI.SUM) / self._nodes[:, None])[self._piece]
        R = rigid_motions(x)
        gram = b.comm.allreduce(self._by_piece(np.swapaxes(R, 1, 2) @ R), MPI.SUM) / self._nodes[:, None, None]
        square, axes = np.linalg.eigh(gram)
        root = np.sqrt(np.maximum(square, 1e-300))
        return np.asarray(R @ ((axes / root[:, None]) @ np.swapaxes(axes, 1, 2))[self._piece])

    # ---------------------------------------------------------------- forces

    def times(self, values: Array) -> Array:
        """(ties,) of nodal values (owned dofs,) along the motions (collective)."""
        return np.asarray(self._bodies.comm.allreduce(self.motions @ values, MPI.SUM))

    def forces(self) -> Array:
        """(owned dofs,) of the ties (N), collective."""
        return self.pull(self._bodies.get() - self.anchor)

    def pull(self, u: Array) -> Array:
        """(owned dofs,) forces (N) of the ties in use for displacements u (owned dofs,), collective."""
        return (self.stiffness * self.times(u)) @ self.motions if self.acts else np.zeros_like(u)

    def along(self, forces: Array) -> Array:
        """(pieces,) resultant (N) of nodal forces (owned dofs,) along the tied motions at the present positions
        (collective)."""
        f = forces.reshape(len(self._piece), -1)
        total = self._bodies.comm.allreduce(self._by_piece(np.einsum("nim,ni->nm", self._rigid_motions(), f)), MPI.SUM)
        return np.asarray(np.linalg.norm((self._free @ total[:, :, None])[:, :, 0], axis=1))

    def springs(self, *, multigrid: bool) -> Array:
        """(owned nodes, gdim, gdim) stiffness (N/m) of weak springs at the nodes, along the motions: weaker for factors than
        for `multigrid`."""
        weak = WEAK_TO_MULTIGRID if multigrid else WEAK
        m = self.motions.reshape(-1, len(self._piece), self._bodies.gdim)
        return np.asarray(np.einsum("a,ani,anj->nij", weak * self.stiffness * self._nodes[self.piece], m, m))

    # ---------------------------------------------------------------- steps

    def move(self, on: float) -> None:
        """Tie the pieces to where they are, and `on` times as far from where they were tied to."""
        u = self._bodies.get()
        self.anchor = u + on * (u - self.anchor)

    def snapshot(self) -> dict[str, Array]:
        """What a step may change."""
        return {"anchor": self.anchor.copy(), "resistance": self.resistance.copy(), "borne": self.borne.copy()}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        self.anchor, self.resistance = saved["anchor"].copy(), saved["resistance"].copy()
        self.borne = saved["borne"].copy()
