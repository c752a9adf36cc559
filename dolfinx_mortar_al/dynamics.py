"""Impact by Moreau's θ-scheme, with an energy ledger (section 4.3, 4.4; Vola, Pratt, Jean and Raous 1998).

    𝐮_{n+1} = 𝐮_n + Δt [θ 𝐯_{n+1} + (1−θ) 𝐯_n],     𝐌(𝐯_{n+1} − 𝐯_n)/Δt + 𝐆 = 𝐑,

𝐑 the mean contact force of the step under the law between velocities (`velocity.py`) and 𝐆 the internal force: θ-weighted,
or the energy-consistent one. The unknown is 𝐮_{n+1}, so that bodies, contact pairs and Newton are those of statics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al import validation
from dolfinx_mortar_al.added_mass import AddedMass
from dolfinx_mortar_al.contact import ContactPair
from dolfinx_mortar_al.kinematics import VelocityLevel
from dolfinx_mortar_al.monitors import Finding, Reporter
from dolfinx_mortar_al.motion import Motion
from dolfinx_mortar_al.newton import NewtonSolver
from dolfinx_mortar_al.problem import ContactProblem, Snapshot
from dolfinx_mortar_al.quasistatic import StepFailure
from dolfinx_mortar_al.ranks import agreed

__all__ = ["Ledger", "Motion", "Step", "march"]

Array = NDArray[np.float64]

EASY = 8  # Newton iterations up to which a step that was cut may grow again
RTOL = 1e-11  # of Newton: what is left over shows up in the ledger


@dataclass(frozen=True)
class Ledger:
    """Energies (J) and momenta at a time; what is not of the moment has been added up since the start.

    kinetic + strain = initial energy + external_work − friction_dissipation − impact_loss + energy_defect.
    """

    kinetic: float
    strain: float
    external_work: float = 0.0
    friction_dissipation: float = 0.0
    impact_loss: float = 0.0
    energy_defect: float = 0.0
    momentum: tuple[float, ...] = ()
    angular_momentum: tuple[float, ...] = ()


@dataclass(frozen=True)
class Step:
    """A converged step: time (s), Δt, Newton iterations (rejected trials included), rejected trials, wall time (s), whether
    the time is one of the asked-for ones, the ledger, the mean contact force on each contactor (N), and what the monitors
    found below their bounds."""

    time: float
    step: float
    iterations: int
    rejected: int
    wall_time: float
    nominal: bool
    ledger: Ledger
    forces: tuple[Array, ...]
    findings: tuple[Finding, ...] = ()


def march(
    problem: ContactProblem,
    motions: Motion | Sequence[Motion],
    *,
    to: float,
    start: float = 0.0,
    move: Callable[[float], None] | None = None,
    redistribute: bool = False,
    solver: NewtonSolver | None = None,
    smallest: float = 2.0**-10,
    ledger: Ledger | None = None,
) -> Iterator[Step]:
    """Moreau's scheme from `start` to `to`, with steps of the motions' Δt; yields each converged step.

    A step that fails is undone, velocities and impulses included, and tried again with half of Δt, which grows back after
    easy steps; the times start + k Δt are always met. Impulses are warm-started with those of the last step.

    Args:
        problem: made with the motions' residuals.
        motions: one per displacement of the problem.
        to, start: final and initial time (s).
        move: sets all that depends on time: poses of obstacles, Dirichlet values.
        redistribute: take the mass off the contactors' nodes (`added_mass.py`), so that their stop costs no energy.
        solver: default one with tolerance RTOL.
        smallest: Δt, relative to the asked-for one, below which the march gives up.
        ledger: to go on with, from an earlier march.

    Raises:
        ValueError: `to` not after `start`, motions that are not those of the problem, one for each displacement, or a
            redistributed mass that is not positive.
        StepFailure: on every rank.
    """
    all_motions = validation.listed("motions", motions, Motion, "a Motion")
    if move is not None:
        validation.check_callable("move", move, "the time")
    validation.check_motions(all_motions, [body.u for body in problem.bodies.bodies])
    start, smallest = validation.number("start", start), validation.number("smallest", smallest, above=0.0, most=1.0)
    to = validation.number("to", to, above=start, must="the end of the march must be")
    agreed(problem.comm, "start, to, Δt", (start, to, [float(motion.Δt.value) for motion in all_motions]))
    problem.terms = [term for term in problem.terms if not isinstance(term, AddedMass)]
    if redistribute and not problem.pairs:
        raise ValueError("redistribute=True: the problem has no contactor to take mass from; leave it out")
    if redistribute:
        problem.terms.append(AddedMass(problem.bodies, all_motions, problem.pairs))
    problem.members |= {f"motion{k}": motion for k, motion in enumerate(all_motions)}
    stepper = _Stepper(problem, all_motions, move, solver, ledger)
    stepper.check_kinetic()
    longest = float(stepper.motions[0].Δt.value)
    steps = int(np.ceil((to - start) / longest - 1e-9))
    time, Δt, number = start, longest, 1
    while number <= steps:
        mark = min(start + number * longest, to)
        nominal = time + Δt * (1 + 1e-9) >= mark
        trial = mark - time if nominal else Δt
        if not stepper.try_step(time, trial):
            Δt = trial / 2
            stepper.undo(time, hopeless=Δt < smallest * longest)
            continue
        time = mark if nominal else time + trial
        Δt = min(2 * Δt, longest) if stepper.easy else Δt
        number += int(nominal)
        step = stepper.accept(time, trial, nominal)
        stepper.check_kinetic()
        yield step


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
        θ = {motion.θ for motion in motions}
        if len(θ) > 1:
            raise ValueError(f"theta = {sorted(θ)}: all motions of a problem need the same θ")
        self.θ = θ.pop()
        self.levels = [pair.use_velocities(self.θ) for pair in problem.pairs]
        self.ledger = self._with_state(Ledger(0.0, 0.0)) if ledger is None else ledger
        self._reporter = Reporter(problem.comm.rank)
        self._clock, self.rejected, self.iterations = perf_counter(), 0, 0

    def _with_state(self, ledger: Ledger) -> Ledger:
        energies = np.sum([motion.energies() for motion in self.motions], axis=0)
        momenta = np.sum([motion.momenta() for motion in self.motions], axis=0)
        for term in self.problem.terms:
            if isinstance(term, AddedMass):
                energies[0] += term.kinetic_energy()
                momenta += term.momenta()
        d = self.problem.gdim
        momentum, spin = tuple(momenta[:d].tolist()), tuple(momenta[d:].tolist())
        return replace(
            ledger, kinetic=float(energies[0]), strain=float(energies[1]), momentum=momentum, angular_momentum=spin
        )

    def check_kinetic(self) -> None:
        """Whether the ledger's kinetic energy is one, with a redistributed mass, too."""
        validation.check_kinetic(self.ledger.kinetic, sum(motion.energies()[0] for motion in self.motions))

    def try_step(self, time: float, Δt: float) -> bool:
        """Solve for the state at time + Δt; whether Newton converged."""
        problem = self.problem
        self._before: Snapshot = problem.snapshot()
        for motion in self.motions:
            motion.Δt.value = Δt
            motion.predict()
        self.move(time + (1 - self.θ) * Δt)
        for level in self.levels:
            level.predict()
        self._books = [_Book(level, self.motions, lambda: self.move(time)) for level in self.levels]
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
        fatal = [str(f) for f in self._findings if f.fatal]
        self._message = "; ".join(fatal) if fatal else self._message
        return result.converged and not fatal

    def _inertia_scale(self, Δt: float) -> float:
        """Norm of nodal momenta per Δt (N), roughly: the size of forces that a step of this length resolves."""
        comm, kinetic = self.problem.comm, sum(motion.energies()[0] for motion in self.motions)
        largest = max(comm.allreduce(float(np.abs(m.velocity.x.array).max(initial=0.0)), MPI.MAX) for m in self.motions)
        return 2 * kinetic / (largest * Δt) / np.sqrt(self.problem.bodies.layout.total) if largest > 0 else 0.0

    def undo(self, time: float, hopeless: bool) -> None:
        """Back to the last accepted state; `hopeless` ends the run with the reason."""
        for motion in self.motions:
            motion.undo()
        self.problem.restore(self._before)
        self.move(time)
        self.rejected += 1
        if hopeless:
            raise StepFailure(f"no convergence after time {time:.6g} s with the smallest step: {self._message}")

    def accept(self, time: float, Δt: float, nominal: bool) -> Step:
        """Velocities, ledger, and what the step reports."""
        problem, last = self.problem, self.ledger
        work = sum(motion.external_work() for motion in self.motions)
        friction = loss = 0.0
        for book, pair in zip(self._books, problem.pairs, strict=True):
            dissipated, lost, by_target = book.close(pair)
            friction, loss, work = friction + dissipated, loss + lost, work + by_target
        forces = tuple(pair.force() for pair in problem.pairs)
        for motion in self.motions:
            motion.accept()
        problem.commit()
        now = self._with_state(last)
        change = now.kinetic + now.strain - last.kinetic - last.strain
        self.ledger = replace(
            now,
            external_work=last.external_work + work,
            friction_dissipation=last.friction_dissipation + friction,
            impact_loss=last.impact_loss + loss,
            energy_defect=last.energy_defect + change - work + friction + loss,
        )
        seconds = perf_counter() - self._clock
        found = tuple(self._findings)
        step = Step(time, Δt, self.iterations, self.rejected, seconds, nominal, self.ledger, forces, found)
        self._reporter.report(found, f"time {time:.6g} s")
        self.rejected, self.iterations, self._clock = 0, 0, perf_counter()
        return step


class _Book:
    """A pair's work in a step: where its points and their target points were at the beginning."""

    def __init__(self, level: VelocityLevel, motions: list[Motion], back: Callable[[], None]) -> None:
        self._level = level
        now = [motion.u.x.array.copy() for motion in motions]
        for motion in motions:
            motion.undo()
        back()
        self._x, self._y = level.moving_points()
        for motion, array in zip(motions, now, strict=True):
            motion.u.x.array[:] = array

    def close(self, pair: ContactPair) -> tuple[float, float, float]:
        """(friction dissipation, impact loss, work done by an obstacle that moves) of the step (J), collective."""
        x, y = self._level.moving_points()
        slide, ν, p, j = (x - self._x) - (y - self._y), pair.at.ν, pair.state.p, pair.j
        normal = np.einsum("ni,ni->n", ν, slide)
        total = np.einsum("n,ni,ni->", j, pair.state.t, slide)
        lost = -float(j @ (p * normal))
        by_target = float(np.einsum("n,ni,ni->", j, pair.state.t, y - self._y)) if pair.target.is_rigid else 0.0
        sums = pair.comm.allreduce(np.array([-total - lost, lost, by_target]), MPI.SUM)
        return float(sums[0]), float(sums[1]), float(sums[2])
