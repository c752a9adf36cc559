"""How many Gauss points a facet has: what the target's facets that it faces ask for, its surface and its corners."""

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import CellType, create_box, exterior_facet_indices, locate_entities_boundary, meshtags
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, quasistatic
from dolfinx_mortar_al.verify.meshes import build, graded, half_space
from dolfinx_mortar_al.verify.model import elastic_work, hold, make_contact, measures, space

FAR, SURFACE, OTHER_FAR, OTHER_SURFACE = 1, 2, 3, 4


def points_on(contactor, target, order):
    """(nf, 2) ends and (nf,) number of points of the facets of a contactor on a target, both from 0 to 8 m."""
    bodies = [
        half_space([x], np.array([0.0, 1.0]), up, 0.0, {(1, 0): surface, (1, -1): far}, order=order)
        for x, up, surface, far in ((contactor, True, SURFACE, FAR), (target, False, OTHER_SURFACE, OTHER_FAR))
    ]
    domain, cells, facets = build(bodies)
    V, u = space(domain, order)
    F = elastic_work(u, 1.0, 0.3, measures(domain, cells, facets)[0])
    contact = make_contact(Surface(domain, facets, SURFACE), Surface(domain, facets, OTHER_SURFACE))
    problem = ContactProblem(F, u, bcs=[hold(V, facets, FAR), hold(V, facets, OTHER_FAR)], contacts=[contact])
    assert isinstance(u, fem.Function)
    pair = problem.pairs[0]
    ends = np.sort(pair.facets.X[:, :, 0], axis=1)[:, [0, -1]]
    return ends, np.bincount(pair.integration.facet, minlength=pair.facets.size), pair


@pytest.mark.parametrize("order", [1, 2])
def test_each_facet_has_the_points_that_the_facets_it_faces_ask_for(order):
    """Where the target is graded: two points per facet of the target, or the least."""
    target = graded(1.0, 16, 8.0)
    ends, count, pair = points_on(np.linspace(0.0, 8.0, 17), target, order)
    sizes = np.diff(target)
    least = max({1: 6, 2: 5}[order], int(np.ceil(2 * 0.5 / sizes.mean())))  # for the mean, onto which they may slide
    for (start, end), n in zip(ends, count, strict=True):
        rim = 0.12 * (end - start)  # outside the outermost points
        finest = sizes[(target[1:] > start + rim) & (target[:-1] < end - rim)].min()
        assert n >= min(16, 2 * (end - start) / finest)
        if start > 3.0:
            assert n == least
    total = pair.integration.sum_by_facet(pair.j[:, None])[:, 0]
    assert total == pytest.approx(ends[:, 1] - ends[:, 0], rel=1e-12)


def test_a_graded_contactor_has_no_more_points_where_it_is_fine():
    """On equally graded surfaces the small facets, where contact is, have the least; before all had the most, 16."""
    x = graded(1.0, 16, 8.0)
    ends, count, _ = points_on(x, x, 2)
    assert (count[ends[:, 1] <= 1.0 + 1e-9] == 5).all()


def on_a_plane(n, order, cell, place=lambda x: x, whole=True):
    """The pair of a cube [−1, 1]³ of n³ cells, its nodes moved by `place`, whose whole boundary, or bottom alone, is in
    contact with a rigid plane."""
    domain = create_box(MPI.COMM_WORLD, [[-1.0] * 3, [1.0] * 3], [n] * 3, cell)
    bottom = locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], -1.0))
    domain.topology.create_connectivity(2, 3)
    facets = exterior_facet_indices(domain.topology) if whole else bottom
    domain.geometry.x[:] = place(domain.geometry.x)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", order, (3,))))
    F = materials.saint_venant_kirchhoff(1.0, 0.3).virtual_work(u)
    surface = Surface(domain, meshtags(domain, 2, np.sort(facets), np.ones(len(facets), dtype=np.int32)), 1)
    plane = obstacles.RigidPlane([0.0, 0.0, -2.0], [0.0, 0.0, 1.0])
    return ContactProblem(F, u, contacts=[Contact(surface, plane)]).pairs[0]


def ball(x):
    return x * (np.abs(x).max(axis=1) / np.maximum(np.linalg.norm(x, axis=1), 1e-300))[:, None]


@pytest.mark.parametrize("cell", [CellType.tetrahedron, CellType.hexahedron])
@pytest.mark.parametrize("order, n", [(1, 1), (1, 3), (1, 5), (2, 2)])
def test_a_corner_of_a_coarse_ball_is_felt_before_it_is_in_a_plane(cell, order, n):
    """By 2 % of a facet, which is said to be an overlap; the normal of the plane is the ball's. With the degree 4 × order
    it would be 4 (n = 2, order 2, hexahedra) to 22 % (n = 1, tetrahedra)."""
    pair = on_a_plane(n, order, cell, ball)
    facets, points = pair.facets, pair.integration
    corners = facets.X[:, : len(facets.shape.corners)]
    normal = corners / np.linalg.norm(corners, axis=2, keepdims=True)
    apart = corners[points.facet] - points.interpolate(facets.X)[:, None]
    depth = np.einsum("nci,nci->nc", apart, normal[points.facet]) / np.sqrt(facets.areas())[points.facet, None]
    felt = np.full(corners.shape[:2], np.inf)
    np.minimum.at(felt, points.facet, depth)
    assert felt.max(initial=0.0) < 0.0225  # mean normals are not quite the ball's
    total = pair.comm.allreduce(float(pair.j.sum()))
    assert total == pytest.approx(pair.comm.allreduce(float(facets.areas().sum())), rel=1e-5)  # curved ones


@pytest.mark.parametrize("cell", [CellType.tetrahedron, CellType.hexahedron])
def test_a_surface_of_few_facets_has_many_points_and_one_of_many_the_least(cell):
    def points(n):
        pair = on_a_plane(n, 1, cell, whole=False)
        size = pair.comm.allreduce(pair.integration.size)
        return size, size / pair.comm.allreduce(pair.facets.size)

    least = {CellType.tetrahedron: 6, CellType.hexahedron: 9}[cell]
    assert points(2)[0] >= 0.8 * 32**2  # on triangles a rule has fewer than on squares
    assert points(16)[1] == least


@pytest.mark.parametrize("facets, said", [(3, True), (10, False)])
def test_contact_on_parts_of_facets_is_said(facets, said):
    """A ball of eight cells across pressed into a flat stiff plate of n × n facets, the contactor. With n = 3 contact is in
    the middle of one facet, whose nodes all are where nothing is pressed: less than half of the force (otherwise Hertz'
    within a fifth), and the ball is a tenth of a facet in the plate."""
    R, E, ν, depth = 1.0, 1e6, 0.45, 0.15
    sphere = create_box(MPI.COMM_WORLD, [[-1.0] * 3, [1.0] * 3], [8] * 3, CellType.hexahedron)
    sphere.geometry.x[:] = ball(sphere.geometry.x) + np.array([0.0, 0.0, R])
    plate = create_box(MPI.COMM_WORLD, [[-1.2, -1.2, -0.4], [1.2, 1.2, 0.0]], [facets, facets, 2], CellType.hexahedron)
    bodies, surfaces, push = [], [], fem.Constant(sphere, np.zeros(3))
    for domain, modulus, held, touching, value in (
        (sphere, E, lambda x: x[2] > 1.75, lambda x: x[2] < 1.05, push),
        (plate, 1e3 * E, lambda x: x[2] < -0.399, lambda x: x[2] > -1e-6, fem.Constant(plate, np.zeros(3))),
    ):
        V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
        u = fem.Function(V)
        dofs = fem.locate_dofs_topological(V, 2, locate_entities_boundary(domain, 2, held))
        bodies.append(Body(u, materials.neo_hookean(E=modulus, nu=ν), bcs=[fem.dirichletbc(value, dofs, V)]))
        found = np.sort(locate_entities_boundary(domain, 2, touching))
        surfaces.append(Surface(domain, meshtags(domain, 2, found, np.ones(len(found), dtype=np.int32)), 1))
    problem = ContactProblem(bodies, contacts=[Contact(surfaces[1], surfaces[0])])
    *_, last = quasistatic.march(problem, quasistatic.Stage(push, (0.0, 0.0, -depth), 3))
    hertz = 4 / 3 * E / (1 - ν**2) * np.sqrt(R) * depth**1.5
    share = abs(problem.pairs[0].force()[2]) / hertz
    assert (share > 0.8) is not said and share < 1.0
    names = [finding.name for finding in last.findings]
    assert ("contact: overlap in contact (facets)" in names) is said
