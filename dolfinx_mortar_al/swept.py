"""Which contactor points a step has carried through a target: a thin body must not be passed unseen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import dot, inverse
from dolfinx_mortar_al.surface import GatheredFacets, surface_normal

__all__ = ["DEPTH", "passed_through"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

DEPTH = 0.05  # of a facet, behind which an open point that came through its front has not been seen by contact
CHUNK = 2**20  # couples of points and facets looked at together


def passed_through(
    target: GatheredFacets,
    before: Array,
    after: Array,
    x0: Array,
    x1: Array,
    depth: float,
    counts: Callable[[Index, Index], Bool] | None = None,
) -> Bool:
    """(n,) points that went from 𝐱₀ to 𝐱₁ (n, gdim) through the front of a target facet and ended farther behind its plane
    than `depth` (m); `before`, `after` (nodes, gdim) are the positions of the target's nodes. Facets count as flat, between
    their corners, and motions as straight. `counts` says of points (m,) and facets (m,) which couples are looked at, all by
    default."""
    passed = np.zeros(len(x0), dtype=bool)
    if not len(x0):
        return passed
    corners = target.facets[:, : len(target.shape.corners)]
    c0, c1 = before[corners], after[corners]  # (nf, corners, gdim)
    low, high = np.minimum(c0.min(axis=1), c1.min(axis=1)), np.maximum(c0.max(axis=1), c1.max(axis=1))
    near_low, near_high = np.minimum(x0, x1).min(axis=0), np.maximum(x0, x1).max(axis=0)
    facets = np.flatnonzero(((low <= near_high) & (high >= near_low)).all(axis=1))
    if not len(facets):
        return passed
    rows = max(1, CHUNK // len(facets))
    for start in range(0, len(x0), rows):
        a, b = x0[start : start + rows], x1[start : start + rows]
        meets = (np.minimum(a, b)[:, None] <= high[facets]) & (np.maximum(a, b)[:, None] >= low[facets])
        point, k = np.nonzero(meets.all(axis=2))
        facet = facets[k]
        if counts is not None:
            real = counts(start + point, facet)
            point, facet = point[real], facet[real]
        crossed = _crossed(c0[facet], c1[facet], a[point], b[point], target.orientation[facet], depth)
        passed[start + point[crossed]] = True
    return passed


def _crossed(c0: Array, c1: Array, x0: Array, x1: Array, orientation: Array, depth: float) -> Bool:
    """(m,) whether each point crosses its facet from the front, inside the facet; c (m, corners, gdim)."""
    height = [_height(c, x, orientation) for c, x in ((c0, x0), (c1, x1))]
    fall = height[0] - height[1]
    through = (height[0] >= 0) & (height[1] < -depth)
    t = np.where(through, height[0] / np.where(fall == 0.0, 1.0, fall), 0.0)[:, None]
    c, x = c0 + t[:, :, None] * (c1 - c0), x0 + t * (x1 - x0)
    if c.shape[1] == 4:  # a quadrilateral is two triangles
        inside = _inside(c[:, [0, 1, 2]], x) | _inside(c[:, [3, 1, 2]], x)
    else:
        inside = _inside(c, x)
    result: Bool = through & inside
    return result


def _height(c: Array, x: Array, orientation: Array) -> Array:
    """(m,) distance of 𝐱 in front of its facet's plane (m)."""
    m = surface_normal(c[:, 1 : c.shape[2]] - c[:, :1]) * orientation[:, None]
    return dot(m, x - c[:, 0]) / np.linalg.norm(m, axis=1)


def _inside(c: Array, x: Array) -> Bool:
    """(m,) whether 𝐱 lies over the simplex with corners c (m, gdim, gdim)."""
    a = c[:, 1:] - c[:, :1]
    η = (inverse(a @ np.swapaxes(a, 1, 2)) @ (a @ (x - c[:, 0])[:, :, None]))[:, :, 0]
    inside: Bool = (η >= 0).all(axis=1) & (η.sum(axis=1) <= 1)
    return inside
