"""The contact and friction law of eq. (1) at a point, and its exact derivative. Arrays over points: no mesh, no PETSc.

The multiplier is the nominal traction of body 1, λ_N = Λ·ν and λ_T = −PΛ with P = I − ν⊗ν. A frictionless pair has the
scalar multiplier λ_N only. Derivatives are linear maps of a few nodal variations, stacked in a last axis of length z
(:class:`~dolfinx_mortar_al.variation.Variation`), so δΛ (n, gdim, z) means δΛ_i = Σ_z δΛ[n, i, z] × (variation z).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import Projection
from dolfinx_mortar_al.variation import Variation

__all__ = [
    "OPEN",
    "SLIP",
    "STICK",
    "Augmentation",
    "Coulomb",
    "Frictionless",
    "LawState",
    "augmented_normal",
    "augmented_tangential",
]

Array = NDArray[np.float64]

OPEN, SLIP, STICK = 0, 1, 2


@dataclass(frozen=True)
class Augmentation:
    """Augmentation parameters ε_N and ε_T in Pa/m."""

    normal: float
    tangential: float


@dataclass
class LawState:
    """What the law says at n points.

    Attributes:
        status: (n,) OPEN, SLIP or STICK.
        λN_hat: (n,) λ̂_N in Pa.
        p: (n,) pressure ⟨λ̂_N⟩ in Pa: λ̂_N where the point counts as closed.
        t: (n, gdim) nominal traction on body 1 in Pa.
        r: (n, gdim) residual of the multiplier in metres, (n, 1) without friction.
        λT_hat: (n, gdim) λ̂_T in Pa, where there is friction.
        bound: (n,) friction bound μp in Pa, and slope: (n,) its derivative with respect to p: μ, or 0 where it is frozen.
    """

    status: NDArray[np.int8]
    λN_hat: Array
    p: Array
    t: Array
    r: Array
    λT_hat: Array | None = None
    bound: Array | None = None
    slope: Array | None = None

    def take(self, index: NDArray[np.int64]) -> LawState:
        """The state at some of the points."""
        values: list[Any] = [getattr(self, f.name) for f in fields(self)]
        taken: list[Any] = [None if v is None else v[index] for v in values]
        return LawState(*taken)


def _dot(a: Array, b: Array) -> Array:
    """a·b over the component axis, (n, gdim) and (n, gdim) or (n, gdim, z)."""
    return np.einsum("ni,ni...->n...", a, b)


def _times(scalar: Array, vector: Array) -> Array:
    """vector (n, gdim) ⊗ scalar map (n, z)."""
    return vector[:, :, None] * scalar[:, None, :]


def augmented_normal(λN: Array, g: Array, ε: Augmentation) -> Array:
    """λ̂_N = λ_N + ε_N g, after eq. (1)."""
    return λN + ε.normal * g


def augmented_tangential(Λ: Array, s: Array, ν: Array, ε: Augmentation) -> Array:
    """λ̂_T = λ_T + ε_T P s = P(−Λ + ε_T s), after eq. (1), with the slip s of eq. (5)."""
    q = -Λ + ε.tangential * s
    return q - ν * _dot(ν, q)[:, None]


@dataclass(frozen=True)
class Frictionless:
    """μ = 0: t = ⟨λ̂_N⟩ν and r = (λ_N − ⟨λ̂_N⟩)/ε_N with the scalar multiplier λ_N."""

    ε: Augmentation

    def evaluate(
        self,
        λ: Array,
        at: Projection,
        s: Array | None,
        closed: NDArray[np.bool_],
        frozen: Array | None,
        held: NDArray[np.bool_] | None = None,
    ) -> LawState:
        """The law at multipliers λ (n, 1) and projections `at` of points that are `closed` (n,) or open: in eq. (1) those
        with λ̂_N ≥ 0, in a Newton iteration those of the active set."""
        ν = at.ν
        λ_hat = augmented_normal(λ[:, 0], at.g, self.ε)
        closed = at.facing & closed
        p = np.where(closed, λ_hat, 0.0)
        status = np.where(closed, SLIP, OPEN).astype(np.int8)
        return LawState(status, λ_hat, p, p[:, None] * ν, (λ - p[:, None]) / self.ε.normal)

    def open_slope(self, ν: Array) -> Array:
        """(n, 1, 1) δr of open points, times δλ."""
        return np.full((len(ν), 1, 1), 1.0 / self.ε.normal)

    def linearise(
        self, state: LawState, λ: Array, at: Projection, s: Array | None, δ: Variation
    ) -> tuple[Array, Array]:
        """δt (n, gdim, z) and δr (n, 1, z)."""
        δp = (state.status != OPEN)[:, None] * (δ.Λ[:, 0] + self.ε.normal * δ.g)
        δt = _times(δp, at.ν) + state.p[:, None, None] * δ.ν
        return δt, (δ.Λ - δp[:, None]) / self.ε.normal


@dataclass(frozen=True)
class Coulomb:
    """Eq. (1) with Coulomb's friction, coefficient μ (dimensionless); a λ̂_T below `noise` (Pa) sticks."""

    ε: Augmentation
    μ: float
    noise: float = 0.0

    def evaluate(
        self,
        Λ: Array,
        at: Projection,
        s: Array | None,
        closed: NDArray[np.bool_],
        frozen: Array | None,
        held: NDArray[np.bool_] | None = None,
    ) -> LawState:
        """The law at multipliers Λ (n, gdim), projections `at` and slips s (n, gdim); `closed` as above.

        `frozen` (n,) is a friction bound (Pa) to take in place of μp, not a number where it is free; points `held` (n,)
        stick whatever their bound.
        """
        assert s is not None
        ν = at.ν
        λN = _dot(ν, Λ)
        λN_hat = augmented_normal(λN, at.g, self.ε)
        closed = at.facing & closed
        p = np.where(closed, λN_hat, 0.0)
        λT_hat = augmented_tangential(Λ, s, ν, self.ε)
        size = np.linalg.norm(λT_hat, axis=1)
        bound, slope = self.μ * np.maximum(p, 0.0), np.where(p > 0, self.μ, 0.0)
        if frozen is not None:
            free = np.isnan(frozen)
            bound, slope = np.where(free, bound, frozen), slope * free
        stick = size <= bound + self.noise  # also where λ̂_T = 0: there the bracket of eq. (1) is 0
        if held is not None:
            stick |= held
        f = λT_hat * np.where(stick, 1.0, bound / np.where(stick, 1.0, size))[:, None]
        f[~closed] = 0.0
        status = np.where(closed, np.where(stick, STICK, SLIP), OPEN).astype(np.int8)
        λT = ν * λN[:, None] - Λ
        r = ν * ((λN - p) / self.ε.normal)[:, None] - (λT - f) / self.ε.tangential
        return LawState(status, λN_hat, p, p[:, None] * ν - f, r, λT_hat, bound, slope)

    def unspent(self, state: LawState, at: Projection) -> Array:
        """(n, gdim) the slip (f_T − λ_T)/ε_T that has not become sliding, −λ_T/ε_T at open points: with it a point's friction
        is the same again in a step in which nothing moves. It is the tangential part of r, whose mean with each multiplier's
        shape function is zero."""
        return np.asarray(state.r - at.ν * _dot(at.ν, state.r)[:, None])

    def open_slope(self, ν: Array) -> Array:
        """(n, gdim, gdim) δr of open points, times δΛ, where ν (n, gdim) is held."""
        normal, tangential = 1.0 / self.ε.normal, 1.0 / self.ε.tangential
        slope = np.broadcast_to(tangential * np.eye(ν.shape[1]), (*ν.shape, ν.shape[1]))
        return slope if normal == tangential else slope + (normal - tangential) * ν[:, :, None] * ν[:, None]

    def linearise(
        self, state: LawState, Λ: Array, at: Projection, s: Array | None, δ: Variation
    ) -> tuple[Array, Array]:
        """δt and δr, (n, gdim, z): the derivative in docs/theory.md, misprints of eqs. (8)–(10) corrected."""
        assert state.λT_hat is not None and state.bound is not None and state.slope is not None
        assert δ.s is not None and s is not None
        ν = at.ν
        εN, εT = self.ε.normal, self.ε.tangential
        closed = (state.status != OPEN)[:, None]
        λN = _dot(ν, Λ)
        δλN = _dot(Λ, δ.ν) + _dot(ν, δ.Λ)
        δp = closed * (δλN + εN * δ.g)

        q, δq = -Λ + εT * s, -δ.Λ + εT * δ.s
        δλT_hat = _tangential(q, δq, ν, δ.ν)
        size = np.linalg.norm(state.λT_hat, axis=1)
        slip = state.status == SLIP
        h = np.where(slip[:, None], state.λT_hat / np.where(slip, size, 1.0)[:, None], 0.0)
        ratio = np.where(slip, state.bound / np.where(slip, size, 1.0), 1.0)
        δf = ratio[:, None, None] * (δλT_hat - _times(_dot(h, δλT_hat), h)) + _times(state.slope[:, None] * δp, h)
        δf[state.status == OPEN] = 0.0

        δt = _times(δp, ν) + state.p[:, None, None] * δ.ν - δf
        # λ_T = −PΛ; the residual's tangential part P(λ_T − f_T) is tangential already, so P needs no variation
        δλT = _tangential(-Λ, -δ.Λ, ν, δ.ν)
        δr = (_times(δλN - δp, ν) + (λN - state.p)[:, None, None] * δ.ν) / εN - (δλT - δf) / εT
        return δt, δr


def _tangential(q: Array, δq: Array, ν: Array, δν: Array) -> Array:
    """δ(P q) = P δq − δν (ν·q) − ν (q·δν)."""
    return δq - _times(_dot(ν, δq), ν) - _dot(ν, q)[:, None, None] * δν - _times(_dot(q, δν), ν)
