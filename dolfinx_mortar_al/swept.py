"""Which points a step has carried through a surface or an obstacle: a thin body must not be passed unseen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.obstacles import Obstacle, Pose
from dolfinx_mortar_al.projection import dot, inverse
from dolfinx_mortar_al.search import where
from dolfinx_mortar_al.surface import GatheredFacets, surface_normal

__all__ = ["DEPTH", "changed_side", "depth_behind", "passed_obstacle", "passed_through"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

DEPTH = 0.05  # of a facet, behind which an open point that came through its front has not been seen by contact
CHUNK = 2**20  # couples of points and facets looked at together
OPPOSITE = -0.7  # cosine of the normals where a point has come in and out, of the two sides of a plate
STEEP = 0.7  # sine of the angle between a way and a surface, below which it leads along it
GRAZES = 1e-9  # of a way, on which a point that slides past an edge is in a surface at most
AROUND = 0.25  # of a piece, beside which it may hold the closest point of what is behind a hollow
BEHIND = 0.1  # cosine of the normals of a surface and of an obstacle, from which on that lies behind the surface,
BENEATH = 0.5  # and where the surface lies in it: beside a corner that is pressed in they are at an angle
SIDEWAYS = -0.3  # and where a membrane lies deep in it: its rim stands so around what has gone half through it,
DEEP_IN = 0.25  # of the obstacle's radius
TOUCHES = 1e-3  # of the depth: so near a path comes to what lies that deep
MAX_ITERATIONS = 100  # along a path; one that comes nearer that slowly grazes


def passed_through(
    target: GatheredFacets,
    before: Array,
    after: Array,
    x0: Array,
    x1: Array,
    depth: float,
    counts: Callable[[Index, Index], Bool] | None = None,
    touching: Bool | None = None,
) -> Bool:
    """(n,) points that went from 𝐱₀ to 𝐱₁ (n, gdim) through the front of a target facet and ended farther behind its plane
    than `depth` (m), or came out again at the other side of a plate. (A point that comes out again elsewhere may have gone
    round under contact, where surfaces slide over many facets.) Of those not what went through the target along facets that
    are `touching` (nf,), sliding past them rather than towards or from them, no farther from the middle of one than a facet
    is large: it has gone round under these.

    `before`, `after` (nodes, gdim) are the positions of the target's nodes. Facets count as flat between neighbouring nodes,
    and motions as straight. `counts` says of points (m,) and facets (m,) which couples are looked at, all by default.
    """
    passed = np.zeros(len(x0), dtype=bool)
    pieces = target.shape.pieces
    orientation = np.repeat(target.orientation, len(pieces))
    c0, c1 = (_corners(target, nodes) for nodes in (before, after))
    under = np.zeros(len(c0), dtype=bool) if touching is None else np.repeat(touching, len(pieces))
    middles = c0[under].mean(axis=1), c1[under].mean(axis=1)
    normals = _normal(c0[under], orientation[under]) + _normal(c1[under], orientation[under])
    for point, piece in _couples([c0, c1], [x0, x1], 0.0):
        if counts is not None:
            real = counts(point, piece // len(pieces))
            point, piece = point[real], piece[real]
        through, *times = _Ways(c0[piece], c1[piece], x0[point], x1[point], orientation[piece], point).through(depth)
        along = _along(middles, normals, (x0[through], x1[through]), times, target.size_of_facets)
        passed[through[~along]] = True
    return passed


def _along(
    middles: tuple[Array, Array], normals: Array, x: tuple[Array, Array], times: Sequence[Array], reach: float
) -> Bool:
    """(n,) points that come as near as `reach` (m) to any of the `middles` (m, gdim) between two `times` (n,), all moving
    straight on from where they are at 0 to where they are at 1, and past it, across its normal (m, gdim) of any length
    rather than along that; a share of the points at a time."""
    ν = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    near = np.zeros(len(x[0]), dtype=bool)
    rows = max(1, CHUNK // max(len(middles[0]), 1))
    for start in range(0, len(near) if len(middles[0]) else 0, rows):
        part = slice(start, start + rows)
        r, dr = (x[0][part, None] - middles[0]), (x[1] - x[0])[part, None] - (middles[1] - middles[0])
        t = -(r * dr).sum(axis=2) / np.maximum((dr * dr).sum(axis=2), 1e-300)
        t = np.clip(t, *(time[part, None] for time in times))
        past = np.abs(np.einsum("nmi,mi->nm", dr, ν)) <= STEEP * np.linalg.norm(dr, axis=2)
        near[part] = (past & (np.linalg.norm(r + t[:, :, None] * dr, axis=2) <= reach)).any(axis=1)
    return near


def depth_behind(target: GatheredFacets, nodes: Array, x: Array, reach: float) -> Array:
    """(n,) roughly how far 𝐱 (n, gdim) lies behind the flat pieces of a surface with its nodes at `nodes` (nodes, gdim), at
    most `reach` (m) or little more; −∞ where it is not over any."""
    pieces = target.shape.pieces
    orientation, c = np.repeat(target.orientation, len(pieces)), _corners(target, nodes)
    depth = np.full(len(x), -np.inf)
    for point, piece in _couples([c], [x], reach):
        over = _inside(c[piece], x[point], AROUND)
        point, piece = point[over], piece[over]
        height = _height(c[piece], x[point], orientation[piece])
        order = np.lexsort([np.abs(height), point])
        nearest = order[np.r_[True, np.diff(point[order]) > 0]] if len(order) else order
        depth[point[nearest]] = -height[nearest]
    return depth


def _corners(target: GatheredFacets, nodes: Array) -> Array:
    """(pieces, corners, gdim) of the flat pieces of all facets, facet after facet."""
    return np.asarray(nodes[target.facets[:, target.shape.pieces].reshape(-1, target.shape.dim + 1)])


def _couples(corners: Sequence[Array], x: Sequence[Array], slack: float) -> Iterator[tuple[Index, Index]]:
    """Points and pieces whose boxes, at all their positions 𝐱 (n, gdim) and corners (pieces, corners, gdim), come nearer
    than `slack` (m), a share of the points at a time and in their order."""
    low = np.min([c.min(axis=1) for c in corners], axis=0) - slack
    high = np.max([c.max(axis=1) for c in corners], axis=0) + slack
    first, last = np.min(x, axis=0), np.max(x, axis=0)
    every = first.min(axis=0, initial=np.inf), last.max(axis=0, initial=-np.inf)
    near = np.flatnonzero(((low <= every[1]) & (high >= every[0])).all(axis=1))
    rows = max(1, CHUNK // max(len(near), 1))
    for start in range(0, len(first) if len(near) else 0, rows):
        part = slice(start, start + rows)
        meets = np.ones((len(first[part]), len(near)), dtype=bool)
        for i in range(first.shape[1]):
            meets &= (first[part, None, i] <= high[near, i]) & (last[part, None, i] >= low[near, i])
        point, k = where(meets)
        yield start + point, near[k]


class _Ways:
    """Ways of points (m, gdim) past pieces of a surface with corners c (m, corners, gdim), both moving straight on.

    Attributes:
        point: (m,) which point each is of, of those that cross their piece, in order of time; entry: (m,) from the front.
    """

    def __init__(self, c0: Array, c1: Array, x0: Array, x1: Array, orientation: Array, point: Index) -> None:
        start, end = _height(c0, x0, orientation), _height(c1, x1, orientation)
        entry = (start >= 0) & (end < 0)
        t = np.where(start != end, start / np.where(start != end, start - end, 1.0), 0.0)
        across = np.flatnonzero(entry | ((start < 0) & (end >= 0)))
        c, x = (
            v[across] + t[across, None, None] * d[across] for v, d in ((c0, c1 - c0), (x0[:, None], (x1 - x0)[:, None]))
        )
        across = across[_inside(c, x[:, 0])]
        # out at the very edge where it came in: round-off must not have it go out first
        across = across[np.lexsort([t[across] - GRAZES * entry[across], point[across]])]
        self.point, self.entry, self._end, self._time = point[across], entry[across], end[across], t[across]
        self._normal = _normal((c0 + t[:, None, None] * (c1 - c0))[across], orientation[across])

    def through(self, depth: float) -> tuple[Index, Array, Array]:
        """The points that have passed, deeper than `depth` (m); between which times (shares of the way) they were inside."""
        m = len(self.point)
        following = np.minimum.accumulate(np.where(self.entry, m, np.arange(m))[::-1])[::-1]  # the next way out
        comes_out = np.zeros(m, dtype=bool)
        comes_out[following < m] = self.point[following[following < m]] == self.point[following < m]
        stays = self.entry & ~comes_out & (self._end < -depth)
        into = np.flatnonzero(self.entry & comes_out)
        into = into[dot(self._normal[into], self._normal[following[into]]) < OPPOSITE]  # a plate
        way_in = np.concatenate([np.flatnonzero(stays), into])
        way_out = np.concatenate([np.ones(stays.sum()), self._time[following[into]]])
        return self.point[way_in], self._time[way_in], way_out


def passed_obstacle(obstacle: Obstacle, before: Pose, x0: Array, x1: Array, depth: float) -> Bool:
    """(n,) points that went from 𝐱₀ to 𝐱₁ (n, gdim) through a rigid obstacle, `before` in another pose, deeper than `depth`
    (m), and are out of it again. Their motion relative to its surface counts as straight."""
    start = obstacle.carried(x0, before)
    ends = [-obstacle.project(x).g for x in (start, x1)]
    may = (ends[0] >= 0) & (ends[1] >= 0) & (ends[0] + ends[1] + 2 * depth < np.linalg.norm(x1 - start, axis=1))
    return _goes_deep(obstacle, start, x1, depth, may)


def changed_side(
    obstacle: Obstacle, before: Pose, x: Sequence[Array], n: Sequence[Array], depth: float, is_membrane: bool
) -> Bool:
    """(n,) points of a surface that a rigid obstacle, `before` in another pose, was in front of, and that it lies behind now,
    on whose way they went deeper into it than `depth` (m). A membrane it may have met from behind, too, and has gone through
    where it stands on end deep in the obstacle; what is in its very middle has passed as well.

    `x`, `n`: (n, gdim) positions (m) of the points and unit normals there, before and now. Where contact is right an obstacle
    lies in front of what it touches, however far this slides round it. Planes and hollows have no other side."""
    if obstacle.curvature <= 0.0:
        return np.zeros(len(x[0]), dtype=bool)
    start, turned = obstacle.carried(x[0], before), n[0] @ obstacle.swing(before).T
    end = obstacle.project(x[1])
    was, now = dot(turned, obstacle.project(start).ν), np.where(end.facing, dot(n[1], end.ν), 1.0)
    least = np.where(end.g > 0.0, BENEATH, BEHIND)
    if is_membrane:
        now = np.where((was > 0.0) & end.facing, -now, now)
        was = -np.abs(was)
        least[end.g > DEEP_IN / obstacle.curvature] = SIDEWAYS
    return _goes_deep(obstacle, start, x[1], depth, (was < np.minimum(least, 0.0)) & (now > least))


def _goes_deep(obstacle: Obstacle, start: Array, end: Array, depth: float, may: Bool) -> Bool:
    """(n,) which of the points that `may` are deeper in an obstacle than `depth` (m) somewhere on the straight way from
    `start` to `end` (n, gdim): where that is as far away as its clearance says it goes on by that (sphere tracing)."""
    deep = np.zeros(len(start), dtype=bool)
    length, at, on = np.linalg.norm(end - start, axis=1), np.zeros(len(start)), np.flatnonzero(may)
    for _ in range(MAX_ITERATIONS):
        if not len(on):
            break
        x = start[on] + at[on, None] * (end - start)[on]
        clearance = depth - obstacle.project(x).g
        met = clearance <= TOUCHES * depth
        deep[on[met]] = True
        at[on] += clearance / np.maximum(length[on], 1e-300)
        on = on[~met & (at[on] < 1.0)]
    return deep


def _normal(c: Array, orientation: Array) -> Array:
    """(m, gdim) unit normals of simplices with corners c (m, gdim, gdim)."""
    m = surface_normal(c[:, 1:] - c[:, :1]) * orientation[:, None]
    return np.asarray(m / np.linalg.norm(m, axis=1, keepdims=True))


def _height(c: Array, x: Array, orientation: Array) -> Array:
    """(m,) distance of 𝐱 in front of its simplex' plane (m)."""
    return dot(_normal(c, orientation), x - c[:, 0])


def _inside(c: Array, x: Array, around: float = 0.0) -> Bool:
    """(m,) whether 𝐱 lies over the simplex with corners c (m, gdim, gdim), or `around` it (share of its size)."""
    a = c[:, 1:] - c[:, :1]
    η = (inverse(a @ np.swapaxes(a, 1, 2)) @ (a @ (x - c[:, 0])[:, :, None]))[:, :, 0]
    inside: Bool = (η >= -around).all(axis=1) & (η.sum(axis=1) <= 1 + around)
    return inside
