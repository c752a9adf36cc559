"""Reactions: what a support, or whatever prescribes displacements, bears."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import BodyForms
from dolfinx_mortar_al.problem import ContactProblem, check_problem
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.reductions import sum_over
from dolfinx_mortar_al.surface import Facets, Surface
from dolfinx_mortar_al.validation import vector

__all__ = ["Reaction", "reaction"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reaction:
    """What a support does to the bodies: force (gdim,) in N, and moment in N m (3 components, or 1 in the plane)."""

    force: Array
    moment: Array


def reaction(
    problem: ContactProblem, at: fem.DirichletBC | Surface, *, about: Sequence[float] | None = None
) -> Reaction:
    """The force and moment with which a support holds the bodies, in the state last solved for: the sum of the
    residual, contact included, over what the support prescribes. With the loads and inertia forces are in equilibrium, and
    moments but for friction's across the gaps that the mesh leaves (``docs/results.md``) (collective).

    In dynamics it is the mean over the last time step; what the projection of velocities adds at its end is left out.

    Args:
        problem: the problem.
        at: a Dirichlet condition of the problem, or a surface, which stands for all that is prescribed on it.
        about: point of the moment (m), default the origin; nodes are where they have moved to.

    Raises:
        ValueError: on every rank: a condition that is none of the problem's, a surface on which nothing is prescribed, what
            is neither, or another `at` on some ranks.
    """
    check_problem(problem)
    agreed(problem.comm, "at", _words(problem, at))
    d = problem.gdim
    origin = np.zeros(d) if about is None else vector("about", about, d)
    if isinstance(at, fem.DirichletBC):
        body, held = _of_condition(problem, at)
    elif isinstance(at, Surface):
        body, held = _of_surface(problem, at)
    else:
        raise ValueError(f"at: {type(at).__name__} is neither a Dirichlet condition nor a Surface")
    k = problem.bodies.bodies.index(body)
    R = (problem.support_forces()[k] * held).reshape(-1, d)
    arm = body.positions() - origin
    spin = arm[:, 0] * R[:, 1] - arm[:, 1] * R[:, 0] if d == 2 else np.cross(arm, R)
    total = sum_over(problem.comm, np.concatenate([R.sum(axis=0), np.atleast_1d(spin.sum(axis=0))]))
    return Reaction(total[:d], total[d:])


def _words(problem: ContactProblem, at: fem.DirichletBC | Surface) -> str:
    """What a support is, alike on all ranks."""
    for k, body in enumerate(problem.bodies.bodies):
        for j, bc in enumerate(body.bcs):
            if bc is at:
                return f"the Dirichlet condition {j} of u[{k}]"
        if isinstance(at, Surface) and at.mesh is body.mesh:
            return f"the surface of tag {at.tag} of u[{k}]"
    return type(at).__name__


def _of_condition(problem: ContactProblem, bc: fem.DirichletBC) -> tuple[BodyForms, Array]:
    """The body of a condition, and (owned dofs,) 1 at what it prescribes."""
    for body in problem.bodies.bodies:
        if any(bc is own for own in body.bcs):
            held = np.zeros(body.owned * problem.gdim)
            dofs = bc.dof_indices()[0]  # ghosts among them, whose number DOLFINx 0.9 does not know for vectors
            held[dofs[dofs < len(held)]] = 1.0
            return body, held
    raise ValueError("at: the Dirichlet condition is none of the problem's bcs; pass one of these")


def _of_surface(problem: ContactProblem, surface: Surface) -> tuple[BodyForms, Array]:
    """The body of a surface, and (owned dofs,) 1 at what is prescribed on it."""
    body = problem.bodies.bodies[problem.bodies.index(surface.mesh)]
    facets, d = Facets.of(surface, body.space), problem.gdim
    on = fem.Function(body.space)
    on.x.array.reshape(-1, d)[facets.dofs.ravel()] = 1.0
    on.x.scatter_reverse(InsertMode.add)
    n = body.owned * d
    held = np.asarray((on.x.array[:n] > 0) & (body.prescribed().x.array[:n] > 0)).astype(np.float64)
    if sum_over(problem.comm, float(held.sum())) == 0:
        raise ValueError(f"at: nothing is prescribed on the surface of tag {surface.tag}, so that it has no reaction")
    return body, held
