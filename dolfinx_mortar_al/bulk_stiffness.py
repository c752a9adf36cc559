"""What contact knows of the bulk's stiffness, and measures again when the bodies have become others.

ε, what holds multipliers smooth and what counts as round-off are taken from the stiffness in the start state. Moduli that are
Constants or Functions of the forms may change since: a part cures, cools or is damaged. ε that is left behind by two orders
lets partly closed facets overlap (docs/newton.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.reductions import any_over

__all__ = ["BulkStiffness"]

Array = NDArray[np.float64]

FAR = 2.0  # times as much as when it was measured: forces of a coarse block were off by .3 % there (docs/newton.md)


class BulkStiffness:
    """The stiffness of bodies, as their pairs take it.

    Args:
        bodies: at the start.
        pairs: their ε is set.
        diagonals: of the bodies' stiffness at the start (N/m).

    Attributes:
        firmness: (pieces,) largest stiffness times diameter: the size of forces that strain a piece by one (N).
        diameters: (pieces,) of the bodies at the start (m).
    """

    def __init__(self, bodies: Bodies, pairs: Sequence[ContactPair], diagonals: Sequence[fem.Function]) -> None:
        self._bodies, self._pairs, self._start = bodies, pairs, bodies.get()
        self.diameters = bodies.diameters()
        self.firmness = bodies.stiffest(diagonals) * self.diameters
        yielding = bodies.yielding(diagonals)
        for pair in pairs:
            pair.set_stiffness(yielding)
        self._given = self._magnitudes()

    def follow(self) -> None:
        """Measure again what numbers and fields of the forms may have changed, if any is FAR from what it was when that was
        done last (collective). It is done in the start state, lest what bodies do is taken for what they are made of. Loads
        are among the numbers, and cost an assembly at each such change."""
        now = self._magnitudes()
        if not any_over(self._bodies.comm, np.any(_far(now, self._given))):
            return
        self._given, present = now, self._bodies.get()
        self._bodies.set(self._start)
        diagonals = self._bodies.diagonals()
        self._bodies.set(present)
        firmness = self._bodies.stiffest(diagonals) * self.diameters
        self.firmness = np.where(_far(firmness, self.firmness), firmness, self.firmness)
        yielding = self._bodies.yielding(diagonals)
        for pair in self._pairs:
            now = np.array(measured := pair.measured_stiffnesses(yielding))
            if np.all(now > 0) and np.any(_far(now, np.array(pair.augmentation.stiffnesses))):
                pair.take_stiffnesses(measured)

    def _magnitudes(self) -> Array:
        """Of the numbers of all forms, and of this rank's values of fields."""
        numbers = [np.ravel(c.value) for body in self._bodies.bodies for c in body.constants]
        fields = [f.x.array for body in self._bodies.bodies for f in body.fields]
        return np.abs(np.concatenate([np.zeros(0), *numbers, *fields]))

    def snapshot(self) -> dict[str, Array]:
        """What has been measured, and with what; arrays that are replaced, not changed."""
        stiffnesses = np.array([pair.augmentation.stiffnesses for pair in self._pairs])
        return {"given": self._given, "firmness": self.firmness, "stiffnesses": stiffnesses}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        self._given, self.firmness = saved["given"], saved["firmness"]
        for k, pair in enumerate(self._pairs):
            stiffnesses = float(saved["stiffnesses"][k, 0]), float(saved["stiffnesses"][k, 1])
            if pair.augmentation.stiffnesses != stiffnesses:
                pair.take_stiffnesses(stiffnesses)


def _far(now: Array, then: Array) -> NDArray[np.bool_]:
    return np.asarray((now > FAR * then) | (then > FAR * now))
