"""What a pair finds amiss in a converged state: integration, multipliers and facets that do not resolve the contact."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.blocks import Blocks
from dolfinx_mortar_al.law import OPEN, SLIP
from dolfinx_mortar_al.monitors import Finding
from dolfinx_mortar_al.obstacles import Pose
from dolfinx_mortar_al.prescribed import PrescribedNodes
from dolfinx_mortar_al.projection import dot
from dolfinx_mortar_al.rays import OPPOSED
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over
from dolfinx_mortar_al.results import PairResults
from dolfinx_mortar_al.smoothing import ALIKE
from dolfinx_mortar_al.surface import GatheredFacets, surface_normal
from dolfinx_mortar_al.targets import DeformableTarget, RigidTarget
from dolfinx_mortar_al.unfelt import Converged

__all__ = ["PUSHED", "PairFindings"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FINER = (
    "the target is finer than the contactor's integration points, which miss some of its facets: the pressure is "
    "inaccurate; refine the contactor or raise quadrature_degree"
)
FINE = (
    "the contactor is finer than the target and stiffer per area, as finer facets of one material are, too, and contact a "
    "few of the target's facets wide: they cannot follow what the multiplier asks of them, and pressures oscillate "
    "(resultants do not); refine the target, or swap contactor and target"
)
HARDLY = 1e-6  # share of the target's shape functions: a point that free nodes move by less is prescribed
STIFFER = 4.0  # of stiffnesses per area: pressures on finer contactors were off by more than a tenth from there on
ALTERNATES = 0.05  # of the pressure, within facets: it is off by a tenth at their nodes, in turn
MUCH_STIFFER = 10.0  # the same; solves that failed went through with the roles swapped from 15 on (docs/robustness.md)
OVERLAP = "both surfaces are prescribed there and overlap: no contact force can part them; change the prescribed values"
PUSHED = (
    "supports push this node into the other surface, which is held there, too, so that no contact force can part them: end "
    "the support, or the surface, at the facet before, or change the prescribed values"
)
DEEP = (
    "the surfaces overlap where they are in contact, and much of the force comes from that: the contact is on parts of the "
    "contactor's facets, which do not resolve it; refine the contactor there"
)
BY_ORDER = ", or take multiplier_order=2"  # where the displacement has that and the contactor is the softer side
SWAP = ", or swap contactor and target"  # where both are surfaces of their own and the target is the finer one
WAVERS = (
    "pressures waver by that share from point to point about those of the multiplier's nodes, as pressures near the bodies' "
    'moduli let their surfaces ripple between these; take integration="segments" or finer meshes'
)
WAVERING = 0.02  # of the pressure: at points it is off by 2.7 % from there on, root mean square
OVERLAPS = 0.05  # of the longer facet: closed points that lie deeper are hardly held apart,
BY_OVERLAP = (
    0.1  # if so much of the contact force is ε g: in resolved contact multipliers bear all but a few hundredths
)
BY_NORMALS = (
    "a corner or a rounded edge of the contactor with few facets rests on a smoother target, and pressure acts along the "
    "contactor's normals: the direction of this part's force (of separate parts of the contact the worst) is off by that "
    "share; refine the contactor there if it is round; at a sharp corner take "
    'projection="closest", or swap contactor and target'
)
TURNED = 0.03  # of the force
DIPS = (
    "what slides dips into the target with the contactor's last facets, where pressures are largest and act along normals "
    "that are not the target's, on fine meshes, too: friction of this part (of separate parts of the contact the worst) is "
    "off by about that share; round the corner over some facets, or compare with contactor and target swapped, or with "
    'projection="closest"'
)
OF_FRICTION = 0.05  # of what friction bears in gross slip
PATCHES = (
    "curved surfaces are in contact in patches, as the gaps between their facets are larger than what the pressure closes, "
    "and pressures in them are too large; where surfaces are pressed by a given interference, as in a shrink fit, the force "
    "is too small; "
)
STRAIGHT = "take meshes of order 2 (gmsh -order 2) with displacements of order 2, or refine both surfaces"
CURVED = "refine both surfaces"  # where facets are curved already
PATCHY = 0.1  # of the contact: next to its end facets are open in part
MANY = 8  # facets in each direction: in Hertz' contacts of so many a fifth of the pressure would close the sagitta
HOLES = 2  # facets from any hole to its edge: nodes of meshes that are to match nearly meet every few facets
NARROW = (
    "this part of the contact is that many of the contactor's facets wide, which do not resolve it: its force may be off by "
    "tens of per cent, and is mostly too small; refine the contactor there, to a third of the contact's width"
)
NARROWER = 1.25  # facets: forces of rollers, discs and balls were off by 10 to 65 % below, by 3 % from 1.4
BEARS = 0.1  # of the force: parts that bear less are not told of
DEEPLY = 1.0  # target facets: a surface that lies deeper may be nearer to another side of the target
AT_START = (
    "the surfaces overlap by as much before any load, and the first step parts them at once: if no press fit is meant, look "
    "at the positions of the meshes, their units, and which side of the target is named"
)
SHARE = 0.01  # of a target facet: overlaps below it are those of facets that do not match on curved surfaces


FAR_TURN = 1.6  # rad, a little more than a quarter of a turn: from here on a chord is a tenth shorter than its arc
FAR = (
    "friction goes by where the obstacle's points were before and are now, the shorter way round: it is turned round from π "
    "on, and none at whole turns; take smaller increments, and let the angle go on beyond 2π"
)

APART = (
    "nothing has been in contact in the whole march: do the bodies start as close, and move as far, as was meant, in the "
    "units of the mesh, and are these the surfaces that meet?"
)


class PairFindings(PairResults):
    """Findings of a contact pair; None where there is nothing to say (all collective)."""

    #: out of the plane (m)
    thickness: float
    _prescribed_facets: NDArray[np.bool_]
    _firmness: float  # what is added to ε lest surfaces ripple (Pa/m)
    _prescribed_nodes: PrescribedNodes
    #: whether there is friction, or may be
    friction: bool
    _converged: Converged
    blocks: Blocks
    #: the whole contactor, and (nf,) which of its facets this rank has
    _contactor: GatheredFacets
    _own: NDArray[np.int64]

    def coarse_integration(self) -> Finding | None:
        """Where closed Gauss points lie farther apart than the target facets they face are long (collective)."""
        if self.is_segmented:
            return None
        closed = np.flatnonzero(self.state.status != OPEN)
        ratio = self.target.extents[self.at.point.facet[closed]] / self.integration.spacing[closed]
        k = int(np.argmin(ratio)) if len(ratio) else -1
        mine = (float(ratio[k]), tuple(self.points()[closed[k]].tolist())) if len(ratio) else (np.inf, ())
        value, X = min(self.comm.allgather(mine))
        if value >= 1.0:
            return None
        says = FINER if self.target.is_contactor else FINER + SWAP
        return Finding(f"{self.name}: target facets per point's distance", value, X, says, False)

    def fine_multiplier(self) -> Finding | None:
        """Whether the multiplier of a contactor that is stiffer than the target has nodes closer together than those of the
        target's facets that it faces, in the mean over what is closed, and is not held smooth for the most part, so that
        pressures alternate (collective)."""
        if self.target.is_rigid or self.target.is_contactor or self.augmentation.ratio <= STIFFER:
            return None
        closed = np.flatnonzero(self.state.status != OPEN)
        j, (own, theirs) = self.j[closed], (extents[closed] for extents in self._extents())
        own, theirs = self.multiplier.shape.spacing * own, self.target.spacing * theirs
        smooth = self.blocks.smoothed[self.integration.facet[closed]]
        sums = j @ own, j @ theirs, j.sum(), j @ smooth, *self._varies_within()
        mine, others, whole, held, varies, force = sum_over(self.comm, np.array(sums))
        oscillates = held < 0.5 * whole and varies > ALTERNATES * force
        ratio = float(mine / others) if others > 0 and oscillates else 1.0
        return (
            Finding(f"{self.name}: multiplier's spacing over the target's", ratio, (), FINE, False)
            if ratio < ALIKE
            else None
        )

    def far_turn(self) -> Finding | None:
        """Whether an obstacle that a body rubs on was turned so far in this step that friction does not know its way
        (collective)."""
        if not self.friction or not isinstance(self.target, RigidTarget):
            return None
        before, now = self._converged.place, self.target.place
        assert isinstance(before, Pose) and isinstance(now, Pose)
        turn = float(np.linalg.norm(now.turned - before.turned))
        if not turn > FAR_TURN or self.closed_fraction() == 0.0:
            return None
        return Finding(f"{self.name}: turn of the obstacle in this step (rad)", turn, (), FAR, False)

    def _varies_within(self) -> tuple[float, float]:
        """By how much pressure is off its mean on the facet (N), on this rank's altogether, and the force (N)."""
        facet, force = self.integration.facet, self.j * self.state.p
        mean = self.integration.sum_by_facet(force) / np.maximum(self.integration.sum_by_facet(self.j), 1e-300)
        return float(self.j @ np.abs(self.state.p - mean[facet])), float(force.sum())

    def doubts_roles(self) -> str | None:
        """What a failed solve says of a contactor that is much stiffer than its target, whose edges and corners then come to
        bear on less than one of its facets."""
        if self.target.is_rigid or self.target.is_contactor or self.augmentation.ratio <= MUCH_STIFFER:
            return None
        return (
            f"{self.name}: its contactor is {self.augmentation.ratio:.2g} times as stiff as its target, whose edges and "
            "corners the contactor's facets may not resolve; swap contactor and target, so that the softer one is the "
            "contactor"
        )

    def never_met(self) -> Finding:
        """Of a pair that has not been in contact: how near its surfaces are, infinite where they do not face each other
        (collective)."""
        gap = np.where(self.at.facing, -self.at.g, np.inf)
        k = int(np.argmin(gap)) if len(gap) else -1
        mine = (float(gap[k]), tuple(self.points()[k].tolist())) if gap.min(initial=np.inf) < np.inf else (np.inf, ())
        value, X = min(self.comm.allgather(mine))
        return Finding(f"{self.name}: least gap (m)", value, X, APART, False)

    def overlap_at_start(self) -> Finding | None:
        """The deepest point that is closed as the problem is set up, if deeper than DEEPLY (collective)."""
        depth = np.where(self.state.status != OPEN, self.at.g, -np.inf) / self.target.size
        k = int(np.argmax(depth)) if len(depth) else -1
        mine = (float(depth[k]), tuple(self.points()[k].tolist())) if len(depth) else (-np.inf, ())
        value, X = max(self.comm.allgather(mine))
        if value <= DEEPLY:
            return None
        return Finding(f"{self.name}: initial overlap (target's facets)", value, X, AT_START, False)

    def prescribed_overlap(self) -> Finding | None:
        """Where both surfaces are prescribed and overlap, so that no contact force can part them (collective)."""
        prescribed = self._prescribed_facets[self.integration.facet] & self.at.facing
        if isinstance(self.target, DeformableTarget):  # within facets it may be free all the same
            free = ~self.target.fixed[self.target.facets[self.at.point.facet]]
            moves = np.einsum("nk,nki->ni", np.abs(self.kinematics.weights), free)
            prescribed &= (moves < HARDLY).all(axis=1)
        g = np.where(prescribed, self.at.g, -np.inf)
        k = int(np.argmax(g)) if len(g) else -1
        mine = (float(g[k]), tuple(self.points()[k].tolist())) if len(g) else (-np.inf, ())
        value, X = max(self.comm.allgather(mine))
        return (
            Finding(f"{self.name}: overlap (m)", value, X, OVERLAP, True) if value > SHARE * self.target.size else None
        )

    def pushed_node(self) -> Finding | None:
        """The prescribed node of one surface that lies deepest in the other, which is held there as well (collective)."""
        depth, X = self._prescribed_nodes.deepest()
        if depth <= SHARE * self.target.size:
            return None
        return Finding(f"{self.name}: prescribed node's overlap (m)", depth, X, PUSHED, False)

    def overlap_in_contact(self) -> Finding | None:
        """Where closed points lie deep in the target while ε g, in place of multipliers, is a good part of the contact force
        (collective)."""
        closed = np.flatnonzero(self.state.status != OPEN)
        g, j = self.at.g[closed], self.j[closed]
        own, theirs = (extents[closed] for extents in self._extents())
        depth = g / np.maximum(own, theirs)
        k = int(np.argmax(depth)) if len(depth) else -1
        is_finer = (own > theirs) & (not self.target.is_rigid) & (not self.target.is_contactor)
        here = (tuple(self.points()[closed[k]].tolist()), bool(is_finer[k])) if len(depth) else ((), False)
        value, X, may_swap = max(self.comm.allgather((float(depth.max(initial=-np.inf)), *here)))
        by_overlap = j @ np.abs(g) * self.epsilon.normal
        borne, total = sum_over(self.comm, np.array([by_overlap, j @ self.state.p[closed]]))
        if value < OVERLAPS or borne < BY_OVERLAP * total:
            return None
        sees = self.multiplier.shape.order == self.integration.facets.shape.order or self.augmentation.ratio > 1.0
        says = DEEP + ("" if sees else BY_ORDER) + (SWAP if may_swap else "")
        return Finding(f"{self.name}: overlap in contact (facets)", value, X, says, False)

    def turned_force(self) -> Finding | None:
        """By how much contact's forces are off the target's normal in the mean over a connected zone, as a share of them, the
        largest of the zones', where the contactor turns more than the target does over a facet, as at a rounded corner on a
        flat surface (collective). There ν = −𝐧 is that of coarse facets; where the target turns more, as its corner on a flat
        contactor, 𝐧 is the better one."""
        if not self._has_two_normals:
            return None
        share, X = self._share_off_normal(
            lambda own, facet, cosine: self._contactor.turns[own] > self._target_surface.turns[facet]
        )
        if share < TURNED:
            return None
        return Finding(f"{self.name}: share of the force that is off the target's normal", share, X, BY_NORMALS, False)

    def dipping_friction(self, μ: float) -> Finding | None:
        """The same in the contactor's last facets, as a share of friction of the coefficient μ, where most of what presses
        slips: a front that dips into a target, but for what passes over one's edge and faces its side (collective)."""
        if not self._has_two_normals or μ == 0.0:
            return None
        pressed, slips = self.j * self.state.p, self.state.status == SLIP
        slipping, force = sum_over(self.comm, np.array([pressed @ slips, pressed.sum()]))
        if slipping <= force / 2:
            return None
        share, X = self._share_off_normal(lambda own, facet, cosine: self._contactor.at_ends[own] & (cosine >= OPPOSED))
        if share < OF_FRICTION * μ:
            return None
        return Finding(f"{self.name}: share of the friction that is off", share / μ, X, DIPS, False)

    @property
    def _has_two_normals(self) -> bool:
        """Whether forces act along the contactor's normal while the target has one of its own."""
        target = self.target
        return isinstance(target, DeformableTarget) and target.uses_rays and not target.is_contactor

    @property
    def _target_surface(self) -> GatheredFacets:
        assert isinstance(self.target, DeformableTarget)
        return self.target.surface

    def _share_off_normal(
        self, counts: Callable[[Index, Index, Array], NDArray[np.bool_]]
    ) -> tuple[float, tuple[float, ...]]:
        """The largest mean over a connected zone of p (ν − ν₂) over that of p, ν₂ the target's normal, across the zone's mean
        ν₂, along which the sides of a symmetric zone leave what is no friction, and the middle of that zone; of facets of the
        contactor and the target's that they face (n,), and the cosine between both normals (n,), `counts` says which do
        (collective)."""
        closed = np.flatnonzero(self.state.status != OPEN)
        at, own = self.at.take(closed), self._own[self.integration.facet[closed]]
        normal = surface_normal(at.a)
        normal /= (np.sqrt(dot(normal, normal)) * np.where(dot(normal, at.ν) < 0, -1.0, 1.0))[:, None]
        pressed, zone = self.j[closed] * self.state.p[closed], self._contactor.zones(self._touched())
        off = (pressed * counts(own, at.point.facet, dot(normal, at.ν)))[:, None] * (at.ν - normal)
        parts = np.column_stack([off, pressed[:, None] * normal, pressed[:, None] * self.points()[closed], pressed])
        sums = np.zeros((zone.max(initial=-1) + 1, parts.shape[1]))
        np.add.at(sums, zone[own], parts)
        sums = sum_over(self.comm, sums)
        sums = sums[sums[:, -1] > TURNED * sums[:, -1].sum()]  # errors of the others are below what is said of one zone
        if not len(sums):
            return 0.0, ()
        off, normals, middles = np.split(sums[:, :-1] / sums[:, -1:], 3, axis=1)
        off -= (dot(off, normals) / np.maximum(dot(normals, normals), 1e-300))[:, None] * normals
        shares = np.linalg.norm(off, axis=1)
        worst = int(shares.argmax())
        return float(shares[worst]), tuple(middles[worst].tolist())

    def patches(self) -> Finding | None:
        """What is open amid a contact of many facets, as a share of it, where straight facets of curved surfaces leave larger
        gaps than the pressure closes (collective). A contact that ends where the surfaces part has open points in its last
        facets alone, or is a first touch of few; facets that overhang the target are last ones, too."""
        if self.target.is_contactor or not self._is_curved:
            return None
        facet, closed = self._own[self.integration.facet], self.state.status != OPEN
        amid = self._contactor.amid(self._touched(), HOLES)
        overhangs = np.zeros(len(amid), dtype=bool)
        overhangs[facet[~self.at.facing]] = True
        j = np.where((amid & ~overhangs)[facet], self.j, 0.0)
        needed = j @ (self._sagittas() * self.epsilon.normal)
        whole, open_, needed, borne = sum_over(self.comm, np.array([j.sum(), j @ ~closed, needed, j @ self.state.p]))
        few = np.sum(amid) < MANY ** (self.gdim - 1)
        if few or open_ <= PATCHY * whole or not needed > borne > 0.0:
            return None
        says = PATCHES + (STRAIGHT if self._some_are_straight(amid) else CURVED)
        return Finding(f"{self.name}: open share amid the contact", float(open_ / whole), (), says, False)

    def narrow_zone(self) -> Finding | None:
        """How many facets wide the narrowest connected zone of contact is that bears a good part of the force, if less than
        NARROWER, but for such as corners and ends of either surface are in (collective)."""
        if self.target.is_contactor or (self.augmentation.ratio == 0.0 and not self.target.is_rigid):
            return None
        closed, touched = np.flatnonzero(self.state.status != OPEN), self._touched()
        own, zone, j = self._own[self.integration.facet[closed]], self._contactor.zones(touched), self.j[closed]
        at_end, pressed = self._contactor.at_ends[own], j * self.state.p[closed]
        if not self.target.is_rigid:
            at_end = at_end | self._target_surface.at_ends[self.at.point.facet[closed]]
        parts = np.column_stack([pressed[:, None] * self.points()[closed], j, at_end, pressed])
        sums = np.zeros((zone.max(initial=-1) + 1, parts.shape[1]))
        np.add.at(sums, zone[own], parts)
        *moments, area, ends, force = sum_over(self.comm, sums).T
        facets = np.bincount(zone[touched], self._contactor.areas()[touched]) * self.thickness
        width = (area * np.bincount(zone[touched]) / facets) ** (1.0 / (self.gdim - 1))
        width[(ends > 0.0) | (force <= BEARS * force.sum())] = np.inf
        if width.min(initial=np.inf) >= NARROWER:
            return None
        k = int(width.argmin())
        X = tuple(float(moment[k] / force[k]) for moment in moments)
        return Finding(f"{self.name}: width of the contact (facets)", float(width[k]), X, NARROW, False)

    def ripples(self) -> Finding | None:
        """Under pressures near the bodies' moduli, what ε bears in the mean on facets that are closed altogether, if they are
        many, as a share of the pressure, beside what gaps between straight facets of curved surfaces make of it
        (collective)."""
        if self.augmentation.of_membranes or self._firmness == 0.0:
            return None
        facet, closed = self.integration.facet, self.state.status != OPEN
        whole = np.ones(self.integration.facets.size, dtype=bool)
        whole[facet[~closed]] = False
        j = np.where(whole[facet], self.j, 0.0)
        wavers = j @ np.maximum(np.abs(self.at.g) - self._sagittas(), 0.0) * self.epsilon.normal
        count, force, wavers = sum_over(self.comm, np.array([whole.sum(), j @ self.state.p, wavers]))
        if count < MANY ** (self.gdim - 1) or wavers <= WAVERING * force:
            return None
        return Finding(f"{self.name}: wavering share of the pressure", float(wavers / force), (), WAVERS, False)

    def _touched(self) -> NDArray[np.bool_]:
        """(nf,) which facets of the whole contactor are in contact, at least in part (collective)."""
        touched = np.zeros(len(self._contactor.facets))
        touched[self._own[self.integration.facet[self.state.status != OPEN]]] = 1.0
        return max_over(self.comm, touched) > 0

    def _extents(self) -> tuple[Array, Array]:
        """(n,) and (n,) extents of the points' facets and of those that they face (m); 0 of a rigid target."""
        own = self._own_extents()
        return own, np.zeros_like(own) if self.target.is_rigid else self.target.extents[self.at.point.facet]

    def _own_extents(self) -> Array:
        """(n,) extents of the points' facets (m)."""
        return np.asarray(self.integration.facets.extents()[self.integration.facet])

    @cached_property
    def _is_curved(self) -> bool:
        """Whether facets fall short of a curved surface on either side; the same on all ranks."""
        return any(side.sagittas.any() for side in self._sides)

    def _some_are_straight(self, facets: NDArray[np.bool_]) -> bool:
        """Whether some of those are straight, of the contactor's `facets` (whole nf,) or of what these face (collective)."""
        own = self._own[self.integration.facet]
        touched = [facets, np.unique(self.at.point.facet[facets[own]])]
        straight = ((side.rises == 0.0) & (side.sagittas > 0.0) for side in self._sides)
        return any_over(self.comm, any(each[there].any() for each, there in zip(straight, touched, strict=False)))

    @cached_property
    def largest_turn(self) -> float:
        """By how much a surface of the pair turns over a facet at most, but at sharp corners (rad)."""
        return max(float(side.smooth_turns.max(initial=0.0)) for side in self._sides)

    @property
    def _sides(self) -> list[GatheredFacets]:
        """The meshed surfaces of the pair."""
        target = self.target
        return [self._contactor, *([target.surface] if isinstance(target, DeformableTarget) else [])]

    def _sagittas(self) -> Array:
        """(n,) how far the straight facets at the points, or those that they face, fall short of curved surfaces (m)."""
        short = self._contactor.sagittas[self._own[self.integration.facet]]
        if not isinstance(self.target, DeformableTarget):
            return short
        return np.maximum(short, self.target.surface.sagittas[self.at.point.facet])
