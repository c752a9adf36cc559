"""Each body has tolerances of its own: a soft body beside a stiff one, in any unit of length."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary
from scenes import contact_of, tip

from dolfinx_mortar_al import ContactProblem, loads, materials, quasistatic
from meshes.two_beams import LOWER, UPPER, TwoBeams

NU, STRAIN = 0.3, 1e-6


def stacked(lower, upper, unit, friction):
    """Two blocks of height `unit` on each other, of Young's moduli `lower` and `upper`, that can move vertically only, under
    a dead pressure on top: (problem, pressure)."""
    mesh, cells, facets = TwoBeams(height=1.0, along=(3, 3), across=2).create()
    mesh.geometry.x[:] *= unit
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u, p = fem.Function(V), fem.Constant(mesh, 0.0)
    dx = ufl.Measure("dx", mesh, subdomain_data=cells)
    moduli = {LOWER: fem.Constant(mesh, lower), UPPER: fem.Constant(mesh, upper)}
    F = sum(materials.saint_venant_kirchhoff(E, NU).virtual_work(u, dx=dx(k)) for k, E in moduli.items())
    on_top = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(mesh)[1], fem.Constant(mesh, 0.999 * unit)), 1.0, 0.0)
    F -= loads.dead_traction(u, ufl.as_vector([0.0, -p * on_top]), ufl.ds(mesh))
    bottom = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1] / unit, -1.0))
    everywhere = np.arange(V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts, dtype=np.int32) * 2
    bcs = [
        fem.dirichletbc(0.0, fem.locate_dofs_topological(V.sub(1), 1, bottom), V.sub(1)),
        fem.dirichletbc(0.0, everywhere, V.sub(0)),
    ]
    return ContactProblem(F, u, bcs=bcs, contacts=[contact_of(mesh, facets, friction=friction)]), p


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e3])
@pytest.mark.parametrize("ratio", [1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9])
def test_a_soft_body_beside_a_stiff_one(ratio, unit):
    """Uniaxial strain, p h/M per block with M = E (1 − ν)/((1 + ν)(1 − 2ν)): the top and the contact force to 1e-5 (the
    law's curvature at a strain of 1e-6 is below that)."""
    lower, upper = 2e6, 2e6 * ratio
    problem, p = stacked(lower, upper, unit, friction=0.3)
    M1, M2 = (E * (1 - NU) / ((1 + NU) * (1 - 2 * NU)) for E in (lower, upper))
    pressure = STRAIN * min(M1, M2)
    iterations = [s.iterations for s in quasistatic.march(problem, p, to=pressure, increments=1)]
    assert iterations[0] > 0
    top, interface = tip(problem, (unit, unit))[1], tip(problem, (unit, -unit))[1]
    assert interface == 0.0
    assert top / unit == pytest.approx(-pressure * (1 / M1 + 1 / M2), rel=1e-5)
    assert problem.pairs[0].force()[1] == pytest.approx(pressure * unit, rel=1e-5)
