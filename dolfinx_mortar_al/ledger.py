"""The books of bodies in motion: energies and momenta."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Ledger"]


@dataclass(frozen=True)
class Ledger:
    """Energies (J) and momenta at a time; what is not of the moment has been added up since the start.

    kinetic + strain + contact = initial energy + external_work − friction_dissipation − impact_loss + energy_defect, where
    `contact` is what the augmentation stores at the edges of contact, a share of 1e-4 and less, `held` of it by friction
    (:meth:`ContactPair.stored_energy`, :meth:`ContactPair.stored_by_friction`); impact_loss and friction_dissipation never
    fall. `known` says where `strain` comes from: a stored energy, or the internal work done since the start, where a body has
    no stored energy (`internal_work.py`). The external work is that of loads, of obstacles and of supports that move.
    """

    kinetic: float
    strain: float
    contact: float = 0.0
    held: float = 0.0
    external_work: float = 0.0
    friction_dissipation: float = 0.0
    impact_loss: float = 0.0
    energy_defect: float = 0.0
    momentum: tuple[float, ...] = ()
    angular_momentum: tuple[float, ...] = ()
    known: str = ""

    @property
    def total(self) -> float:
        """Energy of the moment (J)."""
        return self.kinetic + self.strain + self.contact

    @property
    def size(self) -> float:
        """What the energies of the moment amount to, whatever their signs (J): what a form has done since the start may be
        less than nothing, as that of a weight in it."""
        return abs(self.kinetic) + abs(self.strain) + abs(self.contact)

    @property
    def received(self) -> float:
        """Energy of the moment and all that has been lost: what has come in, from wherever (J)."""
        return self.total + self.friction_dissipation + self.impact_loss
