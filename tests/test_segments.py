"""Segments: cuts where target facets end, and the patch test that they pass to round-off."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI
from scenes import beams, blocks, contact_of, membranes, tip

from dolfinx_mortar_al import Checkpoint, Contact, ContactProblem, dynamics, materials, output, quasistatic
from dolfinx_mortar_al.clipping import _clip_by_line, areas, clip, triangulate, without_flat_corners
from dolfinx_mortar_al.segments import cuts_on_curve, images_on_curve
from dolfinx_mortar_al.surface import ShapeFunctions
from exact.two_membranes import TwoMembranes as Exact
from meshes.two_beams import UPPER, TwoBeams

PRESSURE = 2e4  # Pa


def pressed(**options):
    """The pair of two blocks under PRESSURE, in one step without rejection."""
    problem, p = blocks(integration="segments", **options)
    assert sum(step.rejected for step in quasistatic.march(problem, p, to=PRESSURE, increments=1)) == 0
    return problem.pairs[0]


@pytest.mark.one_rank
@pytest.mark.parametrize("order", [1, 2])
def test_images_are_where_rays_meet(order):
    """𝐱(η) + d 𝐧(η) is the given point."""
    import basix

    rng = np.random.default_rng(1)
    shape = ShapeFunctions(basix.CellType.interval, order)
    straight = np.stack([shape.nodes[:, 0], np.zeros(order + 1)], axis=1)
    nodes = straight + 0.1 * rng.uniform(-1, 1, (50, order + 1, 2))
    η, d = rng.uniform(-0.2, 1.2, 50), rng.uniform(-0.2, 0.2, 50)
    N, dN = shape.tabulate(η[:, None], 1)
    a = (dN @ nodes)[:, 0]
    normal = np.stack([a[:, 1], -a[:, 0]], axis=1) / np.linalg.norm(a, axis=1, keepdims=True)
    found, distance = images_on_curve(shape, nodes, (N[:, None] @ nodes)[:, 0] + d[:, None] * normal)
    assert np.abs(found - η).max() < 1e-9
    assert np.abs(distance - d).max() < 1e-9


@pytest.mark.one_rank
def test_cuts_share_out_each_facet():
    """Whatever the cuts, the intervals of a facet go from 0 to 1 without gap; a sliver is none; each end knows its cut."""
    rng = np.random.default_rng(2)
    facet, η = rng.integers(0, 5, 40), np.concatenate([rng.uniform(0, 1, 36), [0.0, 1.0, 1e-12, 1 - 1e-12]])
    owner, first, last, begin, end = cuts_on_curve(facet, η, 7)
    assert np.allclose(np.bincount(owner, last - first, minlength=7), 1.0, rtol=0, atol=1e-15)
    assert (last - first).min() > 1e-6
    inner = np.flatnonzero(np.diff(owner) == 0)
    assert np.array_equal(last[inner], first[inner + 1]) and np.array_equal(end[inner], begin[inner + 1])
    assert np.array_equal(η[begin[begin >= 0]], first[begin >= 0]) and (begin[first == 0.0] == -1).all()


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("swap", [False, True], ids=["upper", "lower"])
@pytest.mark.parametrize("cells", [(5, 7), (16, 2), (3, 11)])
@pytest.mark.parametrize("order", [1, 2])
def test_patch_in_the_plane(order, cells, swap, friction):
    """Constant pressure to 1e-10, as Newton leaves it; Gauss points are 1e-3 to 5e-2 off."""
    pair = pressed(order=order, cells=cells, swap=swap, friction=friction)
    assert np.abs(pair.state.p / PRESSURE - 1).max(initial=0.0) < 1e-10


@pytest.mark.parametrize("swap", [False, True], ids=["upper", "lower"])
@pytest.mark.parametrize("cells", [(2, 3), (5, 2)])
@pytest.mark.parametrize("triangles", [False, True], ids=["box", "simplex"])
@pytest.mark.parametrize("order", [1, 2])
def test_patch_in_space(order, triangles, cells, swap):
    """As in the plane, with tetrahedra and hexahedra; Gauss points are 2e-3 to 3e-2 off."""
    pair = pressed(order=order, cells=cells, swap=swap, dim=3, triangles=triangles)
    assert np.abs(pair.state.p / PRESSURE - 1).max(initial=0.0) < 1e-10


@pytest.mark.parametrize("dim, triangles", [(2, False), (3, False), (3, True)], ids=["plane", "box", "simplex"])
@pytest.mark.parametrize("order, multiplier", [(1, 1), (2, 1), (2, 2)])
def test_patch_with_the_sides_in_the_surface(order, multiplier, dim, triangles):
    """Constant pressure up to the edges: open sides have no part in their nodes. It was half as high there before."""
    options = {"cells": (5, 3) if dim == 2 else (3, 2), "friction": 0.3, "multiplier_order": multiplier}
    pair = pressed(order=order, dim=dim, triangles=triangles, sides=True, **options)
    closed = pair.active.closed
    assert pair.closed_fraction() == pytest.approx(0.5 if dim == 2 else 0.25, rel=1e-9)
    assert np.abs(pair.state.p[closed] / PRESSURE - 1).max(initial=0.0) < 1e-10


@pytest.mark.one_rank
@pytest.mark.parametrize("window", [4, 3], ids=["square", "triangle"])
def test_clipped_polygons_share_out_the_window(window):
    """Cut by random lines into convex cells, a square's or triangle's parts in them have its area, and so have their fans."""
    rng = np.random.default_rng(3)
    cells = np.array([[[-1.0, -1.0], [2.0, -1.0], [2.0, 2.0], [-1.0, 2.0]]])
    count = np.array([4])
    for _ in range(6):
        normal = rng.standard_normal(2)
        height = (cells - rng.uniform(0, 1, 2)) @ normal
        (left, n), (right, m) = _clip_by_line(cells, count, height), _clip_by_line(cells, count, -height)
        v = max(left.shape[1], right.shape[1])
        padded = [np.pad(part, ((0, 0), (0, v - part.shape[1]), (0, 0))) for part in (left, right)]
        cells, count = np.concatenate(padded), np.concatenate([n, m])
        cells, count = cells[count > 2], count[count > 2]
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])[:window]
    total = 0.0
    for cell, n in zip(cells, count, strict=True):
        parts, k = clip(cell[None, :n], corners[None])
        fan = triangulate(parts, k)[1]
        area = areas(fan, np.full(len(fan), 3)).sum()
        assert abs(area - areas(parts, k).sum()) < 1e-14
        total += area
    assert abs(total - (1.0 if window == 4 else 0.5)) < 1e-13


def test_sliding_in_space():
    """Two bent beams of non-matching hexahedra with friction: the deflection is within 1e-3 of that of Gauss points."""
    tips = []
    for integration in ("gauss", "segments"):
        mesh = {"dim": 3, "along": (10, 8), "through": 2}
        problem, P = beams(order=1, friction=0.3, mesh=mesh, integration=integration)
        for step in quasistatic.march(problem, P, to=10.0, increments=4):
            assert step.rejected == 0
        tips.append(tip(problem)[1])
    assert abs(tips[1] / tips[0] - 1) < 1e-3


def test_membranes_that_slide():
    """With friction points move while contact settles on the linearised bulk; the midpoint is as far off as with Gauss points
    (1.8e-4 with 40 cells; docs/membranes.md)."""
    problem, p = membranes(cells=(30, 40), friction=0.5, integration="segments")
    for _ in quasistatic.march(problem, p, to=4400.0, increments=15):
        pass
    exact = Exact(friction=0.5).state(4400.0).midpoint_displacement
    middle = output.Probe(problem.u, [0.5, 0.0], problem.lower)()
    assert np.linalg.norm(middle - exact) < 5e-4 * np.linalg.norm(exact)


def test_history_does_not_hang_on_points(shared_path):
    """A checkpoint in the middle of a slide with friction goes on to the same state, though points have moved."""
    ends = []
    for resumed in (False, True):
        problem, P = beams(friction=0.3, mesh={"along": (10, 13)}, integration="segments")
        if resumed:
            start = Checkpoint(shared_path, problem).load().at
        else:
            for step in quasistatic.march(problem, P, to=5.0, increments=3):
                start = step.load
            Checkpoint(shared_path, problem).save(start)
        P.value = start
        for _ in quasistatic.march(problem, P, to=10.0, increments=3):
            pass
        ends.append(tip(problem))
    assert np.abs(ends[0] - ends[1]).max() < 1e-9  # m: Newton's tolerance


@pytest.mark.one_rank
@pytest.mark.parametrize("scale", [1e-8, 1e-7, 1e-6])
def test_flush_beams_under_next_to_nothing(scale):
    """Their tip goes down by .0343 m/N to half a per cent, as under 1e-4 N. An open point against the law by a pressure that
    decisions take for round-off had been no solution, and 1e-7 N failed."""
    problem, P = beams(order=1, integration="segments", mesh={"along": (10, 14)})
    steps = list(quasistatic.march(problem, P, to=scale, increments=2, smallest=0.5))
    assert sum(step.iterations for step in steps) <= 8
    assert tip(problem)[1] / scale == pytest.approx(-0.0343, rel=5e-3)


def test_segments_need_rays():
    problem, _ = blocks()
    contact = problem.pairs[0].contact
    with pytest.raises(ValueError, match='projection = "rays"'):
        Contact(contact.contactor, contact.target, integration="segments", projection="closest")
    with pytest.raises(ValueError, match='"segments" or "gauss"'):
        Contact(contact.contactor, contact.target, integration="exact")


def landing(path=None, resumed=False, to=0.02):
    """A block of 7 facets lands on one of 5, both free, uniaxial (ν = 0), one after the other in time: (pair, steps)."""
    mesh, body, tags = TwoBeams(height=0.5, along=(5, 7), across=2).create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (2,))))
    motion = dynamics.Motion(u, materials.saint_venant_kirchhoff(2e6, 0.0), density=1000.0, step=1e-3)
    motion.velocity.interpolate(lambda x: np.stack([0 * x[0], np.full(x.shape[1], -2.0)]), cells0=body.find(UPPER))
    motion.velocity.x.scatter_forward()
    contact = contact_of(mesh, tags, integration="segments")
    problem = ContactProblem(motion, contacts=[contact])
    start, ledger, keeper = 0.0, None, path and Checkpoint(path, problem)
    if resumed:
        saved = keeper.load()
        start, ledger = saved.at, saved.ledger
    steps = []
    for step in dynamics.march(problem, to=to, start=start, ledger=ledger):
        steps.append((step, problem.pairs[0].state.p.copy()))
        if keeper and not resumed and len(steps) == 10:
            keeper.save(step.time, step.ledger)
    return problem.pairs[0], steps


def test_impact_of_blocks(shared_path):
    """Under an impact, too, the pressure is uniform (to what Newton leaves), and energy is kept; a run resumed in its middle,
    where the points of the segments are part of the state, goes on the same way."""
    pair, steps = landing(shared_path)
    total = np.array([step.ledger.total for step, _ in steps])
    assert np.diff(total).max() < 1e-9 * total[0]
    worst = 0.0
    for step, p in steps:
        mean = pair.comm.allreduce(float(pair.j @ p)) / pair.area
        if np.linalg.norm(step.forces[0]) > 0:
            worst = max(worst, np.abs(p / mean - 1).max(initial=0.0))
    assert pair.comm.allreduce(worst, MPI.MAX) < 1e-6
    _, again = landing(shared_path, resumed=True)
    assert again[-1][0].ledger.total == pytest.approx(total[-1], rel=1e-10)
    assert again[-1][0].ledger.impact_loss == pytest.approx(steps[-1][0].ledger.impact_loss, abs=1e-10 * total[0])


@pytest.mark.one_rank
def test_flat_corners_are_left_out():
    """Of a square with a vertex amid each side, one of them off by a hair, and a corner that is there twice; and of a
    triangle, which stays one however thin it is."""
    square = [[0, 0], [0.5, -1e-9], [1, 0], [1, 1e-9], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]]
    thin = [[0, 0], [1, 0], [1, 1e-9]] + 6 * [[0, 0]]
    polygons, count = without_flat_corners(np.array([square, thin], dtype=float), np.array([9, 3]), 1e-4)
    assert count.tolist() == [4, 3]
    assert np.allclose(areas(polygons, count), [1.0, 0.0], atol=1e-8)
