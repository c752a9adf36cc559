"""Segments: the contactor's facets cut where target facets end, as its rays see them, so that no integrand has a kink inside.

The points follow the bodies from one evaluation to the next; they stay where they are while the ends of the target's facets
have moved by less than STILL. A cut displaced by δ changes the integral of a continuous integrand by δ²/2 times the jump of
its slope: Newton's tangent may leave the motion of the points out, and a small δ does not matter (``docs/integration.md``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.projection import dot
from dolfinx_mortar_al.surface import Facets, GatheredFacets, ShapeFunctions

__all__ = ["Segments", "cuts_on_curve", "images_on_curve"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

STILL = 3e-5  # in facets: the root of Newton's tolerance on forces, as a cut's displacement counts squared
SNAP = 1e-6  # in facets: a cut closer to another, or to a facet's end, is none; its displacement counts squared, too
NEWTON = 8  # iterations for the ray of a curved facet through a point


class Segments:
    """The points of a pair's segments, where the bodies are now.

    Args:
        facets: of the contactor, on this rank.
        target: the target, whole.
        degree: of the quadrature on each segment.
        thickness: out of the plane (m).
    """

    def __init__(self, facets: Facets, target: GatheredFacets, degree: int, thickness: float) -> None:
        self._facets, self._target = facets, target
        self._degree, self._thickness = degree, thickness
        own = np.linalg.norm(np.ptp(facets.X, axis=1), axis=1).max(initial=0.0)
        #: farther from the contactor (m) an end of a target facet makes no cut: nothing is closed there
        self._reach = max(target.size_of_facets, float(own))
        self._ends = np.unique(target.facets[:, np.concatenate(target.shape.sides)])
        self._couples: tuple[Index, Index] | None = None
        self._x1, self._x2 = facets.X, target.X
        self._η: Array = np.zeros(0)
        self._cuts: Bool = np.zeros(0, dtype=bool)

    def follow(self, contactor: Array, target: Array) -> IntegrationPoints | None:
        """New points, if they have to move; `contactor` (nf, nodes, gdim) and `target` (nodes, gdim): nodes now (m)."""
        fresh = self._find_couples(contactor, target)
        assert self._couples is not None
        facet, end = self._couples
        η, d = images_on_curve(self._facets.shape, contactor[facet], target[end])
        cuts = (np.abs(d) <= self._reach) & (np.abs(η - 0.5) <= 0.5)
        if not fresh:
            seen = cuts | self._cuts
            if np.abs(η[seen] - self._η[seen]).max(initial=0.0) <= STILL:
                return None
        self._η, self._cuts = η, cuts
        facet, first, last = cuts_on_curve(facet[cuts], η[cuts], self._facets.size)
        ξ, weight = self._facets.shape.quadrature(self._degree)
        length = (last - first)[:, None]
        points = (first[:, None] + length * ξ[:, 0]).reshape(-1, 1)
        weights = (length * weight).ravel()
        return IntegrationPoints(self._facets, np.repeat(facet, len(weight)), points, weights, self._thickness)

    def forget(self) -> None:
        """Make new points next time, whether anything has moved or not."""
        self._couples = None

    def _find_couples(self, contactor: Array, target: Array) -> bool:
        """Bring up to date which facets may be cut by which ends; whether that was due."""
        margin = 0.5 * self._reach
        if self._couples is not None:
            moved = [np.abs(now - then).max(initial=0.0) for now, then in ((contactor, self._x1), (target, self._x2))]
            if max(moved) <= margin / 8:
                return False
        self._x1, self._x2 = contactor.copy(), target.copy()
        centre = contactor.mean(axis=1)
        # a facet of order 2 stays within 1.25 times the hull of its nodes seen from their mean
        radius = 1.25 * np.linalg.norm(contactor - centre[:, None], axis=2).max(axis=1, initial=0.0)
        distance = np.linalg.norm(centre[:, None] - target[self._ends], axis=2)
        facet, end = np.nonzero(distance <= radius[:, None] + self._reach + margin)
        self._couples = facet, self._ends[end]
        return True


def images_on_curve(shape: ShapeFunctions, nodes: Array, y: Array) -> tuple[Array, Array]:
    """Where the rays of curved facets with `nodes` (n, k, 2) pass through 𝐲 (n, 2): η (n,), infinite where none does near the
    facet, and the signed distance d (n,) along the normal's line (m)."""
    powers = np.linalg.inv(shape.nodes ** np.arange(shape.order + 1))  # 𝐱(η) = Σ_k 𝐜_k η^k
    c0, c1, *rest = np.moveaxis(powers @ nodes, 1, 0)
    chord = c1 + rest[0] if rest else c1
    η = dot(y - c0, chord) / dot(chord, chord)
    outside = np.abs(η - 0.5) > 1.5  # so far off that a curved facet's rays mean nothing
    a, r = c1, y - c0 - c1 * η[:, None]
    if rest:
        η = np.clip(η, -1.0, 2.0)
        for _ in range(NEWTON):
            a, r = c1 + 2 * rest[0] * η[:, None], y - c0 - (c1 + rest[0] * η[:, None]) * η[:, None]
            slope = 2 * dot(r, rest[0]) - dot(a, a)
            step = np.clip(-dot(r, a) / np.where(slope == 0.0, -1.0, slope), -0.5, 0.5)
            if np.max(np.abs(step)[~outside], initial=0.0) <= SNAP**2:
                break
            η = np.clip(η + step, -1.0, 2.0)
        outside |= np.abs(step) > SNAP
    d = (r[:, 0] * a[:, 1] - r[:, 1] * a[:, 0]) / np.linalg.norm(a, axis=1)
    return np.where(outside, np.inf, η), d


def cuts_on_curve(facet: Index, η: Array, size: int) -> tuple[Index, Array, Array]:
    """Intervals between cuts at η (n,) in [0, 1] of facets (n,) out of `size`: facet, first and last η of each (m,)."""
    all_facets = np.arange(size)
    owner, at = np.concatenate([facet, all_facets, all_facets]), np.concatenate([η, np.zeros(size), np.ones(size)])
    order = np.lexsort([at, owner])
    owner, at = owner[order], at[order]
    at = np.where(at > 1.0 - SNAP, 1.0, at)  # ends win over cuts that are close
    keep = np.r_[True, (np.diff(owner) > 0) | (np.diff(at) > SNAP)] if len(at) else np.zeros(0, dtype=bool)
    owner, at = owner[keep], at[keep]
    same = np.flatnonzero(np.diff(owner) == 0)
    return owner[same], at[same], at[same + 1]
