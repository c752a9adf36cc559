"""Broad phase: which target facets can hold the closest point of each contactor point, or meet its ray.

Candidates are found with a margin and stay valid until points, nodes or rays have moved by it, or a quarter of it, or rays
have turned. Points are looked at in groups of neighbours: the facets that a group can have to do with are few, however large
the target.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import dot
from dolfinx_mortar_al.surface import GatheredFacets

__all__ = [
    "BULGE",
    "CandidateSearch",
    "RaySearch",
    "across",
    "balls",
    "candidates",
    "ray_candidates",
    "tight_balls",
    "where",
]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

GROUP, BATCH = (
    128,
    2**18,
)  # fewest points, and couples with all facets, looked at together: less makes more steps than work
MARGIN = 0.25  # of a facet, by which things may move until rays are searched anew,
TURN = 0.05  # and by which rays may turn (rad): as much for facets that are five of them away
BULGE = {1: 1e-9, 2: 0.35}  # by order: what a facet leaves its nodes' box by, over the box; a patch by a third at most
LEBESGUE = {1: 1.0, 2: 5.0 / 3.0}  # by order: motion of a facet's points over that of its nodes, at most
TIGHT = 0.81  # of the radius of `balls`: balls around the nodes alone, with 1 % to spare for round-off
BITS = 10  # of each coordinate along the curve that groups are cut from


def balls(facets: Array) -> tuple[Array, Array]:
    """Centre (nf, gdim) and radius (nf,) of a ball around each facet with nodes (nf, k, gdim), with room to spare."""
    centre = facets.mean(axis=1)
    # a facet of order 2 stays within 1.25 times the hull of its nodes seen from their mean (Lebesgue constant)
    return centre, 1.25 * np.linalg.norm(facets - centre[:, None], axis=2).max(axis=1, initial=0.0)


def tight_balls(facets: Array) -> tuple[Array, Array]:
    """The same with less room around facets of order 1, which lie between their nodes."""
    (centre, radius), (_, k, d) = balls(facets), facets.shape
    return centre, radius * (TIGHT if k <= 2 ** (d - 1) else 1.0)


def _table(row: Index, facet: Index, n: int) -> Index:
    """(n, k) the facets of each row, padded with −1, from couples."""
    order = np.argsort(row, kind="stable")
    row, facet = row[order], facet[order]
    count = np.bincount(row, minlength=n)
    table = np.full((n, max(1, int(count.max(initial=0)))), -1, dtype=np.int64)
    table[row, np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)] = facet
    return table


def _groups(x: Array, facets: int) -> list[Index]:
    """The points 𝐱 (n, gdim) in groups of neighbours: pieces of a curve through a grid's cells in Morton's order."""
    (n, d), size = x.shape, max(GROUP, BATCH // max(facets, 1))
    if n <= size:
        return [np.arange(n)] if n else []
    low = x.min(axis=0, initial=np.inf)
    width = max(float((x.max(axis=0, initial=-np.inf) - low).max(initial=0.0)), 1e-300)
    cell = np.clip(np.nan_to_num((x - low) / width * 2**BITS), 0, 2**BITS - 1).astype(np.int64)
    key = np.zeros(n, dtype=np.int64)
    for bit in range(BITS):
        for i in range(d):
            key |= (cell[:, i] >> bit & 1) << (d * bit + i)
    order = np.argsort(key, kind="stable")
    return [order[first : first + size] for first in range(0, n, size)]


def where(table: NDArray[np.bool_]) -> tuple[Index, Index]:
    """Rows and columns (m,) where a table is true, in their order; several times quicker than NumPy's `nonzero`."""
    return np.divmod(np.flatnonzero(table), max(table.shape[1], 1))


def _squared_distances(x: Array, centre: Array) -> Array:
    """(n, nf) of points and centres near the coordinates' origin: far from it distances would lose their digits."""
    size = np.einsum("fi,fi->f", centre, centre)
    return np.maximum(size - 2 * x @ centre.T + np.einsum("ni,ni->n", x, x)[:, None], 0.0)


def candidates(x: Array, facets: Array, margin: float) -> Index:
    """(n, k) facets that can be closest to a point once points and nodes have moved by at most margin/4, padded with −1.

    Args:
        x: (n, gdim) points.
        facets: (nf, nodes, gdim) positions of the facets' nodes.
        margin: allowance for motion (m).
    """
    centre, radius = tight_balls(facets)
    rows: list[Index] = [np.empty(0, dtype=np.int64)]
    columns: list[Index] = [np.empty(0, dtype=np.int64)]
    for group in _groups(x, len(centre)):
        middle, near = x[group].mean(axis=0), np.arange(len(centre))
        if len(group) < len(x):
            spread, far = _spread(x[group] - middle), np.linalg.norm(centre - middle, axis=1)
            near = near[~(far - radius > far.min() + radius.max() + 2 * spread + margin)]
        distance = np.sqrt(_squared_distances(x[group] - middle, centre[near] - middle))
        # no point of the target is closer than `nearest` to x, and one is at most that far: a node of the nearest facet
        nearest = np.linalg.norm(x[group, None] - facets[near[distance.argmin(axis=1)]], axis=2).min(axis=1)
        i, j = where(distance - radius[near] <= nearest[:, None] + margin)
        rows.append(group[i])
        columns.append(near[j])
    return _table(np.concatenate(rows), np.concatenate(columns), len(x))


def ray_candidates(x: Array, normal: Array, facets: Array, margin: float, turn: float = 0.0) -> tuple[Index, Index]:
    """Couples of points (m,), ascending, and facets (m,) within `margin` (m) of the lines through 𝐱 along `normal`, or of
    those that differ from them by a `turn` (rad).

    Args:
        x: (n, gdim) points; normal: (n, gdim) unit vectors.
        facets: (nf, nodes, gdim) positions of the facets' nodes.
    """
    centre, radius = tight_balls(facets)
    rows: list[Index] = [np.empty(0, dtype=np.int64)]
    columns: list[Index] = [np.empty(0, dtype=np.int64)]
    for group in _groups(x, len(centre)):
        middle, n = x[group].mean(axis=0), normal[group]
        near: Index = np.arange(len(centre))
        if len(group) < len(x):
            near = near[_near_lines(x[group] - middle, n, centre - middle, radius, margin, turn)]
        p, c = x[group] - middle, centre[near] - middle
        axes = np.moveaxis(across(n), 1, 0)
        beside = [e @ c.T - dot(p, e)[:, None] for e in axes]
        squared = beside[0] ** 2 if len(beside) == 1 else beside[0] ** 2 + beside[1] ** 2
        reach: Array = radius[near] + margin
        if turn:
            reach = reach + turn * (np.sqrt(_squared_distances(p, c)) + radius[near])
        i, j = where(squared <= reach**2)
        rows.append(group[i])
        columns.append(near[j])
    row, column = np.concatenate(rows), np.concatenate(columns)
    order = np.argsort(row, kind="stable")
    return row[order], column[order]


def across(normal: Array) -> Array:
    """(n, dim, gdim) orthonormal vectors normal to `normal` (n, gdim)."""
    if normal.shape[1] == 2:
        return np.asarray(normal[:, None, ::-1] * np.array([-1.0, 1.0]))
    first = np.cross(np.eye(3)[np.argmin(np.abs(normal), axis=1)], normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first)], axis=1)


def clearance(order: int, x: Array, normal: Array, nodes: Array) -> Array:
    """(m,) distance (m) that the line through 𝐱 along `normal` (m, gdim) keeps at least from a facet of the order, with nodes
    (m, k, gdim)."""
    c = np.moveaxis((nodes - x[:, None]) @ np.swapaxes(across(normal), 1, 2), 1, 0).copy()
    low, high = c.min(axis=0), c.max(axis=0)
    slack = BULGE[order] * (high - low)
    return np.asarray(np.linalg.norm(np.maximum(np.maximum(low - slack, -high - slack), 0.0), axis=1))


def _spread(x: Array) -> float:
    return float(np.linalg.norm(x, axis=1).max())


def _near_lines(x: Array, normal: Array, centre: Array, radius: Array, margin: float, turn: float) -> NDArray[np.bool_]:
    """(nf,) balls around `centre` (nf, gdim) of `radius` (nf,) that some line through 𝐱 (n, gdim), moved by `margin` (m) and
    by a `turn` (rad), may meet; the points' mean is the origin.

    With the points' spread ρ, a direction 𝐦 and δ = max |𝐧 − 𝐦| a centre 𝐟 is at most ρ + δ |𝐟| nearer to a line than to that
    through the origin along 𝐦.
    """
    m, spread = normal[0], _spread(x)
    turned = min(1.0, _spread(normal - m))
    far, along = np.linalg.norm(centre, axis=1), centre @ m
    beside = np.sqrt(np.maximum(far**2 - along**2, 0.0))
    reach = radius + margin + turn * (far + spread + radius)
    return ~(beside > reach + spread + turned * far)  # what is no number is near to all


@dataclass
class CandidateSearch:
    """Keeps a table of candidates for closest points and renews it when something has moved too far."""

    target: GatheredFacets
    rebuilds: int = 0
    _table: Index | None = None
    _x: Array = field(default_factory=lambda: np.empty(0))
    _nodes: Array = field(default_factory=lambda: np.empty(0))

    def __call__(self, x: Array, nodes: Array) -> Index:
        """Candidates for contactor points `x` and target nodes at `nodes`."""
        margin = 0.5 * self.target.size_of_facets
        if self._table is None or not (_near(x, self._x, margin / 4) and _near(nodes, self._nodes, margin / 4)):
            self._table = candidates(x, nodes[self.target.facets], margin)
            self._x, self._nodes = x.copy(), nodes.copy()
            self.rebuilds += 1
        return self._table


@dataclass
class RaySearch:
    """Keeps couples of rays and facets near them, each with the distance between both. A couple needs to be looked at when
    its point, ray and nodes have moved by that distance; all are found anew when some have moved or turned by more than what
    they were found with."""

    target: GatheredFacets
    rebuilds: int = 0
    _row: Index = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    _facet: Index = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    _clearance: Array = field(default_factory=lambda: np.empty(0))
    _lever: Array = field(default_factory=lambda: np.empty(0))
    _x: Array | None = None
    _normal: Array = field(default_factory=lambda: np.empty(0))
    _nodes: Array = field(default_factory=lambda: np.empty(0))

    def __call__(self, x: Array, normal: Array, nodes: Array) -> tuple[Index, Index]:
        """Couples of rays (m,), ascending, from `x` along `normal`, and facets (m,) that they may meet, the target's nodes at
        `nodes`."""
        margin = MARGIN * self.target.size_of_facets
        moved, turned = self._moved(x, normal, nodes)
        if not (_largest(moved) <= margin and _largest(turned) <= TURN):
            self._find(x, normal, nodes, margin)
            moved = turned = np.zeros(len(x))
        now = self._clearance <= moved[self._row] + turned[self._row] * self._lever
        return self._row[now], self._facet[now]

    def _find(self, x: Array, normal: Array, nodes: Array, margin: float) -> None:
        """All couples that count until something has moved by the margin (m), or turned by TURN."""
        facets = nodes[self.target.facets]
        row, facet = ray_candidates(x, normal, facets, margin, TURN)
        distance = clearance(self.target.shape.order, x[row], normal[row], facets[facet])
        centre, radius = tight_balls(facets)
        lever = np.linalg.norm(centre[facet] - x[row], axis=1) + radius[facet]
        kept = distance <= margin + TURN * lever
        self._row, self._facet, self._clearance, self._lever = row[kept], facet[kept], distance[kept], lever[kept]
        self._x, self._normal, self._nodes = x.copy(), normal.copy(), nodes.copy()
        self.rebuilds += 1

    def _moved(self, x: Array, normal: Array, nodes: Array) -> tuple[Array, Array]:
        """(n,) how much nearer (m) a facet may have come to a ray that has not turned, and (n,) by how much each has turned;
        infinite where that is not known."""
        if self._x is None or x.shape != self._x.shape:
            return np.full(len(x), np.inf), np.zeros(len(x))
        of_nodes = LEBESGUE[self.target.shape.order] * _largest(np.linalg.norm(nodes - self._nodes, axis=1))
        return np.linalg.norm(x - self._x, axis=1) + of_nodes, np.linalg.norm(normal - self._normal, axis=1)


def _largest(values: Array) -> float:
    return float(values.max(initial=0.0))


def _near(a: Array, b: Array, distance: float) -> bool:
    return a.shape == b.shape and (not a.size or bool(np.max(np.einsum("ni,ni->n", a - b, a - b)) <= distance**2))
