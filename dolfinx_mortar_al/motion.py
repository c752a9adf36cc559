"""A body in motion: its mass, velocity and the residual of a time step (``docs/impact.md``)."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.materials import Hyperelastic, cell_measure, deformation_gradient
from dolfinx_mortar_al.validation import check_external, check_law, number, positive_or_ufl

__all__ = ["Motion"]

Array = NDArray[np.float64]


class Motion:
    """A body in motion: its mass, velocity and the mid-step residual to hand to a ContactProblem.

    Args:
        u: displacement (m), at the start state.
        material: its stored energy.
        density: ρ per reference volume (kg/m³).
        step: Δt (s), the longest that will be used.
        theta: θ of the scheme, 1/2 ≤ θ ≤ 1; anything but 1/2 dissipates.
        force: "consistent", whose energy balance is exact (with θ = 1/2), or "trapezoidal", θ-weighted end forces.
        thickness: out of the plane (m).
        external: external virtual work of dead loads, a UFL form linear in the test function.

    Attributes:
        residual: UFL form for :class:`~dolfinx_mortar_al.problem.ContactProblem`.
        velocity: 𝐯_n (m/s), a Function to interpolate the initial velocity into.

    Raises:
        ValueError: on a density, step, θ or force out of range.
    """

    def __init__(
        self,
        u: fem.Function,
        material: Hyperelastic,
        *,
        density: float,
        step: float,
        theta: float = 0.5,
        force: str = "consistent",
        thickness: float = 1.0,
        external: Any = None,
    ) -> None:
        density, thickness = positive_or_ufl("density", density), positive_or_ufl("thickness", thickness)
        step = number("step", step, above=0.0, must="Δt (s) must be")
        theta = number("theta", theta, least=0.5, most=1.0, must="θ must be")
        check_law(u, membrane=False, what="Motion")
        check_external(external, u)
        if not isinstance(force, str) or force not in ("consistent", "trapezoidal"):
            raise ValueError(f'force = "{force}": "consistent" or "trapezoidal"')
        V = u.function_space
        self.u, self.material, self.density, self.thickness, self.theta = u, material, density, thickness, theta
        self.external = external
        self.old, self.velocity = u.copy(), fem.Function(V, name="velocity")
        self.time_step = fem.Constant(V.mesh, float(step))
        self.dx = cell_measure(u)
        w = ufl.TestFunction(V)
        F0, F1 = deformation_gradient(self.old), deformation_gradient(u)
        if force == "consistent":
            P = material.mean_first_piola(F0, F1)
        else:
            P = theta * material.first_piola(F1) + (1 - theta) * material.first_piola(F0)
        rate = (self.new_velocity() - self.velocity) / self.time_step
        self.residual = thickness * (density * ufl.inner(rate, w) + ufl.inner(P, ufl.grad(w))) * self.dx
        if external is not None:
            self.residual -= external
        work = None if external is None else ufl.replace(external, {w: u - self.old})
        self._work = None if work is None else fem.form(work)
        self._energies = self.energy_forms()
        self._momenta = self._momentum_forms()

    def new_velocity(self) -> Any:
        """𝐯_{n+1} (m/s) as UFL of 𝐮_{n+1}, 𝐮_n and 𝐯_n."""
        return (self.u - self.old) / (self.theta * self.time_step) - (1 - self.theta) / self.theta * self.velocity

    def energy_forms(self, dx: ufl.Measure | None = None) -> tuple[Any, Any]:
        """Kinetic and strain energy (J) at the last accepted step as compiled forms, over all cells or those of `dx`."""
        dx = cell_measure(self.u, dx)
        v, w = self.velocity, self.material.energy(deformation_gradient(self.old))
        return (
            fem.form(self.thickness * self.density / 2 * ufl.inner(v, v) * dx),
            fem.form(self.thickness * w * dx),
        )

    def _momentum_forms(self) -> list[Any]:
        d = len(self.u)
        p = self.thickness * self.density * self.velocity
        x = ufl.SpatialCoordinate(self.u.function_space.mesh) + self.old
        spin = [x[0] * p[1] - x[1] * p[0]] if d == 2 else list(ufl.cross(x, p))
        return [fem.form(c * self.dx) for c in (*p, *spin)]

    def integral(self, form: Any) -> float:
        """Value of a compiled scalar form (collective)."""
        return float(self.u.function_space.mesh.comm.allreduce(fem.assemble_scalar(form)))

    def energies(self) -> tuple[float, float]:
        """Kinetic and strain energy (J), collective."""
        kinetic, strain = self._energies
        return self.integral(kinetic), self.integral(strain)

    def kinetic_energy(self) -> float:
        """Kinetic energy (J), collective."""
        return self.integral(self._energies[0])

    @cached_property
    def mass(self) -> float:
        """Mass (kg), collective."""
        one = fem.Constant(self.u.function_space.mesh, 1.0)
        return self.integral(fem.form(self.thickness * self.density * one * self.dx))

    @cached_property
    def mass_form(self) -> fem.Form:
        """The mass (kg) as a compiled bilinear form."""
        V = self.u.function_space
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        return fem.form(self.thickness * self.density * ufl.inner(u, v) * self.dx)

    def momenta(self) -> Array:
        """Momentum (N s, gdim) and angular momentum about the origin (N m s, 1 or 3), collective."""
        return np.array([self.integral(form) for form in self._momenta])

    def external_work(self) -> float:
        """Work of the dead loads in the present step (J), collective."""
        return 0.0 if self._work is None else self.integral(self._work)

    def predict(self) -> None:
        """𝐮 ← 𝐮_n + Δt 𝐯_n/2, where the step's contact geometry is taken first."""
        self.u.x.array[:] = self.old.x.array + self.time_step.value / 2 * self.velocity.x.array

    def guess(self) -> None:
        """𝐮 ← 𝐮_n + Δt 𝐯_n, from which Newton starts."""
        self.u.x.array[:] = self.old.x.array + self.time_step.value * self.velocity.x.array

    def accept(self) -> None:
        """The step has converged: 𝐯_n ← 𝐯_{n+1}, 𝐮_n ← 𝐮_{n+1}."""
        new = (self.u.x.array - self.old.x.array) / (self.theta * self.time_step.value)
        self.velocity.x.array[:] = new - (1 - self.theta) / self.theta * self.velocity.x.array
        self.old.x.array[:] = self.u.x.array

    def undo(self) -> None:
        """Undo a step: 𝐮 ← 𝐮_n."""
        self.u.x.array[:] = self.old.x.array

    def snapshot(self) -> dict[str, Array]:
        """𝐮_n and 𝐯_n on this rank, ghosts included."""
        return {"old": self.old.x.array.copy(), "velocity": self.velocity.x.array.copy()}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        self.old.x.array[:], self.velocity.x.array[:] = saved["old"], saved["velocity"]
