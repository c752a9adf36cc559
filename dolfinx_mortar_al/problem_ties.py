"""What a problem does with its ties in a solve, and what contact and friction say of the bodies that they hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.dashpots import Dashpots
from dolfinx_mortar_al.problem_findings import ProblemFindings
from dolfinx_mortar_al.reductions import any_over, max_over
from dolfinx_mortar_al.ties import Bearing

__all__ = ["ProblemTies"]

Array = NDArray[np.float64]


class ProblemTies(ProblemFindings):
    """The :class:`~dolfinx_mortar_al.ties.Ties` of a contact problem, None where no piece of a body needs any."""

    #: the bulk's forces at the last evaluation, those of ties among them (N)
    bulk_forces: PETSc.Vec
    #: on the nodes, while the bodies go to where they come to rest (`relaxation`)
    dashpots: Dashpots | None
    #: (pairs,) which have friction
    _rough: NDArray[np.bool_]
    #: (pieces,) most of the contact forces in this solve (N)
    _pressed: Array
    #: (pairs,) whether all points have slipped in this solve
    _slid: NDArray[np.bool_]

    def add_contact(self, f: PETSc.Vec) -> None:
        """f ← the bulk's forces and those of contact, as last evaluated."""
        raise NotImplementedError

    # ---------------------------------------------------------------- in the course of a solve

    def start_ties(self) -> None:
        """At the start of a solve tie the motions that next to nothing resisted in the last equilibrium, or before the
        first one those that what touches does not hold; none where dashpots resist all (collective)."""
        if self.ties is None:
            return
        self._pressed[:], self._slid[:] = 0.0, False
        if self.dashpots is not None:
            self.ties.rest()
        else:
            self.ties.begin(self._contact_motions.held_by_touch if self.is_at_start else None)

    def loosen_ties(self, f: PETSc.Vec) -> None:
        """At the start of a solve in which supports or obstacles move: where pairs with friction stick, at least in part, and
        that holds what is tied, the first step does without ties, which go where it leads (:meth:`tighten_ties`), and
        without springs: bodies may be carried along, far from where they were, and next to nothing that held them back
        would be more than friction bears. f, the residual, is brought up to date (collective)."""
        if self.ties is None or not self._supports_move():
            return
        slip, stick = self._contact_motions.slip_and_stick()
        rub = self._rough & (slip + stick > 0)
        if not rub.any() or not stick[rub].all() or not self.ties.are_spare(self._contact_motions.held_by_stick):
            return
        with self._other_forces(f):
            self.ties.release()
            self.ties.are_loose = True

    def tighten_ties(self) -> None:
        """After such a step: tie the pieces to where they are now; the bulk's forces, which are those before it, are brought
        up to date (collective)."""
        if self.ties is None or not self.ties.are_loose:
            return
        before = self.ties.anchor
        self.ties.release()
        self.ties.are_loose = False
        self.bulk_forces.array[:] += self.ties.pull(before - self.ties.anchor)

    def catch_slipping(self, f: PETSc.Vec, *, begins: bool) -> None:
        """In the middle of a solve: where all points of another pair with friction slip tie what it alone held; f, the
        residual, is brought up to date. What slips where it `begins` did so in the last equilibrium, in which what resists
        was measured (collective)."""
        new = self.gives_way()
        if self.ties is None or not new.any():
            return
        self._slid |= new
        if begins:
            return
        _, stick = self._contact_motions.slip_and_stick()
        with self._other_forces(f):
            self.ties.catch(partial(self._contact_motions.held, stick == 0))

    def move_ties(self, f: PETSc.Vec, bear: Array, *, softer: bool) -> bool:
        """Tie the pieces to where the ties bear so much, (pieces, motions) in N, by softer ties if need be; f, the residual,
        is brought up to date. Whether other motions are tied than before (collective)."""
        assert self.ties is not None
        for pair in self.pairs:
            pair.begin_again()
        with self._other_forces(f):
            if softer:
                self.ties.soften()
            self.ties.move(bear)
            changed = self.ties.engage()
            self._slid &= self._slips_all_over()  # what sticks again may be what resists
        return changed

    @contextmanager
    def _other_forces(self, f: PETSc.Vec) -> Iterator[None]:
        """Within, ties change; the bulk's forces and f, the residual, are brought up to date (collective)."""
        assert self.ties is not None
        self.bulk_forces.array[:] -= self.ties.forces()
        yield
        self.bulk_forces.array[:] += self.ties.forces()
        self.add_contact(f)

    # ---------------------------------------------------------------- what ties bear

    def measure_ties(self, response: Callable[[Array], Array]) -> None:
        """What resists rigid motions in this state, from the displacements that nodal forces (owned dofs,) lead to
        (collective)."""
        if self.ties is not None:
            self.ties.measure(response, self._pressing())

    def ties_bear(self) -> Bearing:
        """What ties bear, as shares of the contact forces on each piece (collective). Forces that balance each other on a
        piece count, as of a disc in its hole."""
        assert self.ties is not None
        present = self._pressing()
        np.maximum(self._pressed, present, out=self._pressed)
        return self.ties.bearing(
            self.bulk_forces.array_r,
            self._pressed,
            self.standing.pressed,
            present,
            self._no_press(),
            self._touched * len(self.pairs),
            self._contact_motions.turns(),
            self._contact_motions.rubbing,
        )

    def dragged(self) -> Array:
        """(pieces, motions) what ties would bear more (N) if the pieces went on along them by what undoes how far surfaces
        with friction have slid in this step (collective)."""
        assert self.ties is not None
        return self.ties.further(self._contact_motions.that_undo_slip(self.ties.ways.T))

    # ---------------------------------------------------------------- what holds bodies, or drives them on

    def contact_holds(self) -> bool:
        """Whether contact alone holds pieces as firmly as supports would, in the equilibrium just found: stability of these
        is told as that of others, while bodies that may slide or roll are neutral (collective)."""
        return self.ties is not None and self.ties.are_stuck(self._contact_motions.held_by_stick)

    def gives_way(self) -> NDArray[np.bool_]:
        """(pairs,) which pairs with friction slip at all points for the first time in this solve, where contact alone holds
        bodies (collective)."""
        if self.ties is None or self.dashpots is not None:
            return np.zeros(len(self.pairs), dtype=bool)
        return np.asarray(self._slips_all_over() & ~self._slid)

    def _slips_all_over(self) -> NDArray[np.bool_]:
        """(pairs,) which pairs with friction slip at all points (collective)."""
        slip, stick = self._contact_motions.slip_and_stick()
        return np.asarray((stick == 0) & (slip > 0) & self._rough)

    def has_thrown_off(self) -> bool:
        """Whether a piece that contact alone holds is far from where the last solve began, and nothing touches it
        (collective)."""
        if self.ties is None:
            return False
        return bool((self.ties.far() & (self._touched_now() == 0)).any())

    def led(self, du: Array) -> float:
        """How far supports go in the change du (owned dofs,) of the displacements since the last equilibrium (m); ∞ where
        obstacles are led (collective)."""
        if any(pair.obstacle_moves for pair in self.pairs):
            return np.inf
        return max_over(self.comm, float(np.abs(du[self.bodies.prescribed()]).max(initial=0.0)))

    def is_driven_on(self, du: Array) -> bool:
        """Whether something drives bodies on, along a motion that contact alone would hold them in, and supports and
        obstacles rest in the change du (owned dofs,) of the displacements since the last equilibrium (collective)."""
        if self.ties is None:
            return False
        rests = self.led(du) <= self._touch
        return any_over(self.comm, rests and self.ties.drives_on)

    def _supports_move(self) -> bool:
        """Whether prescribed values, or rigid obstacles, have moved since the last equilibrium (collective)."""
        assert self.ties is not None
        return any(pair.obstacle_moves for pair in self.pairs) or self.ties.supports_move(self._touch)

    @property
    def _touch(self) -> float:
        """Gap (m) up to which surfaces count as touching."""
        return max((pair.kinematics.touch for pair in self.pairs), default=0.0)
