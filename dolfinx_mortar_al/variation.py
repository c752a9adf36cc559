"""First variation of a projection: δη, δ𝐲, δg, δν and the slip's δs as linear maps of few nodal variations.

At a point only few variations enter, such as δ𝐱 = N1 δU1, w = N2(η) δU2, w_α = N2,α(η) δU2, δ𝐱,α = N1,α δU1, and δΛ
(``docs/theory.md``). They are the slots of the last axis, of length z = gdim × number of slots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.closest_point import ClosestPoint
from dolfinx_mortar_al.projection import Projection, dual
from dolfinx_mortar_al.rays import RayHit
from dolfinx_mortar_al.surface import surface_normal

__all__ = ["Slots", "Variation", "scaled_normal", "vary", "vary_cosine", "vary_gap"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Slots:
    """Which variations there are: of the displacements, `names` in their order, then of the multiplier's components.

    A name is that of a point, whose variation has gdim components: x on the contactor, w on the target, w_p, w_e on it
    where a point was or will be; or that of a derivative, such as x,0 and x,1 for the two δ𝐱,α on a surface in space.
    """

    gdim: int
    multiplier: int
    names: tuple[str, ...]

    @property
    def dim(self) -> int:
        return self.gdim - 1

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
    """Variation of a projection, by its rule, in the slots x, w, w,α, with rays x,α, with friction w_p."""
    if isinstance(at, RayHit):
        return _vary_ray(at, slots)
    assert isinstance(at, ClosestPoint)
    return _vary_closest(at, slots)


def vary_gap(at: Projection, slots: Slots, target: str) -> Array:
    """δg (n, z) alone; `target` is the slot of the point faced."""
    w, δx = slots.slot(target), slots.slot("x")
    if not isinstance(at, RayHit):
        return np.asarray(-at.ν @ (δx - w))
    m = scaled_normal(at)
    # −m̂·(δ𝐱 − w + d δ𝐧) with δ𝐧 = −𝐚₁^α (𝐧·δ𝐱,α), 𝐧 = −ν, d = −g
    turned = np.einsum(
        "naz,na->nz",
        np.tensordot(at.ν, slots.derivatives("x"), axes=(1, 1)),
        (dual(at.tangents) @ m[:, :, None])[:, :, 0],
    )
    return np.asarray(-m @ (δx - w) + at.g[:, None] * turned)


def scaled_normal(at: Projection) -> Array:
    """(n, gdim) 𝐦̂ = 𝐦/(𝐦·ν), 𝐦 the target's normal: δg = −𝐦̂ · (relative motion), and 𝐦̂ = ν where ν is that normal."""
    if not isinstance(at, RayHit):
        return at.ν
    m = surface_normal(at.a)
    return np.asarray(m / np.where(at.facing, np.einsum("ni,ni->n", m, at.ν), 1.0)[:, None])


def vary_cosine(at: RayHit, bends: Array, δ: Variation, slots: Slots) -> Array:
    """(n, z) variation of :attr:`RayHit.cosine`, |𝐦·ν|/|𝐦|; `bends` (n, dim, dim, gdim) are the target's 𝐚_α,β."""
    δa = slots.derivatives("w") + np.einsum("nabi,nbz->naiz", bends, δ.η)
    if slots.dim == 1:
        δm = np.stack([δa[:, 0, 1], -δa[:, 0, 0]], axis=1)
    else:
        δm = np.cross(δa[:, 0], at.a[:, 1, :, None], axis=1) + np.cross(at.a[:, 0, :, None], δa[:, 1], axis=1)
    m = surface_normal(at.a)
    size = np.linalg.norm(m, axis=1)[:, None]
    m /= size
    along = np.einsum("ni,ni->n", m, at.ν)[:, None]
    δalong = (np.einsum("ni,niz->nz", at.ν - along * m, δm)) / size + np.einsum("ni,niz->nz", m, δ.ν)
    return np.asarray(np.sign(along) * δalong)


def _vary_ray(at: RayHit, slots: Slots) -> Variation:
    """δ𝐧 = −𝐚₁^α (𝐧·δ𝐱,α),  [𝐚_α, −𝐧](δη, δd) = δ𝐱 − w + d δ𝐧,  δg = −δd,  δν = −δ𝐧; the slip is s = 𝐱 − φ₂(Y_{n−1})."""
    n, w, δx = -at.ν, slots.slot("w"), slots.slot("x")
    δn = -np.swapaxes(dual(at.tangents), 1, 2) @ np.tensordot(n, slots.derivatives("x"), axes=(1, 1))
    M = np.concatenate([np.swapaxes(at.a, 1, 2), at.ν[:, :, None]], axis=2)
    M[~at.facing] = np.eye(slots.gdim)
    solution = np.linalg.solve(M, (δx - w) - at.g[:, None, None] * δn)
    δs = np.broadcast_to(δx - slots.slot("w_p"), δn.shape) if "w_p" in slots.names else None
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
    δs = w + aT @ δη - slots.slot("w_p") if "w_p" in slots.names else None
    return Variation(δη, δg, δν, slots.multiplier_slot()[None], δs)
