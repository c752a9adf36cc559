"""Rigid obstacles as targets of quasi-static contact."""

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import NU, E, assert_tangent

from dolfinx_mortar_al import Contact, ContactProblem, Surface, materials, obstacles, quasistatic
from meshes.boxes import Box, create_boxes

TOP = 7


def block(
    obstacle,
    comm=MPI.COMM_WORLD,
    *,
    dim=2,
    cells=8,
    size=1.0,
    height=0.5,
    friction=0.0,
    order=2,
    confined=False,
    **options,
):
    """A block y ∈ [−height, 0] held at its bottom (and, `confined`, at its sides by rollers), under an obstacle."""
    low, high = [-size / 2, -height, -size / 2][:dim], [size / 2, 0.0, size / 2][:dim]
    grid = [cells, cells // 2, cells][:dim]
    domain = (mesh.create_rectangle if dim == 2 else mesh.create_box)(comm, [low, high], grid)
    d = domain.topology.dim
    top = mesh.locate_entities_boundary(domain, d - 1, lambda x: np.isclose(x[1], 0.0))
    tags = mesh.meshtags(domain, d - 1, np.sort(top), np.full(len(top), TOP, dtype=np.int32))
    V = fem.functionspace(domain, ("Lagrange", order, (dim,)))
    u = fem.Function(V)
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -height))
    bcs = [fem.dirichletbc(np.zeros(dim), bottom, V)]
    for axis in [a for a in range(dim) if a != 1 and confined]:
        W = V.sub(axis).collapse()[0]
        side = fem.locate_dofs_geometrical((V.sub(axis), W), lambda x, a=axis: np.isclose(np.abs(x[a]), size / 2))
        bcs.append(fem.dirichletbc(fem.Function(W), side, V.sub(axis)))
    F = materials.saint_venant_kirchhoff(E, NU).virtual_work(u)
    contact = Contact(Surface(domain, tags, TOP), obstacle, friction=friction, **options)
    return ContactProblem(F, u, bcs=bcs, contacts=[contact])


@pytest.mark.parametrize("dim", [2, 3])
def test_a_plane_that_compresses_a_confined_block(dim):
    """Uniaxial strain, exact: P = l (Λ + 2G)(l² − 1)/2 with l = 1 − 0.2, to Newton's tolerance."""
    normal = -np.eye(dim)[1]
    plane = obstacles.RigidPlane(np.zeros(dim), normal)
    problem = block(plane, dim=dim, cells=4, confined=True)
    for _ in quasistatic.march(problem, lambda t: plane.move(0.1 * t * normal), to=1.0, increments=2):
        pass
    G, Λ = materials.lame(E, NU)
    l = 0.8
    pair = problem.pairs[0]
    assert pair.force()[1] == pytest.approx(l * (Λ + 2 * G) * (l**2 - 1) / 2, rel=1e-8)
    assert np.allclose(pair.moment(np.zeros(dim)), 0.0, atol=1e-6 * abs(pair.force()[1]))
    assert pair.closed_fraction() == 1.0


def test_a_plane_that_slides_drags_with_coulombs_force():
    """Pressed down, then moved along: at last all points slip and the force is μ times the normal one, to 1e-8; and back."""
    plane = obstacles.RigidPlane([0.0, 0.0], [0.0, -1.0])
    problem = block(plane, friction=0.2)
    pair = problem.pairs[0]
    for _ in quasistatic.march(problem, lambda t: plane.move([0.0, -0.02 * t]), to=1.0, increments=2):
        pass
    for way in (1.0, -1.0):
        for _ in quasistatic.march(problem, lambda t, w=way: plane.move([w * 0.1 * t, -0.02]), to=1.0, increments=10):
            pass
        assert pair.stick_fraction() == 0.0
        assert pair.force()[0] == pytest.approx(way * 0.2 * abs(pair.force()[1]), rel=1e-8)


def test_a_turning_circle_drags_too():
    """A circle pressed in and turned about its centre: tangential force and moment have the sense of the turn."""
    circle = obstacles.RigidSphere([0.0, 1.0], 1.0)
    problem = block(circle, friction=0.3, cells=16)
    pair = problem.pairs[0]
    for _ in quasistatic.march(problem, lambda t: circle.move([0.0, -0.02 * t]), to=1.0, increments=2):
        pass
    assert abs(pair.force()[0]) < 1e-2 * abs(pair.force()[1])  # the mesh's diagonals are not symmetric
    for _ in quasistatic.march(problem, lambda t: circle.move([0.0, -0.02], 0.1 * t), to=1.0, increments=5):
        pass
    fx, fy = pair.force()
    assert fx == pytest.approx(0.3 * abs(fy), rel=5e-2)  # its lowest point moves to +x; tractions lean with the surface
    on_circle = -pair.moment([0.0, 0.98])[0]
    assert on_circle == pytest.approx(-0.3 * abs(fy), rel=8e-2)  # the block resists the turn, at the lever R = 1


@pytest.mark.parametrize("dim", [2, 3])
def test_a_roller_may_turn_by_any_angle_in_a_step(dim):
    """What lies beside it is not carried through it: seen from its material it was, and steps of 1 rad were rejected."""
    eye, turn = np.eye(dim), np.eye(2 * dim - 3)[-1]
    roller = (
        obstacles.RigidSphere([0.0, 0.3], 0.3) if dim == 2 else obstacles.RigidCylinder([0, 0.3, 0], [0, 0, 1], 0.3)
    )
    problem = block(roller, dim=dim, friction=0.3, order=1)
    for _ in quasistatic.march(problem, lambda t: roller.move(-0.03 * t * eye[1]), to=1.0, increments=2):
        pass
    steps = list(quasistatic.march(problem, lambda t: roller.move(-0.03 * eye[1], t * turn), to=4.0, increments=2))
    assert not any(step.rejected for step in steps)
    assert problem.pairs[0].force()[0] > 0.2 * abs(problem.pairs[0].force()[1])


@pytest.mark.parametrize("turn, said", [(1.5, False), (4.0, True), (2 * np.pi, True)])
def test_a_turn_that_friction_does_not_follow_is_said(turn, said):
    """Of 4 rad in an increment it sees 2.3 the other way round, of a whole turn nothing."""
    circle = obstacles.RigidSphere([0.0, 0.3], 0.3)
    problem = block(circle, friction=0.3)
    pressed = quasistatic.march(problem, lambda t: circle.move([0.0, -0.03 * t]), to=1.0, increments=2)
    assert not any(step.findings for step in pressed)
    (step,) = quasistatic.march(problem, lambda t: circle.move([0.0, -0.03], t * turn), to=1.0, increments=1)
    assert [finding.value for finding in step.findings if "turn of" in finding.name] == [turn] * said


def test_hertz():
    """A circle on a large block: p₀ = √(F E*/(πR)), E* = E/(1 − ν²); 3 % for the finite block and mesh."""
    circle = obstacles.RigidSphere([0.0, 5.0], 5.0)
    problem = block(circle, cells=80, size=4.0, height=2.0)
    for _ in quasistatic.march(problem, lambda t: circle.move([0.0, -0.02 * t]), to=1.0, increments=2):
        pass
    pair = problem.pairs[0]
    F = -pair.force()[1]
    assert pair.largest_pressure() == pytest.approx(np.sqrt(F * E / (1 - NU**2) / (np.pi * 5.0)), rel=3e-2)


def disc_on_block(cells, radius, multiplier_order=None):
    """Vertical force of a disc pressed in by a tenth of its radius, amid one of a block's eight facets of order 2."""
    disc = obstacles.RigidSphere([0.0625, radius], radius)
    problem = block(disc, cells=cells, multiplier_order=multiplier_order)
    for _ in quasistatic.march(problem, lambda t: disc.move([0.0, -0.1 * radius * t]), to=1.0, increments=2):
        pass
    return problem.pairs[0].force()[1]


def test_a_disc_as_small_as_a_facet_is_felt():
    """Multipliers at a facet's corners alone let it in with .38 of the force on facets a quarter as large, where both orders
    agree to 3 %; those of the displacement's order with 1.13 of it."""
    radius = 0.125
    fine = [disc_on_block(32, radius, order) for order in (1, 2)]
    assert fine[0] == pytest.approx(fine[1], rel=0.03)
    assert disc_on_block(8, radius) == pytest.approx(fine[0], rel=0.15)
    assert abs(disc_on_block(8, radius, 1)) < 0.5 * abs(fine[0])


@pytest.mark.parametrize("cells, at, said", [(8, 0.0625, True), (64, 0.0625, False), (8, 0.5, False)])
def test_a_contact_narrower_than_a_facet_is_said(cells, at, said):
    """Of a disc of three of eight facets' radius, pressed in by .01 of it amid a facet, when the stage is over; not on 64
    facets, and not at the block's end, where any contact is narrow."""
    disc = obstacles.RigidSphere([at, 0.375], 0.375)
    steps = quasistatic.march(block(disc, cells=cells), lambda t: disc.move([0.0, -0.00375 * t]), to=1.0, increments=2)
    found = [[finding.name == "contact: width of the contact (facets)" for finding in step.findings] for step in steps]
    assert [any(names) for names in found] == [False, said]


@pytest.mark.one_rank
def test_the_order_of_multipliers_follows_the_radius_in_facets():
    """The displacement's on a disc of less than two facets, or one whose own facets turn by as much."""

    def order(radius, inside=False):
        return block(obstacles.RigidSphere([0.0, radius], radius, inside)).pairs[0].multiplier.shape.order

    assert [order(r / 8) for r in (1.0, 1.9, 2.1, 20.0)] == [2, 2, 1, 1]
    assert block(obstacles.RigidPlane([0.0, 0.0], [0.0, -1.0])).pairs[0].multiplier.shape.order == 1


@pytest.mark.several_ranks
def test_ranks_agree_with_one_rank():
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        ball = obstacles.RigidSphere([0.0, 0.5, 0.0], 0.5)
        problem = block(ball, comm, dim=3, cells=6, friction=0.3, order=1)
        for _ in quasistatic.march(
            problem, lambda t, b=ball: b.move([0.02 * t, -0.05 * t, 0.0], [0, 0.3 * t, 0]), to=1.0, increments=2
        ):
            pass
        found.append([*problem.pairs[0].force(), *problem.pairs[0].moment([0, 0, 0])])
    assert np.allclose(found[0], found[1], rtol=1e-8, atol=1e-8 * abs(found[0][1]))


def test_an_obstacle_of_another_dimension():
    with pytest.raises(ValueError, match="an obstacle in 3 dimensions"):
        block(obstacles.RigidPlane([0.0, 0, 0], [0.0, 1, 0]))


def test_tangent_on_a_curved_obstacle():
    """The Jacobian against central differences, friction, points inside and outside the circle: below 1e-6."""
    circle = obstacles.RigidSphere([0.1, 0.5], 0.5)
    problem = block(circle, friction=0.4, cells=6)
    pair = problem.pairs[0]
    rng = np.random.default_rng(1)
    x = problem.u.x.array
    free = problem.bodies.bodies[0].prescribed().x.array == 0
    base, direction = 5e-3 * free * rng.standard_normal(len(x)), free * rng.standard_normal(len(x))
    Λ = pair.multiplier.field.x.array
    base_Λ, direction_Λ = 1e4 * rng.standard_normal(len(Λ)) - 1e4, 1e6 * rng.standard_normal(len(Λ))

    def at(h):
        x[:], Λ[:] = base + h * direction, base_Λ + h * direction_Λ
        problem.u.x.scatter_forward()
        pair.multiplier.field.x.scatter_forward()
        problem.pack(problem.x)
        problem.assemble_residual(problem.x, problem.residual)
        return [part.array.copy() for part in problem.residual.getNestSubVecs()]

    at(0.0)
    circle.move([1e-3, -0.01])
    pair.active.closed = pair.at.facing & (pair.state.λN_hat > 0)
    at(0.0)

    def go():
        x[:], Λ[:] = direction, direction_Λ
        problem.u.x.scatter_forward()
        pair.multiplier.field.x.scatter_forward()

    assert_tangent(problem, at, go)


@pytest.mark.one_rank
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("target", ["disc", "plane", "closest points"])
def test_friction_stays_while_nothing_moves(target, order):
    """What drags a block slides on by a facet, and rests. Each point slips on from what its multiplier has not seen of its
    slip: with that forgotten friction fell by 8.5 % of itself on the disc, by 1.8 % on the plane, by 4 to 6 % on closest
    points, without a word, and hung on the number of increments."""
    slab = Box((0.0, 0.0), (2.0, 0.8), (8, 3), 1, {(1, 0): 1, (1, 1): 2})
    punch = Box((0.5, 0.8), (0.9, 0.5), (3, 2), 2, {(1, 1): 3, (1, 0): 4})
    boxes = [slab, punch]
    domain, _, tags = create_boxes(MPI.COMM_WORLD, boxes if target == "closest points" else boxes[:1], simplices=False)
    V = fem.functionspace(domain, ("Lagrange", order, (2,)))
    u, led = fem.Function(V), fem.Constant(domain, (0.0, 0.0))
    rigid = {"disc": obstacles.RigidSphere([0.8, 1.4], 0.6), "plane": obstacles.RigidPlane([1.7, 0.8], [-0.2, -1.0])}
    bcs = [fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(1)), V)]
    upper = Surface(domain, tags, 2)
    if target in rigid:
        contact = Contact(upper, rigid[target], friction=0.4)
    else:
        contact = Contact(upper, Surface(domain, tags, 4), friction=0.4, projection="closest")
        bcs.append(fem.dirichletbc(led, fem.locate_dofs_topological(V, 1, tags.find(3)), V))
    problem = ContactProblem(materials.neo_hookean(1e6, 0.3).virtual_work(u), u, bcs=bcs, contacts=[contact])

    def place(x, y):
        led.value[:] = x, y
        if target in rigid:
            rigid[target].move([x, y])

    list(quasistatic.march(problem, lambda y: place(0.0, y), to=-0.1, increments=2))
    list(quasistatic.march(problem, lambda x: place(x, -0.1), to=0.15, increments=3))
    dragged = problem.pairs[0].force()
    for rest in (1e-9, 2e-9):
        list(quasistatic.march(problem, lambda x, rest=rest: place(0.15 + x * rest, -0.1), to=1.0, increments=1))
    assert problem.pairs[0].stick_fraction() < 1.0
    assert np.allclose(problem.pairs[0].force(), dragged, rtol=0, atol=1e-6 * np.linalg.norm(dragged))
