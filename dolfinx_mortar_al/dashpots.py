"""Dashpots on the nodes of bodies, which let them go to where they come to rest (`relaxation`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Dashpots"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Dashpots:
    """What slows nodes down in a step.

    Attributes:
        stiffness: (owned dofs,) in N/m; since: (owned dofs,) displacements (m) in which they bear nothing.
    """

    stiffness: Array
    since: Array

    def forces(self, u: Array) -> Array:
        """(owned dofs,) what they resist displacements u (owned dofs,) with (N)."""
        return self.stiffness * (u - self.since)
