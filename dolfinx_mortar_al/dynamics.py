"""Impact of deformable bodies: momentum, angular momentum and the energy balance exact, gaps held (``docs/impact.md``).

The mid-point rule with the energy-consistent internal force 𝐆 and the mean contact force 𝐑 of a step,

    𝐮_{n+1} = 𝐮_n + Δt [θ 𝐯* + (1−θ) 𝐯_n],     𝐌(𝐯* − 𝐯_n)/Δt + 𝐆 = 𝐑,

with eq. (1) for the gap at the end of the step and the relative motion over it (`step_level`), so that contact and friction
can only take energy; then 𝐯_{n+1} is 𝐯* made compatible with the contact that persists (`velocity_projection`). The unknown
is 𝐮_{n+1}: bodies, contact pairs and Newton are those of statics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al import validation
from dolfinx_mortar_al.drift import DriftMonitor
from dolfinx_mortar_al.ledger import Ledger
from dolfinx_mortar_al.monitors import Finding, Reporter
from dolfinx_mortar_al.motion import Motion
from dolfinx_mortar_al.newton import NewtonSolver
from dolfinx_mortar_al.problem import ContactProblem, Snapshot
from dolfinx_mortar_al.quasistatic import StepFailure
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.velocity_projection import VelocityProjection

__all__ = ["Ledger", "Motion", "Step", "march"]

Array = NDArray[np.float64]

EASY = 8  # Newton iterations up to which a step that was cut may grow again
RTOL = 1e-11  # of Newton: what is left over shows up in the ledger
GAIN = (
    1e-8  # of the total energy that contact may give in a step: what Newton's tolerance leaves, a thousand times over
)
GROWTH = 2.0  # of Δt from one step to the next at most, where the march chooses it
SAFETY = 0.9  # of the Δt that would just meet the tolerance
FAR = 2.0  # times the tolerance beyond which a step is repeated


@dataclass(frozen=True)
class Step:
    """A converged step: time (s), Δt, Newton iterations (rejected trials included), rejected trials, wall time (s), whether
    the time is one of the asked-for ones, the ledger, the mean contact force on each contactor (N), the largest penetration
    of a closed point (m), and what the monitors found, that of a drift among them."""

    time: float
    step: float
    iterations: int
    rejected: int
    wall_time: float
    nominal: bool
    ledger: Ledger
    forces: tuple[Array, ...]
    penetration: float
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class _Work:
    """What contact does in a step (J): on the bodies along the normal and along the surface, what obstacles put in, and what
    is lost for good along the normal."""

    normal: float
    tangential: float
    by_obstacles: float
    lost: float


def march(
    problem: ContactProblem,
    motions: Motion | Sequence[Motion],
    *,
    to: float,
    start: float = 0.0,
    move: Callable[[float], None] | None = None,
    tolerance: float | None = None,
    solver: NewtonSolver | None = None,
    smallest: float = 2.0**-10,
    ledger: Ledger | None = None,
) -> Iterator[Step]:
    """Move bodies from `start` to `to`, with steps of the motions' Δt; yields each converged step.

    A step that fails is undone, velocities included, and tried again with half of Δt, which grows back after easy steps;
    the times start + k Δt are always met. Besides a failure of Newton these are failures: contact that gives energy, and
    points that have passed through a target. Multipliers are warm-started with those of the last step.

    Args:
        problem: made with the motions' residuals.
        motions: one per displacement of the problem.
        to, start: final and initial time (s).
        move: sets all that depends on time: poses of obstacles, Dirichlet values.
        tolerance: local error of the displacements (m, root mean square over the body where it is largest) by which Δt is
            chosen, never longer than the motions' own; by default it is theirs.
        solver: default one with tolerance RTOL.
        smallest: Δt, relative to the motions' own, below which the march gives up.
        ledger: to go on with, from an earlier march.

    Raises:
        ValueError: `to` not after `start`, a tolerance that is not positive, or motions other than those of the problem, one
            for each displacement.
        StepFailure: on every rank.
    """
    all_motions = validation.listed("motions", motions, Motion, "a Motion")
    if move is not None:
        validation.check_callable("move", move, "the time")
    validation.check_motions(all_motions, [body.u for body in problem.bodies.bodies])
    start, smallest = validation.number("start", start), validation.number("smallest", smallest, above=0.0, most=1.0)
    to = validation.number("to", to, above=start, must="the end of the march must be")
    if tolerance is not None:
        tolerance = validation.number("tolerance", tolerance, above=0.0)
    said = (start, to, tolerance, [float(motion.time_step.value) for motion in all_motions])
    agreed(problem.comm, "start, to, tolerance, Δt", said)
    problem.members |= {f"motion{k}": motion for k, motion in enumerate(all_motions)}
    stepper = _Stepper(problem, all_motions, move, solver, ledger)
    validation.check_kinetic(stepper.ledger.kinetic)
    longest = float(stepper.motions[0].time_step.value)
    steps = int(np.ceil((to - start) / longest - 1e-9))
    time, Δt, number = start, longest, 1
    while number <= steps:
        mark = min(start + number * longest, to)
        parts = max(int(np.ceil((mark - time) / Δt - 1e-9)), 1)  # equal ones: no tiny step is left over
        trial, nominal = (mark - time) / parts, parts == 1
        easy = stepper.try_step(time, trial)
        share = 0.0 if tolerance is None or not easy else stepper.local_error(trial) / tolerance
        if not easy or share > FAR:
            Δt = trial / 2 if not easy else trial * max(0.2, SAFETY * share ** (-1 / 3))
            stepper.undo(time, give_up=Δt < smallest * longest)
            continue
        time = mark if nominal else time + trial
        if tolerance is not None:
            Δt = min(trial * min(GROWTH, SAFETY * max(share, 1e-12) ** (-1 / 3)), longest)
        elif stepper.easy:
            Δt = min(GROWTH * Δt, longest)
        number += int(nominal)
        yield stepper.accept(time, trial, nominal)


class _Stepper:
    """One time step after the other: predict, solve, keep the books or undo."""

    def __init__(
        self,
        problem: ContactProblem,
        motions: list[Motion],
        move: Callable[[float], None] | None,
        solver: NewtonSolver | None,
        ledger: Ledger | None,
    ) -> None:
        self.problem, self.motions = problem, motions
        self.move: Callable[[float], None] = move if move is not None else lambda t: None
        self.solver = NewtonSolver(problem, rtol=RTOL) if solver is None else solver
        θ = {motion.theta for motion in motions}
        if len(θ) > 1:
            raise ValueError(f"theta = {sorted(θ)}: all motions of a problem need the same θ")
        self.theta = θ.pop()
        self.levels = [pair.use_steps() for pair in problem.pairs]
        self._projection = VelocityProjection(problem, motions)
        problem.evaluate()
        now = self._with_state(Ledger(0.0, 0.0) if ledger is None else ledger)
        self.ledger = now if ledger is None else ledger
        self._drift = DriftMonitor(problem, motions, now)
        self._rate: Array | None = None
        self._next_rate: Array | None = None
        self._reporter = Reporter(problem.comm.rank)
        self._clock, self.rejected, self.iterations = perf_counter(), 0, 0

    def _with_state(self, ledger: Ledger) -> Ledger:
        energies = np.sum([motion.energies() for motion in self.motions], axis=0)
        momenta = np.sum([motion.momenta() for motion in self.motions], axis=0)
        d = self.problem.gdim
        momentum, spin = tuple(momenta[:d].tolist()), tuple(momenta[d:].tolist())
        stored = sum(pair.stored_energy() for pair in self.problem.pairs)
        return replace(
            ledger, kinetic=float(energies[0]), strain=float(energies[1]), contact=stored, momentum=momentum,
            angular_momentum=spin,
        )  # fmt: skip

    def try_step(self, time: float, Δt: float) -> bool:
        """Solve for the state at time + Δt; whether that is a good one."""
        problem = self.problem
        self._before: Snapshot = problem.snapshot()
        for motion in self.motions:
            motion.time_step.value = Δt
            motion.predict()
        self.move(time + Δt / 2)
        for level in self.levels:
            level.predict()
        for motion in self.motions:
            motion.undo()
        self.move(time)
        for pair in self.problem.pairs:
            pair.begin_step()
        self.move(time + Δt)
        for motion in self.motions:
            motion.guess()
        if problem.inverted_volume() > 0:  # a long step of a body under strong compression
            for motion in self.motions:
                motion.undo()
        problem.force_reference = self._inertia_scale(Δt)
        result = self.solver.solve()
        self.iterations += result.iterations
        self.easy, self._message = result.iterations <= EASY, result.message
        self._findings = problem.findings() if result.converged else []
        return result.converged and self._is_sound()

    def _is_sound(self) -> bool:
        """Whether a converged state is one: no fatal finding, no energy from contact, nothing passed through."""
        self._work = self._contact_work()
        reasons = [str(f) for f in self._findings if f.fatal]
        allowed = GAIN * max(self.ledger.total + self.ledger.impact_loss + self.ledger.friction_dissipation, 0.0)
        gain = max(-self._work.lost, self._work.tangential)
        if gain > allowed:
            reasons.append(f"contact would give {gain:.3g} J to the bodies in this step; take a smaller one")
        for pair, level in zip(self.problem.pairs, self.levels, strict=True):
            passed = level.passed_through(pair.state)
            X = np.concatenate(self.problem.comm.allgather(pair.points()[passed]))
            if len(X):
                place = np.array2string(X[0], precision=4)
                reasons.append(
                    f"{pair.name}: {len(X)} points pass through the target in this step, the first at X = {place}; take a "
                    "smaller one"
                )
        self._message = "; ".join(reasons) or self._message
        return not reasons

    def _contact_work(self) -> _Work:
        problem, stored = self.problem, 0.0
        sums = np.zeros(3)
        for level, pair in zip(self.levels, problem.pairs, strict=True):
            done = level.work(pair.state, pair.j)
            sums += problem.comm.allreduce(np.array([done.normal, done.tangential, done.by_obstacle]), MPI.SUM)
            stored += pair.stored_energy()
        normal, tangential, by_obstacles = sums.tolist()
        return _Work(normal, tangential, by_obstacles, self.ledger.contact - stored - normal)

    def local_error(self, Δt: float) -> float:
        """What the mid-point rule leaves out in this step, Δt³ 𝐮‴/12 (m): the root mean square over the components of each
        connected body, of which the largest, so that those at rest do not hide what a small one does. For Δt 𝐮‴ the jump of
        the mean acceleration from the last step (zero at the start) to this one."""
        new = [2 / Δt**2 * (m.u.x.array - m.old.x.array) - 2 / Δt * m.velocity.x.array for m in self.motions]
        sizes = [m.u.function_space.dofmap.index_map.size_local * self.problem.gdim for m in self.motions]
        rate = np.concatenate([a[:n] for a, n in zip(new, sizes, strict=True)])
        jump = rate if self._rate is None else rate - self._rate  # a start without acceleration may be an impact
        self._next_rate = rate
        bodies = self.problem.bodies
        return float(Δt**2 / 12 * (bodies.norms(jump) / bodies.norms(np.ones(len(jump)))).max())

    def _inertia_scale(self, Δt: float) -> float:
        """Norm of nodal momenta per Δt (N), roughly: the size of forces that a step of this length resolves."""
        comm, kinetic = self.problem.comm, self.ledger.kinetic
        largest = max(comm.allreduce(float(np.abs(m.velocity.x.array).max(initial=0.0)), MPI.MAX) for m in self.motions)
        return 2 * kinetic / (largest * Δt) / np.sqrt(self.problem.bodies.layout.total) if largest > 0 else 0.0

    def undo(self, time: float, give_up: bool) -> None:
        """Back to the last accepted state; `give_up` ends the run with the reason."""
        for motion in self.motions:
            motion.undo()
        self.problem.restore(self._before)
        self.move(time)
        self.rejected += 1
        if give_up:
            raise StepFailure(f"no convergence after time {time:.6g} s with the smallest step: {self._message}")

    def accept(self, time: float, Δt: float, nominal: bool) -> Step:
        """Velocities, ledger, and what the step reports."""
        problem, last, done = self.problem, self.ledger, self._work
        work = sum(motion.external_work() for motion in self.motions) + done.by_obstacles
        for motion in self.motions:
            motion.accept()
        self._rate = self._next_rate
        settled = self._projection.apply(Δt, -done.tangential)
        forces = tuple(pair.force() + i / Δt for pair, i in zip(problem.pairs, settled.impulses, strict=True))
        problem.commit()
        now = self._with_state(last)
        work, loss = work + settled.by_obstacles, done.lost + settled.lost
        friction = settled.friction - done.tangential
        self.ledger = replace(
            now,
            external_work=last.external_work + work,
            friction_dissipation=last.friction_dissipation + friction,
            impact_loss=last.impact_loss + loss,
            energy_defect=last.energy_defect + now.total - last.total - work + friction + loss,
        )
        seconds = perf_counter() - self._clock
        depths = [pair.penetration() for pair in problem.pairs]
        found = (*self._findings, *self._drift.look(self.ledger, depths))
        deepest = max(depths, default=0.0)
        step = Step(time, Δt, self.iterations, self.rejected, seconds, nominal, self.ledger, forces, deepest, found)
        self._reporter.report(found, f"time {time:.6g} s")
        self.rejected, self.iterations, self._clock = 0, 0, perf_counter()
        return step
