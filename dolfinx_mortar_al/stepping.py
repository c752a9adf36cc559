"""The one loop that takes steps: try, accept or undo, cut, grow, give up, close in on an event, say how it goes.

What moves is a controller's: the load (`quasistatic.march`), the load along the path's length (`quasistatic.follow`), time
(`dynamics.march`). It says how far a step may go, solves and judges it, and knows what a step reports.
"""

from __future__ import annotations

import sys
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from time import perf_counter
from types import TracebackType
from typing import Any, Generic, TypeVar

import numpy as np
from mpi4py import MPI

from dolfinx_mortar_al.monitors import Finding, Reporter, warn
from dolfinx_mortar_al.newton import NewtonResult, NewtonSolver
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.validation import takes

__all__ = ["Attempt", "Bar", "Controller", "Event", "March", "Step", "StepFailure", "run", "solver_of"]

EASY = 8  # Newton iterations up to which a step that was cut may grow again
GROWTH = 2.0  # of a step from one to the next at most
CUT = 1 / 2  # of a step after a failure
RELAXED = 2.0**-4  # of an asked-for step: with as little bodies are let go to where they come to rest
EVENT = 2.0**-6  # of an asked-for step: how closely an event is met


class StepFailure(RuntimeError):
    """A step did not converge even at the smallest length; what had converged was yielded before."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """A converged step: Newton iterations (rejected trials included; not the linear solves by which contact settles within
    each, `contact_iteration.py`, which may take most of the time), wall time (s), whether it ends at one of the asked-for
    places (not between them after a cut), why trials on the way to it were rejected, and what the monitors found below
    their bounds."""

    iterations: int
    wall_time: float
    nominal: bool
    reasons: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def rejected(self) -> int:
        """Number of rejected trials."""
        return len(self.reasons)


@dataclass
class Attempt:
    """A trial: whether it is good, what Newton did, the reasons why not, what monitors found, and the share of its length to
    try next if it failed."""

    good: bool
    newton: NewtonResult
    message: str
    findings: list[Finding]
    cut: float = CUT

    @property
    def easy(self) -> bool:
        """Whether Newton had little to do."""
        return self.newton.iterations <= EASY


S = TypeVar("S", bound=Step)


class Controller(ABC, Generic[S]):
    """What moves, and how. Lengths are shares of an asked-for step.

    Attributes:
        problem: to solve.
        smallest: length below which the march gives up.
        leg: number of the part of the way that the next step is on; each begins with a step of the asked-for length.
        lets_go: length from which on, where a step fails, bodies are let go to where they come to rest.
    """

    problem: ContactProblem
    smallest: float
    leg: int = 0

    @property
    def lets_go(self) -> float:
        return RELAXED

    @property
    def may_relax(self) -> bool:
        """Whether bodies may be let go where a step has failed."""
        return False

    def begin(self) -> None:
        """Called once, before the first step."""

    @property
    @abstractmethod
    def finished(self) -> bool:
        """Whether no step is left to take."""

    @property
    @abstractmethod
    def share(self) -> float:
        """How much of the whole way is done, from 0 to 1."""

    @abstractmethod
    def at(self, tried: bool = False) -> str:
        """Where the last accepted step has come to, or the last `tried` one, in words."""

    @abstractmethod
    def clip(self, size: float) -> tuple[float, bool]:
        """The length of the next step, `size` or less, and whether it ends at an asked-for place."""

    @abstractmethod
    def attempt(self, length: float, nominal: bool) -> Attempt:
        """Predict, solve and judge a step (collective)."""

    def relax(self, length: float) -> Attempt:
        """Where steps fail: let the bodies go to where they come to rest, `length` on (collective)."""
        raise NotImplementedError

    @abstractmethod
    def undo(self) -> None:
        """Back to the last accepted step (collective)."""

    def event(self) -> bool:
        """Whether what the march is to end at has happened in the step just tried (collective)."""
        return False

    @abstractmethod
    def accept(self, done: Step) -> S:
        """The step just tried is final: it becomes the origin of the next one, and says more than `done` (collective)."""

    def grown(self, size: float, length: float, attempt: Attempt) -> float:
        """What to take for the next step after a good one of `length`, for which `size` was meant."""
        return min(GROWTH * size, 1.0) if attempt.easy else size

    @abstractmethod
    def failure(self, reason: str) -> str:
        """What to say of a march that gives up (collective); the last step has been undone."""


def run(control: Controller[S], bar: Bar) -> Iterator[S]:
    """The steps of a controller (collective).

    Raises:
        StepFailure: on every rank.
    """
    reporter = Reporter(control.problem.comm.rank)
    size, leg, closing_in = 1.0, control.leg, False
    control.begin()
    iterations, clock = 0, perf_counter()
    reasons: list[str] = []
    relaxed = False  # whether that has been tried in this step
    while not control.finished:
        length, nominal = control.clip(size)
        attempt = control.attempt(length, nominal)
        iterations += attempt.newton.iterations
        if not attempt.good:
            bar.rejected(control.at(tried=True), attempt.message)
            size = attempt.cut * length
            reasons.append(f"{control.at(tried=True)}: {attempt.message}")
            control.undo()
            last = size < control.smallest
            moved = None
            if control.may_relax and length <= control.lets_go and (last or not relaxed):
                bar.lets_go(control.at(tried=True))
                moved, relaxed = control.relax(length), True
                iterations += moved.newton.iterations
                if not moved.good:
                    control.undo()
            if moved is None or not moved.good:
                if last:
                    control.problem.show_committed()
                    raise StepFailure(control.failure(attempt.message + attempt.newton.advice))
                continue
            attempt, size = moved, length
        if control.event() and length > EVENT:
            control.undo()
            size, closing_in = length / 2, True
            continue
        grown = size if closing_in else control.grown(size, length, attempt)
        size = min(grown, length) if reasons else grown  # what has just failed would again
        seconds, found = perf_counter() - clock, tuple(attempt.findings)
        done = Step(
            iterations=iterations, wall_time=seconds, nominal=nominal, reasons=tuple(reasons), findings=found
        )  # fmt: skip
        step = control.accept(done)
        if control.leg != leg:
            size, leg, closing_in = 1.0, control.leg, False
        bar.show(control.at(), control.share, step)
        reporter.report(step.findings, control.at())
        yield step
        iterations, reasons, clock, relaxed = 0, [], perf_counter(), False


class March(Generator[S, None, None]):
    """The steps of a march, each taken when it is asked for; where none was asked for at all, that is said in the end.

    Args:
        steps: the steps.
        rank: 0 says it.
    """

    def __init__(self, steps: Generator[S, None, None], rank: int) -> None:
        self._steps, self._asked = steps, rank != 0
        weakref.finalize(self, steps.close)  # where the program ends first: before PETSc does

    def __next__(self) -> S:
        self._asked = True
        return next(self._steps)

    def send(self, value: None) -> S:
        """The next step."""
        self._asked = True
        return self._steps.send(value)

    def throw(self, *error: Any) -> S:
        """End the march with an error."""
        self._asked = True
        return self._steps.throw(*error)

    def close(self) -> None:
        """End the march where it is."""
        self._asked = True
        self._steps.close()

    def __del__(self) -> None:
        if not self._asked and not sys.is_finalizing():
            warn(
                "march: none of its steps was asked for, so that nothing was solved: write for step in march(…)",
            )


def solver_of(problem: ContactProblem, solver: NewtonSolver | None, **options: Any) -> NewtonSolver:
    """The solver that was passed, or one with these options.

    Raises:
        ValueError: if it is none, that of another problem, or passed on some ranks only.
    """
    agreed(problem.comm, "solver: whether it is passed", solver is not None)
    if solver is None:
        return NewtonSolver(problem, **options)
    if not isinstance(solver, NewtonSolver):
        raise ValueError(f"solver: {type(solver).__name__} is not a NewtonSolver; leave it out for the default")
    if solver.problem is not problem:
        raise ValueError("solver: it solves another problem; make it from this one")
    return solver


class Event:
    """An event that a march ends at, checked to be the same on all ranks.

    Args:
        comm: of the problem.
        until: whether it has happened, asked in converged states; None never happens.

    Raises:
        ValueError: if it is no function, or passed on some ranks only.
    """

    def __init__(self, comm: MPI.Comm, until: Callable[[], bool] | None) -> None:
        agreed(comm, "until: whether it is passed", until is not None)
        if until is not None and not (callable(until) and takes(until)):
            raise ValueError(f"until = {until!r}: pass a function without arguments, such as pair.reaches_end")
        self._comm, self._until = comm, until

    def __call__(self) -> bool:
        """Whether it has happened (collective).

        Raises:
            ValueError: on every rank, if the ranks do not agree, or on something else than a truth value.
        """
        if self._until is None:
            return False
        happened = self._until()
        sound = isinstance(happened, bool | np.bool_ | int)
        agreed(self._comm, "until()", bool(happened) if sound else happened)
        if not sound:
            raise ValueError(f"until() = {happened}: must return True or False")
        return bool(happened)


class Bar:
    """Progress on standard error, drawn by rank 0; the contact state it shows is collective. Use it as a context, which
    closes the bar whatever ends the march.

    Args:
        problem: whose contact it shows.
        shown: whether there is a bar at all, on rank 0.
    """

    def __init__(self, problem: ContactProblem, shown: bool) -> None:
        self._problem, self._bar = problem, None
        if problem.comm.bcast(bool(shown)):
            from tqdm import tqdm

            layout = "{percentage:3.0f}%|{bar:20}| {elapsed} {postfix}"
            self._bar = tqdm(total=1.0, disable=problem.comm.rank != 0, bar_format=layout)

    def __enter__(self) -> Bar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def show(self, where: str, share: float, step: Step) -> None:
        """A step was accepted, `share` of the whole way done (collective)."""
        if self._bar is None:
            return
        pairs = [
            f"{pair.name}: {pair.closed_fraction():.1%} closed, {pair.stick_fraction():.1%} stick"
            for pair in self._problem.pairs
        ]
        self._bar.set_postfix_str("; ".join([where, f"{step.iterations} iterations", *pairs]), refresh=False)
        self._bar.update(share - self._bar.n)

    def rejected(self, where: str, why: str) -> None:
        """A trial failed."""
        self._write(f"{where} rejected: {why}")

    def lets_go(self, where: str) -> None:
        """What comes next may take long."""
        self._write(f"{where}: the bodies are let go, each node slowed by a dashpot, until they come to rest")

    def _write(self, line: str) -> None:
        if self._bar is not None and self._problem.comm.rank == 0:
            self._bar.write(line, file=sys.stderr)
