"""How many Gauss points a facet has: as many as the target's facets that it faces ask for."""

import numpy as np
import pytest
from dolfinx import fem

from dolfinx_mortar_al import ContactProblem, Surface
from dolfinx_mortar_al.verify.meshes import build, graded, half_space
from dolfinx_mortar_al.verify.model import elastic_work, hold, make_contact, measures, space

FAR, SURFACE, OTHER_FAR, OTHER_SURFACE = 1, 2, 3, 4


def points_on(contactor, target, order):
    """(nf, 2) ends and (nf,) number of points of the facets of a contactor on a target, both from 0 to 8 m."""
    bodies = [
        half_space([x], np.array([0.0, 1.0]), up, 0.0, {(1, 0): surface, (1, -1): far}, order=order)
        for x, up, surface, far in ((contactor, True, SURFACE, FAR), (target, False, OTHER_SURFACE, OTHER_FAR))
    ]
    domain, cells, facets = build(bodies)
    V, u = space(domain, order)
    F = elastic_work(u, 1.0, 0.3, measures(domain, cells, facets)[0])
    contact = make_contact(Surface(domain, facets, SURFACE), Surface(domain, facets, OTHER_SURFACE))
    problem = ContactProblem(F, u, bcs=[hold(V, facets, FAR), hold(V, facets, OTHER_FAR)], contacts=[contact])
    assert isinstance(u, fem.Function)
    pair = problem.pairs[0]
    ends = np.sort(pair.facets.X[:, :, 0], axis=1)[:, [0, -1]]
    return ends, np.bincount(pair.integration.facet, minlength=pair.facets.size), pair


@pytest.mark.parametrize("order", [1, 2])
def test_each_facet_has_the_points_that_the_facets_it_faces_ask_for(order):
    """Where the target is graded: two points per facet of the target, or the least."""
    target = graded(1.0, 16, 8.0)
    ends, count, pair = points_on(np.linspace(0.0, 8.0, 17), target, order)
    sizes = np.diff(target)
    least = max(2 * order + 1, int(np.ceil(2 * 0.5 / sizes.mean())))  # for the mean, onto which they may slide
    for (start, end), n in zip(ends, count, strict=True):
        rim = 0.12 * (end - start)  # outside the outermost points
        finest = sizes[(target[1:] > start + rim) & (target[:-1] < end - rim)].min()
        assert n >= min(16, 2 * (end - start) / finest)
        if start > 3.0:
            assert n == least
    total = pair.integration.sum_by_facet(pair.j[:, None])[:, 0]
    assert total == pytest.approx(ends[:, 1] - ends[:, 0], rel=1e-12)


def test_a_graded_contactor_has_no_more_points_where_it_is_fine():
    """On equally graded surfaces the small facets, where contact is, have the least; before all had the most, 16."""
    x = graded(1.0, 16, 8.0)
    ends, count, _ = points_on(x, x, 2)
    assert (count[ends[:, 1] <= 1.0 + 1e-9] == 5).all()
