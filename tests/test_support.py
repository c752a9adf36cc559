"""What holds a body: contact alone, nothing, an unstable equilibrium; and findings and failures that say so."""

from contextlib import nullcontext

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import FailingSolver, beams, blocks, contact_of, octant

from dolfinx_mortar_al import (
    Body,
    Contact,
    ContactProblem,
    NewtonSolver,
    Surface,
    dynamics,
    materials,
    obstacles,
    output,
    quasistatic,
)
from dolfinx_mortar_al.newton import NewtonResult
from exact.balloon import Balloon
from meshes.two_beams import UPPER, TwoBeams

LOAD = 1e4  # N/m³, dead


def loose_block(*, gap=0.0, friction=0.3, tilt=0.0, E=1e5, at=(0.0, 0.0), comm=MPI.COMM_WORLD, varies=False):
    """A block without any condition, above a slab held at its bottom, under a dead load along (tilt, −1); `at`: where;
    `varies`: μ is a Constant."""
    domain, cells, tags = TwoBeams(length=1.0, height=0.5, along=(7, 5), across=3, gap=gap).create(comm)
    domain.geometry.x[:, :2] += at
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, load = fem.Function(V), fem.Constant(domain, 0.0)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], at[1] - 0.5))
    held = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, bottom), V)
    dx = ufl.Measure("dx", domain, subdomain_data=cells)
    F = materials.neo_hookean(E, 0.3).virtual_work(u, dx=dx)
    F -= load * ufl.dot(ufl.as_vector([tilt, -1.0]), ufl.TestFunction(V)) * dx(UPPER)
    μ = fem.Constant(domain, friction) if varies else friction
    return ContactProblem(F, u, bcs=[held], contacts=[contact_of(domain, tags, friction=μ)]), load


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("gap", [0.0, 0.01, 0.7])
def test_a_block_that_nothing_holds_falls_on_its_slab(gap, friction):
    """Contact carries the load to the last digit, whatever the gap; it does not move sideways. 0.7 m are five facets."""
    problem, load = loose_block(gap=gap, friction=friction)
    (step,) = quasistatic.march(problem, load, to=LOAD, increments=1)
    assert len(problem.floating) == 1 and "around X = [0.5" in str(problem.floating[0])
    assert step.rejected == 0 and step.iterations <= 15
    assert problem.pairs[0].force() == pytest.approx([0.0, 0.5 * LOAD], abs=1e-6 * LOAD)
    assert problem.pairs[0].closed_fraction() == 1.0


def test_friction_holds_a_pushed_block_and_none_does_not():
    """tan = 0.2 < μ = 0.3 sticks; without friction there is no equilibrium, and the error says which body it is."""
    problem, load = loose_block(tilt=0.2)
    assert [s.rejected for s in quasistatic.march(problem, load, to=LOAD, increments=1)] == [0]
    assert problem.pairs[0].force() == pytest.approx([-0.1 * LOAD, 0.5 * LOAD], rel=1e-6)
    problem, load = loose_block(tilt=0.2, friction=0.0)
    with pytest.raises(quasistatic.StepFailure, match=r"contact alone holds the body around X = \[0.5.*of one node"):
        list(quasistatic.march(problem, load, to=LOAD, increments=1, smallest=0.5))


def test_a_block_about_to_slide_is_said():
    """Pushed with a fifth of its weight it needs μ = .2, which the march takes away; just before all friction is in use."""
    problem, load = loose_block(tilt=0.2, varies=True)
    (pair,) = problem.pairs
    list(quasistatic.march(problem, load, to=LOAD, increments=1))
    assert 0.2 / 0.3 - 1e-6 < pair.friction_in_use() < 0.9  # points rub to and fro, too
    with pytest.raises(quasistatic.StepFailure, match=r"contact: (9.\.|100).*% of the friction .* is in use"):
        list(quasistatic.march(problem, pair.contact.friction, to=0.1, increments=4, smallest=1 / 8))
    assert 0.9 < pair.friction_in_use() <= 1.0 + 1e-6


def test_a_block_that_is_let_go_is_said():
    """Held by friction between two plates; as one lifts off the march goes on, and says once that nothing holds the block,
    which is left lying on the other or, as nothing decides, between both."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [[0, 0], [0.2, 0.1]], [6, 3])
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    plates = [obstacles.RigidPlane([0, 0], [0, 1]), obstacles.RigidPlane([0, 0.1], [0, -1])]
    sides = [mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, 0.1)]
    facets = np.sort(np.concatenate(sides))
    tags = mesh.meshtags(domain, 1, facets, np.isin(facets, sides[1]).astype(np.int32))
    contacts = [Contact(Surface(domain, tags, k), plate, friction=0.3, name=f"{k}") for k, plate in enumerate(plates)]
    problem = ContactProblem(Body(u, materials.neo_hookean(1e6, 0.3)), contacts=contacts)
    said = []
    for _ in quasistatic.march(problem, lambda t: plates[1].move([0.0, -0.001 * t]), to=2.0, increments=2, start=0.0):
        assert problem.pairs[1].closed_fraction() == 1.0
    for step in quasistatic.march(problem, lambda t: plates[1].move([0.0, 0.01 * t]), to=2.0, increments=2, start=0.0):
        said += [str(finding) for finding in step.findings]
    assert len(said) == 1
    between, lying = "contacts of the body around X = [0.1", "contact forces on the body around X = [0.1"
    if problem.pairs[0].closed_fraction() == 0.0:
        assert said[0].startswith(between)
    else:
        assert said[0].startswith(lying) and np.abs(problem.pairs[0].force()).max() < 1e-9


FREE = "supports do not keep it in place and no load presses it on"


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("gap", [0.0, 0.01])
def test_a_block_without_a_load_is_said_to_be_free(gap, friction):
    """It lies on a plate that moves, or near it, and may be carried along or not, by round-off of contact: the first step
    says so, and no other; where it is never touched the last one says that."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [[0, gap], [0.2, gap + 0.1]], [6, 3])
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    bottom = np.sort(mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], gap)))
    tags = mesh.meshtags(domain, 1, bottom, np.ones(len(bottom), dtype=np.int32))
    plate = obstacles.RigidPlane([0, 0], [0, 1])
    contact = Contact(Surface(domain, tags, 1), plate, friction=friction)
    problem = ContactProblem(Body(u, materials.neo_hookean(1e6, 0.3)), contacts=[contact])
    steps = list(quasistatic.march(problem, lambda t: plate.move([0.01 * t, 0.0]), to=1.0, increments=3, start=0.0))
    said = [[str(finding) for finding in step.findings] for step in steps]
    assert [len(one) for one in said] == [1, 0, 1 if gap else 0]
    assert not gap or said[2][0].startswith("contact: least gap (m) = 0.01 at")
    assert said[0][0].startswith("contact forces on the body around X = [0.1") and FREE in said[0][0]


def test_a_body_without_contacts_is_said_to_be_free():
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 3, 3)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    (found,) = ContactProblem(Body(u, materials.neo_hookean(1e5, 0.3))).findings()
    assert FREE in found.meaning


def test_a_block_is_free_once_its_load_is_taken_away():
    """Not under a thousandth of the load, nor under a millionth."""
    problem, load = loose_block()
    for share in (1.0, 1e-3, 1e-6):
        for step in quasistatic.march(problem, load, to=share * LOAD, increments=1):
            assert step.findings == ()
    (step,) = quasistatic.march(problem, load, to=0.0, increments=1)
    assert [FREE in str(finding) for finding in step.findings] == [True]


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("far", [0.7, 1e3])
@pytest.mark.parametrize("E", [1e5, 1e11])
def test_light_loads_are_borne_to_round_off(E, far, friction):
    """Down to a load that strains the block by 1e-14, wherever it lies: forces are right to the round-off of positions in the
    law, 4e-16 of the distance times ε over all facets, and said to be so where that is more than a thousandth."""
    problem, load = loose_block(E=E, at=(far, 1.3 * far), friction=friction)
    for share in (1.0, 1e-3, 1e-6):
        (step,) = quasistatic.march(problem, load, to=share * LOAD, increments=1)
        assert step.rejected == 0 and step.iterations <= 5
        weight, force = 0.5 * share * LOAD, problem.pairs[0].force()
        off = 4e-16 * np.hypot(1.0 + far, 1.3 * far + 0.5) * problem.pairs[0].epsilon.normal / weight
        assert np.linalg.norm(force - [0.0, weight]) <= max(1e-9, off) * weight
        said = [str(finding) for finding in step.findings]
        assert not said or off >= 1e-3
        assert len(said) == 1 or off <= 1e-2  # between them it hangs on the number of facets
        assert all(text.startswith(("round-off on the body", "contact forces on the body")) for text in said)


@pytest.mark.parametrize(
    "failures, shares",
    [
        ((3,), [(0.25, 0), (0.5, 0), (0.75, 1), (1.0, 0)]),
        ((3, 4), [(0.25, 0), (0.5, 0), (0.625, 2), (0.75, 0), (1.0, 0)]),
    ],
)
def test_a_loose_block_is_tried_from_its_last_state_before_an_increment_is_cut(failures, shares):
    """What failed leaves no trace: where the block alone is held by friction, once or twice, the forces at the end agree."""
    problem, load = loose_block(tilt=0.2)
    steps = quasistatic.march(problem, load, to=LOAD, increments=4, solver=FailingSolver(problem, failures))
    assert [(step.load / LOAD, step.rejected) for step in steps] == shares
    assert problem.pairs[0].force() == pytest.approx([-0.1 * LOAD, 0.5 * LOAD], rel=1e-6)


def test_inertia_of_a_form_of_ones_own_has_no_resultant_to_wait_for():
    """A free block above a plate it does not reach, with a step's inertia in its UFL form: it flies at its speed. The sum of
    its forces is round-off of forces that balance, which Newton waited for in vain as if nothing held the block."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [[0, 1], [0.7, 1.3]], [7, 3])
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    edges = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1.0))
    tags = mesh.meshtags(domain, 1, edges, np.ones(len(edges), dtype=np.int32))
    Δt, v = fem.Constant(domain, 1e-3), ufl.as_vector([0.37, -0.11])
    inertia = 1e3 / Δt**2 * ufl.inner(u - Δt * v, ufl.TestFunction(u.function_space)) * ufl.dx
    F = materials.neo_hookean(1e5, 0.3).virtual_work(u) + inertia
    contact = Contact(Surface(domain, tags, 1), obstacles.RigidPlane([0, 0], [0, 1]))
    problem = ContactProblem(F, u, contacts=[contact])
    result = NewtonSolver(problem).solve()
    assert not problem.floating
    assert result.converged and result.iterations <= 3
    assert u.x.array.reshape(-1, 2) == pytest.approx(np.tile([3.7e-4, -1.1e-4], (len(u.x.array) // 2, 1)), rel=1e-9)


def test_what_conditions_or_inertia_hold_does_not_float():
    problem, _ = beams()
    assert problem.floating == []
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 3, 3)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    motion = dynamics.Motion(u, materials.neo_hookean(1e5, 0.3), density=1.0, step=1e-3)
    assert ContactProblem(motion).floating == []
    assert len(ContactProblem(materials.neo_hookean(1e5, 0.3).virtual_work(u), u).floating) == 1


def squeezed_block(held):
    """A block of order 2 between straight plates 1e4 times as stiff, without friction, its cells not symmetric; a corner
    cannot move along the plates if `held`. Returns the problem and the upper plate's prescribed displacement."""
    bodies, faces = [], []
    for low, high, cells, young in (
        ((-0.5, 0.0), (0.5, 1.0), (5, 5), 1e6),
        ((-1.0, -0.2), (1.0, 0.0), (8, 1), 1e10),
        ((-1.0, 1.0), (1.0, 1.2), (8, 1), 1e10),
    ):
        domain = mesh.create_rectangle(MPI.COMM_WORLD, (low, high), cells, mesh.CellType.quadrilateral)
        X = domain.geometry.x
        X[:, 0] += 0.2 * (0.25 - X[:, 0] ** 2) * X[:, 1] * (young == 1e6)
        ends = [mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (low[1], high[1])]
        facets, order = np.concatenate(ends), np.argsort(np.concatenate(ends))
        tags = mesh.meshtags(domain, 1, facets[order], np.repeat(np.int32([1, 2]), [len(f) for f in ends])[order])
        V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
        bcs, given = [], fem.Constant(domain, np.zeros(2))
        if young > 1e6:
            outer = tags.find(1 if low[1] < 0 else 2)
            bcs = [fem.dirichletbc(given, fem.locate_dofs_topological(V, 1, outer), V)]
        elif held:
            Vx = V.sub(0).collapse()[0]
            corner = lambda x: np.isclose(x[0], -0.5) & np.isclose(x[1], 0.0)  # noqa: E731
            bcs = [fem.dirichletbc(fem.Function(Vx), fem.locate_dofs_geometrical((V.sub(0), Vx), corner), V.sub(0))]
        bodies.append(Body(fem.Function(V), materials.neo_hookean(young, 0.3), bcs=bcs))
        faces.append((domain, tags))
    block, lower, upper = faces
    contacts = [Contact(Surface(*block, 1), Surface(*lower, 2)), Contact(Surface(*block, 2), Surface(*upper, 1))]
    return ContactProblem(bodies, contacts=contacts), given


@pytest.mark.parametrize("held", [True, False])
def test_a_block_that_may_slide_between_plates(held):
    """Nothing resists the slide, and rays push the block along the plates by a discretisation error: a corner that is held,
    or the tie, bears less than 1e-6 of the squeeze. Held it takes 3 iterations a step, tied 6 in the first solve, in which
    every motion is tied, and 3 then."""
    problem, head = squeezed_block(held)
    steps = list(quasistatic.march(problem, head, to=(0.0, -0.1), increments=2))
    assert [step.rejected for step in steps] == [0, 0]
    assert all(step.iterations <= most for step, most in zip(steps, (4, 4) if held else (6, 3), strict=True))
    lower, upper = (pair.force() for pair in problem.pairs)
    assert lower[1] == pytest.approx(-upper[1], rel=1e-6)
    assert abs(lower[0] + upper[0]) < 1e-6 * lower[1]


@pytest.mark.parametrize("order", [1, 2])
def test_a_symmetry_plane_between_rigid_plates_with_friction(order):
    """u_x = 0 on one side of a block between plates: its stuck corner nodes leave nothing to enforce along the plates.
    The contact forces balance each other."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [[0, 0], [1, 1]], [6, 6], mesh.CellType.quadrilateral)
    V = fem.functionspace(domain, ("Lagrange", order, (2,)))
    u, W = fem.Function(V), V.sub(0).collapse()[0]
    facets, marks = [], []
    for tag, y in ((1, 0.0), (2, 1.0)):
        found = mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        facets, marks = [*facets, *found], [*marks, *[tag] * len(found)]
    tags = mesh.meshtags(
        domain, 1, np.sort(facets).astype(np.int32), np.array(marks, dtype=np.int32)[np.argsort(facets)]
    )
    left = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0.0))
    symmetry = fem.dirichletbc(fem.Function(W), fem.locate_dofs_topological((V.sub(0), W), 1, left), V.sub(0))
    lower, upper = obstacles.RigidPlane([0, 0], [0, 1]), obstacles.RigidPlane([0, 1], [0, -1])
    contacts = [Contact(Surface(domain, tags, k), plane, friction=0.3) for k, plane in ((1, lower), (2, upper))]
    problem = ContactProblem(materials.neo_hookean(1e5, 0.3).virtual_work(u), u, bcs=[symmetry], contacts=contacts)
    steps = list(quasistatic.march(problem, lambda t: upper.move([0.0, -t]), to=0.2, increments=5, start=0.0))
    assert sum(s.rejected for s in steps) == 0 and sum(s.iterations for s in steps) <= 30
    bottom, top = (pair.force() for pair in problem.pairs)
    assert bottom[1] > 2e4 and bottom[1] == pytest.approx(-top[1], rel=1e-8)


def test_the_unstable_branch_of_a_balloon_is_named():
    """Past its limit point the balloon's determinant is negative; before, no step says so."""
    problem, p = octant()
    limit = Balloon().limit()[0]
    unstable = {}
    with pytest.warns(UserWarning, match="this equilibrium is unstable") if problem.comm.rank == 0 else nullcontext():
        for step in quasistatic.follow(problem, p, first=200.0, length=0.1, steps=9):
            stretch = 1 + output.Probe(problem.u, [0.0, 0.0, 1.0])()[2]
            unstable[stretch] = any("unstable" in finding.meaning for finding in step.findings)
    below = [said for stretch, said in unstable.items() if stretch < limit - 0.1]
    beyond = [said for stretch, said in unstable.items() if stretch > limit + 0.1]
    assert not any(below) and len(beyond) > 0 and all(beyond)


def test_an_unstable_equilibrium_is_taken_where_no_shorter_step_ends_in_a_stable_one():
    """A straight column, clamped at both ends and shortened, is in equilibrium at any load, but unstable beyond a strain of
    4π²/12 (h/L)² (Euler: .033, shear apart): the step there is tried again, down to a quarter of the increment."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [[0, 0], [10, 1]], [10, 1], mesh.CellType.quadrilateral)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    moved, bcs = fem.Constant(domain, (0.0, 0.0)), []
    for x, value in ((0.0, fem.Constant(domain, (0.0, 0.0))), (10.0, moved)):
        end = mesh.locate_entities_boundary(domain, 1, lambda X, x=x: np.isclose(X[0], x))
        bcs.append(fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, end), V))
    u = fem.Function(V)
    problem = ContactProblem(materials.saint_venant_kirchhoff(1e5, 0.3).virtual_work(u), u, bcs=bcs)
    with pytest.warns(UserWarning, match="this equilibrium is unstable") if problem.comm.rank == 0 else nullcontext():
        steps = list(quasistatic.march(problem, moved, to=(-0.5, 0.0), increments=1))
    assert [step.load for step in steps] == [0.5, 0.75, 1.0]
    assert [step.rejected for step in steps] == [1, 1, 0]
    assert [bool(step.findings) for step in steps] == [False, True, True]


@pytest.mark.parametrize(("signs", "said"), [([1.0, -1.0, 1.0], True), ([-1.0, 1.0, -1.0], False), ([], False)])
def test_an_unstable_equilibrium_is_named_where_newton_came_nearest(signs, said):
    """Of three iterates the second has the least residual; what the determinant is at wild ones says nothing."""
    solver = NewtonSolver(octant()[0])
    solver.result = NewtonResult(norms=[(1e6, 1e5), (1e2, 1e3), (1e6, 1e6)], signs=signs)
    assert ("unstable equilibrium" in solver._advice()) == said


def test_points_too_few_for_a_fine_target_are_reported():
    """One point for three target facets is a finding of the step; by default there are two for each."""
    problem, p = blocks(order=1, cells=(16, 2), quadrature_degree=2)
    with pytest.warns(UserWarning, match="the target is finer") if problem.comm.rank == 0 else nullcontext():
        (step,) = quasistatic.march(problem, p, to=2e4, increments=1)
    assert len(step.findings) == 1 and step.findings[0].value < 1.0
    problem, p = blocks(order=1, cells=(16, 2))
    (step,) = quasistatic.march(problem, p, to=2e4, increments=1)
    assert step.findings == () and np.allclose(problem.pairs[0].state.p, 2e4, rtol=0.02)


def test_a_prediction_with_inverted_cells_is_dropped():
    """A block crushed by a plate in two uneven steps: extrapolation turns cells inside out, the march goes on. Crushed
    farther, by .85 of its height, it passes equilibria that are unstable, and goes through or not by chance."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u = fem.Function(V)
    bottom, top = (mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, 1.0))
    down = fem.Constant(domain, (0.0, 0.0))
    bcs = [
        fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, bottom), V),
        fem.dirichletbc(down, fem.locate_dofs_topological(V, 1, top), V),
    ]
    problem = ContactProblem(materials.neo_hookean(1e5, 0.3).virtual_work(u), u, bcs=bcs)
    dropped = []
    check = problem.inverted_volume
    problem.inverted_volume = lambda: dropped.append(check()) or dropped[-1]

    def crush(t):
        down.value[1] = -0.62 * t**0.25  # steep at first: a line through the first two states goes beyond the bottom

    last = list(quasistatic.march(problem, crush, to=1.0, increments=2, start=0.0))[-1]
    assert last.load == 1.0 and max(dropped) > 0 and check() == 0
