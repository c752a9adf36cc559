"""Nearly incompressible bodies: Newton's derivative with the foreseen pressure, and what marches take with it."""

import numpy as np
import pytest
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc as dolfinx_petsc

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, quasistatic
from dolfinx_mortar_al.materials import deformation_gradient
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import space

TOP, BOTTOM = 1, 2


def block(dim: int = 2, cells: int = 6):
    """A unit cube or square of order 2, its mesh's tags, space and displacement."""
    faces = {(dim - 1, -1): TOP, (dim - 1, 0): BOTTOM}
    domain, _, tags = build([grid([np.linspace(0, 1, cells + 1)] * dim, faces)])
    return domain, tags, *space(domain, 2)


def bent(u: fem.Function, by: float) -> None:
    """Some displacement of this size."""
    u.interpolate(lambda x: by * np.stack([np.sin(3 * x[0] + k) * np.cos(2 * x[1] - k) for k in range(len(u))]))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", ["neo_hookean", "saint_venant_kirchhoff"])
def test_derivative_is_that_of_the_residual_with_the_foreseen_pressure_in_place_of_the_present_one(law, dim):
    """Against differences of the residual and of ∫ (q foreseen − q) Dθ with that factor as it is: 1e-7 is what central
    differences of a step of 1e-5 leave."""
    *_, V, u = block(dim, cells=2)
    bent(u, 0.02)
    material = getattr(materials, law)(1.0, 0.499)
    body = Body(u, material)
    foreseen, before = body.foreseen, u.copy()
    assert foreseen is not None
    foreseen.begin(u.x.array)
    foreseen.advance()
    bent(u, 0.05)
    foreseen.look()
    v, now, step = ufl.TestFunction(V), u.copy(), u.copy()
    step.x.array[:] -= before.x.array
    θ_before = material.volume_strain(deformation_gradient(before))
    q = θ_before + ufl.derivative(θ_before, before, step)
    q -= material.volume_strain(deformation_gradient(now))
    θ = material.volume_strain(deformation_gradient(u))
    residual = body.residual + material.lame * q * ufl.derivative(θ, u, v) * body.dx

    way, shift = fem.Function(V), 1e-5
    way.interpolate(lambda x: np.stack([np.cos(4 * x[0] - k * x[1]) for k in range(dim)]))
    derivative = ufl.action(ufl.derivative(body.residual, u) + foreseen.form, way)
    exact = fem.assemble_vector(fem.form(derivative)).array.copy()
    sides = []
    for sign in (1.0, -1.0):
        u.x.array[:] = now.x.array + sign * shift * way.x.array
        sides.append(fem.assemble_vector(fem.form(residual)).array.copy())
    assert np.abs((sides[0] - sides[1]) / (2 * shift) - exact).max(initial=0.0) < 1e-7 * max(
        np.abs(exact).max(initial=1.0), 1.0
    )


def test_at_a_converged_state_it_is_the_derivative():
    """Nothing is foreseen there but what is: quadratic convergence to the same states, and the same stability."""
    *_, u = block()
    bent(u, 0.05)
    body = Body(u, materials.neo_hookean(1.0, 0.4999))
    assert body.foreseen is not None
    body.foreseen.begin(u.x.array)
    body.foreseen.look()
    more = dolfinx_petsc.assemble_matrix(fem.form(body.foreseen.form))
    more.assemble()
    assert more.norm() < 1e-9 * materials.lame(1.0, 0.4999)[1]


def test_compressible_bodies_do_without():
    *_, u = block(cells=1)
    assert Body(u, materials.neo_hookean(1.0, 0.4)).foreseen is None
    assert Body(u, materials.neo_hookean(1.0, 0.49)).foreseen is not None


def pressed(ν: float, with_body: bool) -> tuple[ContactProblem, list[quasistatic.Step]]:
    """A block glued at its top and pressed on a rough rigid floor by a third of its height in five increments."""
    domain, tags, V, u = block()
    down = fem.Constant(domain, np.zeros(2, dtype=default_scalar_type))
    dofs = fem.locate_dofs_topological(V, 1, tags.find(TOP))
    law, bc = materials.neo_hookean(1.0, ν), fem.dirichletbc(down, dofs, V)
    contact = Contact(Surface(domain, tags, BOTTOM), obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0]), friction=0.3)
    made = (Body(u, law, bcs=[bc]),) if with_body else (law.virtual_work(u), u)
    problem = ContactProblem(*made, bcs=[] if with_body else [bc], contacts=[contact])
    return problem, list(quasistatic.march(problem, down, to=(0.0, -0.3), increments=5))


@pytest.mark.parametrize("ν", [0.499, 0.4999])
def test_a_rubber_block_is_pressed_in_few_iterations(ν):
    """Fifteen and nineteen; with the residual's own derivative 105 and 164, and three and four rejected trials."""
    _, steps = pressed(ν, with_body=True)
    assert sum(step.rejected for step in steps) == 0
    assert sum(step.iterations for step in steps) <= 25


def test_the_state_is_that_of_the_residual_alone():
    """Of a Body and of its residual, whose derivative Newton takes as it is: the same displacements to Newton's tolerance."""
    (mine, _), (plain, _) = (pressed(0.49, with_body) for with_body in (True, False))
    assert np.abs(mine.bodies.get() - plain.bodies.get()).max(initial=0.0) < 1e-8
