"""Forms are compiled once for all values of the numbers in them, and mean what they say."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_square
from mpi4py import MPI

from dolfinx_mortar_al import loads, materials
from dolfinx_mortar_al.compiling import compiled, compiled_expression

pytestmark = pytest.mark.one_rank


@pytest.fixture
def u():
    mesh = create_unit_square(MPI.COMM_SELF, 2, 2)
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (2,))))
    u.x.array[:] = 0.05 * np.random.default_rng(0).standard_normal(u.x.array.shape)
    return u


def residual(u, E, nu, load, thickness):
    """With numbers of all kinds: in the law, a factor, a list, an exponent and a condition."""
    v, X = ufl.TestFunction(u.function_space), ufl.SpatialCoordinate(u.function_space.mesh)
    body = materials.neo_hookean(E, nu).virtual_work(u, thickness=thickness)
    force = ufl.conditional(ufl.gt(X[0], load / 1e4), 1.0, 0.0) * (1 + X[1]) ** 1.7 * ufl.as_vector((0.3 * load, -load))
    return body - ufl.inner(force, v) * ufl.ds - loads.follower_force(u, load, ufl.ds)


def test_other_numbers_take_the_same_kernels(u):
    cases = [residual(u, *numbers) for numbers in ((2.1e6, 0.3, 3.3e3, 0.1), (71.0, 0.41, 4.7e3, 2.3))]
    for forms in (cases, [ufl.derivative(F, u) for F in cases]):
        assert len({compiled(form, u.function_space.mesh).module.__name__ for form in forms}) == 1


def test_forms_and_expressions_mean_what_they_say(u):
    """To round-off of sums of a few hundred terms."""
    domain, F = u.function_space.mesh, residual(u, 2.1e6, 0.3, 3.3e3, 0.1)
    b, c = (fem.assemble_vector(form).array for form in (fem.form(F), compiled(F, domain)))
    assert np.abs(b - c).max() < 1e-13 * np.abs(b).max()
    J = ufl.derivative(F, u)
    A, B = (fem.assemble_matrix(form).to_dense() for form in (fem.form(J), compiled(J, domain)))
    assert np.abs(A - B).max() < 1e-13 * np.abs(A).max()
    energy, points = materials.neo_hookean(2.1e6, 0.3).energy(materials.deformation_gradient(u)), np.array([[0.2, 0.3]])
    cells = np.arange(8, dtype=np.int32)
    x, y = (
        e.eval(domain, cells) for e in (fem.Expression(energy, points), compiled_expression(energy, points, domain))
    )
    assert np.abs(x - y).max() < 1e-13 * np.abs(x).max()
