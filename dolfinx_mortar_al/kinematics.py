"""What the law needs to know of a pair's points: positions, projection, slip, their variation, and where forces act.

Two strategies of one interface: :class:`PositionLevel` (statics: gap and slip of the present positions) and
:class:`~dolfinx_mortar_al.step_level.StepLevel` (impact: gap at the end of a time step, slip over it).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.carried import carried, components, vary_carried
from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.last_step import LastStep
from dolfinx_mortar_al.law import OPEN, STICK, Coulomb, Frictionless, LawState
from dolfinx_mortar_al.projection import Projection, TargetPoint, combine, dot
from dolfinx_mortar_al.rays import RayHit
from dolfinx_mortar_al.targets import ContactorPoints, DeformableTarget, Target
from dolfinx_mortar_al.variation import Slots, Variation, vary, vary_cosine

__all__ = ["Forces", "Kinematics", "PositionLevel", "contactor_points"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

ROUNDS = 3  # in which a way over a curved surface is found: it and its chord differ by the square of way over radius
AT_NODE = 1e-9  # share of the other nodes where a point of the target is one of its nodes
# Of a gap's turn, what the target's facet says; the contactor's says the rest: half each, so that two bodies that mirror each
# other have no slip (docs/theory.md).
SHARE = 0.5
ROUND_OFF = 4e-16  # of gaps, which are differences of sums, as a share of the distance from the origin


@dataclass
class Forces:
    """Nominal forces on one body and the other at n points (Pa; Pa m on tangents).

    Attributes:
        contactor: (n, gdim) on 𝐱; target: (n, gdim) on the point faced.
        tangents: (n, dim, gdim) on the contactor's 𝐚₁_α, couples that keep angular momentum; None if there are none.
    """

    contactor: Array
    target: Array
    tangents: Array | None = None


@dataclass(frozen=True)
class Approach:
    """How open points came nearer to the target in the last step, from which it is known when they will touch.

    Attributes:
        points: that `g` is known at; g: (n,) the penetration where that step ended, minus the reach where nothing was faced
            (m).
        nearer: (n,) by how much it grew, 0 at points that are closed or go away (m); drift: (n, gdim) the slip meanwhile (m).
    """

    points: IntegrationPoints
    g: Array
    nearer: Array
    drift: Array

    @classmethod
    def none(cls, points: IntegrationPoints, reach: float) -> Approach:
        n, gdim = points.size, points.facets.X.shape[2]
        return cls(points, np.full(n, -reach), np.zeros(n), np.zeros((n, gdim)))

    def at(self, origin: Index) -> Approach:
        """Of other points, to which those with the numbers `origin` (n,) are the nearest."""
        return replace(self, nearer=self.nearer[origin], drift=self.drift[origin])


class Kinematics(ABC):
    """A pair's points as they move.

    Args:
        points: of integration on the contactor.
        u: displacement of the contactor's body; ghosts are up to date.
        target: what the points face.
        friction: whether a slip is kept.
        reach: largest distance of a point of either side from the origin (m).

    Attributes:
        x: (n, gdim) contactor points now (m); at: what they face; s: (n, gdim) slip increment (m), None without friction.
        may_close: (n,) points that contact may take part in at all.
        reach: as above.
        history: (n,) the target's points Y_{n−1} that the slip is counted from.
        ρ: (n, gdim) 𝐱 − φ₂(Y_{n−1}) of step n − 1 in the target's frame there (`carried.py`), 0 where it is not needed.
        offset: (n,) depth from which the law counts a point's penetration (m): that at which a time step brought it into
            sight (`step_level.py`), infinite where it takes no part; zero in statics.
        last: where the last step ended, at the points it had.
        share: (n,) how far each point counts in the multiplier's equation.
        unspent: (n, gdim − 1) slip that a time step has left to the next (m), `step_level.py`; zero in statics.
    """

    x: Array
    at: Projection
    s: Array | None
    may_close: Bool

    def __init__(
        self, points: IntegrationPoints, u: fem.Function, target: Target, friction: bool, reach: float
    ) -> None:
        self.points, self.target, self.friction, self.reach = points, target, friction, reach
        self._reach_at_start = reach
        self._u = u
        self.offset: Array = np.zeros(points.size)
        self.share: Array = np.ones(points.size)
        self.unspent: Array = np.zeros((points.size, points.facets.X.shape[2] - 1))
        self.history = TargetPoint(np.zeros(points.size, dtype=np.int64), np.zeros((points.size, points.η.shape[1])))
        self.ρ: Array = np.zeros((points.size, points.facets.X.shape[2]))
        self.last = LastStep.none(points, self.history, self.ρ)

    def reach_on(self, way: float) -> None:
        """Points may be `way` (m) from their reference positions from now on: bodies fly far, and round-off grows."""
        start = self._reach_at_start
        self.reach = start if way <= start else start + way

    @property
    def round_off(self) -> float:
        """Of gaps and slips, which are differences of positions (m)."""
        return ROUND_OFF * self.reach

    @property
    def touch(self) -> float:
        """Gaps below count as none (m)."""
        return max(1e-12 * self.target.size, self.round_off)

    # ---------------------------------------------------------------- where the contactor is

    def nodes(self) -> Array:
        """(nf, nodes, gdim) present positions of the contactor's facets' nodes (m)."""
        facets = self.points.facets
        return np.asarray(facets.X + self._u.x.array.reshape(-1, facets.X.shape[2])[facets.dofs])

    def positions(self) -> Array:
        """(n, gdim) present positions of the points (m)."""
        return self.points.interpolate(self.nodes())

    def contactor(self, nodes: Array | None = None) -> ContactorPoints:
        """The points with the contactor's normals and tangents, now or with the nodes (nf, nodes, gdim) elsewhere."""
        return contactor_points(self.points, self.nodes() if nodes is None else nodes)

    # ---------------------------------------------------------------- the present state

    @abstractmethod
    def evaluate(self) -> None:
        """Bring x, at and s up to date with the displacements."""

    @abstractmethod
    def count(self) -> None:
        """Bring the shares up to date with what points face."""

    def follow(self) -> bool:
        """At the start of an iteration: choose anew what is held in between; whether anything changed."""
        return False

    @property
    def normals(self) -> Array | None:
        """(n, gdim) the multiplier's normal direction at the points, where it is held while an iteration goes on; None where
        it turns with the unknowns."""
        return None

    # ---------------------------------------------------------------- forces, and their derivative

    @abstractmethod
    def slots(self, multiplier: int) -> Slots:
        """The variations that the forces depend on; `multiplier` is its number of components."""

    @abstractmethod
    def forces(self, state: LawState) -> Forces:
        """Where the tractions of the law act, and how."""

    @abstractmethod
    def linearise(
        self, law: Frictionless | Coulomb, state: LawState, Λ: Array, act: Index, slots: Slots
    ) -> tuple[Array, Array]:
        """Derivatives, at the points `act`, of what the virtual displacements' operators (:meth:`rows`) are multiplied with
        (n, rows, gdim, z), and of the multiplier's residual (n, components, z); `state` and `Λ` are those of `act`."""

    @abstractmethod
    def rows(self, act: Index) -> Array:
        """(n, rows, nodes of the contactor's and the target's facet) shape functions of the virtual displacements."""

    @abstractmethod
    def columns(self, act: Index) -> Array:
        """(n, slots, nodes) shape functions of the slots, on the rows' nodes and on those of `extra`."""

    @property
    @abstractmethod
    def extra(self) -> TargetPoint | None:
        """(n,) points of the target on whose nodes the law depends besides those that the forces act on."""

    def traction(self, state: LawState) -> Array:
        """(n, gdim) nominal traction on the contactor (Pa)."""
        return -self.forces(state).contactor

    def _shape_rows(self, act: Index, count: int) -> tuple[Array, int, int]:
        """Zeros for `count` operators, with N1 and N2 in the first two; the number of the contactor's nodes, and of all."""
        N1, at = self.points.N[act], self.at.take(act)
        k1, k = N1.shape[1], N1.shape[1] + at.N.shape[1]
        B = np.zeros((len(act), count, k))
        B[:, 0, :k1], B[:, 1, k1:] = N1, at.N
        return B, k1, k

    # ---------------------------------------------------------------- slip history

    @property
    def faced(self) -> Projection:
        """What the points face in the present positions."""
        return self.at

    def take(self, points: IntegrationPoints, origin: Index, contactor: Array, target: Array) -> None:
        """Other points from now on, to which the former ones `origin` (n,) are the nearest. Where that is another place, what
        they faced when the last step had converged is found anew, with the nodes of contactor (nf, nodes, gdim) and target
        (nodes, gdim) where they were then (m): history belongs to the bodies, not to the points."""
        moved = np.flatnonzero((self.points.η[origin] != points.η).any(axis=1))
        self.points, self.share = points, self.share[origin]
        self.offset, self.unspent = self.offset[origin], self.unspent[origin]
        point, ρ = TargetPoint(self.history.facet[origin], self.history.η[origin]), self.ρ[origin]
        if self.friction and len(moved):
            stuck, kept, ρ[stuck] = self.last.kept_at(points, moved)
            point.facet[stuck], point.η[stuck] = kept.facet, kept.η
            anew = np.setdiff1d(moved, stuck)
            then = contactor_points(points, contactor).at(anew)
            found, facing = self.target.faced(then, target)
            point.facet[anew], point.η[anew] = found.facet, found.η
            apart = self.apart(found, facing, then.x, target, self.last.owed_at(points, anew))
            ρ[anew] = 0.0 if apart is None else apart
        self.set_history(point, ρ)

    def commit(self, unspent: Array | None, status: NDArray[np.int8], closest: TargetPoint | None = None) -> None:
        """The step has converged: Y_{n−1} ← Y, from which the slip (n, gdim) that is `unspent` (m) goes on where points are
        closed; those that stick, by `status` (n,), keep the Y from which they do, so that nothing adds up however often they
        are moved to and fro. `closest`: (n,) the closest points, where they are known."""
        if unspent is not None:
            unspent = np.where((status == OPEN)[:, None], 0.0, unspent)
        point = self.slips_on_from(unspent)
        lost = np.flatnonzero(~self.faced.facing)
        if self.friction and len(lost):  # the slip of what comes back is counted from the nearest point
            near = self.target.closest(self.x[lost]).point if closest is None else closest.take(lost)
            point.facet[lost], point.η[lost] = near.facet, near.η
        ρ = self.apart(point, self.faced.facing, self.x, self.target.nodes, unspent)
        stuck = status == STICK
        point.facet[stuck], point.η[stuck] = self.history.facet[stuck], self.history.η[stuck]
        if ρ is not None:
            ρ[stuck] = self.ρ[stuck]
        self.set_history(point, ρ)
        self.last = LastStep(self.points, self.history, self.ρ, np.zeros_like(self.ρ), stuck)

    def slips_on_from(self, unspent: Array | None) -> TargetPoint:
        """(n,) the target's points Y that slip is counted from after a step that has left a slip (n, gdim) `unspent` (m)."""
        return self.faced.point.copy()

    def apart(
        self, point: TargetPoint, facing: Bool, x: Array, nodes: Array, unspent: Array | None = None
    ) -> Array | None:
        """(n, gdim) ρ of points at 𝐱 (n, gdim) that take Y = `point` for their history, the target's nodes at `nodes` (m),
        with a slip `unspent`."""
        return None

    def history_at_points(self) -> dict[str, Array]:
        """What a step may change of the above, by name."""
        return {
            "history_facet": self.history.facet.astype(float),
            "history_η": self.history.η.copy(),
            "ρ": self.ρ.copy(),
            "offset": self.offset.copy(),
            "unspent": self.unspent.copy(),
            "owed": self.last.owed_at(self.points),
            "stuck": self.last.stuck_at(self.points).astype(float),
        }

    def restore_history(self, saved: dict[str, Array]) -> None:
        """As it was at these points."""
        point = TargetPoint(saved["history_facet"].astype(np.int64), saved["history_η"].copy())
        self.set_history(point, saved["ρ"].copy())
        self.offset, self.unspent = saved["offset"].copy(), saved["unspent"].copy()
        stuck = saved["stuck"].astype(bool)
        self.last = LastStep(self.points, self.history, self.ρ, saved["owed"].copy(), stuck)

    def set_history(self, point: TargetPoint, ρ: Array | None = None) -> None:
        """Count the slip from these material points of the target, and from ρ (n, gdim) apart from them."""
        self.history = point
        self.weights: Array = self.target.weights(point)
        self.ρ = np.zeros((len(point.facet), self.target.dim + 1)) if ρ is None else ρ
        self.slopes: Array = self.target.derivatives(point) if self.carries else np.zeros(0)

    @property
    def carries(self) -> bool:
        """Whether the slip is counted with ρ."""
        return False

    def positions_of_history(self) -> Array:
        """(n, gdim) where the points Y_{n−1} are now, φ₂(Y_{n−1}, t) (m)."""
        return self.target.positions(self.history, self.weights)


def contactor_points(points: IntegrationPoints, nodes: Array) -> ContactorPoints:
    """Integration points with the contactor's normals and tangents, its nodes at `nodes` (nf, nodes, gdim)."""
    tangents = points.tangents(nodes)
    normal = points.normals(tangents)
    normal /= np.sqrt(dot(normal, normal))[:, None]
    return ContactorPoints(points.interpolate(nodes), normal, tangents, points.facet, points.η)


class PositionLevel(Kinematics):
    """Gap and slip of the present positions: eq. (1) as it stands."""

    #: nodes of the target at which it turns away: what is at a slant is its side to points in whose tangent plane, up to
    #: `level` (m), such a node lies. A multiplier goes on beside a target's corner, and must not press on the side there
    turning_nodes: Index = np.zeros(0, dtype=np.int64)
    level = 0.0
    #: share of points that face nothing
    beyond = 1.0
    #: whether shares stay as they are: at kinks of the target they jump
    holds_shares = False
    # (n,) derivative of the share with respect to the cosine between ray and target's normal
    _slope: Array = np.zeros(0)

    def __init__(
        self, points: IntegrationPoints, u: fem.Function, target: Target, friction: bool, reach: float
    ) -> None:
        super().__init__(points, u, target, friction, reach)
        self.approach = Approach.none(points, reach)

    def take(self, points: IntegrationPoints, origin: Index, contactor: Array, target: Array) -> None:
        super().take(points, origin, contactor, target)
        self.approach = self.approach.at(origin)

    def evaluate(self) -> None:
        self.target.refresh()
        now = self.contactor()
        self.x, self.at = now.x, self.target.project(now)
        if len(self.turning_nodes):
            assert isinstance(self.at, RayHit)
            self._leave_sides(self.at)
        self.may_close = self.at.facing & self.target.admits(now.facet, self.at.point)
        self.s = self.slip() if self.friction else None
        self.count()

    def count(self) -> None:
        if self.beyond < 1.0:
            assert isinstance(self.at, RayHit)
            share, slope = self.at.frontal(self.beyond)
            self.share, self._slope = (self.share, 0.0 * slope) if self.holds_shares else (share, slope)

    @property
    def slanted(self) -> Bool:
        """(n,) points whose share changes with what they face."""
        return np.asarray(self._slope > 0.0)

    def _vary_share(self, at: RayHit, act: Index, δ: Variation, slots: Slots) -> Array:
        """(n, z) variation of the share, over it, of points `act` that face `at`."""
        assert isinstance(self.target, DeformableTarget)
        δcosine = vary_cosine(at, self.target.bends(at.point), δ, slots)
        return δcosine * (self._slope[act] / self.share[act])[:, None]

    def _leave_sides(self, at: RayHit) -> None:
        """Points that see the target's side from beside its face do not face it."""
        slanted = np.flatnonzero(at.facing & ~at.opposed())
        if len(slanted):
            from scipy.spatial import KDTree  # slow to import

            x, corners = self.x[slanted], self.target.nodes[self.turning_nodes]
            height = dot(corners[KDTree(corners).query(x)[1]] - x, at.ν[slanted])
            at.facing[slanted[np.abs(height) <= self.level]] = False

    def slip(self) -> Array:
        """s = V_T Δt, eq. (5): (n, gdim) in m, of which only the tangential part counts. 𝐲 − φ₂(Y_{n−1}, t) with the closest
        point; with rays 𝐱 − φ₂(Y_{n−1}, t) less the mean of 𝐱 − φ₂(Y_{n−1}) of step n − 1 as the target's and as the
        contactor's facet have carried it. The latter is along ν and left out. What is `unspent` is slip from the start."""
        if not self.carries:
            return (self.x if self.target.uses_rays else self.at.y) - self.positions_of_history()
        self._frame = self.target.tangents(self.history, self.slopes)
        return self.x - self.positions_of_history() - carried(self._frame, self.ρ)

    def commit(self, unspent: Array | None, status: NDArray[np.int8], closest: TargetPoint | None = None) -> None:
        drift = self._drift() if self.friction else None
        super().commit(unspent, status, closest)
        if drift is not None:
            self.last = replace(self.last, owed=np.where((status == OPEN)[:, None], 0.0, self.slip()))
            self._remember_approach(drift, status == OPEN)

    def _remember_approach(self, drift: Array, is_open: Bool) -> None:
        """Of open points, how much nearer they have come in the step that has converged, and the slip `drift` (n, gdim)."""
        g = np.where(self.at.facing, self.at.g, -self.reach)
        nearer = np.where(is_open & self.at.facing, np.maximum(g - self._gap_before(), 0.0), 0.0)
        self.approach = Approach(self.points, g, nearer, np.where(nearer[:, None] > 0.0, drift, 0.0))

    def _drift(self) -> Array:
        """(n, gdim) the slip since the last step, as far as it is more than what the turns of the two surfaces leave open,
        which carry a gap along in different ways: where bodies mirror each other, that is all of it."""
        assert self.s is not None
        owed, ν = self.last.owed_at(self.points), self.at.ν
        drift, turned = self.s - owed, carried(self._frame, self.ρ) + owed if self.carries else np.zeros_like(self.ρ)
        drift, turned = (a - ν * dot(ν, a)[:, None] for a in (drift, turned))
        size, doubt = (np.linalg.norm(a, axis=1) for a in (drift, turned))
        sure = np.maximum(size - doubt, 0.0)
        return drift * np.divide(sure, size, out=np.zeros_like(size), where=size > 0.0)[:, None]

    def history_at_points(self) -> dict[str, Array]:
        if not self.friction:
            return super().history_at_points()
        approach = {"gap": self._gap_before(), "nearer": self.approach.nearer, "drift": self.approach.drift}
        return super().history_at_points() | {name: values.copy() for name, values in approach.items()}

    def restore_history(self, saved: dict[str, Array]) -> None:
        super().restore_history(saved)
        if self.friction:
            self.approach = Approach(self.points, *(saved[name].copy() for name in ("gap", "nearer", "drift")))

    def _gap_before(self) -> Array:
        """(n,) the penetration where the last step ended (m)."""
        points, g = self.approach.points, self.approach.g
        return g if points is self.points else points.between(g, self.points.facet, self.points.η)

    def slip_from_touch(self, ratio: float) -> None:
        """Of open points, count the slip of the next step, which is `ratio` times as long as the last one, from where
        they touch in it if all goes on as it did: what they pass in the air is no slip (docs/theory.md)."""
        nearer = self.approach.nearer
        share = np.divide(-self._gap_before(), nearer, out=np.zeros_like(nearer), where=nearer > 0.0)
        air = np.where(share < ratio, np.maximum(share, 0.0), 0.0)[:, None] * self.approach.drift
        if self.carries:
            ρ = self.ρ + components(self.target.tangents(self.history, self.slopes), air)
            self.set_history(self.history, ρ)
        else:
            point = self.history.copy()
            self._move(point, self.positions_of_history(), air)
            self.set_history(point)
        owed, stuck = self.last.owed_at(self.points) - air, self.last.stuck_at(self.points)
        self.last = LastStep(self.points, self.history, self.ρ, owed, stuck)
        self.s = self.slip()

    def slips_on_from(self, unspent: Array | None) -> TargetPoint:
        """Where slip has no ρ to hold what is unspent, Y is as far behind."""
        point = super().slips_on_from(unspent)
        if unspent is not None and not self.carries:
            self._move(point, self.at.y, -unspent)
        return point

    def _move(self, point: TargetPoint, y: Array, way: Array) -> None:
        """Move points of the target, at 𝐲 (n, gdim), over it until the straight way (n, gdim) there is the given one (m), as
        far as that is along the surface at 𝐲."""
        moved = np.flatnonzero(way.any(axis=1))
        start, way, ν = y[moved], way[moved], self.at.ν[moved]
        rest, near = way, start
        for _ in range(ROUNDS):
            at = self.target.closest(near + rest)
            near, rest = at.y, way - (at.y - start)
            rest = rest - ν * dot(ν, rest)[:, None]
        point.facet[moved], point.η[moved] = at.point.facet, at.point.η

    @property
    def carries(self) -> bool:
        return self.friction and self.target.uses_rays

    def apart(
        self, point: TargetPoint, facing: Bool, x: Array, nodes: Array, unspent: Array | None = None
    ) -> Array | None:
        """Zero at points that faced nothing: those that come from beyond the target's end slip from that end on."""
        if not self.carries:
            return None
        r = x - combine(self.target.weights(point), nodes[self.target.facets[point.facet]])
        apart = SHARE * r if unspent is None else SHARE * r - unspent
        ρ = components(self.target.tangents(point, self.target.derivatives(point), nodes), apart)
        return np.where(facing[:, None], ρ, 0.0)

    def slots(self, multiplier: int) -> Slots:
        derivatives = [str(α) for α in range(self.target.dim)]
        own = [f"x,{α}" for α in derivatives] if self.target.uses_rays else []
        old = ["w_p"] if self.friction else []
        old += [f"w_p,{α}" for α in derivatives] if self.carries else []
        names = ["x", "w", *(f"w,{α}" for α in derivatives), *own, *old]
        return Slots(self.target.dim + 1, multiplier, tuple(names))

    def along_facets(self, act: Index, part: Index, slope: Array) -> Array:
        """(n, z) variations of the slots as points `act` move along their facets by δη = 1, the multiplier by its `slope`
        (n, components). History is found anew where they go, so that slip is what it is there, and as a straight line fits
        that of the points of each `part` (n,); what has come from beyond the target's end slips from there, a node of it."""
        points, slots = self.points, self.slots(slope.shape[1])
        _, dN, ddN = points.facets.shape.tabulate(points.η[act], 2)
        nodes = self.nodes()[points.facet[act]]
        a, aη = ((B[:, None] @ nodes)[:, 0] for B in (dN[:, 0], ddN[:, 0, 0]))
        motion = {"x": a, "x,0": aη}
        if self.friction:
            from_end = self.weights[act].max(axis=1) > 1.0 - AT_NODE
            motion["w_p"] = np.where(from_end[:, None], 0.0, a - self._slope_of_slip(act, part, ~from_end))
        return np.concatenate([*(motion.get(name, np.zeros_like(a)) for name in slots.names), slope], axis=1)

    def _slope_of_slip(self, act: Index, part: Index, fits: Bool) -> Array:
        """(n, gdim) ∂s/∂η of points `act` by the straight line that fits best those of each `part` (n,) that face the target
        and are among `fits`."""
        assert self.s is not None
        weight = (fits & self.at.facing[act]).astype(float)

        def mean(values: Array) -> Array:
            total = np.zeros((part.max(initial=-1) + 1, *values.shape[1:]))
            np.add.at(total, part, values * weight.reshape(-1, *np.ones(values.ndim - 1, dtype=int)))
            return total

        count = np.maximum(mean(np.ones(len(act))), 1.0)
        η, s = self.points.η[act, 0], self.s[act]
        η = η - (mean(η) / count)[part]
        s = s - (mean(s) / count[:, None])[part]
        spread = mean(η**2)
        return (mean(η[:, None] * s) / np.where(spread > 0.0, spread, 1.0)[:, None])[part]

    def forces(self, state: LawState) -> Forces:
        """−∫ t·(N1 U1* − N2(η) U2*) dS₀, eq. (4)."""
        return Forces(-state.t, state.t)

    def linearise(
        self, law: Frictionless | Coulomb, state: LawState, Λ: Array, act: Index, slots: Slots
    ) -> tuple[Array, Array]:
        """δ of −t (on N1 U1*), t (on N2 U2*), and t_i η^α (on N2,α U2*): the moving η moves the test function too."""
        at = self.at.take(act)
        δ = vary(at, slots)
        if self.carries:
            assert δ.s is not None
            δ.s = δ.s - vary_carried(self._frame[act], self.ρ[act], slots, "w_p")
        δt, δr = law.linearise(state, Λ, at, None if self.s is None else self.s[act], δ)
        moving = state.t[:, None, :, None] * δ.η[:, :, None, :]
        if self.beyond < 1.0 and len(k := np.flatnonzero(self.slanted[act])):
            assert isinstance(at, RayHit)
            part = Variation(δ.η[k], δ.g[k], δ.ν[k], δ.Λ, None)
            δr[k] += state.r[k][:, :, None] * self._vary_share(at.take(k), act[k], part, slots)[:, None]
        return np.concatenate([np.stack([-δt, δt], axis=1), moving], axis=1), δr

    def rows(self, act: Index) -> Array:
        """N1; N2, N2,α."""
        B, k1, _ = self._shape_rows(act, 2 + self.target.dim)
        B[:, 2:, k1:] = self.at.dN[act]
        return B

    def columns(self, act: Index) -> Array:
        """The rows' operators; with rays N1,α; with friction N2(η_{n−1}) on the old target facet, with both N2,α there."""
        rows, dim = self.rows(act), self.target.dim
        n, r, k = rows.shape
        old = self.weights[act][:, None] if self.friction else np.zeros((n, 0, 0))
        if self.carries:
            old = np.concatenate([old, self.slopes[act]], axis=1)
        own = dim * self.target.uses_rays
        B = np.zeros((n, r + own + old.shape[1], k + old.shape[2]))
        B[:, :r, :k], B[:, r + own :, k:] = rows, old
        if self.target.uses_rays:
            dN1 = self.points.dN[act]
            B[:, r : r + dim, : dN1.shape[2]] = dN1
        return B

    @property
    def extra(self) -> TargetPoint | None:
        return self.history if self.friction else None
