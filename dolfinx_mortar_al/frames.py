"""Frames of a multiplier's nodes: normal and tangential parts that do not mix where normals turn.

A traction vector interpolated in global axes, Λ(𝐱) = Σ N_a Λ_a, has a normal part that depends on the nodes' tangential ones
wherever ν turns across a facet. With a normal ν_a at each node and the rotation 𝐑_a(𝐱) that takes ν_a to ν(𝐱) the short way,

    Λ(𝐱) = Σ N_a(𝐱) 𝐑_a(𝐱) Λ_a,     ν·Λ = Σ N_a (ν_a·Λ_a):

the normal part is a scalar Lagrange field, the tangential part a field of tangential vectors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.multiplier import MultiplierSpace

__all__ = ["nodal_normals", "rotation"]

Array = NDArray[np.float64]

OPPOSITE = 1e-12  # 1 + cos of the angle between normals that count as opposite


def nodal_normals(multiplier: MultiplierSpace, points: IntegrationPoints, ν: Array) -> Array:
    """(nf, nodes, gdim) unit normals at the multiplier's nodes, means of ν (n, gdim) about them (collective)."""
    N = np.abs(multiplier.shape.tabulate(points.η)[0])
    mean = multiplier.sum_over_facets(points.sum_by_facet(N[:, :, None] * (points.j[:, None] * ν)[:, None]))
    size = np.linalg.norm(mean, axis=2, keepdims=True)
    any_axis = np.eye(mean.shape[2])[0]  # where normals cancel no direction is better than another
    return np.asarray(np.where(size > 0.0, mean / np.where(size > 0.0, size, 1.0), any_axis))


def rotation(start: Array, end: Array) -> Array:
    """(..., gdim, gdim) the rotation that takes unit vectors `start` to `end` (..., gdim) in the plane of both; −𝐈 where
    they are opposite."""
    both = start + end
    closeness = 1.0 + np.einsum("...i,...i->...", start, end)
    opposite = closeness < OPPOSITE
    eye = np.eye(start.shape[-1])
    mirror = both[..., :, None] * both[..., None, :] / np.where(opposite, 1.0, closeness)[..., None, None]
    turned = eye + 2.0 * end[..., :, None] * start[..., None, :] - mirror
    return np.where(opposite[..., None, None], -eye, turned)
