"""How bodies that contact alone holds stood in the last equilibrium, kept from one step to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Standing"]

Array = NDArray[np.float64]


@dataclass
class Standing:
    """How pieces that contact alone holds stood in the last equilibrium.

    Attributes:
        held: whether supports, or contact as firmly as supports, held all pieces.
        free: (pieces,) which ones nothing presses on.
        pressed: (pieces,) what contact pressed on each with (N); pressing: the most that it has in an equilibrium.
    """

    held: bool
    free: NDArray[np.bool_]
    pressed: Array
    pressing: Array

    def snapshot(self) -> dict[str, Array]:
        """Copies of all."""
        held = np.array([float(self.held)])
        forces = {"pressed": self.pressed.copy(), "pressing": self.pressing.copy()}
        return {"held": held, "free": self.free.astype(float), **forces}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        self.held, self.free = bool(saved["held"][0]), saved["free"] > 0
        self.pressed, self.pressing = saved["pressed"].copy(), saved["pressing"].copy()
