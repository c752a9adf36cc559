"""Eq. (1) as the paper prints it, point by point, against the batched law."""

import numpy as np
import pytest

from dolfinx_mortar_al.law import OPEN, SLIP, STICK, Augmentation, Coulomb, Frictionless, augmented_normal
from dolfinx_mortar_al.projection import Projection, TargetPoint

pytestmark = pytest.mark.one_rank


def point_geometry(ν, g):
    """A projection of which the law reads ν, g and `facing` only."""
    n = len(g)
    none = np.zeros((n, 0))
    facing = np.ones(n, dtype=bool)
    return Projection(TargetPoint(np.zeros(n, int), none), facing, none, none, none, none, ν, g)


def slow_law(Λ, ν, g, s, μ, ε):
    """Eq. (1) with its brackets, one point at a time."""
    λN, λT = Λ @ ν, -(Λ - ν * (Λ @ ν))
    hat_N = λN + ε.normal * g
    hat_T = λT + ε.tangential * (s - ν * (ν @ s))
    p, size = max(hat_N, 0.0), np.linalg.norm(hat_T)
    bracket = 0.0 if size == 0 else max(1 - μ * p / size, 0.0)
    f = (1 - bracket) * hat_T
    return p * ν - f, ν * (λN - p) / ε.normal - (λT - f) / ε.tangential


@pytest.mark.parametrize("dim", [2, 3])
def test_coulomb_is_eq_1(dim):
    rng = np.random.default_rng(0)
    n, ε, μ = 200, Augmentation(3.0, 5.0), 0.4
    ν = rng.standard_normal((n, dim))
    ν /= np.linalg.norm(ν, axis=1, keepdims=True)
    Λ, s, g = rng.standard_normal((n, dim)), 0.2 * rng.standard_normal((n, dim)), rng.standard_normal(n)
    Λ[0] = s[0] = 0.0  # λ̂_T = 0, where the bracket is replaced by 0
    closed = augmented_normal(np.einsum("ni,ni->n", Λ, ν), g, ε) >= 0
    state = Coulomb(ε, μ).evaluate(Λ, point_geometry(ν, g), s, closed, None)
    for k in range(n):
        t, r = slow_law(Λ[k], ν[k], g[k], s[k], μ, ε)
        assert np.allclose(state.t[k], t, atol=1e-14)
        assert np.allclose(state.r[k], r, atol=1e-14)
    assert set(state.status) == {OPEN, SLIP, STICK}
    friction = np.linalg.norm(state.t - state.p[:, None] * ν, axis=1)
    assert np.all(friction <= μ * state.p + 1e-14)


def test_frictionless_is_coulomb_without_friction_in_the_normal_direction():
    rng = np.random.default_rng(1)
    n, ε = 100, Augmentation(3.0, 3.0)
    ν = np.tile([0.6, 0.8], (n, 1))
    λ, g = rng.standard_normal((n, 1)), rng.standard_normal(n)
    at = point_geometry(ν, g)
    closed = augmented_normal(λ[:, 0], g, ε) >= 0
    a = Frictionless(ε).evaluate(λ, at, None, closed, None)
    b = Coulomb(ε, 1e-300).evaluate(λ * ν, at, np.zeros((n, 2)), closed, None)
    assert np.allclose(a.t, b.t, atol=1e-14)
    assert np.allclose(a.r, np.einsum("ni,ni->n", b.r, ν)[:, None], atol=1e-14)


def test_a_frozen_bound_takes_the_place_of_μp():
    """Tresca's law where a bound is given, Coulomb's where it is not a number."""
    rng = np.random.default_rng(2)
    n, ε, μ = 50, Augmentation(1.0, 1.0), 0.4
    ν = np.tile([0.0, 1.0], (n, 1))
    Λ, s, g = rng.standard_normal((n, 2)), rng.standard_normal((n, 2)), np.ones(n)
    frozen = np.where(np.arange(n) % 2, 0.05, np.nan)
    closed = np.ones(n, dtype=bool)
    state = Coulomb(ε, μ).evaluate(Λ, point_geometry(ν, g), s, closed, frozen)
    free = Coulomb(ε, μ).evaluate(Λ, point_geometry(ν, g), s, closed, None)
    slip = state.status == SLIP
    friction = np.abs(state.t[:, 0])
    assert np.allclose(friction[slip & ~np.isnan(frozen)], 0.05, rtol=1e-14)
    assert np.allclose(state.t[np.isnan(frozen)], free.t[np.isnan(frozen)], rtol=1e-14)
    assert np.all(state.slope[~np.isnan(frozen)] == 0.0)


@pytest.mark.parametrize("branch", ["stick", "slip", "open"])
def test_printed_equations_as_corrected_are_the_derivative(branch):
    """Eqs. (8)-(10) as docs/theory.md has them, with ν held, against central differences of eq. (4) in Λ, in the gap
    and in the slip (1e-7); in slip (8) as printed is off by more than 1e-2."""
    εN, εT, μ, ν = 3.0, 2.0, 0.4, np.array([2.0, -1.0, 2.0]) / 3
    P, νν = np.eye(3) - np.outer(ν, ν), np.outer(ν, ν)
    Λ, s = {"stick": 2.0, "slip": 1.0, "open": -2.0}[branch] * ν, np.array([0.1, 0.2, -0.3])
    s = s * (0.3 if branch == "stick" else 2.0)

    def hats(Λ, g, s):
        λN, λT = ν @ Λ + εN * g, P @ (-Λ + εT * s)
        return λN, λT, max(λN, 0.0)

    def evaluate(Λ, g, s):
        _, λT, p = hats(Λ, g, s)
        f = λT * min(1.0, μ * p / np.linalg.norm(λT))
        return p * ν - f, (p - ν @ Λ) / εN * ν + (-P @ Λ - f) / εT  # the contactor's force and R_Λ

    _, λT, p = hats(Λ, 0.01, s)
    n, H = np.linalg.norm(λT), float(p > 0)
    β, χ = min(1.0, μ * p / n), float(μ * p < n)
    hν, hh = np.outer(λT, ν) / n, np.outer(λT, λT) / n**3
    eq8 = -H * νν + χ * μ * H * hν + χ * μ * p * hh - β * P
    eq9_gap = -H * νν + χ * μ * H * εN / εT * hν
    eq9_slip = χ * μ * p * hh - β * P
    eq10 = (H - 1) / εN * νν - χ * μ * H / εT * hν - χ * μ * p / εT * hh - (1 - β) / εT * P
    assert (χ, H) == {"stick": (0, 1), "slip": (1, 1), "open": (1, 0)}[branch]
    step, δ = 1e-6, np.eye(3)

    def derivative(which, change):
        ahead, behind = (
            evaluate(*(np.add(v, h * d) for v, d in zip((Λ, 0.01, s), change, strict=True)))[which]
            for h in (step, -step)
        )
        return (ahead - behind) / (2 * step)

    columns = {
        "8": (eq8, [-derivative(0, (d, 0, 0 * d)) for d in δ]),
        "9, N": (eq9_gap, [derivative(1, (0 * d, -ν @ d, 0 * d)) for d in δ]),
        "9, δy": (eq9_slip, [derivative(1, (0 * d, 0, d)) for d in δ]),
        "10": (eq10, [derivative(1, (d, 0, 0 * d)) for d in δ]),
    }
    for name, (printed, found) in columns.items():
        assert np.allclose(printed, np.transpose(found), atol=1e-7), name
    if branch == "slip":
        misprinted8 = eq8 + χ * μ * p * (hν / n**2 - hh)
        assert np.abs(misprinted8 - np.transpose(columns["8"][1])).max() > 1e-2
