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

from dolfinx_mortar_al.newton import NewtonSolver
from dolfinx_mortar_al.problem import ContactProblem, State

__all__ = ["Step", "StepFailure", "march"]

MAX_ORDER = 4  # of the predictor's polynomial
MAX_ORDER_WITH_FRICTION = 1  # slip makes a history of kinks: measured, docs/newton.md
EVENT = 2.0**-6  # of an asked-for increment: how closely an event is met
EASY = 8  # Newton iterations up to which an increment that was cut may grow again


class StepFailure(RuntimeError):
    """A step did not converge even at the smallest increment; what had converged was yielded before."""


@dataclass(frozen=True)
class Step:
    """A converged step: load, Newton iterations (rejected trials included), rejected trials, wall time (s), and whether
    the load is one of the asked-for increments (not a step between them after a cut)."""

    load: float
    iterations: int
    rejected: int
    wall_time: float
    nominal: bool


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

    A step that fails is undone, slip history included, and tried again at half the increment, which grows back after easy
    steps. Loads at multiples of (to − start)/increments are always met.

    Args:
        problem: to solve.
        load: the load parameter: a UFL constant of the problem, or a function that sets what depends on it.
        to: final load.
        increments: number of steps asked for.
        start: load of the problem's present state, default the constant's value, or 0 for a function.
        solver: default a new :class:`~dolfinx_mortar_al.newton.NewtonSolver`.
        smallest: increment, relative to the asked-for one, below which the march gives up.
        until: an event of the converged state, the same on every rank, such as ``pair.reaches_end``. The march ends with
            the first step where it holds, after closing in on it down to EVENT of an increment.
        progress: show a progress bar with load, iterations and contact state (rank 0, standard error).

    Raises:
        ValueError: `increments` < 1, or `to` equals the present load.
        StepFailure: on every rank.
    """
    if increments < 1:
        raise ValueError(f"increments = {increments}: at least one load increment is needed")
    begin = start if start is not None else float(load.value) if isinstance(load, fem.Constant) else 0.0

    def set_load(value: float) -> None:
        if isinstance(load, fem.Constant):
            load.value = value
        else:
            load(value)

    if not np.isfinite(to) or to == begin:
        raise ValueError(f"to = {to}: the load must move away from its present value {begin}")

    solver = NewtonSolver(problem) if solver is None else solver
    asked = (to - begin) / increments
    current, increment, rejected, iterations = begin, asked, 0, 0
    past = _Past(problem)
    past.add(current)
    bar = _Bar(problem, begin, to) if progress else None
    clock = perf_counter()
    number, closing_in = 1, False
    while number <= increments:
        mark = begin + number * asked
        nominal = abs(current + increment - mark) < 1e-9 * abs(asked) or abs(increment) >= abs(mark - current)
        trial = mark if nominal else current + increment
        set_load(trial)
        past.predict(trial)
        result = solver.solve()
        iterations += result.iterations
        if not result.converged:
            past.restore()
            rejected += 1
            increment = (trial - current) / 2
            if bar is not None:
                bar.rejected(trial, result.message)
            if abs(increment) < smallest * abs(asked):
                set_load(current)
                problem.evaluate()
                raise StepFailure(
                    f"no convergence at load {trial:.6g} with the smallest increment {2 * increment:.3g}: {result.message}; "
                    f"the steps up to load {current:.6g} are converged"
                )
            continue
        happened = until is not None and until()
        if happened and abs(trial - current) > EVENT * abs(asked):
            past.restore()
            increment, closing_in = (trial - current) / 2, True
            continue
        problem.commit()
        current = trial
        past.add(current)
        if result.iterations <= EASY and not closing_in:
            increment = float(np.sign(asked)) * min(2 * abs(increment), abs(asked))
        step = Step(current, iterations, rejected, perf_counter() - clock, nominal)
        if bar is not None:
            bar.show(step)
        number += int(nominal)
        rejected, iterations = 0, 0
        yield step
        if happened:
            break
        clock = perf_counter()
    if bar is not None:
        bar.bar.close()


class _Past:
    """The last converged states and their loads, for extrapolation and for undoing a failed step."""

    def __init__(self, problem: ContactProblem) -> None:
        self.problem = problem
        friction = any(pair.contact.friction for pair in problem.pairs)
        self.max_order = MAX_ORDER_WITH_FRICTION if friction else MAX_ORDER
        self.loads: list[float] = []
        self.states: list[State] = []
        self.order = 1

    def add(self, load: float) -> None:
        """A state has converged; choose the polynomial order that would have predicted it best."""
        state = self.problem.state()
        self.order = self._best_order(load, state.u)
        self.loads, self.states = (
            [*self.loads, load][-self.max_order - 1 :],
            [*self.states, state][-self.max_order - 1 :],
        )

    def restore(self) -> None:
        """Undo: back to the last converged state."""
        self.problem.restore(self.states[-1])

    def predict(self, load: float) -> None:
        """Displacement and multipliers extrapolated to `load`; and λ̂_N, which says what points to expect closed, linearly
        and half the way only: too much closed costs more iterations than too little (docs/newton.md)."""
        self.restore()
        if len(self.states) < 2:
            return
        used, weights = self._weights(load, self.order)
        problem = self.problem
        problem.bodies.set(sum((w * s.u for w, s in zip(weights, used, strict=True)), np.zeros_like(used[0].u)))
        for k, pair in enumerate(problem.pairs):
            values = sum(w * s.multipliers[k] for w, s in zip(weights, used, strict=True))
            pair.multiplier.field.x.array[:] = values
        if len(self.states) > 2:  # the start state's contact is a guess
            used, weights = self._weights((load + self.loads[-1]) / 2, 1)
            for k, pair in enumerate(problem.pairs):
                λN_hat = sum(w * s.pressures[k] for w, s in zip(weights, used, strict=True))
                pair.restore(self.states[-1].history[k], np.asarray(λN_hat))

    def _weights(self, load: float, order: int) -> tuple[list[State], NDArray[np.float64]]:
        """The last order + 1 states and their Lagrange weights at `load`."""
        x = np.array(self.loads[-order - 1 :])
        weights = [np.prod([(load - b) / (a - b) for b in x if b != a]) for a in x]
        return self.states[-len(x) :], np.array(weights)

    def _best_order(self, load: float, u: NDArray[np.float64]) -> int:
        orders = range(1, len(self.states))
        errors = []
        for order in orders:
            used, weights = self._weights(load, order)
            miss = u - sum(w * s.u for w, s in zip(weights, used, strict=True))
            errors.append(self.problem.comm.allreduce(float(miss @ miss), MPI.SUM))
        return min(self.max_order, 1 + int(np.argmin(errors))) if errors else 1


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
