"""Load stepping: adaptive increments, each one a transaction; extrapolation in the load as predictor."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al import validation
from dolfinx_mortar_al.monitors import Finding, Reporter
from dolfinx_mortar_al.newton import NO_PROGRESS, Load, NewtonSolver, Path
from dolfinx_mortar_al.problem import ContactProblem, Snapshot
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.stepping import Event, LoadWatch

__all__ = ["Step", "StepFailure", "follow", "march"]

MAX_ORDER = 4  # of the predictor's polynomial
BETTER = 3.0  # factor by which a higher order must have been better to be used: measured, docs/newton.md
EVENT = 2.0**-6  # of an asked-for increment: how closely an event is met
CUT, CUT_WITHOUT_PROGRESS = (
    1 / 2,
    1 / 4,
)  # of the increment after a failure: that came near, that made no progress at all
EASY = 8  # Newton iterations up to which an increment that was cut may grow again


UNSTABLE = Finding(
    "determinant of the Jacobian",
    -1.0,
    (),
    "this equilibrium is unstable: a real body would leave it; follow the path with quasistatic.follow or let the bodies "
    "move with dynamics.march",
    False,
)


class StepFailure(RuntimeError):
    """A step did not converge even at the smallest increment; what had converged was yielded before."""


@dataclass(frozen=True)
class Step:
    """A converged step: load, Newton iterations (rejected trials included), rejected trials, wall time (s), whether
    the load is one of the asked-for increments (not a step between them after a cut), and what the monitors found below
    their bounds."""

    load: float
    iterations: int
    rejected: int
    wall_time: float
    nominal: bool
    findings: tuple[Finding, ...] = ()


def march(
    problem: ContactProblem,
    load: fem.Constant | Callable[[float], None],
    *,
    to: float,
    increments: int,
    start: float | None = None,
    solver: NewtonSolver | None = None,
    smallest: float = 2.0**-10,
    until: Callable[[], bool] | None = None,
    progress: bool = False,
) -> Iterator[Step]:
    """Solve at growing loads and yield each converged step.

    A step that fails is undone, slip history included, and tried again at half the increment (a quarter if Newton made no
    progress), which grows back after easy steps. Loads at multiples of (to − start)/increments are always met.

    Args:
        problem: to solve.
        load: the load parameter: a UFL constant of the problem, or a function that sets what depends on it.
        to: final load.
        increments: number of steps asked for.
        start: load of the problem's present state, default the constant's value, or 0 for a function.
        solver: default a new :class:`~dolfinx_mortar_al.newton.NewtonSolver`.
        smallest: increment, relative to the asked-for one, below which the march gives up.
        until: an event of the converged state, the same on every rank (an error if not), such as ``pair.reaches_end``. The
            march ends with the first step where it holds, after closing in on it down to EVENT of an increment.
        progress: show a progress bar with load, iterations and contact state (rank 0, standard error).

    Raises:
        ValueError: on every rank: `increments` < 1, `to` equals the present load, a `load` that is neither a scalar Constant
            nor a function, or an argument or event that differs between ranks.
        StepFailure: on every rank.
    """
    increments = validation.whole("increments", increments, least=1)
    smallest = validation.number("smallest", smallest, above=0.0, most=1.0)
    parameter, event = Load.of(load, start), Event(problem.comm, until)
    begin = validation.number("start", parameter.value)
    to = validation.number("to", to, must=f"the load must move away from its present value {begin} to")
    if to == begin:
        raise ValueError(f"to = {to}: the load must move away from its present value {begin}")
    agreed(problem.comm, "start, to, increments", (begin, to, increments))
    stepper = _Stepper(problem, parameter, solver, _Bar(problem, begin, to) if progress else None)
    return _march(stepper, to, increments, smallest, event, LoadWatch(problem, load))


def _march(
    stepper: _Stepper, to: float, increments: int, smallest: float, event: Event, watch: LoadWatch
) -> Iterator[Step]:
    """The steps of :func:`march`, whose arguments have been checked."""
    parameter = stepper.load
    begin = parameter.value
    asked = (to - begin) / increments
    stepper.past.add(begin)
    increment, number, closing_in = asked, 1, False
    while number <= increments:
        current, mark = parameter.value, begin + number * asked
        nominal = abs(current + increment - mark) < 1e-9 * abs(asked) or abs(increment) >= abs(mark - current)
        trial = mark if nominal else current + increment
        stepper.past.predict(trial)
        with watch:
            parameter.value = trial
        if not stepper.solve():
            increment = stepper.cut * (trial - current)
            stepper.undo(current, give_up=abs(increment) < smallest * abs(asked))
            continue
        happened = event()
        if happened and abs(trial - current) > EVENT * abs(asked):
            stepper.past.restore()
            increment, closing_in, parameter.value = (trial - current) / 2, True, current
            continue
        if stepper.easy and not closing_in:
            increment = float(np.sign(asked)) * min(2 * abs(increment), abs(asked))
        number += int(nominal)
        yield stepper.accept(trial, nominal)
        if happened:
            break
    watch.report()
    stepper.close()


def follow(
    problem: ContactProblem,
    load: fem.Constant | Callable[[float], None],
    *,
    first: float,
    length: float,
    steps: int,
    start: float | None = None,
    solver: NewtonSolver | None = None,
    smallest: float = 2.0**-10,
    until: Callable[[], bool] | None = None,
) -> Iterator[Step]:
    """Follow the equilibrium path by its length, the load being an unknown, past limit points where the load turns.

    After a first step under load control, each step moves on along the line through the last two states and corrects in
    the plane normal to it (Riks' method; the displacements alone make the norm). Contact and friction are as in `march`.

    Args:
        problem, load, start, solver: as in :func:`march`.
        first: load increment of the first step, which gives the path its direction.
        length: of a step: the largest displacement of a node in its prediction (m).
        steps: how many steps to take after the first.
        smallest: length, relative to the asked-for one, below which the march gives up.
        until: an event of the converged state that ends the path, the same on every rank.

    Raises:
        ValueError: `steps` < 1, or a first load or a length of zero.
        StepFailure: on every rank.
    """
    steps, length = validation.whole("steps", steps, least=1), validation.number("length", length, above=0.0)
    first, smallest = validation.number("first", first), validation.number("smallest", smallest, above=0.0, most=1.0)
    if first == 0.0:
        raise ValueError("first = 0: the path needs a first load increment, which gives it its direction")
    parameter, event = Load.of(load, start), Event(problem.comm, until)
    agreed(problem.comm, "first, length, steps", (first, length, steps))
    stepper = _Stepper(problem, parameter, solver, None)
    states = [(parameter.value, problem.bodies.get())]
    yield from march(
        problem, parameter.set, to=parameter.value + first, increments=1, start=parameter.value, solver=stepper.solver
    )
    states.append((parameter.value, problem.bodies.get()))
    s = [0.0, _largest(problem, states[1][1] - states[0][1])]  # path length, the abscissa of the predictor
    stepper.past.add(s[1])
    step_length, taken = length, 0
    while taken < steps:
        (λ0, u0), (λ1, u1) = states
        share = step_length / (s[1] - s[0])
        stepper.past.restore()
        direction = u1 - u0
        problem.bodies.set(u1 + share * direction)
        parameter.value = λ1 + share * (λ1 - λ0)
        if not stepper.solve(Path(parameter, direction, 1e-3 * first)):
            step_length *= stepper.cut
            stepper.undo(λ1, give_up=step_length < smallest * length)
            continue
        states = [(λ1, u1), (parameter.value, problem.bodies.get())]
        s = [s[1], s[1] + _largest(problem, states[1][1] - u1)]
        step_length = min(2 * step_length, length) if stepper.easy else step_length
        taken += 1
        yield stepper.accept(s[1], nominal=True)
        if event():
            break


def _largest(problem: ContactProblem, u: NDArray[np.float64]) -> float:
    """Largest displacement of a node (m), collective."""
    nodal = np.linalg.norm(u.reshape(-1, problem.gdim), axis=1)
    return float(problem.comm.allreduce(float(nodal.max(initial=0.0)), MPI.MAX))


class _Stepper:
    """What every way of stepping shares: solve, then accept with its bookkeeping or undo."""

    def __init__(self, problem: ContactProblem, load: Load, solver: NewtonSolver | None, bar: _Bar | None) -> None:
        self.problem, self.load, self.bar = problem, load, bar
        if solver is not None and not isinstance(solver, NewtonSolver):
            raise ValueError(f"solver: {type(solver).__name__} is not a NewtonSolver; leave it out for the default")
        self.solver = NewtonSolver(problem) if solver is None else solver
        self.past = _Past(problem)
        self.rejected = self.iterations = 0
        self.easy, self.cut = False, CUT
        self._reporter = Reporter(problem.comm.rank)
        self._clock = perf_counter()

    def solve(self, path: Path | None = None) -> bool:
        """Newton from the present prediction; a fatal finding of a monitor counts as a failure."""
        result = self.solver.solve(path)
        self.iterations += result.iterations
        self.easy, self._message = result.iterations <= EASY, result.message
        self.cut = CUT if result.residual < NO_PROGRESS else CUT_WITHOUT_PROGRESS
        self._findings = self.problem.findings() if result.converged else []
        if result.converged and result.unstable and not self.problem.floating:  # neutral, where nothing resists a slide
            self._findings.append(UNSTABLE)
        fatal = [str(f) for f in self._findings if f.fatal]
        if fatal:
            self._message = "; ".join(fatal)
        return result.converged and not fatal

    def accept(self, abscissa: float, nominal: bool) -> Step:
        """The step is final: it becomes the origin of the next one."""
        self.problem.commit()
        self.past.add(abscissa)
        seconds = perf_counter() - self._clock
        step = Step(self.load.value, self.iterations, self.rejected, seconds, nominal, tuple(self._findings))
        self._report(step)
        self.rejected, self.iterations, self._clock = 0, 0, perf_counter()
        return step

    def undo(self, load: float, give_up: bool) -> None:
        """Back to the last converged state at `load`; `give_up` ends the run with the reason of the failure."""
        failed, self.load.value = self.load.value, load
        self.past.restore()
        self.rejected += 1
        if self.bar is not None:
            self.bar.rejected(failed, self._message)
        if give_up:
            self.problem.evaluate()
            raise StepFailure(
                f"no convergence at load {failed:.6g} with the smallest step: {self._message}; "
                f"the steps up to load {load:.6g} are converged"
            )

    def _report(self, step: Step) -> None:
        if self.bar is not None:
            self.bar.show(step)
        self._reporter.report(step.findings, f"load {step.load:.6g}")

    def close(self) -> None:
        if self.bar is not None:
            self.bar.bar.close()


class _Past:
    """The last converged states and their loads, for extrapolation and for undoing a failed step."""

    def __init__(self, problem: ContactProblem) -> None:
        self.problem = problem
        self.loads: list[float] = []
        self.states: list[Snapshot] = []
        #: of each predicted array, the polynomial order to predict it with
        self._order = {(member, name): 1 for member, name in self._predicted()}

    def _predicted(self) -> list[tuple[str, str]]:
        """What is extrapolated: member and name of arrays of a snapshot."""
        return [("bodies", "u"), *((f"pair{k}", "multiplier") for k in range(len(self.problem.pairs)))]

    def add(self, load: float) -> None:
        """A state has converged; choose the polynomial orders that would have predicted it well."""
        state = self.problem.snapshot()
        for array in self._order:
            self._order[array] = self._best_order(state, array, load)
        self.loads, self.states = [*self.loads, load][-MAX_ORDER - 1 :], [*self.states, state][-MAX_ORDER - 1 :]

    def restore(self) -> None:
        """Undo: back to the last converged state."""
        self.problem.restore(self.states[-1])

    def predict(self, load: float) -> None:
        """Displacement and multipliers extrapolated to `load`; and λ̂_N, which says what points to expect closed, linearly
        and half the way only: too much closed costs more iterations than too little (docs/newton.md). The last state
        itself, where an extrapolated one has inverted cells."""
        self.restore()
        if len(self.states) < 2:
            return
        problem = self.problem
        problem.bodies.set(self._extrapolated(("bodies", "u"), load, self._order["bodies", "u"]))
        if problem.inverted_volume() > 0:
            self.restore()
            return
        for k, pair in enumerate(problem.pairs):
            name = f"pair{k}"
            predicted = dict(self.states[-1][name])
            array = name, "multiplier"
            predicted["multiplier"] = self._extrapolated(array, load, self._order[array])
            if len(self.states) > 2:  # the start state's contact is a guess
                predicted["λN_hat"] = self._extrapolated((name, "λN_hat"), (load + self.loads[-1]) / 2, 1)
            pair.restore(predicted)

    def _extrapolated(self, array: tuple[str, str], load: float, order: int) -> NDArray[np.float64]:
        """An array of the last order + 1 snapshots, extrapolated to `load` by Lagrange's polynomial."""
        x = np.array(self.loads[-order - 1 :])
        weights = np.array([np.prod([(load - b) / (a - b) for b in x if b != a]) for a in x])
        member, name = array
        return np.asarray(weights @ np.stack([state[member][name] for state in self.states[-len(x) :]]))

    def _best_order(self, state: Snapshot, array: tuple[str, str], load: float) -> int:
        """The order that would have predicted `state` best; a higher one only where it is BETTER times as good."""
        member, name = array
        best, least = 1, np.inf
        for order in range(1, min(MAX_ORDER + 1, len(self.states))):
            miss = state[member][name] - self._extrapolated(array, load, order)
            size = np.sqrt(self.problem.comm.allreduce(float(miss @ miss), MPI.SUM))
            if size * BETTER < least:
                best, least = order, size
        return best


class _Bar:
    """Progress on standard error, drawn by rank 0; the contact state it shows is collective."""

    def __init__(self, problem: ContactProblem, begin: float, to: float) -> None:
        from tqdm import tqdm

        self.problem, self.begin, self.to = problem, begin, to
        layout = "{percentage:3.0f}%|{bar:20}| {elapsed} {postfix}"
        self.bar = tqdm(total=1.0, disable=problem.comm.rank != 0, bar_format=layout)

    def show(self, step: Step) -> None:
        pairs = [
            f"{pair.name}: {pair.closed_fraction():.1%} closed, {pair.stick_fraction():.1%} stick"
            for pair in self.problem.pairs
        ]
        self.bar.set_postfix_str(
            "; ".join([f"load {step.load:.5g}", f"{step.iterations} iterations", *pairs]), refresh=False
        )
        self.bar.update((step.load - self.begin) / (self.to - self.begin) - self.bar.n)

    def rejected(self, load: float, why: str) -> None:
        if self.problem.comm.rank == 0:
            self.bar.write(f"load {load:.6g} rejected: {why}", file=sys.stderr)
