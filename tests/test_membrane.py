"""Membranes: material, pressure, flat start, contact of curves and surfaces, path following, against exact solutions."""

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import NU, E, assert_tangent, membranes, octant, rough, set_field
from scipy.optimize import brentq

from dolfinx_mortar_al import (
    Body,
    Contact,
    ContactProblem,
    Surface,
    loads,
    materials,
    membrane,
    monitors,
    obstacles,
    output,
    quasistatic,
)
from dolfinx_mortar_al.checkpoint import Checkpoint
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.law import OPEN, SLIP, STICK
from exact.balloon import Balloon
from exact.two_membranes import TwoMembranes as Exact
from exact.two_membranes import thickness_stretch_squared
from meshes.two_membranes import EDGE, LOWER, UPPER, TwoMembranes


@pytest.mark.parametrize("nu", [0.0, 0.1, 0.3, 0.45, 0.4999])
def test_thickness_is_eliminated_to_round_off(nu):
    """x(J) against Wright's ω for area stretches 0.1 … 20: a few units of round-off."""
    sheet = membrane.neo_hookean_membrane(1.0, nu, 1.0)
    for J in np.geomspace(0.1, 20.0, 41):
        exact = thickness_stretch_squared(J, sheet.G, sheet.lame)
        assert float(sheet.squared_thickness_stretch(ufl.as_ufl(float(J)))) == pytest.approx(float(exact), rel=1e-13)


def test_tension_of_a_strip_and_of_a_sheet_stretched_both_ways():
    """End forces of a uniformly stretched curve, hG(l − x/l), and of a surface with x(l²): to round-off."""
    sheet = membrane.neo_hookean_membrane(E, NU, 1e-3)
    for dim, l in ((2, 1.7), (3, 1.3)):
        domain, _, _edges = TwoMembranes(dim=dim, cells=(3, 3), through=3).create()
        u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (dim,))))
        u.interpolate(lambda x, l=l, dim=dim: ((l - 1) * x[:dim]) * np.array([[1], [0], [1]])[:dim])
        J = l if dim == 2 else l**2
        tension = sheet.thickness * sheet.G * (l - float(thickness_stretch_squared(J, sheet.G, sheet.lame)) / l)
        assert np.allclose(monitors.wrinkling(sheet, u).range(), tension, rtol=1e-12)
        inner = fem.assemble_scalar(fem.form(sheet.virtual_work(u, u)))  # N × (l − 1) per direction and area, 2 sheets
        total = domain.comm.allreduce(inner)
        assert total == pytest.approx(2 * (dim - 1) * tension * (l - 1), rel=1e-12)


@pytest.mark.parametrize("nu, thickness, words", [(-0.1, 1.0, "nu = -0.1"), (0.3, 0.0, "thickness = 0.0")])
def test_membrane_arguments(nu, thickness, words):
    with pytest.raises(ValueError, match=words):
        membrane.neo_hookean_membrane(1.0, nu, thickness)


@pytest.mark.parametrize("dim", [2, 3])
def test_pressure_on_a_closed_surface_does_the_work_of_its_volume(dim):
    """Any deformation: no resultant force; power −p dV/dt, both to round-off (the quadrature is exact)."""
    comm = MPI.COMM_WORLD
    domain = mesh.create_unit_square(comm, 3, 3) if dim == 2 else mesh.create_unit_cube(comm, 2, 2, 2)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (dim,))))
    v = fem.Function(u.function_space)
    u.interpolate(lambda x: 0.1 * np.sin(3 * x[:dim] + 1) * np.cos(2 * x[[1, 0, 2][:dim]]))
    v.interpolate(lambda x: np.cos(4 * x[:dim] + 2) + x[:dim] ** 2)
    force = loads.pressure(u, 2.0, ufl.Measure("ds", domain))
    F = materials.deformation_gradient(u)
    volume_rate = ufl.derivative(ufl.det(F) * ufl.dx(domain), u, v)
    total = [domain.comm.allreduce(fem.assemble_scalar(fem.form(f))) for f in (ufl.action(force, v), volume_rate)]
    assert total[0] == pytest.approx(-2.0 * total[1], rel=1e-10)
    for k in range(dim):
        rigid = fem.Constant(domain, np.eye(dim)[k])
        one = ufl.replace(force, {ufl.TestFunction(u.function_space): rigid})
        assert abs(domain.comm.allreduce(fem.assemble_scalar(fem.form(one)))) < 1e-12


@pytest.mark.parametrize("pressure", [0.1, 10.0, 400.0, 2800.0])
def test_flat_unstressed_start_reaches_the_exact_arc_in_one_step(pressure):
    """A single step from the flat state, whatever its size; error of P2 with 20 cells: measured 2e-6 of the deflection."""
    problem, p = membranes(cells=(20, 20), shift=3.0, contact=False)
    assert problem.lacks_stiffness
    (step,) = quasistatic.march(problem, p, to=pressure, increments=1)
    exact = Exact().apart(pressure)
    u = output.Probe(problem.u, [0.5, 0.0])()
    assert step.rejected == 0
    assert u[1] == pytest.approx(exact.midpoint_displacement[1], rel=1e-5)
    assert u[0] == pytest.approx(0.0, abs=1e-9)
    assert problem.comm.allreduce(np.abs(problem.residual.getNestSubVecs()[0].array_r).max(initial=0), MPI.MAX) < 1e-6


RADIUS, PUSHED_TO = 0.2, 0.4


def under_a_disc(gap):
    """A flat membrane with a rigid disc `gap` above it, and another one that nothing meets: (problem, disc)."""
    domain, cells, edges = TwoMembranes(cells=(20, 20), shift=3.0).create()
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    bc = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 0, edges.find(EDGE)), V)
    sheet = Body(fem.Function(V), membrane.neo_hookean_membrane(E, NU, 1e-3), bcs=[bc])
    disc = obstacles.RigidSphere([0.5, RADIUS + gap], RADIUS)
    return ContactProblem(sheet, contacts=[Contact(Surface(domain, cells, LOWER, side=[0, 1]), disc)]), disc


def force_on_a_disc(depth):
    """Exact, by so much below the flat membrane: two straight legs at an angle φ, and an arc between them."""
    φ = brentq(lambda φ: (1 - np.cos(φ)) * RADIUS - depth + np.tan(φ) * (0.5 - RADIUS * np.sin(φ)), 1e-6, 1.5)
    stretch = 2 * (0.5 - RADIUS * np.sin(φ)) / np.cos(φ) + 2 * RADIUS * φ
    sheet = membrane.neo_hookean_membrane(E, NU, 1e-3)
    x = float(thickness_stretch_squared(stretch, sheet.G, sheet.lame))
    return 2 * np.sin(φ) * sheet.thickness * sheet.G * (stretch - x / stretch)


@pytest.mark.parametrize("gap", [0.04, 0.07, 0.1, 0.12])
def test_a_flat_membrane_that_is_met_in_a_later_step(shared_path, gap):
    """In steps of 0.05 m, of which up to two meet nothing or all but touch, each gone on with from a checkpoint: nothing is
    rejected, and the force is the exact one to 2e-3 (20 cells, two of which the edges of contact cut)."""
    path = None
    while path != 1.0:
        problem, disc = under_a_disc(gap)

        def press(depth, disc=disc):
            disc.move([0, -depth])

        kept = Checkpoint(shared_path, problem)
        saved = kept.load()
        assert problem.lacks_stiffness
        assert problem.slack.all() == (saved is None or PUSHED_TO * saved.at <= gap)
        stages = [quasistatic.Stage(press, PUSHED_TO, 8)]
        step = next(quasistatic.march(problem, stages, start=None if saved is None else saved.at))
        assert step.rejected == 0
        path = step.path
        kept.save(path)
    assert -problem.pairs[0].force()[1] == pytest.approx(force_on_a_disc(PUSHED_TO - gap), rel=2e-3)


def midpoint_error(problem, state):
    u = output.Probe(problem.u, [0.5, 0.0], problem.lower)()
    exact = np.array(state.midpoint_displacement)
    return np.linalg.norm(u - exact) / np.linalg.norm(exact)


@pytest.mark.one_rank
@pytest.mark.parametrize("pressure, cells", [(3500.0, 200), (4023.0, 160)])
def test_without_friction_the_exact_solution_is_met(pressure, cells):
    """P2: below 1e-5 of the midpoint's displacement, and of the length of a membrane; facet means of the traction in the
    zone (six facets from its edges) are p l to 1e-4 where the zone is long enough to have such facets."""
    problem, p = membranes(cells=(cells, cells))
    for _ in quasistatic.march(problem, p, to=pressure, increments=10):
        pass
    exact = Exact().state(pressure)
    assert midpoint_error(problem, exact) < 1e-5
    length = fem.assemble_scalar(fem.form(membrane.area_stretch(problem.u) * ufl.dx(problem.u.function_space.mesh)))
    assert problem.comm.allreduce(length) / 2 == pytest.approx(exact.stretch_max, rel=1e-5)
    profile = problem.pairs[0].fields_on_root()
    if profile is not None and pressure > 4000:
        weights = np.polynomial.legendre.leggauss(7)[1] / 2
        means = profile.pressure.reshape(-1, 7) @ weights
        zone = np.flatnonzero(means > 0.9 * exact.multiplier[1])
        inner = means[zone[6:-6]]
        assert len(inner) > 4
        assert np.allclose(inner, exact.multiplier[1], rtol=1e-4)


@pytest.mark.one_rank
def test_any_steps_give_the_same_frictionless_answer():
    """Steps of 400 and of 50 Pa: differences of round-off size (both solve the same equations to 1e-9)."""
    found = []
    for increments in (10, 80):
        problem, p = membranes(cells=(40, 40))
        for _ in quasistatic.march(problem, p, to=4023.0, increments=increments):
            pass
        found.append(output.Probe(problem.u, [0.5, 0.0], problem.lower)())
    assert np.allclose(found[0], found[1], atol=1e-7)


@pytest.mark.one_rank
def test_with_friction_the_slipping_branch_is_met():
    """μ = 0.5 at 3500 and 4023 Pa, P2 with 80 cells: 1e-4 of the midpoint's displacement (measured: 3e-5)."""
    problem, p = membranes(cells=(80, 80), friction=0.5)
    assert list(quasistatic.march(problem, p, to=4023.0, increments=20))[-1].load == 4023.0
    assert midpoint_error(problem, Exact(friction=0.5).state(4023.0)) < 1e-4
    assert problem.pairs[0].stick_fraction() == 0.0


def test_states_before_the_first_touch_predict_nothing_after_it():
    """Shift 0.5 m, μ = 0.5: free membranes touch at 2168 Pa. Extrapolated from before, the next increment took 20 iterations
    and a rejected trial on one rank and 32 iterations on two."""
    problem, p = membranes(cells=(40, 40), friction=0.5, shift=0.5)
    steps = list(quasistatic.march(problem, p, to=2710.0, increments=10))
    assert problem.pairs[0].closed_fraction() > 0.0
    assert sum(step.rejected for step in steps) == 0
    assert max(step.iterations for step in steps[1:]) <= 10


def test_a_flat_start_predicts_nothing():
    """Displacements grow as a root of the pressure from there: twice those of the first step carry the membranes through each
    other, from where the second took 32 iterations with a rejected trial; it takes three."""
    problem, p = membranes(order=2, shift=0.1, height=0.3, cells=(24, 20), friction=0.2)
    first, second = quasistatic.march(problem, p, to=120.0, increments=2)
    assert (first.load, first.rejected, second.rejected) == (60.0, 0, 0) and second.iterations <= 5


@pytest.mark.parametrize("order", [1, 2])
def test_a_membrane_that_folds_over_in_a_step_is_no_equilibrium(order):
    """The node in the middle is carried past its right neighbour: facets point backwards, and the step is rejected. One that
    turns as a whole does not."""
    problem, _ = membranes(order=order, shift=0.1, height=0.3, cells=(12, 10))
    problem.commit()

    def folds(motion):
        set_field(problem, motion, clamped=False)
        problem.evaluate()
        return [f for f in problem.findings() if "folded" in f.name]

    def past(X):
        u = np.zeros((len(X), 2))
        u[:, 0] = np.where((X[:, 1] < 0.1) & (np.abs(X[:, 0] - 0.5) < 1e-6), 1.2 / 12, 0.0)
        return u

    turn = np.array([[np.cos(3.0), -np.sin(3.0)], [np.sin(3.0), np.cos(3.0)]])
    assert not folds(lambda X: X @ turn.T - X)
    (found,) = folds(past)
    assert found.fatal and found.value >= 2.0


@pytest.mark.parametrize("μ, limit", [(0.0, 4380.47), pytest.param(0.5, 4670.9, marks=pytest.mark.one_rank)])
def test_the_march_ends_where_the_membranes_lock(μ, limit):
    """40 cells meet the limit within a facet of the edge: 0.8 % without friction, 0.5 % with."""
    problem, p = membranes(cells=(40, 40), friction=μ)
    *_, step = quasistatic.march(problem, p, to=5420.0, increments=20, until=problem.pairs[0].reaches_end)
    assert step.load < 5420.0
    assert step.load == pytest.approx(limit, rel=8e-3 if μ == 0 else 5e-3)


def test_swapped_roles_agree_within_the_discretisation_error():
    found = []
    for swap in (False, True):
        problem, p = membranes(cells=(40, 50), swap=swap)
        for _ in quasistatic.march(problem, p, to=4023.0, increments=20):
            pass
        found.append(midpoint_error(problem, Exact().state(4023.0)))
    assert max(found) < 5e-4


def test_a_balloon_is_followed_past_its_limit_point():
    """Spherical balloon, coarse octant of order 2: pressure on both sides of the limit within 1e-3 of the exact curve."""
    problem, p = octant()
    balloon = Balloon()
    l_limit, p_limit = balloon.limit()
    loads_, stretches = [], []
    for step in quasistatic.follow(problem, p, first=200.0, length=0.1, steps=9):
        loads_.append(step.load)
        stretches.append(1 + output.Probe(problem.u, [0.0, 0.0, 1.0])()[2])
    late = np.array(stretches) > 1.2
    assert np.allclose(np.array(loads_)[late], balloon.pressure(np.array(stretches)[late]), rtol=1e-3)
    assert stretches[-1] > l_limit and loads_[-1] < max(loads_)
    assert max(loads_) == pytest.approx(p_limit, rel=2e-3)  # the path's points do not fall on the summit


def test_path_arguments():
    problem, p = membranes(cells=(4, 4), contact=False)
    with pytest.raises(ValueError, match="length = 0"):
        next(quasistatic.follow(problem, p, first=1.0, length=0.0, steps=3))


def pushed_round_a_drum(cell, order, μ, cells=(6, 3)):
    """A sheet of 2 m × 1 m on a drum of 20 m, which it presses with 300 Pa; an edge is pushed by 8 % of its length."""
    R, (n, m), length = 20.0, cells, 2.0
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, length, n + 1), np.linspace(0, 1, m + 1), indexing="ij"))
    X = np.column_stack([x, y, np.sqrt(R**2 - (x - 1) ** 2) - R])
    first = (np.arange(n)[:, None] * (m + 1) + np.arange(m)).ravel()
    corners = first[:, None] + [0, m + 1, 1, m + 2]
    if cell == "triangle":
        corners = corners[:, [[0, 1, 3], [0, 2, 3]]].reshape(-1, 3)
    root = int(MPI.COMM_WORLD.rank == 0)
    element = basix.ufl.element("Lagrange", cell, 1, shape=(3,))
    domain = mesh.create_mesh(MPI.COMM_WORLD, cells=corners[: root * len(corners)], x=X[: root * len(X)], e=element)
    domain.topology.create_connectivity(1, 2)
    V = fem.functionspace(domain, ("Lagrange", order, (3,)))
    u, weight, push = fem.Function(V), fem.Constant(domain, np.zeros(3)), fem.Constant(domain, np.zeros(3))
    edge = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], length))
    held = fem.dirichletbc(push, fem.locate_dofs_topological(V, 1, edge), V)
    sheet = membrane.neo_hookean_membrane(E=1e6, nu=0.3, thickness=1e-2)
    body = Body(u, sheet, external=(weight, ufl.Measure("dx", domain)), bcs=[held])
    cells = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    tags = mesh.meshtags(domain, 2, cells, np.ones_like(cells))
    drum = obstacles.RigidCylinder([1, 0, -R], [0, 1, 0], R)
    problem = ContactProblem(body, contacts=[Contact(Surface(domain, tags, 1, side=[0, 0, -1]), drum, friction=μ)])
    pressed = list(quasistatic.march(problem, weight, to=(0, 0, -300.0), increments=1))

    def along(t):
        x = length - 0.16 * t
        push.value = [x - length, 0, np.sqrt(R**2 - (x - 1) ** 2) - np.sqrt(R**2 - (length - 1) ** 2)]

    steps = pressed + list(quasistatic.march(problem, along, to=1.0, increments=2))
    x = V.tabulate_dof_coordinates() + u.x.array.reshape(-1, 3)
    return steps, np.hypot(x[:, 0] - 1, x[:, 2] + R) - R, problem.pairs[0].force()


@pytest.mark.parametrize("cell, cells", [("quadrilateral", (6, 3)), ("triangle", (6, 3)), ("quadrilateral", (16, 1))])
def test_a_sheet_in_compression_stays_on_what_it_lies_on(cell, cells):
    """Between the multipliers' nodes nothing held it: it rippled within its facets, 3 cm off the drum, in 29 iterations a
    step, some rejected. Slender facets ended 9 cm off, the force 39.6 N, while contact had too few solves to settle
    in. What is left are gaps of p/ε."""
    steps, off, force = pushed_round_a_drum(cell, 2, 0.3, cells)
    assert sum(step.rejected for step in steps) == 0 and max(step.iterations for step in steps) <= 12
    assert np.abs(off).max(initial=0.0) < 1e-4
    assert force[0] == pytest.approx(172.94, rel=2e-3)  # on meshes of 6 × 3 to 24 × 12 cells
    assert not any(finding for step in steps for finding in step.findings)


@pytest.mark.parametrize("strain, said", [(-1e-12, False), (-1e-6, True)])
def test_round_off_is_no_compression(strain, said):
    """A sheet that lies flat without tension has some of either sign."""
    problem, _ = membranes(cells=(4, 4), contact=False)
    u, sheet = problem.u, membrane.neo_hookean_membrane(E=2e6, nu=0.3, thickness=1e-3)
    set_field(problem, lambda X: strain * X)
    assert (monitors.wrinkling(sheet, u).look() is not None) == said


def test_compression_is_reported():
    """A membrane pushed together by a tenth: the finding says how much and where, and the step is there all the same."""
    domain, _, edges = TwoMembranes(cells=(8, 8)).create()
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, push = fem.Function(V), fem.Function(V)
    sheet = membrane.neo_hookean_membrane(E, NU, 1e-3)
    bcs = [fem.dirichletbc(push, fem.locate_dofs_topological(V, 0, edges.find(EDGE)))]
    y = fem.locate_dofs_geometrical((V.sub(1), V.sub(1).collapse()[0]), lambda x: x[0] > -1)
    bcs.append(fem.dirichletbc(fem.Function(V.sub(1).collapse()[0]), y, V.sub(1)))  # held straight
    problem = ContactProblem(sheet.virtual_work(u), u, bcs=bcs, monitors=[monitors.wrinkling(sheet, u)])

    def set_push(t):
        push.interpolate(lambda x: np.stack([-0.1 * t * (x[0] - 1.0), 0 * x[0]]))

    march = quasistatic.march(problem, set_push, to=1.0, increments=2)
    if problem.comm.rank == 0:
        with pytest.warns(monitors.ModelWarning, match=r"tension \(N/m\) = -.*would wrinkle"):
            steps = list(march)
    else:
        steps = list(march)
    assert len(steps) == 2
    assert steps[1].findings[0].value < steps[0].findings[0].value < 0


CASES = [(dim, order, μ) for dim in (2, 3) for order in (1, 2) for μ in (0.0, 0.8)]


@pytest.mark.parametrize("dim, order, friction", CASES)
def test_tangent_of_membranes_in_contact(dim, order, friction):
    """Every block of the Jacobian (membrane, pressure, contact) against central differences: below 1e-6."""
    shape = {"cells": (9, 7), "through": 4, "shift": 0.1, "height": 0.05, "dim": dim}
    problem, p = membranes(order=order, friction=friction, epsilon_normal=1e5, epsilon_tangential=3e5, **shape)
    pair = problem.pairs[0]
    p.value = 100.0
    upper = problem.u.function_space.tabulate_dof_coordinates()[:, 1] > 0.02

    def bend(X):
        u = np.zeros_like(X)
        u[:, 1] = 0.2 * X[:, 0] ** 2 - 0.05 * upper
        return u

    set_field(problem, lambda X: bend(X) + 0.95 * rough(3e-3, 2)(X))
    pair.evaluate()
    pair.commit()
    pair.holds_points = True  # as in a Newton step
    direction = [rough(1.0, 4), rough(1e5, 5)]

    def at(h):
        set_field(
            problem,
            lambda X: bend(X) + rough(3e-3, 2)(X) + h * direction[0](X),
            lambda X: 3e2 * (rough(1, 3)(X) + np.array([0.1, 1.0, 0.1])[:dim]) + h * direction[1](X),
        )
        problem.pack(problem.x)
        problem.assemble_residual(problem.x, problem.residual)
        return [part.array.copy() for part in problem.residual.getNestSubVecs()]

    at(0.0)
    pair.active.closed = pair.at.facing & (pair.state.λN_hat > 0)
    at(0.0)
    counts = np.bincount(np.concatenate(problem.comm.allgather(pair.state.status)), minlength=3)
    assert counts[SLIP] + counts[STICK] > 0
    if order == 2:
        assert counts[SLIP] > 0 and (counts[OPEN] > 0 if friction == 0 else counts[STICK] > 0)
    assert_tangent(problem, at, lambda: set_field(problem, direction[0], direction[1]))


def membrane_on_block(comm=MPI.COMM_WORLD, swap=False):
    """A membrane from (0, 0.02) to (1, 0.02), blown down on a soft block below it: two meshes, two displacements."""
    sheet_mesh, cells, edges = TwoMembranes(length=1.0, shift=0.0, height=0.02, cells=(5, 12)).create(comm)
    block = mesh.create_rectangle(comm, [[0.2, -0.3], [0.8, 0.0]], [7, 4])
    sheet_mesh.topology.create_connectivity(1, 1)
    top = mesh.locate_entities_boundary(block, 1, lambda x: np.isclose(x[1], 0.0))
    tags = mesh.meshtags(block, 1, np.sort(top), np.full(len(top), 5, dtype=np.int32))
    V, W = (fem.functionspace(m, ("Lagrange", 2, (2,))) for m in (sheet_mesh, block))
    u, w, p = fem.Function(V), fem.Function(W), fem.Constant(sheet_mesh, 0.0)
    dx = ufl.Measure("dx", sheet_mesh, subdomain_data=cells)
    sheet = membrane.neo_hookean_membrane(E, NU, 1e-3)
    F = [
        sheet.virtual_work(u, dx=dx) - loads.membrane_pressure(u, p, [0.0, -1.0], dx(UPPER)),
        materials.neo_hookean(1e5, 0.3).virtual_work(w),
    ]
    bcs = [fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 0, edges.find(EDGE)), V)]
    bcs.append(fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, cells.find(LOWER)), V))  # the other one
    bcs.append(fem.dirichletbc(np.zeros(2), fem.locate_dofs_geometrical(W, lambda x: np.isclose(x[1], -0.3)), W))
    sides = [Surface(sheet_mesh, cells, UPPER, side=[0.0, -1.0]), Surface(block, tags, 5)]
    contactor, target = reversed(sides) if swap else sides
    return ContactProblem(F, [u, w], bcs=bcs, contacts=[Contact(contactor, target, friction=0.2)]), p


@pytest.mark.parametrize("swap", [False, True])
def test_a_membrane_and_a_body_on_meshes_of_their_own(swap):
    """The block carries what the membrane does not: the contact force is down on the block, and all ranks agree with
    one rank to 1e-8."""
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        problem, p = membrane_on_block(comm, swap)
        *_, step = quasistatic.march(problem, p, to=500.0, increments=4)
        assert step.load == 500.0
        force = problem.pairs[0].force()
        found.append([*force, problem.pairs[0].closed_fraction(), *output.Probe(problem.u[1], [0.5, -0.1])()])
    down = -1 if swap else 1
    assert 30.0 < down * found[0][1] < 500.0
    assert abs(found[0][0]) < 1e-2 * abs(found[0][1])  # symmetric but for the meshes
    assert np.allclose(found[0], found[1], rtol=1e-8, atol=1e-10)


@pytest.mark.several_ranks
@pytest.mark.parametrize("dim, friction", [(2, 0.0), (2, 0.5), (3, 0.3)])
def test_ranks_agree_with_one_rank(dim, friction):
    shape = {"cells": (24, 20)} if dim == 2 else {"cells": (5, 4), "through": 3, "dim": 3, "shift": 0.3}
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        problem, p = membranes(comm, friction=friction, order=2, **shape)
        for _ in quasistatic.march(problem, p, to=3300.0 if dim == 2 else 2700.0, increments=6):
            pass
        middle = [0.5, 0.0] + [0.5] * (dim - 2)
        found.append([*output.Probe(problem.u, middle, problem.lower)(), problem.pairs[0].closed_fraction()])
    assert found[0][-1] > 0
    assert np.allclose(found[0], found[1], rtol=1e-8, atol=1e-10)


def test_sides_must_be_named_and_not_lie_in_the_membrane():
    domain, cells, _edges = TwoMembranes(cells=(4, 4)).create()
    with pytest.raises(ValueError, match="name the side of the membrane"):
        Surface(domain, cells, LOWER).owned_facets()
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    from dolfinx_mortar_al.surface import Facets

    with pytest.raises(ValueError, match="lies in the plane"):
        Facets.of(Surface(domain, cells, LOWER, side=[1.0, 0.0]), V)
    with pytest.raises(ValueError, match="needs 2 components"):
        Facets.of(Surface(domain, cells, LOWER, side=[1.0, 0.0, 0.0]), V)


def blown_up(nodes, cells, order, pressure, turn=0.0):
    """Steps to a pressure (Pa) of a membrane of straight cells between nodes (n, 2), the first and the last of them held,
    turned by an angle (rad), and whether it was slack at the start."""
    Q = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    element = basix.ufl.element("Lagrange", "interval", 1, shape=(2,))
    domain = mesh.create_mesh(MPI.COMM_WORLD, cells=np.asarray(cells, dtype=np.int64), x=nodes @ Q.T, e=element)
    u, P = fem.Function(fem.functionspace(domain, ("Lagrange", order, (2,)))), fem.Constant(domain, 0.0)
    V, ends = u.function_space, nodes[[0, -1]] @ Q.T
    held = fem.locate_dofs_geometrical(
        V, lambda X: np.any([np.hypot(*(X[:2] - x[:, None])) < 1e-9 for x in ends], axis=0)
    )
    blows = loads.membrane_pressure(u, P, Q @ np.array([0.3, 1.0]), ufl.dx)
    rubber = membrane.neo_hookean_membrane(E, NU, 1e-3)
    sheet = Body(u, rubber, external=blows, bcs=[fem.dirichletbc(np.zeros(2), held, V)])
    tags = mesh.meshtags(domain, 1, np.arange(len(cells), dtype=np.int32), np.ones(len(cells), dtype=np.int32))
    far = obstacles.RigidPlane(Q @ np.array([0.0, 9.0]), -Q @ np.array([0.0, 1.0]))
    contact = Contact(Surface(domain, tags, 1, side=Q @ np.array([0.3, 1.0])), far)
    problem = ContactProblem(sheet, contacts=[contact])
    slack = bool(problem.slack.all())
    return list(quasistatic.march(problem, P, to=pressure, increments=1)), slack


@pytest.mark.one_rank
@pytest.mark.parametrize("turn", [0.0, 0.5, np.pi / 4])
@pytest.mark.parametrize("order", [1, 2])
def test_a_flat_membrane_is_slack_however_it_lies(order, turn):
    """What no displacement along an axis shows, one across the membrane does: first steps under a block failed at 45°,
    and at other angles took up to 203 iterations with 5 rejected trials."""
    x = np.linspace(0.0, 1.0, 13)
    (step,), slack = blown_up(
        np.column_stack([x, 0 * x]), np.column_stack([np.arange(12), np.arange(1, 13)]), order, 100.0, turn
    )
    assert slack and not step.rejected and step.iterations <= 10


@pytest.mark.one_rank
def test_an_arc_of_chords_of_order_two_is_slack():
    """The nodes in the middle of straight cells meet no stiffness across them: rings took 77 to 88 iterations."""
    φ = np.linspace(np.pi, 0.0, 13)
    nodes = 0.5 * np.column_stack([np.cos(φ), np.sin(φ)])
    (step,), slack = blown_up(nodes, np.column_stack([np.arange(12), np.arange(1, 13)]), 2, 400.0)
    assert slack and not step.rejected and step.iterations <= 10


def wrapped_round_a_disc(n, μ, pull):
    """A curve of order 2 with n cells, held at one end, lies exactly on a quarter of a rigid disc of 1 m, .5 m of it straight
    on either side, and is pulled at the other end by T (N/m). Returns the step, angles, and p over T exp(−μφ)/R there."""
    x = np.linspace(-0.5, np.pi / 2 + 0.5, 2 * n + 1)
    φ, root = np.clip(x, 0.0, np.pi / 2), int(MPI.COMM_WORLD.rank == 0)
    X = np.column_stack([np.sin(φ), np.cos(φ)])
    X += np.minimum(x, 0.0)[:, None] * [1, 0] + np.maximum(x - np.pi / 2, 0.0)[:, None] * [0, -1]
    cells = 2 * np.arange(n)[:, None] + [0, 2, 1]
    element = basix.ufl.element("Lagrange", "interval", 2, shape=(2,))
    domain = mesh.create_mesh(MPI.COMM_WORLD, cells=cells[: root * n], x=X[: root * len(X)], e=element)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, T, w = fem.Function(V), fem.Constant(domain, 0.0), ufl.TestFunction(V)
    ends = [mesh.locate_entities_boundary(domain, 0, lambda x, k=k: np.isclose(x[k], -0.5)) for k in (0, 1)]
    tags = mesh.meshtags(domain, 0, np.sort(ends[1]), np.full(len(ends[1]), 1, dtype=np.int32))
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    held = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 0, ends[0]), V)
    sheet = membrane.neo_hookean_membrane(E=1e6, nu=0.3, thickness=1e-2)
    body = Body(u, sheet, external=-T * w[1] * ds(1), bcs=[held])
    own = np.arange(domain.topology.index_map(1).size_local, dtype=np.int32)
    curve = Surface(domain, mesh.meshtags(domain, 1, own, np.ones_like(own)), 1, side=[-1, -1])
    problem = ContactProblem(body, contacts=[Contact(curve, obstacles.RigidSphere([0, 0], 1.0), friction=μ)])
    (step,) = quasistatic.march(problem, T, to=pull, increments=1)
    fields = problem.pairs[0].fields_on_root()
    if fields is None:
        return step, np.zeros(0), np.zeros(0)
    φ = np.arctan2(fields.x[:, 0], fields.x[:, 1])
    inside = (φ > 0.15) & (φ < np.pi / 2 - 0.15)
    return step, φ[inside], (fields.pressure / (pull * np.exp(-μ * (np.pi / 2 - φ))))[inside]


@pytest.mark.parametrize("wild", [False, True])
def test_a_sheet_in_tension_presses_evenly(monkeypatch, wild):
    """What keeps compressed sheets flat lets pressures waver by a half where nothing is to be kept flat, in 11 iterations.
    Compressions up to what ε holds by itself do not count, and what an iterate alone asked for is taken back. The exact
    pressure per reference area is larger than T/R by the stretch."""
    if wild:
        firmness, calls = ContactPair._firmness_of_sheets, []

        def once(pair):
            calls.append(firmness(pair))
            return np.inf if len(calls) == 2 else calls[-1]

        monkeypatch.setattr(ContactPair, "_firmness_of_sheets", once)
    step, _, ratio = wrapped_round_a_disc(40, 0.3, 20.0)
    assert step.rejected == 0 and step.iterations <= (14 if wild else 8)
    assert np.abs(ratio - 1.0).max(initial=0.0) < 1e-2
