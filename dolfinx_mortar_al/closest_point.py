"""Closest-point map: contactor point 𝐱 → (facet, η) on the target, unit normal ν, gap g, tangents 𝐚_α and their variation.

The paper's projection. The target is the union of its curved facets, so the closest point lies inside a facet, on an edge or
at a vertex. The distance is continuous in 𝐱; the normal is not (``docs/projection.md``), so that rays are the default:

- inside a facet ν is the facet's outward normal and (𝐱 − 𝐲)·𝐚_α = 0;
- on an edge or vertex ν = ±(𝐱 − 𝐲)/|𝐱 − 𝐲|, the sign taken from the normals of the facets that meet there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.facet_sides import holding_points
from dolfinx_mortar_al.projection import Projection, TargetPoint, combine, dot, inverse
from dolfinx_mortar_al.search import tight_balls, where
from dolfinx_mortar_al.surface import GatheredFacets, ShapeFunctions, surface_normal

__all__ = ["ClosestPoint", "closest_in_facet", "penetrates", "project"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MAX_ITERATIONS = 30
TOLERANCE = 1e-9  # on the step in η: Newton squares the error, what is left after such a step is round-off
MEETING = 1e-9  # of a facet: distances from facets that meet at the closest point differ by less
LOW, HIGH = -0.5, 1.5  # how far beyond a facet's sides, in η, its closest point is looked for
AT_SIDE = 1e-6  # |𝐱 − 𝐲| over the facets' size below which its direction is noise: the facet's own normal serves


@dataclass
class ClosestPoint(Projection):
    """The closest-point map at n contactor points.

    Attributes:
        κ: (n, dim, dim) curvature ν·𝐲,αβ.
        Ā_inv: (n, dim, dim) inverse of A_αβ + g κ_αβ on the directions in which η may move (none at a vertex).
        A_inv: (n, dim, dim) inverse of the metric A_αβ = 𝐚_α·𝐚_β.
        inside: (n,) whether the closest point lies inside its facet, not on an edge or vertex.
    """

    κ: Array
    Ā_inv: Array
    A_inv: Array
    inside: NDArray[np.bool_]


def closest_in_facet(shape: ShapeFunctions, nodes: Array, x: Array, η: Array | None = None) -> Array:
    """η (n, dim) of the point of facet `nodes` (n, nodes, gdim) closest to 𝐱 (n, gdim), searched from `η`."""
    if η is None:
        η = np.repeat(shape.corners.mean(axis=0)[None], len(x), axis=0)
    if shape.dim == 1:
        return _closest_on_line(shape, nodes, x, η, np.zeros(1), np.ones(1))
    return _closest_on_patch(shape, nodes, x, η)


def _closest_on_line(shape: ShapeFunctions, nodes: Array, x: Array, η: Array, start: Array, direction: Array) -> Array:
    """Newton on s ∈ [0, 1] for the curve 𝐲(start + s direction) of each facet, an interval or a side; returns η (n, dim).

    With 𝐱 − 𝐲 = 𝐫 − 𝐜₁ s − 𝐜₂ s² all that the steps need are polynomials in s.
    """
    s = np.clip((η - start) @ direction / (direction @ direction), 0.0, 1.0)
    places = np.linspace(0.0, 1.0, shape.order + 1)
    N = shape.tabulate(start + places[:, None] * direction)[0]
    c0, c1, *more = np.moveaxis(np.linalg.inv(np.vander(places, increasing=True)) @ N @ nodes, 1, 0)
    r, c2 = x - c0, more[0] if more else np.zeros_like(c0)
    terms = np.stack([dot(r, c1), dot(r, c2), dot(c1, c1), dot(c1, c2), dot(c2, c2)])
    active = np.arange(len(s))
    for _ in range(MAX_ITERATIONS):
        (r1, r2, a11, a12, a22), t = terms, s[active]
        slope = r1 + t * (2 * r2 - a11 - t * (3 * a12 + t * 2 * a22))
        metric = a11 + 4 * t * (a12 + t * a22)
        bend = 2 * (r2 - t * (a12 + t * a22))
        # Newton where the distance is convex, Gauss–Newton elsewhere
        new = np.clip(t + slope / np.maximum(metric - bend, 0.2 * metric), 0.0, 1.0)
        s[active] = new
        moved = np.abs(new - t) > TOLERANCE
        active, terms = active[moved], terms[:, moved]
        if not active.size:
            break
    return start + s[:, None] * direction


def _closest_on_patch(shape: ShapeFunctions, nodes: Array, x: Array, η: Array) -> Array:
    """Newton inside each facet; where it leaves the facet, the closest of the points on the facet's edges."""
    η = η.copy()
    active = np.arange(len(η))
    for _ in range(MAX_ITERATIONS):
        N, dN, ddN = shape.tabulate(η[active], 2)
        Xa = nodes[active]
        r = x[active] - combine(N, Xa)
        a = dN @ Xa
        A = a @ np.swapaxes(a, 1, 2)
        H = A - np.einsum("nabk,nk->nab", ddN, (Xa @ r[:, :, None])[:, :, 0])
        convex = (H[:, 0, 0] > 0.2 * A[:, 0, 0]) & (_determinant(H) > 0.1 * _determinant(A))
        step = (inverse(np.where(convex[:, None, None], H, A)) @ (a @ r[:, :, None]))[:, :, 0]
        if shape.flat:  # that step is exact
            η += step
            break
        now = η[active]
        # what a bound stops leaves the other direction its whole step: else the points far beside a facet do not come to rest
        step[((now <= LOW) & (step < 0)) | ((now >= HIGH) & (step > 0))] = 0.0
        step *= np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        new = np.clip(now + step, LOW, HIGH)
        moved = np.abs(new - now).max(axis=1) > TOLERANCE
        η[active] = new
        active = active[moved]
        if not active.size:
            break
    outside = np.flatnonzero((η.min(axis=1) < 0) | (_upper_slack(shape, η).min(axis=1) < 0))
    if outside.size:
        η[outside] = _closest_on_edges(shape, nodes[outside], x[outside], η[outside])
    return η


def _determinant(A: Array) -> Array:
    """(n,) of matrices (n, 2, 2)."""
    return np.asarray(A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0])


def _closest_on_edges(shape: ShapeFunctions, nodes: Array, x: Array, η: Array) -> Array:
    best, distance = η.copy(), np.full(len(η), np.inf)
    for side in shape.sides:
        start, end = shape.nodes[side[0]], shape.nodes[side[1]]
        trial = _closest_on_line(shape, nodes, x, η, start, end - start)
        d = np.linalg.norm(x - combine(shape.tabulate(trial)[0], nodes), axis=1)
        closer = d < distance
        best[closer], distance[closer] = trial[closer], d[closer]
    return best


def _upper_slack(shape: ShapeFunctions, η: Array) -> Array:
    """How far η is from the reference facet's upper bounds: 1 − η (interval, quadrilateral) or 1 − η¹ − η² (triangle)."""
    if len(shape.corners) == 3:
        return 1.0 - η.sum(axis=1, keepdims=True)
    return 1.0 - η


def project(target: GatheredFacets, positions: Array, x: Array, candidates: Index) -> ClosestPoint:
    """The closest-point map of 𝐱 (n, gdim) onto the target whose nodes are at `positions`.

    Args:
        target: the surface.
        positions: (nodes, gdim) current positions of its nodes (m).
        x: (n, gdim) current contactor points (m).
        candidates: (n, k) facets that may hold the closest point, padded with −1.
    """
    at = _located(target, positions, x, candidates)
    _finish(target, positions, at)
    return at


def penetrates(
    target: GatheredFacets, positions: Array, x: Array, candidates: Index, depth: Array
) -> NDArray[np.bool_]:
    """(n,) whether 𝐱 lies by `depth` (n,) in m or more behind a closest point that is not at an end of the target; the other
    arguments as of :func:`project`."""
    at = _located(target, positions, x, candidates)
    return np.asarray(at.facing & (at.g > 0) & (at.g >= depth))


def _located(target: GatheredFacets, positions: Array, x: Array, candidates: Index) -> ClosestPoint:
    """The closest points with their normals and gaps."""
    point = np.arange(len(x))
    row, column, η, distance = _closest_of(target, positions, x, candidates)
    facet = candidates[row, column]

    table = np.full(candidates.shape, np.inf)
    table[row, column] = distance
    tie = 1e-12 * target.size_of_facets  # the first of equally close facets, whatever round-off says
    chosen = np.argmax(table <= table.min(axis=1, initial=np.inf)[:, None] + tie, axis=1)
    pair = np.zeros(candidates.shape, dtype=np.int64)
    pair[row, column] = np.arange(len(row))
    best = pair[point, chosen]
    at, on_side = _at(target, positions, x, TargetPoint(facet[best], η[best]))
    if on_side.size:
        meeting = np.flatnonzero(distance <= distance[best][row] + MEETING * target.size_of_facets)
        meeting = meeting[np.isin(row[meeting], on_side)]
        _turn_to_point(
            at, x, on_side, _meeting_normals(target, positions, facet[meeting], η[meeting], row[meeting], len(x))
        )
    return at


def _closest_of(
    target: GatheredFacets, positions: Array, x: Array, candidates: Index
) -> tuple[Index, Index, Array, Array]:
    """Row and column (m,) of the candidates that matter, the point η (m, dim) of each that is closest to 𝐱 and its distance
    (m,): of the facet whose middle is the nearest, and of those in balls no farther than that point."""
    centre, radius = tight_balls(positions[target.facets])
    away = np.where(candidates < 0, np.inf, np.linalg.norm(x[:, None] - centre[candidates], axis=2))
    first = np.argmin(away, axis=1)
    away -= radius[candidates]

    def look(row: Index, column: Index) -> tuple[Index, Index, Array, Array]:
        nodes = positions[target.facets[candidates[row, column]]]
        η = closest_in_facet(target.shape, nodes, x[row])
        return row, column, η, np.linalg.norm(x[row] - combine(target.shape.tabulate(η)[0], nodes), axis=1)

    every: Index = np.arange(len(x))
    begun = look(every, first)
    away[every, first] = np.inf
    rest = look(*_no_farther(target, positions, x, candidates, away, begun[3] + MEETING * target.size_of_facets))
    row, column = (np.concatenate([begun[k], rest[k]]) for k in (0, 1))
    η, distance = (np.concatenate([begun[k], rest[k]]) for k in (2, 3))
    return row, column, η, distance


def _no_farther(
    target: GatheredFacets, positions: Array, x: Array, candidates: Index, away: Array, distance: Array
) -> tuple[Index, Index]:
    """Row and column (m,) of the candidates whose balls are `away` (n, k) by no more than `distance` (n,), and neither are
    the points that they lie between, seen towards their middle and towards the nearest: from afar a ball is much deeper than
    its facet, and beside it much nearer."""
    row, column = where(away <= distance[:, None])
    points = holding_points(target.shape) @ positions[target.facets]
    for towards in (_middle, _nearest):
        r = points[candidates[row, column]] - x[row, None]
        way = towards(r)
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
        near = (r @ way[:, :, None])[:, :, 0].min(axis=1, initial=np.inf) <= distance[row]
        row, column = row[near], column[near]
    return row, column


def _middle(points: Array) -> Array:
    """(m, gdim) mean of points (m, k, gdim)."""
    return np.asarray(points.mean(axis=1))


def _nearest(points: Array) -> Array:
    """(m, gdim) that of the points (m, k, gdim) which is nearest to the origin."""
    return points[np.arange(len(points)), np.einsum("mki,mki->mk", points, points).argmin(axis=1)]


def _at(target: GatheredFacets, positions: Array, x: Array, point: TargetPoint) -> tuple[ClosestPoint, Index]:
    """Geometry of the target at known closest points, with the facet's own normal, and the points that lie on a side."""
    shape, n = target.shape, len(x)
    N, dN = shape.tabulate(point.η, 1)
    nodes = positions[target.facets[point.facet]]
    y, a = combine(N, nodes), dN @ nodes
    ν = surface_normal(a) * target.orientation[point.facet, None]
    ν /= np.linalg.norm(ν, axis=1, keepdims=True)
    r = x - y
    A_inv = inverse(a @ np.swapaxes(a, 1, 2))
    free = np.broadcast_to(np.eye(shape.dim), (n, shape.dim, shape.dim))
    inside, facing = np.ones(n, dtype=bool), np.ones(n, dtype=bool)
    at = ClosestPoint(point, facing, N, dN, y, a, ν, -dot(ν, r), A_inv, free, A_inv, inside)
    # a point on the surface has no direction to its closest point: the facet's own normal is as good as any
    near_side = np.flatnonzero(
        (np.linalg.norm(r, axis=1) > AT_SIDE * target.size_of_facets)
        & ((point.η.min(axis=1) < 1e-13) | (_upper_slack(shape, point.η).min(axis=1) < 1e-13))
    )
    if not near_side.size:
        return at, near_side
    at.Ā_inv = free.copy()
    at.Ā_inv[near_side], at_end = _free_directions(target, point, a, r, near_side)
    on_side = near_side[at.Ā_inv[near_side].trace(axis1=1, axis2=2) < shape.dim - 0.5]
    facing[near_side] = ~at_end
    inside[on_side] = False
    return at, on_side


def _turn_to_point(at: ClosestPoint, x: Array, on_side: Index, sign_normal: Array) -> None:
    """On edges and vertices ν is the direction to the point, the sign that of the facets that meet there."""
    r = x[on_side] - at.y[on_side]
    sign = np.where(dot(r, sign_normal[on_side]) < 0, -1.0, 1.0)
    at.ν[on_side] = sign[:, None] * r / np.linalg.norm(r, axis=1, keepdims=True)
    at.g[on_side] = -dot(at.ν[on_side], r)


def _finish(target: GatheredFacets, positions: Array, at: ClosestPoint) -> None:
    """Curvature, and the inverse of Ā = A + g κ on the free directions (which `at.Ā_inv` holds until now)."""
    shape, n, free = target.shape, len(at.g), at.Ā_inv
    at.κ = np.zeros((n, shape.dim, shape.dim))
    if not shape.flat:
        nodes = positions[target.facets[at.point.facet]]
        second = shape.tabulate(at.point.η, 2)[2]
        at.κ = np.einsum("nabk,nk->nab", second, (nodes @ at.ν[:, :, None])[:, :, 0])
    Ā = at.a @ np.swapaxes(at.a, 1, 2) + at.g[:, None, None] * at.κ
    at.Ā_inv = inverse(Ā)
    on_side = np.flatnonzero(~at.inside)
    if on_side.size:
        f = free[on_side]
        at.Ā_inv[on_side] = f @ np.linalg.pinv(f @ Ā[on_side] @ f, hermitian=True) @ f


def _meeting_normals(
    target: GatheredFacets, positions: Array, facet: Index, η: Array, row: Index, points: int
) -> Array:
    """(points, gdim) sum of the unit normals at η of the facets that hold the closest point of point `row`."""
    a = target.shape.tabulate(η, 1)[1] @ positions[target.facets[facet]]
    normal = surface_normal(a) * target.orientation[facet, None]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    total = np.zeros((points, positions.shape[1]))
    np.add.at(total, row, normal)
    return total


def _free_directions(
    target: GatheredFacets, point: TargetPoint, a: Array, r: Array, which: Index
) -> tuple[Array, NDArray[np.bool_]]:
    """For the points `which`: projector (m, dim, dim) on the directions in which η can move, and (m,) whether η sits on
    an end of the target. A bound counts as reached only where the distance pulls η against it."""
    shape, η = target.shape, point.η[which]
    m, dim = η.shape
    pull = np.einsum("nai,ni->na", a[which], r[which]) / np.linalg.norm(a[which], axis=2)
    free = np.repeat(np.eye(dim)[None], m, axis=0)
    at_end = np.zeros(m, dtype=bool)
    ends = target.boundary_sides[point.facet[which]]
    for k, (outward, origin) in enumerate(_sides_of_reference_facet(shape)):
        reached = ((η - origin) @ outward > -1e-13) & (pull @ outward > 1e-12 * target.size_of_facets)
        at_end |= reached & ends[:, k]
        direction = np.einsum("nab,b->na", free[reached], outward)
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        direction /= np.where(length > 1e-8, length, 1.0)
        free[reached] -= direction[:, :, None] * direction[:, None, :]
    return free, at_end


def _sides_of_reference_facet(shape: ShapeFunctions) -> list[tuple[Array, Array]]:
    """(outward normal, a point) of each side of the reference facet, in the order of `shape.sides`."""
    centre = shape.corners.mean(axis=0)
    result = []
    for side in shape.sides:
        points = shape.nodes[side]
        if shape.dim == 1:
            outward = points[0] - centre
        else:
            along = points[1] - points[0]
            outward = np.array([along[1], -along[0]])
            outward *= np.sign(outward @ (points[0] - centre))
        result.append((outward / np.linalg.norm(outward), points[0]))
    return result
