"""Cuts that move with the target's end inside a facet of the contactor: what moves with them, and with what they move.

A part [a, b] of a facet in the plane has points η_k = a + (b − a) ξ_k and weights (b − a) ω_k. With the state of each point
as it is, a sum Σ w_k f(η_k) changes with a cut c by Σ (∂w_k/∂c f + w_k ∂f/∂η ∂η_k/∂c), and c with the bodies: the ray
through the target's end 𝐲 is at (𝐲 − 𝐱(c))·𝐱,η(c) = 0. Newton's tangent gets the product of both, of rank one for each
cut (``docs/integration.md``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import dot
from dolfinx_mortar_al.surface import Facets

__all__ = ["MovingCuts"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class MovingCuts:
    """Cuts of the contactor's facets that move with nodes of the target, and the points that move with them.

    Attributes:
        facet: (c,) of the contactor; η: (c,) where on it.
        node: (c,) of the target; end: (c,) a facet of the target with that node.
        cut: (m,) of couples of a cut and a point; point: (m,).
        dη, dw: (m,) ∂η_k/∂c and ∂w_k/∂c.
    """

    facet: Index
    η: Array
    node: Index
    end: Index
    cut: Index
    point: Index
    dη: Array
    dw: Array

    @classmethod
    def of(
        cls,
        points: tuple[Index, Array, Array],
        intervals: tuple[Index, Array, Array],
        cuts: tuple[Index, Index],
        ends: tuple[Index, Index],
    ) -> MovingCuts | None:
        """Of points (facet, η and weight, (n,)) in intervals (facet, first and last η, (i,)), None if none moves: `cuts` are
        the numbers of those at the first and at the last η, −1 where there is none that moves; `ends` the target's node and
        a facet with it by number."""
        facet, first, last = intervals
        begins = np.flatnonzero(cuts[0] >= 0)  # each cut has an interval on either side
        if not len(begins):
            return None
        begins = begins[np.argsort(cuts[0][begins])]
        used = cuts[0][begins]
        part = np.searchsorted(2.0 * facet + first, 2.0 * points[0] + points[1], side="right") - 1
        length = (last - first)[part]
        share = (points[1] - first[part]) / length
        columns: list[tuple[Index, Index, Array, Array]] = []
        for number, dη, sign in ((cuts[0][part], 1.0 - share, -1.0), (cuts[1][part], share, 1.0)):
            k = np.flatnonzero(number >= 0)
            columns.append((np.searchsorted(used, number[k]), k, dη[k], sign * points[2][k] / length[k]))
        moved = [np.concatenate(column) for column in zip(*columns, strict=True)]
        return cls(facet[begins], first[begins], ends[0][used], ends[1][used], *moved)

    def speeds(self, facets: Facets, nodes: Array, y: Array) -> tuple[Array, Array]:
        """δη = Σ_b D_b·δ𝐮_b + 𝐞·δ𝐲 of each cut: D (c, nodes, gdim) on its facet's nodes, which are at `nodes` (nf, nodes,
        gdim), and 𝐞 (c, gdim) on the target's node at 𝐲 (c, gdim), all in 1/m."""
        N, dN, ddN = facets.shape.tabulate(self.η[:, None], 2)
        own = nodes[self.facet]
        x, a, aη = ((B[:, None] @ own)[:, 0] for B in (N, dN[:, 0], ddN[:, 0, 0]))
        r = y - x
        scale = 1.0 / (dot(a, a) - dot(r, aη))
        e = scale[:, None] * a
        D = scale[:, None, None] * (dN[:, 0, :, None] * r[:, None]) - N[:, :, None] * e[:, None]
        return D, e
