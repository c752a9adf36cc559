"""Impact by Moreau's θ-scheme, with an energy ledger (section 4.3, 4.4; Vola, Pratt, Jean and Raous 1998).

    𝐮_{n+1} = 𝐮_n + Δt [θ 𝐯_{n+1} + (1−θ) 𝐯_n],     𝐌(𝐯_{n+1} − 𝐯_n)/Δt + 𝐆 = 𝐑,

𝐑 the mean contact force of the step under the law between velocities (`velocity.py`) and 𝐆 the internal force: θ-weighted,
or the energy-consistent one. The unknown is 𝐮_{n+1}, so that bodies, contact pairs and Newton are those of statics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.added_mass import AddedMass
from dolfinx_mortar_al.contact import ContactPair
from dolfinx_mortar_al.materials import Hyperelastic, cell_measure, deformation_gradient
from dolfinx_mortar_al.monitors import Finding, Reporter
from dolfinx_mortar_al.newton import NewtonSolver
from dolfinx_mortar_al.problem import ContactProblem, State
from dolfinx_mortar_al.quasistatic import StepFailure
from dolfinx_mortar_al.velocity import VelocityLevel

__all__ = ["Ledger", "Motion", "Step", "march"]

Array = NDArray[np.float64]

EASY = 8  # Newton iterations up to which a step that was cut may grow again
RTOL = 1e-11  # of Newton: what is left over shows up in the ledger


class Motion:
    """A body in motion: its mass, velocity and the mid-step residual to hand to a ContactProblem.

    Args:
        u: displacement (m), at the start state.
        material: its stored energy.
        density: ρ per reference volume (kg/m³).
        step: Δt (s), the longest that will be used.
        theta: θ of the scheme, 1/2 ≤ θ ≤ 1; anything but 1/2 dissipates.
        force: "consistent", whose energy balance is exact (with θ = 1/2), or "trapezoidal", θ-weighted end forces.
        thickness: out of the plane (m).
        external: external virtual work of dead loads, a UFL form linear in the test function.

    Attributes:
        residual: UFL form for :class:`~dolfinx_mortar_al.problem.ContactProblem`.
        velocity: 𝐯_n (m/s), a Function to interpolate the initial velocity into.

    Raises:
        ValueError: on a density, step, θ or force out of range.
    """

    def __init__(
        self,
        u: fem.Function,
        material: Hyperelastic,
        *,
        density: float,
        step: float,
        theta: float = 0.5,
        force: str = "consistent",
        thickness: float = 1.0,
        external: Any = None,
    ) -> None:
        if not density > 0 or not step > 0 or not 0.5 <= theta <= 1:
            raise ValueError(f"density = {density}, step = {step}, theta = {theta}: need ρ > 0, Δt > 0, ½ ≤ θ ≤ 1")
        if force not in ("consistent", "trapezoidal"):
            raise ValueError(f'force = "{force}": "consistent" or "trapezoidal"')
        V = u.function_space
        self.u, self.material, self.density, self.thickness, self.θ = u, material, density, thickness, theta
        self.external = external
        self.old, self.velocity = u.copy(), fem.Function(V, name="velocity")
        self.Δt = fem.Constant(V.mesh, float(step))
        self.dx = cell_measure(u)
        w = ufl.TestFunction(V)
        F0, F1 = deformation_gradient(self.old), deformation_gradient(u)
        if force == "consistent":
            P = material.mean_first_piola(F0, F1)
        else:
            P = theta * material.first_piola(F1) + (1 - theta) * material.first_piola(F0)
        rate = (self.new_velocity() - self.velocity) / self.Δt
        self.residual = thickness * (density * ufl.inner(rate, w) + ufl.inner(P, ufl.grad(w))) * self.dx
        if external is not None:
            self.residual -= external
        work = None if external is None else ufl.replace(external, {w: u - self.old})
        self._work = None if work is None else fem.form(work)
        self._energies = self.energy_forms()
        self._momenta = self._momentum_forms()

    def new_velocity(self) -> Any:
        """𝐯_{n+1} (m/s) as UFL of 𝐮_{n+1}, 𝐮_n and 𝐯_n."""
        return (self.u - self.old) / (self.θ * self.Δt) - (1 - self.θ) / self.θ * self.velocity

    def energy_forms(self, dx: ufl.Measure | None = None) -> tuple[Any, Any]:
        """Kinetic and strain energy (J) at the last accepted step as compiled forms, over all cells or those of `dx`."""
        dx = cell_measure(self.u, dx)
        v, w = self.velocity, self.material.energy(deformation_gradient(self.old))
        return (
            fem.form(self.thickness * self.density / 2 * ufl.inner(v, v) * dx),
            fem.form(self.thickness * w * dx),
        )

    def _momentum_forms(self) -> list[Any]:
        d = len(self.u)
        p = self.thickness * self.density * self.velocity
        x = ufl.SpatialCoordinate(self.u.function_space.mesh) + self.old
        spin = [x[0] * p[1] - x[1] * p[0]] if d == 2 else list(ufl.cross(x, p))
        return [fem.form(c * self.dx) for c in (*p, *spin)]

    def integral(self, form: Any) -> float:
        """Value of a compiled scalar form (collective)."""
        return float(self.u.function_space.mesh.comm.allreduce(fem.assemble_scalar(form)))

    def energies(self) -> tuple[float, float]:
        """Kinetic and strain energy (J), collective."""
        kinetic, strain = self._energies
        return self.integral(kinetic), self.integral(strain)

    def momenta(self) -> Array:
        """Momentum (N s, gdim) and angular momentum about the origin (N m s, 1 or 3), collective."""
        return np.array([self.integral(form) for form in self._momenta])

    def external_work(self) -> float:
        """Work of the dead loads in the present step (J), collective."""
        return 0.0 if self._work is None else self.integral(self._work)

    def predict(self) -> None:
        """𝐮 ← 𝐮_m = 𝐮_n + (1−θ) Δt 𝐯_n, where the step's contact geometry is taken."""
        self.u.x.array[:] = self.old.x.array + (1 - self.θ) * self.Δt.value * self.velocity.x.array

    def guess(self) -> None:
        """𝐮 ← 𝐮_n + Δt 𝐯_n, from which Newton starts."""
        self.u.x.array[:] = self.old.x.array + self.Δt.value * self.velocity.x.array

    def accept(self) -> None:
        """The step has converged: 𝐯_n ← 𝐯_{n+1}, 𝐮_n ← 𝐮_{n+1}."""
        new = (self.u.x.array - self.old.x.array) / (self.θ * self.Δt.value)
        self.velocity.x.array[:] = new - (1 - self.θ) / self.θ * self.velocity.x.array
        self.old.x.array[:] = self.u.x.array

    def restore(self) -> None:
        """Undo a step: 𝐮 ← 𝐮_n."""
        self.u.x.array[:] = self.old.x.array


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
        ValueError: `to` not after `start`.
        StepFailure: on every rank.
    """
    if not to > start:
        raise ValueError(f"to = {to}: must be later than start = {start}")
    all_motions = [motions] if isinstance(motions, Motion) else list(motions)
    problem.added_mass = AddedMass(problem.bodies, all_motions, problem.pairs) if redistribute else None
    stepper = _Stepper(problem, all_motions, move, solver, ledger)
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
        θ = {motion.θ for motion in motions}
        if len(θ) > 1:
            raise ValueError(f"theta = {sorted(θ)}: all motions of a problem need the same θ")
        self.θ = θ.pop()
        for pair in problem.pairs:
            pair.impact = VelocityLevel(self.θ)
        self.ledger = self._with_state(Ledger(0.0, 0.0)) if ledger is None else ledger
        self._reporter = Reporter(problem.comm.rank)
        self._clock, self.rejected, self.iterations = perf_counter(), 0, 0

    def _with_state(self, ledger: Ledger) -> Ledger:
        energies = np.sum([motion.energies() for motion in self.motions], axis=0)
        momenta = np.sum([motion.momenta() for motion in self.motions], axis=0)
        if self.problem.added_mass is not None:
            energies[0] += self.problem.added_mass.kinetic_energy()
            momenta += self.problem.added_mass.momenta()
        d = self.problem.gdim
        momentum, spin = tuple(momenta[:d].tolist()), tuple(momenta[d:].tolist())
        return replace(
            ledger, kinetic=float(energies[0]), strain=float(energies[1]), momentum=momentum, angular_momentum=spin
        )

    def try_step(self, time: float, Δt: float) -> bool:
        """Solve for the state at time + Δt; whether Newton converged."""
        problem = self.problem
        self._before: State = problem.state()
        for motion in self.motions:
            motion.Δt.value = Δt
            motion.predict()
        self.move(time + (1 - self.θ) * Δt)
        for pair in problem.pairs:
            pair.predict()
        self._books = [_Book(pair, self.motions, lambda: self.move(time)) for pair in problem.pairs]
        self.move(time + Δt)
        for motion in self.motions:
            motion.guess()
        if problem.inverted_volume() > 0:  # a long step of a body under strong compression
            for motion in self.motions:
                motion.restore()
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
            motion.restore()
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

    def __init__(self, pair: ContactPair, motions: list[Motion], back: Callable[[], None]) -> None:
        assert pair.impact is not None
        now = [motion.u.x.array.copy() for motion in motions]
        for motion in motions:
            motion.restore()
        back()
        self._x, self._y = pair.moving_points()
        for motion, array in zip(motions, now, strict=True):
            motion.u.x.array[:] = array

    def close(self, pair: ContactPair) -> tuple[float, float, float]:
        """(friction dissipation, impact loss, work done by an obstacle that moves) of the step (J), collective."""
        x, y = pair.moving_points()
        slide, ν, p = (x - self._x) - (y - self._y), pair.at.ν, pair.state.p
        normal = np.einsum("ni,ni->n", ν, slide)
        j = pair.j.reshape(-1)
        total = np.einsum("n,ni,ni->", j, pair.state.t, slide)
        lost = -float(j @ (p * normal))
        by_target = float(np.einsum("n,ni,ni->", j, pair.state.t, y - self._y)) if pair.is_rigid else 0.0
        sums = pair.comm.allreduce(np.array([-total - lost, lost, by_target]), MPI.SUM)
        return float(sums[0]), float(sums[1]), float(sums[2])
