"""Projection along the contactor's normal: 𝐱 + d 𝐧 = 𝐲(η), with ν = −𝐧 and g = −d (``docs/projection.md``).

A Gauss point lies inside its facet, where 𝐧 is smooth, and the target is a continuous surface: 𝐲, ν and g are continuous
in the displacements, also where the ray passes from one target facet to the next. The pressure acts along 𝐲 − 𝐱, so that a
pair's normal forces have no moment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.closest_point import project
from dolfinx_mortar_al.projection import Projection, TargetPoint, combine, dot, inverse
from dolfinx_mortar_al.search import CandidateSearch
from dolfinx_mortar_al.surface import GatheredFacets, ShapeFunctions, surface_normal

__all__ = ["RayHit", "cast", "hits"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

EDGE = 1e-9  # how far beyond a facet's sides, in η, a hit still counts: no ray slips through between two facets
FACING = 0.1  # least cosine between ray and target's normal: flatter hits have no sensible gap
DEEP = 0.5  # penetration, in facets, beyond which a hit behind the contactor must be confirmed by the closest point
MAX_ITERATIONS = 12  # of Newton for the hit on a curved facet; five do, unless the ray all but touches the facet


@dataclass
class RayHit(Projection):
    """Where the rays of n contactor points meet the target.

    Attributes:
        tangents: (n, dim, gdim) 𝐚₁_α of the contactor at 𝐱.
    """

    tangents: Array


def cast(
    target: GatheredFacets,
    positions: Array,
    x: Array,
    normal: Array,
    tangents: Array,
    candidates: Index,
    search: CandidateSearch,
    depth: Array | None = None,
) -> RayHit:
    """The nearest valid hit of each point's ray, in front of the contactor or, in penetration, behind it.

    Args:
        target: the surface.
        positions: (nodes, gdim) current positions of its nodes (m).
        x: (n, gdim) contactor points (m).
        normal: (n, gdim) the contactor's outward unit normal there; tangents: (n, dim, gdim) its covariant tangents (m).
        candidates: (n, k) facets that the rays may meet, padded with −1.
        search: for closest points, where a deep penetration is in doubt.
        depth: (n,) penetration (m) beyond which a hit behind the contactor does not count, in place of the closest points.
    """
    row, column = np.nonzero(candidates >= 0)
    row, facet, η, d = hits(target.shape, positions[target.facets], x, normal, row, candidates[row, column])
    a = target.shape.tabulate(η, 1)[1] @ positions[target.facets[facet]]
    m = surface_normal(a) * target.orientation[facet, None]
    cos = dot(m, normal[row]) / np.linalg.norm(m, axis=1)
    opposed, entry = cos < -FACING, _first_entry(len(x), row, d, cos)
    if depth is not None:
        opposed &= d >= -depth[row]
    row, facet, η, d = row[opposed], facet[opposed], η[opposed], d[opposed]

    nearest = _first_of_each(row, np.abs(d))
    limit = DEEP * target.size_of_facets
    deep = nearest[d[nearest] < -limit] if depth is None else nearest[:0]
    if len(deep):
        through = entry[row[deep]] > d[deep] + limit  # in on one side and out on the other: no need to ask
        outside, doubtful = row[deep[through]], row[deep[~through]]
        if len(doubtful):
            outside = np.r_[outside, doubtful[~_is_inside(target, positions, x[doubtful], search)]]
        real = ~(np.isin(row, outside) & (d < 0))
        row, facet, η, d = row[real], facet[real], η[real], d[real]
        nearest = _first_of_each(row, np.abs(d))

    n = len(x)
    facing = np.zeros(n, dtype=bool)
    facing[row[nearest]] = True
    point = TargetPoint(np.zeros(n, dtype=np.int64), np.repeat(target.shape.corners.mean(axis=0)[None], n, axis=0))
    g = np.full(n, -float(np.linalg.norm(np.ptp(positions, axis=0))))  # a gap that is none: nothing is faced
    point.facet[row[nearest]], point.η[row[nearest]], g[row[nearest]] = facet[nearest], η[nearest], -d[nearest]

    N, dN = target.shape.tabulate(point.η, 1)
    nodes = positions[target.facets[point.facet]]
    return RayHit(point, facing, N, dN, combine(N, nodes), dN @ nodes, -normal, g, tangents)


def hits(
    shape: ShapeFunctions, nodes: Array, x: Array, normal: Array, row: Index, facet: Index
) -> tuple[Index, Index, Array, Array]:
    """All meetings of the lines through 𝐱 (n, gdim) along `normal` with facets, from the couples (row, facet).

    `nodes` (nf, k, gdim) are the facets' nodes. Returns row, facet, η (m, dim) and the signed distance d (m,) of each.
    """
    across = np.swapaxes(_across(normal), 1, 2).copy()
    c = (nodes[facet] - x[row, None]) @ across[row]  # the line is the origin
    by_node = np.swapaxes(c, 0, 1).copy()  # NumPy is slow along a short axis that is not the first
    low, high = by_node.min(axis=0), by_node.max(axis=0)
    slack = (0.35 if shape.order > 1 else 1e-9) * (
        high - low
    )  # a curve leaves its nodes' box, a patch by a third at most
    near = ((low <= slack) & (high >= -slack)).all(axis=1)
    row, facet, c = row[near], facet[near], c[near]
    if shape.dim == 1:
        which, η = _on_curve(shape, c[:, :, 0])
    else:
        which, η = _on_patch(shape, c)
    row, facet = row[which], facet[which]
    d = dot(combine(shape.tabulate(η)[0], nodes[facet]) - x[row], normal[row])
    return row, facet, η, d


def _across(normal: Array) -> Array:
    """(n, dim, gdim) orthonormal vectors normal to `normal` (n, gdim)."""
    if normal.shape[1] == 2:
        return np.stack([-normal[:, 1], normal[:, 0]], axis=1)[:, None]
    first = np.cross(np.eye(3)[np.argmin(np.abs(normal), axis=1)], normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first)], axis=1)


def _on_curve(shape: ShapeFunctions, c: Array) -> tuple[Index, Array]:
    """Roots of Σ_k N_k(η) c_k on [0, 1]: which row of c (m, k) each is of, and η (·, 1)."""
    powers = shape.nodes ** np.arange(shape.order + 1)  # (k, k): monomials at the nodes
    coefficients = c @ np.linalg.inv(powers).T
    a0, a1 = coefficients[:, 0], coefficients[:, 1]
    a2 = coefficients[:, 2] if shape.order > 1 else np.zeros_like(a0)
    discriminant = a1**2 - 4 * a2 * a0
    q = -0.5 * (a1 + np.where(a1 >= 0, 1.0, -1.0) * np.sqrt(np.maximum(discriminant, 0.0)))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.stack([a0 / q, q / a2])  # the second is infinite or far where the curve is straight
    with np.errstate(invalid="ignore"):
        good = np.isfinite(roots) & (discriminant >= 0) & (roots >= -EDGE) & (roots <= 1 + EDGE)
    which = np.nonzero(good)[1]
    return which, np.clip(roots[good], 0.0, 1.0)[:, None]


def _on_patch(shape: ShapeFunctions, c: Array) -> tuple[Index, Array]:
    """Newton for Σ_k N_k(η) 𝐜_k = 0 from the middle of each facet, c (m, k, 2); one root at most is found."""
    η = np.repeat(shape.corners.mean(axis=0)[None], len(c), axis=0)
    active, converged = np.arange(len(c)), np.zeros(len(c), dtype=bool)
    for _ in range(MAX_ITERATIONS):
        if not active.size:
            break
        N, dN = shape.tabulate(η[active], 1)
        r, A = combine(N, c[active]), np.swapaxes(dN @ c[active], 1, 2)
        step = -(inverse(A) @ r[:, :, None])[:, :, 0]
        step *= np.minimum(1.0, 0.7 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        η[active] += step
        size, far = np.abs(step).max(axis=1), np.abs(η[active] - 0.5).max(axis=1) > 2.0
        converged[active] = size < EDGE  # Newton squares it
        active = active[(size >= EDGE) & ~far]
    triangle = len(shape.corners) == 3
    upper = 1.0 - η.sum(axis=1) if triangle else (1.0 - η).min(axis=1)
    which = np.flatnonzero(converged & (np.minimum(η.min(axis=1), upper) >= -EDGE))
    return which, η[which]


def _first_of_each(row: Index, key: Array) -> Index:
    """For each row number that occurs, the place where `key` is least."""
    order = np.lexsort([key, row])
    return order[np.r_[True, np.diff(row[order]) > 0]] if len(order) else order


def _first_entry(n: int, row: Index, d: Array, cos: Array) -> Array:
    """(n,) where the line from each point backwards first enters the target, as signed distance (m); −∞ if nowhere."""
    entry = np.full(n, -np.inf)
    enters = (d < 0) & (cos > FACING)
    np.maximum.at(entry, row[enters], d[enters])
    return entry


def _is_inside(target: GatheredFacets, positions: Array, x: Array, search: CandidateSearch) -> NDArray[np.bool_]:
    """(n,) whether the closest points say that 𝐱 (n, gdim) lies inside the target."""
    at = project(target, positions, x, search(x, positions))
    inside: NDArray[np.bool_] = at.facing & (at.g > 0)
    return inside
