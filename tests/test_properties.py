"""Whatever is passed to the public arguments: a ValueError that names the argument, on every rank, or a march that converges
or says why not (StepFailure). Nothing else is raised, and every number that comes out is finite."""

import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dolfinx_mortar_al import (
    Contact,
    ContactProblem,
    NewtonSolver,
    Surface,
    dynamics,
    loads,
    materials,
    membrane,
    obstacles,
    quasistatic,
)
from meshes.two_beams import CLAMP, LOWER_TOP, TIP, UPPER_BOTTOM, TwoBeams

#: derandomised: all ranks draw the same examples
FAST = settings(max_examples=200, deadline=None, derandomize=True, database=None)
SLOW = settings(FAST, max_examples=25, suppress_health_check=[HealthCheck.too_slow])

ODD = st.sampled_from([np.nan, np.inf, -np.inf, None, "0.3", "", b"1", True, 1 + 2j, [1.0, 2.0], np.zeros(2), {}])
NUMBERS = st.one_of(st.floats(), st.integers(-(10**6), 10**6), st.floats(1e-3, 1e3).map(np.float64), ODD)


ARGUMENTS = ["friction", "epsilon_normal", "epsilon_tangential", "thickness", "quadrature_degree", "multiplier_order"]
ARGUMENTS += ["projection", "name"]


def named(name, call):
    """The call's value, or None where it refuses its argument by name."""
    try:
        return call()
    except ValueError as error:
        assert str(error).startswith(name), error
        return None


@pytest.fixture(scope="module")
def beams():
    return TwoBeams(along=(4, 4), across=1).create()


@FAST
@given(NUMBERS, NUMBERS, NUMBERS)
def test_materials(E, nu, thickness):
    law = named(("E = ", "nu = "), lambda: materials.neo_hookean(E, nu))
    if law is not None:
        assert law.G > 0 or np.finfo(float).tiny > E  # a third of the least number is none
        assert -1 < nu < 0.5
    sheet = named(("E = ", "nu = ", "thickness = "), lambda: membrane.neo_hookean_membrane(E, nu, thickness))
    if sheet is not None:
        assert sheet.thickness > 0
        assert nu >= 0


@FAST
@given(st.sampled_from(ARGUMENTS), NUMBERS)
def test_contact(beams, name, value):
    mesh, _, tags = beams
    sides = Surface(mesh, tags, UPPER_BOTTOM), Surface(mesh, tags, LOWER_TOP)
    contact = named(f"{name} = ", lambda: Contact(*sides, **{name: value}))
    if contact is not None and name in ("friction", "thickness") and getattr(contact, name) is not None:
        assert np.isfinite(getattr(contact, name))
        assert getattr(contact, name) >= 0


@FAST
@given(st.lists(st.one_of(st.floats(), ODD), max_size=4), st.lists(st.floats(), max_size=4), NUMBERS)
def test_obstacles(point, direction, radius):
    plane = named(("point = ", "normal = "), lambda: obstacles.RigidPlane(point, direction))
    if plane is not None:
        assert np.linalg.norm(plane.normal) == pytest.approx(1.0)
        named(("translation = ", "rotation = "), lambda: plane.move(direction, radius))
        assert np.isfinite(plane.pose.rotation).all()
    sphere = named(("centre = ", "radius = "), lambda: obstacles.RigidSphere(point, radius))
    assert sphere is None or sphere.radius > 0


def problem_of(beams, E=2e6, friction=0.3, **options):
    mesh, _, tags = beams
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u, P = fem.Function(V), fem.Constant(mesh, 0.0)
    F = materials.saint_venant_kirchhoff(E, 0.3).virtual_work(u)
    F -= loads.follower_force(u, P / 0.05, ufl.Measure("ds", mesh, subdomain_data=tags)(TIP))
    clamp = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(CLAMP)), V)
    sides = Surface(mesh, tags, UPPER_BOTTOM), Surface(mesh, tags, LOWER_TOP)
    return ContactProblem(F, u, bcs=[clamp], contacts=[Contact(*sides, friction=friction, **options)]), P


@SLOW
@given(
    friction=st.floats(0.0, 10.0),
    epsilon=st.floats(1e2, 1e10) | st.none(),
    degree=st.integers(2, 12) | st.none(),
    projection=st.sampled_from(["rays", "closest"]),
    to=st.floats(-10.0, 10.0),
    increments=st.integers(1, 4),
)
def test_a_march_converges_or_says_why_not(beams, friction, epsilon, degree, projection, to, increments):
    problem, P = problem_of(
        beams, friction=friction, epsilon_normal=epsilon, quadrature_degree=degree, projection=projection
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            reached = 0.0
            for step in quasistatic.march(problem, P, to=to, increments=increments, smallest=0.2):
                reached = step.load
                assert np.isfinite(problem.u.x.array).all()
                assert np.isfinite(problem.pairs[0].force()).all()
            assert reached == pytest.approx(to)
        except quasistatic.StepFailure as failure:
            assert "no convergence at load" in str(failure)
        except ValueError as error:
            assert str(error).startswith("to = "), error


@SLOW
@given(st.sampled_from(["to", "start", "increments", "smallest", "rtol", "max_iterations"]), ODD)
def test_march_refuses(beams, name, value):
    problem, P = problem_of(beams)
    options = {"to": 1.0, "increments": 1}
    if name in ("rtol", "max_iterations"):
        assert named(f"{name} = ", lambda: NewtonSolver(problem, **{name: value})) is None or value is True
    elif not (name == "start" and value is None):
        assert named(f"{name} = ", lambda: quasistatic.march(problem, P, **options | {name: value})) is None


@settings(SLOW, max_examples=12)  # each accepted number is compiled
@given(st.sampled_from(["density", "step", "theta", "thickness"]), NUMBERS)
def test_motion(beams, name, value):
    u = fem.Function(fem.functionspace(beams[0], ("Lagrange", 1, (2,))))
    options = {"density": 1e3, "step": 1e-3, "theta": 0.5, "thickness": 1.0} | {name: value}
    motion = named(f"{name} = ", lambda: dynamics.Motion(u, materials.neo_hookean(1e6, 0.3), **options))
    if motion is not None:
        assert np.isfinite([motion.time_step.value, motion.theta, motion.mass, motion.kinetic_energy()]).all()
        assert motion.mass == pytest.approx(0.1 * options["density"] * options["thickness"], rel=1e-9)  # 0.1 m²
