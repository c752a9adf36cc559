"""Impact of two identical linear elastic bars (section 4.3): d'Alembert's solution in closed form.

Bar 1, at speed V, meets bar 2, at rest, face to face. From the contact faces a compression wave, velocity V/2 and stress
−ρcV/2, runs through each bar at c = √(E/ρ). The free ends send it back after L/c as a tension wave of the same size, which
leaves bar 1 at rest, bar 2 at V and both without stress; at 2L/c the two reach the contact faces and the bars part.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["TwoBars"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TwoBars:
    """Length and gap in m, section in m², Young's modulus in Pa, density in kg/m³, speed of bar 1 in m/s.

    Bar 1 starts at t = 0, `gap` away from bar 2. Times are in seconds, scalars or arrays of any shape, and the solution holds
    at all of them; at a jump, force and velocities take the later value. Displacements count from t = 0.
    """

    length: float = 10.0
    section: float = 1.0
    E: float = 100.0
    rho: float = 0.01
    speed: float = 0.1
    gap: float = 0.0

    def __post_init__(self) -> None:
        if self.speed <= 0 or self.gap < 0:
            raise ValueError(f"bar 1 must approach bar 2 from outside: speed {self.speed} m/s, gap {self.gap} m")

    @property
    def wave_speed(self) -> float:
        """c = √(E/ρ) in m/s."""
        return sqrt(self.E / self.rho)

    @property
    def mass(self) -> float:
        """Mass of one bar in kg."""
        return self.rho * self.section * self.length

    @property
    def momentum(self) -> float:
        """Momentum of the two bars in N·s, constant."""
        return self.mass * self.speed

    @property
    def energy(self) -> float:
        """Energy of the two bars in J, constant."""
        return self.mass * self.speed**2 / 2

    @property
    def contact_force(self) -> float:
        """Compression ρcAV/2 while the bars touch, in N."""
        return self.rho * self.wave_speed * self.section * self.speed / 2

    @property
    def contact_start(self) -> float:
        """Time of first touch in s."""
        return self.gap / self.speed

    @property
    def contact_end(self) -> float:
        """Time of release, 2L/c after first touch, in s."""
        return self.contact_start + 2 * self.length / self.wave_speed

    def _phase(self, t: ArrayLike) -> Array:
        """Wave travel in bar lengths: 0 before contact, 1 when the waves reach the free ends, 2 after release."""
        return np.clip((np.asarray(t, dtype=float) - self.contact_start) * self.wave_speed / self.length, 0.0, 2.0)

    def force(self, t: ArrayLike) -> Array:
        """Contact force (compression positive) in N."""
        t = np.asarray(t, dtype=float)
        return np.where((t >= self.contact_start) & (t < self.contact_end), self.contact_force, 0.0)

    def tip_displacements(self, t: ArrayLike) -> Array:
        """Displacement of the contact faces of bars 1 and 2 in m, shape (2, …)."""
        t = np.asarray(t, dtype=float)
        together = self.speed / 2 * (np.clip(t, self.contact_start, self.contact_end) - self.contact_start)
        before, after = np.minimum(t, self.contact_start), np.maximum(t - self.contact_end, 0.0)
        return np.stack([self.speed * before + together, together + self.speed * after])

    def tip_velocities(self, t: ArrayLike) -> Array:
        """Velocity of the contact faces of bars 1 and 2 in m/s, shape (2, …)."""
        t = np.asarray(t, dtype=float)
        gone = np.where(t < self.contact_start, 0.0, np.where(t < self.contact_end, 0.5, 1.0))
        return self.speed * np.stack([1.0 - gone, gone])

    def momenta(self, t: ArrayLike) -> Array:
        """Momentum of bars 1 and 2 in N·s, shape (2, …)."""
        s = self._phase(t)
        return self.momentum / 2 * np.stack([2.0 - s, s])

    def energies(self, t: ArrayLike) -> Array:
        """Kinetic energy of bars 1 and 2, then strain energy of bars 1 and 2, in J, shape (4, …)."""
        s = self._phase(t)
        waves = np.minimum(s, 2.0 - s) / 4  # the compressed part of a bar holds 1/4 of each kind of energy per length
        untouched, relieved = (
            np.maximum(1.0 - s, 0.0),
            np.maximum(s - 1.0, 0.0),
        )  # parts of a bar before, behind both waves
        return self.energy * np.stack([untouched + waves, relieved + waves, waves, waves])
