"""Which side of a fold carries the multiplier, where a surface is its own target (``docs/self_contact.md``).

Two parts of a surface that touch must not both carry multipliers: the gap would be prescribed twice, and the pressure would
not be unique. Of each couple of facets that see each other exactly one is therefore contactor, by an order of the facets that
all ranks share: a role, 0 (contactor) or 1 (target), and the number of the facet where the roles are alike.

Roles are a two-colouring of a graph: facets that see each other should differ, neighbours should agree. Both cannot always
hold (every fold has a crease); so edges are taken in order of the gap, those that close a loop are left out, and what remains
is a forest with one colouring for each tree. The roles thus change where the gap is widest, far from where anything touches.
Facets in contact keep their roles; where nothing touches yet the side with the smaller facets is the contactor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["assign", "precedes"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

FINER = 0.01  # share by which facets must be smaller to make a difference, whatever round-off says
ALIKE = 1e-6  # of the unit of gaps: those that differ by less count as equal, whatever round-off says


def precedes(role: Index, facet: Index, other: Index) -> Bool:
    """(n,) whether `facet` (n,) is contactor of `other` (n,) rather than the reverse; `role` (nf,) is 0 or 1."""
    result: Bool = np.where(role[facet] == role[other], facet < other, role[facet] < role[other])
    return result


def assign(
    couples: Index, gap: Array, unit: float, neighbours: Index, extents: Array, role: Index, held: Bool
) -> Index:
    """(nf,) roles 0 and 1 of the facets of one surface.

    Args:
        couples: (m, 2) facets that see each other; gap: (m,) the distance between them (m).
        unit: length by which gaps are judged (m).
        neighbours: (nf, k) facets that share a side with each; extents: (nf,) their sizes (m).
        role: (nf,) roles until now.
        held: (nf,) facets that keep theirs.
    """
    from scipy.sparse import coo_array  # slow to import
    from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

    n = len(role)
    start, end, differ = _edges(couples, gap, unit, neighbours, role, held)
    rank = np.arange(1.0, len(start) + 1.0)
    graph = coo_array((rank, (start.astype(np.int32), end.astype(np.int32))), shape=(n + 1, n + 1))
    forest = minimum_spanning_tree(graph.tocsr())
    kept = np.sort(forest.tocoo().data.astype(np.int64)) - 1
    i, j, turn = start[kept], end[kept], differ[kept] * (n + 1)
    # every facet in both colours: an edge joins equal or different ones, a tree falls into its two colourings
    rows, columns = np.concatenate([i, i + n + 1]), np.concatenate([j + turn, j + (n + 1) - turn])
    double = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * (n + 1), 2 * (n + 1)))
    label = connected_components(double, directed=False)[1].reshape(2, n + 1)
    _, first, tree = np.unique(label.min(axis=0), return_index=True, return_inverse=True)
    colour = (label[0] != label[0, first[tree]]).astype(np.int64)
    other = _is_finer(colour[:n], tree[:n], extents, len(first))
    other[tree[n]] = colour[n] == 1  # the root is of role 0
    return np.asarray((colour ^ other[tree])[:n])


def _is_finer(colour: Index, tree: Index, extents: Array, trees: int) -> Bool:
    """(trees,) whether the facets of colour 1 in each tree have the smaller mean size."""
    place = 2 * tree + colour
    count, total = np.bincount(place, minlength=2 * trees), np.bincount(place, extents, minlength=2 * trees)
    mean = (total / np.maximum(count, 1)).reshape(trees, 2)
    finer: Bool = (count.reshape(trees, 2)[:, 1] > 0) & (mean[:, 1] < (1 - FINER) * mean[:, 0])
    return finer


def _edges(
    couples: Index, gap: Array, unit: float, neighbours: Index, role: Index, held: Bool
) -> tuple[Index, Index, Index]:
    """Edges (start, end) of the graph in the order in which they count, once each, and whether (1) their ends differ or (0)
    agree. Held facets hang on a root, number nf."""
    n = len(role)
    seen = np.full(n, np.inf)
    for side in couples.T:
        np.minimum.at(seen, side, gap)
    a, b = np.repeat(np.arange(n), neighbours.shape[1]), neighbours.ravel()
    joined = (a < b) & np.isfinite(seen[a]) & np.isfinite(seen[b])
    a, b, root = a[joined], b[joined], np.flatnonzero(held)
    start = np.concatenate([root, couples.min(axis=1), a])
    end = np.concatenate([np.full(len(root), n), couples.max(axis=1), b])
    weight = np.round(np.concatenate([np.full(len(root), -1.0), gap, np.maximum(seen[a], seen[b])]) / (ALIKE * unit))
    kind = np.repeat([0, 1, 2], [len(root), len(couples), len(a)])
    differ = np.concatenate([role[root], np.ones(len(couples), dtype=np.int64), np.zeros(len(a), dtype=np.int64)])
    order = np.lexsort([end, start, kind, weight, kind > 0])
    start, end, differ = start[order], end[order], differ[order]
    once = np.sort(np.unique(start * (n + 1) + end, return_index=True)[1])
    return start[once], end[once], differ[once]
