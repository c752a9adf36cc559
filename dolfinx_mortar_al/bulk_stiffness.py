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
from dolfinx_mortar_al.reductions import sum_over

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
    """

    def __init__(self, bodies: Bodies, pairs: Sequence[ContactPair], diagonals: Sequence[fem.Function]) -> None:
        self._bodies, self._pairs = bodies, pairs
        self._diameters = bodies.diameters()
        self.firmness = bodies.stiffest(diagonals) * self._diameters
        for pair in pairs:
            pair.set_stiffness(bodies.yielding(diagonals))
        self._given = self._sizes()

    def follow(self) -> None:
        """Measure again what numbers and fields of the forms may have changed, if any is FAR from what it was when that was
        done last (collective). Loads are among them, and cost an assembly at each such change."""
        now = self._sizes()
        if not np.any(_far(now, self._given)):
            return
        self._given, diagonals = now, self._bodies.diagonals()
        firmness = self._bodies.stiffest(diagonals) * self._diameters
        self.firmness = np.where(_far(firmness, self.firmness), firmness, self.firmness)
        yielding = self._bodies.yielding(diagonals)
        for pair in self._pairs:
            measured = pair.measured_stiffnesses(yielding)
            if np.any(_far(np.array(measured), np.array(pair.stiffnesses))):
                pair.take_stiffnesses(measured)

    def _sizes(self) -> Array:
        """Magnitudes of the numbers of all forms, and sums of those of the fields' values (collective)."""
        numbers = [np.ravel(c.value) for body in self._bodies.bodies for c in body.constants]
        fields = [f for body in self._bodies.bodies for f in body.fields]
        sums = np.array([np.abs(f.x.array[: _owned(f)]).sum() for f in fields])
        sums = sum_over(self._bodies.comm, sums) if fields else sums
        return np.abs(np.concatenate([np.zeros(0), *numbers, sums]))

    def snapshot(self) -> dict[str, Array]:
        """Copies of what has been measured, and when."""
        stiffnesses = np.array([pair.stiffnesses for pair in self._pairs])
        return {"given": self._given.copy(), "firmness": self.firmness.copy(), "stiffnesses": stiffnesses}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        self._given, self.firmness = saved["given"].copy(), saved["firmness"].copy()
        for k, pair in enumerate(self._pairs):
            stiffnesses = float(saved["stiffnesses"][k, 0]), float(saved["stiffnesses"][k, 1])
            if pair.stiffnesses != stiffnesses:
                pair.take_stiffnesses(stiffnesses)


def _owned(field: fem.Function) -> int:
    dofs = field.function_space.dofmap
    return int(dofs.index_map.size_local * dofs.index_map_bs)


def _far(now: Array, then: Array) -> NDArray[np.bool_]:
    return np.asarray((now > FAR * then) | (then > FAR * now))
