"""Rays along the contactor's normals: against a slow root finder, complete, continuous, and their variation."""

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import root
from scipy.stats import special_ortho_group
from test_projection import CELLS, curved_surface

from dolfinx_mortar_al.carried import carried, components, vary_carried
from dolfinx_mortar_al.closest_point import project
from dolfinx_mortar_al.projection import TargetPoint
from dolfinx_mortar_al.rays import FACING, cast
from dolfinx_mortar_al.search import RaySearch, candidates
from dolfinx_mortar_al.surface import GatheredFacets, ShapeFunctions, surface_normal
from dolfinx_mortar_al.variation import Slots, vary

pytestmark = pytest.mark.one_rank

SURFACES = [(cell, order) for cell in CELLS for order in (1, 2)]


def tangents_of(normal):
    """(n, dim, gdim) some vectors across `normal`."""
    return np.stack([null_space(n[None]).T for n in normal])


def all_couples(points, facets):
    """Every point with every facet."""
    return np.repeat(np.arange(points), facets), np.tile(np.arange(facets), points)


def shoot(surface, x, normal, positions=None, couples=None):
    """`cast` with every facet a candidate, unless there are couples."""
    positions = surface.X if positions is None else positions
    couples = all_couples(len(x), len(surface.facets)) if couples is None else couples
    return cast(surface, positions, x, normal, tangents_of(normal), couples)


def random_rays(surface, n, seed):
    """Points above or a little below the surface, each with a ray towards a random point of it; where that is."""
    rng, shape = np.random.default_rng(seed), surface.shape
    η = rng.dirichlet(np.ones(len(shape.corners)), n) @ shape.corners
    nodes = surface.X[surface.facets[rng.integers(len(surface.facets), size=n)]]
    y = (shape.tabulate(η)[0][:, None] @ nodes)[:, 0]
    normal = rng.uniform(-0.4, 0.4, y.shape)
    normal[:, -1] = -1.0
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return y - rng.uniform(-0.05, 0.4, (n, 1)) * normal, normal, y


def slow_hit(surface, x, normal):
    """Signed distance to the nearest facet that the line meets and that faces it, by SciPy from several starts."""
    shape, across, found = surface.shape, null_space(normal[None]).T, []
    for nodes, orientation in zip(surface.X[surface.facets], surface.orientation, strict=True):

        def aside(η, nodes=nodes):
            return across @ (shape.tabulate(η[None])[0][0] @ nodes - x)

        for start in [*shape.corners, shape.corners.mean(axis=0)]:
            result = root(aside, start, tol=1e-14)
            η = result.x
            upper = 1 - η.sum() if len(shape.corners) == 3 else (1 - η).min()
            if np.abs(aside(η)).max() < 1e-10 and min(η.min(), upper) > -1e-9:
                N, dN = shape.tabulate(η[None], 1)
                m = orientation * surface_normal(dN[0] @ nodes)
                if -(m @ normal) > FACING * np.linalg.norm(m):
                    found.append((N[0] @ nodes - x) @ normal)
    return min(found, key=abs, default=np.nan)


@pytest.mark.parametrize("cell, order", SURFACES)
def test_hits_are_those_of_a_slow_root_finder(cell, order):
    """Half of the points are drawn anywhere, so that some rays miss."""
    surface = curved_surface(cell, order)
    x, normal, _ = random_rays(surface, 24, 1)
    x[::2, :-1] = np.random.default_rng(2).uniform(-0.3, 1.3, x[::2, :-1].shape)
    at = shoot(surface, x, normal)
    slow = np.array([slow_hit(surface, *ray) for ray in zip(x, normal, strict=True)])
    assert np.array_equal(at.facing, np.isfinite(slow))
    assert 0 < at.facing.sum() < len(x)
    hit = at.facing
    assert np.allclose(-at.g[hit], slow[hit], atol=1e-9)  # roots are good to 1e-10 across
    assert np.allclose((x - at.g[:, None] * normal)[hit], at.y[hit], atol=1e-9)  # x + d n = y
    assert np.array_equal(at.ν, -normal)


def test_hits_stay_with_their_rays():
    """Rays from both sides onto one arch, y = 0.6 (1 − (2η − 1)²), in turn, so that both roots of its equation are met: each
    meets the leg that opposes it, once."""
    arch = GatheredFacets(
        ShapeFunctions(CELLS["line"], 2),
        np.arange(3)[None],
        np.arange(3),
        np.array([[0, 0], [1, 0], [0.5, 0.6]]),
        -np.ones(1),
    )
    side, height = np.tile([1.0, -1.0], 10), np.linspace(0.05, 0.4, 20)
    x, normal = np.c_[0.5 - 2 * side, height], np.c_[side, np.zeros(20)]
    at = shoot(arch, x, normal)
    assert at.facing.all()
    leg = 0.5 - 0.5 * side * np.sqrt(1 - height / 0.6)
    assert np.allclose(at.y, np.c_[leg, height], atol=1e-12)


@pytest.mark.parametrize("shift", [0.0, 3e5], ids=["near", "1e6 facets away"])
@pytest.mark.parametrize("cell, order", SURFACES)
def test_no_ray_slips_through(cell, order, shift):
    """Rays to 3000 points of the surface, and to points of its inner edges and vertices, all hit, there or nearer."""
    surface = curved_surface(cell, order)
    x, normal, y = random_rays(surface, 3000, 3)
    rng, shape = np.random.default_rng(4), surface.shape
    edge = np.array(shape.sides)[rng.integers(len(shape.sides), size=1000)]
    along = rng.uniform(0, 1, (1000, 1)) * (rng.random((1000, 1)) > 0.3)  # some of them exactly at a vertex
    η = (1 - along) * shape.nodes[edge[:, 0]] + along * shape.nodes[edge[:, min(1, shape.dim - 1)]]
    on_edge = shape.tabulate(η)[0][:, None] @ surface.X[surface.facets[rng.integers(len(surface.facets), size=1000)]]
    x[:1000] += on_edge[:, 0] - y[:1000]
    y[:1000] = on_edge[:, 0]
    inner = np.all((y[:, :-1] > 0.01) & (y[:, :-1] < 0.99), axis=1)
    x, y, normal = x[inner], y[inner], normal[inner]
    at = shoot(surface, x + shift, normal, surface.X + shift)
    assert np.all(at.facing)
    # coordinates of 3e5 are good to 6e-11, the distance along an oblique ray to some times that
    assert np.all(np.abs(at.g) <= np.linalg.norm(y - x, axis=1) + (1e-12 if shift == 0 else 1e-8))


@pytest.mark.parametrize("cell, order", SURFACES)
def test_far_from_the_origin_the_same_hits(cell, order):
    surface = curved_surface(cell, order)
    x, normal, _ = random_rays(surface, 300, 5)
    far = np.array([3e5, -2e5, 1e5])[: x.shape[1]]  # a million facets away
    moved = GatheredFacets(surface.shape, surface.facets, surface.blocks, surface.X + far, surface.orientation)
    search = RaySearch(moved)
    here, there = shoot(surface, x, normal), shoot(moved, x + far, normal, couples=search(x + far, normal, moved.X))
    assert np.array_equal(here.facing, there.facing)
    assert np.allclose(here.g, there.g, atol=1e-8)  # the coordinates themselves are good to 6e-11


@pytest.mark.parametrize("cell, order", SURFACES)
def test_projection_is_continuous_across_the_facets(cell, order):
    """Points on a path over the surface, below it, where closest points jump, with a turning ray."""
    surface, n = curved_surface(cell, order), 4001
    t = np.linspace(0.0, 1.0, n)
    x = np.stack([0.1 + 0.8 * t, 0.15 + 0.6 * t, 0.3 * np.sin(0.2 + 1.6 * t) - 0.1], axis=1)
    normal = np.stack([0.2 * np.cos(3 * t), 0.2 * np.sin(4 * t), -np.ones(n)], axis=1)
    if surface.shape.dim == 1:
        x, normal = x[:, [0, 2]], normal[:, [0, 2]]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    at = shoot(surface, x, normal)
    assert np.all(at.facing) and np.sum(np.diff(at.point.facet) != 0) >= 2
    moved = np.linalg.norm(np.diff(x, axis=0), axis=1) + np.linalg.norm(np.diff(normal, axis=0), axis=1)
    # |∂y/∂x| is at most 1/cos of ray and facet's normal, here less than 3
    for jump in (np.diff(at.y, axis=0), np.diff(at.ν, axis=0), np.diff(at.g)[:, None]):
        assert np.all(np.linalg.norm(jump, axis=1) < 3 * moved)
    if order == 1:  # what the test is about: here the closest point's normal does jump
        near = project(surface, surface.X, x, candidates(x, surface.X[surface.facets], 0.0))
        assert np.any(np.linalg.norm(np.diff(near.ν, axis=0), axis=1) > 30 * moved)


@pytest.mark.parametrize("contactor_order", [1, 2])
@pytest.mark.parametrize("cell, order", SURFACES)
def test_variation_against_differences(cell, order, contactor_order):
    """δη, δg, δν and δs where the nodes of both sides move, below 1e-6 of their size."""
    surface, rng = curved_surface(cell, order), np.random.default_rng(6)
    d = surface.shape.dim + 1
    own = ShapeFunctions(CELLS[cell], contactor_order)
    η1 = rng.dirichlet(np.ones(len(own.corners)), 20) @ own.corners
    N1, dN1 = own.tabulate(η1, 1)
    nodes1 = np.c_[0.2 + 0.6 * own.nodes, np.zeros(len(own.nodes))]  # one facet above (and in) the target
    nodes1[:, -1] = 0.25 + (0.1 if d == 3 else 0.0) + 0.05 * np.sin(5 * nodes1[:, 0])
    old = TargetPoint(rng.integers(len(surface.facets), size=20), np.full((20, d - 1), 0.3))
    d1, d2 = rng.uniform(-1, 1, nodes1.shape), rng.uniform(-1, 1, surface.X.shape)
    N_old, dN_old = surface.shape.tabulate(old.η, 1)
    on_old = surface.facets[old.facet]
    ρ = rng.uniform(-1, 1, (20, d))  # a gap in which a point was, carried with the target

    def state(h):
        mine, theirs = nodes1 + h * d1, surface.X + h * d2
        tangents = dN1 @ mine
        normal = surface_normal(tangents) * (1.0 if d == 2 else -1.0)  # down
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        x = N1 @ mine
        every = all_couples(20, len(surface.facets))
        at = cast(surface, theirs, x, normal, tangents, every)
        return at, x - np.einsum("nk,nki->ni", N_old, theirs[on_old]) - carried(dN_old @ theirs[on_old], ρ)

    h = 1e-6
    (at, _), (plus, s_plus), (minus, s_minus) = state(0.0), state(h), state(-h)
    assert np.all(at.facing) and np.any(at.g < 0)
    inside = (at.point.facet == plus.point.facet) & (at.point.facet == minus.point.facet)
    assert inside.sum() >= 15
    slots = Slots(d, d, ("x", "w", *(f"{slot},{α}" for slot in "wx" for α in range(d - 1)), "w_p"))
    slots = Slots(d, d, (*slots.names, *(f"w_p,{α}" for α in range(d - 1))))
    δ2 = d2[surface.facets[at.point.facet]]
    given = {"x": N1 @ d1, "w": np.einsum("nk,nki->ni", at.N, δ2)}
    given |= {f"w,{α}": np.einsum("nk,nki->ni", at.dN[:, α], δ2) for α in range(d - 1)}
    given |= {f"x,{α}": dN1[:, α] @ d1 for α in range(d - 1)}
    given["w_p"] = np.einsum("nk,nki->ni", N_old, d2[on_old])
    given |= {f"w_p,{α}": np.einsum("nk,nki->ni", dN_old[:, α], d2[on_old]) for α in range(d - 1)}
    z = np.concatenate([given[name] for name in slots.names] + [np.zeros((20, d))], axis=1)
    δ = vary(at, slots)
    δ.s = δ.s - vary_carried(dN_old @ surface.X[on_old], ρ, slots, "w_p")
    for exact, difference in (
        (np.einsum("naz,nz->na", δ.η, z), plus.point.η - minus.point.η),
        (np.einsum("nz,nz->n", δ.g, z), plus.g - minus.g),
        (np.einsum("niz,nz->ni", δ.ν, z), plus.ν - minus.ν),
        (np.einsum("niz,nz->ni", δ.s, z), s_plus - s_minus),
    ):
        error = np.abs(exact - difference / (2 * h))[inside].max()
        assert error < 1e-6 * np.abs(exact[inside]).max()
        assert np.abs(exact[inside]).max() > 0.1


@pytest.mark.parametrize("gdim", [2, 3])
def test_a_vector_is_carried_with_its_facet(gdim):
    """At first it is what it was; a rotation turns it, and a stretch of the facet leaves the part along the normal."""
    rng = np.random.default_rng(12)
    a, r = rng.uniform(-1, 1, (20, gdim - 1, gdim)), rng.uniform(-1, 1, (20, gdim))
    Q = special_ortho_group.rvs(gdim, random_state=rng)
    ρ = components(a, r)
    assert np.allclose(carried(a, ρ), r, atol=1e-12)
    assert np.allclose(carried(a @ Q.T, ρ), r @ Q.T, atol=1e-12)
    m = surface_normal(a)
    assert np.allclose(np.sum(m * (carried(3 * a, ρ) - r), axis=1), 0.0, atol=1e-12)


@pytest.mark.parametrize("cell", CELLS)
def test_kept_candidates_give_the_hits_of_all_facets(cell):
    """Points, target and rays move at random; between renewals the table of an earlier state must do."""
    surface, rng = curved_surface(cell, 2, n=5), np.random.default_rng(7)
    search, positions = RaySearch(surface), surface.X.copy()
    x, normal, _ = random_rays(surface, 60, 8)
    for _ in range(60):
        x += rng.uniform(-1, 1, x.shape) * 0.004
        positions = positions + rng.uniform(-1, 1, positions.shape) * 0.002
        normal += rng.uniform(-1, 1, x.shape) * 0.02
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        kept = shoot(surface, x, normal, positions, search(x, normal, positions))
        every = shoot(surface, x, normal, positions)
        assert np.array_equal(kept.facing, every.facing)
        assert np.allclose(kept.g, every.g, atol=1e-12)
    assert 1 < search.rebuilds < 30  # the table was kept now and then, and renewed


def test_a_ray_that_turns_to_the_target_is_seen():
    """It passed all facets at first: no facet was near it, none says how little it may turn."""
    surface = curved_surface("line", 1)
    search, x = RaySearch(surface), np.array([[0.5, 0.8]])
    for normal, hit in ((np.array([[1.0, 0.0]]), False), (np.array([[0.0, -1.0]]), True)):
        at = shoot(surface, x, normal, couples=search(x, normal, surface.X))
        assert at.facing.tolist() == [hit]


def test_rays_past_the_ends_along_the_target_and_away_from_it_face_nothing():
    surface = curved_surface("line", 2)
    x = np.array([[-0.05, 0.4], [0.5, 0.5], [1.05, 0.4], [0.5, 0.3], [0.5, 0.2], [0.5, 0.5]])
    normal = np.array([[0, -1], [0, -1], [0, -1], [0, 1], [0, 1], [1, 0]], dtype=float)
    at = shoot(surface, x, normal)
    assert at.facing.tolist() == [False, True, False, False, False, False]
    assert np.all(at.g[~at.facing] < -1.0)  # a gap longer than the target


def sheets(*heights_and_sides):
    """Level lines of 8 facets over (0, 1): (height, ±1: the side that is outside)."""
    shape, k = ShapeFunctions(CELLS["line"], 1), 9
    X = np.concatenate([np.c_[np.linspace(0, 1, k), np.full(k, y)] for y, _ in heights_and_sides])
    first = np.concatenate([i * k + np.arange(k - 1) for i in range(len(heights_and_sides))])
    orientation = np.repeat([-float(side) for _, side in heights_and_sides], k - 1)
    return GatheredFacets(shape, np.c_[first, first + 1], np.arange(len(X)), X, orientation)


def test_a_hit_far_behind_counts_where_the_closest_point_agrees():
    """Facets are 1/8 long; a slab between y = 0 (outside is up) and y = −1 (down)."""
    slab, top = sheets((0.0, 1), (-1.0, -1)), sheets((0.0, 1))
    down = np.array([[0.0, -1.0]])
    for y, surface, facing, g in (
        (-0.05, slab, True, 0.05),  # shallow
        (-0.3, slab, True, 0.3),  # deep, and inside
        (-1.5, slab, False, None),  # on the slab's other side, turned away from it
        (-1.5, top, True, 1.5),  # no other side: inside
        (0.2, slab, True, -0.2),
    ):
        at = shoot(surface, np.array([[0.45, y]]), down)
        assert at.facing.tolist() == [facing]
        assert g is None or at.g[0] == pytest.approx(g, abs=1e-12)


def test_a_hit_far_behind_is_none_where_the_point_is_hardly_in_the_target():
    """Just below the target, with a level line that goes back through all of it to a slope far off: 0.655 behind the first
    point, which the closest point has 0.005 deep, and 0.055 behind the second."""
    surface = sheets((0.0, 1))
    surface.X[:, 1] = np.where(np.arange(9) < 7, 0.02, -0.1)
    at = shoot(surface, np.array([[0.1, 0.015], [0.7, 0.015]]), np.array([[-1.0, 0.0], [-1.0, 0.0]]))
    assert at.facing.tolist() == [False, True]
    assert at.g[1] == pytest.approx(0.75 + 0.125 * 0.005 / 0.12 - 0.7, abs=1e-12)


def test_the_far_side_of_a_tooth_behind_a_point_is_none():
    """A plate between y = −0.01 and −0.05, less than half a facet thick, and rays upwards: from above it the plate lies
    behind the point and is not penetrated, from within it is."""
    plate, up = sheets((-0.01, 1), (-0.05, -1)), np.array([[0.0, 1.0], [0.0, 1.0]])
    at = shoot(plate, np.array([[0.45, 0.0], [0.45, -0.03]]), up)
    assert at.facing.tolist() == [False, True]
    assert at.g[1] == pytest.approx(0.02, abs=1e-12)


def test_in_a_u_the_near_leg_is_faced():
    """Two sheets that face each other, a point between them: each ray takes the sheet it points to, also in penetration."""
    gap = sheets((0.0, 1), (0.5, -1))
    x = np.array([[0.3, 0.1], [0.3, 0.1], [0.3, -0.02], [0.3, 0.52]])
    normal = np.array([[0, -1], [0, 1], [0, -1], [0, 1]], dtype=float)
    at = shoot(gap, x, normal)
    assert np.all(at.facing)
    assert np.allclose(at.g, [-0.1, -0.4, 0.02, 0.02], atol=1e-12)
