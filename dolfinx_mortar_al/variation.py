"""First variation of a projection: δη, δ𝐲, δg, δν and the slip's δs as linear maps of few nodal variations.

At a point only δ𝐱 = N1 δU1, w = N2(η) δU2, w_α = N2,α(η) δU2, with rays δ𝐱,α = N1,α δU1, with friction w_p = N2(η_{n−1}) δU2,
and δΛ enter (``docs/theory.md``). They are the slots of the last axis, of length z = gdim × number of slots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.closest_point import ClosestPoint
from dolfinx_mortar_al.projection import Projection, inverse
from dolfinx_mortar_al.rays import RayHit

__all__ = ["Slots", "Variation", "vary", "vary_frozen"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Slots:
    """Which variations there are: of the displacements in this order, then of the multiplier's components."""

    gdim: int
    multiplier: int
    friction: bool
    rays: bool

    @property
    def dim(self) -> int:
        return self.gdim - 1

    @property
    def names(self) -> list[str]:
        """The displacements' slots: x, w, w,α (gdim − 1 of them); x,α with rays; w_p with friction."""
        derivatives = [str(α) for α in range(self.dim)]
        own = [f"x,{α}" for α in derivatives] if self.rays else []
        return ["x", "w", *(f"w,{α}" for α in derivatives), *own, *(["w_p"] if self.friction else [])]

    @property
    def size(self) -> int:
        return self.gdim * len(self.names) + self.multiplier

    def slot(self, name: str) -> Array:
        """(gdim, z) the map that picks a displacement slot."""
        k = self.names.index(name)
        pick = np.zeros((self.gdim, self.size))
        pick[:, k * self.gdim : (k + 1) * self.gdim] = np.eye(self.gdim)
        return pick

    def derivatives(self, name: str) -> Array:
        """(dim, gdim, z) the maps that pick the slots `name`,α."""
        return np.stack([self.slot(f"{name},{α}") for α in range(self.dim)])

    def multiplier_slot(self) -> Array:
        """(multiplier, z) the map that picks δΛ."""
        pick = np.zeros((self.multiplier, self.size))
        pick[:, self.size - self.multiplier :] = np.eye(self.multiplier)
        return pick


@dataclass
class Variation:
    """δη (n, dim, z), δg (n, z), δν (n, gdim, z), δΛ (1, ·, z) and, with friction, δs (n, gdim, z)."""

    η: Array
    g: Array
    ν: Array
    Λ: Array
    s: Array | None


def vary(at: Projection, slots: Slots) -> Variation:
    """Variation of a projection, by its rule."""
    if isinstance(at, RayHit):
        return _vary_ray(at, slots)
    assert isinstance(at, ClosestPoint)
    return _vary_closest(at, slots)


def _vary_ray(at: RayHit, slots: Slots) -> Variation:
    """δ𝐧 = −𝐚₁^α (𝐧·δ𝐱,α),  [𝐚_α, −𝐧](δη, δd) = δ𝐱 − w + d δ𝐧,  δg = −δd,  δν = −δ𝐧; the slip is s = 𝐱 − φ₂(Y_{n−1})."""
    n, w, δx = -at.ν, slots.slot("w"), slots.slot("x")
    dual = inverse(at.tangents @ np.swapaxes(at.tangents, 1, 2)) @ at.tangents
    δn = -np.swapaxes(dual, 1, 2) @ np.tensordot(n, slots.derivatives("x"), axes=(1, 1))
    M = np.concatenate([np.swapaxes(at.a, 1, 2), at.ν[:, :, None]], axis=2)
    M[~at.facing] = np.eye(slots.gdim)
    solution = np.linalg.solve(M, (δx - w) - at.g[:, None, None] * δn)
    δs = np.broadcast_to(δx - slots.slot("w_p"), δn.shape) if slots.friction else None
    return Variation(solution[:, : slots.dim], -solution[:, slots.dim], -δn, slots.multiplier_slot()[None], δs)


def _vary_closest(at: ClosestPoint, slots: Slots) -> Variation:
    """Eq. (9) and δη, δν of ``docs/theory.md``; the slip is s = 𝐲 − φ₂(Y_{n−1})."""
    δx, w, wα = slots.slot("x"), slots.slot("w"), slots.derivatives("w")
    δη = at.Ā_inv @ (at.a @ (δx - w) - at.g[:, None, None] * np.einsum("ni,aiz->naz", at.ν, wα))
    δg = -at.ν @ (δx - w)
    aT = np.swapaxes(at.a, 1, 2)
    δν = -aT @ (at.A_inv @ (np.einsum("ni,aiz->naz", at.ν, wα) + at.κ @ δη))
    corner = np.flatnonzero(~at.inside)
    if corner.size:  # on an edge or vertex ν = −(x − y)/g turns with the point
        ν, turn = at.ν[corner], (δx - w) - aT[corner] @ δη[corner]
        δν[corner] = -(turn - ν[:, :, None] * (ν[:, None, :] @ turn)) / at.g[corner, None, None]
    δs = w + aT @ δη - slots.slot("w_p") if slots.friction else None
    return Variation(δη, δg, δν, slots.multiplier_slot()[None], δs)


def vary_frozen(at: Projection, slots: Slots, θ: float) -> Variation:
    """Variation where the geometry is frozen and gap and slip are Δt × velocities, (δ𝐱 − w)/θ: Moreau's scheme."""
    n, z = len(at.g), slots.size
    drift = (slots.slot("x") - slots.slot("w")) / θ
    δs = np.broadcast_to(drift, (n, *drift.shape)) if slots.friction else None
    zero_η, zero_ν = np.zeros((n, slots.dim, z)), np.zeros((n, slots.gdim, z))
    return Variation(zero_η, -at.ν @ drift, zero_ν, slots.multiplier_slot()[None], δs)
