"""Closest-point map: contactor point 𝐱 → (facet, η) on the target, unit normal ν, gap g, tangents 𝐚_α and their variation.

The target is the union of its curved facets, so the closest point lies inside a facet, on an edge or at a vertex. The map
is the exact distance in all three cases and hence continuous in 𝐱 (``docs/projection.md``):

- inside a facet ν is the facet's outward normal and (𝐱 − 𝐲)·𝐚_α = 0;
- on an edge or vertex ν = ±(𝐱 − 𝐲)/|𝐱 − 𝐲|, the sign taken from the normals of the facets that meet there.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.surface import GatheredFacets, ShapeFunctions, surface_normal

__all__ = ["Projection", "TargetPoint", "closest_in_facet", "project"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MAX_ITERATIONS = 30
BEYOND = 0.2  # how far a facet that a point is held to goes on past its sides, in its reference coordinates
TOLERANCE = 1e-9  # on the step in η: Newton squares the error, what is left after such a step is round-off


@dataclass
class TargetPoint:
    """Material points of the target: facet (n,) and reference coordinates η (n, dim); Y of eq. (5)."""

    facet: Index
    η: Array

    def copy(self) -> TargetPoint:
        return TargetPoint(self.facet.copy(), self.η.copy())


@dataclass
class Projection:
    """The closest-point map at n contactor points; gdim = dim + 1.

    Attributes:
        point: facet (n,) and η (n, dim) of the closest point.
        facing: (n,) false where the closest point is an end of the target: the point faces no target.
        N: (n, nodes) target shape functions at η; dN: (n, dim, nodes) their derivatives N,α.
        y: (n, gdim) closest point; a: (n, dim, gdim) tangents 𝐚_α.
        ν: (n, gdim) unit normal, outward to the target; g: (n,) proximity −ν·(𝐱 − 𝐲), positive in penetration.
        κ: (n, dim, dim) curvature ν·𝐲,αβ.
        Ā_inv: (n, dim, dim) inverse of A_αβ + g κ_αβ on the directions in which η may move (none at a vertex).
        A_inv: (n, dim, dim) inverse of the metric A_αβ = 𝐚_α·𝐚_β.
        inside: (n,) whether the closest point lies inside its facet, not on an edge or vertex.
    """

    point: TargetPoint
    facing: NDArray[np.bool_]
    N: Array
    dN: Array
    y: Array
    a: Array
    ν: Array
    g: Array
    κ: Array
    Ā_inv: Array
    A_inv: Array
    inside: NDArray[np.bool_]

    def take(self, index: Index) -> Projection:
        """The map at some of the points."""
        point = TargetPoint(self.point.facet[index], self.point.η[index])
        rest = [getattr(self, f.name)[index] for f in fields(self)[1:]]
        return Projection(point, *rest)


def closest_in_facet(
    shape: ShapeFunctions, nodes: Array, x: Array, η: Array | None = None, beyond: NDArray[np.bool_] | None = None
) -> Array:
    """η (n, dim) of the point of facet `nodes` (n, nodes, gdim) closest to 𝐱 (n, gdim), searched from `η`.

    Where `beyond` (n,) is set the facet is taken to go on past its sides, by at most BEYOND in η.
    """
    beyond = np.zeros(len(x), dtype=bool) if beyond is None else beyond
    if η is None:
        η = np.repeat(shape.corners.mean(axis=0)[None], len(x), axis=0)
    if shape.dim == 1:
        return _closest_on_line(shape, nodes, x, η, np.zeros(1), np.ones(1), BEYOND * beyond)
    return _closest_on_patch(shape, nodes, x, η, beyond)


def _closest_on_line(
    shape: ShapeFunctions,
    nodes: Array,
    x: Array,
    η: Array,
    start: Array,
    direction: Array,
    slack: NDArray[np.floating] | float = 0.0,
) -> Array:
    """Newton on s ∈ [−slack, 1 + slack] for the curve 𝐲(start + s direction) of each facet; returns η (n, dim)."""
    slack = np.broadcast_to(np.asarray(slack, dtype=np.float64), len(x))
    s = np.clip((η - start) @ direction / (direction @ direction), -slack, 1.0 + slack)
    active = np.arange(len(s))
    for _ in range(MAX_ITERATIONS):
        N, dN, ddN = shape.tabulate(start + s[active, None] * direction, 2)
        Xa = nodes[active]
        r = x[active] - _combine(N, Xa)
        a = _combine(np.einsum("nak,a->nk", dN, direction), Xa)
        slope = np.einsum("ni,ni->n", r, a)
        metric = np.einsum("ni,ni->n", a, a)
        bend = np.einsum("ni,ni->n", r, _combine(np.einsum("nabk,a,b->nk", ddN, direction, direction), Xa))
        # Newton where the distance is convex, Gauss–Newton elsewhere
        new = s[active] + slope / np.maximum(metric - bend, 0.2 * metric)
        new = np.clip(new, -slack[active], 1.0 + slack[active])
        moved = np.abs(new - s[active]) > TOLERANCE
        s[active] = new
        active = active[moved]
        if not active.size:
            break
    return start + s[:, None] * direction


def _closest_on_patch(shape: ShapeFunctions, nodes: Array, x: Array, η: Array, beyond: NDArray[np.bool_]) -> Array:
    """Newton inside each facet; where it leaves the facet, the closest of the points on the facet's edges."""
    η = η.copy()
    active = np.arange(len(η))
    for _ in range(MAX_ITERATIONS):
        N, dN, ddN = shape.tabulate(η[active], 2)
        Xa = nodes[active]
        r = x[active] - _combine(N, Xa)
        a = dN @ Xa
        A = a @ np.swapaxes(a, 1, 2)
        H = A - np.einsum("nabk,nki,ni->nab", ddN, Xa, r)
        convex = (H[:, 0, 0] > 0.2 * A[:, 0, 0]) & (np.linalg.det(H) > 0.1 * np.linalg.det(A))
        step = np.linalg.solve(np.where(convex[:, None, None], H, A), np.einsum("nai,ni->na", a, r)[..., None])[..., 0]
        step *= np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        new = np.clip(η[active] + step, -0.5, 1.5)
        moved = np.abs(new - η[active]).max(axis=1) > TOLERANCE
        η[active] = new
        active = active[moved]
        if not active.size:
            break
    outside = np.flatnonzero(~beyond & ((η.min(axis=1) < 0) | (_upper_slack(shape, η).min(axis=1) < 0)))
    if outside.size:
        η[outside] = _closest_on_edges(shape, nodes[outside], x[outside], η[outside])
    return η


def _closest_on_edges(shape: ShapeFunctions, nodes: Array, x: Array, η: Array) -> Array:
    best, distance = η.copy(), np.full(len(η), np.inf)
    for side in shape.sides:
        start, end = shape.nodes[side[0]], shape.nodes[side[1]]
        trial = _closest_on_line(shape, nodes, x, η, start, end - start)
        d = np.linalg.norm(x - _combine(shape.tabulate(trial)[0], nodes), axis=1)
        closer = d < distance
        best[closer], distance[closer] = trial[closer], d[closer]
    return best


def _upper_slack(shape: ShapeFunctions, η: Array) -> Array:
    """How far η is from the reference facet's upper bounds: 1 − η (interval, quadrilateral) or 1 − η¹ − η² (triangle)."""
    if len(shape.corners) == 3:
        return 1.0 - η.sum(axis=1, keepdims=True)
    return 1.0 - η


def _combine(N: Array, nodes: Array) -> Array:
    """Σ_k N_k 𝐗_k: (n, k), (n, k, gdim) → (n, gdim)."""
    return (N[:, None, :] @ nodes)[:, 0]


def project(
    target: GatheredFacets,
    positions: Array,
    x: Array,
    candidates: Index,
    previous: TargetPoint | None = None,
    held: NDArray[np.bool_] | None = None,
) -> Projection:
    """The closest-point map of 𝐱 (n, gdim) onto the target whose nodes are at `positions`.

    Args:
        target: the surface.
        positions: (nodes, gdim) current positions of its nodes (m).
        x: (n, gdim) current contactor points (m).
        candidates: (n, k) facets that may hold the closest point, padded with −1.
        previous: an earlier closest point, where the search starts on the same facet.
        held: (n,) points that stay on their previous facet, continued past its sides.
    """
    if held is not None and held.any():
        assert previous is not None
        candidates = np.where(held[:, None], -1, candidates)
        candidates[held, 0] = previous.facet[held]
    else:
        held = np.zeros(len(x), dtype=bool)
    point, row, column = np.arange(len(x)), *np.nonzero(candidates >= 0)
    facet = candidates[row, column]
    nodes = positions[target.facets[facet]]
    η = np.repeat(target.shape.corners.mean(axis=0)[None], len(facet), axis=0)
    if previous is not None:
        same = previous.facet[row] == facet
        η[same] = previous.η[row[same]]
    η = closest_in_facet(target.shape, nodes, x[row], η, held[row])
    distance = np.linalg.norm(x[row] - _combine(target.shape.tabulate(η)[0], nodes), axis=1)

    table = np.full(candidates.shape, np.inf)
    table[row, column] = distance
    if previous is not None:  # of equally close facets keep the one that was closest before
        tie = 1e-12 * target.size_of_facets
        table -= tie * (candidates == previous.facet[:, None])
    chosen = np.argmin(table, axis=1)
    pair = np.zeros(candidates.shape, dtype=np.int64)
    pair[row, column] = np.arange(len(row))
    best = pair[point, chosen]
    at, on_side = _at(target, positions, x, TargetPoint(facet[best], η[best]), held)
    if on_side.size:
        meeting = np.flatnonzero(distance <= distance[best][row] + 1e-9 * target.size_of_facets)
        meeting = meeting[np.isin(row[meeting], on_side)]
        _turn_to_point(
            at, x, on_side, _meeting_normals(target, positions, facet[meeting], η[meeting], row[meeting], len(x))
        )
    _finish(target, positions, at)
    return at


def _at(
    target: GatheredFacets, positions: Array, x: Array, point: TargetPoint, held: NDArray[np.bool_]
) -> tuple[Projection, Index]:
    """Geometry of the target at known closest points, with the facet's own normal, and the points that lie on a side."""
    shape, n = target.shape, len(x)
    N, dN = shape.tabulate(point.η, 1)
    nodes = positions[target.facets[point.facet]]
    y, a = _combine(N, nodes), dN @ nodes
    ν = surface_normal(a) * target.orientation[point.facet, None]
    ν /= np.linalg.norm(ν, axis=1, keepdims=True)
    r = x - y
    A_inv = _inverse(a @ np.swapaxes(a, 1, 2))
    free = np.broadcast_to(np.eye(shape.dim), (n, shape.dim, shape.dim))
    inside, facing = np.ones(n, dtype=bool), np.ones(n, dtype=bool)
    at = Projection(point, facing, N, dN, y, a, ν, -_dot(ν, r), A_inv, free, A_inv, inside)
    # a point on the surface has no direction to its closest point: the facet's own normal is as good as any
    near_side = np.flatnonzero(
        ~held
        & (np.linalg.norm(r, axis=1) > 1e-10 * target.size_of_facets)
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


def _turn_to_point(at: Projection, x: Array, on_side: Index, sign_normal: Array) -> None:
    """On edges and vertices ν is the direction to the point, the sign that of the facets that meet there."""
    r = x[on_side] - at.y[on_side]
    sign = np.where(_dot(r, sign_normal[on_side]) < 0, -1.0, 1.0)
    at.ν[on_side] = sign[:, None] * r / np.linalg.norm(r, axis=1, keepdims=True)
    at.g[on_side] = -_dot(at.ν[on_side], r)


def _finish(target: GatheredFacets, positions: Array, at: Projection) -> None:
    """Curvature, and the inverse of Ā = A + g κ on the free directions (which `at.Ā_inv` holds until now)."""
    shape, n, free = target.shape, len(at.g), at.Ā_inv
    at.κ = np.zeros((n, shape.dim, shape.dim))
    if not shape.flat:
        nodes = positions[target.facets[at.point.facet]]
        second = shape.tabulate(at.point.η, 2)[2]
        at.κ = np.einsum("nabk,nk->nab", second, (nodes @ at.ν[:, :, None])[:, :, 0])
    Ā = at.a @ np.swapaxes(at.a, 1, 2) + at.g[:, None, None] * at.κ
    at.Ā_inv = _inverse(Ā)
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


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("ni,ni->n", a, b)


def _inverse(A: Array) -> Array:
    """Inverse of (n, 1, 1) or (n, 2, 2) matrices; large where singular (the centre of curvature)."""
    if A.shape[1] == 1:
        return 1.0 / np.where(A == 0.0, 1e-300, A)
    determinant = A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
    rows = [[A[:, 1, 1], -A[:, 0, 1]], [-A[:, 1, 0], A[:, 0, 0]]]
    adjoint = np.stack([np.stack(row, axis=1) for row in rows], axis=1)
    return adjoint / np.where(determinant == 0.0, 1e-300, determinant)[:, None, None]


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
