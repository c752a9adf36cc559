"""Broad phase: which target facets can hold the closest point of each contactor point, or meet its ray.

Candidates are found with a margin and stay valid until points, nodes or rays have moved by a quarter of it. Points are looked
at in groups of neighbours: the facets that a group can have to do with are few, however large the target.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.surface import GatheredFacets

__all__ = ["CandidateSearch", "RaySearch", "balls", "candidates", "ray_candidates"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

GROUP, BATCH = (
    128,
    2**18,
)  # fewest points, and couples with all facets, looked at together: less makes more steps than work
BITS = 10  # of each coordinate along the curve that groups are cut from


def balls(facets: Array) -> tuple[Array, Array]:
    """Centre (nf, gdim) and radius (nf,) of a ball around each facet with nodes (nf, k, gdim)."""
    centre = facets.mean(axis=1)
    # a facet of order 2 stays within 1.25 times the hull of its nodes seen from their mean (Lebesgue constant)
    return centre, 1.25 * np.linalg.norm(facets - centre[:, None], axis=2).max(axis=1)


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
    centre, radius = balls(facets)
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
        i, j = np.nonzero(distance - radius[near] <= nearest[:, None] + margin)
        rows.append(group[i])
        columns.append(near[j])
    return _table(np.concatenate(rows), np.concatenate(columns), len(x))


def ray_candidates(x: Array, normal: Array, facets: Array, margin: float) -> tuple[Index, Array]:
    """(n, k) facets within `margin` (m) of the lines through 𝐱 along `normal`, padded with −1; and (n,) a length (m) that
    turns of a line are multiplied with: to its farthest facet, or twice to the nearest facet, on the line or not.

    Args:
        x: (n, gdim) points; normal: (n, gdim) unit vectors.
        facets: (nf, nodes, gdim) positions of the facets' nodes.
    """
    centre, radius = balls(facets)
    rows: list[Index] = [np.empty(0, dtype=np.int64)]
    columns: list[Index] = [np.empty(0, dtype=np.int64)]
    reach = np.zeros(len(x))
    for group in _groups(x, len(centre)):
        middle, n = x[group].mean(axis=0), normal[group]
        near: Index = np.arange(len(centre))
        if len(group) < len(x):
            near = near[_near_lines(x[group] - middle, n, centre - middle, radius + margin)]
        p, c = x[group] - middle, centre[near] - middle
        squared, along = _squared_distances(p, c), n @ c.T - np.einsum("ni,ni->n", p, n)[:, None]
        i, j = np.nonzero(squared - along**2 <= (radius[near] + margin) ** 2)
        reach[group] = 2 * np.sqrt(squared.min(axis=1))
        np.maximum.at(reach, group[i], np.abs(along[i, j]))
        rows.append(group[i])
        columns.append(near[j])
    return _table(np.concatenate(rows), np.concatenate(columns), len(x)), reach


def _spread(x: Array) -> float:
    return float(np.linalg.norm(x, axis=1).max())


def _near_lines(x: Array, normal: Array, centre: Array, reach: Array) -> NDArray[np.bool_]:
    """(nf,) balls around `centre` (nf, gdim) of radius `reach` (nf,) that some line through 𝐱 (n, gdim) may meet, and those
    whose centre may be the nearest to some 𝐱; the points' mean is the origin.

    With the points' spread ρ, a direction 𝐦 and δ = max |𝐧 − 𝐦| a centre 𝐟 is at most ρ + δ |𝐟| nearer to a line than to that
    through the origin along 𝐦.
    """
    m, spread = normal[0], _spread(x)
    turned = min(1.0, _spread(normal - m))
    far, along = np.linalg.norm(centre, axis=1), centre @ m
    beside = np.sqrt(np.maximum(far**2 - along**2, 0.0))
    beyond = (beside > reach + spread + turned * far) & (far > far.min() + 2 * spread)
    return ~beyond  # what is no number is near to all


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
    """Keeps a table of the facets near each ray and renews it when points, nodes or rays have moved too far."""

    target: GatheredFacets
    rebuilds: int = 0
    _table: Index | None = None
    _x: Array = field(default_factory=lambda: np.empty(0))
    _normal: Array = field(default_factory=lambda: np.empty(0))
    _nodes: Array = field(default_factory=lambda: np.empty(0))
    _reach: Array = field(default_factory=lambda: np.empty(0))

    def __call__(self, x: Array, normal: Array, nodes: Array) -> Index:
        """Candidates for rays from `x` along `normal` and target nodes at `nodes`."""
        margin = 0.5 * self.target.size_of_facets
        if (
            self._table is None
            or not (_near(x, self._x, margin / 4) and _near(nodes, self._nodes, margin / 4))
            or not _near(self._reach[:, None] * normal, self._reach[:, None] * self._normal, margin / 4)
        ):
            self._table, self._reach = ray_candidates(x, normal, nodes[self.target.facets], margin)
            self._x, self._normal, self._nodes = x.copy(), normal.copy(), nodes.copy()
            self.rebuilds += 1
        return self._table


def _near(a: Array, b: Array, distance: float) -> bool:
    return a.shape == b.shape and (not a.size or bool(np.max(np.einsum("ni,ni->n", a - b, a - b)) <= distance**2))
