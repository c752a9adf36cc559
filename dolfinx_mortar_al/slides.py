"""Tied pieces in a solve: where they go from a state that has converged, or whether it is an equilibrium (docs/newton.md).

When Newton has converged, pieces that :mod:`~dolfinx_mortar_al.ties` hold are tied to where they are then, or to the next of
their :mod:`~dolfinx_mortar_al.places`, until something resists the slide and ties bear nothing, or until they bear the same
as before, little enough, and neither a load pushes the pieces nor friction drags them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.places import Places
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.problem_findings import TOLD
from dolfinx_mortar_al.ties import PUSHED, Bearing

__all__ = ["Slides"]

Array = NDArray[np.float64]

PUSHED_ALONG = 1e-3  # as PUSHED, along surfaces with friction: a tie is not to bear what friction does not
SLIDES = 0.1  # of the contact forces: what is left of a coarse mesh's pressures along a slide is less
MAX_MOVES = 20  # places that a sliding piece is tied to while its tie bears no less than HALVED of the least so far
HALVED = 0.5


class Slides:
    """The slides of a solve.

    Args:
        problem: to solve.
        response: the displacements that nodal forces lead to, by the Jacobian of the last iteration.
        rtol: of the solve, which ties may bear of the contact forces.
        longest: way to the next place (target facets).
        may_trust: whether the elasticity of bodies may be trusted in place of ties, once.

    Attributes:
        has_trusted: whether that has been done.
    """

    def __init__(
        self,
        problem: ContactProblem,
        response: Callable[[Array], Array],
        rtol: float,
        *,
        longest: float,
        may_trust: bool,
    ) -> None:
        self._problem, self._response, self._rtol, self._may_trust = problem, response, rtol, may_trust
        self.has_trusted = False
        self._moves, self._least_borne, self._places = 0.0, np.inf, Places(longest)

    @property
    def lead_nowhere(self) -> bool:
        """Whether so many places have been tried that nothing seems to resist a slide."""
        return self._moves > MAX_MOVES

    def forget(self) -> None:
        """What ties bore was in another state of contact."""
        self._places.forget()

    def go_on(self, f: PETSc.Vec, *, measures: bool) -> bool:
        """From a state that has converged: False if it is an equilibrium; else pieces are tied elsewhere, and f, the
        residual, is brought up to date. Where it `measures`, the response is that in this state (collective)."""
        p, ties, places = self._problem, self._problem.ties, self._places
        if ties is None or not ties.acts:
            return False
        bear = p.ties_bear()
        driven, bearable = self._bearable(bear)
        resisted, little = places.resist(bear, self._length), bool(np.all(bear.borne <= bearable))
        on = places.follow(bear, bear.rubs & ~driven, p.dragged, self._length, first=resisted) if little else None
        borne = float(bear.borne.max())
        accepted = borne <= self._rtol or (on is None and not resisted and little)
        if accepted and not self._trusts_elasticity(borne, measures=measures):
            ties.borne = bear.share
            return False
        if not accepted and not resisted:  # what one side alone presses on is pushed away from it, along its surface
            ties.let_be |= bear.alone & bear.rubs
        softer = not accepted and on is None and self._softens(bear, bearable, resisted)
        if accepted or softer:
            places.forget()
            on = bear.along
        elif on is None:
            on = places.onwards(bear, resisted, self._length)
        if measures and not accepted:
            p.measure_ties(self._response)
        if p.move_ties(f, bear.along - on, softer=softer):
            places.forget()
        self._count(borne)
        return True

    def _length(self, forces: Array) -> float:
        """How far pieces go whose ties bear so much more (target facets)."""
        assert self._problem.ties is not None
        return self._problem.longest_motion(self._problem.ties.motion(forces))

    def _bearable(self, bear: Bearing) -> tuple[NDArray[np.bool_], Array]:
        """(pieces,) whether a load pushes them, and the share that a tie may bear: an error of the mesh, but nothing that a
        load pushes with and friction does not bear."""
        driven = bear.pushed > np.where(bear.rubs, PUSHED_ALONG, PUSHED)
        return driven, np.where(driven, np.where(bear.rubs, self._rtol, PUSHED), SLIDES)

    def _softens(self, bear: Bearing, bearable: Array, resisted: bool) -> bool:
        """Whether ties are to be softer from now on: a load pushes pieces against others, and nothing has resisted."""
        assert self._problem.ties is not None
        pushed = (bear.pushed > PUSHED) & (bear.pushed < 1.0) & (bear.borne > bearable)
        return (not resisted or self._problem.ties.softness < 1.0) and bool(np.any(pushed))

    def _count(self, borne: float) -> None:
        """Count a place at which ties bear so much; on the way to a first contact there may be twice as many."""
        if borne <= HALVED * self._least_borne:
            self._moves, self._least_borne = 0.0, borne
        self._moves += 1.0 if self._problem.is_pressed() else 0.5

    def _trusts_elasticity(self, borne: float, *, measures: bool) -> bool:
        """Whether ties that bear so much are let go in a state that would be accepted, as bodies deform along them and
        resist: asked once in a solve, where it is more than is left unsaid."""
        p, ties = self._problem, self._problem.ties
        if ties is None or not self._may_trust or borne <= TOLD:
            return False
        self._may_trust = False
        if measures:
            p.measure_ties(self._response)
        self.has_trusted = ties.elastic_ones()
        ties.trusts[:] |= self.has_trusted
        return self.has_trusted
