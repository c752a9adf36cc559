"""Places that sliding pieces are tied to, one after the other: where their ties bear nothing (``docs/newton.md``).

What ties bear is a function of where they are tied to, and Newton's method for the bodies gives one value of it at each
place. As long as it is linear, what the ties bore at the last places says where they bear nothing: Anderson's method (J. ACM
12, 1965, doi:10.1145/321296.321305) remembers one for each piece that its tie holds. With one piece that is the secant.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.ties import Bearing

__all__ = ["Places"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

HELD = 0.9  # share of what a tie bore, of which it bears less at the next place where something resists the slide
SOFTLY = 0.995  # that share at the next place where nothing resists but how the pressures of meshes differ,
NOISE = 0.01  # of the contact forces, as which they push where no load does
LINEAR = 1e-6  # share of the largest singular value below which differences of forces are round-off


class Places:
    """The places of a solve.

    Args:
        longest: way to the next place (target facets).
    """

    def __init__(self, longest: float) -> None:
        self._longest, self._followed = longest, False
        self.forget()

    def forget(self) -> None:
        """Other motions are tied: start anew."""
        self._forces: list[Array] = []
        self._moves: list[Array] = []
        self._stride = 0.0

    def resist(self, bear: Bearing, length: Callable[[Array], float]) -> bool:
        """Whether something resists the slide: the ties bear less than at the last place, if there was one, or so little
        less that the first places, one for each piece, say that they bear nothing at one within reach. `length` is that of
        a way in target facets."""
        if not self._forces:
            return True
        weights = self._weights(bear)
        now, before = bear.along * weights, self._forces[-1] * weights
        left = float(np.sum(now * before) / max(np.sum(before**2), 1e-300))
        if left < HELD:
            return True
        softly = (left < SOFTLY) & (bear.borne > np.where(bear.pushed > bear.borne, 0.0, NOISE))
        on = self._balanced(bear, weights)
        known = len(self._forces) <= self._unknowns(bear)
        return bool(known and softly.any() and np.sum(weights * on * now) > 0.0 and length(on) <= self._longest)

    @staticmethod
    def _weights(bear: Bearing) -> Array:
        """(pieces, 1) that make forces shares of the largest ones on each piece that bears something; where next to nothing
        presses it, of the tie's own."""
        largest = np.maximum(bear.most, np.linalg.norm(bear.along, axis=1))
        return np.where(bear.borne > 0.0, 1.0 / largest, 0.0)[:, None]

    def onwards(self, bear: Bearing, resisted: bool, length: Callable[[Array], float]) -> Array:
        """How far on to tie the pieces: by as much as would make the ties bear so much more, (pieces, motions) in N. It is
        to where they should bear nothing or, where that is too far or backwards for a piece and nothing has resisted, twice
        as far each time. `length` is that of a way in target facets."""
        f = on = bear.along
        if self._forces:
            weights = self._weights(bear)
            on = self._balanced(bear, weights)
            work = np.sum(weights**2 * on * f, axis=1)
            forwards = float(work.sum()) > 0.0
            if not resisted and not (np.all(work >= 0.0) and forwards and length(on) <= self._longest):
                self._stride = 2.0 * self._stride + 1.0
                on = (1.0 + self._stride) * f
            elif not forwards:
                on = f
        on = on * min(1.0, self._longest / max(length(on), 1e-300))
        self._forces.append(f)
        self._moves.append(on)
        return on

    @staticmethod
    def _unknowns(bear: Bearing) -> int:
        """One for each piece that its tie holds, but no more than there are ties."""
        return min(int(np.count_nonzero(bear.borne > 0.0)), bear.ties)

    def follow(
        self,
        bear: Bearing,
        along: Flags,
        dragged: Callable[[], Array],
        length: Callable[[Array], float],
        *,
        first: bool,
    ) -> Array | None:
        """How far on to tie those of the pieces `along` (pieces,) that friction drags, farther than their ties have given
        way: to where it will have `dragged` them, (pieces, motions) in N. None if there are none, or if this is to be the
        `first` time and is not."""
        if first and self._followed:
            return None
        f, along = bear.along, along & (bear.borne > NOISE)
        if not along.any():
            return None
        way = dragged()
        farther = along & (np.sum(way * f, axis=1) > np.sum(f**2, axis=1))
        if not farther.any():
            return None
        self.forget()
        self._followed = True
        on = f + np.where(farther[:, None], way, 0.0)
        return np.asarray(on * min(1.0, self._longest / max(length(on), 1e-300)))

    def _balanced(self, bear: Bearing, weights: Array) -> Array:
        """The way to where forces that are linear would vanish, Picard's for what the places so far say nothing of."""
        f, most = bear.along, self._unknowns(bear)
        forces = [*self._forces, f]
        Δf = np.diff(forces, axis=0)[-most:].reshape(-1, f.size).T
        Δa = np.array(self._moves)[-most:].reshape(-1, f.size).T
        w = np.broadcast_to(weights, f.shape).ravel()
        γ = np.linalg.lstsq(w[:, None] * Δf, w * f.ravel(), rcond=LINEAR)[0]
        return np.asarray((f.ravel() - Δf @ γ - Δa @ γ).reshape(f.shape))
