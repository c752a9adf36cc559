"""A body in motion: its mass, velocity and the residual of a time step (``docs/impact.md``)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.internal_work import InternalWork, Material, internal_work
from dolfinx_mortar_al.materials import cell_measure
from dolfinx_mortar_al.validation import check_external, check_residual, number, positive_or_ufl
from dolfinx_mortar_al.versions import whole_form

__all__ = ["Motion"]

Array = NDArray[np.float64]


class Motion:
    """A body in motion: its mass, velocity and the mid-step residual to hand to a ContactProblem.

    Args:
        u: displacement (m), at the start state.
        material: what its internal forces come from, on all cells: a law with a stored energy, of a body or a membrane, or a
            UFL form of an internal virtual work G(u; w); or a list of (law or form, measure of its cells).
        density: ρ per reference volume (kg/m³); a list, if each part of a list of materials has its own.
        step: Δt (s), the longest that will be used.
        theta: θ of the scheme, 1/2 ≤ θ ≤ 1; anything but 1/2 dissipates.
        force: "consistent", whose energy balance is exact (with θ = 1/2), or "trapezoidal", θ-weighted end forces, which a
            form has in any case.
        thickness: out of the plane (m), that of the contacts, too; a form has it written into it and needs it here for the
            mass, a membrane has its own.
        external: external virtual work of dead loads, a UFL form linear in the test function.

    Attributes:
        residual: UFL form for :class:`~dolfinx_mortar_al.problem.ContactProblem`.
        velocity: 𝐯_n (m/s), a Function to interpolate the initial velocity into.
        known: how the ledger knows the strain energy, in words.

    Raises:
        ValueError: on every rank: a density, step, θ or force out of range, a material for other cells, or parts that leave
            cells out or have some in common.
    """

    def __init__(
        self,
        u: fem.Function,
        material: Material | Sequence[tuple[Material, ufl.Measure]],
        *,
        density: Any,
        step: float,
        theta: float = 0.5,
        force: str = "consistent",
        thickness: float = 1.0,
        external: Any = None,
    ) -> None:
        thickness = positive_or_ufl("thickness", thickness)
        step = number("step", step, above=0.0, must="Δt (s) must be")
        theta = number("theta", theta, least=0.5, most=1.0, must="θ must be")
        check_external(external, u)
        if not isinstance(force, str) or force not in ("consistent", "trapezoidal"):
            raise ValueError(f'force = "{force}": "consistent" or "trapezoidal"')
        V = u.function_space
        self.u, self.density, self.thickness, self.theta = u, density, thickness, theta
        self.external = external
        self.old, self.velocity = u.copy(), fem.Function(V, name="velocity")
        self.time_step = fem.Constant(V.mesh, float(step))
        self.parts = self._parts_of(material, force == "consistent")
        self.known = "; ".join(dict.fromkeys(part.known for part in self.parts))
        w = ufl.TestFunction(V)
        rate = (self.new_velocity() - self.velocity) / self.time_step
        self.residual = self._per_mass(ufl.inner(rate, w)) + sum(part.form for part in self.parts)
        if external is not None:
            self.residual -= external
        if isinstance(material, list | tuple):
            check_residual(self.residual, u, "material")
            self._check_cover()
        work = None if external is None else ufl.replace(external, {w: u - self.old})
        self._work = None if work is None else self._compiled(work)
        self._internal = [self._compiled(part.work) for part in self.parts if part.work is not None]
        self._done = 0.0  # by internal forces without a stored energy, since the start (J)
        self._energies = self.energy_forms()
        self._momenta = self._momentum_forms()

    def _parts_of(
        self, material: Material | Sequence[tuple[Material, ufl.Measure]], consistent: bool
    ) -> list[InternalWork]:
        """The parts and their densities."""
        several = isinstance(material, list | tuple)
        listed: Any = material if several else [(material, None)]
        if not listed:
            raise ValueError("material = []: no part has a law or form")
        parts = []
        for k, item in enumerate(listed):
            if several and not (isinstance(item, tuple) and len(item) == 2 and isinstance(item[1], ufl.Measure)):
                raise ValueError(f"material[{k}]: {item!r} is no (law or form, measure)")
            parts.append(
                internal_work(
                    self.u,
                    self.old,
                    item[0],
                    item[1],
                    theta=self.theta,
                    consistent=consistent,
                    thickness=self.thickness,
                    name=f"material[{k}]" if several else "material",
                )
            )
        densities = list(self.density) if isinstance(self.density, list | tuple) else [self.density] * len(parts)
        if len(densities) != len(parts):
            raise ValueError(f"density: {len(densities)} of them for {len(parts)} materials; pass one, or one each")
        self.densities = [positive_or_ufl("density", ρ) for ρ in densities]
        if not isinstance(self.density, list | tuple):
            self.density = self.densities[0]
        self.dx = cell_measure(self.u)
        return parts

    def _check_cover(self) -> None:
        """Every cell must belong to one part: one without mass would have no velocity, one of two parts both masses."""
        count = fem.Function(fem.functionspace(self.u.function_space.mesh, ("DG", 0)))
        one = ufl.TestFunction(count.function_space)
        share = fem.assemble_vector(self._compiled(sum(one * part.dx for part in self.parts))).array
        whole = fem.assemble_vector(self._compiled(one * self.dx)).array
        cells = self.u.function_space.mesh.topology.index_map(self.u.function_space.mesh.topology.dim).size_local
        times = np.round(share[:cells] / whole[:cells]).astype(int)
        comm = self.u.function_space.mesh.comm
        none, twice = comm.allreduce(np.array([np.sum(times == 0), np.sum(times > 1)]))
        if none or twice:
            raise ValueError(
                f"material: {none} cells belong to no part and {twice} to several; give each cell to one of the measures"
            )

    def _per_mass(self, quantity: Any) -> Any:
        """∫ ρ h quantity over all parts, as a form."""
        parts = zip(self.parts, self.densities, strict=True)
        return sum(part.depth * ρ * quantity * part.dx for part, ρ in parts)

    @property
    def width(self) -> Any:
        """Out of the plane (m), as contact counts it: a membrane's own thickness is not that."""
        membrane = self.u.function_space.mesh.topology.dim < len(self.u)
        return 1.0 if membrane else self.thickness

    @property
    def has_forms(self) -> bool:
        """Whether a part's forces come from a form, which may hold loads."""
        return bool(self._internal)

    def new_velocity(self) -> Any:
        """𝐯_{n+1} (m/s) as UFL of 𝐮_{n+1}, 𝐮_n and 𝐯_n."""
        return (self.u - self.old) / (self.theta * self.time_step) - (1 - self.theta) / self.theta * self.velocity

    def energy_forms(self, dx: ufl.Measure | None = None) -> tuple[Any, Any]:
        """Kinetic and strain energy (J) at the last accepted step as compiled forms, over all cells or those of `dx`: of one
        material any, of several those of a part. Without a stored energy the strain energy is left out.

        Raises:
            ValueError: on cells that are those of none of several parts.
        """
        pairs = list(zip(self.parts, self.densities, strict=True))
        if dx is not None:
            dx = cell_measure(self.u, dx)
            pairs = [(part, ρ) for part, ρ in pairs if len(pairs) == 1 or part.dx == dx]
            if not pairs:
                raise ValueError(f"dx = {dx}: not the measure of one of the {len(self.parts)} materials")
        v, zero = self.velocity, fem.Constant(self.u.function_space.mesh, 0.0)
        kinetic = sum(part.depth * ρ / 2 * ufl.inner(v, v) * (dx or part.dx) for part, ρ in pairs)
        strain = sum((zero if part.energy is None else part.energy) * (dx or part.dx) for part, _ in pairs)
        return self._compiled(kinetic), self._compiled(strain)

    def _momentum_forms(self) -> list[Any]:
        d = len(self.u)
        x, v = ufl.SpatialCoordinate(self.u.function_space.mesh) + self.old, self.velocity
        spin = [x[0] * v[1] - x[1] * v[0]] if d == 2 else list(ufl.cross(x, v))
        return [self._compiled(self._per_mass(c)) for c in (*v, *spin)]

    def _compiled(self, form: Any) -> fem.Form:
        return fem.form(whole_form(form, self.u.function_space.mesh))

    def integral(self, form: Any) -> float:
        """Value of a compiled scalar form (collective)."""
        return float(self.u.function_space.mesh.comm.allreduce(fem.assemble_scalar(form)))

    def energies(self) -> tuple[float, float]:
        """Kinetic and strain energy (J), with the work of internal forces that have no stored energy (collective)."""
        kinetic, strain = self._energies
        return self.integral(kinetic), self.integral(strain) + self._done

    def kinetic_energy(self) -> float:
        """Kinetic energy (J), collective."""
        return self.integral(self._energies[0])

    @cached_property
    def mass(self) -> float:
        """Mass (kg), collective."""
        one = fem.Constant(self.u.function_space.mesh, 1.0)
        return self.integral(self._compiled(self._per_mass(one)))

    @cached_property
    def mass_form(self) -> fem.Form:
        """The mass (kg) as a compiled bilinear form."""
        V = self.u.function_space
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        return self._compiled(self._per_mass(ufl.inner(u, v)))

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
        """The step has converged: 𝐯_n ← 𝐯_{n+1}, 𝐮_n ← 𝐮_{n+1} (collective)."""
        self._done += sum(self.integral(form) for form in self._internal)
        new = (self.u.x.array - self.old.x.array) / (self.theta * self.time_step.value)
        self.velocity.x.array[:] = new - (1 - self.theta) / self.theta * self.velocity.x.array
        self.old.x.array[:] = self.u.x.array

    def undo(self) -> None:
        """Undo a step: 𝐮 ← 𝐮_n."""
        self.u.x.array[:] = self.old.x.array

    def snapshot(self) -> dict[str, Array]:
        """𝐮_n and 𝐯_n on this rank, ghosts included, and the work of internal forces without a stored energy (1,)."""
        fields = {"old": self.old.x.array.copy(), "velocity": self.velocity.x.array.copy()}
        return fields | {"work": np.array([self._done])}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        self.old.x.array[:], self.velocity.x.array[:] = saved["old"], saved["velocity"]
        self._done = float(saved["work"][0])
