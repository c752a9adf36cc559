"""Ties of pieces that contact alone holds, along what nothing resists (``docs/newton.md``).

A body squeezed between flat plates may lie anywhere along them, a wheel may roll along its track, a beam with the rollers
that it lies on; and what pressures leave along the plates, an error of the mesh, has nothing to resist it: as a rule there
is no equilibrium. So such pieces are tied to where they were in the last one,

    𝐟 = s ∑ 𝐦 (𝐦·(𝐮 − 𝐚)),

with the rigid motions of all pieces together that next to nothing resists, so that ties bear a slide and nothing else. For
s = 1 a tie resists with a stiffness κ what it moves of a piece. When Newton has converged the pieces are tied to where they
are then, and the solve goes on: where something does resist the slide the tie bears less each time; where nothing does it
bears the same again. Ties of pieces that loads push against others become softer each time.

Before the first equilibrium nothing is pressed: tied are the motions that what touches could not hold. Where friction gives
way in the middle of a solve, at all points of a pair, tied as well are from then on the motions that it alone held.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.pieces import rigid_motions
from dolfinx_mortar_al.reductions import max_over, sum_over

__all__ = ["PUSHED", "Bearing", "Ties"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STIFFNESS = 0.1  # of a tie, as a share of what a piece resists a deformation of its own size with
NEUTRAL = 0.1  # share of a tie below which what resists a motion leaves it free, and with the other sign drives it on
DEFORMS = 0.1  # of a motion, root mean square: where bodies deform by more, their stiffness resists,
GEOMETRIC = 3.0  # unless it is less than so many times the contact forces over the piece's size, as flat zones resist
RUBS = (
    0.1  # of a motion, in the mean over the contact forces: what goes along surfaces with friction if it is no rolling
)
SPARE = 1e-3  # of a motion's square where points stick: from 2e-3 on as columns rock, wheels roll with 4e-4 at most
HOLDS = 0.1  # of a motion's square, in the mean over what faces each other, from which on what touches holds it
RADIUS = np.sqrt(2.0)  # of a disc over its matter's root mean square distance from its middle; less of balls and rings
HELD = 1e-6  # norm over prescribed components of a rigid motion, one in the mean over the nodes, that is let be
SAME = 0.1  # difference of two projections onto motions that count as the same
WEAK = 1e-6  # share of a tie that springs at the nodes have, which make the sparse Jacobian regular,
WEAK_TO_MULTIGRID = 1e-3  # where multigrid inverts it
PUSHED = 0.01  # of the contact forces: what loads push with must be resisted by more than a tie
CLEAR = 0.03  # that share from which on it is clear of what coarse meshes push with: a tie bears but so much of it
SOFTER = 0.1  # a tie at the next place, where a load pushes its piece against others: what it bears falls tenfold, too,
SOFTEST = 1e-9  # where all points slip and a spring of a millionth of the bodies' stiffness holds
THROWN = (
    1.0  # of a piece's radius, root mean squares of both: farther from where it was expected is no equilibrium near by
)
HISTORY = ("anchor", "resistance", "elastic", "trusts", "borne")


class Bearing(NamedTuple):
    """What ties bear, by pieces.

    Attributes:
        along: (pieces, motions) along the motions of each piece (N).
        borne: (pieces,) their norm, as a share of `most`.
        most: (pieces,) the contact forces on each piece (N), or what loads push with, if that is more; where no load pushes
            the largest ones in this solve.
        share: (pieces,) for the user to know: the norm as a share of the contact forces that are, or were in the last
            equilibrium, in place of the largest ones, which on Newton's way were seen to be twenty times as large.
        alone: (pieces,) whether it is more than half of the contact forces: one side presses the piece against its tie.
        pushed: (pieces,) what loads push with along the same motions, as a share of present contact forces, at most 1.
        rubs: (pieces,) whether friction could bear it.
        ties: number of them.
    """

    along: Array
    borne: Array
    most: Array
    share: Array
    alone: Flags
    pushed: Array
    rubs: Flags
    ties: int


class Ties:
    """Ties of the pieces that contact alone holds, along the rigid motions that conditions let be.

    Args:
        bodies: all of them.
        diagonal: (owned dofs,) of the bodies' stiffness (N/m), 0 where nothing is to be tied.

    Attributes:
        anchor: (owned dofs,) displacement where the ties bear nothing (m).
        resistance: (motions, motions) of all pieces together, to their rigid motions in the last equilibrium, as a share of
            that of a tie; at least 1 where it is a stiffness that resists; 0 where that is not known.
        elastic: (motions, motions) projects onto those motions that bodies deform in, and resist.
        trusts: (1,) whether these are not tied, and count as held, however much contact presses: a state has been found in
            which they bear what ties bore.
        tied: (pieces,) which contact alone holds.
        let_be: (pieces,) which are not tied in this solve.
        borne: (pieces,) what ties bear in the last equilibrium, as a share of the contact forces (`Bearing.share`).
        motions, ways: (ties, owned dofs) of the ties in use: nodal forces 𝐦, and displacements along them.
        softness: s, as a share of a tie's stiffness.
        are_loose: whether neither they nor springs act in the next Newton step; they go where it leads.
    """

    def __init__(self, bodies: Bodies, diagonal: Array) -> None:
        self._bodies, d = bodies, bodies.gdim
        self._piece, self._prescribed = bodies.piece_of_dof[::d], bodies.prescribed().reshape(-1, d)
        self._volumes: Array = bodies.volumes()
        each = np.stack([np.ones(len(self._piece)), diagonal.reshape(-1, d).mean(axis=1)])
        count, total = sum_over(bodies.comm, self._by_piece(each.T)).T
        self._nodes = np.maximum(count, 1.0)
        # n springs of k at n nodes: k n^(2/d) is what a body resists a deformation of its size with, k its nodes' stiffness
        self._k = STIFFNESS * total / self._nodes ** (1.0 + 2.0 / d)
        self.tied: Flags = self._k > 0.0
        self._pieces = [int(p) for p in np.flatnonzero(self.tied)]
        m = 3 * (d - 1)
        self.anchor: Array = bodies.get()
        self._n = bodies.pieces * m
        self._root: Array = np.repeat(np.sqrt(self._k), m)
        self._inverse: Array = np.divide(1.0, self._root, out=np.zeros(self._n), where=self._root > 0.0)
        self.resistance: Array = np.zeros((self._n, self._n))
        self.let_be: Flags = np.zeros(bodies.pieces, dtype=bool)
        self.borne: Array = np.zeros(bodies.pieces)
        self.elastic: Array = np.zeros_like(self.resistance)
        self.trusts: Flags = np.zeros(1, dtype=bool)
        self._free: Array = np.zeros_like(self.resistance)  # projects onto the motions that are tied,
        self._basis: Array = np.zeros((self._n, 0))  # orthonormal ones
        self.motions: Array = np.zeros((0, len(diagonal)))
        self.ways: Array = np.zeros((0, len(diagonal)))
        self.softness = 1.0
        self.are_loose = False
        # where the present solve began, and (pieces,) which something held then in some direction
        self._start: Array = self.anchor
        self._was_held: Flags = np.zeros(bodies.pieces, dtype=bool)

    @property
    def acts(self) -> bool:
        """Whether anything is tied."""
        return len(self.motions) > 0

    @property
    def may_act(self) -> bool:
        """Whether there is anything that may be tied."""
        return bool(self.tied.any())

    @property
    def is_unstable(self) -> bool:
        """Whether the last equilibrium is one that a piece would leave, along a motion that it is driven on in."""
        return self._least < -NEUTRAL

    @property
    def drives_on(self) -> bool:
        """Whether anything drives a piece on in the last equilibrium, by more than springs at the nodes could."""
        return self._least < -WEAK * max(1.0, float(np.abs(self.resistance).max()))

    @property
    def _least(self) -> float:
        """What resists a motion least."""
        return float(np.linalg.eigvalsh((self.resistance + self.resistance.T) / 2)[0])

    def far(self) -> Flags:
        """(pieces,) which of those that contact alone holds are farther than their radius from where this solve began
        (collective)."""
        way = (self._bodies.get() - self._start).reshape(len(self._piece), -1)
        square = sum_over(self._bodies.comm, self._by_piece(np.sum(way**2, axis=1)))
        return self.tied & (np.sqrt(square / self._nodes) > THROWN * self._sizes())

    def has_thrown(self) -> bool:
        """Whether a piece that something held in the last equilibrium is far from where this solve began (collective)."""
        return bool((self._was_held & self.far()).any())

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
        self._renew()
        if holding is None:
            self.engage()
            return
        R, admissible = self._admissible()
        unheld = [self._unheld(R, p, basis, holding) for p, basis in zip(self._pieces, admissible, strict=True)]
        self._tie(R, self._together(unheld))

    def rest(self) -> None:
        """A solve begins in which something else resists all motions: nothing is tied (collective)."""
        self._renew()
        self._tie(np.zeros(0), np.zeros((self._n, 0)))

    def _renew(self) -> None:
        """A solve begins (collective)."""
        self.borne[:], self.let_be[:], self.softness, self.are_loose = 0.0, False, 1.0, False
        self._start = self._bodies.get()
        self._was_held = np.abs(self.resistance).reshape(self._bodies.pieces, -1).max(axis=1, initial=0.0) > NEUTRAL

    def engage(self) -> bool:
        """Tie motions that next to nothing resists; whether they are others than before (collective)."""
        before = self._free
        R, admissible = self._admissible()
        self._tie(R, self._soft(admissible))
        return bool(np.abs(self._free - before).max(initial=0.0) > SAME)

    def supports_move(self, touch: float) -> bool:
        """Whether prescribed values are others than in the last equilibrium, by more than `touch` (m), before ties have moved
        (collective)."""
        way = self._bodies.get() - self._bodies.unmet() - self.anchor
        moved = np.abs(way[self._prescribed.ravel()]).max(initial=0.0)
        return max_over(self._bodies.comm, float(moved)) > touch

    def are_spare(self, holding: Callable[[Array], Array]) -> bool:
        """Whether a Newton step may do without them: something resisted all that is not tied in the last equilibrium, and
        what is tied slides where points stick: of the squares of motions (owned dofs, motions) `holding` gives the mean of
        that, (motions, motions) (collective)."""
        if not self.acts:
            return bool(self.resistance.any())
        return self._least_held(self.ways, holding) >= SPARE

    def are_stuck(self, holding: Callable[[Array], Array]) -> bool:
        """Whether contact holds the pieces as a support would: something resists all motions in the last equilibrium, or what
        nothing resists, or what drives on, slides where points stick, and is no rolling; `holding` is as in :meth:`are_spare`
        (collective)."""
        R, admissible = self._admissible()
        soft = self._soft(admissible)
        if not soft.shape[1]:
            return bool(self.resistance.any())
        return self._least_held(self._all_of(R, self._inverse[:, None] * soft).T, holding) >= HOLDS

    def _least_held(self, ways: Array, holding: Callable[[Array], Array]) -> float:
        """The least share that `holding` gives of the squares of motions along the `ways` (motions, owned dofs)
        (collective)."""
        w = ways.reshape(len(ways), len(self._piece), -1)
        squares = sum_over(self._bodies.comm, np.einsum("n,kni,lni->kl", 1.0 / self._nodes[self._piece], w, w))
        inverse = np.linalg.inv(np.linalg.cholesky(squares))
        return float(np.linalg.eigvalsh(inverse @ holding(ways.T) @ inverse.T)[0])

    def catch(self, holding: Callable[[Array], Array]) -> None:
        """In the middle of a solve tie the pieces as well along the motions, of all of them together, that contact as it is
        does not hold: `holding` is as in :meth:`begin`. Ties in use bear what they bear (collective)."""
        R, admissible = self._admissible()
        basis = self._together(
            [b[:, :0] if self.let_be[p] else b for p, b in zip(self._pieces, admissible, strict=True)]
        )
        if not basis.shape[1]:
            return
        of_one = np.repeat(np.sqrt(self._nodes), len(self._root) // len(self._nodes))[:, None]
        share, axes = np.linalg.eigh(holding(self._all_of(R, of_one * basis)))
        unheld = np.linalg.qr(self._root[:, None] * (basis @ axes[:, share < HOLDS]))[0]
        borne = self.along(self.forces())
        left, size, _ = np.linalg.svd(np.concatenate([self._free, unheld], axis=1))
        self._tie(R, left[:, : np.count_nonzero(size > SAME)])
        self.move(borne)

    def _together(self, bases: list[Array]) -> Array:
        """(motions of all pieces, ·) an orthonormal basis of the pieces' ones."""
        n, m = self._n, 3 * (self._bodies.gdim - 1)
        columns = [np.zeros((n, 0))]
        for p, basis in zip(self._pieces, bases, strict=True):
            wide = np.zeros((n, basis.shape[1]))
            wide[p * m : (p + 1) * m] = basis
            columns.append(wide)
        return np.concatenate(columns, axis=1)

    def _all_of(self, R: Array, free: Array) -> Array:
        """(owned dofs, ·) nodal values along combinations `free` (motions of all pieces, ·) of the rigid motions R of
        pieces, orthonormal over their nodes."""
        if not free.shape[1]:
            return np.zeros((self.anchor.size, 0))
        by_piece = free.reshape(self._bodies.pieces, -1, free.shape[1]) / np.sqrt(self._nodes)[:, None, None]
        return np.asarray(np.einsum("nim,nma->nia", R, by_piece[self._piece]).reshape(self.anchor.size, -1))

    def _tie(self, R: Array, free: Array) -> None:
        """Tie the pieces along orthonormal combinations (motions of all pieces, ·) of the rigid motions R, each counted in
        what a tie of its piece resists it with."""
        self._basis, self._free = free, free @ free.T
        self.motions, self.ways = (
            self._all_of(R, scale[:, None] * free).T.copy() for scale in (self._root, self._inverse)
        )

    def _soft(self, admissible: list[Array]) -> Array:
        """(motions of all pieces, ·) an orthonormal basis of those motions, together, that next to nothing resists."""
        held = [np.zeros((len(b), 0)) if self.let_be[p] else b for p, b in zip(self._pieces, admissible, strict=True)]
        basis, resistance = self._together(held), self.resistance + (self.elastic if self.trusts[0] else 0.0)
        if not resistance.any() or not basis.shape[1]:
            return np.zeros((self._n, 0))
        if self.let_be.any():  # what is let be follows
            resistance = basis @ np.linalg.pinv(basis.T @ np.linalg.pinv(resistance) @ basis) @ basis.T
        share, axes = np.linalg.eigh(basis.T @ (resistance + resistance.T) @ basis / 2)
        return np.asarray(basis @ axes[:, share < NEUTRAL])

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

    def measure(self, response: Callable[[Array], Array], pressed: Array) -> None:
        """What resists rigid motions, from the displacements that nodal forces (owned dofs,) lead to, where each piece is
        `pressed` with so much, (pieces,) in N (collective)."""
        R, admissible = self._admissible()
        basis = self._together(admissible)
        if not basis.shape[1]:
            return
        m = self._all_of(R, self._root[:, None] * basis)
        u = np.stack([response(column) for column in m.T], axis=1)
        resistance = np.linalg.pinv(sum_over(self._bodies.comm, m.T @ u))
        resists, axes = np.linalg.eigh((resistance + resistance.T) / 2)
        # (pieces, motions) mean square over a piece's nodes of what each motion moves of it
        square = self._square(basis @ axes)
        deformed = self._deformation(R, admissible, u @ resistance @ axes) > DEFORMS**2 * square.max(axis=0)
        geometric = np.sum(square * (GEOMETRIC * pressed / np.maximum(self._sizes(), 1e-300))[:, None], axis=0)
        held = np.ones(len(self._nodes), dtype=bool)  # in place
        held[[p for p, b in zip(self._pieces, admissible, strict=True) if b.size]] = False
        stiff = deformed[held].any(axis=0) | (deformed.any(axis=0) & (resists > geometric))
        resists[stiff] = np.maximum(resists[stiff], 1.0)
        self.elastic = basis @ (axes * (deformed.any(axis=0) & (resists > 0.0))) @ axes.T @ basis.T
        self.resistance = basis @ (axes * resists) @ axes.T @ basis.T

    def _square(self, free: Array) -> Array:
        """(pieces, ·) mean square over each piece's nodes of the displacements along combinations `free` (motions of all
        pieces, ·)."""
        each = np.sum((self._inverse[:, None] * free).reshape(self._bodies.pieces, -1, free.shape[1]) ** 2, axis=1)
        return np.asarray(each / self._nodes[:, None])

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
        return self.softness * self.times(u) @ self.motions if self.acts else np.zeros_like(u)

    def along(self, forces: Array) -> Array:
        """(pieces, motions) of nodal forces (owned dofs,) what acts along the tied motions, at the present positions (N,
        collective)."""
        return self._along(self._works(self._rigid_motions(), forces), self._free)

    def _works(self, R: Array, forces: Array) -> Array:
        """(pieces, motions) of nodal forces (owned dofs,) along the rigid motions R of each piece (N, collective)."""
        f = forces.reshape(len(self._piece), -1)
        return np.asarray(sum_over(self._bodies.comm, self._by_piece(np.einsum("nim,ni->nm", R, f))))

    def _along(self, works: Array, free: Array) -> Array:
        """(pieces, motions) of `works` (pieces, motions) what is of the motions that `free` projects onto (N)."""
        nodes = np.sqrt(self._nodes)[:, None]
        along = free @ (self._inverse * (works / nodes).ravel())
        return np.asarray((self._root * along).reshape(works.shape) * nodes)

    def pushing(self, forces: Array, turns: Array) -> Array:
        """(pieces,) norm of what nodal forces (owned dofs,) push with along the tied motions (N). In motions by which pieces
        turn where they are, but for as little as facets of surfaces that turn by so much each, (pieces,) in rad, can tell,
        a force through the centroid pushes with nothing (collective)."""
        R = self._rigid_motions()
        works = self._works(R, forces)
        of_centroid = self._of_centroids(R)
        through = np.einsum("pim,pi->pm", of_centroid, works[:, : self._bodies.gdim])
        pushing = self._along(works, self._free) - self._along(through, self._spins(of_centroid, turns))
        return np.asarray(np.linalg.norm(pushing, axis=1))

    def _of_centroids(self, R: Array) -> Array:
        """(pieces, gdim, motions) how the pieces' centroids move in their rigid motions R (collective)."""
        total = sum_over(self._bodies.comm, self._by_piece(self._volumes[:, None, None] * R))
        volume = sum_over(self._bodies.comm, self._by_piece(self._volumes))
        return np.asarray(total / volume[:, None, None])

    def _spins(self, of_centroid: Array, turns: Array) -> Array:
        """(motions of all pieces, ·) projects onto those tied motions in which centroids, which move by `of_centroid`
        (pieces, gdim, motions), all together move by less than the angles of turn times `turns` (pieces,) and radii."""
        nodes = np.sqrt(self._nodes)[:, None, None]
        ways = (self._inverse[:, None] * self._basis).reshape(*of_centroid.shape[::2], -1) / nodes
        moved = (of_centroid @ ways).reshape(-1, ways.shape[2])
        turned = (RADIUS * turns[:, None, None] * ways[:, self._bodies.gdim :]).reshape(-1, ways.shape[2])
        share, axes = np.linalg.eigh(moved.T @ moved - turned.T @ turned)
        spins = self._basis @ axes[:, share < 0.0]
        return np.asarray(spins @ spins.T)

    def bearing(
        self,
        bulk: Array,
        most: Array,
        before: Array,
        present: Array,
        noise: Array,
        touched: list[Flags],
        turns: Array,
        rubbing: Callable[[Array], Array],
    ) -> Bearing:
        """What ties bear where `bulk` (owned dofs,) are the bodies' forces with those of ties, and the contact forces on each
        piece, `present` ones, those `before`, in the last equilibrium, and the `most` in this solve (pieces,), in N; less
        than `noise` (pieces,) is nothing. What pushes one of the pieces that a pair has `touched` (pieces,) pushes the
        others. `rubbing` gives of displacements (owned dofs,) the mean square over the contact forces on each piece (pieces,)
        of what goes along surfaces with friction; `turns` are as in :meth:`pushing` (collective)."""
        f = self.forces()
        borne, pushed = self.along(f), self.pushing(bulk - f, turns)
        borne *= (np.linalg.norm(borne, axis=1) > noise)[:, None]
        pushed *= pushed > noise
        size, here = np.linalg.norm(borne, axis=1), np.maximum(np.maximum(present, pushed), 1e-300)
        pushed = pushed / here
        for together in touched:
            pushed[together & self.tied] = pushed[together & self.tied].max(initial=0.0)
        # what nothing pushes may be where next to nothing presses it, which is no share to measure by
        most, by = (
            np.where(pushed > PUSHED, np.where(pushed > CLEAR, pushed, 1.0) * here, np.maximum(forces, here))
            for forces in (most, before)
        )
        way = self.motion(borne)
        square = sum_over(self._bodies.comm, self._by_piece(np.sum(way.reshape(len(self._piece), -1) ** 2, axis=1)))
        rubs = rubbing(way) > RUBS**2 * square / self._nodes
        return Bearing(
            along=borne,
            borne=size / most,
            most=most,
            share=size / by,
            alone=(present > 0.0) & (size > present / 2),
            pushed=pushed,
            rubs=rubs & (size > 0.0),
            ties=len(self.motions),
        )

    def springs(self, *, multigrid: bool) -> Array:
        """(owned nodes, gdim, gdim) stiffness (N/m) of weak springs at the nodes, along the motions: weaker for factors than
        for `multigrid`."""
        weak = self.softness * (WEAK_TO_MULTIGRID if multigrid else WEAK)
        m = self.motions.reshape(-1, len(self._piece), self._bodies.gdim)
        return np.asarray(np.einsum("n,ani,anj->nij", weak * self._nodes[self._piece], m, m))

    # ---------------------------------------------------------------- steps

    def motion(self, forces: Array) -> Array:
        """(owned dofs,) how far (m) the pieces are from where ties that bear `forces` (pieces, motions) hold them
        (collective)."""
        stiffness = self.softness * (self._k * self._nodes)[self._pieces, None]
        away = np.zeros_like(forces)
        away[self._pieces] = forces[self._pieces] / stiffness
        return np.asarray(np.einsum("nim,nm->ni", self._rigid_motions(), away[self._piece]).ravel())

    def further(self, amounts: Array) -> Array:
        """(pieces, motions) what ties bear more (N) where pieces are so much (ties,) on along their ways (collective)."""
        return self.along(self.softness * amounts @ self.motions)

    def trust_matters(self) -> bool:
        """Whether more would be tied if elasticity were not trusted (collective)."""
        _, admissible = self._admissible()
        trusts, counts = bool(self.trusts[0]), []
        for self.trusts[:] in (True, False):
            counts.append(self._soft(admissible).shape[1])
        self.trusts[:] = trusts
        return counts[1] > counts[0]

    def elastic_ones(self) -> bool:
        """Whether any motion that is tied is one that bodies deform in, and resist."""
        return bool(np.linalg.eigvalsh(self._free @ self.elastic @ self._free)[-1] > 1 / 2)

    def soften(self) -> None:
        """Let ties be softer from now on in this solve; the pieces are to be tied anew."""
        self.softness = max(SOFTEST, SOFTER * self.softness)

    def move(self, bear: Array) -> None:
        """Tie the pieces to where, as they are, ties along the present motions bear so much, (pieces, motions) in N
        (collective)."""
        self.anchor = self._bodies.get() - self.motion(bear)

    def release(self) -> None:
        """Tie the pieces to where they are (collective)."""
        self.anchor = self._bodies.get()

    def snapshot(self) -> dict[str, Array]:
        """What a step may change."""
        return {name: getattr(self, name).copy() for name in HISTORY}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        for name in HISTORY:
            setattr(self, name, saved[name].astype(getattr(self, name).dtype))
