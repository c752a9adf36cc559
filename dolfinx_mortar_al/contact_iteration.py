"""Contact on the linearised bulk: what keeps the number of Newton iterations from growing with the mesh.

A Newton step linearises the bulk and the state of contact at once. The edge of contact, or of stick, moves by a facet or two
in a step; where it has many to go the bulk's forces are in balance long since. Josephy's generalisation of Newton's method
(S. M. Robinson, Math. Oper. Res. 5, 1980) linearises what is smooth, and that only: with the bulk's forces R and their
derivative K at 𝐱_k it asks for x with

    R + K (x − 𝐱_k) + contact(x) = 0,

contact as it is. Newton's step is the first semi-smooth step towards that x; the others follow here. Their matrices differ by
contact's share alone from the one that has been factorised, by a low rank where few points have changed their state: GMRES
with the factors at hand for preconditioner takes few iterations, and no form is assembled.

What is left then is the bulk's nonlinearity alone. Its forces are assembled at that x, as Newton's next iteration would do,
and further steps are taken with the derivative at 𝐱_k (Shamanskii's method), and contact's while no point changes its state,
as long as that pays. In space, where a factorisation costs as much as many solves, that is while each takes half of the
residual away, and contact settles anew where points change their state; in the plane where contact is what it was at 𝐱_k, so
that a solve with the factors at hand is all that a step takes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfinx_mortar_al.linear_solver import LinearSolver
from dolfinx_mortar_al.linearised_bulk import LinearisedBulk
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import any_over

__all__ = ["ContactIteration"]

ENOUGH = 0.01  # of the residual that Newton's step started from: the bulk's nonlinearity leaves as much
CHORD = 0.2  # of the residual: steps with an old derivative go on while each leaves less,
HALF = 0.5  # in space, where a Newton iteration costs several of them
SOLVES = 8  # at most in one of them
# solves in all for a Newton step: MUMPS factorises in the time of 6 to 37 (docs/newton.md); in the plane at least, and on
# fine meshes, where the edges of contact have more facets to go, times the root of the number of unknowns; in space
MOST, FINER, MOST_IN_SPACE = 40, 0.8, 200
ENDS = 0.01  # of the tolerance: once begun they go on to it, as they converge linearly and Newton's last step does not
AFFORDED = 5.0  # of them that may be to come in the plane: Newton's next iteration costs four (bars) to six (disc)
ASTRAY = 4.0  # times the least residual so far: semi-smooth steps with more in space go on from there by Tresca's law,
FROZEN = 0.1  # until this is left of it
LINEAR = 0.1  # relative tolerance of GMRES: with 0.01 a fifth less steps for a fifth more solves


class _Inverse:
    """PETSc's interface of a preconditioner: what the linear solver has for the inverse of an earlier matrix."""

    def __init__(self, linear: LinearSolver) -> None:
        self._linear = linear

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        self._linear.apply(b, x)


@dataclass
class _Kept:
    """A state on the way: what has been added to Newton's step, and the active sets' decisions there."""

    total: PETSc.Vec
    decisions: list[Any] = field(default_factory=list)


class ContactIteration:
    """Improves Newton steps x ← x − y.

    Args:
        problem: in a step, its Jacobian has been assembled at x and its pairs were last evaluated there.
        linear: the solver of Newton's steps.
        size: of a residual, in units of its tolerance.
        longest: facets that a node may move in a step.

    Attributes:
        steps: taken so far; solves: with the factors that they took.
    """

    def __init__(
        self, problem: ContactProblem, linear: LinearSolver, size: Callable[[PETSc.Vec], float], longest: float
    ) -> None:
        self.problem, self._linear, self._size, self._longest = problem, linear, size, longest
        # in the plane thin belts would fly off, and membranes take more iterations, by what settles contact in space
        self._is_solid = linear.is_solid
        in_plane = max(MOST, int(FINER * problem.bodies.layout.sizes[1] ** 0.5))
        self._most = MOST_IN_SPACE if self._is_solid else in_plane
        self.steps = self.solves = 0
        self._z, self._step, self._total, self._way = (problem.x.duplicate() for _ in range(4))
        self._best, self._safe = (_Kept(problem.x.duplicate()) for _ in range(2))
        self._f, self._goal, self._off = (problem.residual.duplicate() for _ in range(3))
        self._off.set(0.0)
        self._forces = problem.bulk_forces.duplicate()
        self._at_z = self._bulk_at_z = False
        self._ksp = PETSc.KSP().create(problem.comm)
        # factors tell the error itself, to GMRES from the left; without them what is left of forces and gaps is measured from
        # the right, by the flexible kind, which has no preconditioner to apply again at its end
        self._ksp.setType("fgmres" if linear.iterative else "gmres")
        self._ksp.getPC().setType("python")
        self._ksp.getPC().setPythonContext(_Inverse(linear))

    def known(self, x: PETSc.Vec) -> tuple[bool, bool]:
        """Whether the pairs were last evaluated, and the bulk's forces last assembled, here and at x (collective; once)."""
        known, self._at_z = self._at_z, False
        if known:
            self._z.axpy(-1.0, x)
            known = bool(self._z.norm(PETSc.NormType.NORM_INFINITY) == 0.0)
        if not known:
            return False, False
        moved = [pair.follow_segments() for pair in self.problem.pairs]  # segments were held until now
        return not any_over(self.problem.comm, any(moved)), self._bulk_at_z

    def improve(self, x: PETSc.Vec, y: PETSc.Vec, start: float, residual: PETSc.Vec, share: float) -> PETSc.Vec | None:
        """What to add to y so that contact settles on the linearised bulk, and the bulk's forces follow; None if they have
        (collective).

        The linear solver was last used with the Jacobian at x, `residual` is that at x, and y is a `share` of Newton's step:
        the same share of the residual is to be taken away. `start` is its size before the active set's last decisions.
        """
        p = self.problem
        self._x, self._y, self._at_z, self._bulk_at_z = x, y, True, False
        residual.copy(self._goal)
        self._goal.scale(1.0 - share)
        self._decisions, self._before = [pair.decisions() for pair in p.pairs], p.contact_pattern()
        p.bulk_forces.copy(self._forces)
        self._left = self._most
        self._total.set(0.0)
        self._evaluate()
        if p.gives_way().any():
            return None  # nothing would resist these steps along surfaces: ties are to hold what friction held
        settled, whole = p.contact_pattern() == self._before, share == 1.0
        if settled and not whole:
            return None
        # where contact has not changed a direct solver's factors are those of its share, too
        bulk = None if settled and not self._linear.iterative else LinearisedBulk(p)
        changed = bulk is not None and not settled and self._settle(bulk, max(1.0, ENOUGH * share * start), start)
        if whole and (settled or self._is_solid):
            changed |= self._correct(bulk, start)
        return self._total if changed else None

    def _follow(self) -> float:
        """The bulk's forces at z, and in f the residual there; returns its size."""
        p = self.problem
        p.assemble_bulk()
        self._bulk_at_z = True
        p.add_contact(self._f)
        return self._size(self._f)

    def _settle(self, bulk: LinearisedBulk, enough: float, start: float) -> bool:
        """Semi-smooth steps on the linearised bulk until `enough` of the residual is left, or in space, below `start`, the
        error of its forces; whether any was taken. In space Tresca's law leads on where Coulomb's leads astray."""
        patterns, taken = [self.problem.contact_pattern()], False
        size = least = self._balance(bulk)
        if self._is_solid:
            self._keep(self._best)
        while self._left > 0 and size > enough and patterns[-1] not in patterns[:-2]:
            if self._is_solid and size < start and size < self._bulk_error():
                break
            self._solve(bulk, self._left)
            self._advance()
            size, taken = self._balance(bulk), True
            patterns.append(self.problem.contact_pattern())
            if self._is_solid and size > ASTRAY * least and self.problem.free_bounds:
                if not self._settle_frozen(bulk):
                    break
                size = least = self._balance(bulk)
                patterns = [self.problem.contact_pattern()]
                self._keep(self._best)
            elif self._is_solid and size < least:
                least = size
                self._keep(self._best)
        if self._is_solid and size > least:
            self._go_back(self._best)
        return taken

    def _settle_frozen(self, bulk: LinearisedBulk) -> bool:
        """From the state that was kept semi-smooth steps with friction bounds frozen until FROZEN of its residual is left
        or points are in states that they were in before; whether they do not cycle."""
        p = self.problem
        self._go_back(self._best)
        pairs = p.freeze_bounds()
        for pair in pairs:
            pair.apply_law()
        start = size = self._balance(bulk)
        patterns = [p.contact_pattern()]
        while self._left > 0 and size > FROZEN * start and patterns[-1] not in patterns[:-1]:
            self._solve(bulk, self._left)
            self._advance()
            size = self._balance(bulk)
            patterns.append(p.contact_pattern())
        for pair in pairs:
            pair.active.thaw()
            pair.apply_law()
        return size <= FROZEN * start or patterns[-1] not in patterns[:-2]

    def _bulk_error(self) -> float:
        """Size of what the linearised bulk's forces are off by at z."""
        p, off = self.problem, self._off.getNestSubVecs()[0]
        p.bulk_forces.copy(off)
        p.assemble_bulk()
        off.aypx(-1.0, p.bulk_forces)
        return self._size(self._off)

    def _keep(self, state: _Kept) -> None:
        """Remember the state."""
        self._total.copy(state.total)
        state.decisions = [pair.decisions() for pair in self.problem.pairs]

    def _go_back(self, state: _Kept) -> None:
        """To a state that was kept: of those on the way the one with the least residual is what counts."""
        state.total.copy(self._total)
        for pair, saved in zip(self.problem.pairs, state.decisions, strict=True):
            pair.undo_decisions(saved)
        self._evaluate()

    def _correct(self, bulk: LinearisedBulk | None, start: float) -> bool:
        """Steps from z with the bulk's derivative at x until the residual is below its tolerance or they do not pay any more;
        then segments follow the bodies, and further such steps take away what that leaves. Whether any was taken. Points at
        the target's end, whose motion is part of the derivative, follow it in each step."""
        if any_over(self.problem.comm, any([p.follow_segments() for p in self.problem.pairs if not p.is_segmented])):
            self._evaluate(follow=True)
        taken, size = self._take_chords(bulk, start)
        while size <= 1.0 and self._segments_follow():
            more, size = self._take_chords(bulk, start)
            taken |= more
        return taken

    def _segments_follow(self) -> bool:
        """Whether segments had to move to be where the bodies are at z (collective)."""
        p = self.problem
        if not any_over(p.comm, any([pair.follow_segments() for pair in p.pairs])):
            return False
        self._evaluate()
        self._before = p.contact_pattern()  # of other points
        return True

    def _take_chords(self, bulk: LinearisedBulk | None, start: float) -> tuple[bool, float]:
        """Steps from z with the bulk's derivative at x, and without `bulk` contact's as well while it is as it was there, as
        long as they pay; whether any was taken, and what is left. In space contact settles in each. One after which more is
        left is undone. What is left below the tolerance where they should have left less than ENDS is round-off."""
        size, taken, end = self._follow(), False, 1.0
        while self._pays(size, start, end) and (bulk is not None or self.problem.contact_pattern() == self._before):
            self._keep(self._safe)
            pattern = self.problem.contact_pattern()
            if bulk is not None and self._is_solid:
                self._linearise_again(bulk)
            self._solve(bulk, SOLVES, min(LINEAR, max(size / start, ENDS / size)), old=True)
            self._advance(follow=True)
            if bulk is not None and self._is_solid and self.problem.contact_pattern() != pattern:
                self._settle(bulk, 1.0, size)
            end = 1.0 if taken and size * size / start <= ENDS else ENDS
            start, size = size, self._follow()
            if not size < start:
                self._go_back(self._safe)
                return taken, self._follow()
            taken = True
        return taken, size

    def _linearise_again(self, bulk: LinearisedBulk) -> None:
        """From now on the linearised bulk's forces are right at z, where they have been assembled; its derivative stays."""
        bulk.forces(self._way.getNestSubVecs()[0], self._forces)
        self._forces.axpy(1.0, self.problem.bulk_forces)

    def _pays(self, size: float, start: float, end: float) -> bool:
        """Whether to take a step with the old derivative towards `end`, the last step having left `size` of `start`."""
        share = size / start if start > 0 else 1.0
        if not end < size or share >= (HALF if self._is_solid else CHORD):
            return False
        return self._is_solid or bool(np.log(end / size) / np.log(share) <= AFFORDED)

    def undo(self) -> None:
        """Take back the decisions of :meth:`improve`."""
        self._at_z = False
        for pair, saved in zip(self.problem.pairs, self._decisions, strict=True):
            pair.undo_decisions(saved)

    def _advance(self, follow: bool = False) -> None:
        """The step is taken."""
        self._total.axpy(1.0, self._step)
        self._evaluate(follow)

    def _evaluate(self, follow: bool = False) -> None:
        """Bring the pairs and their active sets up to date with z, at the points as they are: contact's state is compared
        point by point. Where it does not change any more those at the target's end may `follow` it. In space gaps are off
        by what GMRES leaves in the next step, as they are linear but for contact; in the plane their whole error counts."""
        p = self.problem
        self._way.waxpy(1.0, self._y, self._total)
        self._z.waxpy(-1.0, self._way, self._x)  # with the line search's own rounding
        p.unpack(self._z)
        for pair in p.pairs:
            pair.holds_points = pair.is_segmented or not follow
        p.evaluate()
        for pair in p.pairs:
            pair.holds_points = False
        p.set_gaps(self._f)
        self._f.axpy(-1.0, self._goal)
        if self._is_solid:
            self._f.scale(LINEAR)
        p.choose(self._f)

    def _balance(self, bulk: LinearisedBulk) -> float:
        """In f the residual at z, its bulk linear from x on, less what may be left; returns its size."""
        p = self.problem
        bulk.forces(self._way.getNestSubVecs()[0], p.bulk_forces)
        p.bulk_forces.aypx(-1.0, self._forces)
        p.add_contact(self._f)
        self._f.axpy(-1.0, self._goal)
        return self._size(self._f)

    def _solve(self, bulk: LinearisedBulk | None, most: int, rtol: float = LINEAR, old: bool = False) -> None:
        """A semi-smooth step from z that takes f away but for a share `rtol`, by no more than `most` solves with the factors.
        An `old` derivative of contact will do where no point has changed its state. Without `bulk` the factors are those of
        contact's state as well."""
        if bulk is None:
            self._linear.apply(self._f, self._step)
            return
        if not (old and bulk.pattern == self.problem.contact_pattern()):
            matrix = bulk.renew()
            self._linear.renew_contact(matrix)
            self._ksp.setOperators(matrix)
        self._ksp.setTolerances(rtol=rtol, max_it=most)
        self._ksp.setGMRESRestart(most)
        self._ksp.solve(self._f, self._step)
        if self._ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_NANORINF:
            self._step.set(0.0)  # the patch's factors are singular
            self._left = 0
            return
        motion = self.problem.longest_motion(self._step.getNestSubVecs()[0].array_r)
        if self._is_solid and motion > self._longest:
            # pressures of points closed by mistake may exceed the stiffness of what they press
            self._step.scale(self._longest / motion)
        solves = self._ksp.getIterationNumber() + (not self._linear.iterative)
        self.steps, self.solves, self._left = self.steps + 1, self.solves + solves, self._left - solves
