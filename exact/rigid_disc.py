"""Impact of a rigid disc on a rigid plane with Coulomb friction and restitution: the estimate for section 4.4.

With I = mR²/2 and the sliding speed v_s = V_x + ωR at the touching point, the normal impulse is J_n = m(1 + e)V_n. Friction
stops the sliding, J_t = m v_s/3, if the cone allows it, and is μJ_n against the sliding otherwise. Then V_x' = V_x − J_t/m,
V_n' = eV_n and ω' = ω − 2J_t/(mR).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, pi

__all__ = ["Rebound", "RigidDisc"]


@dataclass(frozen=True)
class Rebound:
    """State after the impact: velocities in m/s (`velocity_n` away from the plane), spin in rad/s, impulses on the disc in
    N·s (`impulse_t` against +x), energy lost by restitution and by friction in J."""

    velocity_x: float
    velocity_n: float
    spin: float
    impulse_n: float
    impulse_t: float
    normal_loss: float
    friction_loss: float
    sticks: bool

    @property
    def energy_loss(self) -> float:
        """Kinetic energy lost in J."""
        return self.normal_loss + self.friction_loss


@dataclass(frozen=True)
class RigidDisc:
    """Radius and thickness in m, density in kg/m³, coefficient of friction."""

    radius: float = 0.1
    thickness: float = 0.02
    density: float = 6000.0
    friction: float = 0.3

    @property
    def mass(self) -> float:
        """Mass in kg."""
        return self.density * pi * self.radius**2 * self.thickness

    @property
    def inertia(self) -> float:
        """Moment of inertia about the centre, mR²/2, in kg·m²."""
        return self.mass * self.radius**2 / 2

    def kinetic_energy(self, velocity_x: float, velocity_n: float, spin: float) -> float:
        """Kinetic energy in J."""
        return (self.mass * (velocity_x**2 + velocity_n**2) + self.inertia * spin**2) / 2

    def rebound(self, velocity_x: float, velocity_n: float, spin: float, restitution: float = 1.0) -> Rebound:
        """What leaves the plane.

        Args:
            velocity_x: Velocity along the plane in m/s.
            velocity_n: Velocity towards the plane in m/s, not negative.
            spin: ω in rad/s; positive is slice: the touching point moves with the travel +x.
            restitution: e, from 0 to 1.
        """
        if velocity_n < 0 or not 0 <= restitution <= 1:
            raise ValueError(f"no impact: approach velocity {velocity_n} m/s, restitution {restitution}")
        m, R = self.mass, self.radius
        sliding = velocity_x + spin * R
        J_n = m * (1 + restitution) * velocity_n
        sticks = self.friction * J_n >= m * abs(sliding) / 3
        J_t = m * sliding / 3 if sticks else copysign(self.friction * J_n, sliding)
        return Rebound(
            velocity_x=velocity_x - J_t / m,
            velocity_n=restitution * velocity_n,
            spin=spin - 2 * J_t / (m * R),
            impulse_n=J_n,
            impulse_t=J_t,
            normal_loss=m * velocity_n**2 * (1 - restitution**2) / 2,
            friction_loss=J_t * (sliding - 1.5 * J_t / m),  # J_t times the mean of v_s before and after
            sticks=sticks,
        )
