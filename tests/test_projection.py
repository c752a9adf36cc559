"""The closest-point map against SciPy's bounded minimisation on each facet, and its continuity at edges and ends."""

import basix
import numpy as np
import pytest
from scipy.optimize import minimize

from dolfinx_mortar_al import search
from dolfinx_mortar_al.closest_point import closest_in_facet, project
from dolfinx_mortar_al.projection import combine
from dolfinx_mortar_al.search import CandidateSearch, candidates, ray_candidates
from dolfinx_mortar_al.surface import GatheredFacets, ShapeFunctions

pytestmark = pytest.mark.one_rank

CELLS = {
    "line": basix.CellType.interval,
    "triangle": basix.CellType.triangle,
    "quadrilateral": basix.CellType.quadrilateral,
}


def curved_surface(cell: str, order: int, n: int = 3) -> GatheredFacets:
    """n (×n) facets over the unit interval or square, lifted to y (z) = 0.3 sin 2x (…)."""
    shape = ShapeFunctions(CELLS[cell], order)
    corners = []
    for ix in np.ndindex(*([n] * shape.dim)):
        o, h = np.array(ix) / n, 1 / n
        if cell == "triangle":
            corners += [(o, [[h, 0], [0, h]]), (o + h, [[-h, 0], [0, -h]])]
        else:
            corners += [(o, h * np.eye(shape.dim))]
    flat = np.array([o + shape.nodes @ np.array(A) for o, A in corners])  # (nf, nodes, dim)
    lift = 0.3 * np.sin(2 * flat[..., 0]) + (0.2 * np.cos(3 * flat[..., 1]) if shape.dim == 2 else 0)
    X = np.concatenate([flat, lift[..., None]], axis=2).reshape(-1, shape.dim + 1)
    key = np.round(X, 9)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    facets = inverse.reshape(flat.shape[:2])
    orientation = -np.ones(len(flat)) if shape.dim == 1 else np.ones(len(flat))  # outward = up
    return GatheredFacets(shape, facets, np.arange(len(first)), X[first], orientation)


def slow_distance(surface: GatheredFacets, x: np.ndarray) -> float:
    """Smallest distance over all facets by SciPy, several starts each."""
    shape, best = surface.shape, np.inf
    triangle = len(shape.corners) == 3
    for nodes in surface.X[surface.facets]:

        def squared(η, nodes=nodes):
            return float(np.sum((x - shape.tabulate(np.atleast_2d(η))[0][0] @ nodes) ** 2))

        for start in [*shape.corners, shape.corners.mean(axis=0)]:
            constraint = [{"type": "ineq", "fun": lambda η: 1 - η.sum()}] if triangle else []
            found = minimize(
                squared,
                start,
                bounds=[(0, 1)] * shape.dim,
                constraints=constraint,
                method="SLSQP",
                options={"ftol": 1e-15},
            )
            best = min(best, np.sqrt(found.fun))
    return best


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_distance_is_that_of_a_slow_minimisation(cell, order):
    surface = curved_surface(cell, order)
    d = surface.shape.dim + 1
    x = np.random.default_rng(3).uniform(-0.1, 1.1, (12, d))
    x[:, -1] = np.random.default_rng(4).uniform(-0.1, 0.7, 12)
    at = project(surface, surface.X, x, CandidateSearch(surface)(x, surface.X))
    slow = np.array([slow_distance(surface, p) for p in x])
    # the minimiser finds the squared distance to about 1e-14, the distance to its root
    assert np.allclose(np.linalg.norm(x - at.y, axis=1), slow, atol=2e-7)
    assert np.allclose(np.abs(at.g), np.linalg.norm(x - at.y, axis=1), atol=1e-13)
    assert np.allclose(np.linalg.norm(at.ν, axis=1), 1.0, atol=1e-13)
    assert np.allclose(x, at.y - at.g[:, None] * at.ν, atol=1e-12)  # x − y is along ν, also on edges and vertices


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_points_far_away_find_the_closest_of_all_facets(cell, order):
    """Bounds leave out the facets that cannot hold the closest point, and no other."""
    surface = curved_surface(cell, order)
    x = np.random.default_rng(5).uniform(-3.0, 4.0, (200, surface.shape.dim + 1))
    at = project(surface, surface.X, x, candidates(x, surface.X[surface.facets], 0.0))
    distances = []
    for nodes in surface.X[surface.facets]:
        every = np.repeat(nodes[None], len(x), axis=0)
        y = combine(surface.shape.tabulate(closest_in_facet(surface.shape, every, x))[0], every)
        distances.append(np.linalg.norm(x - y, axis=1))
    assert np.allclose(np.linalg.norm(x - at.y, axis=1), np.min(distances, axis=0), rtol=1e-13)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_points_beside_a_flat_facet_come_to_rest_in_a_few_iterations(cell, monkeypatch):
    """From far beside it in one direction, the other one is not shortened."""
    shape = ShapeFunctions(CELLS[cell], 2)
    nodes = np.concatenate([shape.nodes @ [[1.0, 0.2], [0.1, 0.8]], np.zeros((len(shape.nodes), 1))], axis=1)
    x = np.random.default_rng(6).uniform(-9.0, 9.0, (200, 3))
    nodes = np.repeat(nodes[None], len(x), axis=0)
    tabulate, looks = shape.tabulate, []

    def looked(η, derivatives=0):
        looks.extend([len(η)] if derivatives == 2 else [])
        return tabulate(η, derivatives)

    monkeypatch.setattr(shape, "tabulate", looked)
    closest_in_facet(shape, nodes, x)
    assert len(looks) < 10  # 30 are allowed


def test_gap_is_continuous_across_a_vertex_and_its_sign_says_inside():
    """Points on a path over a kink of a faceted (order 1) curve, outside and inside."""
    surface = curved_surface("line", 1)
    for side in (0.02, -0.02):
        x = np.stack([np.linspace(0.25, 0.42, 2001), 0.3 * np.sin(2 * np.linspace(0.25, 0.42, 2001)) + side], axis=1)
        at = project(surface, surface.X, x, CandidateSearch(surface)(x, surface.X))
        assert np.all(np.sign(at.g) == -np.sign(side))
        assert np.max(np.abs(np.diff(at.g))) < 2 * np.max(np.linalg.norm(np.diff(x, axis=0), axis=1))  # 1-Lipschitz


def test_points_beyond_the_end_face_no_target():
    surface = curved_surface("line", 2)
    x = np.array([[-0.05, 0.0], [0.5, 0.4], [1.05, 0.3]])
    at = project(surface, surface.X, x, CandidateSearch(surface)(x, surface.X))
    assert at.facing.tolist() == [False, True, False]


@pytest.mark.parametrize("cell", CELLS)
def test_candidates_hold_the_closest_facet_after_motion_within_the_margin(cell):
    surface = curved_surface(cell, 2)
    rng = np.random.default_rng(5)
    x = rng.uniform(0, 1, (40, surface.shape.dim + 1))
    margin = 0.2
    near = candidates(x, surface.X[surface.facets], margin)
    moved = x + rng.uniform(-1, 1, x.shape) * margin / 4 / np.sqrt(x.shape[1])
    every = np.tile(np.arange(len(surface.facets)), (len(x), 1))
    a = project(surface, surface.X, moved, near)
    b = project(surface, surface.X, moved, every)
    assert np.allclose(np.linalg.norm(moved - a.y, axis=1), np.linalg.norm(moved - b.y, axis=1), atol=1e-12)


@pytest.mark.parametrize("gdim", [2, 3])
def test_groups_of_points_find_what_all_facets_looked_at_would(gdim, monkeypatch):
    """Facets and points anywhere, rays in all directions: the groups' first cut loses nothing. The oracle is one group."""
    rng = np.random.default_rng(gdim)
    facets = rng.uniform(-1, 1, (300, 1, gdim)) + 0.04 * rng.standard_normal((300, gdim, gdim))
    x, normal = rng.uniform(-1.2, 1.2, (200, gdim)), rng.standard_normal((200, gdim))
    normal[100:] = normal[100] + 0.1 * normal[100:]  # half of them like those of a smooth surface
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    found = []
    for most in (10**6, 1):
        monkeypatch.setattr(search, "BATCH", most)
        monkeypatch.setattr(search, "GROUP", 16)
        table, (row, facet) = candidates(x, facets, 0.05), ray_candidates(x, normal, facets, 0.05, 0.1)
        found.append([np.sort(table, axis=1), np.sort(300 * row + facet)])
    assert 1 < found[0][0].shape[1] < 300 and len(found[0][1]) < 200 * 300
    for whole, grouped in zip(*found, strict=True):
        assert np.allclose(whole, grouped, rtol=1e-9, atol=0)
    nowhere = np.full((20, gdim), np.nan)  # a Newton step that went wrong: no error, the residual will say so
    assert len(candidates(nowhere, facets, 0.05)) == 20
    assert not len(ray_candidates(nowhere, nowhere, facets, 0.05)[0])
