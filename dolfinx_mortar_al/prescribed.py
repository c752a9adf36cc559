"""Nodes of one surface that supports push into the other, which is held there as well (``docs/errors.md``).

No contact force can part them. Where whole facets are prescribed the integration points on them tell; a single node, such as
the corner that a surface shares with a clamped side, lies between them.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.inside import Inside
from dolfinx_mortar_al.projection import Projection
from dolfinx_mortar_al.reductions import any_over
from dolfinx_mortar_al.surface import Surface
from dolfinx_mortar_al.targets import DeformableTarget, RigidTarget, Target

__all__ = ["PrescribedNodes"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

ALONG = 1.0 - 1e-6  # share of a normal's square along prescribed components from which on it counts as prescribed


class PrescribedNodes:
    """Of a pair's surfaces the nodes that are prescribed.

    Args:
        contactor: the surface.
        target: the pair's; surface: it, if it is one.
        bodies: of the problem.
    """

    def __init__(self, contactor: Surface, target: Target, surface: Surface | None, bodies: Bodies) -> None:
        self._comm, self._bodies = bodies.comm, bodies
        self._contactor, self._target, self._surface = contactor, target, surface
        # where they were at the last look, (nodes, gdim) of each side, and what was found
        self._seen: list[Array] = []
        self._found: tuple[float, tuple[float, ...]] = (-np.inf, ())

    @cached_property
    def _couples(self) -> list[tuple[DeformableTarget, Target, Inside | None]]:
        """What has nodes, what they may lie in, and what tells whether they do; empty where nothing can be (collective)."""
        target, surface, bodies = self._target, self._surface, self._bodies
        if surface is not None and not target.fixed.any():
            return []
        own = DeformableTarget(self._contactor, bodies, uses_rays=False)
        if not own.fixed.any():
            return []
        if isinstance(target, RigidTarget):
            return [(own, target, None)]
        if not isinstance(target, DeformableTarget) or surface is None:
            return []
        return [(own, target, Inside(surface, bodies)), (target, own, Inside(self._contactor, bodies))]

    def deepest(self) -> tuple[float, tuple[float, ...]]:
        """How deep one of them lies in the other body (m) where that is held along the normal as well, and its reference
        position; −∞ without one (collective). Between two surfaces that changes as such nodes move, and only then."""
        worst: tuple[float, tuple[float, ...]] = (-np.inf, ())
        for side, _, _ in self._couples:
            side.refresh()
        seen = [side.nodes[side.fixed.any(axis=1)] for side, _, _ in self._couples]
        known = self._surface is not None and len(self._seen) == len(seen)
        moved = not known or not all(map(np.array_equal, seen, self._seen))
        if seen and not any_over(self._comm, moved):
            return self._found
        self._seen = seen
        for side, other, inside in self._couples:
            nodes = np.flatnonzero(side.fixed.any(axis=1))[self._comm.rank :: self._comm.size]
            depth = self._depths(side.nodes[nodes], side.fixed[nodes], other, inside)
            k = int(np.argmax(depth)) if len(depth) else -1
            mine = (float(depth[k]), tuple(side.surface.X[nodes[k]].tolist())) if len(depth) else (-np.inf, ())
            worst = max(worst, *self._comm.allgather(mine))
        self._found = worst
        return worst

    def _depths(self, x: Array, fixed: Bool, other: Target, inside: Inside | None) -> Array:
        """(n,) how deep 𝐱 (n, gdim), of which these components are fixed, lie in what is held as well (m), or −∞."""
        at = other.closest(x)
        both = fixed & _held(other, at)
        suspect = at.facing & (at.g > 0.0) & (np.einsum("ni,ni->n", at.ν**2, both) > ALONG)
        if inside is not None and any_over(self._comm, suspect.any()):
            assert isinstance(other, DeformableTarget)
            suspect[suspect] = inside(x[suspect], other.positions(at.point, other.weights(at.point))[suspect])
        return np.where(suspect, at.g, -np.inf)


def _held(target: Target, at: Projection) -> Bool:
    """(n, gdim) which components are prescribed of what is faced."""
    if isinstance(target, RigidTarget):
        return np.ones_like(at.ν, dtype=bool)
    free = ~target.fixed[target.facets[at.point.facet]]
    return np.asarray(np.einsum("nk,nki->ni", np.abs(target.weights(at.point)), free) < 1.0 - ALONG)
