"""Exact states of the two membranes against their energy, their equilibrium point by point, and known numbers.

Numbers known to six digits are compared to one unit of the last; what must hold exactly, to round-off.
"""

from functools import cache
from math import atan2, pi

import numpy as np
import pytest
from scipy.optimize import brentq

from exact.two_membranes import MembraneState, TwoMembranes, thickness_stretch_squared

pytestmark = pytest.mark.one_rank

# (shift, friction, fraction of the way from the first contact to the lock)
SCENES = [(1.0, 0.0, 0.3), (1.0, 0.0, 0.99), (1.0, 0.2, 0.6), (1.0, 0.5, 0.05), (1.0, 0.5, 0.6), (1.0, 0.5, 0.99)]
SCENES += [(0.5, 0.0, 0.5), (0.5, 0.25, 0.7), (1.5, 0.5, 0.7), (2.0, 1.0, 0.5)]


@cache
def scene(shift: float = 1.0, friction: float = 0.0) -> TwoMembranes:
    return TwoMembranes(shift=shift, friction=friction)


def at(shift: float, friction: float, way: float) -> MembraneState:
    membranes = scene(shift, friction)
    first, lock = membranes.first_contact_pressure(), membranes.lock_pressure()
    return membranes.in_contact(first + way * (lock - first))


def up(d):
    """Vectors turned left by a right angle: the side on which the pressure pushes."""
    return np.stack([-d[..., 1], d[..., 0]], axis=-1)


@pytest.mark.parametrize("nu", [0.0, 1e-9, 0.3, 0.4999])
def test_thickness_stretch_leaves_no_stress(nu):
    material = TwoMembranes(nu=nu)
    G, Λ = material.G, material.lame
    J = np.geomspace(1e-2, 1e6, 50).reshape(5, 10)
    x = thickness_stretch_squared(J, G, Λ)
    assert x.shape == J.shape and np.all(x > 0)
    terms = np.array([G * (x - 1), Λ / 2 * np.log(x), Λ * np.log(J)])
    assert np.all(np.abs(terms.sum(0)) <= 1e-14 * (np.abs(terms).sum(0) + G))  # round-off of the terms
    assert thickness_stretch_squared(1.0, G, Λ) == pytest.approx(1.0, abs=1e-14)


def test_tension_is_the_derivative_of_the_energy():
    material = TwoMembranes()
    G, Λ, h = material.G, material.lame, material.thickness

    def energy(l):
        x = brentq(lambda x: G * (x - 1) + Λ / 2 * np.log(x) + Λ * np.log(l), 1e-12, 10, xtol=1e-15)
        I1, log_I3 = l**2 + 1 + x, np.log(l**2 * x)
        return h * (G / 2 * (I1 - 3) - G / 2 * log_I3 + Λ / 8 * log_I3**2)

    for l in (1.0, 1.3, 3.0, 6.0):
        d = 1e-4
        slope = (energy(l + d) - energy(l - d)) / (2 * d)
        assert material.tension(l) == pytest.approx(slope, rel=1e-7, abs=1e-4)  # d² and round-off/d


def test_stretch_inverts_tension():
    for nu in (0.0, 0.3, 0.4999):
        material = TwoMembranes(nu=nu)
        l = 1 + np.geomspace(1e-6, 1e3, 60).reshape(6, 10)
        assert np.allclose(material.stretch(material.tension(l)), l, rtol=4e-15, atol=0)
    assert material.stretch(0.0) == 1
    with pytest.raises(ValueError, match=r"tension = -1\.0: must be ≥ 0"):
        material.stretch([1.0, -1.0])


def test_first_contact():
    membranes = scene()
    assert membranes.first_contact_pressure() == pytest.approx(2876.276, abs=5e-4)
    assert membranes.first_contact_angle() == pytest.approx(pi - atan2(2, 1), abs=1e-15)
    for shift, height, length in ((1.0, 1.0, 1.0), (0.3, 0.5, 1.0), (0.5, 1.0, 2.0), (3.0, 1.0, 1.0)):
        # the arc's circle and its reflection at M touch: their centres are two radii apart
        membranes = TwoMembranes(shift=shift, height=height, length=length)
        state = membranes.apart(membranes.first_contact_pressure())
        radius = state.radii[0]
        middle = np.array([length / 2, state.max_height - radius])
        assert np.linalg.norm(membranes.centre - middle) == pytest.approx(radius, rel=1e-12)


@pytest.mark.parametrize("pressure", [1e-3, 1.0, 1000.0, 2400.0, 2876.0])
def test_apart(pressure):
    """l = θ/sin θ, R = 1/(2 sin θ) and p = N/R, below and above the half circle (θ = π/2 at 2413 Pa)."""
    membranes = scene()
    state = membranes.state(pressure)
    R, l = state.radii[0], state.stretch_max
    θ = l / (2 * R)  # half of the deformed length over the radius
    assert np.sin(θ) / θ == pytest.approx(1 / l, rel=1e-12)
    assert 2 * R * np.sin(θ) == pytest.approx(1.0, rel=1e-12)
    assert membranes.tension(l) / R == pytest.approx(pressure, rel=1e-9)  # l − 1 of 2e-5 has lost five digits
    assert state.max_height == pytest.approx(R * (1 - np.cos(θ)), rel=1e-9)
    assert state.midpoint_displacement == pytest.approx([0.0, state.max_height], abs=1e-12)
    assert state.contact_length == 0 and state.multiplier == (0.0, 0.0) and state.stretch_min == l


def test_flat_without_pressure():
    X, x = scene().state(0.0).shape(5)
    assert np.array_equal(x, np.stack([X, 0 * X], axis=1))


def test_frictionless_numbers():
    membranes = scene()
    assert membranes.lock_pressure() == pytest.approx(4380.47, abs=0.005)
    state = membranes.state(4023.0)
    assert state.stretch_max == state.stretch_min == pytest.approx(3.85598, abs=5e-6)
    assert state.radii == pytest.approx((0.727558, 0.727558), abs=1e-6)
    assert state.contact_length == pytest.approx(0.495335, abs=1e-6)
    assert state.midpoint_displacement == pytest.approx([-0.345352, 1.402874], abs=1e-6)
    assert state.multiplier == pytest.approx((4023 * 3.85598,) * 2, rel=2e-6)


def test_lock_without_friction():
    """Three quarters of a unit circle about (0, 1), then the line x = 1 down to the fixed edge."""
    membranes = scene()
    state = membranes.state(membranes.lock_pressure())
    l = 1.5 * pi + 1
    assert state.stretch_max == pytest.approx(l, rel=1e-14)
    assert state.pressure == pytest.approx(float(membranes.tension(l)), rel=1e-14)
    assert state.contact_line == pytest.approx(np.array([[1.0, 1.0], [1.0, 0.0]]), abs=1e-14)
    assert state.max_height == pytest.approx(2.0, abs=1e-14)


def test_lock_with_friction():
    """The same curve, with a tension that falls by μ of itself along the line."""
    membranes = scene(friction=0.5)
    assert membranes.lock_pressure() == pytest.approx(4670.9, abs=0.05)
    state = membranes.state(membranes.lock_pressure())
    assert state.radii == pytest.approx((1.0, 0.5), abs=1e-14)
    assert state.contact_length == 1
    assert state.stretch_max > state.stretch_min


@pytest.mark.parametrize("shift, friction, way", SCENES)
def test_closed_and_symmetric(shift, friction, way):
    state = at(shift, friction, way)
    membranes = state.membranes
    assert float(state.material(sum(state.lengths))) == pytest.approx(1.0, abs=1e-13)
    assert state.points([0.0, 1.0]) == pytest.approx(np.array([[0.0, 0.0], [1.0, 0.0]]), abs=1e-12)
    assert state.contact_line.mean(axis=0) == pytest.approx(membranes.centre, abs=1e-12)
    assert np.linalg.norm(np.diff(state.contact_line, axis=0)) == pytest.approx(state.contact_length, abs=1e-14)
    X = np.linspace(0, 1, 101)
    assert state.material(state.arc_length(X)) == pytest.approx(X, abs=1e-14)
    assert state.radii[0] - state.radii[1] == pytest.approx(friction * state.contact_length, abs=1e-14)


@pytest.mark.parametrize("shift, friction, way", SCENES)
def test_equilibrium_point_by_point(shift, friction, way):
    """Forces on the nodes of a fine chain, its tensions from its own lengths: pressure, contact and friction balance them."""
    state = at(shift, friction, way)
    p = state.pressure
    X, x = state.shape(4001)
    edges = np.diff(x, axis=0)
    size = np.linalg.norm(edges, axis=1)
    stretch = size / np.diff(X)
    start, end = state.contact_material
    middles = (X[1:] + X[:-1]) / 2
    whole = np.min(np.abs(middles[:, None] - [start, end]), axis=1) > 1 / 4000  # edges within one piece
    assert stretch[whole] == pytest.approx(
        state.stretch(middles[whole]), rel=2e-6
    )  # chords: ds²/(24R²), ds up to 3e-3 m
    pull = edges * (state.membranes.tension(stretch) / size)[:, None]
    d = (edges[1:] + edges[:-1]) / 2  # the node's share of the curve
    touching = ((start < X) & (end > X))[1:-1]
    force = np.diff(pull, axis=0) + p * up(d)  # free
    force[touching] += (-p * up(d) + friction * p * d)[touching]  # the other membrane
    rest = np.linalg.norm(force, axis=1) / (p * np.linalg.norm(d, axis=1))
    ends = np.min(np.abs(X[1:-1, None] - [start, end]), axis=1) < 2 / 4000  # nodes that the line's ends divide
    assert rest[~ends].max() < 5e-7  # O(ds²/R²)
    # and the tangent is continuous there too: it turns by at most ds/R
    turn = np.abs(np.sum(up(edges[1:]) * edges[:-1], axis=1)) / (size[1:] * size[:-1])
    assert turn.max() <= 1.001 * size.max() / min(state.radii)


@pytest.mark.parametrize("shift, friction, way", [scene for scene in SCENES if scene[1] > 0])
def test_material_length_in_closed_form(shift, friction, way):
    """∫ dr/l = ∫ dN/(μp l) over the line has the primitive hG[ln l − x/(2l²) − e^{a(x−1)}(ax − 1)/(2a²)], a = 2G/Λ."""
    state = at(shift, friction, way)
    G, Λ, h = state.membranes.G, state.membranes.lame, state.membranes.thickness
    a, l = 2 * G / Λ, np.array([state.stretch_min, state.stretch_max])
    x = thickness_stretch_squared(l, G, Λ)
    low, high = h * G * (np.log(l) - x / (2 * l**2) - np.exp(a * (x - 1)) * (a * x - 1) / (2 * a**2))
    start, end = state.contact_material
    assert end - start == pytest.approx((high - low) / (friction * state.pressure), abs=1e-13)


@pytest.mark.parametrize("shift, friction, way", SCENES)
def test_friction_opposes_the_slip(shift, friction, way):
    """Under growing pressure all of the lower membrane's line slips against t: friction on it, +μp t, dissipates."""
    state = at(shift, friction, way * 0.98)
    next_ = state.membranes.in_contact(state.pressure + 1e-3)
    along = np.linspace(0, state.contact_length, 21)
    lower = state.material(state.lengths[0] + along)
    upper = lower[::-1]  # the upper membrane's material there, in coordinates of the lower one
    t = np.array([np.cos(state.angle), np.sin(state.angle)])
    centre = 2 * state.membranes.centre
    assert state.points(lower) == pytest.approx(centre - state.points(upper), abs=1e-12)
    slip = (next_.points(lower) - (centre - next_.points(upper))) @ t / 1e-3
    assert np.all(slip < -1e-6)  # m/Pa


@pytest.mark.parametrize("shift, friction, way", SCENES)
def test_membranes_do_not_overlap(shift, friction, way):
    """The lower membrane lies on its side of the contact line, so that its reflection lies on the other."""
    state = at(shift, friction, way)
    _, x = state.shape(2001)
    ν = np.array([-np.sin(state.angle), np.cos(state.angle)])
    assert np.all((x - state.membranes.centre) @ ν < 1e-12)
    assert state.max_height == pytest.approx(x[:, 1].max(), abs=1e-6)  # between two points 3e-3 m apart
    assert state.max_height >= x[:, 1].max() - 1e-12


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_continuous_in_the_pressure(friction):
    membranes = scene(friction=friction)
    first, lock = membranes.first_contact_pressure(), membranes.lock_pressure()
    for p in (first, lock):
        inside, outside = membranes.state(p - 1e-6), membranes.state(min(p + 1e-6, lock))
        assert inside.points(np.linspace(0, 1, 11)) == pytest.approx(outside.points(np.linspace(0, 1, 11)), abs=1e-7)
    pressures = np.linspace(0, lock, 60)
    states = [membranes.state(p) for p in pressures]
    assert [s.pressure for s in states] == pytest.approx(pressures, rel=1e-12)
    for name in ("stretch_max", "stretch_min", "max_height"):
        assert np.all(np.diff([getattr(s, name) for s in states]) > 0)


@pytest.mark.parametrize("shift", [0.1, 0.5, 1.0, 1.5, 2.0])
def test_largest_friction(shift):
    limit = TwoMembranes(shift=shift).largest_friction()
    assert TwoMembranes(shift=shift, friction=0.98 * limit).lock_pressure() > TwoMembranes(shift=shift).lock_pressure()
    with pytest.raises(ValueError, match=rf"friction = .*not to the lock; .* at shift = {shift}: from 0 to at most"):
        TwoMembranes(shift=shift, friction=1.02 * limit).lock_pressure()


def test_the_whole_line_slips_at_one_half():
    assert scene(1.0).largest_friction() == pytest.approx(0.54309, abs=1e-5)  # so shift 1 has a solution for μ = 0.5
    assert scene(0.5).largest_friction() == pytest.approx(0.29332, abs=1e-5)  # and shift 0.5 has none of this form
    with pytest.raises(ValueError, match=r"pressure = 5420: .* slip everywhere up to 2079\.739\d* Pa"):
        scene(0.5, 0.5).state(5420)


@pytest.mark.parametrize("pressure", [-1.0, float("nan"), 4671.0, 5420.0])
def test_inadmissible_pressures_are_refused(pressure):
    membranes = scene(friction=0.5)
    apart, touch = (
        r"the membranes are apart from 0 to 2876\.276",
        r"the membranes touch from 2876\.276.* lock at 4670\.929",
    )
    with pytest.raises(ValueError, match=f"pressure = {pressure}: {apart}"):
        membranes.apart(pressure)
    with pytest.raises(ValueError, match=f"pressure = {pressure}: {touch}"):
        membranes.in_contact(pressure)
    with pytest.raises(ValueError, match=f"pressure = {pressure}: {touch if pressure > 0 else apart}"):
        membranes.state(pressure)


@pytest.mark.parametrize("name, value", [("E", 0.0), ("nu", 0.5), ("nu", -0.1), ("shift", 0.0), ("friction", -0.1)])
def test_inadmissible_arguments_are_refused(name, value):
    with pytest.raises(ValueError, match=rf"{name} = {value}: must|{name} = {value}: Coulomb"):
        TwoMembranes(**{name: value})
