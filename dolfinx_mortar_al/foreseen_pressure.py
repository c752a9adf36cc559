"""Newton's derivative for nearly incompressible bodies: with the pressure that the last step foresaw.

With a stored energy Λ θ²/2 + rest, θ(𝐅) the law's volume strain, the pressure-like q = Λ θ stands in the derivative twice:

    ∫ Λ Dθ[∇v] Dθ[∇w] + q D²θ[∇v, ∇w].

A step keeps the volume to first order; what it misses, of second order, is multiplied by Λ, so that q at the next iterate may
be many times G and of either sign, and with it the derivative is worth nothing: Newton diverges. A formulation with q as an
unknown has q_k + Λ Dθ(𝐅_k)[∇Δu] in its place, linear in the step. With q eliminated that is the displacement method with
this one change of its derivative: quadratic convergence to the same state (docs/newton.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.materials import Hyperelastic, deformation_gradient

__all__ = ["ForeseenPressure"]

Array = NDArray[np.float64]
Part = tuple[Hyperelastic, ufl.Measure, Any]  # a law, the measure of its cells, its thickness (m)


class ForeseenPressure:
    """Of a body's nearly incompressible parts.

    Args:
        u: displacement (m).
        parts: with laws that have a volume strain.

    Attributes:
        form: what to add to the derivative of the residual; bilinear.
        last: (dofs,) displacement at which the derivative was assembled last, or a solve began (m).
    """

    def __init__(self, u: fem.Function, parts: Sequence[Part]) -> None:
        self._u = u
        self._before, self._step = fem.Function(u.function_space), fem.Function(u.function_space)
        F, F_before = deformation_gradient(u), deformation_gradient(self._before)
        v, w = ufl.TestFunction(u.function_space), ufl.TrialFunction(u.function_space)
        form = 0
        for law, dx, depth in parts:
            θ, θ_before = law.volume_strain(F), law.volume_strain(F_before)
            foreseen = θ_before + ufl.derivative(θ_before, self._before, self._step)
            curvature = ufl.derivative(ufl.derivative(θ, u, v), u, w)
            form += depth * law.lame * (foreseen - θ) * curvature * dx
        self.form: Any = form
        self.begin(u.x.array)

    @staticmethod
    def of(u: fem.Function, parts: Sequence[Part]) -> ForeseenPressure | None:
        """That of those of the parts that are nearly incompressible and have a volume strain; None without any."""
        F = deformation_gradient(u)
        rubber = [part for part in parts if part[0].is_nearly_incompressible and part[0].volume_strain(F) is not None]
        return ForeseenPressure(u, rubber) if rubber else None

    def begin(self, start: Array) -> None:
        """A solve begins from the converged state `start` (owned dofs, or with ghosts): its first derivative has the pressure
        of that, whatever u is predicted (collective)."""
        self._before.x.array[: len(start)] = start
        self._before.x.scatter_forward()
        self.last, self._is_first = self._before.x.array.copy(), True

    def look(self) -> None:
        """Foresee the pressure at u."""
        self._before.x.array[:] = self.last
        self._step.x.array[:] = 0.0 if self._is_first else self._u.x.array - self.last

    def advance(self) -> None:
        """The derivative has been assembled at u, from which the next step is taken."""
        self.last, self._is_first = self._u.x.array.copy(), False
