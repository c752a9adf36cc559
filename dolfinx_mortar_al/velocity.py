"""Contact between velocities, for Moreau's scheme: the geometry of a time step and the relative motion on it.

With the predictor 𝐮_m = 𝐮_n + (1−θ)Δt 𝐯_n the θ-scheme says Δt 𝐯_{n+1} = (𝐮_{n+1} − 𝐮_m)/θ. Points that touch at 𝐮_m have
eq. (1) with Δt × the relative velocity in place of gap and slip; all others are open. Closest points and normals are those
of 𝐮_m and do not move within the step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import Projection

__all__ = ["VelocityLevel"]

Array = NDArray[np.float64]


@dataclass
class VelocityLevel:
    """The step's geometry: θ of the scheme, the closest-point map `at` at the predictor, positions there, and whether
    each point touches."""

    θ: float
    at: Projection = field(init=False)
    touches: NDArray[np.bool_] = field(init=False)

    def predict(self, at: Projection, x: Array, touch: float) -> None:
        """Freeze the geometry `at` of the predicted points 𝐱 (n, gdim); gaps below `touch` (m) are closed."""
        self.at, self._x = at, x
        touches: NDArray[np.bool_] = at.g >= -touch
        self.touches = at.facing & touches

    def relative_motion(self, x: Array, y: Array) -> tuple[Projection, Array]:
        """The frozen map with g = −Δt v_N in place of the gap, and Δt × the relative velocity (n, gdim) as the slip.

        Args:
            x: (n, gdim) contactor points now.
            y: (n, gdim) the predictor's closest target points, where they are now.
        """
        motion: Array = np.asarray(((x - self._x) - (y - self.at.y)) / self.θ, dtype=np.float64)
        return replace(self.at, g=-np.einsum("ni,ni->n", self.at.ν, motion)), motion
