"""Sections 4.3 and 4.4: the exact impact of two bars, the rigid-disc estimate, and the meshes of both scenes.

Exact solutions are held to round-off, 1e-12 relative, unless a test says otherwise.
"""

from math import pi, radians, sin

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from mpi4py import MPI
from scenes import marked

from exact.rigid_disc import RigidDisc
from exact.two_bars import TwoBars
from meshes.disc import DISC, RIM, Disc
from meshes.two_bars import BAR1, BAR2, FACE1, FACE2, FREE1, FREE2, SIDES1, SIDES2
from meshes.two_bars import TwoBars as TwoBarsMesh

ROUND_OFF = 1e-12


def near(value, **tolerance):
    return pytest.approx(value, rel=ROUND_OFF, abs=tolerance.get("abs", 0.0))


def integral(form):
    """∫ over the whole mesh, on every rank."""
    form = fem.form(form)
    return form.mesh.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)


def one(mesh):
    return fem.Constant(mesh, 1.0)


# Two bars, exact

BARS = TwoBars()
OFFSET = TwoBars(length=3.0, section=0.2, E=50.0, rho=0.04, speed=0.3, gap=0.06)
TIMES = np.linspace(-0.1, 0.5, 1201)


def characteristics(bars, cells, steps):
    """Force and energies at the ends of `steps` steps of L/(c·cells), in which both waves cross one cell: no error but
    round-off. The waves are v ∓ σ/(ρc); both faces let them pass while that is compression, and reflect them otherwise.
    """
    z, V = bars.rho * bars.wave_speed, bars.speed
    right, left = (np.repeat([[V], [0.0]], cells, axis=1) for _ in range(2))
    force, energies = [], []
    for _ in range(steps):
        (out1, end2), (end1, out2) = right[:, -1], left[:, 0]
        closed = out1 > out2
        in1, in2 = (out2, out1) if closed else (out1, out2)
        force.append(z * bars.section * max(out1 - out2, 0.0) / 2)
        right = np.c_[[end1, in2], right[:, :-1]]
        left = np.c_[left[:, 1:], [in1, end2]]
        v, σ = (right + left) / 2, z * (left - right) / 2
        volume = bars.section * bars.length / cells
        energies.append(volume / 2 * np.r_[(bars.rho * v**2).sum(axis=1), (σ**2 / bars.E).sum(axis=1)])
    return np.array(force), np.array(energies).T


@pytest.mark.one_rank
def test_bars_of_the_paper():
    assert BARS.wave_speed == near(100.0)
    assert (BARS.contact_start, BARS.contact_end) == (0.0, near(0.2))
    assert BARS.contact_force == near(0.05)
    assert BARS.momentum == near(0.01)
    assert BARS.energies(0.1) == near(np.full(4, 1.25e-4))
    assert BARS.tip_velocities(0.1) == near(np.full(2, 0.05))
    assert BARS.tip_velocities(0.3).tolist() == [0.0, 0.1]
    assert BARS.tip_displacements(0.3) == near(np.array([0.01, 0.02]))
    assert BARS.energies(0.4) == near(np.array([0.0, 5e-4, 0.0, 0.0]))


@pytest.mark.one_rank
def test_force_lasts_for_two_passages_of_the_wave():
    t = np.array([-1e-9, 0.0, 0.1, 0.2 - 1e-9, 0.2 + 1e-9, 1.0])
    assert BARS.force(t) == near(np.array([0.0, 0.05, 0.05, 0.05, 0.0, 0.0]))
    assert OFFSET.contact_start == near(0.2)
    assert OFFSET.contact_end - OFFSET.contact_start == near(2 * OFFSET.length / OFFSET.wave_speed)


@pytest.mark.one_rank
@pytest.mark.parametrize("bars", [BARS, OFFSET])
def test_bars_keep_energy_and_momentum(bars):
    assert np.allclose(bars.energies(TIMES).sum(axis=0), bars.energy, rtol=ROUND_OFF, atol=0)
    assert np.allclose(bars.momenta(TIMES).sum(axis=0), bars.momentum, rtol=ROUND_OFF, atol=0)
    assert bars.energies(TIMES).min() >= 0.0
    assert BARS.energy == near(5e-4)


@pytest.mark.one_rank
def test_bars_agree_with_the_method_of_characteristics():
    """Two closed forms of the same waves, through 4L/c; the force at mid-step, where it has no jump."""
    cells = 40
    force, energies = characteristics(BARS, cells, 4 * cells)
    step = BARS.length / BARS.wave_speed / cells
    t = step * np.arange(1, 4 * cells + 1)
    assert np.allclose(BARS.force(t - step / 2), force, rtol=0, atol=ROUND_OFF * BARS.contact_force)
    assert np.allclose(BARS.energies(t), energies, rtol=0, atol=ROUND_OFF * BARS.energy)


@pytest.mark.one_rank
@pytest.mark.parametrize("bars", [BARS, OFFSET])
def test_bars_are_continuous_and_obey_newton(bars):
    """Displacements do not jump; off the two jumps their slope is the velocity, and that of the momenta ∓ the force.

    1e-7 covers the round-off of a difference over 1e-7 s; the pieces are linear in t.
    """
    δ = 1e-7
    for t in (bars.contact_start, bars.contact_end):
        jump = bars.tip_displacements(t + δ) - bars.tip_displacements(t - δ)
        assert np.abs(jump).max() <= bars.speed * 2 * δ * (1 + 1e-6)
    t = TIMES + 1.234e-5  # no sample within δ of a jump
    slope = (bars.tip_displacements(t + δ) - bars.tip_displacements(t - δ)) / (2 * δ)
    assert np.allclose(slope, bars.tip_velocities(t), rtol=0, atol=1e-7)
    push = (bars.momenta(t + δ) - bars.momenta(t - δ)) / (2 * δ)
    assert np.allclose(push, np.stack([-bars.force(t), bars.force(t)]), rtol=0, atol=1e-7)


@pytest.mark.one_rank
@pytest.mark.parametrize("bars", [BARS, OFFSET])
def test_bars_touch_in_contact_only(bars):
    """The gap is never negative, zero in contact and open before and after."""
    u1, u2 = bars.tip_displacements(TIMES)
    gap = bars.gap + u2 - u1
    touching = (bars.contact_start <= TIMES) & (bars.contact_end >= TIMES)
    assert np.abs(gap[touching]).max() <= ROUND_OFF
    away = (bars.contact_start - 1e-4 > TIMES) & (bars.gap > 0) | (bars.contact_end + 1e-4 < TIMES)
    assert gap[away].min() > 0.0


@pytest.mark.one_rank
def test_bars_take_scalars_and_arrays_and_refuse_what_does_not_meet():
    assert BARS.force(0.1).shape == ()
    t = TIMES[:6].reshape(2, 3)
    assert (BARS.force(t).shape, BARS.tip_displacements(t).shape, BARS.energies(t).shape) == (
        (2, 3),
        (2, 2, 3),
        (4, 2, 3),
    )
    for wrong in ({"speed": 0.0}, {"gap": -0.1}):
        with pytest.raises(ValueError, match="approach"):
            TwoBars(**wrong)


# Rigid disc

V45 = 200 / 3.6 * sin(radians(45))  # 200 km/h at 45°, along and towards the plane
SLICE = 200 * 2 * pi / 60  # 200 rev/min
RIGID = RigidDisc()


def sliding(velocity_x, spin):
    return velocity_x + spin * RIGID.radius


@pytest.mark.one_rank
@pytest.mark.parametrize("restitution", [0.0, 0.1, 0.2, 0.7, 1.0])
@pytest.mark.parametrize("spin", [-3 * V45 / 0.1, -SLICE, 0.0, SLICE])
def test_disc_sticks_or_slides(spin, restitution):
    """Friction ends the sliding within the cone, or is on the cone and against the sliding that remains."""
    after = RIGID.rebound(V45, V45, spin, restitution)
    v, v_after = sliding(V45, spin), sliding(after.velocity_x, after.spin)
    limit = RIGID.friction * after.impulse_n
    if after.sticks:
        assert v_after == pytest.approx(0.0, abs=ROUND_OFF * V45)
        assert abs(after.impulse_t) <= limit
    else:
        assert v * v_after > 0
        assert after.impulse_t == near(np.sign(v) * limit)
    assert after.velocity_n == near(restitution * V45)


@pytest.mark.one_rank
def test_disc_without_spin_sticks_above_a_known_restitution():
    """At 45° and ω = 0, μ(1 + e) ≥ 1/3, that is e ≥ 1/9."""
    assert not RIGID.rebound(V45, V45, 0.0, 1 / 9 - 1e-9).sticks
    assert RIGID.rebound(V45, V45, 0.0, 1 / 9 + 1e-9).sticks


@pytest.mark.one_rank
def test_disc_obeys_the_laws_of_motion():
    """Momentum and spin change by the impulses; the losses are what the kinetic energy lacks and never negative."""
    for Vx, Vn, spin, e in np.random.default_rng(3).uniform([-50, 0, -900, 0], [50, 50, 900, 1], (500, 4)):
        after = RIGID.rebound(Vx, Vn, spin, e)
        before, left = (
            RIGID.kinetic_energy(Vx, Vn, spin),
            RIGID.kinetic_energy(after.velocity_x, after.velocity_n, after.spin),
        )
        assert RIGID.mass * (Vx - after.velocity_x) == near(after.impulse_t, abs=ROUND_OFF * RIGID.mass * 50)
        assert RIGID.inertia * (spin - after.spin) == near(
            after.impulse_t * RIGID.radius, abs=ROUND_OFF * RIGID.mass * 50
        )
        assert RIGID.mass * (Vn + after.velocity_n) == near(after.impulse_n)
        assert after.energy_loss == near(before - left, abs=ROUND_OFF * before)
        assert min(after.normal_loss, after.friction_loss) >= 0.0


@pytest.mark.one_rank
@pytest.mark.parametrize("restitution", [0.0, 0.7, 1.0])
def test_disc_claims_of_the_paper(restitution):
    """The loss is largest with slice, then without spin, then with topspin; friction reverses the slice."""
    sliced, plain, topspin = (RIGID.rebound(V45, V45, spin, restitution) for spin in (SLICE, 0.0, -SLICE))
    assert sliced.energy_loss > plain.energy_loss > topspin.energy_loss
    assert sliced.spin < 0.0
    assert sliced.friction_loss > 0.0


@pytest.mark.one_rank
def test_disc_limits():
    """No friction: nothing but the normal velocity changes. Sticking loses m v_s²/6 to friction, rolling nothing."""
    after = RigidDisc(friction=0.0).rebound(V45, V45, SLICE)
    assert (after.velocity_x, after.velocity_n, after.spin, after.energy_loss) == (V45, V45, SLICE, 0.0)
    assert RIGID.mass == near(6000 * pi * 0.1**2 * 0.02)
    assert RIGID.rebound(V45, V45, SLICE).friction_loss == near(RIGID.mass * sliding(V45, SLICE) ** 2 / 6)
    rolling = RIGID.rebound(V45, V45, -V45 / RIGID.radius)
    assert rolling.impulse_t == pytest.approx(0.0, abs=ROUND_OFF * RIGID.mass * V45)
    for wrong in ((V45, -1.0, 0.0, 1.0), (V45, V45, 0.0, 1.1)):
        with pytest.raises(ValueError, match="no impact"):
            RIGID.rebound(*wrong)


# Meshes. The faces of the bars are flat: volumes and areas to round-off, 1e-12.


@pytest.mark.parametrize("dim, triangles", [(2, False), (2, True), (3, False), (3, True)])
@pytest.mark.parametrize("gap", [0.0, 0.5])
def test_bars_mesh(dim, triangles, gap):
    bars = TwoBarsMesh(height=0.8, width=0.6, along=12, across=2, dim=dim, triangles=triangles, gap=gap)
    mesh, cells, facets = bars.create()
    assert mesh.geometry.index_map().size_global == 2 * 13 * 3 ** (dim - 1)  # no node in common
    section, girth = (0.8, 2.0) if dim == 2 else (0.8 * 0.6, 2 * (0.8 + 0.6))
    x = ufl.SpatialCoordinate(mesh)[0]
    for body, start in ((BAR1, 0.0), (BAR2, 10.0 + gap)):
        dx = marked("dx", mesh, cells, body)
        assert integral(one(mesh) * dx) == near(10.0 * section)
        assert integral(x * dx) == near((start + 5.0) * 10.0 * section)
    for end, position in ((FREE1, 0.0), (FACE1, 10.0), (FACE2, 10.0 + gap), (FREE2, 20.0 + gap)):
        ds = marked("ds", mesh, facets, end)
        assert integral(one(mesh) * ds) == near(section)
        assert integral(abs(x - fem.Constant(mesh, position)) * ds) == pytest.approx(0.0, abs=ROUND_OFF * 20)
    for sides in (SIDES1, SIDES2):
        assert integral(one(mesh) * marked("ds", mesh, facets, sides)) == near(10.0 * girth)
    assert integral(one(mesh) * ufl.ds(mesh)) == near(4 * section + 20.0 * girth)


@pytest.mark.parametrize("triangles", [True, False])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("shape", [{}, {"height": 0.15, "size": 0.02, "rim_size": 0.005}])
def test_disc_mesh(triangles, order, shape):
    """The area is that of the polygon of the rim's nodes (order 1), or πR² within 1e-4 (order 2: error of order (h/R)⁴)."""
    mesh, cells, facets = Disc(order=order, triangles=triangles, **shape).create()
    R, y0, rim_size = 0.1, shape.get("height", 0.1), shape.get("rim_size", 0.01)
    ds, dx = ufl.Measure("ds", mesh, subdomain_data=facets), ufl.Measure("dx", mesh, subdomain_data=cells)
    n = mesh.comm.allreduce(np.sum(facets.find(RIM) < mesh.topology.index_map(1).size_local))
    assert n % 4 == 0
    assert (
        0.8 * rim_size <= 2 * pi * R / n <= 1.01 * rim_size
    )  # at most rim_size, but for rounding to four equal quarters
    area = integral(one(mesh) * dx(DISC))
    assert area == (near(n * R**2 * sin(2 * pi / n) / 2) if order == 1 else pytest.approx(pi * R**2, rel=1e-4))
    J = ufl.JacobianDeterminant(mesh)
    assert abs(integral(ufl.sign(J) * dx)) == near(area)  # no element folds over
    length = integral(one(mesh) * ds(RIM))
    assert length == (near(2 * n * R * sin(pi / n)) if order == 1 else pytest.approx(2 * pi * R, rel=1e-4))
    assert integral(one(mesh) * ds) == near(length)
    x, y = ufl.SpatialCoordinate(mesh)
    if order == 2:  # every point of the rim, not its nodes only: the sagitta, some 1e-3 R, would show
        off = y - fem.Constant(mesh, y0)
        assert integral(abs(ufl.sqrt(x**2 + off**2) - R) * ds(RIM)) <= 1e-5 * R * length
    nodes = mesh.geometry.x
    assert mesh.comm.allreduce(nodes[:, 1].min(), op=MPI.MIN) == pytest.approx(y0 - R, abs=ROUND_OFF * R)
    lowest = nodes[nodes[:, 1] < y0 - R + ROUND_OFF, 0]
    assert np.abs(np.concatenate(mesh.comm.allgather(lowest))).max() <= 1e-9 * R


def test_a_finer_rim_leaves_the_inside_as_it_is():
    """The rim's elements are 4 times smaller; within 0.3 R there are as many as before, up to the freedom of the mesher."""
    counts = []
    for rim_size in (None, 0.0025):
        mesh, _, _ = Disc(rim_size=rim_size).create()
        owned = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        radius = np.linalg.norm(compute_midpoints(mesh, 2, owned) - [0.0, 0.1, 0.0], axis=1)
        counts.append(mesh.comm.allreduce(np.sum(radius < 0.03)))
    assert counts[1] == pytest.approx(counts[0], rel=0.25)
