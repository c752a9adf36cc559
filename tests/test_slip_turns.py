"""Friction small beside the bodies' stiffness: what slips to and fro as Newton iterates comes to rest first."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from scenes import tip

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, dynamics, materials, obstacles, quasistatic
from meshes.boxes import Box, create_boxes

BOTTOM, END = 11, 12


def on_rough_plane(body, domain, tags, friction):
    plane = obstacles.RigidPlane([0, 0], [0, 1])
    return ContactProblem(body, contacts=[Contact(Surface(domain, tags, BOTTOM), plane, friction=friction)])


def test_strip_lifted_off_rough_ground():
    """A strip (E = 10 MPa, 2 m × 2 cm) lies under its weight of 4 N/m on rough ground, with a pressure 2.5 million times less
    than its modulus. Lifted at one end by F it leaves the ground along l = 2F/q, and its end rises by q l⁴/24EI. Where slips
    could turn round at once 1450 iterations and 26 rejected trials were needed."""
    L, h, E, q = 2.0, 0.02, 1e7, 4.0
    domain, _, tags = create_boxes(
        MPI.COMM_WORLD, [Box((0, 0), (L, h), (40, 2), 1, {(1, 0): BOTTOM, (0, 1): END})], False
    )
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, weight, F = fem.Function(V), fem.Constant(domain, 0.0), fem.Constant(domain, 0.0)
    W = V.sub(0).collapse()[0]
    corner = fem.locate_dofs_geometrical((V.sub(0), W), lambda x: np.hypot(x[0], x[1]) < 1e-9)
    held = fem.dirichletbc(fem.Function(W), corner, V.sub(0))
    end = ufl.Measure("ds", domain, subdomain_data=tags)(END)
    loads = [(ufl.as_vector([0, -weight / h]), ufl.Measure("dx", domain)), (ufl.as_vector([0, F / h]), end)]
    strip = Body(u, materials.saint_venant_kirchhoff(E, 0.0), external=loads, bcs=[held])
    problem = on_rough_plane(strip, domain, tags, 0.3)
    stages = [quasistatic.Stage(weight, to=q, increments=2), quasistatic.Stage(F, to=1.6, increments=5)]
    steps = list(quasistatic.march(problem, [*stages, quasistatic.Stage(F, to=0.32, increments=4)]))
    rise = tip(problem, (L, h / 2))[1]
    assert problem.pairs[0].force()[1] == pytest.approx(q * L - 0.32, rel=1e-7)
    assert rise == pytest.approx(q * (2 * 0.32 / q) ** 4 / (24 * E * h**3 / 12), abs=1e-6)
    assert sum(step.rejected for step in steps) == 0
    assert sum(step.iterations for step in steps) <= 150


def test_block_stops():
    """A block that slides on a plane at v is stopped by μ = .3 after v²/2μg, however it shivers when it sticks."""
    v, μ, g, ρ = 0.1, 0.3, 9.81, 1000.0
    domain, _, tags = create_boxes(MPI.COMM_WORLD, [Box((0, 0), (0.1, 0.05), (6, 3), 1, {(1, 0): BOTTOM})], False)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    weight = (ufl.as_vector([0, -ρ * g]), ufl.Measure("dx", domain))
    motion = dynamics.Motion(Body(u, materials.neo_hookean(1e8, 0.3), density=ρ, external=[weight]), step=2e-3)
    motion.velocity.interpolate(lambda X: np.stack([np.full_like(X[0], v), np.zeros_like(X[0])]))
    steps = list(dynamics.march(on_rough_plane(motion, domain, tags, μ), to=0.05))
    way = motion.integral(fem.form(u[0] * ufl.dx)) / (0.1 * 0.05)
    assert way == pytest.approx(v**2 / (2 * μ * g), rel=1e-3)
    assert sum(step.rejected for step in steps) == 0
