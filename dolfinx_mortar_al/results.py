"""What a pair reports of its present state: forces, fractions, areas, and where."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.augmentation import PairAugmentation
from dolfinx_mortar_al.contact_fields import ContactFields, gathered
from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.kinematics import Kinematics
from dolfinx_mortar_al.law import OPEN, STICK, Augmentation, LawState
from dolfinx_mortar_al.multiplier import MultiplierSpace
from dolfinx_mortar_al.projection import Projection
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over
from dolfinx_mortar_al.targets import Target
from dolfinx_mortar_al.validation import vector

__all__ = ["PairResults"]

Array = NDArray[np.float64]

AT_END = 0.1  # weight of the other nodes where a point counts as at the target's end


class PairResults:
    """Results of a contact pair.

    Attributes:
        is_segmented: whether facets are cut at all ends of the target's.
        state: what the law says at this rank's points; kinematics: where they are.
    """

    comm: MPI.Intracomm
    name: str
    gdim: int
    integration: IntegrationPoints
    kinematics: Kinematics
    target: Target
    multiplier: MultiplierSpace
    is_segmented: bool
    state: LawState
    _Λ: Array
    augmentation: PairAugmentation
    area: float
    _at_end: NDArray[np.bool_]

    @property
    def epsilon(self) -> Augmentation:
        """ε_N and ε_T as they are."""
        return self.augmentation.parameters

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
        state, faced, at = self.state, self.kinematics.faced, self.at
        closed = (state.status != OPEN)[:, None]
        friction = state.p[:, None] * at.ν - state.t  # f_T of eq. (1), which acts on the target
        slip = np.zeros_like(friction)
        if state.λT_hat is not None:
            # what the law takes for sliding: λ̂_T = f_T + ε_T s
            slip = np.where(closed, (state.λT_hat - friction) / self.epsilon.tangential, 0.0)
            slip[state.status == STICK] = 0.0
        return ContactFields(
            X=self.points(),
            x=self.positions(),
            area=self.j.copy(),
            gap=np.where(faced.facing, -faced.g, np.nan),
            pressure=state.p.copy(),
            traction=np.where(closed, self.kinematics.traction(state), 0.0),
            tangential_traction=np.where(closed, -friction, 0.0),
            slip=slip,
            status=state.status.copy(),
        )

    def fields_on_root(self) -> ContactFields | None:
        """The same at all integration points, in order of X, on rank 0; None on the others (collective)."""
        return gathered(self.fields(), self.comm)

    def force(self) -> Array:
        """(gdim,) resultant of the contact tractions on the contactor (N), collective."""
        return np.asarray(sum_over(self.comm, self.j @ self.kinematics.traction(self.state)))

    def pressing(self) -> float:
        """∫ p dS₀ over the contactor (N), collective: of pressures that balance each other, too."""
        return sum_over(self.comm, float(self.j @ self.state.p))

    def moment(self, about: Sequence[float]) -> Array:
        """Moment of the contact tractions on the contactor about a point (N m; 3 components, or 1 in the plane),
        collective. A rigid obstacle feels the opposite, as it does of :meth:`force`."""
        arm = self.kinematics.x - vector("about", about, self.gdim)
        t = self.j[:, None] * self.kinematics.traction(self.state)
        if self.gdim == 3:
            return np.asarray(sum_over(self.comm, np.cross(arm, t).sum(axis=0)))
        return np.atleast_1d(sum_over(self.comm, float(np.sum(arm[:, 0] * t[:, 1] - arm[:, 1] * t[:, 0]))))

    def stored_energy(self) -> float:
        """∫ (p² − λ_N²)/(2ε_N) dS₀ (J), collective: what the augmentation holds where facets are partly closed. It is the
        potential of the normal contact forces, convex in the gaps and zero where nothing touches."""
        p = np.maximum(self.state.p, 0.0)  # points that count as closed may be apart before a march
        density = (p**2 - self._normal_multiplier() ** 2) / (2 * self.epsilon.normal)
        return sum_over(self.comm, float(self.j @ density))

    def stored_by_friction(self) -> float:
        """∫ (f² − λ_T²)/(2ε_T) dS₀ (J), collective: the same of friction, the potential of stuck points' tractions."""
        if self._Λ.shape[1] == 1:
            return 0.0
        ν = self.at.ν
        f, λT = (v - ν * np.einsum("ni,ni->n", ν, v)[:, None] for v in (self.state.t, self._Λ))
        density = np.einsum("ni,ni->n", f, f) - np.einsum("ni,ni->n", λT, λT)
        return sum_over(self.comm, float(self.j @ density) / (2 * self.epsilon.tangential))

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

    def friction_in_use(self) -> float:
        """The friction that the contact bears, ∫ |t_T| dS₀, over what its pressure allows, ∫ μp dS₀, collective: 1 where all
        of it slides, 0 without friction or pressure."""
        if self.state.bound is None:
            return 0.0
        bound = np.where(
            self.state.status != OPEN, self.state.bound, 0.0
        )  # one that is frozen is there where all is open, too
        ν, t = self.at.ν, self.state.t
        rubs = np.linalg.norm(t - ν * np.einsum("ni,ni->n", ν, t)[:, None], axis=1)
        borne, allowed = sum_over(self.comm, self.j @ np.column_stack([rubs, np.maximum(bound, 0.0)]))
        return float(borne / allowed) if allowed > 0.0 else 0.0

    def _share(self, points: NDArray[np.bool_]) -> float:
        return sum_over(self.comm, float(self.j[points].sum())) / self.area

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
