"""Where no equilibrium is near: bodies that are let go come to rest, in the state that they reach on other ways, too."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_rectangle, locate_entities_boundary, meshtags
from mpi4py import MPI
from scenes import beams, rough, set_field, tip

from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, quasistatic
from dolfinx_mortar_al.dashpots import Dashpots
from dolfinx_mortar_al.materials import neo_hookean, saint_venant_kirchhoff
from dolfinx_mortar_al.obstacles import RigidPlane, RigidSphere
from dolfinx_mortar_al.quasistatic import StepFailure
from dolfinx_mortar_al.relaxation import relax

RISE, THICKNESS = 0.1, 0.02  # m, of an arch that spans one metre
TOP = (0.5, RISE)


def rise(x):
    return RISE * np.sin(np.pi * x) ** 2


def arch(plate=-1.0):
    """A shallow arch of E = 1 GPa, clamped at both ends, with a dead load (N/m) on its middle half, above a plate (m)."""
    corners = [[0.0, -THICKNESS / 2], [1.0, THICKNESS / 2]]
    domain = create_rectangle(MPI.COMM_WORLD, corners, [24, 1], CellType.quadrilateral)
    domain.geometry.x[:, 1] += rise(domain.geometry.x[:, 0])
    u, P = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,)))), fem.Constant(domain, 0.0)
    V = u.function_space
    ends = locate_entities_boundary(domain, 1, lambda x: (x[0] < 1e-9) | (x[0] > 1 - 1e-9))
    lower = locate_entities_boundary(
        domain, 1, lambda x: (x[1] < rise(x[0]) - 0.9 * THICKNESS / 2) & (x[0] > 0.2) & (x[0] < 0.8)
    )
    tags = meshtags(domain, 1, np.sort(lower), np.ones(len(lower), dtype=np.int32))
    v, X = ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
    middle = ufl.conditional(ufl.lt(abs(X[0] - 0.5), 0.25), 2.0 / THICKNESS, 0.0)
    F = saint_venant_kirchhoff(1e9, 0.3).virtual_work(u) + P * middle * v[1] * ufl.dx
    clamped = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, ends), V)
    contact = Contact(Surface(domain, tags, 1), RigidPlane([0.0, plate], [0.0, 1.0]))
    return ContactProblem(F, u, bcs=[clamped], contacts=[contact]), P


@pytest.mark.parametrize("P, plate", [(5e4, -1.0), (4e5, -0.06)], ids=["free", "onto a plate"])
def test_an_arch_let_go_snaps_through(P, plate):
    """From rest, with a load beyond its limit, it comes to rest where it does if it is turned over by hand before it is
    loaded, to 1e-8 of its rise; in the plate's way or not."""
    (problem, load), (other, same) = arch(plate), arch(plate)
    load.value = same.value = P
    result = relax(problem, NewtonSolver(problem))
    assert result.converged and result.signs[-1] > 0
    set_field(other, lambda X: np.c_[0 * X[:, 0], -1.6 * rise(X[:, 0])])
    assert NewtonSolver(other).solve().converged
    assert abs(tip(problem, TOP) - tip(other, TOP)).max() < 1e-8 * RISE
    assert tip(problem, TOP)[1] < -1.4 * RISE
    assert (problem.pairs[0].force()[1] > 0) == (plate > -1.0)


def test_below_its_limit_it_stays():
    """With half of the load that it can bear it comes to rest where Newton's method finds it at once."""
    (problem, load), (other, same) = arch(), arch()
    load.value = same.value = 1.5e4
    assert relax(problem, NewtonSolver(problem)).converged
    assert NewtonSolver(other).solve().converged
    assert abs(tip(problem, TOP) - tip(other, TOP)).max() < 1e-8 * RISE


def leaps(steps):
    """Which steps say that they have leapt."""
    return [any(finding.name == "leap (m)" for finding in step.findings) for step in steps]


class Stuck(NewtonSolver):
    """Fails where nothing slows the bodies down, until they have been let go and have come to rest, if that they do."""

    def __init__(self, problem, rests):
        super().__init__(problem)
        self.rests, self.slowed, self.stuck = rests, False, True

    def solve(self, path=None):
        result = super().solve(path)
        slowed = self.problem.dashpots is not None
        self.stuck &= not (result.converged and self.slowed and not slowed and self.rests)
        result.converged &= slowed or not self.stuck
        self.slowed = slowed
        return result


def test_a_march_goes_on_by_letting_the_bodies_go():
    """Where no step gets through, not even a sixteenth, the bodies are let go; that is said, with the place that moved
    farthest, and the march goes on from there, to where one without trouble comes."""
    (problem, load), (other, same) = beams(friction=0.3), beams(friction=0.3)
    steps = list(quasistatic.march(problem, load, to=1.0, increments=1, solver=Stuck(problem, rests=True)))
    assert steps[0].load == 1 / 16 and len(steps[0].reasons) == 5
    assert leaps(steps) == [True] + [False] * (len(steps) - 1)
    assert steps[0].findings[-1].X[0] == pytest.approx(1.0, abs=1e-12)  # a node's, to round-off
    assert problem.dashpots is None and steps[-1].load == 1.0
    list(quasistatic.march(other, same, to=1.0, increments=16))
    assert np.allclose(tip(problem), tip(other), rtol=1e-3)  # slip hangs on the increments


def column(height, cells):
    """A column of a metre's width between two rigid planes, μ = .5, which alone hold it; what presses the upper one down."""
    domain = create_rectangle(MPI.COMM_WORLD, [[-0.5, 0.0], [0.5, height]], cells, CellType.quadrilateral)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,))))
    planes = [RigidPlane([0.0, 0.0], [0.0, 1.0]), RigidPlane([0.0, height], [0.0, -1.0])]
    ends = [locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, height)]
    marks = [np.full(len(facets), k, dtype=np.int32) for k, facets in enumerate(ends)]
    order = np.argsort(np.concatenate(ends))
    tags = meshtags(domain, 1, np.concatenate(ends)[order], np.concatenate(marks)[order])
    contacts = [Contact(Surface(domain, tags, k), plane, friction=0.5) for k, plane in enumerate(planes)]
    problem = ContactProblem(neo_hookean(100.0, 0.3).virtual_work(u), u, contacts=contacts)
    return problem, lambda d: planes[1].move([0.0, -d])


def test_a_column_that_contact_alone_holds_is_unstable_from_eulers_load_on():
    """Squeezed by π²/(3 · 16²) of its height, .206 m, it buckles as one with clamped ends; it bends no more than by round-off
    and stays straight, and the steps from there on say so."""
    problem, press = column(16.0, [2, 32])
    steps = list(quasistatic.march(problem, press, to=0.3, increments=12))
    said = {step.load: any(f.name == "determinant of the Jacobian" for f in step.findings) for step in steps}
    first = min(load for load, unstable in said.items() if unstable)
    assert 0.19 < first < 0.23
    assert all(unstable == (load >= first) for load, unstable in said.items())
    assert abs(tip(problem, (0.0, 8.0))[0]) < 0.05


def test_bodies_that_contact_alone_holds_are_let_go_too():
    """A short column that sticks between its planes, where no step gets through: it is let go as one on supports."""
    (problem, press), (other, same) = column(2.0, [2, 4]), column(2.0, [2, 4])
    list(quasistatic.march(problem, press, to=0.05, increments=1))
    assert problem.standing.held
    steps = list(quasistatic.march(problem, press, to=0.1, increments=1, solver=Stuck(problem, rests=True)))
    assert leaps(steps)[0] and steps[-1].load == 0.1
    list(quasistatic.march(other, same, to=0.1, increments=4))
    assert np.allclose(problem.pairs[0].force(), other.pairs[0].force(), rtol=1e-3, atol=1e-6)


class Unsteady(NewtonSolver):
    """Says of states up to a load of 3 N that they are unstable."""

    def solve(self, path=None):
        result = super().solve(path)
        result.signs[-1] = -1.0 if self.P.value < 3.0 else 1.0
        return result


@pytest.mark.one_rank
def test_no_increment_snaps_through_without_a_word(monkeypatch):
    """A shallower arch, from 10 to 15 kN/m at once, snaps from one stable equilibrium to another, which no determinant tells:
    Newton's method went there in silence. Its limit is 10.4 kN/m (eighty increments)."""
    monkeypatch.setitem(globals(), "RISE", 0.04)
    problem, load = arch()
    steps = list(quasistatic.march(problem, load, to=2e4, increments=4))
    snapped = [step.load for step, leapt in zip(steps, leaps(steps), strict=True) if leapt]
    assert len(snapped) == 1 and 1.025e4 < snapped[0] < 1.13e4
    assert sum(step.load < snapped[0] for step in steps) >= 2
    assert tip(problem, (0.5, 0.04))[1] == pytest.approx(-0.08396, rel=1e-3)


def test_what_leaves_an_unstable_equilibrium_is_said_to_have_leapt():
    """Where a step goes on twice as far and more from an unstable state to a stable one; not from there on."""
    problem, P = beams(friction=0.3)
    solver = Unsteady(problem)
    solver.P = P

    def load(t):
        P.value = 4.0 * t if t < 0.7 else 12.0 * t

    steps = list(quasistatic.march(problem, load, to=1.0, increments=4, solver=solver))
    assert [step.load for step, leapt in zip(steps, leaps(steps), strict=True) if leapt] == [0.75]


class Leaping(NewtonSolver):
    """Says of its first five steps that they have leapt, though they converge."""

    def solve(self, path=None):
        result = super().solve(path)
        self.count = getattr(self, "count", 0) + (self.problem.dashpots is None)
        result.leapt = self.problem.dashpots is None and self.count <= 5
        return result


def test_where_newton_leaps_the_bodies_are_let_go_nearby():
    """A step that leaps is none: it is halved down to a sixteenth, and from there the bodies go by themselves."""
    problem, load = beams(friction=0.3)
    steps = list(quasistatic.march(problem, load, to=1.0, increments=1, solver=Leaping(problem)))
    assert steps[0].load == 1 / 16 and len(steps[0].reasons) == 5
    assert leaps(steps) == [True] + [False] * (len(steps) - 1)
    assert all("no equilibrium near the last one leads there" in reason for reason in steps[0].reasons)
    assert not any(step.reasons for step in steps[1:])


def test_where_increments_may_not_be_cut_a_leap_counts():
    """Nobody asked for shorter steps."""
    problem, load = beams(friction=0.3)
    steps = list(quasistatic.march(problem, load, to=1.0, increments=1, solver=Leaping(problem), smallest=1.0))
    assert [step.load for step in steps] == [1.0] and not steps[0].reasons


def test_bodies_that_do_not_come_to_rest_are_undone():
    """The march ends with its reason, and with the state of the last step."""
    problem, load = beams()
    with pytest.raises(
        StepFailure, match=r"nor do the bodies come to rest when they are let go; the steps up to load 0 "
    ):
        list(quasistatic.march(problem, load, to=1.0, increments=1, solver=Stuck(problem, rests=False), smallest=2**-5))
    assert problem.dashpots is None and not problem.u.x.array.any()


def test_tangent_of_dashpots():
    """They are part of the residual and of its derivative, and leave prescribed displacements alone."""
    problem, P = beams()
    P.value = 1.0
    start, go = rough(1e-4, 1), rough(1.0, 2)
    k = problem.nodal_stiffness()
    assert not k[problem.bodies.prescribed()].any() and (k[~problem.bodies.prescribed()] > 0).all()
    problem.dashpots = Dashpots(0.3 * k, 0.5 * k / k.max())
    x, f = problem.x, problem.residual

    def state(h):
        set_field(problem, lambda X: start(X) + h * go(X))

    def at(h):
        state(h)
        problem.pack(x)
        problem.assemble_residual(x, f)
        return f.getNestSubVecs()[0].array.copy()

    with_them = at(0.0)
    problem.assemble_jacobian()
    set_field(problem, go)
    d, Kd = x.duplicate(), x.duplicate()
    problem.pack(d)
    problem.matrix.mult(d, Kd)
    difference = (at(1e-7) - at(-1e-7)) / 2e-7
    derivative = Kd.getNestSubVecs()[0]
    miss = problem.comm.allreduce(np.sum((difference - derivative.array) ** 2))
    assert np.sqrt(miss) < 1e-8 * derivative.norm()
    state(0.0)
    forces = problem.dashpots.stiffness * (problem.bodies.get() - problem.dashpots.since)
    problem.dashpots = None
    assert np.allclose(with_them - at(0.0), forces, rtol=0.0, atol=1e-12 * abs(forces).max())


@pytest.mark.one_rank
@pytest.mark.parametrize("way", [0.03, 0.06])
def test_bodies_that_are_let_go_know_where_an_obstacle_was(way):
    """A plate on two rollers, bent by a third one in an increment longer than that is thick: let go, the plate forgot after
    a first trial that was undone where the roller had been, and was lifted by it, or lay untouched on its far side. The force
    is that of ten increments."""

    def bent(increments):
        half, r, thick = 0.25, 0.02, 0.005
        domain = create_rectangle(MPI.COMM_WORLD, [[-half, 0.0], [half, thick]], [24, 2], CellType.quadrilateral)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        u, (V_x, _) = fem.Function(V), V.sub(0).collapse()
        middle = fem.locate_dofs_geometrical((V.sub(0), V_x), lambda X: np.isclose(X[0], 0.0))
        faces = [np.sort(locate_entities_boundary(domain, 1, lambda X, y=y: np.isclose(X[1], y))) for y in (0.0, thick)]
        lower, upper = (
            Surface(domain, meshtags(domain, 1, facets, np.ones(len(facets), dtype=np.int32)), 1) for facets in faces
        )
        below, above = [RigidSphere([x, -r], r) for x in (-0.2, 0.2)], RigidSphere([0.0, thick + r], r)
        contacts = [Contact(upper, above), *(Contact(lower, roller) for roller in below)]
        F = neo_hookean(2e9, 0.3).virtual_work(u)
        bc = fem.dirichletbc(fem.Function(V_x), middle, V.sub(0))
        problem = ContactProblem(F, u, bcs=[bc], contacts=contacts)
        list(quasistatic.march(problem, lambda s: above.move([0.0, -s]), to=way, increments=increments))
        return problem.pairs[0].force()[1]

    assert bent(1) == pytest.approx(bent(10), rel=1e-6) and bent(10) < 0.0
