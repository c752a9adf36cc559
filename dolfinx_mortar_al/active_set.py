"""The active set of a pair: which points are closed, and which friction bounds are frozen (``docs/newton.md``).

Decisions are taken once per Newton iteration, in :meth:`ActiveSet.decide`; between them the residual is a function of the
unknowns alone. At convergence the set is that of eq. (1): closed where λ̂_N ≥ 0.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.blocks import Blocks
from dolfinx_mortar_al.kinematics import Kinematics
from dolfinx_mortar_al.law import OPEN, SLIP, STICK, LawState
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over

__all__ = ["ActiveSet"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]
Decided = tuple[Bool, Index, bool, Bool, Bool, Array | None]

TRUST = 1.0  # gaps are trusted to this many times their error
CLOSES = 3.0  # an open point closes beyond this many times what makes a closed one open: closing by mistake costs more
WEAK = 0.1  # share of the largest pressure below which points of a first, all-closed guess open
MANY = 0.5  # share of a closed zone that its edge does not lose in one iteration
LOSSES = 2  # times a closed point may slide off the target before it stays open for the rest of a solve


class ActiveSet:
    """Closed points and frozen bounds of a pair, and the rules by which they change.

    Args:
        blocks: of the pair.
        comm: of the problem.

    Attributes:
        closed: (n,) points that count as closed.
        frozen: (n,) friction bound in place of μp (Pa), not a number where it is free; None if all are.
        held: (n,) points that stick in this iteration because they slip to and fro.
        trust: gaps are trusted to this many times their error.
        guessed: whether `closed` is a first guess rather than what a converged step left.
        cautious: whether the rules of statics hold; if not, the sign of λ̂_N decides alone.
    """

    def __init__(self, blocks: Blocks, comm: MPI.Intracomm) -> None:
        self._comm = comm
        n = blocks.points.size
        self.closed: Bool = np.zeros(n, dtype=bool)
        self.frozen: Array | None = None
        self._off: Array | None = None  # (n,) μp less the frozen bound (Pa) in the last round
        self.held: Bool = np.zeros(n, dtype=bool)
        self._turned: Bool = self.held.copy()  # points whose slip has turned round in this solve
        self._slipped: Array | None = None  # (n, gdim) λ̂_T of points that slip in this iteration, 0 elsewhere
        self.guessed, self.cautious = True, True
        self.trust = TRUST
        self._guess: Bool = self.closed.copy()
        self._losses: Index = np.zeros(n, dtype=np.int64)
        self._were_in_contact: Bool = np.zeros(n, dtype=bool)
        self._pardoned = False
        self._blocks = blocks
        self._node_area = self._area(np.ones(n, dtype=bool))

    def renew(self) -> None:
        """The multiplier's nodes that count are others now (collective)."""
        self._node_area = self._area(np.ones(len(self.closed), dtype=bool))

    def begin(self, were_in_contact: Bool) -> None:
        """A new solve: gaps are trusted as at first, bounds are free, and points may come back to the target; (n,) says which
        points are on facets that were in contact in the last equilibrium."""
        self.trust, self._weak_may_open, self.frozen = TRUST, self.guessed, None
        self.held, self._slipped = np.zeros(len(self.closed), dtype=bool), None
        self._turned = self.held.copy()
        self._guess = self.closed & self.guessed
        self._losses[:], self._pardoned = 0, False
        self._were_in_contact = were_in_contact

    def transfer(self, origin: Index) -> None:
        """Other points: each takes over what is known of the former point `origin` (n,), but for slides off the target, where
        segments end, too."""
        self.closed, self._losses = self.closed[origin], np.zeros(len(origin), dtype=np.int64)
        self._were_in_contact, self._guess = self._were_in_contact[origin], self._guess[origin]
        self.frozen = None if self.frozen is None else self.frozen[origin]
        self._off = None if self._off is None else self._off[origin]
        self._turned = self._turned[origin]
        self.held, self._slipped = self.held[origin], None if self._slipped is None else self._slipped[origin]

    @property
    def _left(self) -> Bool:
        """(n,) points that have slid off the target for good, as far as this solve goes."""
        left: Bool = self._losses >= LOSSES
        return left

    def decide(self, state: LawState, kinematics: Kinematics, residual: PETSc.Vec, unit: float, εN: float) -> bool:
        """Let points open and close, as far as the gaps are known; whether any did on this rank.

        `residual` is `unit` × the multiplier's residual with the present set. Divided by the nodes' area it is how well the
        gap condition is met, the error e of all gaps. A point that was closed opens where λ̂_N < −`trust`·ε_N e; one
        that was open closes where λ̂_N is CLOSES times as far above zero. As Newton converges e vanishes and what remains is
        eq. (1). A point that faces no target is open.

        Where more than MANY of those would open that come from the last equilibrium, the residual is divided by the closed
        part of the area: it is that part's mean gap, and a small part where facets touch in their middle alone, straight ones
        on a cylinder.
        """
        before, λ = self.closed, state.λN_hat
        may_close = kinematics.may_close & ~self._left
        if not self.cautious:
            self.closed = may_close & (λ >= 0.0)
            return not np.array_equal(before, self.closed)
        known = self._known(residual, self._node_area, unit, εN, kinematics)
        release, close = -known, CLOSES * known
        if self._are_many(before & (λ < release)):
            release = -self._known(residual, self._area(before), unit, εN, kinematics)
        least = np.where(before, release, close)
        if self._weak_may_open:  # no history: what presses weakly in an all-closed start may open at once
            weak = WEAK * max_over(self._comm, float(λ[before].max(initial=0.0)))
            if known < 0.1 * weak:
                least[before & self._guess], self._weak_may_open = weak, False
        self._losses += before & ~kinematics.may_close
        self.closed = may_close & (λ >= least)
        return not np.array_equal(before, self.closed)

    def _known(self, residual: PETSc.Vec, area: PETSc.Vec, unit: float, εN: float, kinematics: Kinematics) -> float:
        """Pressure (Pa) that the gaps' error, `residual` per `area` of each node, is worth (collective)."""
        error = residual.duplicate()
        error.pointwiseDivide(residual, area)
        e = error.norm(PETSc.NormType.NORM_INFINITY) / unit
        return float(εN * (self.trust * e + kinematics.touch))

    def _are_many(self, opening: Bool) -> bool:
        """Whether more than MANY of the closed points on facets that were in contact open, (n,) (collective)."""
        known = self._were_in_contact
        count = sum_over(self._comm, np.array([(opening & known).sum(), (self.closed & known).sum()]))
        return bool(count[0] > MANY * count[1])

    def _area(self, counts: Bool) -> PETSc.Vec:
        """∫ |N| for each node over the points that count (n,); 1 where that is nothing (collective)."""
        multiplier, points = self._blocks.multiplier, self._blocks.points
        area = fem.Function(multiplier.field.function_space)
        np.add.at(
            area.x.array.reshape(-1, multiplier.components),
            multiplier.dofs,
            points.sum_by_facet((counts * points.j)[:, None, None] * np.abs(multiplier.at(points.facet, points.η))),
        )
        area.x.scatter_reverse(InsertMode.add)
        vector = area.x.petsc_vec.copy()
        vector.array[vector.array_r == 0.0] = 1.0
        return vector

    def lost(self, state: LawState, kinematics: Kinematics) -> Bool:
        """(n,) points that slid off for good, and penetrate the target now."""
        lost: Bool = self._left & kinematics.may_close & (state.λN_hat > 0)
        return lost

    def pardon(self, state: LawState, kinematics: Kinematics) -> bool:
        """Once in a solve that has converged: give points that are lost one more chance, since Newton may have thrown them
        off on its way; whether there are any (collective)."""
        back = self.lost(state, kinematics)
        if self._pardoned or not any_over(self._comm, back.any()):
            return False
        self._losses[back], self._pardoned = LOSSES - 1, True
        return True

    def expect(self, λN_hat: Array, kinematics: Kinematics, εN: float) -> None:
        """Start from the set that λ̂_N (n,) says, with no point held."""
        self.held, self._slipped = np.zeros(len(λN_hat), dtype=bool), None
        self.closed = kinematics.may_close & (λN_hat >= -εN * kinematics.touch)

    def at_odds(self, state: LawState, kinematics: Kinematics, εN: float) -> Array:
        """(n,) |λ̂_N| (Pa) where a point is closed against λ̂_N < 0 or open against λ̂_N > 0, less what :meth:`decide` takes for
        round-off where gaps are met."""
        λ, round_off = np.where(kinematics.may_close & ~self._left, state.λN_hat, 0.0), εN * kinematics.touch
        return np.maximum(np.where(self.closed, -λ - round_off, λ - CLOSES * round_off), 0.0)

    def snapshot(self) -> Decided:
        """What :meth:`decide` and :meth:`hold_turned` may change."""
        return self.closed.copy(), self._losses.copy(), self._weak_may_open, self.held, self._turned, self._slipped

    def restore(self, saved: Decided, origin: Index) -> None:
        """Take decisions back; they were taken at points of which `origin` (n,) are the present ones."""
        closed, losses, self._weak_may_open, held, turned, slipped = saved
        self.closed, self._losses = closed[origin], losses[origin]
        self.held, self._turned = held[origin], turned[origin]
        self._slipped = None if slipped is None else slipped[origin]

    # ---------------------------------------------------------------- stick and slip

    def hold_turned(self, state: LawState) -> bool:
        """Hold for one iteration the points whose slip has turned round since the last, for the second time or more in this
        solve, and let go those that were held; whether there are any on this rank. What slips to and fro comes to rest before
        it goes back: λ̂_T holds ε_T times what Newton's step moves, and where that is more than twice the friction bound whole
        zones would never stop."""
        before, slips = self.held, state.status == SLIP
        self.held = np.zeros(len(slips), dtype=bool)
        if self._slipped is not None and state.λT_hat is not None:
            turned = slips & (np.einsum("ni,ni->n", self._slipped, state.λT_hat) < 0.0)
            self.held, self._turned = turned & self._turned, self._turned | turned
        return bool(self.held.any() or before.any())

    def note_slip(self, state: LawState) -> None:
        """Remember which way points slip with the decisions taken."""
        if state.λT_hat is not None:
            self._slipped = np.where((state.status == SLIP)[:, None], state.λT_hat, 0.0)

    def beyond(self, state: LawState) -> Array:
        """(n,) by how much the traction (Pa) of points that are held exceeds their friction bound."""
        if state.λT_hat is None or state.bound is None:
            return np.zeros(len(self.held))
        size = np.linalg.norm(state.λT_hat, axis=1)
        return np.where(self.held & (state.status == STICK), np.maximum(size - state.bound, 0.0), 0.0)

    # ---------------------------------------------------------------- friction bounds

    def freeze(self, state: LawState, μ: float) -> None:
        """Hold the friction bound of closed points at its present μp: Tresca's law, which has no stick–slip cycles."""
        self.frozen, self._off = np.where(state.status != OPEN, μ * np.maximum(state.p, 0.0), np.nan), None

    def compare_bounds(self, state: LawState, μ: float) -> Array:
        """(2,) what μp − the frozen bound, which is remembered, has in common with what was remembered last, and that with
        itself. A point that has closed since is to have its μp; one that has opened has nothing."""
        assert self.frozen is not None
        wanted = np.where(state.status != OPEN, μ * np.maximum(state.p, 0.0), np.nan)
        self.frozen = np.where(np.isnan(self.frozen) | np.isnan(wanted), wanted, self.frozen)
        off, last = np.nan_to_num(wanted - self.frozen), self._off
        self._off = off
        return np.zeros(2) if last is None else np.array([off @ last, last @ last])

    def move_bounds(self, share: float) -> None:
        """Move frozen bounds by a `share` of what is remembered."""
        assert self.frozen is not None and self._off is not None
        self.frozen = np.maximum(self.frozen + share * self._off, 0.0)

    def thaw(self) -> None:
        """Back to Coulomb's law."""
        self.frozen = None

    def staleness(self, state: LawState, μ: float) -> float:
        """Largest difference between frozen bounds and μp, as a share of the largest μp (collective)."""
        if self.frozen is None:
            miss = 0.0
        else:
            closed = (state.status != OPEN) & ~np.isnan(self.frozen)
            miss = float(np.abs(self.frozen - μ * np.maximum(state.p, 0.0))[closed].max(initial=0.0))
        worst = max_over(self._comm, miss)
        largest = max_over(self._comm, float(state.p.max(initial=0.0)))
        return worst / max(μ * largest, 1e-300) if worst > 0 else 0.0
