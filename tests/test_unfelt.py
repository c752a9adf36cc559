"""What contact does not feel: thin bodies that a step would pass through, overlaps between the integration points."""

import contextlib
import math
import warnings

import basix.ufl
import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI
from robustness import march
from robustness_scenes import draw

from dolfinx_mortar_al import Contact, ContactProblem, Surface, materials, membrane, quasistatic
from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.inside import Inside
from dolfinx_mortar_al.monitors import ModelWarning
from dolfinx_mortar_al.obstacles import RigidCylinder, RigidPlane, RigidSphere
from dolfinx_mortar_al.surface import GatheredFacets, ShapeFunctions
from dolfinx_mortar_al.swept import changed_side, depth_behind, passed_obstacle, passed_through
from meshes.boxes import Box, create_boxes

E, NU = 1e5, 0.3
BOTTOM, TOP = 1, 2
THICK, WIDTH, HIGH, GAP = 0.05, 0.2, 0.1, 0.02  # m: of the bar, across and along the block, between both
DOWN = 0.3  # m: the block's way, after which it would be wholly below the bar
DEPTH = 0.02  # m: in an obstacle


class Body:
    """A rectangle of quadrilaterals with its bottom and top as surfaces; `place` moves its nodes (n, 3)."""

    def __init__(self, low, high, cells, order=1, place=lambda x: x):
        self.mesh = mesh.create_rectangle(MPI.COMM_WORLD, [low, high], cells, mesh.CellType.quadrilateral)
        faces = [
            mesh.locate_entities_boundary(self.mesh, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (low[1], high[1])
        ]
        ends = mesh.locate_entities_boundary(
            self.mesh, 1, lambda x: np.isclose(x[0], low[0]) | np.isclose(x[0], high[0])
        )
        facets = np.concatenate(faces)
        tags = np.repeat(np.array([BOTTOM, TOP], dtype=np.int32), [len(f) for f in faces])
        order_ = np.argsort(facets)
        self.tags = mesh.meshtags(self.mesh, 1, facets[order_], tags[order_])
        self.mesh.geometry.x[:] = place(self.mesh.geometry.x)
        V = fem.functionspace(self.mesh, ("Lagrange", order, (2,)))
        self.u = fem.Function(V)
        self.ends, self.top = (fem.locate_dofs_topological(V, 1, f) for f in (ends, faces[1]))
        self.F = materials.neo_hookean(E, NU).virtual_work(self.u)

    def held(self, dofs, value):
        return fem.dirichletbc(value, dofs, self.u.function_space)

    def surface(self, tag):
        return Surface(self.mesh, self.tags, tag)


def bar(order):
    """1 m long, its top at y = 0, clamped at both ends: (body, conditions)."""
    body = Body([-0.5, -THICK], [0.5, 0.0], [20, 2], order)
    return body, [body.held(body.ends, np.zeros(2))]


def block_over_bar(order=1, swap=False, tip=0.0, cells=(5, 3), gap=GAP, upright=False, **options):
    """The problem, and the motion of the block's top (m); `tip`: how far the middle of its bottom hangs down; `upright`:
    turned by 90°, its bottom to the left."""
    under, bcs = bar(order)

    def place(x):
        if upright:
            return np.stack([x[:, 1], gap + WIDTH / 2 - x[:, 0], x[:, 2]], axis=1)
        hanging = np.maximum(0, 1 - 2 * np.abs(x[:, 0]) / WIDTH) * (gap + HIGH - x[:, 1]) / HIGH
        return x - tip * hanging[:, None] * [0, 1, 0]

    block = Body([-WIDTH / 2, gap], [WIDTH / 2, gap + HIGH], cells, order, place)
    motion = fem.Constant(block.mesh, np.zeros(2))
    sides = [block.surface(BOTTOM), under.surface(TOP)]
    contact = Contact(*(reversed(sides) if swap else sides), **options)
    bcs.append(block.held(block.top, motion))
    return ContactProblem([under.F, block.F], [under.u, block.u], bcs=bcs, contacts=[contact]), motion


def drive(problem, load, increments=1, **options):
    return list(quasistatic.march(problem, load, to=1.0, increments=increments, start=0.0, **options))


@pytest.mark.one_rank
def test_a_beam_driven_into_another_in_two_increments():
    """The tip of one end would lie 0.8 facets deep in the other beam, where its points face nothing: such an increment fails,
    as Newton, whose points are held to the target's end, does not converge. (With smaller ones the march ends at a limit
    point.)"""
    scene = draw(9401, 28)
    assert "StepFailure: no convergence at load 1 " in march(scene, smallest=1.0)["error"]


@pytest.mark.parametrize("order", [1, 2])
def test_a_surface_carried_through_sideways(order):
    """A block on its side, whose contact surface faces along the bar, goes down through it: no ray meets the bar, and no
    state that a step ends in is one of contact. One increment carries the surface through, small ones into the bar."""
    for increments, said in ((1, "carried one surface through"), (40, "overlap by more than")):
        problem, motion = block_over_bar(order, upright=True)
        with pytest.raises(quasistatic.StepFailure, match=said):
            drive(
                problem,
                lambda t, m=motion: m.value.__setitem__(slice(None), [0.0, -DOWN * t]),
                increments,
                smallest=1.0,
            )


def test_no_increment_jumps_over_a_bar_with_a_rigid_roller():
    """The same with an obstacle, whose whole way is looked at."""
    forces, radius = [], 0.08
    for increments in (1, 30):
        body, bcs = bar(1)
        roller = RigidSphere([0.0, GAP + radius], radius)
        problem = ContactProblem(body.F, body.u, bcs=bcs, contacts=[Contact(body.surface(TOP), roller)])
        steps = drive(problem, lambda t, r=roller: r.move([0.0, -DOWN * t]), increments)
        forces.append(problem.pairs[0].force())
        assert increments > 1 or sum(step.rejected for step in steps) > 0
    assert forces[0][1] < 0
    np.testing.assert_allclose(forces[0], forces[1], atol=1e-6 * np.linalg.norm(forces[1]))


@pytest.mark.parametrize(
    "way, gap, said",
    [([0, -GAP / 2], GAP, [GAP / 2]), ([5, 0], GAP, [math.inf]), ([0, GAP], 0.0, [GAP]), ([0, -1.2 * GAP], GAP, [])],
)
def test_a_march_without_contact_says_how_near_the_bodies_come(way, gap, said):
    """A block goes down by a part of the gap, or aside, where nothing faces the bar, or up from where it touches: the last
    step says it. It does not where the block has been pressed and is lifted off."""
    problem, motion = block_over_bar(gap=gap)
    stages = [quasistatic.Stage(motion, to, 2) for to in (way, [0, GAP])[: 1 if said else 2]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        steps = list(quasistatic.march(problem, stages))
    found = [[f.value for f in step.findings if "least gap" in f.name] for step in steps]
    assert problem.pairs[0].closed_fraction() == 0
    assert not any(found[:-1])
    np.testing.assert_allclose(found[-1], said, rtol=1e-6)


def test_an_overlap_between_the_points_is_said():
    """A tip hangs down by 0.03 m in the middle of the block's two facets of 0.1 m. It goes 0.003 m into the bar, of which the
    next Gauss point, 0.0113 m beside it and 0.0034 m higher, feels nothing."""
    problem, motion = block_over_bar(tip=0.03, cells=(2, 2), gap=0.05, quadrature_degree=4)
    warns = pytest.warns(ModelWarning, match="do not feel it")
    with warns if MPI.COMM_WORLD.rank == 0 else contextlib.nullcontext():
        steps = drive(problem, lambda t: motion.value.__setitem__(slice(None), [0.0, -0.023 * t]))
    found = [f for f in steps[-1].findings if "not felt" in f.name]
    assert problem.pairs[0].closed_fraction() == 0
    assert len(found) == 1 and not found[0].fatal
    assert abs(found[0].value - 0.003 / np.hypot(0.1, 0.03)) < 1e-6
    np.testing.assert_allclose(found[0].X, [0.0, 0.02], atol=1e-12)


@pytest.mark.parametrize("facets", [0.9, 1.1])
def test_a_deep_overlap_at_the_start_is_said(facets):
    """Where a block begins more than one of its facets of .02 m deep in the bar, as a misplaced mesh would."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ModelWarning)
        block_over_bar(cells=(10, 5), gap=-facets * 0.02, swap=True)
    said = [str(w.message) for w in caught if "initial overlap" in str(w.message)]
    assert len(said) == (facets > 1 and MPI.COMM_WORLD.rank == 0)
    assert not said or f"= {facets}" in said[0]


@pytest.mark.parametrize("radius", [0.003, 0.5])
def test_a_pin_between_the_points_is_said(radius):
    """A pin of radius 3 mm goes 2.5 mm into the middle between two Gauss points, .058 m apart, of a facet of .1 m, which the
    points do not feel and the nodes do not see; one of .5 m is felt."""
    body = Body([-0.1, 0.0], [0.1, HIGH], (2, 2))
    pin = RigidSphere([0.05, -radius], radius)
    contact = Contact(body.surface(BOTTOM), pin, quadrature_degree=3)
    problem = ContactProblem(body.F, body.u, bcs=[body.held(body.top, np.zeros(2))], contacts=[contact])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        steps = drive(problem, lambda t: pin.move([0.0, 0.0025 * t]))
    found = [f for f in steps[-1].findings if "not felt" in f.name]
    assert (problem.pairs[0].closed_fraction() == 0) == (radius < 0.01) == (len(found) == 1)
    if found:
        assert found[0].value == pytest.approx(0.025, rel=1e-6)
        np.testing.assert_allclose(found[0].X, [0.05, 0.0], atol=1e-9)


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("side", [(0, 0), (0, 1)])
def test_the_wrong_surface_of_a_body(side, swap):
    """A punch on a slab whose left or right side is named in place of its top goes into it without contact, which is told:
    the five nodes of its bottom lie in the slab."""
    punch = Box((0.4, 1.0), (0.4, 0.5), (4, 4), 1, {(1, 0): BOTTOM, (1, 1): TOP})
    slab = Box((0.0, 0.0), (2.0, 1.0), (8, 4), 2, {(1, 0): 3, side: 4})
    domain, _, tags = create_boxes(MPI.COMM_WORLD, [punch, slab], simplices=False)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, way = fem.Function(V), fem.Constant(domain, np.zeros(2))
    at = [fem.locate_dofs_topological(V, 1, tags.find(tag)) for tag in (TOP, 3)]
    bcs = [fem.dirichletbc(way, at[0], V), fem.dirichletbc(np.zeros(2), at[1], V)]
    sides = [Surface(domain, tags, tag) for tag in (BOTTOM, 4)]
    contact = Contact(*(reversed(sides) if swap else sides))
    problem = ContactProblem(materials.neo_hookean(E, NU).virtual_work(u), u, bcs=bcs, contacts=[contact])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        first, last = quasistatic.march(problem, way, to=(0.0, -0.2), increments=2)
    assert problem.pairs[0].closed_fraction() == 0
    assert first.findings == last.findings
    assert [f.name for f in last.findings] == ["contact: nodes in the other body"]
    assert last.findings[0].value == 5
    assert "other surfaces of them meet" in last.findings[0].meaning


# ---------------------------------------------------------------- swept paths, and what is behind a surface


def barrel(width):
    """A block with its bottom y = x²/2, and of that the part |x| < width as a surface."""
    drum = Body([-0.5, 0.0], [0.5, 0.4], [20, 6], place=lambda x: x + [0, 0.5, 0] * x[:, [1, 0, 2]] ** 2)
    facets = drum.tags.find(BOTTOM)
    facets = facets[np.abs(mesh.compute_midpoints(drum.mesh, 1, facets)[:, 0]) < width]
    tags = mesh.meshtags(drum.mesh, 1, facets, np.full(len(facets), BOTTOM, dtype=np.int32))
    return drum, Surface(drum.mesh, tags, BOTTOM)


@pytest.mark.parametrize("role", ["on an obstacle", "contactor", "target"])
def test_contact_that_runs_over_the_end_of_a_surface_is_told(role):
    """A barrel is pressed .06 down, by which it comes to touch on .2 to either side and more. Where its bottom is named to .1
    only, what follows lies in the other body by a fifth of a facet at least, which is told of, and the force is 10 % lower.
    Where all of it is named nothing is said of it."""
    forces, told = [], []
    for width in (0.1, 0.5):
        drum, surface = barrel(width)
        way = fem.Constant(drum.mesh, np.zeros(2))
        F, u, bcs, sides = [drum.F], [drum.u], [drum.held(drum.top, way)], (surface, RigidPlane([0.0, 0.0], [0.0, 1.0]))
        if role != "on an obstacle":
            slab = Body([-0.8, -0.4], [0.8, 0.0], [40, 8])
            bottom = fem.locate_dofs_geometrical(slab.u.function_space, lambda x: np.isclose(x[1], -0.4))
            F, u, bcs = [*F, slab.F], [*u, slab.u], [*bcs, slab.held(bottom, np.zeros(2))]
            sides = (surface, slab.surface(TOP)) if role == "contactor" else (slab.surface(TOP), surface)
        problem = ContactProblem(F, u, bcs=bcs, contacts=[Contact(*sides)])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            *_, step = quasistatic.march(problem, way, to=(0.0, -0.06), increments=3)
        told.append([f for f in step.findings if "beyond" in f.name])
        forces.append(abs(problem.pairs[0].force()[1]))
    assert told[1] == []
    assert told[0][0].value > 0.2
    assert "name these facets" in told[0][0].meaning
    assert forces[0] < 0.9 * forces[1]


def line(X, order=1, orientation=1.0):
    """A line through the nodes X as a surface of intervals of that order; its front is below if it goes to the right."""
    n = (len(X) - 1) // order
    facets = order * np.arange(n)[:, None] + np.array([[0, 1]] if order == 1 else [[0, 2, 1]])
    shape = ShapeFunctions(basix.CellType.interval, order)
    return GatheredFacets(shape, facets, np.arange(len(X)), np.asarray(X, dtype=float), np.full(n, orientation))


def passes(surface, x0, x1, depth=0.05):
    x0, x1 = np.atleast_2d(np.array(x0, dtype=float)), np.atleast_2d(np.array(x1, dtype=float))
    return passed_through(surface, surface.X, surface.X, x0, x1, depth).tolist()


@pytest.mark.one_rank
def test_paths_through_a_line():
    """From above through a line of 4 m whose front is above; not from below, beside it, or less than the depth."""
    flat = line(np.stack([np.arange(5.0), np.zeros(5)], axis=1), orientation=-1.0)
    assert passes(flat, [[1.5, 1], [1.5, -1], [5, 1], [2.5, 1]], [[2.2, -1], [2.2, 1], [4.5, -1], [2.5, -0.04]]) == [
        True, False, False, False,
    ]  # fmt: skip


@pytest.mark.one_rank
def test_paths_over_a_bump_and_through_a_plate():
    """What comes out again elsewhere may have gone round; through the two sides of a plate it has not. What slides past the
    bump's top is in it at most there."""
    bump = line([[0, 0], [1, 0.5], [2, 0]], orientation=-1.0)
    plate = line([[0, 0.1], [2, 0.1], [2, 0], [0, 0]], orientation=-1.0)
    assert passes(bump, [-1, 0.2], [3, 0.2]) == [False]
    assert passes(bump, [[0.5, 0.5], [1.5, 0.5]], [[1.5, 0.5], [0.5, 0.5]]) == [False, False]
    assert passes(plate, [1, 1], [1, -1]) == [True]


@pytest.mark.one_rank
def test_what_goes_under_facets_in_contact_has_not_passed_through():
    """A block of 4 m, of which sides and bottom are surface, is dragged by 12 m over a point .01 m above its bottom: in at
    one side and out at the other. With the middle of the bottom in contact the point has gone under it; what lies two
    facets higher has not, nor with the sides in contact, as it comes straight at these."""
    x = np.arange(5.0)
    outline = [[0, 3], [0, 1.5], *np.stack([x, 0 * x], axis=1), [4, 1.5], [4, 3]]
    block = line(outline, orientation=1.0)
    ends = block.X + np.array([8.0, 0.0]), block.X - np.array([4.0, 0.0])
    touching = np.isin(np.arange(len(block.facets)), [3, 4])
    points = np.array([[4.0, 0.01], [4.0, 2.0]])
    for told, expected in ((None, [True, True]), (touching, [False, True]), (~touching, [False, True])):
        passed = passed_through(block, *ends, points, points, 0.05, touching=told)
        assert passed.tolist() == expected


@pytest.mark.one_rank
@pytest.mark.parametrize("E_rod, way, expected", [(1e6, (0.0, -0.3), 17490.0), (1e5, (-0.3, -0.3), 1826.7)])
def test_an_elastic_rod_does_not_end_up_through_a_strip(E_rod, way, expected):
    """A rod pushed onto a strip a twelfth of a facet thick tips over, and stood through it at last, without force or a word:
    what went through had been near facets in contact. The force (N) is that of 10 and of 50 increments (seen once)."""
    u, bodies = [], []
    shapes = ([-1.0, -0.02], [1.0, 0.0], [8, 1], 1e6), ([0.875, 0.05], [0.925, 0.35], [2, 2], E_rod)
    for low, high, cells, E in shapes:
        domain = mesh.create_rectangle(MPI.COMM_WORLD, [low, high], cells, mesh.CellType.triangle)
        u.append(fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,)))))
        bodies.append(materials.neo_hookean(E, 0.3).virtual_work(u[-1]))

    def side(k, *at):
        domain = u[k].function_space.mesh
        facets = np.sort(np.concatenate([mesh.locate_entities_boundary(domain, 1, place) for place in at]))
        return Surface(domain, mesh.meshtags(domain, 1, facets, np.ones(len(facets), dtype=np.int32)), 1)

    led = fem.Constant(u[1].function_space.mesh, (0.0, 0.0))
    V, W = (v.function_space for v in u)
    ends = fem.locate_dofs_geometrical(V, lambda x: np.isclose(abs(x[0]), 1.0))
    top = fem.locate_dofs_geometrical(W, lambda x: np.isclose(x[1], 0.35))
    bcs = [fem.dirichletbc(np.zeros(2), ends, V), fem.dirichletbc(led, top, W)]
    rod = side(1, lambda x: np.isclose(x[1], 0.05) | np.isclose(abs(x[0] - 0.9), 0.025))
    faces = [lambda x, y=y: np.isclose(x[1], y) for y in (0.0, -0.02)]
    contact = Contact(rod, side(0, *faces))
    problem = ContactProblem(bodies, u, bcs=bcs, contacts=[contact])
    for _ in quasistatic.march(problem, led, to=way, increments=5 if way[0] == 0.0 else 2):
        pass
    assert np.linalg.norm(problem.pairs[0].force()) == pytest.approx(expected, rel=1e-3)


@pytest.mark.one_rank
def test_a_hollow_of_order_two_is_not_its_chord():
    """A parabola of 1 m, 0.1 m deep: what lies between it and its chord is in front of it. (Its two halves count as flat.)"""
    hollow = line([[0, 0], [0.5, -0.1], [1, 0]], order=2, orientation=-1.0)
    assert passes(hollow, [[0.4, 1], [0.4, 1]], [[0.4, -0.07], [0.4, -0.2]]) == [False, True]
    found = depth_behind(hollow, hollow.X, np.array([[0.4, -0.07], [0.4, -0.15], [3.0, -1.0]]), 0.5)
    assert found[0] < 0 < found[1] and found[2] == -np.inf


@pytest.mark.one_rank
@pytest.mark.parametrize("cell", [basix.CellType.interval, basix.CellType.triangle, basix.CellType.quadrilateral])
@pytest.mark.parametrize("order", [1, 2])
def test_pieces_fill_the_reference_facet(cell, order):
    shape = ShapeFunctions(cell, order)
    corners = shape.nodes[shape.pieces]
    a = corners[:, 1:] - corners[:, :1]
    volume = np.linalg.det(a) / math.factorial(shape.dim)
    assert (volume > 0).all()
    assert abs(volume.sum() - basix.make_quadrature(cell, 1)[1].sum()) < 1e-14


def moving_obstacle(dim, rng):
    """An obstacle that has moved and turned about its axis, and its poses; points a, b (400, 2) across that, before and now,
    as seen from it, and in space; whether their ways go deeper than `DEPTH`, and (400,) where that is clear."""
    radius = 0.5
    obstacle = RigidSphere([0.1, 0.2], radius) if dim == 2 else RigidCylinder([0.1, 0.2, 0], [0, 0, 1], radius)
    poses = []
    for _ in range(2):
        obstacle.move(rng.normal(size=dim), rng.normal() * np.eye(2 * dim - 3)[-1])
        poses.append(obstacle.pose)
    a, b = (rng.uniform(-1.5, 1.5, (400, 2)) for _ in range(2))
    t = np.clip(-np.einsum("ni,ni->n", a, b - a) / np.einsum("ni,ni->n", b - a, b - a), 0, 1)[:, None]
    nearest = np.linalg.norm(a + t * (b - a), axis=1)
    along = rng.uniform(-1, 1, (400, dim - 2))
    centre = np.array([0.1, 0.2, 0][:dim])
    x = [np.hstack([y, along]) + centre + pose.translation for y, pose in zip((a, b), poses, strict=True)]
    return obstacle, poses, (a, b), x, nearest < radius - DEPTH, np.abs(nearest - (radius - DEPTH)) > 1e-3


@pytest.mark.one_rank
@pytest.mark.parametrize("dim", [2, 3])
def test_paths_through_a_moving_obstacle(dim):
    """Against the distance of straight lines from centre or axis, as seen from there."""
    obstacle, poses, (a, b), x, deep, clear = moving_obstacle(dim, np.random.default_rng(3))
    outside = np.minimum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)) >= obstacle.radius
    found = passed_obstacle(obstacle, poses[0], *x, DEPTH)
    assert np.array_equal(found[clear], (outside & deep)[clear]) and (outside & deep).sum() > 20


@pytest.mark.one_rank
@pytest.mark.parametrize("is_membrane", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_points_that_an_obstacle_comes_to_lie_behind(dim, is_membrane):
    """Surfaces that face the obstacle at first and have it behind themselves at last; of membranes, which are seen from
    either side, also those that stand on end more than a quarter of the radius deep in it."""
    rng = np.random.default_rng(4)
    obstacle, poses, (a, b), x, deep, clear = moving_obstacle(dim, rng)
    n = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 400, 2))]
    was, now = (np.einsum("ni,ni->n", v, y) / np.linalg.norm(y, axis=1) for v, y in zip(n, (a, b), strict=True))
    wide = [np.pad(v, [(0, 0), (0, dim - 2)]) for v in n]
    away = np.linalg.norm(b, axis=1)
    expected = deep & (was < 0) & (now > np.where(away < obstacle.radius, 0.5, 0.1))
    if is_membrane:
        side = -np.sign(was)
        least = np.where(away < 0.75 * obstacle.radius, -0.3, np.where(away < obstacle.radius, 0.5, 0.1))
        expected = deep & (-abs(was) < np.minimum(least, 0.0)) & (side * now > least)
    found = changed_side(obstacle, poses[0], x, wide, DEPTH, is_membrane)
    assert np.array_equal(found[clear], expected[clear]) and expected.sum() > 20


@pytest.mark.one_rank
def test_what_comes_to_lie_in_an_obstacles_middle_has_passed():
    """There no closest point is defined, and nothing was said of a membrane that a ball had gone half through."""
    ball = RigidSphere([0.0, 0.0], 0.5)
    x, n = [np.array([[0.0, 0.7]]), np.zeros((1, 2))], [np.array([[0.0, -1.0]])] * 2
    assert changed_side(ball, ball.pose, x, n, DEPTH, False).all()


def ball_on_slab(lead, increments, dim, moves_body=False):
    """Steps as a ball and a slab with facets of its radius are led together by `lead` radii, and the slab's force."""
    r, low, high = 0.25, [0.0] * dim, [1.0] * (dim - 1) + [0.3]
    make = mesh.create_rectangle if dim == 2 else mesh.create_box
    kind = mesh.CellType.quadrilateral if dim == 2 else mesh.CellType.hexahedron
    domain = make(MPI.COMM_WORLD, [low, high], [4] * (dim - 1) + [2], kind)
    ends = mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[0] * (1 - x[0]), 0.0))
    upper = np.sort(mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[dim - 1], 0.3)))
    V, led = fem.functionspace(domain, ("Lagrange", 1, (dim,))), fem.Constant(domain, np.zeros(dim))
    held = fem.dirichletbc(led, fem.locate_dofs_topological(V, dim - 1, ends), V)
    top = Surface(domain, mesh.meshtags(domain, dim - 1, upper, np.ones(len(upper), dtype=np.int32)), 1)
    ball, way = RigidSphere([0.5] * (dim - 1) + [0.3 + r], r), np.eye(dim)[-1] * lead * r
    u = fem.Function(V)
    F = materials.neo_hookean(1e6, NU).virtual_work(u)
    problem = ContactProblem(F, u, bcs=[held], contacts=[Contact(top, ball)])
    if moves_body:
        steps = quasistatic.march(problem, led, to=way, increments=increments)
    else:
        steps = quasistatic.march(problem, lambda share: ball.move(-share * way), to=1.0, increments=increments)
    return list(steps), problem.pairs[0].force()[-1]


@pytest.mark.parametrize("lead, dim, moves_body", [(1.1, 2, False), (1.5, 2, False), (1.1, 3, False), (1.1, 2, True)])
def test_an_obstacle_does_not_come_out_on_the_other_side(lead, dim, moves_body):
    """In one increment its far half lay next to the slab's surface, which it pulled (by 81,990 N in the plane for 104,738 N),
    with no rejected trial and no word. The force is that of eight increments, of which none is rejected."""
    (*_, last), force = ball_on_slab(lead, 1, dim, moves_body)
    every, slowly = ball_on_slab(lead, 8, dim, moves_body)
    assert not any(step.rejected for step in every) and last.load > 0.0
    assert force == pytest.approx(slowly, rel=1e-8) and slowly < 0.0


def ball_under_membrane(cells, radius, x, stretch, increments, to=0.2):
    """Steps as a disc is led up by `to` (m) into a membrane of order 2 between two ends, stretched by that share, under its
    place x (m); and the force on the membrane (N)."""
    nodes = np.column_stack([np.linspace(0.0, 1.0, cells + 1), np.zeros(cells + 1)])
    ends = np.column_stack([np.arange(cells), np.arange(1, cells + 1)])
    element = basix.ufl.element("Lagrange", "interval", 1, shape=(2,))
    domain = mesh.create_mesh(MPI.COMM_WORLD, cells=ends, x=nodes, e=element)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, led, ball = fem.Function(V), fem.Function(V), RigidSphere([x, -radius], radius)
    led.interpolate(lambda X: np.stack([stretch * (X[0] - 0.5), 0 * X[0]]))
    held = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[0] * (1 - X[0]), 0.0))
    tags = mesh.meshtags(domain, 1, np.arange(cells, dtype=np.int32), np.ones(cells, dtype=np.int32))
    contact = Contact(Surface(domain, tags, 1, side=[0, -1]), ball)
    rubber = membrane.neo_hookean_membrane(E=2e6, nu=0.3, thickness=1e-3)
    problem = ContactProblem(rubber.virtual_work(u), u, bcs=[fem.dirichletbc(led, held)], contacts=[contact])
    steps = list(quasistatic.march(problem, lambda s: ball.move([0.0, s]), to=to, increments=increments))
    return steps, problem.pairs[0].force()[1]


@pytest.mark.one_rank  # cells are given on one
@pytest.mark.parametrize("cells, radius, x, stretch, increments", [(20, 0.05, 0.51, 0.0, 4), (40, 0.02, 0.5, 0.05, 10)])
def test_a_ball_does_not_go_through_a_membrane(cells, radius, x, stretch, increments):
    """By its radius an increment, of about a facet. In the first the membrane's rim stood on end around it, in the next it
    was behind: -91 N for 122, and no force at all for 177 (a node was in the very middle), without a word."""
    steps, force = ball_under_membrane(cells, radius, x, stretch, increments)
    _, slowly = ball_under_membrane(cells, radius, x, stretch, 40)
    assert force == pytest.approx(slowly, rel=1e-6) and slowly > 100.0
    assert sum(step.rejected for step in steps) == 1


@pytest.mark.one_rank
def test_a_pin_slides_along_under_a_strip():
    """By its radius in an increment, under the strip that it lifts: what comes to lie on it, and leaves it, has not gone
    through it, though the straight way does (45 iterations, a rejected trial in each increment; now 19 and none)."""
    strip, r = Body([0.0, 0.0], [3.0, 0.02], [60, 1]), 0.2
    held = [fem.dirichletbc(np.zeros(2), strip.ends, strip.u.function_space)]
    pin = RigidSphere([1.5, -r], r)
    contact = Contact(strip.surface(BOTTOM), pin, friction=0.1)
    problem = ContactProblem(strip.F, strip.u, bcs=held, contacts=[contact])
    for _ in quasistatic.march(problem, lambda s: pin.move([0.0, 0.3 * s]), to=1.0, increments=6):
        pass
    steps = list(quasistatic.march(problem, lambda s: pin.move([0.6 * s, 0.3]), to=1.0, increments=3))
    assert not any(step.rejected for step in steps)
    force = problem.pairs[0].force()
    assert force[1] > 0.0 and abs(force[0]) < force[1]


@pytest.mark.one_rank
def test_a_thin_pin_does_not_go_through_a_strip():
    """A pin of half a facet's radius bends a cantilever, by .6 of its radius an increment: it went through in three of them,
    and the strip was straight after (0 N). The force in its middle is 3EI/L³ times the way, to 3 %."""
    domain = mesh.create_box(MPI.COMM_WORLD, [[0, 0, 0], [2, 0.2, 0.1]], [20, 1, 1], mesh.CellType.hexahedron)
    ends = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[0], 0.0))
    top = np.sort(mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0.1)))
    V, r = fem.functionspace(domain, ("Lagrange", 2, (3,))), 0.05
    clamp = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, ends), V)
    pin = RigidCylinder([1, 0, 0.1 + r], [0, 1, 0], r)
    contact = Contact(Surface(domain, mesh.meshtags(domain, 2, top, np.ones(len(top), dtype=np.int32)), 1), pin)
    u = fem.Function(V)
    F = materials.saint_venant_kirchhoff(1e6, 0.0).virtual_work(u)
    problem = ContactProblem(F, u, bcs=[clamp], contacts=[contact])
    for step in quasistatic.march(problem, lambda way: pin.move([0.0, 0.0, -way]), to=0.12, increments=4):
        force = -problem.pairs[0].force()[2]
        assert force == pytest.approx(3 * 1e6 * (0.2 * 0.1**3 / 12) * step.load, rel=0.03)


def test_inside_a_thin_body():
    """Points behind the top of the bar: in it, below it, and in the block's own body, which is another one; and beyond its
    end, from where the way to the rim is in the air all along."""
    body, bcs = bar(2)
    bodies = Bodies([body.F], [body.u], bcs, None)
    x = np.array([[0.1, -0.02], [0.1, -THICK - 0.01], [0.33, -0.049], [0.0, -0.3], [0.6, -1e-4]])
    y = np.clip(x * [1, 0], -0.5, 0.5)
    assert Inside(body.surface(TOP), bodies)(x, y).tolist() == [True, False, True, False, False]
