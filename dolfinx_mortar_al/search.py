"""Broad phase: which target facets can hold the closest point of each contactor point.

Candidates are found with a margin and stay valid until contactor points or target nodes have moved by a quarter of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.surface import GatheredFacets

__all__ = ["CandidateSearch", "candidates"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def candidates(x: Array, facets: Array, margin: float) -> Index:
    """(n, k) facets that can be closest to a point once points and nodes have moved by at most margin/4, padded with −1.

    Args:
        x: (n, gdim) points.
        facets: (nf, nodes, gdim) positions of the facets' nodes.
        margin: allowance for motion (m).
    """
    from scipy.spatial import cKDTree

    centre = facets.mean(axis=1)
    # a facet of order 2 stays within 1.25 times the hull of its nodes seen from their mean (Lebesgue constant)
    radius = 1.25 * np.linalg.norm(facets - centre[:, None], axis=2).max(axis=1)
    tree = cKDTree(centre)
    # no point of the target is closer than `nearest` to x, and one is at most that far: a node of the nearest facet
    _, close = tree.query(x)
    nearest = np.linalg.norm(x[:, None] - facets[close], axis=2).min(axis=1)
    balls = tree.query_ball_point(x, nearest + radius.max() + margin, return_sorted=True)
    count = np.fromiter((len(b) for b in balls), dtype=np.int64, count=len(x))
    facet = np.concatenate([np.asarray(b, dtype=np.int64) for b in balls]) if len(x) else np.empty(0, dtype=np.int64)
    row = np.repeat(np.arange(len(x)), count)
    keep = np.linalg.norm(x[row] - centre[facet], axis=1) - radius[facet] <= nearest[row] + margin
    row, facet = row[keep], facet[keep]
    count = np.bincount(row, minlength=len(x))
    table = np.full((len(x), max(1, int(count.max(initial=0)))), -1, dtype=np.int64)
    table[row, np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)] = facet
    return table


@dataclass
class CandidateSearch:
    """Keeps a table of candidates and renews it when something has moved too far."""

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


def _near(a: Array, b: Array, distance: float) -> bool:
    return not a.size or bool(np.max(np.einsum("ni,ni->n", a - b, a - b)) <= distance**2)
