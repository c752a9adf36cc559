"""The internal virtual work of a time step, and what the ledger books of it.

Where a stored energy is known its change is exactly the work of the step's mean stress (Gonzalez's discrete gradient). Of any
other residual G(u; w) the step takes θ G(u₁; w) + (1−θ) G(u₀; w), and the ledger the work (G(u₀; Δu) + G(u₁; Δu))/2 of each
step: the trapezoidal rule along the path, which for θ = 1/2 is what the step's forces do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import ufl
from dolfinx import fem

from dolfinx_mortar_al.materials import Hyperelastic, cell_measure, deformation_gradient
from dolfinx_mortar_al.membrane import NeoHookeanMembrane, tangent_gradient
from dolfinx_mortar_al.validation import check_law, check_linear, check_residual

__all__ = ["CONSISTENT", "TRAPEZOIDAL", "WORK", "InternalWork", "Material", "internal_work"]

#: how the ledger knows the strain energy
CONSISTENT = "stored energy, whose change is exactly the work of the step's forces"
TRAPEZOIDAL = "stored energy, forces by the trapezoidal rule"
WORK = "internal work by the trapezoidal rule"

#: what gives a part of a body its internal forces: a law with a stored energy, or a virtual work linear in the test function
Material: TypeAlias = Hyperelastic | NeoHookeanMembrane | ufl.Form


@dataclass(frozen=True)
class InternalWork:
    """Of a part of a body.

    Attributes:
        form: the step's internal virtual work, linear in the test function.
        dx: measure of the part's cells.
        depth: thickness by which the density counts (m).
        energy: stored energy per reference measure of `dx` (J/m³ × depth) at u₀, None where there is none.
        work: of the internal forces over the step (J) as a form, None where there is a stored energy.
        known: how the ledger knows it.
    """

    form: Any
    dx: ufl.Measure
    depth: Any
    energy: Any
    work: Any
    known: str


def internal_work(
    u: fem.Function,
    old: fem.Function,
    material: Material,
    dx: ufl.Measure | None,
    *,
    theta: float,
    consistent: bool,
    thickness: Any,
    name: str,
) -> InternalWork:
    """The work of a material in a step from `old` to `u`.

    Args:
        u, old: displacements (m) at the end and at the begin.
        material: a law or a form.
        dx: its cells, default all.
        theta: weight of the end's forces where they are weighted.
        consistent: whether stored energies are to be met exactly.
        thickness: out of the plane (m).
        name: of the argument that the material was passed as.

    Raises:
        ValueError: on a law for other cells than u's, or a form that is no residual of u.
    """
    if isinstance(material, ufl.Form):
        return _of_form(u, old, material, dx, theta, thickness, name)
    if not isinstance(material, Hyperelastic | NeoHookeanMembrane):
        raise ValueError(
            f"{name}: {type(material).__name__} is no material: pass a law with a stored energy, a UFL form of the internal "
            "virtual work, or a list of (law or form, measure)"
        )
    law: Any = material
    membrane = isinstance(law, NeoHookeanMembrane)
    check_law(u, membrane=membrane, what=f"Motion with {type(law).__name__}")
    gradient = tangent_gradient if membrane else deformation_gradient
    if membrane and thickness != 1.0:
        raise ValueError(f"thickness = {thickness}: a membrane has its own; leave it out")
    F0, F1 = gradient(old), gradient(u)
    depth, more = (law.thickness, (u.function_space.mesh.topology.dim,)) if membrane else (thickness, ())
    if consistent:
        P = law.mean_first_piola(F0, F1, *more)
    else:
        P = theta * law.first_piola(F1, *more) + (1 - theta) * law.first_piola(F0, *more)
    dx = cell_measure(u, dx)
    form = depth * ufl.inner(P, ufl.grad(ufl.TestFunction(u.function_space))) * dx
    return InternalWork(form, dx, depth, depth * law.energy(F0, *more), None, CONSISTENT if consistent else TRAPEZOIDAL)


def _of_form(
    u: fem.Function, old: fem.Function, form: Any, dx: ufl.Measure | None, θ: float, thickness: Any, name: str
) -> InternalWork:
    check_residual(form, u, name)
    check_linear(name, form)
    (w,) = form.arguments()
    start = ufl.replace(form, {u: old})
    work = 0.5 * ufl.replace(start, {w: u - old}) + 0.5 * ufl.replace(form, {w: u - old})
    if dx is None:  # of the same tags as the form's, which one residual must have
        kinds: dict[str, Any] = next(iter(form.subdomain_data().values()), {})
        tags = kinds.get("cell", [None])[0]
        dx = ufl.Measure("dx", u.function_space.mesh, subdomain_data=tags)
    return InternalWork(θ * form + (1 - θ) * start, cell_measure(u, dx), thickness, None, work, WORK)
