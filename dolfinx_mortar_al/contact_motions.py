"""What contact feels of displacements of the bodies, such as rigid motions: which it holds, and which rub or slide.

Velocities of contactor points relative to what they face, as the mean of their products over an area or over contact forces.
Ties (`ties`) ask for them where contact alone holds a body.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.law import OPEN, SLIP, STICK
from dolfinx_mortar_al.reductions import sum_over

__all__ = ["ContactMotions"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]
Index = NDArray[np.int64]

ROLLS = 0.01  # share of the squares of velocities along surfaces below which a motion is a rolling


class ContactMotions:
    """Motions of the bodies as their contact pairs see them, in the present state. All is collective.

    Args:
        bodies: all of them.
        pairs: of a problem.
        touched: of each pair (pieces,) which pieces it acts on.
    """

    def __init__(self, bodies: Bodies, pairs: Sequence[ContactPair], touched: Sequence[Bool]) -> None:
        self._bodies, self._pairs = bodies, pairs
        self._touched: Array = np.array(touched, dtype=float).reshape(-1, bodies.pieces)

    def on_pieces(self, values: Sequence[float] | Bool) -> Array:
        """(pieces,) the sum over the pairs that touch each piece of one value per pair."""
        return np.asarray(np.array(values) @ self._touched)

    def turns(self) -> Array:
        """(pieces,) by how much the surfaces of the pairs that touch each piece turn over a facet (rad), less what friction
        can make up for, in the mean over the contact forces."""
        pressing = np.maximum([pair.pressing() for pair in self._pairs], 0.0)  # points that pull may still be closed
        turns = np.array([pair.largest_turn - 2.0 * np.arctan(pair.friction_coefficient) for pair in self._pairs])
        mean = self.on_pieces(pressing * turns) / np.maximum(self.on_pieces(pressing), 1e-300)
        return np.maximum(mean, 0.0)

    def _relative(self, motions: Array) -> list[Array]:
        """(n, motions, gdim) velocities of each pair's points relative to what they face that displacements (owned dofs,
        motions) bring about."""
        u, here = self._bodies.get(), [pair.apart() for pair in self._pairs]
        there = []
        for m in motions.T:
            self._bodies.set(u + m)
            there.append([pair.apart() - x for pair, x in zip(self._pairs, here, strict=True)])
        self._bodies.set(u)
        for pair in self._pairs:
            pair.apart()
        return [np.stack(v, axis=1) for v in zip(*there, strict=True)]

    def _along(self, motions: Array) -> list[Array]:
        """(n, motions, gdim) what of these velocities goes along surfaces with friction, for each pair."""
        along = []
        for pair, v in zip(self._pairs, self._relative(motions), strict=True):
            ν = pair.at.ν[:, None]
            along.append(v - np.sum(v * ν, axis=2, keepdims=True) * ν if pair.friction else np.zeros_like(v))
        return along

    # ---------------------------------------------------------------- friction

    def rubbing(self, motion: Array) -> Array:
        """(pieces,) mean square over the contact forces on each piece of the velocities along surfaces with friction that a
        displacement (owned dofs,) is."""
        rubbed, pressed = [], []
        for pair, v in zip(self._pairs, self._along(motion[:, None]), strict=True):
            force = pair.j * pair.state.p
            rubbed.append(float(np.sum(force * np.sum(v**2, axis=(1, 2)))))
            pressed.append(float(np.sum(force)))
        sums = sum_over(self._bodies.comm, np.array([rubbed, pressed]))
        squares, forces = (self.on_pieces(list(each)) for each in sums)
        return squares / np.maximum(forces, 1e-300)

    def that_undo_slip(self, motions: Array) -> Array:
        """(motions,) amounts of displacements (owned dofs, motions) that undo, by least squares over the contact forces, how
        far surfaces with friction have slid in this step; rollings undo nothing."""
        n = motions.shape[1]
        A: Array = np.zeros((n, n))
        b: Array = np.zeros(n)
        for pair, v in zip(self._pairs, self._along(motions), strict=True):
            force = pair.j * pair.state.p
            A += np.einsum("n,nkd,nld->kl", force, v, v)
            b -= np.einsum("n,nkd,nd->k", force, v, pair.slid())
        A, b = (sum_over(self._bodies.comm, part) for part in (A, b))
        return np.asarray(np.linalg.pinv(A, rcond=ROLLS, hermitian=True) @ b)

    def slip_and_stick(self) -> tuple[Index, Index]:
        """(pairs,) and (pairs,) how many points of each pair slip, and how many stick."""
        states = [pair.state.status for pair in self._pairs]
        counts = np.array([[np.sum(s == k) for s in states] for k in (SLIP, STICK)]).reshape(2, -1)
        slip, stick = sum_over(self._bodies.comm, counts)
        return slip, stick

    # ---------------------------------------------------------------- what is held

    def held_by_touch(self, motions: Array) -> Array:
        """(motions, motions) mean over the area that faces a target of 𝐦⊗𝐦 where it touches, the relative velocities that
        displacements (owned dofs, motions) are, of which without friction the normal parts count."""
        total, faced = np.zeros((motions.shape[1],) * 2), 0.0
        for pair, v in zip(self._pairs, self._relative(motions), strict=True):
            area = pair.j * pair.at.facing * np.any(v, axis=(1, 2))
            if not pair.friction:
                v = _normal(pair, v)
            total += np.einsum("n,nkd,nld->kl", area * pair.touches(), v, v)
            faced += float(area.sum())
        comm = self._bodies.comm
        return np.asarray(sum_over(comm, total) / max(sum_over(comm, faced), 1e-300))

    def held(self, slides: Bool, motions: Array) -> Array:
        """(motions, motions) sum over the pairs of such means over the area that is closed, where of pairs that slide all
        over, by `slides` (pairs,), the normal parts count."""
        total = np.zeros((motions.shape[1],) * 2)
        for pair, v, slide in zip(self._pairs, self._relative(motions), slides, strict=True):
            total += _mean(pair, _normal(pair, v) if slide else v, pair.state.status != OPEN)
        return total

    def held_by_stick(self, motions: Array) -> Array:
        """(motions, motions) sum over the pairs of the mean over the closed area of 𝐦_T⊗𝐦_T where points stick, the relative
        velocities along surfaces with friction that displacements (owned dofs, motions) are."""
        total = np.zeros((motions.shape[1],) * 2)
        for pair, v in zip(self._pairs, self._along(motions), strict=True):
            total += _mean(pair, v, pair.state.status == STICK)
        return total


def _mean(pair: ContactPair, v: Array, counts: Bool) -> Array:
    """(motions, motions) the mean over the area that is closed of 𝐯⊗𝐯, of relative velocities v (n, motions, ·), zero at
    points that do not count by `counts` (n,) (collective)."""
    closed = float(pair.j @ (pair.state.status != OPEN))
    products = np.einsum("n,nkd,nld->kl", pair.j * counts, v, v)
    return np.asarray(sum_over(pair.comm, products) / max(sum_over(pair.comm, closed), 1e-300))


def _normal(pair: ContactPair, v: Array) -> Array:
    """(n, motions, 1) the normal parts of relative velocities (n, motions, gdim)."""
    return np.asarray(np.einsum("nkd,nd->nk", v, pair.at.ν)[:, :, None])
