"""ε_N and ε_T of a contact pair: the user's, or shares of the bulk's stiffness at the two surfaces (docs/newton.md)."""

from __future__ import annotations

from dolfinx_mortar_al.contact import Contact
from dolfinx_mortar_al.law import Augmentation
from dolfinx_mortar_al.monitors import Finding
from dolfinx_mortar_al.surface import Surface

__all__ = ["PairAugmentation"]

SOFTER = 0.125  # ε over what the bulk yields to pressure at the surface (docs/newton.md)
FIRMER = 1.0  # the same in time steps, where inertia is part of that stiffness (docs/impact.md)
FIRMEST = 12.0  # the same for ε_N in time steps: by p/ε_N, less than 1 % of a facet, do partly closed facets overlap
FAR = 100.0  # times more or less than by default: where Newton has been seen to fail for ε
DEPENDS = (
    "the answer depends on it where facets are partly closed, by more than a mesh twice as fine does; leave it out"
)


class PairAugmentation:
    """What the bulk's stiffness at a pair's surfaces suggests for ε, and ε as it is.

    Args:
        contact: which may give ε_N and ε_T (Pa/m).
        stiffnesses: mean nodal ones per facet area, of the contactor and of the target (Pa/m).

    Attributes:
        stiffnesses: the same now.
        stiffness: the softer side's now (Pa/m).
        at_start: the softer side's at the start (Pa/m).
        suggested: ε by default (Pa/m).
        unit: by which multipliers are counted, and their equations (Pa/m); the same as ε by default at the start.
        parameters: ε_N and ε_T as they are.
        of_membranes: whether either side is one.
    """

    stiffnesses: tuple[float, float]
    stiffness: float
    suggested: float
    parameters: Augmentation

    def __init__(self, contact: Contact, stiffnesses: tuple[float, float]) -> None:
        self._given = {name: getattr(contact, name) for name in ("epsilon_normal", "epsilon_tangential")}
        sides = (contact.contactor, contact.target)
        self.of_membranes = any(isinstance(side, Surface) and side.is_membrane for side in sides)
        self.take(stiffnesses)
        self.unit, self.at_start = self.suggested, self.stiffness

    @property
    def ratio(self) -> float:
        """The contactor's stiffness over the target's; 0 where either is a membrane."""
        contactor, target = self.stiffnesses
        return 0.0 if self.of_membranes else contactor / target

    @property
    def is_uniform(self) -> bool:
        """Whether ε_N = ε_T."""
        return self.parameters.normal == self.parameters.tangential

    def take(self, stiffnesses: tuple[float, float]) -> None:
        """The bulk has other stiffnesses (Pa/m) at the contactor and at the target."""
        self.stiffnesses = stiffnesses
        self.take_shares(SOFTER, SOFTER)

    def take_steps(self) -> None:
        """From now on there are time steps."""
        self.take_shares(FIRMER, FIRMEST)
        self.unit = self.suggested

    def take_shares(self, tangential: float, normal: float) -> None:
        """ε_T and ε_N are the user's, or these shares of the softer side's stiffness."""
        self.stiffness = min(self.stiffnesses)
        self.suggested = tangential * self.stiffness
        self._use(normal * self.stiffness, 0.0)

    def add(self, firmness: float) -> None:
        """ε_N and ε_T are the user's, or what the bulk suggests, and this `firmness` more (Pa/m)."""
        self._use(self.suggested, firmness)

    def _use(self, normal: float, more: float) -> None:
        defaults = {"epsilon_normal": normal, "epsilon_tangential": self.suggested}
        chosen = {name: defaults[name] if given is None else given for name, given in self._given.items()}
        self.parameters = Augmentation(chosen["epsilon_normal"] + more, chosen["epsilon_tangential"] + more)

    def far_off(self) -> dict[str, float]:
        """The parameters that are a user's and more than FAR times more or less than the bulk suggests, over that."""
        ratios = {name: ε / self.suggested for name, ε in self._given.items() if ε is not None}
        return {name: ratio for name, ratio in ratios.items() if not 1 / FAR < ratio < FAR}

    def findings(self, pair: str) -> list[Finding]:
        """A finding of the pair of that name for each of :meth:`far_off`."""
        return [
            Finding(f"{pair}: {name} over what the bulk suggests", ratio, (), DEPENDS, False)
            for name, ratio in self.far_off().items()
        ]
