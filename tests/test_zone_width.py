"""Local thickness of a contact zone, against its definition."""

import numpy as np
import pytest
from scenes import beams

from dolfinx_mortar_al.zone_width import STEP, WIDE, ZoneWidth


def width_of(dim, along, h, **shape):
    """The contactor of two beams 1 m long, on target nodes h (m) apart: `ZoneWidth` and (nf, dim) centres of own facets."""
    problem, _ = beams(order=1, mesh={"along": (3, along), "across": 4, "dim": dim, **shape})
    facets = problem.pairs[0].facets
    contactor = facets.gather()
    own = contactor.places_of(facets)
    return ZoneWidth(contactor, own, np.full(len(own), h), problem.comm), facets.X.mean(axis=1)


@pytest.mark.parametrize("h", [0.01, 0.04, 0.3])
def test_zones_in_the_plane_count_by_their_own_width(h):
    """Zones of 3 and 11 facets of 200: each has the cube of its width over WIDE h, 1 at most, rounded down to a power of
    STEP³; what is in no zone has nothing."""
    width, X = width_of(2, 200, h)
    for first, facets in ((20, 3), (100, 11)):
        zone = (X[:, 0] > (first - 0.01) / 200) & (X[:, 0] < (first + facets + 0.01) / 200)
        other = (X[:, 0] > 0.8) & (X[:, 0] < 0.8 + 1.5 / 200)  # one facet, far off
        share = width.share(zone | other)
        exact = min(1.0, (facets / 200 / (WIDE * h)) ** 3)
        assert (share[zone] <= exact * (1 + 1e-9)).all() and (share[zone] > exact * STEP**3 * (1 - 1e-9)).all()
        assert (share[other] <= min(1.0, (1 / 200 / (WIDE * h)) ** 3) * (1 + 1e-9)).all() and (share[other] > 0).all()
        assert not share[~zone & ~other].any()


def test_a_strip_in_space_counts_by_its_narrow_side():
    """Three facets wide and 4 long, across the beam from side to side: the width of three facets, whatever its length; and
    one that all of the contactor is in has no edge."""
    width, X = width_of(3, 50, h := 0.02)
    strip = (X[:, 0] > 0.4) & (X[:, 0] < 0.46)
    exact = (0.06 / (WIDE * h)) ** 3
    share = width.share(strip)
    off = np.sqrt(0.02 * 0.025) / 0.02  # facets count by the root of their area
    assert (share[strip] <= exact * 1.2).all() and (share[strip] >= exact * STEP**3 / off**9).all()
    assert (width.share(np.ones(len(X), dtype=bool)) == 1.0).all()
    assert not width.share(np.zeros(len(X), dtype=bool)).any()


@pytest.mark.one_rank
@pytest.mark.parametrize("dim, triangles", [(2, False), (3, False), (3, True)])
def test_thickness_is_that_of_the_largest_disc(dim, triangles):
    """Random zones against a search of all discs about centres of facets, which have a facet when its centre is no farther
    than a facet beyond them: alike to within two powers of STEP³."""
    width, X = width_of(dim, 30, h := 0.05, triangles=triangles)
    own = width._lengths
    for seed in range(5):
        zone = np.random.default_rng(seed).random(len(X)) < 0.9
        far = np.linalg.norm(X[:, None] - X, axis=2)
        inscribed = np.maximum(own, 2 * far[:, ~zone].min(axis=1) - own)
        has = zone[None] & (far <= 0.5 * inscribed + own[:, None])
        exact = np.minimum(1.0, (np.where(has, inscribed, 0.0).max(axis=1) / (WIDE * h)) ** 3)[zone]
        share = width.share(zone)[zone]
        assert (share <= exact * (1 + 1e-9)).all() and (share > exact * STEP**6 * (1 - 1e-9)).all()
