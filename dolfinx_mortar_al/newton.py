"""Coupled Newton solve by PETSc SNES: convergence per block, guarded trial steps, detection of cycles.

Options reach SNES, KSP and PC from the command line under the solver's prefix (default ``contact_``):
``-contact_snes_monitor -contact_snes_max_it 40 -contact_linear_solver iterative -contact_mat_mumps_icntl_14 200``. The matrix
is a MATNEST, which MUMPS alone of PETSc's direct solvers takes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.contact_iteration import ContactIteration
from dolfinx_mortar_al.friction_bounds import FrictionBounds
from dolfinx_mortar_al.linear_solver import EXTERNAL, LinearSolver
from dolfinx_mortar_al.load import Load
from dolfinx_mortar_al.problem import ContactProblem, Snapshot, check_problem
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.reductions import sum_over
from dolfinx_mortar_al.slides import Slides
from dolfinx_mortar_al.validation import number, whole

__all__ = ["NewtonResult", "NewtonSolver", "Path"]

_Reason = PETSc.SNES.ConvergedReason
NOT_FINITE = -4  # a reason that PETSc has renamed

FIRST_TENSION = 1.0  # of a start without stiffness, as a share of the membrane's stiffness in its own plane
LEAST_TENSION = 1e-12  # so much stays on what no force has met yet, lest the Jacobian be singular
LOOSENS, TIGHTENS = 0.3, 3.0  # times the tension while Newton gets on, and where the residual has grown by more than
OVERSHOOTS = 10.0  # times: forces in the plane grow first where it falls
LAW_TOLERANCE = 1e-6  # on λ̂_N of the wrong sign, of the pair's largest pressure, or of all pairs' if it has none
TRAPPED = 4  # times that a step is halved lest cells be inverted: half of the one before is taken then, once in a solve
LONGEST = 4.0  # target facets that a closed point may move over the target in one iteration
UNSUITABLE = (56, 60, 62, 86, 92)  # PETSc's error codes where a solver does not take the matrix, or is not known
ROUND_OFF = 100.0  # multiples of the tolerance in which a residual that stands still counts as round-off
SPRING = 1e-8  # of pieces that contact alone holds, as a share of their stiffness or that of what they press
MAX_ROUNDS = 60  # in which friction bounds are brought up to date in a solve
BOUND_TOLERANCE = 1e-6  # on a frozen friction bound, as a share of the largest μp
PROGRESS = 0.1  # of the residual between two visits of a contact pattern that is no cycle
STILL = 1e-3  # change of a residual that comes back: Newton's own steps leave much less, or more
HELD_BACK = 3  # iterations in a row that stand still where cells would be inverted: they will not get on
MAX_CYCLES = 6  # returns of a contact pattern before a solve is given up
WANDERS_AFTER = 8  # iterations without progress after which friction bounds are frozen,
SETTLED = 3  # if in so many of them, the last, no point has opened or closed
LETS_GO = 1e-3  # relative residual from which on Newton knows which points are beyond the target's end
WILD = 10.0  # times the residual that a solve starts from
NAMED = 3  # blocks that a failed solve names, the worst first
GIVES_UP_AFTER, NO_PROGRESS = 16, 0.1  # as it is when five iterations in a row have relative residuals above this


@dataclass
class NewtonResult:
    """Whether Newton converged, in how many iterations, the norms of each block, and why not."""

    converged: bool = False
    iterations: int = 0
    message: str = ""
    norms: list[list[float]] = field(default_factory=list)

    #: what a solve that failed says of the equilibrium itself, and the way out
    advice: str = ""
    #: of the Jacobian's determinant in each iteration, where MUMPS solves
    signs: list[float] = field(default_factory=list)

    #: whether friction bounds have led away from an unstable equilibrium
    leapt: bool = False

    #: relative residual of the last iteration: 1 is no progress at all
    residual: float = np.inf

    @property
    def wild(self) -> bool:
        """Whether forces were farther from balance on the way than at the start, by far. The pairs' residuals are shares of
        pressures, which vanish where bodies part."""
        sizes = [norms[0] for norms in self.norms]
        return bool(sizes) and max(sizes) > WILD * sizes[0]

    @property
    def unstable(self) -> bool:
        """Whether the last Jacobian's determinant is negative: a direction without resistance."""
        return bool(self.signs) and self.signs[-1] < 0


@dataclass
class Path:
    """A solve with the load as an unknown: corrections of the displacements stay normal to `direction` (owned dofs,).

    `difference` is the load difference that ∂R/∂(load) is taken with.
    """

    load: Load
    direction: NDArray[np.float64]
    difference: float


class NewtonSolver:
    """SNES on a :class:`~dolfinx_mortar_al.problem.ContactProblem`.

    Args:
        problem: the problem.
        rtol: of all blocks: forces against the bulk's and the contact's on each connected piece of a body, gaps against
            pressure over stiffness.
        max_iterations: of one solve; `-contact_snes_max_it` overrides it.
        prefix: of the PETSc options.
    """

    def __init__(
        self, problem: ContactProblem, *, rtol: float = 1e-9, max_iterations: int = 80, prefix: str = "contact_"
    ) -> None:
        check_problem(problem)
        self.problem, self.rtol = problem, number("rtol", rtol, above=0.0, below=1.0)
        self._max_iterations, self._prefix = whole("max_iterations", max_iterations, least=1), prefix
        agreed(problem.comm, "rtol, max_iterations of a NewtonSolver", (self.rtol, self._max_iterations))
        self.linear = LinearSolver(problem, prefix)
        self.contact_iteration = ContactIteration(problem, self.linear, self._size, LONGEST)
        self._bounds = FrictionBounds(problem)
        self._before, self._taken = problem.x.duplicate(), problem.x.duplicate()  # the last iteration's x and step
        self.snes = self._create()
        problem.linear_solver = self.linear
        self.linear.log()

    def _create(self) -> PETSc.SNES:
        problem, prefix, max_iterations = self.problem, self._prefix, self._max_iterations
        snes = PETSc.SNES().create(problem.comm)
        snes.setOptionsPrefix(prefix)
        snes.setFunction(self._function, problem.residual)
        snes.setJacobian(self._jacobian, problem.matrix)
        snes.setConvergenceTest(self._test)
        # after a line search that has failed SNES takes a small step for convergence, whatever its test says
        snes.setTolerances(stol=0.0, max_it=max_iterations)
        snes.setUpdate(self._update)
        snes.setLineSearchPreCheck(self._guard)
        self.linear.configure(snes.getKSP())
        # Full steps, guarded: with changes of contact state the norm of the residual says little about progress.
        self.linear.options.default("", {"snes_linesearch_type": "basic"})
        with self.linear.options:
            snes.setFromOptions()
        return snes

    def solve(self, path: Path | None = None) -> NewtonResult:
        """Solve from the problem's present state; on failure the state is the last trial's, to be restored.

        With `path` the load is an unknown too, and the present displacements are the prediction of the path.
        """
        self.problem.given.check()
        ties = self.problem.ties
        before = self.problem.snapshot() if ties is not None and ties.may_act else None
        with self.linear.options:
            result = self._solve(path, may_trust=before is not None)
            if before is not None and not result.converged and self._trust_failed(before):
                iterations = result.iterations
                result = self._solve(path)
                result.iterations += iterations
        self.linear.say_unread()
        return result

    def _trust_failed(self, before: Snapshot) -> bool:
        """Go back to where a solve began that failed; whether it trusted the elasticity of bodies in place of ties, which is
        over now (collective)."""
        ties = self.problem.ties
        if ties is None or not ties.trusts[0]:
            return False
        self.problem.restore(before)
        matters = self._slides.has_trusted or ties.trust_matters()
        ties.trusts[:] = False
        return matters

    def _solve(self, path: Path | None, *, may_trust: bool = False) -> NewtonResult:
        """Solve, with PETSc's options in place, where it `may_trust` the elasticity of bodies in place of ties (see
        :class:`~dolfinx_mortar_al.ties.Ties`)."""
        p, self._path = self.problem, path
        self.linear.begin()
        self.result = NewtonResult()
        self._patterns: list[int] = []
        self._status: list[NDArray[np.int8]] = []  # of the pairs' points at the last of them
        self._cycles, self._damping, self._whole_step = 0, 1.0, True
        self._held_back = 0  # iterations in a row whose steps were shortened lest cells be inverted
        # whether half of a step may be taken back, that of the last iteration is known, and it has been done in vain
        self._may_return, self._knows_step, self._trapped = path is None, False, False
        self._law_since, self._set_since = 0, 0
        self._bounds.begin()
        self._slides = Slides(p, self.linear.response, self.rtol, longest=LONGEST, may_trust=may_trust)
        p.begin()
        p.start_ties()
        self._linear_start = p.stopwatch.clock()
        self._tension = FIRST_TENSION if p.lacks_stiffness else 0.0
        p.pack(p.x)
        with p.stopwatch("newton"):
            try:
                self._iterate()
            except PETSc.Error as error:
                if error.ierr in UNSUITABLE:
                    raise ValueError(self.linear.unsuitable()) from error
                if error.ierr != EXTERNAL:
                    raise
                return self._singular()
        reason = self.snes.getConvergedReason()
        self.result.converged = reason == _Reason.CONVERGED_FNORM_ABS and not self._stale
        self.result.leapt = self._bounds.leave
        if self.result.converged:
            p.unpack(p.x)
            if self.result.iterations > 0:
                p.measure_ties(self.linear.response)
            if p.inverted_volume() > 0:
                self.result.converged = False
                self.result.message = "an inverted cell (det F ≤ 0) in the converged state"
        else:
            self.result.message, self.result.advice = self.result.message or self._failure(reason), self._advice()
        return self._singular() if reason == _Reason.DIVERGED_LINEAR_SOLVE else self.result

    def _iterate(self) -> None:
        """SNES, anew after each round in which friction bounds were frozen and are not μp."""
        while True:
            self._stale = 0.0
            self.snes.solve(None, self.problem.x)
            self.result.iterations += self.snes.getIterationNumber()
            if not self._stale:
                return
            if self._bounds.rounds >= MAX_ROUNDS:
                self.result.message = f"the friction bounds do not come to rest after {MAX_ROUNDS} rounds"
                return
            self._bounds.renew(self._stale)
            self._patterns, self._cycles, self._law_since, self._set_since = [], 0, 0, 0

    def _singular(self) -> NewtonResult:
        """A failed solve after which PETSc's objects cannot be used again. The next one has a fictitious tension's help,
        unless something else than stiffness was missing."""
        excuse = self.linear.excuse()
        if excuse is None:
            self.problem.slack[:] = True
            self.result.message = "the Jacobian is singular: some displacement meets no stiffness"
            self.result.advice = self._advice()
        else:
            self.result.message, self.result.advice = excuse, ""
        self.snes = self._create()
        return self.result

    # ---------------------------------------------------------------- callbacks

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        contact, bulk = self.contact_iteration.known(x)
        self.problem.assemble_residual(x, f, contact=contact, bulk=bulk)

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        self.problem.tension = self._fictitious_tension()
        first, last = max(self.result.norms[0]), max(self.result.norms[-1])
        PETSc.garbage_cleanup(self.problem.comm)  # on several ranks what Python has let go of stays until all ask
        self.problem.spring_share = SPRING * min(first, last) / max(first, 1e-300)
        self.problem.assemble_jacobian()
        self.linear.forget()
        if self.problem.matrix.handle != A.handle:  # a new pattern
            snes.setJacobian(self._jacobian, self.problem.matrix)
        self._linear_start = self.problem.stopwatch.clock()

    def _fictitious_tension(self) -> float:
        """For a start without stiffness, such as a flat membrane: a tension in the Jacobian only.

        It is counted in shares of the stiffness and multiplied by the relative residual, so that next to nothing is left
        at convergence; from iteration to iteration it shrinks faster, and grows back where that was too much. A solve may
        begin without forces, before what has come into contact presses.
        """
        norms = [max(norms) for norms in self.result.norms]
        if len(norms) > 1:
            self._tension *= LOOSENS if norms[-1] < OVERSHOOTS * norms[-2] else TIGHTENS
        first = next((norm for norm in norms if norm > 0.0), 0.0)
        share = min(first, norms[-1]) / first if first else 1.0
        return max(self._tension * share, LEAST_TENSION) if self._tension else 0.0

    def _test(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int | None:
        f = self.problem.residual.getNestSubVecs() if iteration == 0 else snes.getFunction()[0].getNestSubVecs()
        ratio = self.problem.residual_ratios(f, self.rtol, corrected=iteration > 0 and self._whole_step)
        self.result.norms.append(ratio)
        self.result.residual = max(ratio) * self.rtol
        if not np.isfinite(ratio).all():
            self.result.message = "the residual is not a number"
            return _Reason.DIVERGED_FNORM_NAN
        if (max(ratio) <= 1.0 or self._at_round_off()) and self._obeys_law():
            pardoned = [pair.active.pardon(pair.state, pair.kinematics) for pair in self.problem.pairs]
            if not any(pardoned) and (missing := [pair.name for pair in self.problem.pairs if pair.misses_most()]):
                self.result.message = f"{', '.join(missing)}: points that slid off the target's end lie in the target"
                return _Reason.DIVERGED_LOCAL_MIN
            if not any(pardoned) and self._follows_again(iteration):
                return None
            if not any(pardoned) and self._bounds_are_stale():
                return _Reason.CONVERGED_FNORM_ABS
            if not any(pardoned) and not self._slide(iteration):
                return None if self._lets_go(iteration) else _Reason.CONVERGED_FNORM_ABS
            if self._slides.lead_nowhere:
                self.result.message = "nothing that resists a slide has been found, at whatever place"
                return _Reason.DIVERGED_LOCAL_MIN
            return None
        ties = self.problem.ties
        if self.result.residual <= LETS_GO and not (ties is not None and ties.acts):  # tied, it is another equilibrium
            self._lets_go(iteration)
        recent = [max(norms) * self.rtol for norms in self.result.norms[-5:]]
        tries = iteration - self._law_since
        settled = iteration - self._set_since >= SETTLED
        if tries >= WANDERS_AFTER and settled and min(recent) > NO_PROGRESS and self._freeze(iteration):
            return None
        allowed = 2 * GIVES_UP_AFTER if self.problem.lacks_stiffness else GIVES_UP_AFTER
        if iteration >= snes.getTolerances()[3] or (tries >= allowed and min(recent) > NO_PROGRESS):
            return _Reason.DIVERGED_MAX_IT  # a long walk of the contact's edge, one facet at a time, may go on
        return self._watch_pattern(iteration)

    def _obeys_law(self) -> bool:
        """Whether points are closed and open as eq. (1) has them. Beside others that press, a pair of which one last point
        hangs on by round-off does (collective)."""
        pressures = [pair.largest_pressure() for pair in self.problem.pairs]
        most = max(pressures, default=0.0)
        return all(
            pair.violation() <= LAW_TOLERANCE * (p or most)
            for pair, p in zip(self.problem.pairs, pressures, strict=True)
        )

    def _at_round_off(self) -> bool:
        """Whether the residual stands still a little above its tolerance: on fine meshes round-off may lie there."""
        last = [max(norms) for norms in self.result.norms[-3:]]
        return len(last) == 3 and max(last) <= ROUND_OFF and last[2] > 0.5 * last[1] and last[1] > 0.5 * last[0]

    def _size(self, f: PETSc.Vec) -> float:
        """The residual f in units of its tolerance (collective)."""
        return max(self.problem.residual_ratios(f.getNestSubVecs(), self.rtol, corrected=True))

    def _update(self, snes: PETSc.SNES, iteration: int) -> None:
        """At the start of an iteration the active sets change, and the residual with them."""
        if iteration > 0:
            self.problem.follow(snes.getFunction()[0])
        if self.problem.decide(snes.getFunction()[0]):
            self._set_since = iteration
        self.problem.catch_slipping(snes.getFunction()[0], begins=iteration == 0)
        if len(self.result.norms) == 1 and self._path is None:
            self.problem.loosen_ties(snes.getFunction()[0])

    def _watch_pattern(self, iteration: int) -> int | None:
        """When the open/slip/stick pattern comes back to an earlier one: let what is held smooth stay so; then freeze the
        friction bounds, under which stick and slip do not cycle; where that has been done or there is no friction, damp the
        next step and let points open and close less readily. Give up when nothing helps."""
        pattern = self.problem.contact_pattern()
        self._damping = 1.0
        returns = pattern in self._patterns[:-1] and pattern != self._patterns[-1] and self._no_nearer(pattern)
        # under a fictitious tension steps are short at first, and leave the residual nearly as it is
        free = self.problem.tension <= LEAST_TENSION
        stands_still = free and self._stands_still(pattern)
        if self._trapped or (not returns and stands_still and self._held_back >= HELD_BACK):
            self.result.message = (
                f"each step would leave an inverted cell (det F ≤ 0), however short; forces{self._worst_place()[1:]}"
            )
            return _Reason.DIVERGED_LOCAL_MIN
        if returns or stands_still or (free and self._alternates(pattern)):
            self._cycles += 1
            if self._cycles > MAX_CYCLES:
                where = (
                    self.problem.changed_points(self._status) if returns else f"in each iteration{self._worst_place()}"
                )
                self.result.message = f"the contact state cycles, {where}"
                return _Reason.DIVERGED_LOCAL_MIN
            if not any([pair.hold_facets() for pair in self.problem.pairs]) and not self._freeze(iteration):
                self._damping = 0.5
                for pair in self.problem.pairs:
                    pair.active.trust *= 10.0
        self._patterns.append(pattern)
        self._status = [pair.state.status for pair in self.problem.pairs]
        return None

    def _stands_still(self, pattern: int) -> bool:
        """Whether the last iterations have led back to the same state, pattern and residual: what goes to and fro within one,
        as contact settles on the linearised bulk, is not seen from outside."""
        last = [max(norms) for norms in self.result.norms[-3:]]
        same = len(last) == 3 and max(last) - min(last) <= STILL * max(last)
        return same and self._patterns[-2:] == [pattern, pattern]

    def _alternates(self, pattern: int) -> bool:
        """Whether Newton goes to and fro between two residuals while no point changes its state."""
        last = [max(norms) for norms in self.result.norms[-4:]]
        if len(last) < 4 or self._patterns[-3:] != [pattern] * 3:
            return False
        return max(abs(last[2] - last[0]), abs(last[3] - last[1])) <= STILL * max(last)

    def _no_nearer(self, pattern: int) -> bool:
        """Whether the residual is hardly smaller than when this contact pattern was there last."""
        norms = self.result.norms[-len(self._patterns) - 1 :]
        then = len(self._patterns) - 1 - self._patterns[::-1].index(pattern)
        return max(norms[-1]) > PROGRESS * max(norms[then])

    def _freeze(self, iteration: int) -> bool:
        """Freeze the friction bounds; whether there were any that were free."""
        free = self._bounds.freeze()
        self._law_since = iteration if free else self._law_since
        return free

    def _bounds_are_stale(self) -> bool:
        """Whether a state has converged with friction bounds that were frozen and are not μp."""
        error = self._bounds.error
        self._stale = error if error > BOUND_TOLERANCE else 0.0
        return self._stale > 0.0

    def _lets_go(self, iteration: int) -> bool:
        """Let points beyond the target's end go; whether there were any (collective)."""
        if not any([pair.let_go() for pair in self.problem.pairs]):
            return False
        self._slides.forget()  # what ties bore with them in contact
        self._goes_on(iteration)
        return True

    def _slide(self, iteration: int) -> bool:
        """A state has converged with pieces tied to where they were: tie them elsewhere; whether there was anything to change
        (collective)."""
        if not self._slides.go_on(self.snes.getFunction()[0], measures=iteration > 0):
            return False
        self._patterns, self._cycles, self._law_since = [], 0, iteration
        return True

    def _follows_again(self, iteration: int) -> bool:
        """A state has converged with points at rest while the target's end has moved: let them follow; whether any do
        (collective)."""
        if not any([pair.follow_again() for pair in self.problem.pairs]):
            return False
        self._goes_on(iteration)
        return True

    def _goes_on(self, iteration: int) -> None:
        """The contact state is another one: the residual follows, and no cycle is known yet."""
        self._patterns, self._cycles, self._law_since = [], 0, iteration
        self.problem.reconsider(self.snes.getFunction()[0])

    def _guard(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Shorten the step x ← x − y until no cell is inverted and no closed point slides too far."""
        p = self.problem
        p.stopwatch.add("linear solve", p.stopwatch.clock() - self._linear_start)
        self._note_stability()
        self.linear.add_ties(y)
        change = self._change_load(y) if self._path is not None else 0.0
        length = self._damping
        with p.stopwatch("guard"):
            xu, yu = x.getNestSubVecs()[0], y.getNestSubVecs()[0]
            p.bodies.set(xu.array_r - length * yu.array_r)
            motion = max([pair.relative_motion() for pair in p.pairs], default=0.0)
            if p.unsupported():  # a piece in free flight must not fly through its target
                motion = max(motion, p.longest_motion(yu.array_r) * length)
            if motion > LONGEST:
                length *= LONGEST / motion
                p.bodies.set(xu.array_r - length * yu.array_r)
            self._held_back += 1
            for n in range(12):
                if p.inverted_volume() <= 0:
                    self._held_back *= n > 0
                    break
                length /= 2
                p.bodies.set(xu.array_r - length * yu.array_r)
        if n >= TRAPPED and self._may_return and self._knows_step:
            self._return_half_way(x, y)
            return True
        self._trapped |= n >= TRAPPED and self._path is None and not self._may_return
        self._whole_step = length == 1.0
        if self._path is not None:
            self._path.load.number += length * change
        if length < 1.0:
            y.scale(length)
        p.tighten_ties()
        improved = self._path is None and self._improve(x, y, length)
        if self._may_return:
            x.copy(self._before)
            y.copy(self._taken)
            self._knows_step = True
        return improved or length < 1.0 or self._path is not None

    def _return_half_way(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Let x − y be half way to x in the last iteration's step: that has left a cell so little of its volume that steps
        from x would invert it, however short."""
        self._may_return, self._held_back, self._whole_step = False, 0, False
        y.waxpy(-1.0, self._before, x)
        y.axpy(0.5, self._taken)

    def _improve(self, x: PETSc.Vec, y: PETSc.Vec, share: float) -> bool:
        """Let contact settle on the linearised bulk; whether the step x ← x − y is another than that `share` of Newton's now.
        It is not where it would invert a cell or move a node by more than LONGEST facets."""
        p = self.problem
        with p.stopwatch("contact iteration"):
            f = self.snes.getFunction()[0]
            change = self.contact_iteration.improve(x, y, max(self.result.norms[-1]), f, share)
            if change is None:
                return False
            yu = y.getNestSubVecs()[0].array_r + change.getNestSubVecs()[0].array_r
            p.bodies.set(x.getNestSubVecs()[0].array_r - yu)
            if p.longest_motion(change.getNestSubVecs()[0].array_r) > LONGEST or p.inverted_volume() > 0:
                self.contact_iteration.undo()
                return False
            y.axpy(1.0, change)
        return True

    def _note_stability(self) -> None:
        """Remember the sign of the Jacobian's determinant, where it is known."""
        sign = self.linear.sign()
        if sign is not None:
            self.result.signs.append(sign)

    def _change_load(self, y: PETSc.Vec) -> float:
        """The change of load that keeps the step x ← x − y on the path's plane; y is changed with it.

        With y = 𝐊⁻¹𝐑 and z = 𝐊⁻¹ ∂𝐑/∂λ the step is −(y + Δλ z), and 𝐝·(y + Δλ z) = 0 gives Δλ.
        """
        p, path = self.problem, self._path
        assert path is not None
        there, here = p.residual.duplicate(), p.residual.duplicate()
        there.set(0.0)
        λ, δ = path.load.number, path.difference
        p.bodies.residual(here.getNestSubVecs()[0])
        path.load.number = λ + δ
        p.bodies.residual(there.getNestSubVecs()[0])
        path.load.number = λ
        right, z = there.getNestSubVecs()[0], y.duplicate()
        right.axpy(-1.0, here.getNestSubVecs()[0])
        right.scale(1.0 / δ)
        self.snes.getKSP().solve(there, z)
        self.linear.add_ties(z)
        along = [path.direction @ v.getNestSubVecs()[0].array_r for v in (y, z)]
        dy, dz = (sum_over(p.comm, float(a)) for a in along)
        y.axpy(-dy / dz, z)
        return -dy / dz

    def _failure(self, reason: int) -> str:
        """Why a solve failed: which blocks, where, and what to do."""
        if not self.result.norms:
            return "the residual is not a number at the start: a cell is inverted, or a law, load or condition has none"
        names, last = ["equilibrium", *(pair.name for pair in self.problem.pairs)], self.result.norms[-1]
        far = sorted((-v, n) for n, v in zip(names, last, strict=True) if v > 1)
        open_blocks = ", ".join(f"{n} at {-v:.1e} of its tolerance" for v, n in far[:NAMED])
        open_blocks += f" and {len(far) - NAMED} more" if len(far) > NAMED else ""
        if not open_blocks:
            rest = "what sticks or is tied does" if self._obeys_law() else "points that open and close do"
            open_blocks = f"forces and gaps are right, but {rest} not come to rest"
        known = {
            _Reason.DIVERGED_MAX_IT: "no convergence",
            _Reason.DIVERGED_LINEAR_SOLVE: "the linear solve failed",
            _Reason.DIVERGED_LINE_SEARCH: "the line search of the options found nothing better",
            NOT_FINITE: "the residual became infinite or not a number",
        }
        why = known.get(reason, f"SNES stopped with reason {reason}")
        return f"{why} after {self.result.iterations} iterations: {open_blocks}{self._worst_place()}"

    def _worst_place(self) -> str:
        """Where the forces on what may move are farthest from equilibrium (collective)."""
        bodies, forces = self.problem.bodies, self.snes.getFunction()[0].getNestSubVecs()[0].array_r
        _, X = bodies.farthest(np.where(bodies.prescribed(), 0.0, forces))
        return f", worst at X = ({', '.join(f'{x:.4g}' for x in X)})"

    def _nearest_is_unstable(self) -> bool:
        """Whether the determinant is negative at the iterate of the least residual; elsewhere it says nothing."""
        worst = [max(norms) for norms, _ in zip(self.result.norms, self.result.signs, strict=False)]
        return bool(worst) and self.result.signs[int(np.argmin(worst))] < 0

    def _advice(self) -> str:
        """What a failed solve says of the equilibrium itself, after a semicolon."""
        p = self.problem
        parts = [str(node) for pair in p.pairs if (node := pair.pushed_node()) is not None]
        off = self.snes.getFunction()[0].getNestSubVecs()[0]
        if p.floating and (loose := p.unheld(off)):
            rub = "" if all(pair.friction > 0 for pair in p.pairs) else "add friction, "
            parts.append(
                f"{' and '.join(loose)}: if it may slide, roll off or topple, or a load pulls it away (its sign?), "
                f"press it on, prescribe the motion that is free (of one node, along the surface), {rub}or let it move "
                "with dynamics.march"
            )
        elif far := [
            f"{pair.name}: {name} = {ratio * ε.suggested:.3g} Pa/m where the bulk suggests {ε.suggested:.3g}"
            for pair, ε in ((pair, pair.augmentation) for pair in p.pairs)
            for name, ratio in ε.far_off().items()
        ]:
            parts.append(f"{', '.join(far)}: leave it out")
        elif self._nearest_is_unstable() and p.motions:
            parts.append(
                "the Jacobian's determinant is negative on the way: Δt is long for how it moves; take a smaller one; "
                "or matter is near inversion: take a law that resists compression"
            )
        elif self._nearest_is_unstable():
            parts.append(
                "the Jacobian's determinant is negative on the way: an unstable equilibrium (a limit or bifurcation point) "
                "is near; follow it with quasistatic.follow, prescribe a displacement, or let it move with dynamics.march"
            )
        parts += [advice for pair in p.pairs if (advice := pair.doubts_roles()) is not None]
        return "".join(f"; {part}" for part in parts)
