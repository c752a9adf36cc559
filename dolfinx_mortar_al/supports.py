"""What supports that move put into bodies in motion: what they bear, times their way."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import any_over, sum_over

__all__ = ["Supports"]

Array = NDArray[np.float64]


class Supports:
    """The prescribed components of a problem made of motions (collective, as all of its methods)."""

    def __init__(self, problem: ContactProblem) -> None:
        self._problem, self._motions = problem, problem.motions
        self._held = problem.bodies.prescribed()

    def work_in_step(self) -> float:
        """In the step last solved for (J): its mean forces, inertia and contact included, times the way from 𝐮_n to
        𝐮_{n+1}."""
        problem = self._problem
        way = problem.bodies.owned([m.u for m in self._motions]) - problem.bodies.owned([m.old for m in self._motions])
        if not any_over(problem.comm, (way[self._held] != 0.0).any()):
            return 0.0
        forces = np.concatenate(problem.support_forces())
        return sum_over(problem.comm, float(forces[self._held] @ way[self._held]))

    def work_in_projection(self, δv: Array) -> float:
        """As velocities change by δ𝐯 (owned dofs,), zero in prescribed components, but not what holds them to that (J):
        𝐯·𝐌 δ𝐯 over these components of 𝐯."""
        problem = self._problem
        v = np.where(self._held, problem.bodies.owned([m.velocity for m in self._motions]), 0.0)
        if not any_over(problem.comm, (v != 0.0).any()):
            return 0.0
        held, change, products = self._mass
        problem.bodies.spread(v, held)
        problem.bodies.spread(δv, change)
        return sum_over(problem.comm, sum(float(fem.assemble_scalar(product)) for product in products))

    @cached_property
    def _mass(self) -> tuple[list[fem.Function], list[fem.Function], list[fem.Form]]:
        """Two Functions of each body, and their products with its mass as forms."""
        held, change = ([fem.Function(m.u.function_space) for m in self._motions] for _ in range(2))
        fields = zip(self._motions, held, change, strict=True)
        return held, change, [motion.mass_product(*pair) for motion, *pair in fields]
