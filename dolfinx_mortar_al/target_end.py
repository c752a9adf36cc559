"""The target's end, while a solve is on its way: points that were in contact go on facing it where they have slid past it.

Newton's first step of a large increment may carry the contactor's last points past the target's end, though in equilibrium
they are on it. They would face nothing, open, and the solve might end without them, in another equilibrium. So while a solve
is on its way the ray of such a point meets the facet at the end as that goes on beyond its sides. Points that lie there when
Newton is near its end are let go, and the state that is left is one of eq. (1) alone (``docs/newton.md``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.kinematics import Kinematics
from dolfinx_mortar_al.rays import RayHit
from dolfinx_mortar_al.targets import DeformableTarget

__all__ = ["TargetEnd"]

Bool = NDArray[np.bool_]
Index = NDArray[np.int64]


class TargetEnd:
    """Which points a solve holds to the target, and which of them are beyond its end.

    Args:
        target: a surface that is projected onto along rays; n: number of points.
    """

    def __init__(self, target: DeformableTarget, n: int) -> None:
        self._target = target
        self.begin(np.zeros(n, dtype=bool))

    def begin(self, held: Bool) -> None:
        """A new solve: points that are `held` (n,) face the target beyond its end, too."""
        self._held = held
        self._beyond: Index = np.zeros(0, dtype=np.int64)

    def end(self) -> None:
        """No solve is on its way."""
        self.begin(np.zeros_like(self._held))

    def transfer(self, origin: Index) -> None:
        """Other points: each takes over what is known of the former point `origin` (n,)."""
        self.begin(self._held[origin])

    def hold(self, k: Kinematics) -> None:
        """Let held points that face nothing in the present state go on facing the target."""
        self._beyond = np.flatnonzero(self._held & ~k.at.facing)
        if len(self._beyond):
            assert isinstance(k.at, RayHit)
            self._beyond = self._target.extend(k.at, k.contactor(), self._beyond)
            k.may_close[self._beyond] = True
            k.count()

    def let_go(self) -> bool:
        """Points beyond the end are no longer held; whether there were any on this rank."""
        self._held[self._beyond] = False
        return bool(len(self._beyond))
