"""Nearly incompressible bodies: Newton's derivative with the foreseen pressure, and what marches take with it."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as dolfinx_petsc
from rubber import Scene, pressed

from dolfinx_mortar_al import Body, materials, quasistatic
from dolfinx_mortar_al.materials import deformation_gradient
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import space


def block(dim: int = 2, cells: int = 6):
    """A unit cube or square, its displacement's space of order 2, and the displacement."""
    domain, *_ = build([grid([np.linspace(0, 1, cells + 1)] * dim, {})])
    return space(domain, 2)


def bent(u: fem.Function, by: float) -> None:
    """Some displacement of this size."""
    u.interpolate(lambda x: by * np.stack([np.sin(3 * x[0] + k) * np.cos(2 * x[1] - k) for k in range(len(u))]))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", ["neo_hookean", "saint_venant_kirchhoff"])
def test_derivative_is_that_of_the_residual_with_the_foreseen_pressure_in_place_of_the_present_one(law, dim):
    """Against differences of the residual and of ∫ (q foreseen − q) Dθ with that factor as it is: 1e-7 is what central
    differences of a step of 1e-5 leave."""
    V, u = block(dim, cells=2)
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
    _, u = block()
    bent(u, 0.05)
    body = Body(u, materials.neo_hookean(1.0, 0.4999))
    assert body.foreseen is not None
    body.foreseen.begin(u.x.array)
    body.foreseen.look()
    more = dolfinx_petsc.assemble_matrix(fem.form(body.foreseen.form))
    more.assemble()
    assert more.norm() < 1e-9 * materials.lame(1.0, 0.4999)[1]


def test_compressible_bodies_do_without():
    _, u = block(cells=1)
    E, ν = (fem.Constant(u.function_space.mesh, value) for value in (1.0, 0.4))
    for moduli in ((1.0, 0.4), (E, 0.4), (E, ν)):
        assert Body(u, materials.neo_hookean(*moduli)).foreseen is None
    ν.value = 0.49
    for moduli in ((1.0, 0.49), (E, 0.49), (E, ν)):
        assert Body(u, materials.neo_hookean(*moduli)).foreseen is not None


def march(scene: Scene) -> list[quasistatic.Step]:
    return list(quasistatic.march(*scene))


@pytest.mark.parametrize("ν", [0.499, 0.4999])
def test_a_rubber_block_is_pressed_in_few_iterations(ν):
    """Fifteen and nineteen; with the residual's own derivative 105 and 164, and three and four rejected trials."""
    steps = march(pressed(ν))
    assert sum(step.rejected for step in steps) == 0
    assert sum(step.iterations for step in steps) <= 25


def test_the_state_is_that_of_the_residual_alone():
    """Of a Body and of its residual, whose derivative Newton takes as it is: the same displacements to Newton's tolerance."""
    (mine, _), (plain, _) = scenes = [pressed(0.49, with_bodies) for with_bodies in (True, False)]
    for scene in scenes:
        march(scene)
    assert np.abs(mine.bodies.get() - plain.bodies.get()).max(initial=0.0) < 1e-8
