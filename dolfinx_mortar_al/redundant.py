"""Nodes of the contactor at which supports leave the multiplier nothing to enforce (docs/theory.md).

Where a component of the displacement is prescribed on both sides its multiplier has no equation: the system is singular.
Where the surfaces end a little apart, the contactor's last node lies a little inside the target's last facet, whose other
nodes move; its equation is then nearly that of its neighbours, and what it asks for beyond them locks both facets. Such nodes
have no part in the multiplier, which is extrapolated from the others of their facets.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.kinematics import contactor_points
from dolfinx_mortar_al.reductions import any_over
from dolfinx_mortar_al.surface import Facets
from dolfinx_mortar_al.targets import DeformableTarget, Target

__all__ = ["RedundantNodes"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

MOSTLY = 0.5  # share of its shape functions: a point to which free nodes contribute less counts as prescribed


class RedundantNodes:
    """Where the relative displacement of a pair is prescribed.

    Args:
        facets: the contactor's, on this rank.
        target: what they face.
        fixed: (nf, nodes, gdim) which components are prescribed at the contactor's nodes.
        friction: without it only nodes held in all directions are redundant.
    """

    def __init__(self, facets: Facets, target: Target, fixed: Bool, friction: bool) -> None:
        self._facets, self._target, self._fixed, self._friction = facets, target, fixed, friction
        self._comm = facets.space.mesh.comm
        self._may_be = any_over(self._comm, fixed.any()) and bool(target.fixed.any())
        self._looked_at: tuple[Array, Array] = np.zeros(0), np.zeros(0)

    def at(self, contactor: Array, place: Array | None = None) -> Bool:
        """(nf, nodes, components) where the relative displacement is prescribed, so that the multiplier has nothing to
        enforce: on the contactor and, if the target is deformable, where that is opposite and near, or wherever it lies in a
        plane of symmetry. `contactor` (nf, nodes, gdim) and `place` (nodes, gdim): nodes of both (m), the target's by
        default undeformed."""
        fixed, facets, target = self._fixed.copy(), self._facets, self._target
        facet, node = np.nonzero(fixed.any(axis=2))
        if isinstance(target, DeformableTarget) and len(facet):
            points = IntegrationPoints(facets, facet, facets.shape.nodes[node], np.ones(len(facet)), 1.0)
            nodes, here = target.surface.X if place is None else place, contactor_points(points, contactor)
            at, near = target.opposite(here, nodes)
            free = ~target.fixed[target.facets[at.facet]]
            given = np.einsum("nk,nki->ni", np.abs(target.weights(at)), free) < MOSTLY
            planes = target.holds_plane(facets.X[facet, node])
            if target.is_contactor:  # whose own clamped face may be plane
                planes &= ~np.asarray(fixed[facet, node].all(axis=1))[:, None]
            fixed[facet, node] &= (near[:, None] & given) | planes
        return fixed if self._friction else np.asarray(fixed.all(axis=2, keepdims=True))

    def are_elsewhere(self, contactor: Array, place: Array) -> bool:
        """Whether nodes may be others than when this was asked last, with both sides' nodes at `contactor` (nf, nodes, gdim)
        and `place` (nodes, gdim) (m) (collective)."""
        if not self._may_be:
            return False
        nodes = contactor, place
        # roles count, too, of what is in contact with itself
        again = not self._target.is_contactor and all(map(np.array_equal, self._looked_at, nodes))
        if not any_over(self._comm, not again):
            return False
        self._looked_at = contactor.copy(), place.copy()
        return True
