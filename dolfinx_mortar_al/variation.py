"""First variation of the closest-point map: δη, δ𝐲, δg, δν and the slip's δs as linear maps of few nodal variations.

At a point only δ𝐱 = N1 δU1, w = N2(η) δU2, w_α = N2,α(η) δU2, w_p = N2(η_{n−1}) δU2 and δΛ enter (formulation, "exact
linearisation"). They are the slots of the last axis, of length z = gdim × number of slots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import Projection

__all__ = ["Slots", "Variation", "vary", "vary_frozen"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Slots:
    """Which variations there are: the target's (`target_slots`) and the multiplier's number of components."""

    gdim: int
    multiplier: int
    friction: bool

    @property
    def dim(self) -> int:
        return self.gdim - 1

    @property
    def displacement_slots(self) -> int:
        """δx, w, w_α (gdim − 1 of them) and, with friction, w_p."""
        return 2 + self.dim + int(self.friction)

    @property
    def size(self) -> int:
        return self.gdim * self.displacement_slots + self.multiplier

    def slot(self, k: int) -> Array:
        """(gdim, z) the map that picks displacement slot k."""
        pick = np.zeros((self.gdim, self.size))
        pick[:, k * self.gdim : (k + 1) * self.gdim] = np.eye(self.gdim)
        return pick

    def multiplier_slot(self) -> Array:
        """(multiplier, z) the map that picks δΛ."""
        pick = np.zeros((self.multiplier, self.size))
        pick[:, self.size - self.multiplier :] = np.eye(self.multiplier)
        return pick


@dataclass
class Variation:
    """δη (n, dim, z), δg (n, z), δν (n, gdim, z), δΛ (1, ·, z) and, with friction, δs = δy − w_p (n, gdim, z)."""

    η: Array
    g: Array
    ν: Array
    Λ: Array
    s: Array | None


def vary(at: Projection, slots: Slots) -> Variation:
    """Variation of the closest-point map `at`."""
    δx, w = slots.slot(0), slots.slot(1)
    wα = np.stack([slots.slot(2 + α) for α in range(slots.dim)])  # (dim, gdim, z)
    δη = at.Ā_inv @ (at.a @ (δx - w) - at.g[:, None, None] * np.einsum("ni,aiz->naz", at.ν, wα))
    δg = -at.ν @ (δx - w)
    aT = np.swapaxes(at.a, 1, 2)
    δν = -aT @ (at.A_inv @ (np.einsum("ni,aiz->naz", at.ν, wα) + at.κ @ δη))
    corner = np.flatnonzero(~at.inside)
    if corner.size:  # on an edge or vertex ν = −(x − y)/g turns with the point
        ν, turn = at.ν[corner], (δx - w) - aT[corner] @ δη[corner]
        δν[corner] = -(turn - ν[:, :, None] * (ν[:, None, :] @ turn)) / at.g[corner, None, None]
    δs = w + aT @ δη - slots.slot(2 + slots.dim) if slots.friction else None
    return Variation(δη, δg, δν, slots.multiplier_slot()[None], δs)


def vary_frozen(at: Projection, slots: Slots, θ: float) -> Variation:
    """Variation where the geometry is frozen and gap and slip are Δt × velocities, (δ𝐱 − w)/θ: Moreau's scheme."""
    n, z = len(at.g), slots.size
    drift = (slots.slot(0) - slots.slot(1)) / θ
    δs = np.broadcast_to(drift, (n, *drift.shape)) if slots.friction else None
    zero_η, zero_ν = np.zeros((n, slots.dim, z)), np.zeros((n, slots.gdim, z))
    return Variation(zero_η, -at.ν @ drift, zero_ν, slots.multiplier_slot()[None], δs)
