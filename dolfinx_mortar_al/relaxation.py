"""Where bodies go when no equilibrium is near: viscous relaxation (``docs/newton.md``).

A soft block that is dragged bends until it lets go, tips or snaps: at such a limit point the equilibria turn back, and past
it none is near, however short the increment. Bodies then move until they come to rest, and friction follows their way. Here
they do so without inertia, each node slowed by a dashpot of the body's own nodal stiffness k (N/m),

    R(u) + contact + k u̇ = 0,

in implicit Euler steps of length 1/δ: R(u) + contact + δ k (u − uₙ) = 0. With δ = 1 a node is held about as firmly by where
it was as by its neighbours, so that Newton has little to do; each easy step is followed by a longer one, and so is one that
moves the bodies no farther than the step before, as they come to rest. One that fails, or has a fatal finding, such as a
surface that has passed through another, is undone and taken shorter. When steps are so long that dashpots bear next to
nothing, and what falls has come down, the last one is without. If there is no friction it is steepest descent of the energy
in the norm of k: no unstable equilibrium stops it for long.

What has gone farther than all bodies together extend has slid or fallen off, and does not come to rest. Loose bodies that
nothing has held yet come down in the same way onto what they meet, however far that is.
"""

from __future__ import annotations

import numpy as np

from dolfinx_mortar_al.dashpots import Dashpots
from dolfinx_mortar_al.newton import NewtonResult, NewtonSolver
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.stepping import EASY

__all__ = ["relax"]

FIRST = 1.0  # δ of the first step
CHANGE = 4.0  # of δ from step to step
LEAST = 1e-5  # δ below which a step is taken without dashpots; where loose bodies come down
NEAR = 0.01  # only if no larger share of the forces was off balance where the last one began: what falls still goes on
SETTLES = 0.5  # nor, once one has failed, before less is, or bodies move less, than where it began
MOST = 100.0  # δ beyond which it is not for want of time that steps fail
MAX_STEPS = 80  # after which the bodies count as moving on for good


def relax(problem: ContactProblem, solver: NewtonSolver) -> NewtonResult:
    """Let the bodies go on from the present state, with the loads as they are, until they come to rest; what Newton did in
    the last step, with the iterations of all. Where it has not converged they are not at rest, and the caller undoes it
    (collective)."""
    k, δ, iterations = problem.nodal_stiffness(), FIRST, 0
    rests, last = False, -1.0  # how far the last step moved the bodies (m), none so far
    comes_down = problem.is_at_start
    # the share of the forces that was off balance where the last step began, and where the last without dashpots did in vain,
    # with how far the step before that one had moved the bodies (m)
    off, tried, tried_way = 1.0, np.inf, np.inf
    began, farthest = problem.bodies.get(), np.inf if comes_down else problem.bodies.diameter()
    for _ in range(MAX_STEPS):
        before, since = problem.snapshot(), problem.bodies.get()
        settles = off <= SETTLES * tried or 0.0 <= last <= SETTLES * tried_way
        slowed = δ > LEAST or (comes_down and off > NEAR) or not settles
        problem.dashpots = Dashpots(δ * k, since) if slowed else None
        try:
            result = solver.solve()
        finally:
            problem.dashpots = None
        iterations += result.iterations
        rests = result.converged and not slowed
        if rests or δ > MOST:
            break
        if result.converged and not any(finding.fatal for finding in problem.findings()):
            way, _ = problem.bodies.farthest(problem.bodies.get() - since)
            problem.commit()
            if problem.bodies.farthest(problem.bodies.get() - began)[0] > farthest:
                break
            if result.iterations <= EASY or way <= last:
                δ /= CHANGE
            last, off = way, max(result.norms[0]) * solver.rtol
        else:
            problem.restore(before)
            tried, tried_way = (tried, tried_way) if slowed else (off, last)
            δ, last = δ * CHANGE, -1.0
    result.converged, result.iterations = rests, iterations
    return result
