"""Broad phase: which target facets can hold the closest point of each contactor point, or meet its ray.

Candidates are found with a margin and stay valid until points, nodes or rays have moved by a quarter of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.surface import GatheredFacets

__all__ = ["CandidateSearch", "RaySearch", "candidates", "ray_candidates"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BATCH = 2**20  # couples of points and facets looked at together: bounds the memory of a search


def _balls(facets: Array) -> tuple[Array, Array]:
    """Centre (nf, gdim) and radius (nf,) of a ball around each facet with nodes (nf, k, gdim)."""
    centre = facets.mean(axis=1)
    # a facet of order 2 stays within 1.25 times the hull of its nodes seen from their mean (Lebesgue constant)
    return centre, 1.25 * np.linalg.norm(facets - centre[:, None], axis=2).max(axis=1)


def _table(row: Index, facet: Index, n: int) -> Index:
    """(n, k) the facets of each row, padded with −1, from couples in order of `row`."""
    count = np.bincount(row, minlength=n)
    table = np.full((n, max(1, int(count.max(initial=0)))), -1, dtype=np.int64)
    table[row, np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)] = facet
    return table


def _squared_distances(x: Array, centre: Array) -> Iterator[tuple[slice, Array]]:
    """A slice of the points 𝐱 (n, gdim) at a time, and its (·, nf) squared distances from the centres (m²); both are
    near the coordinates' origin, far from it distances would lose their digits."""
    size, batch = np.einsum("fi,fi->f", centre, centre), max(1, BATCH // max(len(centre), 1))
    for first in range(0, len(x), batch):
        part = slice(first, first + batch)
        p = x[part]
        yield part, size - 2 * p @ centre.T + np.einsum("ni,ni->n", p, p)[:, None]


def candidates(x: Array, facets: Array, margin: float) -> Index:
    """(n, k) facets that can be closest to a point once points and nodes have moved by at most margin/4, padded with −1.

    Args:
        x: (n, gdim) points.
        facets: (nf, nodes, gdim) positions of the facets' nodes.
        margin: allowance for motion (m).
    """
    centre, radius = _balls(facets)
    rows: list[Index] = [np.empty(0, dtype=np.int64)]
    columns: list[Index] = [np.empty(0, dtype=np.int64)]
    origin = centre.mean(axis=0)
    for part, squared in _squared_distances(x - origin, centre - origin):
        distance = np.sqrt(np.maximum(squared, 0.0))
        # no point of the target is closer than `nearest` to x, and one is at most that far: a node of the nearest facet
        nearest = np.linalg.norm(x[part, None] - facets[distance.argmin(axis=1)], axis=2).min(axis=1)
        i, j = np.nonzero(distance - radius <= nearest[:, None] + margin)
        rows.append(part.start + i)
        columns.append(j)
    return _table(np.concatenate(rows), np.concatenate(columns), len(x))


def ray_candidates(x: Array, normal: Array, facets: Array, margin: float) -> tuple[Index, Array]:
    """(n, k) facets within `margin` (m) of the lines through 𝐱 along `normal`, padded with −1; and (n,) a length (m) that
    turns of a line are multiplied with: to its farthest facet, or twice to the nearest facet, on the line or not.

    Args:
        x: (n, gdim) points; normal: (n, gdim) unit vectors.
        facets: (nf, nodes, gdim) positions of the facets' nodes.
    """
    centre, radius = _balls(facets)
    origin = centre.mean(axis=0)
    centre, x = centre - origin, x - origin
    along_facets, along_points = centre @ normal.T, np.einsum("ni,ni->n", x, normal)
    rows: list[Index] = [np.empty(0, dtype=np.int64)]
    columns: list[Index] = [np.empty(0, dtype=np.int64)]
    reach = np.zeros(len(x))
    for part, squared in _squared_distances(x, centre):
        along = along_facets[:, part].T - along_points[part, None]
        i, j = np.nonzero(squared - along**2 <= (radius + margin) ** 2)
        reach[part] = 2 * np.sqrt(np.maximum(squared.min(axis=1), 0.0))
        np.maximum.at(reach, part.start + i, np.abs(along[i, j]))
        rows.append(part.start + i)
        columns.append(j)
    return _table(np.concatenate(rows), np.concatenate(columns), len(x)), reach


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
