"""What a projection of contactor points onto the target gives, whatever the rule: facet, η, 𝐲, 𝐚_α, unit normal ν and gap g.

Three rules fill it: rays along the contactor's normal (`rays.py`, the default), the paper's closest point
(`closest_point.py`) and the closed forms of rigid obstacles (`obstacles.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["Projection", "TargetPoint", "combine", "dot", "dual", "inverse"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass
class TargetPoint:
    """Material points of the target: facet (n,) and reference coordinates η (n, dim); Y of eq. (5)."""

    facet: Index
    η: Array

    def copy(self) -> TargetPoint:
        return TargetPoint(self.facet.copy(), self.η.copy())

    def take(self, index: Index) -> TargetPoint:
        """Some of them."""
        return TargetPoint(self.facet[index], self.η[index])


@dataclass
class Projection:
    """Where n contactor points face the target; gdim = dim + 1.

    Attributes:
        point: facet (n,) and η (n, dim) of the point faced.
        facing: (n,) false where the point faces no target: beyond its end, or past it.
        N: (n, nodes) target shape functions at η; dN: (n, dim, nodes) their derivatives N,α.
        y: (n, gdim) the point faced; a: (n, dim, gdim) tangents 𝐚_α.
        ν: (n, gdim) unit normal, towards the contactor; g: (n,) proximity −ν·(𝐱 − 𝐲), positive in penetration.
    """

    point: TargetPoint
    facing: NDArray[np.bool_]
    N: Array
    dN: Array
    y: Array
    a: Array
    ν: Array
    g: Array

    def take(self, index: Index) -> Self:
        """The projection of some of the points."""
        rest = [getattr(self, f.name)[index] for f in fields(self)[1:]]
        return type(self)(self.point.take(index), *rest)


def combine(N: Array, nodes: Array) -> Array:
    """Σ_k N_k 𝐗_k: (n, k), (n, k, gdim) → (n, gdim)."""
    return np.asarray((N[:, None, :] @ nodes)[:, 0])


def dot(a: Array, b: Array) -> Array:
    """(n,) 𝐚·𝐛 of (n, gdim) and (n, gdim)."""
    return np.asarray(np.einsum("ni,ni->n", a, b))


def dual(a: Array) -> Array:
    """(n, dim, gdim) contravariant tangents 𝐚^α of tangents 𝐚_α (n, dim, gdim)."""
    return np.asarray(inverse(a @ np.swapaxes(a, 1, 2)) @ a)


def inverse(A: Array) -> Array:
    """Inverse of (n, 1, 1) or (n, 2, 2) matrices; large where singular."""
    if A.shape[1] == 1:
        return np.asarray(1.0 / np.where(A == 0.0, 1e-300, A))
    determinant = A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
    rows = [[A[:, 1, 1], -A[:, 0, 1]], [-A[:, 1, 0], A[:, 0, 0]]]
    adjoint = np.stack([np.stack(row, axis=1) for row in rows], axis=1)
    return np.asarray(adjoint / np.where(determinant == 0.0, 1e-300, determinant)[:, None, None])
