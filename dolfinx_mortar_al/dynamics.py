"""Impact of deformable bodies: momentum, angular momentum and the energy balance exact, gaps held (``docs/impact.md``).

The mid-point rule with the energy-consistent internal force 𝐆 and the mean contact force 𝐑 of a step,

    𝐮_{n+1} = 𝐮_n + Δt [θ 𝐯* + (1−θ) 𝐯_n],     𝐌(𝐯* − 𝐯_n)/Δt + 𝐆 = 𝐑,

with eq. (1) for the gap at the end of the step and the relative motion over it (`step_level`), so that contact and friction
can only take energy; then 𝐯_{n+1} is 𝐯* made compatible with the contact that persists (`velocity_projection`). The unknown
is 𝐮_{n+1}: bodies, contact pairs and Newton are those of statics.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al import stepping, validation
from dolfinx_mortar_al.drift import DriftMonitor
from dolfinx_mortar_al.ledger import Ledger
from dolfinx_mortar_al.monitors import Finding
from dolfinx_mortar_al.motion import Motion
from dolfinx_mortar_al.newton import NewtonSolver
from dolfinx_mortar_al.problem import ContactProblem, Snapshot, check_problem
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over
from dolfinx_mortar_al.stepping import Attempt, Bar, Controller, Event, March, StepFailure
from dolfinx_mortar_al.supports import Supports
from dolfinx_mortar_al.velocity_projection import VelocityProjection

__all__ = ["Ledger", "Motion", "Step", "StepFailure", "march"]

Array = NDArray[np.float64]

LONG = 1e6  # of a step: in so long a time inertia is nothing
RTOL = 1e-11  # of Newton: what is left over shows up in the ledger
# of what energies amount to that contact may give in a step: what Newton's tolerance leaves, a thousand times over
GAIN = 1e-8
COPIES = (
    "they are kept as the displacement of the last step, and rates made of them count by θ only: pass Motion(old=…)"
)
PARTED = (
    "the bodies overlapped at the start, and were moved apart, which has stored this energy in them that no load has put in: "
    "part them in the meshes, or, if one is pressed into the other, begin from quasistatic.equilibrate; after a static "
    "solution the contact is hardly wider than a facet: refine the contactor there, to a third of the contact's width"
)
UNMEANT = 0.05  # of the energy at the start: a static solution's is changed by less
SAFETY = 0.9  # of the Δt that would just meet the tolerance
FAR = 2.0  # times the tolerance beyond which a step is repeated


@dataclass(frozen=True, kw_only=True)
class Step(stepping.Step):
    """A converged step in time.

    Attributes:
        time: reached (s).
        step: Δt (s).
        ledger: energies and momenta.
        forces: the mean contact force of the step on each contactor (N).
        penetration: the largest one of a closed point (m).
    """

    time: float
    step: float
    ledger: Ledger
    forces: tuple[Array, ...]
    penetration: float


@dataclass(frozen=True)
class _Work:
    """What contact does in a step (J): on the bodies along the normal and along the surface, what obstacles put in, what is
    lost for good along the normal and by friction, and the most that augmentation stores at either end."""

    normal: float
    tangential: float
    by_obstacles: float
    lost: float
    rubbed: float
    stored: float

    @property
    def gain(self) -> float:
        """What contact would give (J): on the whole, or along the normal or by friction beyond what is stored, which passes
        from one to the other as nodes' normals turn from step to step."""
        return max(-(self.lost + self.rubbed), -self.lost - self.stored, -self.rubbed - self.stored)


def march(
    problem: ContactProblem,
    *,
    to: float,
    start: float = 0.0,
    move: Callable[[float], None] | None = None,
    tolerance: float | None = None,
    solver: NewtonSolver | None = None,
    smallest: float = 2.0**-10,
    ledger: Ledger | None = None,
    until: Callable[[], bool] | None = None,
    progress: bool = False,
) -> Iterator[Step]:
    """Move bodies from `start` to `to`, with steps of the motions' Δt; yields each converged step. They begin with the
    displacements and velocities that their functions hold.

    A step that fails is undone, velocities included, and tried again with half of Δt, which grows back after easy steps;
    the times start + k Δt are always met. Besides a failure of Newton these are failures: contact that gives energy, and
    points that have passed through a target. Multipliers are warm-started with those of the last step.

    Args:
        problem: made of motions.
        to, start: final and initial time (s).
        move: sets all that depends on time: poses of obstacles, Dirichlet values. Unless the march goes on with a `ledger`,
            prescribed components begin with the velocity that it gives them, whatever their Function holds.
        tolerance: local error of the displacements (m, root mean square over the body where it is largest) by which Δt is
            chosen, never longer than the motions' own; by default it is theirs.
        solver: default one with tolerance RTOL.
        smallest: Δt, relative to the motions' own, below which the march gives up.
        ledger: to go on with, from an earlier march.
        until: an event of the state at the end of a step, velocities included, the same on every rank. The march ends with
            the first step where it holds, after closing in on it down to 1/64 of the motions' Δt.
        progress: show a progress bar with time, iterations and contact state (rank 0, standard error).

    Raises:
        ValueError: at the call: `to` not after `start`, or before it with a `ledger`, a tolerance that is not positive, or
            with another θ than ½, a problem with a body that is no motion, or a motion without mass.
        StepFailure: on every rank, in a step.
    """
    check_problem(problem)
    motions = problem.motions
    validation.check_motions(motions, len(problem.bodies.bodies))
    if move is not None:
        validation.check_callable("move", move, "the time")
    start, smallest = validation.number("start", start), validation.number("smallest", smallest, above=0.0, most=1.0)
    bound = {"above": start} if ledger is None else {"least": start}  # what is over may be gone on with, for no step
    to = validation.number("to", to, **bound, must="the end of the march must be")
    if tolerance is not None:
        tolerance = validation.number("tolerance", tolerance, above=0.0)
    said = (start, to, tolerance, smallest, [float(motion.time_step.value) for motion in motions])
    agreed(problem.comm, "start, to, tolerance, smallest, Δt", said)
    steps = sorted({float(motion.time_step.value) for motion in motions})
    if len(steps) > 1:
        raise ValueError(f"step = {steps}: all motions of a problem need the same Δt")
    θ = {motion.theta for motion in motions}
    if len(θ) > 1:
        raise ValueError(f"theta = {sorted(θ)}: all motions of a problem need the same θ")
    if tolerance is not None and θ != {0.5}:
        raise ValueError(
            f"tolerance = {tolerance} with theta = {motions[0].theta}: Δt is chosen by the error of the mid-point rule, "
            "theta = 0.5; leave the tolerance out, and choose step="
        )
    if not isinstance(ledger, Ledger | None):
        raise ValueError(
            f"ledger: {type(ledger).__name__} is no Ledger; pass that of the last step of an earlier march"
        )
    agreed(problem.comm, "ledger: its energies", ledger if ledger is None else ledger.total)
    event, solver = Event(problem.comm, until), stepping.solver_of(problem, solver, rtol=RTOL)
    for k, motion in enumerate(motions):  # a density may be a Function, with other values than when it was passed
        motion.body.check_densities()
        validation.number(f"mass of motion {k} (kg)", motion.mass, above=0.0, must="its density must make it")
    validation.check_kinetic(sum(motion.kinetic_energy() for motion in motions))
    way = _Way(start, to, float(motions[0].time_step.value), tolerance, smallest)
    return March(_steps(_TimeControl(problem, way, move or _stay, solver, ledger, event), progress), problem.comm.rank)


def _steps(control: _TimeControl, progress: bool) -> Generator[Step, None, None]:
    control.problem.given.check()
    try:
        with Bar(control.problem, progress) as bar:
            yield from stepping.run(control, bar)
    finally:
        control.leave()


@dataclass(frozen=True)
class _Way:
    """From `start` to `to` (s): the longest step (s), the tolerance (m), and the smallest step as a share of the longest."""

    start: float
    to: float
    longest: float
    tolerance: float | None
    smallest: float

    @property
    def steps(self) -> int:
        """Times that are always met."""
        return int(np.ceil((self.to - self.start) / self.longest - 1e-9))


def _stay(time: float) -> None:
    """Nothing depends on time."""


class _TimeControl(Controller[Step]):
    """Time moves: predict, solve, judge, keep the books. Lengths are shares of the motions' Δt, `longest`."""

    def __init__(
        self,
        problem: ContactProblem,
        way: _Way,
        move: Callable[[float], None],
        solver: NewtonSolver,
        ledger: Ledger | None,
        event: Event,
    ) -> None:
        self.problem, self.motions, self.move, self.solver = problem, problem.motions, move, solver
        self._way, self.smallest, self._event, self._over = way, way.smallest, event, False
        self._given = ledger
        self._rate: Array | None = None
        self._next_rate: Array | None = None
        self._time, self._number = way.start, 1
        self._told: list[Finding] = []  # of the start, with the first step

    def begin(self) -> None:
        for motion in self.motions:
            motion.take_up()
        self.levels = [pair.use_steps() for pair in self.problem.pairs]
        self._supports = Supports(self.problem)
        if self._given is None:  # a march that goes on goes on with their velocities
            self._supports.begin(self.move, self._way.start, self._way.longest)
        self._projection = VelocityProjection(self.problem, self._supports)
        self.problem.evaluate()
        touches = any(pair.touches().any() for pair in self.problem.pairs)
        if self._given is None and any_over(self.problem.comm, touches):
            self._told = self._admitted()
        now = self._with_state(Ledger(0.0, 0.0) if self._given is None else self._given)
        self.ledger = now if self._given is None else self._given
        self._drift = DriftMonitor(self.problem, now)
        self._told += self._drift.foresee(self._way.longest)

    def _admitted(self) -> list[Finding]:
        """Move bodies that touch apart as far as they overlap; what there is to be said of it (collective)."""
        before = self._with_state(Ledger(0.0, 0.0)).strain
        self._admit()
        now = self._with_state(Ledger(0.0, 0.0))
        stored = now.strain - before
        return [Finding("energy of an overlap (J)", stored, (), PARTED, False)] if stored > UNMEANT * now.total else []

    def _admit(self) -> None:
        """Begin with positions that contact's law over a step allows, as near as may be: without inertia, nodes held by
        dashpots that bear what forces there are. Those of a static solution overlap a little more or less where facets are
        closed in part, as ε is another one there, and to part them within the first step would take the more energy the
        shorter it is."""
        problem, before = self.problem, self.problem.snapshot()
        velocities = [motion.velocity.x.array.copy() for motion in self.motions]
        for motion in self.motions:
            motion.time_step.value = LONG * self._way.longest
            motion.velocity.x.array[:] = 0.0
        for level in self.levels:
            level.predict()
        for pair in problem.pairs:
            pair.begin_step()
        problem.force_reference = 0.0
        problem.dashpots = problem.holding_dashpots()
        try:
            pressed = self.solver.solve().converged and problem.is_pressed()
            if pressed:
                for motion in self.motions:
                    motion.take_up()
                problem.commit()
            else:
                problem.restore(before)
        finally:
            problem.dashpots = None
            for motion, v in zip(self.motions, velocities, strict=True):
                motion.time_step.value = self._way.longest
                motion.velocity.x.array[:] = v

    def leave(self) -> None:
        """The motions' Δt is again what it was."""
        for motion in self.motions:
            motion.time_step.value = self._way.longest

    # ---------------------------------------------------------------- the way

    @property
    def finished(self) -> bool:
        return self._over or self._number > self._way.steps

    @property
    def share(self) -> float:
        return 1.0 if self.finished else (self._time - self._way.start) / (self._way.to - self._way.start)

    def at(self, tried: bool = False) -> str:
        return f"time {self._end if tried else self._time:.6g} s"

    def clip(self, size: float) -> tuple[float, bool]:
        self._mark = min(self._way.start + self._number * self._way.longest, self._way.to)
        left = self._mark - self._time
        if np.isclose(left, self._way.longest, rtol=0.0, atol=4 * np.spacing(self._mark)):
            left = self._way.longest  # whatever the rounding of times, which differs where a march goes on
        parts = max(int(np.ceil(left / (size * self._way.longest) - 1e-9)), 1)  # equal ones: no tiny step is left over
        self._trial = left / parts
        return self._trial / self._way.longest, parts == 1

    def event(self) -> bool:
        self._over = self._event()
        return self._over

    def grown(self, size: float, length: float, attempt: Attempt) -> float:
        if self._way.tolerance is None:
            return super().grown(size, length, attempt)
        return min(length * min(stepping.GROWTH, SAFETY * max(self._error, 1e-12) ** (-1 / 3)), 1.0)

    def failure(self, reason: str) -> str:
        return f"no convergence after {self.at()} with the smallest step: {reason}"

    # ---------------------------------------------------------------- a step

    def attempt(self, length: float, nominal: bool) -> Attempt:
        self._end = self._mark if nominal else self._time + self._trial
        attempt = self._solve(self._time, self._trial)
        if attempt.good and self._way.tolerance is not None:
            self._error = self._local_error(self._trial) / self._way.tolerance
            if self._error > FAR:
                attempt.good, attempt.cut = False, max(0.2, SAFETY * self._error ** (-1 / 3))
                attempt.message = f"a local error of {self._error:.2g} times the tolerance"
        if attempt.good:
            self._settle()
        return attempt

    def _with_state(self, ledger: Ledger) -> Ledger:
        energies = np.sum([motion.energies() for motion in self.motions], axis=0)
        momenta = np.sum([motion.momenta() for motion in self.motions], axis=0)
        d = self.problem.gdim
        momentum, spin = tuple(momenta[:d].tolist()), tuple(momenta[d:].tolist())
        along_normal, held = self._stored()
        return replace(
            ledger, kinetic=float(energies[0]), strain=float(energies[1]), contact=along_normal + held, held=held,
            momentum=momentum, angular_momentum=spin,
            known="; ".join(dict.fromkeys(motion.known for motion in self.motions)),
        )  # fmt: skip

    def _stored(self) -> tuple[float, float]:
        """What augmentation stores along the normal and by friction (J)."""
        pairs = self.problem.pairs
        return sum(pair.stored_energy() for pair in pairs), sum(pair.stored_by_friction() for pair in pairs)

    def _solve(self, time: float, Δt: float) -> Attempt:
        """Solve for the state at time + Δt, and judge it."""
        problem = self.problem
        self._before: Snapshot = problem.snapshot()
        for motion in self.motions:
            motion.time_step.value = Δt
            motion.fly(0.5)
        self.move(time + Δt / 2)
        for level in self.levels:
            level.predict()
        for motion in self.motions:
            motion.undo()
        self.move(time)
        for motion in self.motions:
            motion.begin_loads()
        for pair in self.problem.pairs:
            pair.begin_step()
        self.move(time + Δt)
        if not any_over(problem.comm, any(pair.is_pressed() for pair in problem.pairs)):
            self._fly()
        problem.force_reference = self._inertia_scale(Δt)
        result = self.solver.solve()
        findings = problem.findings() + self._copies() if result.converged else []
        faults = self._faults(findings) if result.converged else []
        return Attempt(result.converged and not faults, result, "; ".join(faults) or result.message, findings)

    def _copies(self) -> list[Finding]:
        """Whether forms have the last displacement without their motions' knowing (collective)."""
        copies = sum(motion.copies() for motion in self.motions)
        return [Finding("Functions of forms with the values of 𝐮_n", copies, (), COPIES, fatal=False)] if copies else []

    def _fly(self) -> None:
        """Start where bodies are that go on as in the last step."""
        for motion in self.motions:
            motion.go_on()
        if self.problem.inverted_volume() > 0:  # a long step of a body under strong compression
            for motion in self.motions:
                motion.undo()

    def _faults(self, findings: list[Finding]) -> list[str]:
        """What is wrong with a converged state: fatal findings, energy from contact, points that have passed through."""
        self._work = self._contact_work()
        reasons = [str(f) for f in findings if f.fatal]
        allowed = GAIN * (self.ledger.size + self.ledger.impact_loss + abs(self.ledger.friction_dissipation))
        gain = self._work.gain
        if gain > allowed + sum(pair.round_off_energy() for pair in self.problem.pairs):
            reasons.append(f"contact would give {gain:.3g} J to the bodies in this step; take a smaller one")
        for pair, level in zip(self.problem.pairs, self.levels, strict=True):
            passed = level.passed_through(pair.state)
            if any_over(self.problem.comm, passed.any()):
                X = np.concatenate(self.problem.comm.allgather(pair.points()[passed]))
                place = np.array2string(X[0], precision=4)
                reasons.append(
                    f"{pair.name}: {len(X)} points pass through the target in this step, the first at X = {place}; take a "
                    "smaller one"
                )
        return reasons

    def _contact_work(self) -> _Work:
        problem = self.problem
        sums = np.zeros(3)
        for level, pair in zip(self.levels, problem.pairs, strict=True):
            done = level.work(pair.state, pair.j)
            sums += sum_over(problem.comm, np.array([done.normal, done.tangential, done.by_obstacle]))
        normal, tangential, by_obstacles = sums.tolist()
        along_normal, held = self._stored()
        lost = self.ledger.contact - self.ledger.held - along_normal - normal
        stored = max(self.ledger.contact, along_normal + held)
        return _Work(normal, tangential, by_obstacles, lost, self.ledger.held - held - tangential, stored)

    def _local_error(self, Δt: float) -> float:
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
        largest = max(max_over(comm, float(np.abs(m.velocity.x.array).max(initial=0.0))) for m in self.motions)
        return 2 * kinetic / (largest * Δt) / np.sqrt(self.problem.bodies.layout.total) if largest > 0 else 0.0

    def undo(self) -> None:
        self._over = False
        self.problem.restore(self._before)
        for motion in self.motions:
            motion.undo()
        self.move(self._time)

    def _settle(self) -> None:
        """The state at the end of the step: velocities that contact allows, and its ledger."""
        problem, last, done, Δt = self.problem, self.ledger, self._work, self._trial
        work = (
            sum(motion.external_work() for motion in self.motions) + done.by_obstacles + self._supports.work_in_step()
        )
        for motion in self.motions:
            motion.accept()
        settled = self._projection.apply(Δt, done.rubbed)
        self._forces = tuple(pair.force() + i / Δt for pair, i in zip(problem.pairs, settled.impulses, strict=True))
        problem.commit()
        now = self._with_state(last)
        work, loss = work + settled.by_obstacles + settled.by_supports, done.lost + settled.lost
        friction = settled.friction + done.rubbed
        self._next_ledger = replace(
            now,
            external_work=last.external_work + work,
            friction_dissipation=last.friction_dissipation + friction,
            impact_loss=last.impact_loss + loss,
            energy_defect=last.energy_defect + now.total - last.total - work + friction + loss,
        )

    def accept(self, done: stepping.Step) -> Step:
        self._time, self._rate, self.ledger = self._end, self._next_rate, self._next_ledger
        self._number += int(done.nominal)
        depths = [pair.penetration() for pair in self.problem.pairs]
        said = vars(done) | {"findings": (*self._told, *done.findings, *self._drift.look(self.ledger, depths))}
        self._told = []
        return Step(
            **said, time=self._time, step=self._trial, ledger=self.ledger, forces=self._forces,
            penetration=max(depths, default=0.0),
        )  # fmt: skip
