"""Symmetry planes and slices: multipliers at nodes that are held on both sides have nothing to enforce there."""

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_mortar_al import (
    Body,
    Contact,
    ContactProblem,
    NewtonSolver,
    Surface,
    loads,
    materials,
    membrane,
    quasistatic,
    reaction,
)
from dolfinx_mortar_al.quasistatic import Stage

DEEP, THICK = 0.02, 0.1  # m
BOTTOM, TOP = 1, 2


def block(low, high, cells, order, held):
    """A box between the planes z = 0 and z = THICK, which hold it along z where `held` says: (Body's arguments, tags)."""
    domain = mesh.create_box(MPI.COMM_WORLD, [(*low, 0.0), (*high, THICK)], (*cells, 1), mesh.CellType.hexahedron)
    faces = [mesh.locate_entities_boundary(domain, 2, lambda x, y=y: np.isclose(x[1], y)) for y in (low[1], high[1])]
    facets = np.sort(np.concatenate(faces))
    tags = mesh.meshtags(domain, 2, facets, np.where(np.isin(facets, faces[0]), BOTTOM, TOP).astype(np.int32))
    V = fem.functionspace(domain, ("Lagrange", order, (3,)))
    W, _ = V.sub(2).collapse()

    def on_planes(x):
        return (np.isclose(x[2], 0.0) | np.isclose(x[2], THICK)) & held(x)

    nodes = fem.locate_dofs_geometrical((V.sub(2), W), on_planes)
    return fem.Function(V), tags, fem.dirichletbc(fem.Function(W), nodes, V.sub(2))


def everywhere(x):
    return np.ones(x.shape[1], dtype=bool)


def slice_on_slab(gap, order=1, held=everywhere, **options):
    """A slice of a block, to be pressed on a slab and dragged: (problem, place of its top, the slab's support)."""
    u, slab_tags, slab_plane = block((0.0, 0.0), (1.0, 0.5), (4, 2), order, held)
    v, tags, plane = block((0.1, 0.5 + gap), (0.9, 1.0 + gap), (5, 2), order, everywhere)
    moved = fem.Constant(v.function_space.mesh, np.zeros(3))
    supports = []
    for w, where, value, face in ((u, slab_tags, np.zeros(3), BOTTOM), (v, tags, moved, TOP)):
        V = w.function_space
        supports.append(fem.dirichletbc(value, fem.locate_dofs_topological(V, 2, where.find(face)), V))
    law = materials.neo_hookean(1e6, 0.3)
    bodies = [Body(u, law, bcs=[supports[0], slab_plane]), Body(v, law, bcs=[supports[1], plane])]
    sides = Surface(v.function_space.mesh, tags, BOTTOM), Surface(u.function_space.mesh, slab_tags, TOP)
    return ContactProblem(bodies, contacts=[Contact(*sides, friction=0.3, **options)]), moved, supports[0]


@pytest.mark.parametrize("order, integration", [(1, "gauss"), (1, "segments"), (2, "gauss")])
def test_a_slice_presses_as_much_from_any_distance(order, integration):
    """With a gap of more than a facet the nodes on the planes were kept, and stuck points had any force along z: 536 N of
    2069, and a drag of 513 iterations.."""
    found = []
    for gap in (0.0, 0.3):
        problem, top, support = slice_on_slab(gap, order, integration=integration)
        press, drag = ((x, -gap - DEEP, 0.0) for x in (0.0, DEEP))
        steps = list(quasistatic.march(problem, [Stage(top, press, 2), Stage(top, drag, 2)]))
        force = problem.pairs[0].force()
        assert abs(force[2]) < 1e-4 * force[1]
        assert sum(step.iterations for step in steps) <= 8 and not any(step.rejected for step in steps)
        found.append(reaction(problem, support).force[:2])
    assert np.allclose(*found, rtol=1e-2)  # the way to the first touch is told from the increment before


def test_a_slice_slides_onto_what_is_held():
    """The slab is held along z in its right half alone: the block's nodes have a multiplier along z on the left, and none on
    the right, and have one again on the way back."""
    problem, top, _ = slice_on_slab(0.0, held=lambda x: x[0] > 0.45)
    (pair,) = problem.pairs
    idle, forces = [], []
    stages = [Stage(top, (x, -DEEP, 0.0), 4) for x in (-0.4, 0.0, -0.4)]
    for step in quasistatic.march(problem, stages):
        idle.append(problem.comm.allreduce(len(pair.multiplier.idle)))
        forces.append(pair.force())
        assert step.iterations <= 12 and step.rejected == 0
    assert idle[3] < idle[7] and idle[11] == idle[3]
    assert np.abs(np.array(forces)[:, 2]).max() < 1e-3 * np.array(forces)[:, 1].max()


def rectangle(low, high, cells, held):
    """A rectangle whose nodes are led where `held` says: (displacement, tags of its bottom and top, place, condition)."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [low, high], cells, mesh.CellType.quadrilateral)
    faces = [mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (low[1], high[1])]
    facets = np.sort(np.concatenate(faces))
    tags = mesh.meshtags(domain, 1, facets, np.where(np.isin(facets, faces[0]), BOTTOM, TOP).astype(np.int32))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    place = fem.Constant(domain, np.zeros(2))
    return fem.Function(V), tags, place, fem.dirichletbc(place, fem.locate_dofs_geometrical(V, held), V)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_tool_that_begins_beside_a_clamp(friction):
    """All of its nodes are led, and the bar's nearest one is clamped, half a metre away: the tool's multipliers are needed
    where it is put down, in one step. Without them it lies 1.5 mm deep in the bar, under 20 080 N."""
    u, bar_tags, _, clamp = rectangle((0.0, 0.0), (1.0, 0.2), (10, 2), lambda x: np.isclose(x[0] * x[1], 0.0))
    v, tags, place, led = rectangle((-0.6, 0.25), (-0.1, 0.45), (5, 2), everywhere)
    law = materials.neo_hookean(1e6, 0.3)
    sides = Surface(v.function_space.mesh, tags, BOTTOM), Surface(u.function_space.mesh, bar_tags, TOP)
    bodies = [Body(u, law, bcs=[clamp]), Body(v, law, bcs=[led])]
    problem = ContactProblem(bodies, contacts=[Contact(*sides, friction=friction)])
    (step,) = quasistatic.march(problem, place, to=(0.8, -0.055), increments=1)
    (pair,) = problem.pairs
    assert step.rejected == 0 and pair.penetration() < 1e-9
    assert pair.force()[1] == pytest.approx(20713.0, rel=0.02)


def clamped_sheet(n):
    """A flat sheet of 2 m × 2 m, n × n squares cut in triangles, clamped all round: (u, tags, condition)."""
    x, z = (a.ravel() for a in np.meshgrid(*2 * [np.linspace(-1.0, 1.0, n + 1)], indexing="ij"))
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()[:, None]
    cells = (first + np.array([0, n + 1, n + 2, 0, n + 2, 1])).reshape(-1, 3)
    own = slice(None) if MPI.COMM_WORLD.rank == 0 else slice(0)
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,))
    X = np.column_stack([x, 0 * x, z])
    domain = mesh.create_mesh(MPI.COMM_WORLD, cells=cells[own], x=X[own], e=element)
    domain.topology.create_connectivity(1, 2)
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    rim = mesh.locate_entities_boundary(domain, 1, lambda x: np.ones(x.shape[1], dtype=bool))
    clamped = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 1, rim), V)
    facets = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    return fem.Function(V), mesh.meshtags(domain, 2, facets, np.ones_like(facets)), clamped


@pytest.mark.parametrize("cells", [(4, 6), (6, 4)])
def test_sheets_clamped_in_one_frame_press_on_each_other(cells):
    """The corner facet of the coarser one has prescribed nodes alone, opposite which the finer one is prescribed, too, but
    not within the facet: where it was the contactor, the march ended for an overlap of prescribed surfaces. The lower sheet
    bears about half of 3000 Pa, to 4 % with either role (swapped 2.7 % apart in the sag)."""
    (u, tags, clamped), (v, upper_tags, upper_clamped) = (clamped_sheet(n) for n in cells)
    sheet = membrane.neo_hookean_membrane(E=1e6, nu=0.3, thickness=0.01)
    lower, upper = u.function_space.mesh, v.function_space.mesh
    p, dx = fem.Constant(upper, 0.0), ufl.Measure("dx", domain=upper)
    pressed = Body(v, sheet, external=loads.membrane_pressure(v, p, [0, -1, 0], dx), bcs=[upper_clamped])
    sides = Surface(lower, tags, 1, side=[0, 1, 0]), Surface(upper, upper_tags, 1, side=[0, -1, 0])
    problem = ContactProblem([Body(u, sheet, bcs=[clamped]), pressed], contacts=[Contact(*sides)])
    steps = list(quasistatic.march(problem, p, to=3000.0, increments=3))
    assert sum(step.rejected for step in steps) == 0 and max(step.iterations for step in steps) <= 8
    sag = problem.comm.allreduce(u.x.array.min(), MPI.MIN)
    assert sag == pytest.approx(-0.4245, rel=0.04)


@pytest.mark.parametrize("order, integration", [(1, "gauss"), (2, "segments")])
def test_surfaces_that_end_at_supports_a_hair_apart(order, integration):
    """Two plates held at their sides, pressed together; then the upper supports go on by a ten thousandth of a facet. The
    contactor's last node had an equation of its own then, and the force was 9 % (order 1) and -3 % off."""
    corners = [[(-1.0, 0.0), (1.0, 0.3)], [(-1.0, -0.3), (1.0, 0.0)]]
    shift, bodies, sides = None, [], []
    for (low, high), sign in zip(corners, (-1.0, 1.0), strict=True):
        domain = mesh.create_rectangle(MPI.COMM_WORLD, [low, high], (4, 1), mesh.CellType.quadrilateral)
        faced = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
        pressed = mesh.locate_entities_boundary(domain, 1, lambda x: ~np.isclose(x[1], 0.0) & (np.abs(x[0]) < 0.75))
        facets = np.concatenate([faced, pressed])
        order_of = np.argsort(facets)
        values = np.repeat([BOTTOM, TOP], [len(faced), len(pressed)]).astype(np.int32)
        tags = mesh.meshtags(domain, 1, facets[order_of], values[order_of])
        V = fem.functionspace(domain, ("Lagrange", order, (2,)))
        held = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(np.abs(x[0]), 1.0))
        place = fem.Constant(domain, np.zeros(2))
        shift = shift or place
        load = ufl.as_vector([0.0, sign * 1e6]), ufl.Measure("ds", domain, subdomain_data=tags)(TOP)
        support = fem.dirichletbc(place, fem.locate_dofs_topological(V, 1, held), V)
        bodies.append(Body(fem.Function(V), materials.neo_hookean(1e9, 0.3), external=[load], bcs=[support]))
        sides.append(Surface(domain, tags, BOTTOM))
    problem = ContactProblem(bodies, contacts=[Contact(*sides, integration=integration)])
    solver, forces = NewtonSolver(problem), []
    for x in (0.0, 5e-5):
        shift.value[0] = x
        assert solver.solve().converged
        problem.commit()
        forces.append(problem.pairs[0].force()[1])
    assert abs(forces[1] / forces[0] - 1) < 1e-3
