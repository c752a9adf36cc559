"""How firmly a pair is held closed: ε by the bulk's stiffness, and what keeps surfaces, and multipliers, from rippling."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.active_set import ActiveSet
from dolfinx_mortar_al.augmentation import PairAugmentation
from dolfinx_mortar_al.bodies import Bodies, BodyForms
from dolfinx_mortar_al.contact import Contact, coefficient
from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.law import Coulomb, Frictionless
from dolfinx_mortar_al.monitors import Finding
from dolfinx_mortar_al.pair_findings import PairFindings
from dolfinx_mortar_al.reductions import any_over, sum_over
from dolfinx_mortar_al.ripples import FLAT, CompressedSheets, firmness_under_pressure
from dolfinx_mortar_al.smoothing import lacking_compliance
from dolfinx_mortar_al.step_level import StepLevel
from dolfinx_mortar_al.surface import Facets
from dolfinx_mortar_al.targets import DeformableTarget
from dolfinx_mortar_al.validation import constant_value
from dolfinx_mortar_al.zone_width import ZoneWidth

__all__ = ["PairFirmness"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class PairFirmness(PairFindings):
    """What the bulk's stiffness means to a contact pair."""

    contact: Contact
    facets: Facets
    #: Gauss points of whole facets
    gauss: IntegrationPoints
    active: ActiveSet
    multiplier_order: int
    _body1: BodyForms
    _bodies: Bodies
    _facet_count: float
    # points, and the target's facets closest to them at the start
    _closest_to: tuple[IntegrationPoints, Index] | None

    def _at_nodes(self, u: fem.Function) -> Array:
        """(nf, nodes, gdim) values of the contactor's body at its facets' nodes; ghosts are up to date."""
        raise NotImplementedError

    # ---------------------------------------------------------------- the augmentation parameters

    def set_stiffness(self, diagonals: Sequence[fem.Function]) -> None:
        """Fix ε, and the unit of multipliers, by what the bulk has at the two surfaces at the start, from diagonals (N/m) of
        the bodies' matrices (collective)."""
        measured = contactor, target = self.measured_stiffnesses(diagonals)
        for side, stiffness in (
            (f"contactor (tag {self.contact.contactor.tag})", contactor),
            (f"target ({self.contact.target_name})", target),
        ):
            if not stiffness > 0:
                why = "has no internal virtual work on its cells, or with the wrong sign"
                if np.isnan(stiffness):
                    why = "or its derivative is not a number there: a division by zero, a root or logarithm of too little?"
                raise ValueError(
                    f"{self.name}: the {side} meets a stiffness of {stiffness:.3g} Pa/m in the start state: F {why}"
                )
        self.augmentation = PairAugmentation(self.contact, measured)
        self._use_law()
        self._hold_smooth()

    def take_stiffnesses(self, stiffnesses: tuple[float, float]) -> None:
        """The bulk has other stiffnesses now at the contactor and at the target (Pa/m): ε, and what holds multipliers smooth,
        follow (collective)."""
        self.augmentation.take(stiffnesses)
        self._use_law()
        self._hold_smooth()

    @property
    def force_round_off(self) -> float:
        """What ε makes of the round-off of positions (N): of nodal forces on all facets, which add up at random."""
        ε = max(self.epsilon.normal, self.epsilon.tangential)
        return float(ε * self.kinematics.round_off * self.area / np.sqrt(self._facet_count))

    def surface_stiffness(self, diagonals: Sequence[fem.Function]) -> float:
        """The softer side's mean nodal stiffness per facet area (Pa/m), from diagonals (N/m) of the bodies' matrices."""
        return min(self.measured_stiffnesses(diagonals))

    def measured_stiffnesses(self, diagonals: Sequence[fem.Function]) -> tuple[float, float]:
        """The contactor's and the target's mean nodal stiffness per facet area (Pa/m), from diagonals (N/m) of the bodies'
        matrices (collective)."""
        mine = next(d for d in diagonals if d.function_space is self._body1.space)
        own = self._at_nodes(mine).mean(axis=(1, 2)) / self.gauss.sum_by_facet(self.gauss.j)
        contactor = sum_over(self.comm, float(own.sum())) / self._facet_count
        target = self.target.stiffness(diagonals, self.thickness)
        return contactor, target

    def _use_law(self) -> None:
        """Eq. (1) with ε as it is."""
        ε = self.epsilon
        # the residual of an open point, ν λ_N/ε_N − λ_T/ε_T, turns with ν unless ε_N = ε_T
        self._same_ε = self.augmentation.is_uniform or not self.friction
        self.law: Frictionless | Coulomb = Frictionless(ε)
        if self.friction:
            self.law = Coulomb(ε, self.friction_coefficient, noise=self._slip_noise)

    @property
    def _slip_noise(self) -> float:
        """What ε makes of the round-off of slips (Pa)."""
        return self.epsilon.tangential * self.kinematics.round_off

    @property
    def friction_coefficient(self) -> float:
        """Coulomb's coefficient as it is now."""
        return coefficient(constant_value(self.contact.friction))

    def far_augmentation(self) -> list[Finding]:
        """A finding for each augmentation parameter that is a user's and far from the bulk's, while anything is closed
        (collective)."""
        findings = self.augmentation.findings(self.name)
        return findings if findings and self.closed_fraction() > 0.0 else []

    # ---------------------------------------------------------------- surfaces that would ripple

    def _hold_flat(self) -> None:
        """In statics, add to ε what keeps surfaces from rippling within their facets (collective)."""
        if isinstance(self.kinematics, StepLevel):
            return
        if self.augmentation.of_membranes:
            self._add(self._firmness_of_sheets())
            return
        sees = self.multiplier_order == self.facets.shape.order or self.is_segmented
        if sees or self.target.is_rigid:
            return
        p = np.maximum(self._normal_multiplier(), 0.0)
        slopes = [p / extents for extents in self._extents()]
        self._add(firmness_under_pressure(self.j * p, slopes, self.augmentation.stiffnesses, self.comm))

    def _hold_flatter(self) -> bool:
        """In statics, hold membranes flat that are more compressed than at the solve's start; whether there are any
        (collective)."""
        if not self.augmentation.of_membranes or isinstance(self.kinematics, StepLevel):
            return False
        suggested = self.augmentation.suggested  # holds a compression up to that by itself
        firmer = suggested + self._firmness < self._firmness_of_sheets()
        if firmer:  # at once as firm as can be: it grows on, and while it does ripples have begun
            self._add(FLAT * self.augmentation.stiffness)
        return firmer

    def _ease(self) -> bool:
        """Hold membranes no firmer that need not be held, as wild iterates asked for it: pressures waver within their facets;
        whether that is a change (collective)."""
        suggested = self.augmentation.suggested
        if not self.augmentation.of_membranes or self._firmness <= suggested:
            return False
        if (asked := self._firmness_of_sheets()) > suggested:
            return False
        self._add(asked)
        return True

    def _add(self, firmness: float) -> None:
        """Add a firmness (Pa/m) to ε from now on."""
        self._firmness = firmness
        self.augmentation.add(firmness)
        self._use_law()

    def _firmness_of_sheets(self) -> float:
        """What keeps membranes from rippling (Pa/m), within bounds (collective)."""
        closed = self.active.closed
        own, faced = self._own[self.integration.facet[closed]], self.at.point.facet[closed]
        return min(self._sheets.firmness(own, faced), FLAT * self.augmentation.stiffness)

    @cached_property
    def _sheets(self) -> CompressedSheets:
        wholes = self._contactor, getattr(self.target, "surface", None)
        return CompressedSheets(self.contact, wholes, self._bodies)

    # ---------------------------------------------------------------- multipliers that the target does not determine

    def _hold_smooth(self) -> None:
        """Hold a multiplier smooth where the contactor is finer than the target, in statics: membranes yield otherwise, and
        surfaces in contact with themselves are alike (collective)."""
        others = self.target.is_rigid or self.target.is_contactor or self.augmentation.of_membranes
        self.blocks.leave_rough()
        if others or self.target.fixed.all():
            return
        (faced, widths), zone = self._faced_at_start
        rigid = np.asarray(self.blocks.fixed.all(axis=(1, 2)))
        length = float(np.mean(self._contactor.extents()))
        contactor, target = self.augmentation.stiffnesses
        moduli = contactor * length, target * float(np.mean(self.target.extents))
        own = self.facets.extents()
        sides = (own, self.facets.widths()), (faced, widths)
        κ = lacking_compliance(self.multiplier, self.target, *sides, moduli, rigid)
        if any_over(self.comm, κ.any()):
            self.blocks.hold_smooth(κ, zone)

    @cached_property
    def _faced_at_start(self) -> tuple[list[Array], ZoneWidth]:
        """(nf,) and (nf,) extents and widths of the target's facets that each facet faces; how wide contact is in them."""
        sizes = self._faced(self.gauss, self.target.extents, self.target.widths)
        return sizes, ZoneWidth(self._contactor, self._own, self.target.spacing * sizes[1], self.comm)

    def _faced(self, points: IntegrationPoints, *sizes: Array) -> list[Array]:
        """(nf,) out of each of the `sizes` (target's nf,), extents or widths of its facets (m), that of those that each facet
        may face: of the finest that is closest to one of its points at the start, or the mean of all, onto which it may
        slide, if that is less."""
        faced: list[Array] = [np.full(self.facets.size, float(np.mean(size))) for size in sizes]
        if isinstance(self.target, DeformableTarget) and self.facets.size:
            if self._closest_to is None or self._closest_to[0] is not points:
                at = self.target.at_reference(points.interpolate(self.facets.X))
                self._closest_to = points, at.point.facet
            for least, size in zip(faced, sizes, strict=True):
                np.minimum.at(least, points.facet, size[self._closest_to[1]])
        return faced
