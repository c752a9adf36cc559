"""What DOLFINx of one version or another would lose."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

from dolfinx_mortar_al import ContactProblem, loads, materials
from meshes.two_beams import CLAMP, LOWER, UPPER, TwoBeams


def test_the_weight_of_one_of_two_bodies_of_one_material():
    """Equal integrands on two subdomains and a load of other metadata on one of them, which DOLFINx 0.9 alone would lose: the
    bottom carries the weight to 1e-9 of it."""
    mesh, cells, facets = TwoBeams(along=(4, 4), across=1).create()
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u, weight = fem.Function(V), fem.Constant(mesh, (0.0, 0.0))
    dx = ufl.Measure("dx", mesh, subdomain_data=cells)
    F = sum(materials.saint_venant_kirchhoff(2e6, 0.3).virtual_work(u, dx=dx(k)) for k in (LOWER, UPPER))
    F -= loads.dead_traction(u, weight, dx(UPPER))
    clamp = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, facets.find(CLAMP)), V)
    problem = ContactProblem(F, u, bcs=[clamp], contacts=[])
    weight.value[:] = (0.0, -3.0)
    total = mesh.comm.allreduce(problem.bodies.bodies[0].residual().sum())
    area = mesh.comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * dx(UPPER))))
    assert total == pytest.approx(3.0 * area, rel=1e-9)
