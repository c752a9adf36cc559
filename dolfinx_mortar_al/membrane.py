"""Membranes as UFL: a curve in the plane or a surface in space, of small thickness and without bending stiffness.

The mesh's cells have one dimension less than the space. 𝐅 = 𝐓 + ∇u maps the membrane's tangent plane (projector 𝐓) to the
deformed one; J is the ratio of deformed to reference area (length, for a curve). Stress vanishes through the thickness,
which is eliminated here; a curve is in plane strain along z (section 4.2 of the paper).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import Any

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_mortar_al.materials import SERIES, artanh_rest, cell_measure, lame
from dolfinx_mortar_al.validation import check_law, constant_value, positive_or_ufl, vector

__all__ = [
    "NeoHookeanMembrane",
    "area_stretch",
    "area_vector",
    "neo_hookean_membrane",
    "principal_stretches",
    "tangent_gradient",
]

HALLEY = (
    4  # iterations for the thickness: round-off for J from e⁻⁴ to e⁷ and ν from 0 to 0.4999 (tests/test_membrane.py)
)

LEAST_CHANGE = 1e-8  # of 𝐂 in a step: below it what makes the stress of a step exact, quadratic in it, is round-off


def tangent_gradient(u: fem.Function) -> Expr:
    """𝐅 = 𝐓 + ∇u (dimensionless), gdim × gdim, zero on the reference normal."""
    mesh = u.function_space.mesh
    return ufl.Jacobian(mesh) * ufl.JacobianInverse(mesh) + ufl.grad(u)


def _squared_area_stretch(C: Expr, tdim: int) -> Expr:
    """J² from the tangential Cauchy–Green tensor 𝐂 = 𝐅ᵀ𝐅."""
    return ufl.tr(C) if tdim == 1 else (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2


def area_stretch(u: fem.Function) -> Expr:
    """J, current over reference area of a membrane (length, for a curve)."""
    F = tangent_gradient(u)
    return ufl.sqrt(_squared_area_stretch(F.T * F, u.function_space.mesh.topology.dim))


def principal_stretches(u: fem.Function) -> tuple[Expr, ...]:
    """The membrane's stretches in its own plane, the smallest first: one for a curve, two for a surface."""
    mesh = u.function_space.mesh
    F = tangent_gradient(u)
    C = F.T * F
    if mesh.topology.dim == 1:
        return (ufl.sqrt(ufl.tr(C)),)
    mean = ufl.tr(C) / 2
    deviator = C - mean * ufl.Jacobian(mesh) * ufl.JacobianInverse(mesh)
    spread = ufl.sqrt(ufl.inner(deviator, deviator) / 2)  # without the cancellation of mean² − det
    return ufl.sqrt(ufl.max_value(mean - spread, 0.0)), ufl.sqrt(mean + spread)


def area_vector(u: fem.Function, side: Any) -> Expr:
    """𝐧 da/dA: normal of the deformed membrane times the ratio of areas, on its side `side`.

    Args:
        u: displacement (m).
        side: a vector (numbers, or UFL in reference coordinates) that points to that side of the reference membrane.

    Raises:
        ValueError: on a mesh that is no membrane, or a side that is no vector of its space.
    """
    check_law(u, membrane=True, what="area_vector")
    mesh = u.function_space.mesh
    J = ufl.Jacobian(mesh)
    if not isinstance(side, Expr):
        side = ufl.as_vector(vector("side", side, mesh.geometry.dim).tolist())
    elif side.ufl_shape != (mesh.geometry.dim,):
        raise ValueError(f"side = {side}: needs {mesh.geometry.dim} components")
    reference, current = _normal(J), _normal(J + ufl.grad(u) * J)
    turn = ufl.conditional(ufl.gt(ufl.inner(reference, side), 0.0), 1.0, -1.0)
    return turn * current / ufl.sqrt(ufl.inner(reference, reference))


def _normal(a: Expr) -> Expr:
    """𝐚₁ turned by −90° or 𝐚₁ × 𝐚₂ from tangents in columns, not normalised."""
    if a.ufl_shape[1] == 1:
        return ufl.as_vector([a[1, 0], -a[0, 0]])
    return ufl.cross(a[:, 0], a[:, 1])


@dataclass(frozen=True)
class NeoHookeanMembrane:
    """The neo-Hookean law of section 4.2 in plane stress through the thickness; G, Λ in Pa, reference thickness in m.

    Stationarity of w in the squared thickness stretch x, G(x − 1) + Λ/2 ln x + Λ ln J = 0, leaves 𝐏 = G(𝐅 − x 𝐅⁺ᵀ) with
    the pseudo-inverse 𝐅⁺.
    """

    G: Any
    lame: Any
    thickness: Any

    def squared_thickness_stretch(self, J: Expr) -> Expr:
        """x(J), by Halley's iteration on y = ln x: exact to round-off, and so is its derivative."""
        G, Λ = self.G, self.lame
        log_J = ufl.ln(J)
        y = -Λ * log_J / (G + Λ / 2)
        for _ in range(HALLEY):
            x = ufl.exp(y)
            f, slope = G * (x - 1) + Λ * (y / 2 + log_J), G * x + Λ / 2
            y = y - 2 * f * slope / (2 * slope**2 - f * G * x)
        return ufl.exp(y)

    def first_piola(self, F: Expr, tdim: int) -> Expr:
        """𝐏 in Pa from :func:`tangent_gradient`."""
        C = F.T * F
        JJ = _squared_area_stretch(C, tdim)
        F_inv_T = F / JJ if tdim == 1 else (ufl.tr(C) * F - F * C) / JJ  # 𝐂⁻¹ by Cayley–Hamilton in the plane
        return self.G * (F - self.squared_thickness_stretch(ufl.sqrt(JJ)) * F_inv_T)

    def energy(self, F: Expr, tdim: int) -> Expr:
        """w in J/m³ from :func:`tangent_gradient`, at the thickness where it is least."""
        C = F.T * F
        JJ = _squared_area_stretch(C, tdim)
        x = self.squared_thickness_stretch(ufl.sqrt(JJ))
        lnI3 = ufl.ln(JJ * x)
        return self.G / 2 * (ufl.tr(C) + x - tdim - 1 - lnI3) + self.lame / 8 * lnI3**2

    def mean_first_piola(self, F0: Expr, F1: Expr, tdim: int) -> Expr:
        """The stress of a step from 𝐅₀ to 𝐅₁ that does exactly the work w(𝐅₁) − w(𝐅₀), in Pa: Gonzalez's discrete gradient,
        as :meth:`Hyperelastic.mean_first_piola`."""
        C0, C1 = F0.T * F0, F1.T * F1
        ΔC, F = C1 - C0, (F0 + F1) / 2
        C = (C0 + C1) / 2
        JJ, size = _squared_area_stretch(C, tdim), ufl.inner(ΔC, ΔC)
        FC_inv = F * C / JJ**2 if tdim == 1 else (ufl.tr(C) * F - F * C) / JJ
        P = self.G * (F - self.squared_thickness_stretch(ufl.sqrt(JJ)) * FC_inv)
        least = LEAST_CHANGE**2
        share = ufl.conditional(ufl.gt(size, least), self.energy_rest(C0, C1, tdim) / ufl.max_value(size, least), 0.0)
        return P + 2 * share * F * ΔC

    def energy_rest(self, C0: Expr, C1: Expr, tdim: int) -> Expr:
        """w(𝐂₁) − w(𝐂₀) − 𝐒(𝐂̄) : Δ𝐂/2 in J/m³ for the mean 𝐂̄, cubic in Δ𝐂, without differences of large numbers.

        With l = ln J² and y = ln x the energy is G/2 tr 𝐂 + f(l), f′ = −G x/2, and stationarity of x makes

            f(l₁) − f(l₀) = G e^ȳ [sinh δ − δ cosh δ − Δl/2 cosh δ],     ȳ = (y₀ + y₁)/2,   δ = (y₁ − y₀)/2.

        From that G x(𝐂̄) I₁/2 is taken, where I₁, I₂ are the invariants of 𝐂̄⁻¹Δ𝐂 and Δl = 2 artanh z, z = I₁/2 / (1 + I₂/4).
        """
        C, ΔC = (C0 + C1) / 2, C1 - C0
        JJ = _squared_area_stretch(C, tdim)
        y0, ym, y1 = (
            ufl.ln(self.squared_thickness_stretch(ufl.sqrt(a)))
            for a in (_squared_area_stretch(C0, tdim), JJ, _squared_area_stretch(C1, tdim))
        )
        if tdim == 1:
            I1, I2 = ufl.tr(ΔC) / JJ, 0.0
        else:
            I1 = (ufl.tr(C) * ufl.tr(ΔC) - ufl.tr(C * ΔC)) / JJ
            I2 = _squared_area_stretch(ΔC, tdim) / JJ
        z = I1 / 2 / (1 + I2 / 4)
        miss = 2 * artanh_rest(z) - z * I2 / 2  # Δl − I₁
        δ, q = (y1 - y0) / 2, ym - (y0 + y1) / 2
        cosh_rest = 2 * ufl.sinh(δ / 2) ** 2  # cosh δ − 1
        exp_rest = 2 * ufl.sinh(q / 2) * ufl.exp(q / 2)  # e^q − 1
        mean = ufl.exp((y0 + y1) / 2)
        return self.G * mean * (_sinh_rest(δ) - (miss * (1 + cosh_rest) + I1 * (cosh_rest - exp_rest)) / 2)

    def virtual_work(self, u: fem.Function, v: Expr | None = None, *, dx: ufl.Measure | None = None) -> Any:
        """Internal virtual work ∫ h 𝐏(u) : ∇v dA (per unit length along z, for a curve).

        Args:
            u: displacement (m), on a mesh of cells of dimension gdim − 1.
            v: virtual displacement, default the test function of u's space.
            dx: measure of the membrane's cells, default all; its quadrature degree defaults to twice the order of u.
        """
        check_law(u, membrane=True, what=type(self).__name__)
        v = ufl.TestFunction(u.function_space) if v is None else v
        P = self.first_piola(tangent_gradient(u), u.function_space.mesh.topology.dim)
        return self.thickness * ufl.inner(P, ufl.grad(v)) * cell_measure(u, dx)

    def smallest_tension(self, u: fem.Function) -> Expr:
        """Tension in the direction of least stretch (N/m, per reference width); below zero the membrane would wrinkle."""
        l, x = principal_stretches(u)[0], self.squared_thickness_stretch(area_stretch(u))
        return self.thickness * self.G * (l - x / l)


def _sinh_rest(δ: Expr) -> Expr:
    """sinh δ − δ cosh δ, by its series where that would cancel."""
    series = -(δ**3) * sum(2 * (k + 1) / factorial(2 * k + 3) * δ ** (2 * k) for k in range(6))
    return ufl.conditional(ufl.lt(abs(δ), SERIES), series, ufl.sinh(δ) - δ * ufl.cosh(δ))


def neo_hookean_membrane(E: Any, nu: Any, thickness: Any) -> NeoHookeanMembrane:
    """Neo-Hookean membrane from Young's modulus E (Pa), Poisson's ratio ν and thickness (m), numbers or UFL.

    Raises:
        ValueError: on moduli out of range, ν < 0 (the thickness is then not unique) or a thickness that is not positive.
    """
    moduli, ν = lame(E, nu), constant_value(nu)
    if not isinstance(ν, Expr) and float(ν) < 0:
        raise ValueError(f"nu = {ν}: a membrane needs 0 ≤ ν < 0.5, for ν < 0 its thickness stretch is not unique")
    return NeoHookeanMembrane(*moduli, positive_or_ufl("thickness", thickness))
