"""Contact over a time step: tangent, what rigid motions leave at zero, work, and the velocity projection."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI
from scenes import NU, E, assert_tangent, contact_of, rough, set_field

from dolfinx_mortar_al import ContactProblem
from dolfinx_mortar_al.frames import nodal_normals, rotation
from dolfinx_mortar_al.law import OPEN, SLIP, STICK
from dolfinx_mortar_al.lever import Lever
from dolfinx_mortar_al.materials import saint_venant_kirchhoff
from meshes.two_beams import TwoBeams

EPSILON = 1e7


def bend(X):
    u = np.zeros_like(X)
    u[:, 1] = -0.2 * X[:, 0] ** 2
    u[:, 0] = 0.4 * X[:, 0] * X[:, 1]
    return u


def turned(X, angle):
    """Positions X turned in the plane."""
    turned = X.copy()
    turned[:, 0] = np.cos(angle) * X[:, 0] - np.sin(angle) * X[:, 1]
    turned[:, 1] = np.sin(angle) * X[:, 0] + np.cos(angle) * X[:, 1]
    return turned


def in_step(dim, order, friction, projection, triangles=False):
    """A pair of beams in a step: (problem, u at its end, Λ), of slips and gaps of comparable weight."""
    mesh, _, tags = TwoBeams(height=0.05, along=(9, 8), across=1, dim=dim, triangles=triangles).create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", order, (dim,))))
    options = {"epsilon_normal": EPSILON, "epsilon_tangential": 0.5 * EPSILON, "projection": projection}
    contact = contact_of(mesh, tags, friction=friction, **options)
    problem = ContactProblem(saint_venant_kirchhoff(E, NU).virtual_work(u), u, contacts=[contact])
    pair = problem.pairs[0]
    level = pair.use_steps()
    start = lambda X: bend(X) + rough(2e-4, 1)(X)  # noqa: E731
    end = lambda X: turned(X + bend(X) + rough(3e-4, 2)(X), 0.02) - X  # noqa: E731
    Λ = lambda X: 2e3 * (rough(1, 3)(X) + np.array([0.2, 0.6, 0.1])[: X.shape[1]])  # noqa: E731
    set_field(problem, start, clamped=False)
    level.begin()
    return problem, end, Λ


def closed_by_law(problem, u, Λ):
    """Evaluate at (u, Λ) with the points closed that the law says."""
    set_field(problem, u, Λ, clamped=False)
    problem.pack(problem.x)
    problem.assemble_residual(problem.x, problem.residual)
    pair = problem.pairs[0]
    assert pair.follow()
    pair.apply_law()
    pair.active.closed = pair.kinematics.may_close & (pair.state.λN_hat > 0)
    problem.assemble_residual(problem.x, problem.residual)
    return pair


@pytest.mark.parametrize("projection", ["rays", "closest"])
@pytest.mark.parametrize("friction", [0.0, 0.8])
@pytest.mark.parametrize(
    "dim, order, triangles", [(2, 1, False), (2, 2, False), (3, 1, False), (3, 1, True), (3, 2, True)]
)
def test_directional_derivative(dim, order, triangles, friction, projection):
    """K d against central differences, per block, below 1e-6, with open, slipping and sticking points."""
    problem, end, Λ = in_step(dim, order, friction, projection, triangles)
    direction = [rough(1.0, 4), rough(EPSILON, 5)]

    def at(h):
        set_field(problem, lambda X: end(X) + h * direction[0](X), lambda X: Λ(X) + h * direction[1](X), clamped=False)
        problem.pack(problem.x)
        problem.assemble_residual(problem.x, problem.residual)
        return [part.array.copy() for part in problem.residual.getNestSubVecs()]

    pair = closed_by_law(problem, end, Λ)
    counts = np.bincount(np.concatenate(problem.comm.allgather(pair.state.status)), minlength=3)
    assert counts[OPEN] > 0 and counts[SLIP] > 0 and (counts[STICK] > 0 or friction == 0)
    assert problem.comm.allreduce(np.abs(pair.kinematics._κ).sum()) > 0
    assert_tangent(problem, at, lambda: set_field(problem, direction[0], direction[1], clamped=False), h=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_motion_of_the_gap_is_missed_by_third_order(dim):
    """Δg + 𝐦·𝐰 with the directions of the flight's middle, before κ: an eighth for half the step; a quarter with those of its
    start. A slow step takes one iteration, and what κ leaves where nothing moves relatively is energy from nowhere."""

    start = lambda X: bend(X) + rough(2e-4, 1)(X)  # noqa: E731
    motion = lambda X: turned(X, 1.0) + rough(0.02, 2)(X)  # noqa: E731

    def missed(h, in_flight):
        problem, *_ = in_step(dim, 2, 0.0, "rays")
        level = problem.pairs[0].kinematics
        set_field(problem, lambda X: start(X) + h / 2 * motion(X), clamped=False)
        if in_flight:
            level.predict()
        set_field(problem, start, clamped=False)
        level.begin()
        facets = [level.end.point.facet, level.pair.point.facet]
        set_field(problem, lambda X: start(X) + h * motion(X), clamped=False)
        level.evaluate()
        stay = level.end.facing & level._known & np.logical_and(*(level.end.point.facet == before for before in facets))
        miss = level.end.g - level._g0 + np.einsum("ni,ni->n", level._m, level._w)
        assert problem.comm.allreduce(int(stay.sum())) > 10
        return problem.comm.allreduce(float(np.sum(miss[stay] ** 2))) ** 0.5

    for in_flight, least in ((True, 7.0), (False, 3.5)):
        ratio = missed(0.02, in_flight) / missed(0.01, in_flight)
        assert least < ratio < 1.3 * least, in_flight


@pytest.mark.parametrize("projection", ["rays", "closest"])
@pytest.mark.parametrize("dim", [2, 3])
def test_forces_balance_and_work_is_that_of_the_gap(dim, projection):
    """Nodal forces of contact sum to nothing, about the middle of the step they have no moment, and do ∫ 𝐅·𝐰; the normal part
    does −∫ p Δg, all to round-off of the largest term."""
    problem, end, Λ = in_step(dim, 2, 0.8, projection)
    level = problem.pairs[0].kinematics
    u0 = problem.u.x.array.reshape(-1, dim).copy()
    pair = closed_by_law(problem, end, Λ)
    u1 = problem.u.x.array.reshape(-1, dim)
    blocks, values = zip(*pair.body_residual(), strict=True)
    own = problem.u.function_space.dofmap.index_map.size_local
    forces = problem.bodies.layout.vector()
    for where, value in zip(blocks, values, strict=True):
        index = (where[:, :, None] * dim + np.arange(dim)).astype(np.int32)
        forces.setValues(index.ravel(), value.ravel(), addv=True)
    forces.assemble()
    F = -forces.array_r.reshape(-1, dim)  # the residual has the forces on the other side
    x = problem.u.function_space.tabulate_dof_coordinates()[:own, :dim] + (u0 + u1)[:own] / 2
    total = problem.comm.allreduce(F.sum(axis=0))
    size = problem.comm.allreduce(np.abs(F).sum())
    arm = np.cross(np.pad(x, ((0, 0), (0, 3 - dim))), np.pad(F, ((0, 0), (0, 3 - dim))))
    assert np.abs(total).max() < 1e-13 * size
    assert np.abs(problem.comm.allreduce(arm.sum(axis=0))).max() < 1e-13 * size
    work = problem.comm.allreduce(float((F * (u1 - u0)[:own]).sum()))
    done = level.work(pair.state, pair.j)
    normal, tangential = problem.comm.allreduce(np.array([done.normal, done.tangential]))
    assert work == pytest.approx(normal + tangential, abs=1e-12 * size * np.abs(u1 - u0).max())
    sound = (pair.state.status != OPEN) & (level._κ != 0.0)
    per_point = np.einsum("ni,ni->n", level._m + level._κ[:, None] * level._w, level._w)[sound]
    miss = per_point + (level.end.g - level._g0)[sound]
    left_out = 1e-6 * np.linalg.norm(level._w[sound], axis=1) + 1e-3 * pair.target.size
    assert np.all(np.abs(miss) <= left_out * 1e-3)


def test_lever_is_what_a_rigid_motion_does():
    """𝐫 turns with the facet: 𝐀^α Δ𝐚_α = Δ𝐫 for a finite rotation, with mid-point tangents, on curves and surfaces."""
    rng = np.random.default_rng(0)
    for d in (2, 3):
        a, r = rng.normal(size=(5, d - 1, d)), 1e-2 * rng.normal(size=(5, d))
        Q = np.linalg.qr(rng.normal(size=(d, d)))[0]
        Q *= np.sign(np.linalg.det(Q)) if d == 3 else 1.0
        Q = Q if np.linalg.det(Q) > 0 else Q[:, ::-1]
        a1, r1 = a @ Q.T, r @ Q.T
        middle = (a + a1) / 2
        normal = (
            np.cross(middle[:, 0], middle[:, 1]) if d == 3 else np.stack([middle[:, 0, 1], -middle[:, 0, 0]], axis=1)
        )
        lever = Lever.of(middle, normal, (r + r1) / 2)
        assert np.allclose(lever.carry(a1 - a), r1 - r, atol=1e-13)


def test_rotations_take_one_normal_to_the_other():
    """In the plane and in space: proper rotations, nothing for equal normals, finite for opposite ones."""
    rng = np.random.default_rng(1)
    for d in (2, 3):
        a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 50, d)))
        R = rotation(a, b)
        assert np.abs(np.einsum("nik,nk->ni", R, a) - b).max() < 1e-13
        assert np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(d)).max() < 1e-13
        assert np.abs(np.linalg.det(R) - 1).max() < 1e-13
        assert np.abs(rotation(a, a) - np.eye(d)).max() < 1e-15
        assert np.abs(np.einsum("nik,nk->ni", rotation(a, -a), a) + a).max() < 1e-15


@pytest.mark.parametrize("dim", [2, 3])
def test_normal_and_tangential_parts_do_not_mix(dim):
    """Where normals turn, nodal vectors λ_a ν_a give the scalar field Σ N_a λ_a along ν, tangential ones no normal part."""
    problem, end, Λ = in_step(dim, 1, 0.8, "rays")
    pair = closed_by_law(problem, end, Λ)
    points, multiplier, ν = pair.integration, pair.multiplier, pair.at.ν
    at_nodes = nodal_normals(multiplier, points, ν)
    spread = np.abs(at_nodes[points.facet] - ν[:, None]).max(initial=0.0)
    assert problem.comm.allreduce(spread, MPI.MAX) > 1e-3
    N, m = multiplier.shape.tabulate(points.η)[0], multiplier.components
    unknowns = multiplier.own_nodal()
    λ = np.einsum("fai,fai->fa", unknowns, at_nodes)
    free = ~multiplier.redundant.any(axis=(1, 2))[points.facet]

    def miss(nodal, normal):
        values = np.einsum("nik,nk->ni", pair.blocks.NΛ, nodal[points.facet].reshape(points.size, N.shape[1] * m))
        wrong = np.einsum("ni,ni->n", values, ν) - normal
        return problem.comm.allreduce(float(np.abs(wrong[free]).max(initial=0.0)), MPI.MAX)

    scalar, scale = (
        np.einsum("na,na->n", N, λ[points.facet]),
        problem.comm.allreduce(np.abs(λ).max(initial=0.0), MPI.MAX),
    )
    assert miss(unknowns, scalar) < 1e-13 * scale
    assert miss(unknowns - λ[:, :, None] * at_nodes, 0.0) < 1e-13 * scale
