"""Equilibrium under loads that move: along straight lines, one stage after the other, or by the length of the path."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor
from time import perf_counter
from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al import stepping, validation
from dolfinx_mortar_al.load import Load, Movable, pace
from dolfinx_mortar_al.load_watch import LoadWatch
from dolfinx_mortar_al.monitors import Finding, Reporter, warn
from dolfinx_mortar_al.newton import NO_PROGRESS, NewtonResult, NewtonSolver, Path
from dolfinx_mortar_al.pair_findings import PUSHED
from dolfinx_mortar_al.predictor import Predictor
from dolfinx_mortar_al.problem import ContactProblem, check_problem
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.reductions import all_over, max_over
from dolfinx_mortar_al.relaxation import relax
from dolfinx_mortar_al.stepping import Attempt, Bar, Controller, Event, March, StepFailure

__all__ = ["Stage", "Step", "StepFailure", "equilibrate", "follow", "march"]

Array = NDArray[np.float64]

CUT_WITHOUT_PROGRESS = 1 / 4  # of an increment after a failure in which Newton made no progress at all
SMALLEST = 2.0**-10  # increment, as a share of the asked-for one, below which a march gives up
LEAP = 1 / 4  # of an increment, down to which a step from a stable equilibrium to an unstable one is tried again
NEARLY = 1e-9  # of an increment: round-off in a position to go on from

UNSTABLE = Finding(
    "determinant of the Jacobian",
    -1.0,
    (),
    "this equilibrium is unstable: a real body would leave it; follow the path with quasistatic.follow or let the bodies "
    "move with dynamics.march",
    False,
)
UNSTABLE_PATH = replace(UNSTABLE, meaning="this equilibrium is unstable: a real body would leave it; the path goes on")
LEAPT = "an unstable equilibrium, reached from a stable one"
OFF = 1 / 16  # of an increment, down to which a step that leaps out of contact is tried again
LEAPT_OFF = (
    "all contact was lost in a step in which Newton's iterates were wild, as where an arch snaps through: it may be another "
    "equilibrium than the one that the bodies come to; take smaller steps"
)
THROWN_OFF = (
    "a body that contact alone holds has been thrown off, by more than its size, which nothing but the size of the step can "
    "have done; take smaller steps"
)
MOVED_ON = (
    "no equilibrium was found near the last one: the increment is too large, or the bodies let go, tip or snap there; they "
    "were moved on, each node slowed by a dashpot, to where they come to rest, friction following their way; take smaller "
    "increments; dynamics.march shows such motions in time"
)
SET_DOWN = (
    "contact alone holds bodies, and no equilibrium was found from where the meshes have them: they were let down, each node "
    "slowed by a dashpot, to where they come to rest, friction following their way; have them touch on the meshes where they "
    "are to lie"
)
LEFT = (
    "the bodies have left an unstable equilibrium for a stable one some way off: they snapped or buckled, and which way is "
    "chance; dynamics.march shows such motions in time"
)
LEAPS = "the bodies let go, tip or snap on the way: no equilibrium near the last one leads there"
FAR = 10.0  # times a body's size or firmness: what is in other units is a thousand times too large, as a rule;
VERY_FAR = 100.0  # the same before anything has failed: a ball may roll far
LED = "what is prescribed is to lead a body by {:.2g} times its size: is it in the units of the mesh?"
LOADED = (
    "loads are {:.2g} times those that strain a body by one: are they in the units of its moduli, per area or volume of the "
    "mesh's units?"
)
FARTHER = 2.0  # times as far for its length as the step before: a leap, where an unstable equilibrium has been left
# the same, between stable equilibria: 325 steps of drawn scenes went at most 1.6 times as far (docs/newton.md)
SPRINGS = 3.0
AT_REST = 0.01  # facets: where bodies go less for a step, as the load rests, it tells nothing of the next one
SPRANG = (
    "bodies went much farther in this step than in those before, as where they snap through, buckle or let go: on the way "
    "there friction counts as of one step; take smaller steps, or see the motion in time with dynamics.march"
)
RESTLESS = "; nor do the bodies come to rest when they are let go"


@dataclass(frozen=True, kw_only=True)
class Step(stepping.Step):
    """A converged step of loading.

    Attributes:
        load: where a load of one number stands; of another load, the share of the way from the begin of its stage.
        stage: number of the stage, from 0.
        path: how far the march has come: stages done and the share of this one; in `follow` the length of the path (m).
    """

    load: float
    stage: int
    path: float


@dataclass(frozen=True)
class Stage:
    """A load moved along a straight line from where it stands.

    Args:
        load: a Constant (a number or a vector), a Function of prescribed values, or a function that is called with a number
            and sets what depends on it.
        to: where to: a number, a vector, or for a Function another one of its space or what its `interpolate` takes.
        increments: number of steps asked for.
        until: an event of the converged state, the same on every rank, that ends the stage. It ends with the first step
            where it holds, after closing in on it down to 1/64 of an increment.
    """

    load: Movable
    to: Any
    increments: int
    until: Callable[[], bool] | None = None


def equilibrate(problem: ContactProblem, *, solver: NewtonSolver | None = None) -> Step:
    """Solve in the loads as they stand, as of parts that overlap on the mesh because one is pressed into the other, and go on
    from there: slip is counted from this state, and a march begins with it.

    Args:
        problem, solver: as in :func:`march`.

    Returns:
        The converged state as a step, with its findings, of which it warns; its `load` and `path` are 0.

    Raises:
        ValueError: at bodies that are motions.
        StepFailure: on every rank; the problem is as it was.
    """
    check_problem(problem)
    validation.check_still(problem.motions)
    solver = stepping.solver_of(problem, solver)
    problem.take_up()
    before, clock = problem.snapshot(), perf_counter()
    attempt = _solve(problem, solver)
    if not attempt.good:
        problem.restore(before)
        problem.show_committed()
        raise StepFailure(f"no convergence in the loads as they stand: {attempt.message}{attempt.newton.advice}")
    problem.loads.note(None)
    problem.commit()
    findings = (*attempt.findings, *problem.narrow_zones())
    Reporter(problem.comm.rank).report(findings, "the loads as they stand")
    return Step(
        iterations=attempt.newton.iterations,
        wall_time=perf_counter() - clock,
        nominal=True,
        findings=findings,
        load=0.0,
        stage=0,
        path=0.0,
    )


def march(
    problem: ContactProblem,
    load: Movable | Stage | Sequence[Stage],
    *,
    to: Any = None,
    increments: int | None = None,
    start: float | None = None,
    solver: NewtonSolver | None = None,
    smallest: float = SMALLEST,
    until: Callable[[], bool] | None = None,
    progress: bool = False,
) -> Iterator[Step]:
    """Solve at growing loads and yield each converged step.

    A step that fails is undone, slip history included, and tried again at half the increment (a quarter if Newton made no
    progress); the next one is as long, and grows from there after easy steps. Where contact alone holds a body it is first
    tried without a prediction. Other bodies are let go where a sixteenth of the increment fails, and again where the smallest
    does: they move, slowed, to where they come to rest, which a finding of the step says. The asked-for loads are always
    met: `increments` equal parts of the way. A load begins where it stands, at the end of an earlier march or as a
    checkpoint has brought it back; a function that no march has called yet, at 0. Bodies begin where their displacements
    are: where these were set since the last converged state, slip is counted anew.

    Args:
        problem: to solve.
        load: what to move, see :class:`Stage`; or stages, one after the other.
        to, increments: see :class:`Stage`; of a single load.
        start: of a single load its value in the problem's present state, if another than it remembers; of a Stage or stages
            the `path` of the step to go on from, such as the `start` of an `output.Run` with a checkpoint, whose loads stand
            where they were then.
        solver: default a new :class:`~dolfinx_mortar_al.newton.NewtonSolver`.
        smallest: increment, relative to the asked-for one, below which the march gives up.
        until: an event that ends the march, as that of a stage does the stage, such as ``pair.reaches_end``.
        progress: show a progress bar over all stages with load, iterations and contact state (rank 0, standard error).

    Raises:
        ValueError: at the call, on every rank: bodies that are motions, `increments` < 1, a `to` at which the load stands
            already or that is no value of it, a `load` that is none; an argument, and later an event, that differs between
            ranks.
        StepFailure: on every rank, in a step.
    """
    check_problem(problem)
    validation.check_still(problem.motions)
    smallest = validation.number("smallest", smallest, above=0.0, most=1.0)
    event = Event(problem.comm, until)
    if isinstance(load, Stage | list | tuple):
        if to is not None or increments is not None:
            raise ValueError("to, increments: each Stage has its own; leave them out")
        stages = validation.listed("load", load, Stage, "a Stage")
        if not stages:
            raise ValueError("load = []: pass a load, a Stage or a list of them")
        begin = 0.0 if start is None else validation.number("start", start, least=0.0, most=float(len(stages)))
        agreed(problem.comm, "start", begin)
        legs = _legs(problem, stages, done=int(begin))
    else:
        if to is None or increments is None:
            raise ValueError(
                f"to = {to}, increments = {increments}: say where the load goes and in how many steps, as in "
                "march(problem, load, to=…, increments=…)"
            )
        legs = _legs(problem, [Stage(load, to, increments)], start)
        begin = float(legs[0].start is not None and _alike(problem, legs[0].start, legs[0].end))  # 1: it is over
    agreed(problem.comm, "smallest", smallest)
    control = _LoadControl(problem, stepping.solver_of(problem, solver), legs, begin, smallest, event)
    return March(_steps(control, progress), problem.comm.rank)


def follow(
    problem: ContactProblem,
    load: Movable,
    *,
    first: float,
    length: float,
    steps: int,
    start: float | None = None,
    solver: NewtonSolver | None = None,
    smallest: float = SMALLEST,
    until: Callable[[], bool] | None = None,
    progress: bool = False,
) -> Iterator[Step]:
    """Follow the equilibrium path by its length, the load being an unknown, past limit points where the load turns.

    After a first step under load control, each step moves on along the line through the last two states and corrects in
    the plane normal to it (Riks' method; the displacements alone make the norm). Contact and friction are as in `march`.

    Args:
        problem, load, start, solver, progress: as in :func:`march`; the load is one number.
        first: load increment of the first step, which gives the path its direction.
        length: of a step: the largest displacement of a node in its prediction (m).
        steps: how many steps to take after the first.
        smallest: length, relative to the asked-for one, below which the march gives up.
        until: an event of the converged state that ends the path, as in :func:`march`; not looked at in the first step.

    Raises:
        ValueError: at the call: `steps` < 1, a first load or a length of zero, a length beyond the largest body's, or a load
            that is not one number.
        StepFailure: on every rank, in a step.
    """
    steps, length = validation.whole("steps", steps, least=1), validation.number("length", length, above=0.0)
    first, smallest = validation.number("first", first), validation.number("smallest", smallest, above=0.0, most=1.0)
    if first == 0.0:
        raise ValueError("first = 0: the path needs a first load increment, which gives it its direction")
    check_problem(problem)
    validation.check_still(problem.motions)
    (moved,), event = _loads_of(problem, {"load": load}), Event(problem.comm, until)
    if not moved.is_number:
        raise ValueError(f"load: {type(load).__name__} of several components; the unknown load of a path is one number")
    begin = None if start is None else validation.number("start", start)
    agreed(problem.comm, "first, length, steps, start, smallest", (first, length, steps, begin, smallest))
    largest = float(problem.bodies.diameters().max())
    if length > largest:
        raise ValueError(
            f"length = {length:g}: a step would move some node by more than the largest body's size, {largest:.3g} m; take a "
            "few hundredths of it"
        )
    control = _PathControl(problem, stepping.solver_of(problem, solver), moved, first, length, steps, smallest, event)
    return March(_follow(control, begin, progress), problem.comm.rank)


def _steps(control: Controller[Step], progress: bool) -> Generator[Step, None, None]:
    control.problem.given.check()
    with Bar(control.problem, progress) as bar:
        yield from stepping.run(control, bar)


def _follow(control: _PathControl, start: float | None, progress: bool) -> Generator[Step, None, None]:
    """The first step with a given load, and those along the path."""
    problem, load, first = control.problem, control.load, control.first
    if start is not None:
        load.number = start
    control.mark()
    legs = _legs(problem, [Stage(load.source, load.number + first, 1)])
    given = _LoadControl(problem, control.solver, legs, 0.0, control.smallest, Event(problem.comm, None), goes_on=True)
    for step in _steps(given, progress=False):
        yield replace(step, path=control.length())
    control.mark()
    yield from _steps(control, progress)


# ---------------------------------------------------------------- legs


def _loads_of(problem: ContactProblem, sources: Mapping[str, Any]) -> list[Load]:
    """The problem's loads of sources, by the arguments' names, which may not be displacements that are solved for."""
    loads = []
    for name, source in sources.items():
        if any(source is body.u for body in problem.bodies.bodies):
            raise ValueError(f"{name}: Function {source.name!r} is the displacement; pass one of prescribed values")
        loads.append(problem.loads.of(source, name))
    problem.loads.settle()
    return loads


class _Leg:
    """A stage on its way. Positions are counted in increments.

    Attributes:
        load, end, increments: from where it stands to `end` (components,).
        x: the position of the last accepted step.
        event: that ends it; watch: whether the problem feels it.
    """

    def __init__(self, problem: ContactProblem, load: Load, end: Array, increments: int, event: Event) -> None:
        self.load, self.end, self.increments, self.event, self.x = load, end, increments, event, 0.0
        self.start: Array | None = None  # in place of where the load stands
        self.watch = LoadWatch(problem, at_once=isinstance(load.source, fem.Constant | fem.Function))
        self.begin = load.value

    def enter(self, share: float) -> None:
        """Begin, or go on where `share` of the way is done."""
        if self.start is not None and not np.array_equal(self.start, self.load.value):
            self.load.set(self.start)
        x = share * self.increments
        self.x = float(round(x)) if abs(x - round(x)) < NEARLY else x
        s = self.x / self.increments
        self.begin = np.asarray((self.load.value - s * self.end) / (1.0 - s))

    def value(self, x: float) -> Array:
        """(components,) of the load at a position."""
        if x == self.increments:
            return self.end
        return self.begin + x / self.increments * (self.end - self.begin)

    def way(self, x: float) -> Array:
        """(components,) by how much a step to a position moves the load."""
        return self.value(x) - self.value(self.x)

    def stand(self, x: float) -> float:
        """What a step at that position says of its load."""
        return float(self.value(x)[0]) if self.load.is_number else x / self.increments


def _legs(problem: ContactProblem, stages: Sequence[Stage], start: float | None = None, *, done: int = 0) -> list[_Leg]:
    """The stages, checked (collective); `start` is the value of the first one's load, if another than it remembers. Loads
    stand where the first `done` stages have left them."""
    legs: list[_Leg] = []
    agreed(problem.comm, "load: how many stages", len(stages))
    names = [f"stages[{k}]: " if len(stages) > 1 else "" for k in range(len(stages))]
    loads = _loads_of(problem, {f"{name}load": stage.load for name, stage in zip(names, stages, strict=True)})
    for k, (stage, load, where) in enumerate(zip(stages, loads, names, strict=True)):
        increments = validation.whole(f"{where}increments", stage.increments, least=1)
        leg = _Leg(problem, load, load.end(f"{where}to", stage.to), increments, Event(problem.comm, stage.until))
        if start is not None:
            leg.start = _start_of(load, start)
        # of a Function each rank has a part
        begin, end = (None, None) if isinstance(load.source, fem.Function) else (load.value.tolist(), leg.end.tolist())
        agreed(problem.comm, f"{where}start, to, increments", (start, end, increments))
        agreed(problem.comm, f"{where}load: its present value", begin)
        earlier = next((one for one in reversed(legs[done:]) if one.load is load), None)
        before = leg.start if leg.start is not None else load.value if earlier is None else earlier.end
        # where it stands then an event says, or a function that may move other loads
        chosen = earlier is not None and stages[legs.index(earlier)].until is not None
        chosen = chosen or any(one.load.moves_others for one in legs[done:] if one.load is not load)
        if k >= done and not chosen and start is None and _alike(problem, before, leg.end):
            at = f" {float(before[0]):g}" if load.is_number else ""
            raise ValueError(f"{where}to = {stage.to}: the load must move away from its present value{at}")
        legs.append(leg)
    return legs


def _start_of(load: Load, start: Any) -> Array:
    """(components,) of the value that a single load is said to have.

    Raises:
        ValueError: if it is no value of this load.
    """
    if isinstance(start, int | float | np.number) and not load.is_number:
        raise ValueError(
            f"start = {start}: the load has several components, and start is its value; pass the load as "
            "Stage(load, to, increments) for start to be the path to go on from, such as that of an output.Run"
        )
    return load.end("start", start)


def _alike(problem: ContactProblem, a: Array, b: Array) -> bool:
    """Whether two values of a load are the same on all ranks (collective)."""
    return all_over(problem.comm, np.array_equal(a, b))


# ---------------------------------------------------------------- controllers


def _solve(problem: ContactProblem, solver: NewtonSolver, path: Path | None = None) -> Attempt:
    """Newton from the present prediction."""
    return _judged(problem, solver.solve(path))


def _judged(problem: ContactProblem, result: NewtonResult) -> Attempt:
    """An attempt that ended so; a fatal finding of a monitor counts as a failure."""
    findings = problem.findings() if result.converged else []
    if result.converged and _is_unstable(problem, result):
        findings.append(UNSTABLE)
    fatal = [str(f) for f in findings if f.fatal]
    if fatal:
        fatal += [str(f) for f in findings if f.meaning == PUSHED]
    cut = stepping.CUT if result.residual < NO_PROGRESS else CUT_WITHOUT_PROGRESS
    message = "; ".join(fatal) or result.message
    return Attempt(result.converged and not fatal, result, message, findings, cut)


def _is_unstable(problem: ContactProblem, result: NewtonResult) -> bool:
    """Whether bodies would leave a converged state, as the sign of a determinant tells. Where bodies that contact alone holds
    may slide or roll it is round-off's, and a coarse wheel that stands on a corner need not roll off: of those a state counts
    to which they were thrown, or that wild iterates have led to and in which something drives a motion on."""
    if not result.unstable or problem.ties is None or not problem.floating or problem.contact_holds():
        return result.unstable
    return problem.ties.has_thrown() or (result.wild and problem.ties.is_unstable)


class _LoadControl(Controller[Step]):
    """Loads are given, leg by leg."""

    def __init__(
        self,
        problem: ContactProblem,
        solver: NewtonSolver,
        legs: list[_Leg],
        start: float,
        smallest: float,
        event: Event,
        goes_on: bool = False,
    ) -> None:
        self.problem, self.smallest, self.solver = problem, smallest, solver
        self._legs, self._event, self._predictor = legs, event, Predictor(problem)
        self.leg, self._start = int(start), start - int(start)
        self._leg_over = self._over = False
        self._was_unstable = self._unstable = False  # the last accepted equilibrium, and that of the last trial
        # whether the next, any trial of this step does without a prediction
        self._from_last = self._tried_from_last = False
        self._leapt = self._restless = False  # the last trial was no step, and how it ended
        self._before: Array = np.zeros(0)  # displacements in the last accepted state
        # how far a node went for the length of the step, to that state and in the last trial (m)
        self._pace = self._going = np.inf
        self._sprung = 0.0  # the same in the trial before, if a node went unexpectedly far
        self._path = start
        self._met = goes_on  # whether anything has been in contact in a state of this march, or may be after it

    def begin(self) -> None:
        self.problem.take_up()
        self._met |= self.problem.is_pressed()  # what touches at the start may be led away
        self._before = self.problem.bodies.get()
        if self.finished:
            return
        leg = self._legs[self.leg]
        leg.enter(self._start)
        self._predictor.add(leg.x / leg.increments)
        self._at = self._tried = self._words(leg, leg.x)
        self._doubt_units()

    def _doubts(self, legs: Sequence[_Leg], limit: float) -> list[str]:
        """Questions about the units of loads that at their ends lead or load a body by more than `limit` times its size or
        firmness (collective)."""
        p, sizes = self.problem, [0.0, 0.0]  # of the way, of the forces
        for leg in legs:
            here = leg.load.value
            leg.load.set(leg.end)
            way = p.bodies.way_over_size()
            # a way still to be gone would count as forces, as large as crushed cells are stiff
            ends = way, p.force_over_firmness() if way < NEARLY else 0.0
            sizes = [max(size, end) for size, end in zip(sizes, ends, strict=True)]
            leg.load.set(here)
        return [text.format(size) for text, size in zip((LED, LOADED), sizes, strict=True) if size > limit]

    def _doubt_units(self) -> None:
        """Warn, on rank 0, of loads that are hardly meant, before thousands of iterations go to them; of such as can be
        set ahead of their time (collective)."""
        legs = [leg for leg in self._legs[self.leg :] if isinstance(leg.load.source, fem.Constant | fem.Function)]
        for doubt in self._doubts(legs, VERY_FAR):
            if self.problem.comm.rank == 0:
                warn(doubt)

    def _words(self, leg: _Leg, x: float) -> str:
        stage = f" of stage {self.leg + 1}" if len(self._legs) > 1 else ""
        return (
            f"load {leg.stand(x):.6g}{stage}" if leg.load.is_number else f"{leg.stand(x):.6g}{stage or ' of the way'}"
        )

    @property
    def finished(self) -> bool:
        return self._over or self.leg >= len(self._legs)

    @property
    def share(self) -> float:
        return 1.0 if self.finished else self._path / len(self._legs)

    def at(self, tried: bool = False) -> str:
        return self._tried if tried else self._at

    def clip(self, size: float) -> tuple[float, bool]:
        left = floor(self._legs[self.leg].x) + 1.0 - self._legs[self.leg].x
        return min(size, left), size >= left

    def attempt(self, length: float, nominal: bool) -> Attempt:
        leg = self._legs[self.leg]
        self._x = leg.x + length
        self._tried = self._words(leg, self._x)
        predicted = self._predictor.extrapolates and not self._from_last
        if not self._from_last:
            self._predictor.predict(self._x / leg.increments)
        with leg.watch:
            leg.load.set(leg.value(self._x))
        self.problem.slip_from_touch(pace(self.problem.comm, leg.way(self._x), leg.load.moved))
        self.problem.lead()
        attempt = _solve(self.problem, self.solver)
        du = self.problem.bodies.get() - self._before
        way, X = self.problem.bodies.farthest(du)
        self._going = way / length
        if attempt.good and UNSTABLE not in attempt.findings and self._slid_on(attempt.newton, du):
            attempt.findings.append(UNSTABLE)
        self._leapt, self._unstable = False, UNSTABLE in attempt.findings
        if attempt.good and self._unstable and not self._was_unstable:
            # a body does not come to rest there: there may be a stable equilibrium that this step has leapt over
            attempt.good, attempt.message = stepping.CUT * length < max(LEAP, self.smallest), LEAPT
        if attempt.good and self._was_unstable and not self._unstable and self._going > FARTHER * self._pace:
            attempt.findings.append(Finding("leap (m)", way, X, LEFT, False))
        elif attempt.good and self._has_sprung(du, way):
            attempt.good, attempt.message = stepping.CUT * length < max(LEAP, self.smallest), SPRANG
            attempt.findings.append(Finding("leap (m)", way, X, SPRANG, False))
        if attempt.good and attempt.newton.wild and any(torn := self._predictor.torn_off(self._x / leg.increments)):
            # nor out of contact; with as little as OFF it counts, and is said
            attempt.good, attempt.message = stepping.CUT * length < max(OFF, self.smallest), LEAPT_OFF
            for pair in (pair for pair, has in zip(self.problem.pairs, torn, strict=True) if has):
                attempt.findings.append(Finding(f"{pair.name}: contact lost in a leap", 0.0, (), LEAPT_OFF, False))
        if attempt.good and self.problem.has_thrown_off():
            attempt.good, attempt.message = False, THROWN_OFF
        if attempt.good and attempt.newton.leapt and self._has_stood and not self._restless:
            # where Newton has landed is chance: the way there is found from nearby, with friction along it
            attempt.good, attempt.message = False, LEAPS
        again = not attempt.newton.converged and not self._tried_from_last and bool(self.problem.floating)
        # A prediction may leave nothing closed or sticking that holds a body which only contact holds; the last state has it.
        self._from_last = again and predicted
        if self._from_last:
            attempt.cut, self._tried_from_last = 1.0, True
        return attempt

    def _has_sprung(self, du: Array, way: float) -> bool:
        """Whether a node has gone by more than a facet, `way` (m), and SPRINGS times as far as in the last step for its
        length and as supports have: equilibria near the last one may have been leapt over (collective)."""
        p = self.problem
        facets = p.longest_motion(du)
        if not facets > 1.0:
            return False
        expected = facets * self._pace / self._going
        if expected <= AT_REST or facets <= SPRINGS * expected or way <= SPRINGS * p.led(du):
            return False
        # half as far in half of the step: the load goes faster than before; as far: a leap
        smooth = self._going < self._sprung / np.sqrt(stepping.CUT)
        self._sprung = self._going
        return not smooth

    def _slid_on(self, newton: NewtonResult, du: Array) -> bool:
        """Whether bodies have slid or tipped, while supports rest, to where contact holds them no more: by more than a facet,
        from where it held them as supports would, or else FARTHER times as far for the step's length as in the last one."""
        p = self.problem
        far = p.standing.held or self._going > FARTHER * self._pace
        return newton.unstable and far and p.longest_motion(du) > 1.0 and p.is_driven_on(du)

    @property
    def may_relax(self) -> bool:
        """Whether bodies may be let go: what may slide or roll has ties instead once it stands, and a membrane's start a
        tension; what contact alone holds, and has not come to rest, is let go once."""
        return self._has_stood and not (self._restless and self.problem.floating)

    @property
    def _has_stood(self) -> bool:
        """Whether bodies stand, or are to be set down: others have ties, or a tension, for a start."""
        holds = self.problem.standing.held or self._sets_down
        return holds and not self.problem.lacks_stiffness and self.smallest <= stepping.RELAXED

    @property
    def _sets_down(self) -> bool:
        """Whether contact alone holds bodies and has held none yet."""
        return bool(self.problem.floating) and self.problem.is_at_start

    @property
    def lets_go(self) -> float:
        return 1.0 if self._sets_down else stepping.RELAXED

    def relax(self, length: float) -> Attempt:
        p, leg = self.problem, self._legs[self.leg]
        before, words = p.bodies.get(), SET_DOWN if self._sets_down else MOVED_ON
        self._x = leg.x + length
        self._tried = self._words(leg, self._x)
        with leg.watch:
            leg.load.set(leg.value(self._x))
        attempt = _judged(p, relax(p, self.solver))
        self._restless = not attempt.good
        if attempt.good:
            attempt.findings.append(Finding("leap (m)", *p.bodies.farthest(p.bodies.get() - before), words, False))
        self._leapt, self._unstable = True, UNSTABLE in attempt.findings
        return attempt

    def undo(self) -> None:
        self._leg_over = self._over = False
        self._predictor.restore()

    def event(self) -> bool:
        self._leg_over, self._over = self._legs[self.leg].event(), self._event()
        return self._leg_over or self._over

    def accept(self, done: stepping.Step) -> Step:
        leg, stage = self._legs[self.leg], self.leg
        self._was_unstable = self._unstable
        self._before, self._pace = self.problem.bodies.get(), np.inf if self._leapt else self._going
        self._sprung = 0.0
        self._from_last = self._tried_from_last = False
        self._restless &= bool(self.problem.floating)  # what contact alone holds, and slides, is let go once
        self.problem.loads.note(None if self._leapt else leg.load, leg.way(self._x))
        self.problem.commit()
        leg.x, self._at = self._x, self._tried
        self._predictor.add(leg.x / leg.increments, afresh=self._leapt)
        if over := self._leg_over or leg.x >= leg.increments:
            self._turn()
        if over or self._over:
            leg.watch.report()
            done = replace(done, findings=(*done.findings, *self.problem.narrow_zones()))
        self._path = stage + (1.0 if over else leg.x / leg.increments)
        self._met = self._met or self.problem.is_in_contact()
        if self.leg >= len(self._legs) and not (self._met or self._leg_over or self._over):
            done = replace(done, findings=(*done.findings, *self.problem.never_met(done.findings)))
        return Step(**vars(done), load=leg.stand(leg.x), stage=stage, path=self._path)

    def _turn(self) -> None:
        """On to the next leg."""
        last, self.leg = self._legs[self.leg], self.leg + 1
        if self.finished:
            return
        leg, self._pace = self._legs[self.leg], np.inf  # lengths are others
        leg.enter(0.0)
        before = last.end - last.begin if leg.load is last.load else None
        longer = pace(self.problem.comm, leg.end - leg.begin, before)
        self._predictor.turn(1.0 / longer if longer else 0.0)

    def failure(self, reason: str) -> str:
        reason += RESTLESS if self._restless else ""
        narrow = map(str, self.problem.narrow_zones())
        reason = "; ".join(
            [reason, *self.problem.about_to_slide(), *narrow, *self._doubts([self._legs[self.leg]], FAR)]
        )
        return f"no convergence at {self._tried} with the smallest step: {reason}; the steps up to {self._at} are converged"


class _PathControl(Controller[Step]):
    """The load is an unknown; lengths along the path are given."""

    def __init__(
        self,
        problem: ContactProblem,
        solver: NewtonSolver,
        load: Load,
        first: float,
        length: float,
        steps: int,
        smallest: float,
        event: Event,
    ) -> None:
        self.problem, self.smallest, self.solver, self.load, self.first = problem, smallest, solver, load, first
        self._length, self._steps, self._taken, self._event, self._over = length, steps, 0, event, False
        self._states: list[tuple[float, Array]] = []  # the last two: load and displacements (owned dofs,)
        self._s: list[float] = [0.0]  # path length there (m)

    def mark(self) -> None:
        """The present state is on the path."""
        self._states = [*self._states, (self.load.number, self.problem.bodies.get())][-2:]
        if len(self._states) == 2:
            (_, u0), (_, u1) = self._states
            self._s = [*self._s, self._s[-1] + self._largest(u1 - u0)][-2:]

    def length(self) -> float:
        """Of the path to the present state (m), collective."""
        return self._s[-1] + self._largest(self.problem.bodies.get() - self._states[-1][1])

    def _largest(self, u: Array) -> float:
        """Largest displacement of a node (m), collective."""
        nodal = np.linalg.norm(u.reshape(-1, self.problem.gdim), axis=1)
        return max_over(self.problem.comm, float(nodal.max(initial=0.0)))

    @property
    def finished(self) -> bool:
        return self._over or self._taken >= self._steps

    @property
    def share(self) -> float:
        return (1 + self._taken) / (1 + self._steps)

    def at(self, tried: bool = False) -> str:
        return f"load {self._tried if tried else self._states[-1][0]:.6g}"

    def clip(self, size: float) -> tuple[float, bool]:
        return size, True

    def attempt(self, length: float, nominal: bool) -> Attempt:
        (λ0, u0), (λ1, u1) = self._states
        share = length * self._length / (self._s[1] - self._s[0])
        self._before = self.problem.snapshot()
        direction = u1 - u0
        self.problem.bodies.set(u1 + share * direction)
        self.load.number = λ1 + share * (λ1 - λ0)
        self.problem.slip_from_touch(share)
        attempt = _solve(self.problem, self.solver, Path(self.load, direction, 1e-3 * self.first))
        attempt.findings = [UNSTABLE_PATH if f is UNSTABLE else f for f in attempt.findings]
        self._tried = self.load.number
        return attempt

    def undo(self) -> None:
        self._over = False
        self.problem.restore(self._before)

    def event(self) -> bool:
        self._over = self._event()
        return self._over

    def accept(self, done: stepping.Step) -> Step:
        self.problem.loads.note(None)
        self.problem.commit()
        self.mark()
        self._taken += 1
        return Step(**vars(done), load=self.load.number, stage=0, path=self._s[1])

    def failure(self, reason: str) -> str:
        return (
            f"no convergence at {self.at(tried=True)} with the smallest step: {reason}; the steps up to {self.at()} are "
            "converged"
        )
