"""ε follows what a surface yields to pressure, not the volume's stiffness; and cells that lock are told."""

import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, quasistatic
from dolfinx_mortar_al.bodies import BodyForms
from dolfinx_mortar_al.moduli import yielding_share
from dolfinx_mortar_al.monitors import ModelWarning
from meshes.two_beams import LOWER_TOP, UPPER_BOTTOM, TwoBeams

SQUARES = [mesh.CellType.triangle, mesh.CellType.quadrilateral]
CUBES = [mesh.CellType.tetrahedron, mesh.CellType.hexahedron]


def block(cell, order, n=4):
    if cell in SQUARES:
        domain = mesh.create_unit_square(MPI.COMM_WORLD, n, n - 1, cell)
    else:
        domain = mesh.create_unit_cube(MPI.COMM_WORLD, 3, 2, 2, cell)
    return fem.Function(fem.functionspace(domain, ("Lagrange", order, (domain.geometry.dim,))))


def at_boundary(u, F):
    """yielding_share at this rank's boundary nodes."""
    domain = u.function_space.mesh
    share = yielding_share(u.function_space, BodyForms(F, u, [], None).stiffness())
    domain.topology.create_connectivity(domain.topology.dim - 1, domain.topology.dim)
    facets = mesh.exterior_facet_indices(domain.topology)
    nodes = fem.locate_dofs_topological(u.function_space, domain.topology.dim - 1, facets)
    return share.x.array[:: domain.geometry.dim][nodes]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", SQUARES + CUBES)
def test_share_of_the_modulus(cell, order):
    """E'/M to 1e-9 at every node of the boundary (round-off of λ/G = 5000 at ν = 0.4999)."""
    for nu in (-0.5, 0.0, 0.3, 0.4999):
        u = block(cell, order)
        ν = fem.Constant(u.function_space.mesh, nu)  # one form for all
        share = at_boundary(u, materials.neo_hookean(1e6, ν).virtual_work(u))
        M = (1 - nu) / ((1 + nu) * (1 - 2 * nu))
        exact = 1 / (1 - nu**2) / M
        off = np.abs(share / exact - 1).max(initial=0.0)
        assert MPI.COMM_WORLD.allreduce(off, MPI.MAX) < 1e-9


@pytest.mark.parametrize("cell", [SQUARES[0], CUBES[1]])
@pytest.mark.parametrize("θ", [np.pi / 4, np.pi / 2, 3.0])
def test_a_body_that_the_start_has_turned(cell, θ):
    """E'/M is that of the body as it is in the mesh, to round-off, whatever the displacement at the start. Of one turned by a
    right angle it was 1e-14, with ε nothing and a word of ν = .5."""
    u = block(cell, 1)
    domain, d = u.function_space.mesh, u.function_space.mesh.geometry.dim
    forms = BodyForms(materials.neo_hookean(1e6, 0.3).virtual_work(u), u, [], None)
    share = forms.yielding_share(forms.stiffness()).x.array.copy()
    Q = np.eye(d)
    Q[:2, :2] = [[np.cos(θ), -np.sin(θ)], [np.sin(θ), np.cos(θ)]]
    u.interpolate(lambda x: Q @ x[:d] - x[:d])
    put = u.x.array.copy()
    turned = forms.yielding_share(forms.stiffness()).x.array
    assert np.array_equal(u.x.array, put)
    assert domain.comm.allreduce(float(np.abs(turned - share).max(initial=0.0)), MPI.MAX) < 1e-12


@pytest.mark.parametrize("nu", [0.0, 0.2, 0.3, 0.4])
def test_the_inside_of_a_body_says_nothing(nu):
    """A uniform strain meets no force there, and round-off's were taken for moduli (ν = .4994 for .3 on meshes of gmsh's)."""
    u = block(mesh.CellType.triangle, 1, 40)
    X = u.function_space.mesh.geometry.x
    inside = ((X[:, :2] > 1e-9) & (X[:, :2] < 1 - 1e-9)).all(axis=1)
    X[inside, :2] += 0.005 * np.sin(50 * X[inside, :2] + 80 * X[inside, 1::-1])
    F = materials.neo_hookean(70e3, nu).virtual_work(u)
    share = yielding_share(u.function_space, BodyForms(F, u, [], None).stiffness()).x.array
    exact = (1 + nu) * (1 - 2 * nu) / ((1 - nu**2) * (1 - nu))
    assert MPI.COMM_WORLD.allreduce(share.min(initial=1.0), MPI.MIN) > exact - 1e-6
    far = (np.abs(u.function_space.tabulate_dof_coordinates()[:, :2] - 0.5) < 0.4).all(axis=1)
    assert (share.reshape(-1, 2)[far] == 1.0).all()


def test_springs_leave_it_alone():
    """With an elastic foundation of the body's own stiffness the diagonal counts as it is."""
    u = block(mesh.CellType.triangle, 1)
    F = (
        materials.neo_hookean(1e6, 0.49).virtual_work(u)
        + 1e9 * ufl.inner(u, ufl.TestFunction(u.function_space)) * ufl.dx
    )
    assert MPI.COMM_WORLD.allreduce(np.abs(at_boundary(u, F) - 1).max(initial=0.0), MPI.MAX) == 0.0


@pytest.mark.parametrize(
    ("order", "nu", "says"), [(1, 0.4999, "0.4999"), (1, 0.495, "0.495"), (1, 0.45, ""), (2, 0.4999, "")]
)
@pytest.mark.parametrize("as_form", [False, True])
def test_cells_that_lock_are_told(order, nu, says, as_form):
    """Of order 1 and nearly incompressible, whatever the form: once, as the problem is made, with ν read off it."""
    u = block(mesh.CellType.quadrilateral, order)
    law = materials.saint_venant_kirchhoff(1e6, nu)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ContactProblem(law.virtual_work(u), u) if as_form else ContactProblem(Body(u, law))
    said = [w for w in caught if issubclass(w.category, ModelWarning)]
    assert len(said) == (says != "" and MPI.COMM_WORLD.rank == 0)
    assert all(f"u[0] is of order 1 in a nearly incompressible body (ν = {says})" in str(w.message) for w in said)
    assert all(w.filename == __file__ for w in said)


@pytest.mark.parametrize("nu", [0.49, 0.4999])
def test_nearly_incompressible_blocks(nu):
    """Two blocks of P2 pressed to 5 %: no rejection, at most 8 iterations a step (3 to 7 seen). With ε from M there is no
    convergence at ν = 0.4999."""
    domain, _, facets = TwoBeams(height=0.5, along=(6, 4), across=2).create()
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, down = fem.Function(V), fem.Function(V)
    F = materials.neo_hookean(1e6, nu).virtual_work(u)
    ends = [mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (-0.5, 0.5)]
    bottom, top = (fem.locate_dofs_topological(V, 1, end) for end in ends)
    bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(down, top)]
    contact = Contact(Surface(domain, facets, UPPER_BOTTOM), Surface(domain, facets, LOWER_TOP), friction=0.3)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])

    def load(value):
        down.x.array[1::2] = -value

    steps = list(quasistatic.march(problem, load, to=0.05, increments=3))
    assert all(step.rejected == 0 and step.iterations <= 8 for step in steps)
