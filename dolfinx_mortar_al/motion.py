"""A body in motion: its mass, velocity and the residual of a time step (``docs/impact.md``)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.body import Body, Material
from dolfinx_mortar_al.compiling import compiled
from dolfinx_mortar_al.internal_work import TRAPEZOIDAL, WORK, internal_work
from dolfinx_mortar_al.materials import cell_measure
from dolfinx_mortar_al.reductions import any_over, sum_over
from dolfinx_mortar_al.validation import check_dead, check_scalar, number

__all__ = ["Motion"]

Array = NDArray[np.float64]


class Motion:
    """A body in motion: its mass, velocity and the mid-step residual, for a ContactProblem.

    Args:
        u: the :class:`~dolfinx_mortar_al.body.Body`, which says all but the scheme; or its displacement (m), at the start
            state, with what follows in the words of a Body.
        material, density, thickness, external: as of a Body; loads must be dead. Those that `move` changes act with the mean
            of their values at both ends of a step (weighted with θ), of second order in Δt.
        step: Δt (s), the longest that will be used. A Constant in place of a number is one that forms may hold: a march
            sets it to the Δt of each trial, and back at its end.
        theta: θ of the scheme, 1/2 ≤ θ ≤ 1; anything but 1/2 dissipates.
        force: "consistent", whose energy balance is exact with θ = 1/2 and which loses some with a larger one, or
            "trapezoidal", θ-weighted end forces, which a form has in any case.
        old: of forms that hold the displacement of the last step, the Function of u's space that they hold: rates are
            ``(u - old) / Δt``. The motion keeps it; a form without it has a Function of the motion's own.

    Attributes:
        body: the Body.
        residual: UFL form of the step, which :class:`~dolfinx_mortar_al.problem.ContactProblem` takes from the motion.
        velocity: 𝐯_n (m/s), a Function to interpolate the initial velocity into.
        old: 𝐮_n (m).
        time_step: Δt (s) of the next step, a Constant; a number may be assigned between marches.
        known: how the ledger knows the strain energy, in words.

    Raises:
        ValueError: on every rank: a step, θ or force out of range, no density, a load that depends on u, an `old` that no
            form holds or that is not of u's space, what a Body refuses, or what a Body says said again.
    """

    def __init__(
        self,
        u: fem.Function | Body,
        material: Material | Sequence[tuple[Material, ufl.Measure]] | None = None,
        *,
        density: Any = None,
        step: float | fem.Constant,
        theta: float = 0.5,
        force: str = "consistent",
        thickness: Any = None,
        external: Any = None,
        old: fem.Function | None = None,
    ) -> None:
        self.body = body = _body_of(u, material=material, density=density, thickness=thickness, external=external)
        self._time_step = _time_step_of(step, body.u)
        self.theta = theta = number("theta", theta, least=0.5, most=1.0, must="θ must be")
        if not isinstance(force, str) or force not in ("consistent", "trapezoidal"):
            raise ValueError(f'force = "{force}": "consistent" or "trapezoidal"')
        check_dead(body.external, body.u)
        if any(part.density is None for part in body.parts):
            raise ValueError("density = None: a body in motion has a mass; pass ρ (kg/m³)")
        self.u, self.dx, self.bcs, self.external = body.u, body.dx, body.bcs, body.external
        self.density, self.thickness, self.width = body.density, body.thickness, body.width
        V = self.u.function_space
        self.old, self.velocity = _old_of(body, old), fem.Function(V, name="velocity")
        self.works = [
            internal_work(part, self.u, self.old, theta=theta, consistent=force == "consistent") for part in body.parts
        ]
        self.known = "; ".join(dict.fromkeys(work.known for work in self.works))
        w = ufl.TestFunction(V)
        rate = (self.new_velocity() - self.velocity) / self.time_step
        self.residual = self._per_mass(ufl.inner(rate, w)) + sum(work.form for work in self.works)
        # Constants and Functions of the loads, and the like with their values at the step's start
        self._twins: list[tuple[Any, Any]] = []
        mean = None if self.external is None else self._mean_of_loads(self.external)
        if mean is not None:
            self.residual -= mean
        loads = None if mean is None else ufl.replace(mean, {w: self.u - self.old})
        self._external_work = None if loads is None else self._compiled(loads)
        self._internal = [self._compiled(work.work) for work in self.works if work.work is not None]
        self._others = self._of_same_space()
        self._begun = self.old.x.array.copy()  # 𝐮 at the start of a march
        self._mean_velocity: Array | None = None  # over the last step (m/s)
        self._done = 0.0  # by internal forces without a stored energy, since the start (J)
        self._energies = self.energy_forms()
        self._momenta = self._momentum_forms()

    def __setattr__(self, name: str, value: Any) -> None:
        """Forms hold the Functions of a motion: another in the place of one would be known to the ledger alone."""
        if name in ("u", "old", "velocity") and name in self.__dict__:
            raise AttributeError(
                f"{name}: the step's form holds this Function; write into it, motion.{name}.interpolate(…) or "
                f"motion.{name}.x.array[:] = …"
            )
        super().__setattr__(name, value)

    @property
    def time_step(self) -> fem.Constant:
        """Δt (s) of the next step; a number may be assigned between marches, which becomes the Constant's value."""
        return self._time_step

    @time_step.setter
    def time_step(self, step: float) -> None:
        self._time_step.value = number("time_step", step, above=0.0)

    def _mean_of_loads(self, external: ufl.Form) -> ufl.Form:
        """The virtual work of loads with the θ-weighted values over the step of all that they depend on."""
        for c in external.constants():
            self._twins.append((c, fem.Constant(self.u.function_space.mesh, np.array(c.value))))
        for f in external.coefficients():
            self._twins.append((f, f.copy()))
        return ufl.replace(external, {now: (1 - self.theta) * last + self.theta * now for now, last in self._twins})

    def begin_loads(self) -> None:
        """Loads stand as they are at the start of the step."""
        for now, last in self._twins:
            if isinstance(now, fem.Function):
                last.x.array[:] = now.x.array
            else:
                last.value = now.value

    def _per_mass(self, quantity: Any) -> Any:
        """∫ ρ h quantity over all parts, as a form."""
        return sum(part.depth * part.density * quantity * part.dx for part in self.body.parts)

    def _of_same_space(self) -> list[fem.Function]:
        """The Functions of u's space in forms, other than u and old."""
        forms = [part.material for part in self.body.parts if isinstance(part.material, ufl.Form)]
        fields = dict.fromkeys(field for form in forms for field in form.coefficients())
        known = (self.u, self.old)
        return [f for f in fields if f not in known and f.ufl_function_space() == self.u.function_space]

    @property
    def densities(self) -> list[Any]:
        """ρ of each part (kg/m³)."""
        return [part.density for part in self.body.parts]

    @property
    def has_forms(self) -> bool:
        """Whether a part's forces come from a form, which may hold loads."""
        return bool(self._internal)

    @property
    def has_weighted_forces(self) -> bool:
        """Whether a part's forces over a step do another work than the ledger books as strain energy."""
        known = {work.known for work in self.works}
        return TRAPEZOIDAL in known or (WORK in known and self.theta != 0.5)

    def new_velocity(self) -> Any:
        """𝐯_{n+1} (m/s) as UFL of 𝐮_{n+1}, 𝐮_n and 𝐯_n."""
        return (self.u - self.old) / (self.theta * self.time_step) - (1 - self.theta) / self.theta * self.velocity

    def energy_forms(self, dx: ufl.Measure | None = None) -> tuple[Any, Any]:
        """Kinetic and strain energy (J) at the last accepted step as compiled forms, over all cells or those of `dx`: of one
        material any, of several those of a part. Without a stored energy the strain energy is left out.

        Raises:
            ValueError: on cells that are those of none of several parts.
        """
        pairs = list(zip(self.body.parts, self.works, strict=True))
        if dx is not None:
            dx = cell_measure(self.u, dx)
            pairs = [(part, work) for part, work in pairs if len(pairs) == 1 or part.dx == dx]
            if not pairs:
                raise ValueError(f"dx = {dx}: not the measure of one of the {len(self.body.parts)} materials")
        v, zero = self.velocity, fem.Constant(self.u.function_space.mesh, 0.0)
        kinetic = sum(part.depth * part.density / 2 * ufl.inner(v, v) * (dx or part.dx) for part, _ in pairs)
        strain = sum((zero if work.energy is None else work.energy) * (dx or part.dx) for part, work in pairs)
        return self._compiled(kinetic), self._compiled(strain)

    def _momentum_forms(self) -> list[Any]:
        d = len(self.u)
        x, v = ufl.SpatialCoordinate(self.u.function_space.mesh) + self.old, self.velocity
        spin = [x[0] * v[1] - x[1] * v[0]] if d == 2 else list(ufl.cross(x, v))
        return [self._compiled(self._per_mass(c)) for c in (*v, *spin)]

    def _compiled(self, form: Any) -> fem.Form:
        return compiled(form, self.u.function_space.mesh)

    def integral(self, form: Any) -> float:
        """Value of a scalar form, of UFL or compiled (collective)."""
        scalar = form if isinstance(form, fem.Form) else self._compiled(form)
        return sum_over(self.u.function_space.mesh.comm, fem.assemble_scalar(scalar))

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

    def mass_product(self, v: fem.Function, w: fem.Function) -> fem.Form:
        """∫ ρ 𝐯·𝐰 as a compiled form."""
        return self._compiled(self._per_mass(ufl.inner(v, w)))

    def momenta(self) -> Array:
        """Momentum (N s, gdim) and angular momentum about the origin (N m s, 1 or 3), collective."""
        return np.array([self.integral(form) for form in self._momenta])

    def external_work(self) -> float:
        """Work of the dead loads in the present step (J), collective."""
        return 0.0 if self._external_work is None else self.integral(self._external_work)

    def take_up(self) -> None:
        """𝐮_n ← 𝐮: a march begins where the body has been put (collective)."""
        self.u.x.scatter_forward()
        self.old.x.array[:] = self.u.x.array
        self._begun = self.old.x.array.copy()
        self._mean_velocity = None

    def copies(self) -> int:
        """How many Functions in forms, other than `old`, have followed 𝐮_n since the march began (collective)."""
        comm, now = self.u.function_space.mesh.comm, self.old.x.array
        if not self._others or not any_over(comm, not np.array_equal(now, self._begun)):
            return 0
        return sum(not any_over(comm, not np.array_equal(f.x.array, now)) for f in self._others)

    def fly(self, share: float) -> None:
        """𝐮 ← 𝐮_n + share × Δt 𝐯_n, where a body is without forces after a share of the step: in the middle the step's points
        and directions are chosen first."""
        self.u.x.array[:] = self.old.x.array + share * self.time_step.value * self.velocity.x.array

    def go_on(self) -> None:
        """𝐮 ← 𝐮_n + Δt × the mean velocity over the last step, in which stiff vibrations are gone that 𝐯_n has, to and fro
        from step to step; at the start 𝐯_n."""
        velocity = self.velocity.x.array if self._mean_velocity is None else self._mean_velocity
        self.u.x.array[:] = self.old.x.array + self.time_step.value * velocity

    def accept(self) -> None:
        """The step has converged: 𝐯_n ← 𝐯_{n+1}, 𝐮_n ← 𝐮_{n+1} (collective)."""
        self._mean_velocity = (self.u.x.array - self.old.x.array) / self.time_step.value
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


def _time_step_of(step: float | fem.Constant, u: fem.Function) -> fem.Constant:
    """Δt (s) as a Constant, which is the user's own if `step` is one."""
    given = step if isinstance(step, fem.Constant) else None
    Δt = number("step", step if given is None else given.value, above=0.0, must="Δt (s) must be")
    if given is None:
        return fem.Constant(u.function_space.mesh, Δt)
    check_scalar("step", given)
    return given


def _old_of(body: Body, old: fem.Function | None) -> fem.Function:
    """The Function for 𝐮_n, with the values of u."""
    if old is None:
        return body.u.copy()
    if not isinstance(old, fem.Function) or old is body.u or old.function_space != body.u.function_space:
        raise ValueError(f"old = {old}: pass the Function of u's space, other than u, that the forms hold")
    if not any(isinstance(part.material, ufl.Form) and old in part.material.coefficients() for part in body.parts):
        raise ValueError(
            f"old = {old}: no form of the body holds it; leave it out, or, where the number 0 multiplies it and UFL drops "
            "it, make that a Constant"
        )
    old.x.array[:] = body.u.x.array
    return old


def _body_of(u: fem.Function | Body, **said: Any) -> Body:
    """The Body, or one of what is said of it."""
    given = {name: value for name, value in said.items() if value is not None}
    if not isinstance(u, Body):
        return Body(u, given.pop("material", None), **given)
    if given:
        raise ValueError(f"{next(iter(given))}: the Body says it; leave it out here")
    return u
