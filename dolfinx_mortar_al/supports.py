"""What supports that move put into bodies in motion: what they bear, times their way."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import any_over, sum_over

__all__ = ["Supports"]

Array = NDArray[np.float64]

INSTANT = 1e-3  # of a step: a way is a line there, and what is left of its curvature a millionth
FASTER = 2.0  # than in the mean over a step: a quarter of a swing begins with π/2 times it
JUMPS = 1.5  # times the mean velocity over twice the time: it is halved after a jump, and the same or more without


class Supports:
    """The prescribed components of a problem made of motions (collective, as all of its methods).

    Attributes:
        held: (owned dofs,) which they are.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self._problem, self._motions = problem, problem.motions
        self.held = problem.bodies.prescribed()

    def begin(self, move: Callable[[float], None], time: float, Δt: float) -> None:
        """Give prescribed components the velocity with which `move` begins to move them at `time`: with another one the
        mid-point rule, whose mean velocity is that of their way, would swing about it from step to step for ever. It is found
        by differences over a small part of the step; a way that begins with a jump, or a velocity that is not one of the
        step, has none."""
        problem, ε = self._problem, INSTANT * Δt
        if not any_over(problem.comm, self.held.any()):
            return
        at = []
        for t in (time, time + ε, time + 2 * ε, time + Δt):
            move(t)
            at.append(problem.bodies.unmet())
        move(time)
        near, far, mean = (at[0] - at[1]) / ε, (at[0] - at[2]) / (2 * ε), (at[0] - at[3]) / Δt
        squares = sum_over(problem.comm, np.array([near @ near, far @ far, mean @ mean]))
        if squares[0] > JUMPS**2 * squares[1] or squares[0] > FASTER**2 * squares[2]:
            return
        fields = [motion.velocity for motion in self._motions]
        problem.bodies.spread(np.where(self.held, 2 * near - far, problem.bodies.owned(fields)), fields)

    def work_in_step(self) -> float:
        """In the step last solved for (J): its mean forces, inertia and contact included, times the way from 𝐮_n to
        𝐮_{n+1}."""
        problem = self._problem
        way = problem.bodies.owned([m.u for m in self._motions]) - problem.bodies.owned([m.old for m in self._motions])
        if not any_over(problem.comm, (way[self.held] != 0.0).any()):
            return 0.0
        forces = np.concatenate(problem.support_forces())
        return sum_over(problem.comm, float(forces[self.held] @ way[self.held]))

    def work_in_projection(self, δv: Array) -> float:
        """As velocities change by δ𝐯 (owned dofs,), zero in prescribed components, but not what holds them to that (J):
        𝐯·𝐌 δ𝐯 over these components of 𝐯."""
        problem = self._problem
        v = np.where(self.held, problem.bodies.owned([m.velocity for m in self._motions]), 0.0)
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
