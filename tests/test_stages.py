"""Loads of every kind, stages, events, and what the three ways of stepping share."""

import itertools
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import beams
from tqdm import tqdm

from dolfinx_mortar_al import (
    Contact,
    ContactProblem,
    Surface,
    dynamics,
    materials,
    obstacles,
    output,
    quasistatic,
    stepping,
)
from dolfinx_mortar_al.checkpoint import Checkpoint
from dolfinx_mortar_al.newton import NewtonResult
from dolfinx_mortar_al.quasistatic import Stage, StepFailure
from dolfinx_mortar_al.reductions import max_over

CLONE = Path(__file__).parents[1]
MU, DEPTH, WAY = 0.3, 0.05, 0.1


class Block:
    """A block on a rigid floor, μ = 0.3, its top held: `top` is the Constant or, with `field`, the Function of its place. Its
    mesh is at a `height` and put elsewhere by `start`, if so `afterwards`, when the problem has been made.
    Pressed in by 0.05 m it sticks when it is dragged by little and slides under μN in the end."""

    def __init__(self, field=False, start=(0.0, 0.0), height=0.0, afterwards=False):
        low, high = (0.0, height), (1.0, height + 0.5)
        domain = mesh.create_rectangle(MPI.COMM_WORLD, [low, high], (4, 2), mesh.CellType.quadrilateral)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        self.u, self.top = fem.Function(V), fem.Function(V) if field else fem.Constant(domain, start)
        bottom, top = (
            mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], height + y)) for y in (0.0, 0.5)
        )
        tags = mesh.meshtags(domain, 1, np.sort(bottom), np.full(len(bottom), 1, dtype=np.int32))
        held = fem.locate_dofs_topological(V, 1, top)
        bc = fem.dirichletbc(self.top, held) if field else fem.dirichletbc(self.top, held, V)
        F = materials.neo_hookean(E=1e3, nu=0.3).virtual_work(self.u)
        self.μ = fem.Constant(domain, MU)
        contact = Contact(Surface(domain, tags, 1), obstacles.RigidPlane([0, 0], [0, 1]), friction=self.μ)
        if not afterwards:
            self.put(start)
        self.problem = ContactProblem(F, self.u, bcs=[bc], contacts=[contact])
        if afterwards:
            self.put(start)

    def put(self, way):
        self.u.interpolate(lambda x: np.outer(way, np.ones(x.shape[1])))

    def force(self):
        return self.problem.pairs[0].force()


PRESSED, DRAGGED = (0.0, -DEPTH), (WAY, -DEPTH)


@pytest.fixture(scope="module")
def separate():
    """Force (N) after pressing, and after dragging, by marches of their own with functions as loads."""
    block = Block()

    def press(share):
        block.top.value[1] = -share * DEPTH

    def drag(share):
        block.top.value[0] = share * WAY

    found = []
    for load, increments in ((press, 2), (drag, 4)):
        steps = list(quasistatic.march(block.problem, load, to=1.0, increments=increments))
        found.append((block.force(), [step.iterations for step in steps]))
    return found


def test_bodies_that_are_put_elsewhere_after_the_problem_was_made():
    """A block .2 m above its place is let down by u, before and after its problem is made: presses and friction are the same.
    What contact remembered of where it was made closed points by the dozen, and counted .2 m of slip."""
    forces = []
    for afterwards in (False, True):
        block = Block(start=(0.3, -0.2), height=0.2, afterwards=afterwards)
        begun = (0.3, -0.2)
        for way in ((0.0, -DEPTH), (WAY, -DEPTH)):
            to = tuple(np.add(begun, way))
            steps = list(quasistatic.march(block.problem, block.top, to=to, increments=4))
            forces.append((block.force(), sum(step.iterations for step in steps)))
    for (before, few), (after, no_more) in zip(forces[:2], forces[2:], strict=True):
        assert np.allclose(before, after, rtol=1e-9)
        assert no_more <= few
    assert abs(forces[3][0][0]) > 0.9 * MU * forces[3][0][1]


def test_stages_are_marches_one_after_the_other(separate):
    """The same forces and iterations; and sliding, the force is μ times what presses."""
    block = Block()
    stages = [Stage(block.top, PRESSED, 2), Stage(block.top, DRAGGED, 4)]
    forces, iterations = {}, [[], []]
    for step in quasistatic.march(block.problem, stages):
        iterations[step.stage].append(step.iterations)
        forces[step.path] = block.force()
    assert list(forces) == [0.5, 1.0, 1.25, 1.5, 1.75, 2.0]
    assert iterations == [its for _, its in separate]
    for path, (force, _) in zip((1.0, 2.0), separate, strict=True):
        assert np.allclose(forces[path], force, rtol=1e-9, atol=1e-9 * force[1])
    assert abs(forces[2.0][0]) == pytest.approx(MU * forces[2.0][1], rel=1e-6)
    assert np.allclose(block.top.value, DRAGGED)


def test_a_function_of_prescribed_values_as_load(separate):
    block = Block(field=True)
    dragged = fem.Function(block.u.function_space)
    dragged.interpolate(lambda x: np.outer(DRAGGED, np.ones_like(x[0])))
    stages = [Stage(block.top, lambda x: np.outer(PRESSED, np.ones_like(x[0])), 2), Stage(block.top, dragged, 4)]
    loads = [step.load for step in quasistatic.march(block.problem, stages)]
    assert loads == [0.5, 1.0, 0.25, 0.5, 0.75, 1.0]
    force = separate[1][0]
    assert np.allclose(block.force(), force, rtol=1e-9, atol=1e-9 * force[1])


def test_a_load_goes_on_from_where_it_stands():
    """A Constant, a bound method and a function remember; a jump to 0 would lift the block off."""
    block = Block()

    def press(depth):
        block.top.value[1] = -depth

    for to in (0.5 * DEPTH, DEPTH):
        first, *_, last = quasistatic.march(block.problem, press, to=to, increments=2)
    assert (first.load, last.load) == pytest.approx((0.75 * DEPTH, DEPTH))
    assert block.problem.pairs[0].closed_fraction() == 1.0
    with pytest.raises(ValueError, match=r"to = 0\.05: the load must move away from its present value 0\.05"):
        quasistatic.march(block.problem, press, to=DEPTH, increments=2)
    steps = list(quasistatic.march(block.problem, block.top, to=(0.0, 0.01), increments=2))
    assert [step.load for step in steps] == [0.5, 1.0]
    assert block.problem.pairs[0].closed_fraction() == 0.0


def test_a_function_may_move_the_load_of_a_later_stage():
    """It presses and drags; then the Constant that it has set goes back to where it was before the march."""
    block = Block()

    def both(s):
        block.top.value[:] = 0.0, -s * DEPTH

    stages = [Stage(both, to=1.0, increments=2), Stage(block.top, to=(0.0, 0.0), increments=1)]
    forces = [block.force()[1] for _ in quasistatic.march(block.problem, stages)]
    assert forces[1] > 0.0 and abs(forces[2]) < 1e-9 * forces[1]


def test_a_stage_ends_at_its_event():
    """Pressed until 15 N are reached, closed in on to 1/64 of an increment, then dragged from there."""
    block = Block()
    fell = []
    stages = [Stage(block.top, (0.0, -1.0), 20, until=lambda: block.force()[1] > 15.0)]
    for step in quasistatic.march(block.problem, [*stages, Stage(block.top, (0.01, 0.0), 1)]):
        fell.append((step.stage, step.path, float(block.top.value[1]), block.force()[1]))
    *before, (stage, path, depth, force) = [row for row in fell if row[0] == 0]
    assert (stage, path) == (0, 1.0)
    assert before[-1][3] <= 15.0 < force
    assert before[-1][2] - depth <= 1 / 20 / 64 + 1e-12
    assert fell[-1][:3] == (1, 2.0, 0.0)


def test_events_at_the_end_of_a_march_and_of_one_that_is_left():
    block = Block()
    stages = [Stage(block.top, PRESSED, 2), Stage(block.top, DRAGGED, 4)]
    *_, last = quasistatic.march(block.problem, stages, until=lambda: block.top.value[0] > 0.3 * WAY)
    assert last.stage == 1
    assert 0.3 < last.load <= 0.3 + 1 / 4 / 64


def test_a_march_goes_on_from_a_checkpoint_within_a_stage(shared_path):
    """Left in the second stage, whose begin an event has chosen, and gone on with in a new problem: the same rows."""

    def go(folder, steps):
        block = Block()
        run = output.Run(block.problem, folder, ["path", "x", "y", "fx", "fy", "newton_iterations", "wall_time"], {},
                         checkpoint=True)  # fmt: skip
        stages = [
            Stage(block.top, (0.0, -1.0), 40, until=lambda: block.force()[1] > 10.0),
            Stage(block.top, DRAGGED, 4),
            Stage(block.top, (0.0, 0.0), 2),
        ]
        for k, step in enumerate(quasistatic.march(block.problem, stages, start=run.start)):
            (x, y), (fx, fy) = block.top.value, block.force()
            run.record(step, step.path, path=step.path, x=x, y=y, fx=fx, fy=fy)
            if k + 1 == steps:
                break
        return run

    whole = go(shared_path / "whole", -1)
    at = int(np.searchsorted(whole.history.column("path"), 1.4))
    go(shared_path / "cut", at + 1)
    cut = go(shared_path / "cut", -1)
    assert cut.start == 1.5
    for name in ("path", "x", "y", "fx", "fy"):
        assert np.allclose(cut.history.column(name), whole.history.column(name), rtol=0, atol=1e-8), name
    assert go(shared_path / "cut", -1).start == 3.0  # nothing is left, and nothing happens


@pytest.mark.parametrize(
    "stages, rows",
    [
        ([("press", DEPTH, 2), ("drag", WAY, 4)], 2),  # interrupted at the end of the first stage
        ([("press", DEPTH, 2), ("drag", WAY, 4)], 4),  # within the second one, which moves another load
        ([("press", DEPTH / 2, 2), ("press", DEPTH, 2)], 2),
        ([("top", PRESSED, 2), ("drag", WAY, 4)], 2),
        ([("top", PRESSED, 4), ("over", WAY, 4)], 1),  # `over` sets all of `top`:
        ([("top", PRESSED, 2), ("over", WAY, 4), ("top", (0.0, -DEPTH / 2), 4)], 8),  # not before, nor after its turn
        ([("top", DRAGGED, 2), ("μ", MU / 2, 2), ("top", (2 * WAY, -DEPTH), 2)], 3),
    ],
)
def test_a_march_goes_on_from_a_checkpoint_after_a_stage(shared_path, stages, rows):
    """What is done is not done again, whatever load the next stage moves: the forces of the march that went through."""

    def go(rows=None):
        block, forces = Block(), []

        def press(depth):
            block.top.value[1] = -depth

        def drag(way):
            block.top.value[0] = way

        def over(way):
            block.top.value[:] = way, -DEPTH

        loads = {"press": press, "drag": drag, "over": over, "top": block.top, "μ": block.μ}
        folder = shared_path / ("cut" if rows else "whole")
        kept = Checkpoint(folder, block.problem)
        saved = kept.load()
        start = None if saved is None else saved.at
        march = quasistatic.march(block.problem, [Stage(loads[name], *aim) for name, *aim in stages], start=start)
        for step in itertools.islice(march, rows):
            kept.save(step.path)
            forces.append(block.force())
        return forces

    whole = go()
    cut = go(rows) + go(len(whole))
    assert np.allclose(cut, whole, rtol=1e-7, atol=1e-7 * np.abs(whole).max())
    assert go(1) == []


@pytest.mark.parametrize("integration", ["gauss", "segments"])
def test_results_after_a_failure_are_those_of_the_last_converged_step(integration):
    """Sliding points slide in them, by what they slid in that step; with segments, too, whose points have moved since."""
    problem, P = beams(order=1, friction=MU, integration=integration)
    pair = problem.pairs[0]
    *_, step = quasistatic.march(problem, P, to=8.0, increments=4)
    assert step.reasons == () and pair.stick_fraction() < 0.9 * pair.closed_fraction()
    fields = pair.fields()
    force, slip, status = pair.force(), fields.slip, fields.status
    assert max_over(problem.comm, float(np.abs(slip).max(initial=0.0))) > 1e-4
    with pytest.raises(StepFailure, match="the steps up to load 8 are converged"):
        list(quasistatic.march(problem, P, to=1e8, increments=1, smallest=1.0))
    assert np.allclose(pair.force(), force, rtol=1e-9)
    assert np.array_equal(pair.fields().status, status) and np.array_equal(pair.fields().slip, slip)


def flight(step=1e-3):
    """A square that falls onto the floor at 1 m/s from 1 mm above it: (problem, motion)."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 1e-3), (1.0, 1.001)], (2, 2), mesh.CellType.quadrilateral)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    motion = dynamics.Motion(u, materials.neo_hookean(1e6, 0.3), density=1e3, step=step)
    motion.velocity.interpolate(lambda x: np.stack([0 * x[0], -1.0 + 0 * x[0]]))
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1e-3))
    tags = mesh.meshtags(domain, 1, np.sort(bottom), np.full(len(bottom), 1, dtype=np.int32))
    contact = Contact(Surface(domain, tags, 1), obstacles.RigidPlane([0, 0], [0, 1]))
    return ContactProblem(motion, contacts=[contact]), motion


def test_a_march_in_time_ends_at_an_event(capfd):
    """Touch, after 1 ms of free fall, met to 1/64 of Δt; Δt and the ledger are as if nothing had been tried beyond."""
    problem, motion = flight(step=0.7e-3)
    energy = sum(motion.energies())
    march = dynamics.march(problem, to=1.0, until=lambda: problem.pairs[0].closed_fraction() > 0, progress=True)
    *_, last = march
    assert 1e-3 - 1e-9 <= last.time <= 1e-3 + 0.7e-3 / 64 + 1e-9
    assert sum(motion.energies()) == pytest.approx(energy - last.ledger.impact_loss, rel=1e-9)
    assert float(motion.time_step.value) == 0.7e-3
    shown = capfd.readouterr().err
    assert (f"time {last.time:.6g} s" in shown) == (problem.comm.rank == 0)


def test_a_finished_march_that_is_resumed_is_empty():
    """As one of stages is: what a run does next is done."""
    problem, P = beams(order=1)
    list(quasistatic.march(problem, P, to=1.0, increments=1))
    assert list(quasistatic.march(problem, P, to=1.0, increments=1, start=1.0)) == []
    assert [step.load for step in quasistatic.march(problem, P, to=2.0, increments=2, start=1.0)] == [1.5, 2.0]


def test_a_path_that_begins_without_contact_is_not_said_to_have_none():
    """The first step alone is none of the whole path."""
    problem, P = beams(order=1, mesh={"gap": 0.01})
    first = next(quasistatic.follow(problem, P, first=0.01, length=0.01, steps=1))
    assert not first.findings and problem.pairs[0].closed_fraction() == 0.0


def test_arguments_are_checked_at_the_call():
    problem, _ = flight()
    block = Block()
    for call, words in [
        (lambda: dynamics.march(problem, to=-1.0), "to = -1"),
        (lambda: dynamics.march(problem, to=1.0, until=3), "until = 3"),
        (lambda: dynamics.march(problem, to=1.0, solver=3), "solver: int"),
        (lambda: dynamics.march(block.problem, to=1.0), "0 of its 1 displacements move"),
        (lambda: quasistatic.march(problem, block.top, to=PRESSED, increments=1), "1 of its displacements move"),
        (lambda: quasistatic.follow(problem, block.top, first=1.0, length=1.0, steps=1), "march it in time"),
        (lambda: quasistatic.follow(block.problem, block.top, first=1.0, length=1.0, steps=1), "one number"),
        (lambda: quasistatic.follow(block.problem, print, first=0.0, length=1.0, steps=1), "first = 0"),
        (lambda: quasistatic.follow(block.problem, print, first=1.0, length=20.0, steps=1), "the largest body's size"),
        (lambda: quasistatic.march(block.problem, block.top, to=(1.0,), increments=1), r"shape \(2,\)"),
        (lambda: quasistatic.march(block.problem, block.u, to=print, increments=1), "is the displacement"),
        (lambda: quasistatic.march(block.problem, "load", to=1.0, increments=1), "load: str is no load"),
        (lambda: quasistatic.march(block.problem, block.top), "say where the load goes"),
        (lambda: quasistatic.march(block.problem, Stage(block.top, PRESSED, 1), to=1.0), "leave them out"),
        (lambda: quasistatic.march(block.problem, [Stage(block.top, PRESSED, 0)]), "increments = 0"),
        (
            lambda: quasistatic.march(block.problem, [Stage(block.top, PRESSED, 1)] * 2),
            r"stages\[1\]: to = .*move away",
        ),
        (lambda: quasistatic.march(block.problem, [block.top]), "is not a Stage"),
        (lambda: quasistatic.march(block.problem, [Stage(block.top, PRESSED, 1)], start=2.0), "start = 2"),
    ]:
        with pytest.raises(ValueError, match=words):
            call()


@pytest.mark.parametrize("ending", ["break", "error", "failure", "left alone"])
def test_the_bar_is_closed_whatever_ends_the_march(ending):
    block = Block()
    depth = 2.0 if ending == "failure" else DEPTH
    march = quasistatic.march(block.problem, block.top, to=(0.0, -depth), increments=4, progress=True, smallest=0.5)
    if ending == "break":
        next(march)
    elif ending == "error":
        next(march)
        with pytest.raises(ZeroDivisionError):
            march.throw(ZeroDivisionError)
    elif ending == "failure":
        with pytest.raises(StepFailure, match=r"no convergence at .* of the way with the smallest step"):
            list(march)
    del march  # as the loop does that it was made for
    assert not tqdm._instances


@pytest.mark.one_rank
def test_a_users_scene(tmp_path):
    """Press, drag and lift in fewer than 40 lines; while it is dragged back and forth friction is within μ of the normal
    force, and in the end there is none."""
    script = Path(__file__).with_name("user_scene.py")
    assert len(script.read_text().splitlines()) < 40
    subprocess.run([sys.executable, "-m", "meshes.ironing", tmp_path / "ironing.msh"], check=True, cwd=CLONE)
    command = [sys.executable, script, tmp_path / "ironing.msh", tmp_path / "results"]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    rows = np.genfromtxt(tmp_path / "results" / "history.csv", delimiter=",", names=True)
    assert np.allclose(rows["path"], [0.5, 1, 4 / 3, 5 / 3, 2, 2.5, 3])
    share = np.abs(rows["force_x"]) / rows["force_y"].clip(1e-12)
    assert 0.1 < share[4] < 0.3 + 0.1  # the slab's surface is inclined by a few degrees
    assert rows["force_y"][-1] == 0.0
    assert (tmp_path / "results" / "displacement.bp").exists()


class Stubborn(stepping.Controller):
    """A march of four asked-for steps that is refused at once where it is longer than `most` allows at its place."""

    smallest, problem = 2.0**-6, SimpleNamespace(comm=MPI.COMM_SELF)

    def __init__(self, most):
        self.most, self.x, self.tried = most, 0.0, []

    finished = property(lambda self: self.x >= 4.0)
    share = property(lambda self: self.x / 4.0)

    def at(self, tried=False):
        return str(self.x)

    def clip(self, size):
        left = np.floor(self.x) + 1.0 - self.x
        return min(size, left), size >= left

    def attempt(self, length, nominal):
        self.length = length
        self.tried.append(length)
        good = length <= self.most(self.x)
        return stepping.Attempt(good, NewtonResult(converged=good, iterations=2), "too long", [])

    def undo(self):
        pass

    def accept(self, done):
        self.x += self.length
        return done

    def failure(self, reason):
        return reason


def test_a_step_that_was_cut_is_repeated_before_it_grows():
    """What has just failed would fail again: after a cut the next step is as long as the one that went through."""
    march = Stubborn(lambda x: 0.25 if x < 0.5 else 1.0)
    steps = list(stepping.run(march, stepping.Bar(march.problem, shown=False)))
    assert march.tried == [1.0, 0.5, 0.25, 0.25, 0.5, 1.0, 1.0, 1.0]
    assert [step.reasons for step in steps] == [("0.0: too long", "0.0: too long"), *[()] * 5]
    assert [step.rejected for step in steps] == [2, 0, 0, 0, 0, 0]
