"""External virtual work as UFL: ``external`` of a :class:`~dolfinx_mortar_al.body.Body`, or subtracted from the internal
virtual work to get a residual of one's own.

Tractions are nominal: force per reference area (Pa), or per reference length times thickness in two dimensions. A Body puts
in its thickness where it is given a vector and a measure in place of a form: `axis_normal` or `area_normal` times a number.
"""

from __future__ import annotations

from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_mortar_al.materials import cell_measure, cells_of, deformation_gradient
from dolfinx_mortar_al.membrane import area_vector
from dolfinx_mortar_al.reductions import sum_over

__all__ = ["area_normal", "axis_normal", "dead_traction", "follower_force", "membrane_pressure", "pressure"]


def dead_traction(u: fem.Function, traction: Expr, ds: ufl.Measure) -> Any:
    """∫ 𝐭₀·v dS₀ with a traction 𝐭₀ (Pa × thickness) that keeps its direction."""
    return ufl.inner(traction, ufl.TestFunction(u.function_space)) * ds


def axis_normal(u: fem.Function) -> Expr:
    """Unit vector at right angles to the deformed axis 𝐅𝐞_X, turned from it by −90° in the X-Y plane."""
    F = deformation_gradient(u)
    turned = [F[1, 0], -F[0, 0]] + [0] * (len(u) - 2)
    return ufl.as_vector(turned) / ufl.sqrt(F[0, 0] ** 2 + F[1, 0] ** 2)


def follower_force(u: fem.Function, traction: Expr, ds: ufl.Measure) -> Any:
    """∫ t 𝐧(u)·v dS₀: a traction t (Pa × thickness) along :func:`axis_normal`, as on the tip of a beam (section 4.1)."""
    return traction * ufl.inner(axis_normal(u), ufl.TestFunction(u.function_space)) * ds


def area_normal(u: fem.Function) -> Expr:
    """det 𝐅 𝐅⁻ᵀ𝐍 = 𝐧 da/dA on facets (Nanson): outward normal of the deformed body times the ratio of areas."""
    F = deformation_gradient(u)
    return ufl.det(F) * ufl.inv(F).T * ufl.FacetNormal(u.function_space.mesh)


def pressure(u: fem.Function, p: Expr, ds: ufl.Measure) -> Any:
    """−∫ p 𝐧·v da = −∫ p det 𝐅 𝐅⁻ᵀ𝐍·v dS₀: a follower pressure p (Pa × thickness) on facets, against their outward side.

    Raises:
        ValueError: if `ds` is no measure of facets.
    """
    if not isinstance(ds, ufl.Measure) or ds.integral_type() != "exterior_facet":
        raise ValueError(f"ds: {ds} is no measure of facets; pass ufl.Measure('ds', mesh, subdomain_data=tags)(tag)")
    return -p * ufl.inner(area_normal(u), ufl.TestFunction(u.function_space)) * ds


def membrane_pressure(u: fem.Function, p: Expr, side: Any, dx: ufl.Measure) -> Any:
    """∫ p 𝐧·v da: a follower pressure p (Pa) that pushes a membrane towards its side `side`.

    Args:
        u: displacement of the membrane (m).
        p: pressure (Pa).
        side: a vector (numbers, or UFL in reference coordinates) that points to where the pressure pushes.
        dx: measure of the cells under pressure.

    Raises:
        ValueError: on every rank, if `side` lies in the membrane's plane somewhere under `dx`.
    """
    _check_side(u, side, dx)
    return p * ufl.inner(area_vector(u, side), ufl.TestFunction(u.function_space)) * cell_measure(u, dx)


def _check_side(u: fem.Function, side: Any, dx: ufl.Measure) -> None:
    """The pressure must know which way to push: the side may nowhere be at right angles to the normal (collective)."""
    area_vector(u, side)  # a vector, on a membrane
    mesh = u.function_space.mesh
    middle = basix.geometry(mesh.basix_cell()).mean(axis=0)[None]
    J = ufl.Jacobian(mesh)
    across = side if isinstance(side, Expr) else fem.Constant(mesh, np.asarray(side, dtype=np.float64))
    along = J * ufl.JacobianInverse(mesh) * across
    parts = fem.Expression(ufl.as_vector([ufl.inner(across, across), ufl.inner(along, along)]), middle, comm=mesh.comm)
    whole, flat = parts.eval(mesh, cells_of(mesh, dx)).reshape(-1, 2).T
    inside = ~(whole - flat > 1e-12 * whole)
    if sum_over(mesh.comm, int(inside.sum())):
        raise ValueError(
            f"side = {side} lies in the plane of the membrane somewhere: point to where the pressure pushes"
        )
