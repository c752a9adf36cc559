"""The side of all facets that may hold a closest point, against the closest points themselves."""

import numpy as np
import pytest
from test_projection import CELLS, curved_surface

from dolfinx_mortar_al.closest_point import project
from dolfinx_mortar_al.facet_sides import is_behind
from dolfinx_mortar_al.search import candidates

pytestmark = pytest.mark.one_rank


@pytest.mark.parametrize("depth", [0.0, 0.01])
@pytest.mark.parametrize("crumpled", [0.0, 0.3], ids=["smooth", "crumpled"])
@pytest.mark.parametrize("cell, order", [(cell, order) for cell in CELLS for order in (1, 2)])
def test_what_is_known_is_what_closest_points_say(cell, order, crumpled, depth):
    """Points all round, beyond the ends too; a surface with folds inside facets leaves more of them open."""
    surface, rng = curved_surface(cell, order, n=8), np.random.default_rng(3)
    X = surface.X + crumpled * np.sqrt(surface.size_of_facets) * rng.uniform(-0.3, 0.3, surface.X.shape)
    x = rng.uniform(-0.2, 1.2, (500, surface.shape.dim + 1))
    x[:, -1] -= 0.5
    near = candidates(x, X[surface.facets], 0.0)
    at = project(surface, X, x, near)
    inside, known = is_behind(surface, X, x, near, np.full(len(x), depth))
    assert np.array_equal(inside[known], (at.facing & (at.g > depth))[known])
    if not crumpled:
        assert known.mean() > 0.3 and inside.sum() > 5
