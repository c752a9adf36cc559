"""Hyperelastic materials as UFL: the deformation gradient 𝐅 in, the first Piola stress 𝐏 = ∂w/∂𝐅 out.

In two dimensions every law is meant in plane strain. Nothing here knows about contact: any other UFL residual can take
the place of :meth:`Hyperelastic.virtual_work`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh, MeshTags
from numpy.typing import NDArray
from ufl.algorithms.analysis import extract_coefficients, extract_constants, extract_type
from ufl.core.expr import Expr
from ufl.geometry import GeometricQuantity

from dolfinx_mortar_al.validation import check_law, check_plane, constant_value, is_ufl, number, positive_or_ufl

__all__ = [
    "SERIES",
    "Hyperelastic",
    "NeoHookean",
    "SaintVenantKirchhoff",
    "artanh_rest",
    "cell_measure",
    "cells_of",
    "deformation_gradient",
    "lame",
    "neo_hookean",
    "saint_venant_kirchhoff",
]

SMALL_STRAIN = 1e-5  # change of 𝐂 where the rest of a discrete gradient, by differences, is round-off
TINY_STRAIN = 1e-30  # where its quotient is 0/0
# Λ/G from which a strain of .4 in a step, by Λ .4²/2, brings a pressure near G, and Newton was seen to save iterations
STIFF_IN_VOLUME = 10.0
# 1 − 2ν down to which forces keep about eight digits: round-off of volume strains times Λ was seen to be 1e-16/(1 − 2ν) of
# them, times 1 at strains of .05 and times 100 at .001
LEAST_COMPRESSIBILITY = 1e-6
SERIES = 0.05  # up to which six terms give artanh z − z to round-off


def deformation_gradient(u: fem.Function) -> Expr:
    """𝐅 = 𝐈 + ∇u (dimensionless)."""
    return ufl.Identity(len(u)) + ufl.grad(u)


def cell_measure(u: fem.Function, dx: ufl.Measure | None = None) -> ufl.Measure:
    """`dx` (default all cells), with a quadrature degree of twice the order of u unless it has one of its own."""
    V = u.function_space
    dx = ufl.Measure("dx", V.mesh) if dx is None else dx
    return dx if "quadrature_degree" in dx.metadata() else dx(degree=2 * V.ufl_element().embedded_subdegree)


def cells_of(domain: Mesh, dx: ufl.Measure) -> NDArray[np.int32]:
    """This rank's own cells that a measure is of."""
    cells = np.arange(domain.topology.index_map(domain.topology.dim).size_local, dtype=np.int32)
    tags, ids = dx.subdomain_data(), dx.subdomain_id()
    if isinstance(tags, MeshTags) and ids != "everywhere":
        cells = np.intersect1d(cells, np.concatenate([tags.find(k) for k in np.atleast_1d(ids)])).astype(np.int32)
    return cells


def artanh_rest(z: Expr) -> Expr:
    """artanh z − z, by its series where that would cancel."""
    rest: Any = 0
    for k in reversed(range(6)):  # Horner's scheme: powers would be calls of pow()
        rest = 1 / (2 * k + 3) + z * z * rest
    series = z * z * z * rest
    return ufl.conditional(ufl.lt(abs(z), SERIES), series, ufl.ln((1 + z) / (1 - z)) / 2 - z)


def lame(E: Any, nu: Any) -> tuple[Any, Any]:
    """Lamé's (G, Λ) in Pa from Young's modulus E (Pa) and Poisson's ratio nu: numbers, or UFL such as a Constant.

    Raises:
        ValueError: on numbers out of range, or nu so near 0.5 that forces are round-off; UFL has none to look at.
    """
    if not is_ufl("E", constant_value(E, "E")):
        number("E", constant_value(E), above=0.0, must="Young's modulus (Pa) must be")
    if not is_ufl("nu", constant_value(nu, "nu")):
        ratio = number("nu", constant_value(nu), above=-1.0, below=0.5, must="Poisson's ratio must be")
        if 1 - 2 * ratio < LEAST_COMPRESSIBILITY:
            raise ValueError(
                f"nu = {ratio}: 1 − 2ν = {1 - 2 * ratio:.1e} is below {LEAST_COMPRESSIBILITY:g}, where round-off takes the "
                "digits of forces; take 0.4999, which is incompressible for all practical purposes"
            )
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


@dataclass(frozen=True)
class Hyperelastic(ABC):
    """A stored energy w(𝐅) per reference volume, with Lamé's moduli G and Λ (`lame`) in Pa."""

    G: Any
    lame: Any

    def energy(self, F: Expr) -> Expr:
        """w(𝐅) in J/m³."""
        return self.energy_of_strain(F.T * F)

    @abstractmethod
    def first_piola(self, F: Expr) -> Expr:
        """𝐏 = ∂w/∂𝐅 in Pa, written out (shorter kernels than an automatic derivative)."""

    def volume_strain(self, F: Expr) -> Any:
        """θ of a part Λ θ²/2 of w; None of a law without such a part."""
        return None

    @property
    def is_nearly_incompressible(self) -> bool:
        """Whether Λ is far above G (ν > .4545), or may be somewhere, of moduli that are fields."""
        ratio = self.lame / self.G
        if isinstance(ratio, Expr):
            constants = extract_constants(ratio)
            if (
                extract_coefficients(ratio)
                or extract_type(ratio, GeometricQuantity)
                or any(c.ufl_shape for c in constants)
            ):
                return True
            ratio = ratio((), {c: float(c.value) for c in constants})
        return bool(ratio > STIFF_IN_VOLUME)

    @abstractmethod
    def energy_of_strain(self, C: Expr) -> Expr:
        """w as a function of the right Cauchy–Green tensor 𝐂 = 𝐅ᵀ𝐅, in J/m³."""

    @abstractmethod
    def second_piola(self, C: Expr) -> Expr:
        """𝐒 = 2 ∂w/∂𝐂 in Pa."""

    def mean_first_piola(self, F0: Expr, F1: Expr) -> Expr:
        """The stress of a step from 𝐅₀ to 𝐅₁ that does exactly the work w(𝐅₁) − w(𝐅₀), in Pa.

        Gonzalez's discrete gradient (DOI 10.1016/S0045-7825(00)00189-4) on the mean strain, with 𝐅 at mid-step, which
        also keeps angular momentum.
        """
        C0, C1 = F0.T * F0, F1.T * F1
        ΔC = C1 - C0
        S = self.second_piola((C0 + C1) / 2)
        size = ufl.inner(ΔC, ΔC)
        # the rest is cubic in Δ𝐂
        least = self.least_change**2
        share = ufl.conditional(ufl.gt(size, least), self.energy_rest(C0, C1) / ufl.max_value(size, least), 0.0)
        return (F0 + F1) / 2 * (S + 2 * share * ΔC)

    #: change of 𝐂 in a step below which the discrete gradient is the gradient
    least_change: ClassVar[float] = SMALL_STRAIN

    def energy_rest(self, C0: Expr, C1: Expr) -> Expr:
        """w(𝐂₁) − w(𝐂₀) − 𝐒((𝐂₀ + 𝐂₁)/2) : (𝐂₁ − 𝐂₀)/2 in J/m³. A difference of large numbers here: below SMALL_STRAIN it is
        round-off, and so is what leaving it out costs."""
        S = self.second_piola((C0 + C1) / 2)
        return self.energy_of_strain(C1) - self.energy_of_strain(C0) - ufl.inner(S, C1 - C0) / 2

    def virtual_work(
        self, u: fem.Function, v: Expr | None = None, *, thickness: float = 1.0, dx: ufl.Measure | None = None
    ) -> Any:
        """Internal virtual work ∫ 𝐏(u) : ∇v dΩ, the form G_int of eq. (1).

        Args:
            u: displacement (m).
            v: virtual displacement, default the test function of u's space.
            thickness: of the body out of the plane (m), for a two-dimensional u.
            dx: measure of the body's cells, default all of the mesh; its quadrature degree defaults to twice u's order.
        """
        check_law(u, membrane=False, what=type(self).__name__)
        thickness = positive_or_ufl("thickness", thickness)
        check_plane(thickness, u.function_space.mesh.topology.dim)
        v = ufl.TestFunction(u.function_space) if v is None else v
        dx = cell_measure(u, dx)
        return thickness * ufl.inner(self.first_piola(deformation_gradient(u)), ufl.grad(v)) * dx


class SaintVenantKirchhoff(Hyperelastic):
    """w = Λ/2 (tr 𝐄)² + G 𝐄:𝐄 with the Green–Lagrange strain 𝐄 = (𝐅ᵀ𝐅 − 𝐈)/2."""

    def first_piola(self, F: Expr) -> Expr:
        return F * self.second_piola(F.T * F)

    def volume_strain(self, F: Expr) -> Expr:
        """tr 𝐄."""
        return ufl.tr(F.T * F - ufl.Identity(F.ufl_shape[0])) / 2

    def energy_of_strain(self, C: Expr) -> Expr:
        E = (C - ufl.Identity(C.ufl_shape[0])) / 2
        return self.lame / 2 * ufl.tr(E) ** 2 + self.G * ufl.inner(E, E)

    def second_piola(self, C: Expr) -> Expr:
        I = ufl.Identity(C.ufl_shape[0])
        E = (C - I) / 2
        return self.lame * ufl.tr(E) * I + 2 * self.G * E

    def mean_first_piola(self, F0: Expr, F1: Expr) -> Expr:
        """The mean of the two ends' stresses (Simo and Tarnow), which for this law is the discrete gradient."""
        return (F0 + F1) / 2 * self.second_piola((F0.T * F0 + F1.T * F1) / 2)


class NeoHookean(Hyperelastic):
    """w = G/2 (I₁ − 3) − G/2 ln I₃ + Λ/8 (ln I₃)², section 4.2 of the paper (its μ, λ are G, Λ here)."""

    def energy_of_strain(self, C: Expr) -> Expr:
        out_of_plane = 3 - C.ufl_shape[0]
        I1, lnI3 = ufl.tr(C) + out_of_plane, ufl.ln(ufl.det(C))
        return self.G / 2 * (I1 - 3 - lnI3) + self.lame / 8 * lnI3**2

    def second_piola(self, C: Expr) -> Expr:
        I, C_inv = ufl.Identity(C.ufl_shape[0]), ufl.inv(C)
        return self.G * (I - C_inv) + self.lame / 2 * ufl.ln(ufl.det(C)) * C_inv

    def first_piola(self, F: Expr) -> Expr:
        F_inv_T = ufl.inv(F).T
        return self.G * (F - F_inv_T) + self.lame * ufl.ln(ufl.det(F)) * F_inv_T

    def volume_strain(self, F: Expr) -> Expr:
        """ln det 𝐅."""
        return ufl.ln(ufl.det(F))

    least_change: ClassVar[float] = TINY_STRAIN

    def energy_rest(self, C0: Expr, C1: Expr) -> Expr:
        """Without differences of large numbers, whose round-off would keep Newton from converging where a stiff body moves
        slowly. With 𝐀 = 𝐂̄⁻¹Δ𝐂 for the mean 𝐂̄ and its invariants I₁, I₂, I₃,

            det(𝐈 ± 𝐀/2) = even ± odd,   even = 1 + I₂/4,   odd = I₁/2 + I₃/8,   Δ ln det 𝐂 = 2 artanh(odd/even).
        """
        C = (C0 + C1) / 2
        A = ufl.inv(C) * (C1 - C0)
        I1 = ufl.tr(A)
        I2 = (I1**2 - ufl.tr(A * A)) / 2
        I3 = ufl.det(A) if C0.ufl_shape[0] == 3 else 0.0
        even = 1 + I2 / 4
        z = (I1 / 2 + I3 / 8) / even
        miss = I3 / 4 - z * I2 / 2 + 2 * artanh_rest(z)  # Δ ln det 𝐂 − I₁
        mean = ufl.ln(even**2 * (1 - z**2)) / 2  # of ln det 𝐂 at both ends, less ln det 𝐂̄
        return (self.lame * ufl.ln(ufl.det(C)) / 4 - self.G / 2) * miss + self.lame / 4 * mean * (I1 + miss)


def saint_venant_kirchhoff(E: Any, nu: Any) -> SaintVenantKirchhoff:
    """St Venant–Kirchhoff material from Young's modulus E (Pa) and Poisson's ratio ν, as :func:`lame` takes them."""
    return SaintVenantKirchhoff(*lame(E, nu))


def neo_hookean(E: Any, nu: Any) -> NeoHookean:
    """The paper's neo-Hookean material from Young's modulus E (Pa) and Poisson's ratio ν, as :func:`lame` takes them."""
    return NeoHookean(*lame(E, nu))
