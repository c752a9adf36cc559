"""First Piola stresses against the derivative of their stored energies."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_cube, create_unit_square
from mpi4py import MPI

from dolfinx_mortar_al import materials

pytestmark = pytest.mark.one_rank


@pytest.mark.parametrize("law", [materials.saint_venant_kirchhoff, materials.neo_hookean])
@pytest.mark.parametrize("dim", [2, 3])
def test_stress_is_the_derivative_of_the_energy(law, dim):
    mesh = create_unit_square(MPI.COMM_SELF, 1, 1) if dim == 2 else create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    V = fem.functionspace(mesh, ("Lagrange", 2, (dim,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    u.x.array[:] = 0.05 * np.random.default_rng(0).standard_normal(u.x.array.shape)
    material = law(E=2.0, nu=0.3)
    dx = ufl.dx(metadata={"quadrature_degree": 4})
    energy = material.energy(materials.deformation_gradient(u)) * dx
    a = fem.assemble_vector(fem.form(material.virtual_work(u, v))).array
    b = fem.assemble_vector(fem.form(ufl.derivative(energy, u, v))).array
    assert np.allclose(a, b, atol=1e-13 * np.abs(b).max() * len(b))  # the same integrand up to round-off


@pytest.mark.parametrize("E, nu", [(-1.0, 0.3), (0.0, 0.3), (float("nan"), 0.3), (1.0, 0.5), (1.0, -1.0)])
def test_impossible_moduli_are_refused(E, nu):
    with pytest.raises(ValueError, match=r"E = |nu = "):
        materials.saint_venant_kirchhoff(E, nu)


@pytest.mark.parametrize("constant", [False, True])
def test_a_poisson_ratio_whose_forces_are_round_off_is_refused(constant):
    domain = create_unit_square(MPI.COMM_SELF, 1, 1)
    for law in (materials.neo_hookean, materials.saint_venant_kirchhoff):
        for gap in (1e-7, 1e-10, 1e-12):
            nu = fem.Constant(domain, 0.5 - gap) if constant else 0.5 - gap
            with pytest.raises(ValueError, match=r"nu = 0\.49999.*round-off takes the digits of forces; take 0\.4999"):
                law(1.0, nu)
        law(1.0, fem.Constant(domain, 0.499999) if constant else 0.499999)
