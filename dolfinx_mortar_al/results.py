"""What a pair reports of its present state: forces, fractions, areas, and where."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.contact_fields import ContactFields, gathered
from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.kinematics import Kinematics
from dolfinx_mortar_al.law import OPEN, STICK, Augmentation, LawState
from dolfinx_mortar_al.monitors import Finding
from dolfinx_mortar_al.multiplier import MultiplierSpace
from dolfinx_mortar_al.projection import Projection, dot
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over
from dolfinx_mortar_al.segments import Segments
from dolfinx_mortar_al.surface import GatheredFacets, surface_normal
from dolfinx_mortar_al.targets import DeformableTarget, Target

__all__ = ["PairResults"]

Array = NDArray[np.float64]

FINER = (
    "the target is finer than the contactor's integration points, which miss some of its facets: the pressure is "
    "inaccurate; refine the contactor or raise quadrature_degree"
)
FINE = (
    "the contactor is finer than the target and stiffer: the target's facets cannot follow what the multiplier asks of them, "
    "and pressures oscillate (resultants do not); refine the target, or swap contactor and target"
)
STIFFER = 4.0  # of stiffnesses per area: pressures on finer contactors were off by more than a tenth from there on
ALIKE = 0.99  # spacings that are the same but for the shape of facets
OVERLAP = "both surfaces are prescribed there and overlap: no contact force can part them; change the prescribed values"
DEEP = (
    "the surfaces overlap where they are in contact, and much of the force comes from that: the contact is on parts of the "
    "contactor's facets, which do not resolve it; refine the contactor there"
)
SWAP = ", or swap contactor and target"  # where both are surfaces of their own and the target is the finer one
RIPPLES = (
    "the surfaces ripple across each other in contact, between the multipliers' nodes, as they may where pressures come near "
    'the bodies\' moduli; take integration="segments" or finer meshes'
)
RIPPLED = 0.02  # of the longer facet: pressures were off by 3 % from there on
OVERLAPS = 0.05  # of the longer facet: closed points that lie deeper are hardly held apart,
BY_OVERLAP = (
    0.1  # if so much of the contact force is ε g: in resolved contact multipliers bear all but a few hundredths
)
BY_NORMALS = (
    "a corner or a rounded edge of the contactor with few facets rests on a smoother target, and pressure acts along the "
    "contactor's normals: the force's direction is off by that share; refine the contactor there, swap contactor and target, "
    'or take projection="closest"'
)
TURNED = 0.03  # of the force
PATCHES = (
    "curved surfaces are in contact in patches, as the gaps between their straight facets are larger than what the pressure "
    "closes, and pressures are too large; take meshes of order 2 (gmsh -order 2) with displacements of order 2, or refine "
    "both surfaces"
)
PATCHY = 0.1  # of the contact: next to its end facets are open in part
MANY = (
    8  # facets in each direction: of Hertz' contacts that large the sagitta would take a fifth of the pressure to close
)
HOLES = 2  # facets from any hole to its edge: nodes of meshes that are to match nearly meet every few facets
SHARE = 0.01  # of a target facet: overlaps below it are those of facets that do not match on curved surfaces
AT_END = 0.1  # weight of the other nodes where a point counts as at the target's end


class PairResults:
    """Results of a contact pair.

    Attributes:
        state: what the law says at this rank's points; kinematics: where they are.
    """

    comm: MPI.Intracomm
    name: str
    gdim: int
    integration: IntegrationPoints
    kinematics: Kinematics
    target: Target
    multiplier: MultiplierSpace
    #: of the contactor's stiffness per area to the target's; 0 where one of them is a membrane
    stiffness_ratio: float
    segments: Segments | None
    state: LawState
    _Λ: Array
    epsilon: Augmentation
    area: float
    _at_end: NDArray[np.bool_]
    _prescribed_facets: NDArray[np.bool_]
    #: the whole contactor, and (nf,) which of its facets this rank has
    _contactor: GatheredFacets
    _own: NDArray[np.int64]

    @property
    def j(self) -> Array:
        """(n,) weight × reference area of this rank's integration points (m²)."""
        return self.integration.j

    @property
    def at(self) -> Projection:
        """What the points face."""
        return self.kinematics.at

    @property
    def s(self) -> Array | None:
        """(n, gdim) slip increment, eq. (5), of which the tangential part counts (m)."""
        return self.kinematics.s

    def points(self) -> Array:
        """(n, gdim) reference positions of this rank's integration points (m)."""
        return self.integration.interpolate(self.integration.facets.X)

    def positions(self) -> Array:
        """(n, gdim) where they are now (m)."""
        return self.kinematics.positions()

    def fields(self) -> ContactFields:
        """Gap, pressure, traction, slip and status at this rank's integration points."""
        return ContactFields.of(self)

    def fields_on_root(self) -> ContactFields | None:
        """The same at all integration points, in order of X, on rank 0; None on the others (collective)."""
        return gathered(self.fields(), self.comm)

    def force(self) -> Array:
        """(gdim,) resultant of the contact tractions on the contactor (N), collective."""
        return np.asarray(sum_over(self.comm, self.j @ self.kinematics.traction(self.state)))

    def moment(self, about: Sequence[float]) -> Array:
        """Moment of the contact tractions on the contactor about a point (N m; 3 components, or 1 in the plane),
        collective. A rigid obstacle feels the opposite, as it does of :meth:`force`."""
        arm, t = self.kinematics.x - np.asarray(about), self.j[:, None] * self.kinematics.traction(self.state)
        if self.gdim == 3:
            return np.asarray(sum_over(self.comm, np.cross(arm, t).sum(axis=0)))
        return np.atleast_1d(sum_over(self.comm, float(np.sum(arm[:, 0] * t[:, 1] - arm[:, 1] * t[:, 0]))))

    def stored_energy(self) -> float:
        """∫ (p² − λ_N²)/(2ε_N) dS₀ (J), collective: what the augmentation holds where facets are partly closed. It is the
        potential of the normal contact forces, convex in the gaps and zero where nothing touches."""
        p = np.maximum(self.state.p, 0.0)  # points that count as closed may be apart before a march
        density = (p**2 - self._normal_multiplier() ** 2) / (2 * self.epsilon.normal)
        return sum_over(self.comm, float(self.j @ density))

    def _normal_multiplier(self) -> Array:
        """(n,) λ_N at the points (Pa)."""
        return self._Λ[:, 0] if self._Λ.shape[1] == 1 else np.asarray(np.einsum("ni,ni->n", self._Λ, self.at.ν))

    def penetration(self) -> float:
        """Largest penetration of a closed point (m), collective."""
        deep = self.kinematics.faced.g[self.state.status != OPEN]
        return max_over(self.comm, float(deep.max(initial=0.0)))

    def nodal_forces(self) -> float:
        """Norm of the contactor's nodal contact forces ∫ N |t| (N), collective: the scale of both residuals."""
        size = self.j * np.linalg.norm(self.state.t, axis=1)
        nodal = self.integration.sum_by_facet(size[:, None] * np.abs(self.integration.N))
        return float(np.sqrt(sum_over(self.comm, float(np.sum(nodal**2)))))

    def largest_pressure(self) -> float:
        """Largest nominal contact pressure at an integration point (Pa), collective."""
        return max_over(self.comm, float(self.state.p.max(initial=0.0)))

    def contact_area(self) -> float:
        """Current area of the closed part of the contactor (m²; length × thickness in the plane), collective."""
        points = self.integration
        current = np.linalg.norm(points.normals(points.tangents(self.kinematics.nodes())), axis=1)
        area = (points.weight * points.thickness * current)[self.state.status != OPEN]
        return sum_over(self.comm, float(area.sum()))

    def closed_fraction(self) -> float:
        """Closed part of the contactor's reference area, collective."""
        return self._share(self.state.status != OPEN)

    def stick_fraction(self) -> float:
        """Sticking part of the contactor's reference area, collective."""
        return self._share(self.state.status == STICK)

    def _share(self, points: NDArray[np.bool_]) -> float:
        return sum_over(self.comm, float(self.j[points].sum())) / self.area

    def coarse_integration(self) -> Finding | None:
        """Where closed Gauss points lie farther apart than the target facets they face are long (collective)."""
        if self.segments is not None:
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
        target's facets that it faces, in the mean over what is closed (collective)."""
        if self.target.is_rigid or self.target.is_contactor or self.stiffness_ratio <= STIFFER:
            return None
        closed = np.flatnonzero(self.state.status != OPEN)
        facets, j = self.integration.facets, self.j[closed]
        extents = facets.areas() ** (1.0 / facets.shape.dim)
        own = self.multiplier.shape.spacing * extents[self.integration.facet[closed]]
        theirs = self.target.spacing * self.target.extents[self.at.point.facet[closed]]
        mine, others = sum_over(self.comm, np.array([j @ own, j @ theirs]))
        ratio = float(mine / others) if others > 0 else 1.0
        return (
            Finding(f"{self.name}: multiplier's spacing over the target's", ratio, (), FINE, False)
            if ratio < ALIKE
            else None
        )

    def prescribed_overlap(self) -> Finding | None:
        """Where both surfaces are prescribed and overlap, so that no contact force can part them (collective)."""
        g = np.where(self._prescribed_facets[self.integration.facet] & self.at.facing, self.at.g, -np.inf)
        k = int(np.argmax(g)) if len(g) else -1
        mine = (float(g[k]), tuple(self.points()[k].tolist())) if len(g) else (-np.inf, ())
        value, X = max(self.comm.allgather(mine))
        return (
            Finding(f"{self.name}: overlap (m)", value, X, OVERLAP, True) if value > SHARE * self.target.size else None
        )

    def overlap_in_contact(self) -> Finding | None:
        """Where closed points lie deep in the target while ε g, in place of multipliers, is a good part of the contact force
        (collective)."""
        closed = np.flatnonzero(self.state.status != OPEN)
        facets, g, j = self.integration.facets, self.at.g[closed], self.j[closed]
        own = (facets.areas() ** (1.0 / facets.shape.dim))[self.integration.facet[closed]]
        theirs = 0.0 if self.target.is_rigid else self.target.extents[self.at.point.facet[closed]]
        depth = g / np.maximum(own, theirs)
        k = int(np.argmax(depth)) if len(depth) else -1
        is_finer = (own > theirs) & (not self.target.is_rigid) & (not self.target.is_contactor)
        here = (tuple(self.points()[closed[k]].tolist()), bool(is_finer[k])) if len(depth) else ((), False)
        value, X, may_swap = max(self.comm.allgather((float(depth.max(initial=-np.inf)), *here)))
        by_overlap = j @ np.abs(g) * self.epsilon.normal
        borne, total = sum_over(self.comm, np.array([by_overlap, j @ self.state.p[closed]]))
        if value < OVERLAPS or borne < BY_OVERLAP * total:
            return None
        says = DEEP + SWAP if may_swap else DEEP
        return Finding(f"{self.name}: overlap in contact (facets)", value, X, says, False)

    def turned_force(self) -> Finding | None:
        """By how much contact's forces are off the target's normal in the mean, as a share of them, where the contactor turns
        more than the target does over a facet, as at a rounded corner on a flat surface (collective). There ν = −𝐧 is that of
        coarse facets; where the target turns more, as its corner on a flat contactor, 𝐧 is the better one."""
        if not isinstance(self.target, DeformableTarget) or not self.target.uses_rays or self.target.is_contactor:
            return None
        closed = np.flatnonzero(self.state.status != OPEN)
        at, facet = self.at.take(closed), self.integration.facet[closed]
        normal = surface_normal(at.a)
        normal /= (np.sqrt(dot(normal, normal)) * np.where(dot(normal, at.ν) < 0, -1.0, 1.0))[:, None]
        pressed = self.j[closed] * self.state.p[closed]
        turns = self._contactor.turns[self._own[facet]] > self.target.surface.turns[at.point.facet]
        mine = np.append((pressed * turns) @ (at.ν - normal), pressed.sum())
        force = sum_over(self.comm, mine)
        share = float(np.linalg.norm(force[:-1]) / force[-1]) if force[-1] > 0 else 0.0
        if share < TURNED:
            return None
        return Finding(f"{self.name}: share of the force that is off the target's normal", share, (), BY_NORMALS, False)

    def patches(self) -> Finding | None:
        """What is open amid a contact of many facets, as a share of it, where straight facets of curved surfaces leave larger
        gaps than the pressure closes (collective). A contact that ends where the surfaces part has open points in its last
        facets alone, or is a first touch of few."""
        contactor, facet = self._contactor, self._own[self.integration.facet]
        if self.target.is_contactor:
            return None
        closed = self.state.status != OPEN
        touched = np.zeros(len(contactor.facets))
        touched[facet[closed]] = 1.0
        self.comm.Allreduce(MPI.IN_PLACE, touched, MPI.MAX)
        amid = contactor.amid(touched > 0, HOLES)
        j = np.where(amid[facet], self.j, 0.0)
        needed = j @ (self._sagittas() * self.epsilon.normal)
        whole, open_, needed, borne = sum_over(self.comm, np.array([j.sum(), j @ ~closed, needed, j @ self.state.p]))
        few = np.sum(amid) < MANY ** (self.gdim - 1)
        if few or open_ <= PATCHY * whole or not needed > borne > 0.0:
            return None
        return Finding(f"{self.name}: open share amid the contact", float(open_ / whole), (), PATCHES, False)

    def ripples(self) -> Finding | None:
        """Mean size of the gaps on facets that are closed altogether, if they are many, as a share of the longer facet,
        beside those that straight facets of curved surfaces leave (collective)."""
        facet, closed = self.integration.facet, self.state.status != OPEN
        whole = np.ones(self.integration.facets.size, dtype=bool)
        whole[facet[~closed]] = False
        within = whole[facet]
        own = (self.integration.facets.areas() ** (1.0 / self.integration.facets.shape.dim))[facet]
        longer = own if self.target.is_rigid else np.maximum(own, self.target.extents[self.at.point.facet])
        j = np.where(within, self.j, 0.0)
        off = j @ np.where(within, np.maximum(np.abs(self.at.g) - self._sagittas(), 0.0) / longer, 0.0)
        count, area, off = sum_over(self.comm, np.array([whole.sum(), j.sum(), off]))
        if count < MANY ** (self.gdim - 1) or off <= RIPPLED * area:
            return None
        return Finding(f"{self.name}: mean gap in contact (facets)", float(off / area), (), RIPPLES, False)

    def _sagittas(self) -> Array:
        """(n,) how far the straight facets at the points, or those that they face, fall short of curved surfaces (m)."""
        short = self._contactor.sagittas[self._own[self.integration.facet]]
        if not isinstance(self.target, DeformableTarget):
            return short
        return np.maximum(short, self.target.surface.sagittas[self.at.point.facet])

    def _last_points(self) -> NDArray[np.bool_]:
        """(n,) the points next to an end of the contactor."""
        points = self.integration
        weight = (points.N * self._at_end[points.facet]).sum(axis=1)
        nearest = np.zeros(points.facets.size)
        np.maximum.at(nearest, points.facet, weight)
        near: NDArray[np.bool_] = (weight > 0.5) & (weight >= nearest[points.facet] - 1e-9)
        return near

    def reaches_end(self) -> bool:
        """Whether a point is closed at the very end of the contactor or of the target (collective)."""
        closed = self.state.status != OPEN
        facets = self.target.facets[self.at.point.facet]
        at_end = self._last_points() | (np.einsum("nk,nk->n", self.at.N, self.target.end_nodes[facets]) > 1 - AT_END)
        return any_over(self.comm, (closed & at_end).any())
