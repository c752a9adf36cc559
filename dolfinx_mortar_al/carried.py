"""Vectors carried with a facet: constant in the local frame of its tangents 𝐚_α and unit normal 𝐦 as it moves.

𝐫 = ρ^α 𝐚_α + ρ 𝐦. A rigid motion of the facet turns 𝐫 with it; stretch acts on the tangential part only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import combine, dot, dual
from dolfinx_mortar_al.surface import surface_normal
from dolfinx_mortar_al.variation import Slots

__all__ = ["carried", "components", "vary_carried"]

Array = NDArray[np.float64]


def components(a: Array, r: Array) -> Array:
    """(n, gdim) the components ρ^α, ρ of vectors 𝐫 (n, gdim) in metres at tangents a (n, dim, gdim): ρ^α are shares of 𝐚_α,
    ρ is in metres."""
    m = _unit_normal(a)
    return np.concatenate([(dual(a) @ r[:, :, None])[:, :, 0], dot(m, r)[:, None]], axis=1)


def carried(a: Array, ρ: Array) -> Array:
    """(n, gdim) the vectors with components ρ (n, gdim) at tangents a (n, dim, gdim)."""
    return np.asarray(combine(ρ[:, :-1], a) + ρ[:, -1:] * _unit_normal(a))


def vary_carried(a: Array, ρ: Array, slots: Slots, name: str) -> Array:
    """(n, gdim, z) δ𝐫 = ρ^α w_α + ρ δ𝐦 with δ𝐦 = −𝐚^β (𝐦·w_β), where δ𝐚_α = w_α are the slots `name`,α."""
    wα = slots.derivatives(name)
    stretched = np.tensordot(ρ[:, :-1], wα, axes=(1, 0))
    tilt = np.einsum("ni,biz->nbz", _unit_normal(a), wα)
    return np.asarray(stretched - ρ[:, -1, None, None] * (np.swapaxes(dual(a), 1, 2) @ tilt))


def _unit_normal(a: Array) -> Array:
    m = surface_normal(a)
    return np.asarray(m / np.linalg.norm(m, axis=1, keepdims=True))
