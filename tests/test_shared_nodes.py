"""Nodes that contactors of several pairs share: a block in a rough die, a face of two surfaces, four blocks that meet."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, compute_midpoints, create_box, create_rectangle, locate_entities_boundary, meshtags
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, dynamics, materials, obstacles, quasistatic
from dolfinx_mortar_al.step_level import StepLevel

LAW = materials.neo_hookean(E=1e6, nu=0.3)
WEIGHT = -9810.0  # N/m³
EDGES = {"bottom": (1, 0), "right": (0, 1), "top": (1, 1), "left": (0, 0)}  # axis, end


def square(n, order, corner=(0.0, 0.0), cell=CellType.quadrilateral):
    """A unit square: displacement, and its edges as surfaces."""
    (x, y), comm = corner, MPI.COMM_WORLD
    domain = create_rectangle(comm, [[x, y], [x + 1.0, y + 1.0]], [n, n], cell)
    return surfaces(domain, order, {name: (a, corner[a] + end) for name, (a, end) in EDGES.items()})


def surfaces(domain, order, faces):
    """A displacement on a mesh, and surfaces of its `faces` {name: (axis, coordinate)}."""
    dim = domain.geometry.dim
    found = [
        locate_entities_boundary(domain, dim - 1, lambda X, a=a, v=v: np.isclose(X[a], v)) for a, v in faces.values()
    ]
    facets, values = np.concatenate(found), np.repeat(np.arange(len(found), dtype=np.int32), [len(f) for f in found])
    sort = np.argsort(facets)
    tags = meshtags(domain, dim - 1, facets[sort], values[sort])
    u = fem.Function(fem.functionspace(domain, ("Lagrange", order, (dim,))))
    return u, {name: Surface(domain, tags, k) for k, name in enumerate(faces)}


def press(problem, way, increments=4):
    """Iterations and rejected trials of a march along `way`."""
    steps = list(quasistatic.march(problem, way, to=1.0, increments=increments))
    return sum(step.iterations for step in steps), sum(step.rejected for step in steps)


def die(order, friction, n=4, cell=CellType.quadrilateral, multiplier_order=None):
    """A square between four rigid planes, of which the upper one comes down by .1 of its height."""
    u, sides = square(n, order, cell=cell)
    planes = {}
    for name, (axis, end) in EDGES.items():
        planes[name] = obstacles.RigidPlane(np.eye(2)[axis] * end, np.eye(2)[axis] * (1 - 2 * end))
    contacts = [
        Contact(sides[k], planes[k], friction=friction, name=k, multiplier_order=multiplier_order) for k in EDGES
    ]
    problem = ContactProblem(Body(u, LAW), contacts=contacts)
    effort = press(problem, lambda s: planes["top"].move([0.0, -0.1 * s]))
    return effort, {pair.name: pair.force() for pair in problem.pairs}


@pytest.mark.parametrize("friction", [0.05, 0.3, 1.0])
def test_a_block_in_a_rough_die(friction):
    """On meshes of order 1, as on those of order 2 (whose multipliers of order 1 share no such node): no rejected trial, the
    walls' forces alike, and all forces within 3 %: they differ by .05 %, for μ = 1 by 2 %."""
    (iterations, rejected), forces = die(1, friction)
    _, fine = die(2, friction, n=8)
    assert rejected == 0 and iterations <= 12  # 7; it failed in its first step, or took 53 for μ = 1
    scale = np.linalg.norm(fine["top"])
    assert forces["left"][0] == pytest.approx(-forces["right"][0], abs=1e-6 * scale)
    for name in EDGES:
        assert np.linalg.norm(forces[name] - fine[name]) < 0.03 * scale


@pytest.mark.one_rank
@pytest.mark.parametrize(
    "options", [{"cell": CellType.triangle}, {"order": 2, "multiplier_order": 2}, {"n": 7, "friction": 0.2}]
)
def test_other_meshes_in_a_rough_die(options):
    """Triangles, multipliers of order 2, an odd number of facets: none came to an end."""
    effort, _ = die(**({"order": 1, "friction": 0.3} | options))
    assert effort[1] == 0 and effort[0] <= 12


def test_a_block_in_a_rough_die_in_space():
    """Edges are shared by two faces and corners by three."""
    domain = create_box(MPI.COMM_WORLD, [[0.0] * 3, [1.0] * 3], [2] * 3, CellType.hexahedron)
    u, sides = surfaces(domain, 1, {f"{axis}{end}": (axis, end) for axis in range(3) for end in (0, 1)})
    contacts, planes = [], {}
    for name, side in sides.items():
        n = np.eye(3)[int(name[0])]
        planes[name] = obstacles.RigidPlane(n * int(name[1]), n * (1 - 2 * int(name[1])))
        contacts.append(Contact(side, planes[name], friction=0.3, name=name))
    problem = ContactProblem(Body(u, LAW), contacts=contacts)
    effort = press(problem, lambda s: planes["21"].move([0.0, 0.0, -0.1 * s]), increments=2)
    assert effort[1] == 0 and effort[0] <= 10  # came to no end before
    walls = np.array([np.abs(problem.pair(name).force()).max() for name in ("00", "01", "10", "11")])
    assert np.ptp(walls) < 1e-6 * walls.max()


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_face_of_two_surfaces(friction):
    """Both halves of a bottom on one plane bear the same, with multipliers of either order within the error of the mesh; they
    differed by a third without friction, as what each bore at their common node was undetermined."""
    halves = {}
    for order in (1, 2):
        u, sides = square(4, order)
        domain, bottom = sides["bottom"].mesh, np.sort(sides["bottom"].tags.find(0))
        right = compute_midpoints(domain, 1, bottom)[:, 0] > 0.5
        cut = meshtags(domain, 1, bottom, 1 + right.astype(np.int32))
        plane = [obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0]) for _ in range(2)]
        lowered = fem.Function(u.function_space)
        top = fem.locate_dofs_geometrical(u.function_space, lambda X: np.isclose(X[1], 1.0))
        contacts = [Contact(Surface(domain, cut, k), plane[k - 1], friction=friction, name=str(k)) for k in (1, 2)]
        problem = ContactProblem(Body(u, LAW, bcs=[fem.dirichletbc(lowered, top)]), contacts=contacts)

        def lower(s, lowered=lowered):
            lowered.interpolate(lambda X: np.stack([0.0 * X[0], -0.05 * s + 0.0 * X[0]]))

        effort = press(problem, lower)
        assert effort[1] == 0
        halves[order] = np.array([pair.force()[1] for pair in problem.pairs])
        assert np.ptp(halves[order]) < 1e-6 * halves[order].sum()
    assert np.abs(halves[1] - halves[2]).max() < 0.02 * halves[2].max()


@pytest.mark.one_rank
def test_four_blocks_that_meet():
    """Two by two, on meshes that match: round the node where they meet what sticks is undetermined once, too."""
    bodies, side = [], {}
    for i, j in np.ndindex(2, 2):
        u, sides = square(3, 1, (float(i), float(j)))
        bodies.append(Body(u, LAW))
        side |= {(i, j, name): surface for name, surface in sides.items()}
    floor, press_ = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0]), obstacles.RigidPlane([0.0, 2.0], [0.0, -1.0])
    contacts = []
    for k in range(2):
        contacts += [
            Contact(side[0, k, "right"], side[1, k, "left"], friction=0.3, name=f"beside {k}"),
            Contact(side[k, 0, "top"], side[k, 1, "bottom"], friction=0.3, name=f"above {k}"),
            Contact(side[k, 0, "bottom"], floor, friction=0.3, name=f"floor {k}"),
            Contact(side[k, 1, "top"], press_, friction=0.3, name=f"press {k}"),
        ]
    problem = ContactProblem(bodies, contacts=contacts)
    effort = press(problem, lambda s: press_.move([0.0, -0.04 * s]))
    assert effort[1] == 0 and effort[0] <= 12  # the first step came to no end before
    forces = {pair.name: pair.force() for pair in problem.pairs}
    assert forces["floor 0"][1] == pytest.approx(forces["floor 1"][1], rel=0.01)  # the left blocks are contactors, .003
    assert sum(forces[name][1] for name in ("floor 0", "floor 1", "press 0", "press 1")) == pytest.approx(0, abs=1e-3)


@pytest.mark.one_rank
def test_a_pad_one_cell_thick():
    """Clamped on top and squeezed between a floor and walls: at its ends supports hold one node, and the floor's pair shares
    the other one, which a wall keeps. Forces are half of order 2's on such cells."""
    walls = {}
    for order in (1, 2):
        domain = create_rectangle(MPI.COMM_WORLD, [[0.0, 0.0], [1.0, 0.05]], [6, 1], CellType.quadrilateral)
        u, sides = surfaces(domain, order, {"bottom": (1, 0.0), "right": (0, 1.0), "left": (0, 0.0)})
        lowered = fem.Function(u.function_space)
        top = fem.locate_dofs_geometrical(u.function_space, lambda X: np.isclose(X[1], 0.05))
        planes = {
            "bottom": obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0]),
            "right": obstacles.RigidPlane([1.0, 0.0], [-1.0, 0.0]),
            "left": obstacles.RigidPlane([0.0, 0.0], [1.0, 0.0]),
        }
        contacts = [Contact(sides[name], plane, friction=0.3, name=name) for name, plane in planes.items()]
        problem = ContactProblem(Body(u, LAW, bcs=[fem.dirichletbc(lowered, top)]), contacts=contacts)

        def lower(s, lowered=lowered):
            lowered.interpolate(lambda X: np.stack([0.0 * X[0], -0.0125 * s + 0.0 * X[0]]))

        effort = press(problem, lower)
        assert effort[1] == 0 and effort[0] <= 12  # it failed at a quarter of the way
        left, right = problem.pair("left").force(), problem.pair("right").force()
        assert left[0] == pytest.approx(-right[0], rel=1e-6)
        walls[order] = left[0]
    assert walls[1] > 0.25 * walls[2]


@pytest.mark.one_rank
def test_a_surface_that_may_touch_itself_keeps_its_nodes():
    """It is near itself everywhere, and shares no node with its pair with a plane."""
    u, sides = square(4, 1)
    plane, lowered = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0]), fem.Function(u.function_space)
    top = fem.locate_dofs_geometrical(u.function_space, lambda X: np.isclose(X[1], 1.0))
    contacts = [Contact(sides["bottom"], target, friction=0.3, name=str(k)) for k, target in enumerate((plane, None))]
    problem = ContactProblem(Body(u, LAW, bcs=[fem.dirichletbc(lowered, top)]), contacts=contacts)
    lowered.x.array[1::2] = -0.01
    quasistatic.equilibrate(problem)
    assert not any(pair.multiplier.redundant.any() for pair in problem.pairs)


@pytest.mark.one_rank
def test_a_plane_far_off_changes_nothing_in_motion():
    """The same face has a second pair with a plane that it never comes near."""
    ends = []
    for far in (False, True):
        u, sides = square(5, 1)
        motion = dynamics.Motion(Body(u, LAW, density=1000.0), step=4e-3)
        motion.velocity.interpolate(lambda X: np.stack([0 * X[0], -2.0 + 0 * X[0]]))
        planes = [obstacles.RigidPlane([0.0, y], [0.0, 1.0]) for y in (-0.02, -50.0)[: 1 + far]]
        contacts = [Contact(sides["bottom"], plane, friction=0.3) for plane in planes]
        *_, last = dynamics.march(ContactProblem(motion, contacts=contacts), to=0.04)
        ends.append([*last.ledger.momentum, last.ledger.kinetic, last.ledger.friction_dissipation])
    assert np.allclose(*ends, rtol=1e-9, atol=1e-9)


def test_a_block_flies_into_a_rough_corner():
    """Velocities stay numbers, momentum is what the walls give, and energy only falls."""
    u, sides = square(4, 1)
    motion = dynamics.Motion(Body(u, LAW, density=1000.0), step=4e-3)
    motion.velocity.interpolate(lambda X: np.stack([-1.0 + 0 * X[0], -1.5 + 0 * X[0]]))
    planes = {
        "bottom": obstacles.RigidPlane([0.0, -0.01], [0.0, 1.0]),
        "left": obstacles.RigidPlane([-0.01, 0.0], [1.0, 0.0]),
    }
    contacts = [Contact(sides[name], plane, friction=0.3, name=name) for name, plane in planes.items()]
    problem = ContactProblem(motion, contacts=contacts)
    impulse, touched = np.zeros(2), np.zeros(2, dtype=bool)
    for step in dynamics.march(problem, to=0.06):
        impulse += step.step * np.sum(step.forces, axis=0)
        touched |= [bool(np.linalg.norm(force) > 0) for force in step.forces]
        assert abs(step.ledger.energy_defect) < 1e-9 * step.ledger.received
        assert step.ledger.friction_dissipation >= -1e-9 and step.ledger.impact_loss >= -1e-9
    assert touched.all() and isinstance(problem.pairs[0].kinematics, StepLevel)
    assert np.allclose(step.ledger.momentum, impulse + 1000.0 * np.array([-1.0, -1.5]), atol=1e-6)


def test_blocks_on_a_rough_floor_run_into_each_other():
    """Their lower corners touch the floor and each other: a rigid target and one that deforms. What contact leaves of the
    velocities was not determined after a few steps; it is, in a few iterations, and momentum is what the floor gives."""
    floor = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0])
    motions, sides = [], []
    for x in (0.0, 1.0):
        u, mine = square(1, 1, (x, 0.0))
        weight = (ufl.as_vector([0.0, WEIGHT]), ufl.dx)
        motions.append(dynamics.Motion(Body(u, LAW, density=1000.0, external=[weight]), step=1e-3))
        motions[-1].velocity.interpolate(lambda X, x=x: np.stack([0.5 - x + 0 * X[0], 0 * X[0]]))
        sides.append(mine)
    contacts = [Contact(mine["bottom"], floor, friction=0.6) for mine in sides]
    contacts.append(Contact(sides[0]["right"], sides[1]["left"], friction=0.6))
    steps = list(dynamics.march(ContactProblem(motions, contacts=contacts), to=0.02))
    assert max(step.iterations for step in steps) <= 6 and not sum(step.rejected for step in steps)
    ledger = steps[-1].ledger
    assert abs(ledger.energy_defect) < 1e-9 * ledger.received and np.linalg.norm(steps[0].forces[2]) > 0
    on_ground = sum(step.step * (step.forces[0] + step.forces[1]) for step in steps)
    weights = np.array([0.0, 2 * WEIGHT * 0.02])
    assert np.allclose(ledger.momentum, on_ground + weights, atol=1e-6)
