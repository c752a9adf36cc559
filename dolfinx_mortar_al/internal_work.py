"""The internal virtual work of a time step, and what the ledger books of it.

Where a stored energy is known its change is exactly the work of the step's mean stress P̄ (Gonzalez's discrete gradient); the
step takes P̄ + (θ − 1/2)(P₁ − P₀), as the rule for displacements weighs velocities, and loses (θ − 1/2)(P₁ − P₀):ΔF. Of any
other residual G(u; w) the step takes θ G(u₁; w) + (1−θ) G(u₀; w), and the ledger the work (G(u₀; Δu) + G(u₁; Δu))/2 of each
step: the trapezoidal rule along the path, which for θ = 1/2 is what the step's forces do. A form may hold 𝐮_n
itself, for the rate (u − old)/Δt of a viscous stress, say: it is the same at both ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from dolfinx import fem

from dolfinx_mortar_al.body import Part
from dolfinx_mortar_al.materials import deformation_gradient
from dolfinx_mortar_al.membrane import NeoHookeanMembrane, tangent_gradient

__all__ = ["CONSISTENT", "TRAPEZOIDAL", "WEIGHTED", "WORK", "InternalWork", "internal_work"]

#: how the ledger knows the strain energy
CONSISTENT = "stored energy, whose change is exactly the work of the step's forces"
WEIGHTED = "stored energy, forces weighted towards the end of the step, which take energy"
TRAPEZOIDAL = "stored energy, forces by the trapezoidal rule"
WORK = "internal work by the trapezoidal rule"


@dataclass(frozen=True)
class InternalWork:
    """Of a part of a body.

    Attributes:
        form: the step's internal virtual work, linear in the test function.
        energy: stored energy per reference measure of the part's cells (J/m³ × depth) at u₀, None where there is none.
        work: of the internal forces over the step (J) as a form, None where there is a stored energy.
        known: how the ledger knows it.
    """

    form: Any
    energy: Any
    work: Any
    known: str


def internal_work(part: Part, u: fem.Function, old: fem.Function, *, theta: float, consistent: bool) -> InternalWork:
    """The work of a part of a body in a step from `old` to `u`.

    Args:
        part: the part.
        u, old: displacements (m) at the end and at the begin.
        theta: weight of the end's forces where they are weighted.
        consistent: whether stored energies are to be met exactly.
    """
    if isinstance(part.material, ufl.Form):
        return _of_form(part.material, u, old, theta)
    law: Any = part.material
    membrane = isinstance(law, NeoHookeanMembrane)
    gradient = tangent_gradient if membrane else deformation_gradient
    more = (u.function_space.mesh.topology.dim,) if membrane else ()
    F0, F1 = gradient(old), gradient(u)
    if consistent:
        P = law.mean_first_piola(F0, F1, *more)
        if theta != 0.5:  # what weighs the end's stress more, without which stiff vibrations are not damped
            P += (theta - 0.5) * (law.first_piola(F1, *more) - law.first_piola(F0, *more))
    else:
        P = theta * law.first_piola(F1, *more) + (1 - theta) * law.first_piola(F0, *more)
    form = part.depth * ufl.inner(P, ufl.grad(ufl.TestFunction(u.function_space))) * part.dx
    known = TRAPEZOIDAL if not consistent else CONSISTENT if theta == 0.5 else WEIGHTED
    return InternalWork(form, part.depth * law.energy(F0, *more), None, known)


def _of_form(form: Any, u: fem.Function, old: fem.Function, θ: float) -> InternalWork:
    (w,) = form.arguments()
    start = ufl.replace(form, {u: old, old: 2 * old - u})  # so that u − old, of which rates are made, stays
    work = 0.5 * ufl.replace(start, {w: u - old}) + 0.5 * ufl.replace(form, {w: u - old})
    return InternalWork(θ * form + (1 - θ) * start, None, work, WORK)
