"""A spherical balloon: a thin neo-Hookean sphere under inner pressure (the law of section 4.2), with its limit point.

With the stretch l of the sphere's surface and the squared thickness stretch x(l²), plane stress through the thickness, the
nominal tension is N = hG(l − x/l) and balance of forces gives the pressure p = 2N/(R l²), R being the initial radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from scipy.optimize import minimize_scalar

from exact.two_membranes import thickness_stretch_squared

__all__ = ["Balloon"]


@dataclass(frozen=True)
class Balloon:
    """E in Pa, thickness and initial radius in m."""

    E: float = 2e6
    nu: float = 0.3
    thickness: float = 1e-3
    radius: float = 1.0

    def pressure(self, l: Any) -> Any:
        """Pressure (Pa) at surface stretch l; the larger sphere is taken to be loaded on its current surface."""
        G = self.E / (2 * (1 + self.nu))
        Λ = self.E * self.nu / ((1 + self.nu) * (1 - 2 * self.nu))
        return 2 * self.thickness * G * (l - thickness_stretch_squared(l**2, G, Λ) / l) / (self.radius * l**2)

    def limit(self) -> tuple[float, float]:
        """(stretch, pressure in Pa) of the limit point."""
        found = minimize_scalar(
            lambda l: -self.pressure(l), bounds=(1.0, 3.0), method="bounded", options={"xatol": 1e-10}
        )
        return float(found.x), -float(found.fun)
