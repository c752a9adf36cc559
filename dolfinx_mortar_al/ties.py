"""Ties of pieces that contact alone holds, along what nothing resists (``docs/newton.md``).

A body squeezed between flat plates may lie anywhere along them, a wheel may roll along its track, and what pressures leave
along the plates, an error of the mesh, has nothing to resist it: as a rule there is no equilibrium. So such a piece is tied
to where it was in the last one,

    𝐟 = ∑ κ 𝐦 (𝐦·(𝐮 − 𝐚)),

with the rigid motions 𝐦 that next to nothing resists, orthonormal over the nodes, so that a tie bears a slide and nothing
else. When Newton has converged the piece is tied to where it is then, and the solve goes on: where something does resist the
slide the tie bears less each time; where nothing does it bears the same again.

Before the first equilibrium nothing is pressed: tied are the motions that what touches could not hold.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.pieces import rigid_motions
from dolfinx_mortar_al.reductions import sum_over

__all__ = ["Bearing", "Ties"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

STIFFNESS = 0.1  # of a tie, as a share of what a piece resists a deformation of its own size with
NEUTRAL = 0.1  # share of a tie below which what resists a motion leaves it free
DEFORMS = 0.1  # of a motion, root mean square: where bodies deform by more, their stiffness resists,
GEOMETRIC = 3.0  # unless it is less than so many times the contact forces over the piece's size, as flat zones resist
RUBS = (
    0.1  # of a motion, in the mean over the contact forces: what goes along surfaces with friction if it is no rolling
)
HOLDS = 0.1  # of a motion's square, in the mean over what faces each other, from which on what touches holds it
HELD = 1e-6  # norm over prescribed components of a rigid motion, one in the mean over the nodes, that is let be
SAME = 0.1  # difference of two projections onto motions that count as the same
WEAK = 1e-6  # share of a tie that springs at the nodes have, which make the sparse Jacobian regular,
WEAK_TO_MULTIGRID = 1e-3  # where multigrid inverts it
HISTORY = ("anchor", "resistance", "rubbing", "slipping", "borne")


class Bearing(NamedTuple):
    """What ties bear, by pieces.

    Attributes:
        along: (pieces, motions) along the motions of each piece (N).
        borne: (pieces,) their norm, as a share of `most`.
        most: (pieces,) the largest contact forces on each piece in this solve, or what loads push with, if that is more (N).
        alone: (pieces,) whether it is more than half of the present ones: one side alone presses the piece against its tie.
        pushed: (pieces,) what loads push with along the same motions, as the share that `borne` is.
        rubs: (pieces,) whether friction could bear it.
    """

    along: Array
    borne: Array
    most: Array
    alone: Flags
    pushed: Array
    rubs: Flags


class Ties:
    """Ties of the pieces that contact alone holds, along the rigid motions that conditions let be.

    Args:
        bodies: all of them.
        diagonal: (owned dofs,) of the bodies' stiffness (N/m), 0 where nothing is to be tied.

    Attributes:
        anchor: (owned dofs,) displacement where the ties bear nothing (m).
        resistance: (pieces, motions, motions) to the rigid motions of each piece in the last equilibrium (N/m), at least a
            tie's where it is a stiffness that resists; 0 where that is not known.
        rubbing: (pieces, motions, motions) share of each motion's square that goes along surfaces with friction.
        tied: (pieces,) which contact alone holds.
        slipping: (pieces,) which loads push along such surfaces beyond what friction bears: they are not tied along them.
        let_be: (pieces,) which are not tied in this solve.
        borne: (pieces,) what ties bear in the last equilibrium, as a share of the contact forces.
        motions, stiffness, piece: (ties, owned dofs), (ties,) in N/m and (ties,) of the ties in use.
    """

    def __init__(self, bodies: Bodies, diagonal: Array) -> None:
        self._bodies, d = bodies, bodies.gdim
        self._piece, self._prescribed = bodies.piece_of_dof[::d], bodies.prescribed().reshape(-1, d)
        each = np.stack([np.ones(len(self._piece)), diagonal.reshape(-1, d).mean(axis=1)])
        count, total = sum_over(bodies.comm, self._by_piece(each.T)).T
        self._nodes = np.maximum(count, 1.0)
        # n springs of k at n nodes: k n^(2/d) is what a body resists a deformation of its size with, k its nodes' stiffness
        self._k = STIFFNESS * total / self._nodes ** (1.0 + 2.0 / d)
        self.tied: Flags = self._k > 0.0
        self._pieces = [int(p) for p in np.flatnonzero(self.tied)]
        m = 3 * (d - 1)
        self.anchor: Array = bodies.get()
        self.resistance: Array = np.zeros((bodies.pieces, m, m))
        self.rubbing: Array = np.zeros_like(self.resistance)
        self.slipping: Flags = np.zeros(bodies.pieces, dtype=bool)
        self.let_be: Flags = np.zeros(bodies.pieces, dtype=bool)
        self.borne: Array = np.zeros(bodies.pieces)
        self._free = np.zeros_like(self.resistance)  # projects onto the motions that are tied
        self.motions: Array = np.zeros((0, len(diagonal)))
        self.stiffness: Array = np.zeros(0)
        self.piece: Index = np.zeros(0, dtype=np.int64)

    @property
    def acts(self) -> bool:
        """Whether anything is tied."""
        return len(self.stiffness) > 0

    def _by_piece(self, values: Array) -> Array:
        """(pieces, ...) sums of nodal values (owned nodes, ...) of this rank."""
        total = np.zeros((self._bodies.pieces, *values.shape[1:]))
        np.add.at(total, self._piece, values)
        return total

    # ---------------------------------------------------------------- which motions

    def begin(self, holding: Callable[[Array], Array] | None) -> None:
        """A solve begins: tie motions that next to nothing resisted in the last equilibrium, or before the first one those
        that what touches does not hold: of the squares of motions (owned dofs, motions) `holding` gives the mean of what it
        holds, (motions, motions) (collective)."""
        self.borne[:], self.let_be[:] = 0.0, False
        if holding is None:
            self.engage()
        else:
            self.slipping[:] = False
            R, admissible = self._admissible()
            self._tie(
                R, [self._unheld(R, p, basis, holding) for p, basis in zip(self._pieces, admissible, strict=True)]
            )

    def engage(self) -> bool:
        """Tie motions that next to nothing resists; whether they are others than before (collective)."""
        before = self._free
        R, admissible = self._admissible()
        self._tie(R, [self._soft(p, basis) for p, basis in zip(self._pieces, admissible, strict=True)])
        return bool(np.abs(self._free - before).max(initial=0.0) > SAME)

    def _tie(self, R: Array, free: list[Array]) -> None:
        """Tie the pieces along combinations of the rigid motions R, (motions, ·) orthonormal for each of them."""
        self._free = np.zeros_like(self.resistance)
        along: list[Array] = [np.zeros((self.anchor.size, 0))]
        for p, f in zip(self._pieces, free, strict=True):
            self._free[p] = f @ f.T
            along.append(self._of(p, R) @ f)
        self.motions = np.concatenate(along, axis=1).T.copy()
        self.piece = np.repeat(np.array(self._pieces, dtype=np.int64), [f.shape[1] for f in free])
        self.stiffness = self._k[self.piece]

    def _soft(self, p: int, basis: Array) -> Array:
        """(motions, ·) an orthonormal basis of those motions of a piece, out of a `basis`, that next to nothing resists."""
        resistance = self.resistance[p]
        if self.let_be[p] or not resistance.any():
            return np.zeros((len(basis), 0))
        if self.slipping[p]:
            resistance = resistance + NEUTRAL * self._k[p] / RUBS**2 * self.rubbing[p]
        share, axes = np.linalg.eigh(basis.T @ (resistance + resistance.T) @ basis / 2)
        return np.asarray(basis @ axes[:, share < NEUTRAL * self._k[p]])

    def _unheld(self, R: Array, p: int, basis: Array, holding: Callable[[Array], Array]) -> Array:
        """(motions, ·) an orthonormal basis of those of the motions R of a piece, out of a `basis`, that what touches does
        not hold (collective)."""
        if not basis.size:
            return basis
        share, axes = np.linalg.eigh(self._nodes[p] * holding(self._of(p, R) @ basis))
        return np.asarray(basis @ axes[:, share < HOLDS])

    def _admissible(self) -> tuple[Array, list[Array]]:
        """The rigid motions of :meth:`_rigid_motions`, and for each of the pieces (motions, ·) an orthonormal basis of those
        that its conditions let be (collective)."""
        if not self._pieces:
            return np.zeros(0), []
        R = self._rigid_motions()
        fixed = R * self._prescribed[:, :, None]
        gram = sum_over(self._bodies.comm, self._by_piece(np.swapaxes(fixed, 1, 2) @ fixed))
        square, axes = np.linalg.eigh(gram[self._pieces])
        return R, [v[:, s < HELD**2] for s, v in zip(square, axes, strict=True)]

    def _of(self, p: int, R: Array) -> Array:
        """(owned dofs, motions) the rigid motions R of a piece, orthonormal over its nodes."""
        return ((self._piece == p)[:, None, None] * R / np.sqrt(self._nodes[p])).reshape(self.anchor.size, -1)

    def measure(self, response: Callable[[Array], Array], rubbing: Callable[[Array], Array], pressed: Array) -> None:
        """What resists rigid motions, from the displacements that nodal forces (owned dofs,) lead to, where each piece is
        `pressed` with so much, (pieces,) in N; and of the squares of motions (owned dofs, motions) the mean of what goes
        along surfaces with friction, (motions, motions) (collective)."""
        R, admissible = self._admissible()
        held = np.ones(len(self._nodes), dtype=bool)  # in place
        held[[p for p, basis in zip(self._pieces, admissible, strict=True) if basis.size]] = False
        geometric = GEOMETRIC * pressed / np.maximum(self._sizes() * self._nodes, 1e-300)
        for p, basis in zip(self._pieces, admissible, strict=True):
            if not basis.size:
                continue
            m = self._of(p, R) @ basis
            u = np.stack([response(column) for column in m.T], axis=1)
            resistance = np.linalg.pinv(sum_over(self._bodies.comm, m.T @ u))
            resists, axes = np.linalg.eigh((resistance + resistance.T) / 2)
            u = np.sqrt(self._nodes[p]) * u @ resistance @ axes
            deformed = self._deformation(R, admissible, u) > DEFORMS**2
            stiff = deformed[held].any(axis=0) | (deformed.any(axis=0) & (resists > geometric[p]))
            resists[stiff] = np.maximum(resists[stiff], self._k[p])
            self.resistance[p] = basis @ (axes * resists) @ axes.T @ basis.T
            self.rubbing[p] = self._nodes[p] * basis @ rubbing(m) @ basis.T

    def _deformation(self, R: Array, admissible: list[Array], u: Array) -> Array:
        """(pieces, n) mean square over each piece's nodes of what displacements u (owned dofs, n) are beside those of its
        rigid motions R that its conditions let be (collective)."""
        u = u.reshape(len(self._piece), -1, u.shape[1])
        mean = sum_over(self._bodies.comm, self._by_piece(np.swapaxes(R, 1, 2) @ u)) / self._nodes[:, None, None]
        rigid = np.zeros_like(mean)
        for p, basis in zip(self._pieces, admissible, strict=True):
            rigid[p] = basis @ (basis.T @ mean[p])
        square = self._by_piece(((u - R @ rigid[self._piece]) ** 2).sum(axis=1))
        return np.asarray(sum_over(self._bodies.comm, square) / self._nodes[:, None])

    def _offsets(self) -> Array:
        """(owned nodes, gdim) of the nodes from the middle of their piece, at the present positions (m, collective)."""
        b, d = self._bodies, self._bodies.gdim
        x = b.owned_positions() + b.get().reshape(-1, d)
        return np.asarray(x - (sum_over(b.comm, self._by_piece(x)) / self._nodes[:, None])[self._piece])

    def _sizes(self) -> Array:
        """(pieces,) distance of a piece's nodes from its middle, root of the mean square (m, collective)."""
        square = self._by_piece((self._offsets() ** 2).sum(axis=1))
        return np.asarray(np.sqrt(sum_over(self._bodies.comm, square) / self._nodes))

    def _rigid_motions(self) -> Array:
        """(owned nodes, gdim, motions) of the piece that each node is of, at the present positions, orthonormal in the mean
        over the piece's nodes (collective)."""
        b = self._bodies
        # rotations about as large as translations, whatever the unit of length, for the eigenvalues to be told from round-off
        R = rigid_motions(self._offsets() / np.maximum(self._sizes(), 1e-300)[self._piece][:, None])
        gram = sum_over(b.comm, self._by_piece(np.swapaxes(R, 1, 2) @ R)) / self._nodes[:, None, None]
        square, axes = np.linalg.eigh(gram)
        root = np.sqrt(np.maximum(square, 1e-300))
        return np.asarray(R @ ((axes / root[:, None]) @ np.swapaxes(axes, 1, 2))[self._piece])

    # ---------------------------------------------------------------- forces

    def times(self, values: Array) -> Array:
        """(ties,) of nodal values (owned dofs,) along the motions (collective)."""
        return np.asarray(sum_over(self._bodies.comm, self.motions @ values))

    def forces(self) -> Array:
        """(owned dofs,) of the ties (N), collective."""
        return self.pull(self._bodies.get() - self.anchor)

    def pull(self, u: Array) -> Array:
        """(owned dofs,) forces (N) of the ties in use for displacements u (owned dofs,), collective."""
        return (self.stiffness * self.times(u)) @ self.motions if self.acts else np.zeros_like(u)

    def along(self, forces: Array) -> Array:
        """(pieces, motions) of nodal forces (owned dofs,) what acts along the tied motions, at the present positions (N,
        collective)."""
        f = forces.reshape(len(self._piece), -1)
        total = sum_over(self._bodies.comm, self._by_piece(np.einsum("nim,ni->nm", self._rigid_motions(), f)))
        return np.asarray((self._free @ total[:, :, None])[:, :, 0])

    def bearing(self, bulk: Array, most: Array, present: Array, noise: Array) -> Bearing:
        """What ties bear where `bulk` (owned dofs,) are the bodies' forces with those of ties, and the contact forces on each
        piece, present ones and the `most` of them in this solve (pieces,), in N; what is less than `noise` (pieces,) is
        nothing (collective)."""
        f = self.forces()
        borne, pushed = self.along(f), np.linalg.norm(self.along(bulk - f), axis=1)
        borne *= (np.linalg.norm(borne, axis=1) > noise)[:, None]
        size, most = np.linalg.norm(borne, axis=1), np.maximum(np.maximum(most, pushed), 1e-300)
        rubs = np.einsum("pi,pij,pj->p", borne, self.rubbing, borne) > (RUBS * size) ** 2
        alone = (size > present / 2) & (present > 0)
        return Bearing(borne, size / most, most, alone, pushed / most, rubs)

    def springs(self, *, multigrid: bool) -> Array:
        """(owned nodes, gdim, gdim) stiffness (N/m) of weak springs at the nodes, along the motions: weaker for factors than
        for `multigrid`."""
        weak = WEAK_TO_MULTIGRID if multigrid else WEAK
        m = self.motions.reshape(-1, len(self._piece), self._bodies.gdim)
        return np.asarray(np.einsum("a,ani,anj->nij", weak * self.stiffness * self._nodes[self.piece], m, m))

    # ---------------------------------------------------------------- steps

    def motion(self, forces: Array) -> Array:
        """(owned dofs,) how far (m) the pieces are from where ties that bear `forces` (pieces, motions) hold them
        (collective)."""
        away = np.zeros_like(forces)
        away[self._pieces] = forces[self._pieces] / (self._k * self._nodes)[self._pieces, None]
        return np.asarray(np.einsum("nim,nm->ni", self._rigid_motions(), away[self._piece]).ravel())

    def move(self, bear: Array) -> None:
        """Tie the pieces to where, as they are, ties along the present motions bear so much, (pieces, motions) in N
        (collective)."""
        self.anchor = self._bodies.get() - self.motion(bear)

    def snapshot(self) -> dict[str, Array]:
        """What a step may change."""
        return {name: getattr(self, name).copy() for name in HISTORY}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        for name in HISTORY:
            setattr(self, name, saved[name].astype(getattr(self, name).dtype))
