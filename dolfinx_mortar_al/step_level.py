"""Contact over a time step: the gap at its end, the slip over it, and forces that keep momentum, spin and energy.

A force 𝐅 acts on a contactor point 𝐱 and −𝐅 on a material point 𝐲 of the target, both fixed for the step, with the couple
that makes it power-conjugate to a relative motion 𝐰 which every rigid motion leaves at zero (``docs/impact.md``):

    𝐰 = Δ𝐫 − 𝐀^α Δ𝐚_α,   𝐫 = 𝐱 − 𝐲,   𝐀^α = (𝐚^α·𝐫) 𝐈 − (𝐧·𝐫) 𝐚^α⊗𝐧,

Δ the change over the step, 𝐫, the contactor's tangents 𝐚_α, dual tangents 𝐚^α and normal 𝐧 those of its middle,
(𝐮_n + 𝐮_{n+1})/2. The normal force is p(𝐦̂ + κ𝐰): 𝐦̂ along the target's normal, and κ such that its work is −p times the
change of the penetration g, whatever the path (a discrete gradient after Gonzalez, DOI 10.1007/BF02440162).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.kinematics import Forces, Kinematics
from dolfinx_mortar_al.law import OPEN, STICK, Coulomb, Frictionless, LawState
from dolfinx_mortar_al.lever import Lever
from dolfinx_mortar_al.obstacles import Pose
from dolfinx_mortar_al.projection import Projection, TargetPoint, dot
from dolfinx_mortar_al.rays import DEEP
from dolfinx_mortar_al.swept import DEPTH, passed_obstacle, passed_through
from dolfinx_mortar_al.targets import DeformableTarget, Place, RigidTarget
from dolfinx_mortar_al.variation import Slots, Variation, scaled_normal, vary_gap

__all__ = ["Rates", "StepLevel", "StepWork"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

FOLLOWS = 2  # iterations of a solve, after the first, in which points and directions are chosen again
STILL = 1e-3  # of a facet: relative motions below are no direction for κ, which leaves out terms of third order


@dataclass(frozen=True)
class StepWork:
    """Of a pair's tractions in a step, on this rank (J): what the normal and the tangential ones do on both bodies, and what
    a rigid obstacle's motion puts in."""

    normal: float
    tangential: float
    by_obstacle: float


@dataclass(frozen=True)
class Rates:
    """Relative velocities at points `act` (n,) that face target facets `facet` (n,), in the multiplier's components m.

    Attributes:
        G: (n, m, z) of the slots, which are B (n, slots, nodes) times nodal velocities.
        H: (n, m, z) what impulses are conjugate to: where points slip along the step's traction, so that the sum of both
            stays on Coulomb's cone.
        free: (n, m, m) projector onto the components without a condition.
        normals: (all points, gdim) that the components' normal part is along; None without friction.
        carried: (n, m) Δt × the part of G that a rigid obstacle's velocity makes; swept: (n, gdim) its motion (m).
    """

    act: Index
    facet: Index
    G: Array
    H: Array
    B: Array
    free: Array
    normals: Array | None
    carried: Array
    swept: Array


class StepLevel(Kinematics):
    """Kinematics of a time step from 𝐮_n to 𝐮_{n+1}.

    Eq. (1) holds with the penetration at the end of the step and the relative motion 𝐰 over it in place of the slip.

    Attributes:
        at: the material points that forces act on, with the target's normal there for ν, and the penetration at the end
            of the step for g.
        end: what the points face at the end of the step.
    """

    def __init__(self, before: Kinematics) -> None:
        super().__init__(before.points, before._u, before.target, before.friction, before._reach_at_start)
        self.x, self.at, self.s, self.may_close = before.x, before.at, before.s, before.may_close
        self.offset, self.unspent = before.offset, before.unspent
        self.set_history(before.history)
        self.end = self.pair = self.at
        self._place: Place | None = None
        self._flight: tuple[Array, Array] | None = None
        self._remember()
        self._known: Bool = np.zeros(self.points.size, dtype=bool)
        self._g0: Array = np.zeros(self.points.size)
        self._was_open: Bool = np.zeros(self.points.size, dtype=bool)
        self._closes: Array = np.zeros(self.points.size)
        self._follows = 0
        self._c: Array = np.zeros_like(self.x)  # before the first step tractions are those of the law

    # ---------------------------------------------------------------- a step

    def predict(self) -> None:
        """The bodies are in the middle of their flight: there points and directions are chosen at first, those on a rigid
        target at once, as its pose is another one later."""
        self.target.refresh()
        if self.target.is_rigid:
            self.pair = self.target.project(self.contactor())
        else:
            self._flight = self.nodes(), self.target.nodes

    def begin(self, closed: Bool | None = None, closes: Array | None = None) -> None:
        """The step starts from the present displacements; `closed` and `closes` as in :meth:`excuse`."""
        self.target.refresh()
        self._project()
        if not self.target.is_rigid:
            self.pair = self.end.take(np.arange(self.points.size))
            if self._flight is not None:
                self._choose(*self._flight)
        self._remember()
        self._known, self._g0 = self.end.facing, self.end.g
        n = self.points.size
        self._was_open = np.zeros(n, dtype=bool) if closed is None else ~closed
        self._closes = np.zeros(n) if closes is None else closes
        self._follows = FOLLOWS

    def excuse(self, closed: Bool, closes: Array) -> None:
        """Points that are not `closed` (n,) at the end of a step, though their penetration is beyond that at which the law
        would close them, `closes` (n,) in metres, have come into sight at a depth: from here on theirs counts from there, so
        that to close them gives nothing. What lies deeper than closest points would have to confirm takes no part."""
        depth = np.where(self.end.facing, np.maximum(self.end.g - closes, 0.0), 0.0)
        depth[self.end.g > DEEP * self.target.size] = np.inf
        self.offset = np.where(closed, self.offset, depth)

    def take(self, points: IntegrationPoints, origin: Index, contactor: Array, target: Array) -> None:
        """Other points from now on, for a step from the present displacements; nothing but what is `unspent` is kept from
        step to step."""
        self.points, self._place = points, None
        self.offset, self.unspent, self.share = self.offset[origin], self.unspent[origin], self.share[origin]
        self.begin()
        self.set_history(self.end.point)

    def commit(self, unspent: Array | None, status: NDArray[np.int8], closest: TargetPoint | None = None) -> None:
        """The next step begins here. Of the slip goes on what has not become sliding, for the multipliers of the nodes do not
        see all of it: where a facet is partly closed stuck points would creep if each step forgot it."""
        if unspent is not None:
            self.unspent = np.einsum("nai,ni->na", _axes(self.at.ν, self._now.tangents), unspent)
        self._remember()

    def _project(self) -> None:
        """What the points face now, if anything has moved since the last time."""
        if self._place is None or not self.target.is_at(self._place) or not np.array_equal(self.positions(), self.x):
            self._now, self._place = self.contactor(), self.target.place
            self.x, self.end = self._now.x, self.target.project(self._now)

    def count(self) -> None:
        """All points count in full: the multiplier's space is one and the same in all steps."""

    def follow(self) -> bool:
        """Choose points and directions again, from the middle of the step as the iteration has it now; whether they changed.
        The flight knows nothing of an impact; a few iterations do, and then the choice is held."""
        if self.target.is_rigid or self._follows == 0:
            return False
        self._follows -= 1
        place, before = self.target.place, self._place0
        assert isinstance(place, np.ndarray) and isinstance(before, np.ndarray)
        self._choose((self._nodes0 + self.nodes()) / 2, (before + place) / 2)
        self._relate()
        return True

    def _choose(self, nodes: Array, place: Array) -> None:
        """Take the points and directions of a deformable target with the contactor's nodes (nf, nodes, gdim) and its own
        (nodes, gdim) elsewhere, where something is faced there."""
        there = self.target.project(self.contactor(nodes), place)
        self._adopt(there, np.flatnonzero(there.facing))

    def _remember(self) -> None:
        now = self.contactor()
        self._x0, self._a0, self._place0 = now.x, now.tangents, self.target.place
        self._nodes0 = self.nodes()

    def _adopt(self, at: Projection, where: Index) -> None:
        """Take the points and directions of another projection at some points."""
        for name in ("facing", "N", "dN", "y", "a", "ν", "g"):
            getattr(self.pair, name)[where] = getattr(at, name)[where]
        self.pair.point.facet[where], self.pair.point.η[where] = at.point.facet[where], at.point.η[where]

    def evaluate(self) -> None:
        self.target.refresh()
        self._project()
        self._relate()

    def _relate(self) -> None:
        """The relative motion over the step, and what the law sees of it."""
        now = self._now
        unpaired = np.flatnonzero(self.end.facing & ~self.pair.facing & (self.end.g >= -self.touch))
        if len(unpaired):  # contact that the prediction did not see
            self._adopt(self.end, unpaired)
        pair = self.pair
        m = scaled_normal(pair)
        cos = 1.0 / np.linalg.norm(m, axis=1)
        ν = np.where(pair.facing[:, None], m * cos[:, None], pair.ν)
        self._m = m
        r0 = self._x0 - self.target.positions(pair.point, pair.N, self._place0)
        r1 = now.x - self.target.positions(pair.point, pair.N)
        self._w = r1 - r0
        if not self.target.is_rigid:
            a = (self._a0 + now.tangents) / 2
            self.lever = Lever.of(a, self.points.normals(a), (r0 + r1) / 2)
            self._Δa = now.tangents - self._a0
            self._w = self._w - self.lever.carry(self._Δa)
        admitted = self.target.admits(self.points.facet, self.end.point)
        self._q = dot(self._w, self._w) + (STILL * self.target.size) ** 2
        before = self.end.g + dot(m, self._w)  # the penetration at the start, of what is faced at the end
        miss = before - self._g0
        same = self._known & (np.abs(miss) <= np.sqrt(self._q))
        late = self._was_open & ~same & (before > self._closes)
        self.may_close = self.end.facing & pair.facing & admitted & ~late & np.isfinite(self.offset)
        g = self.end.g - self.offset
        self.at = Projection(pair.point, self.may_close, pair.N, pair.dN, pair.y, pair.a, ν, g)
        if self.friction:
            self.s = self._w + np.einsum("nai,na->ni", _axes(ν, self._a0), self.unspent)
        self._κ = np.where(same & self.may_close, -miss / self._q, 0.0)
        self._c = m - ν + self._κ[:, None] * self._w

    @property
    def faced(self) -> Projection:
        return self.end

    @property
    def normals(self) -> Array | None:
        return self.at.ν if self.friction else None

    def passed_through(self, state: LawState) -> Bool:
        """(n,) open points that the step has carried into the target or through it."""
        free = np.flatnonzero(state.status == OPEN)
        passed = np.zeros(len(state.status), dtype=bool)
        if isinstance(self.target, DeformableTarget):
            places = self._place0, self.target.place
            before, after = (place for place in places if isinstance(place, np.ndarray))
            depth = DEPTH * self.target.size
            x0, counts = self._x0[free], self.target.crossable(self._now, free)
            passed[free] = passed_through(self.target.surface, before, after, x0, self.x[free], depth, counts)
        elif isinstance(self.target, RigidTarget):
            assert isinstance(self._place0, Pose)
            depth = DEPTH * self.target.size
            passed[free] = passed_obstacle(self.target.obstacle, self._place0, self._x0[free], self.x[free], depth)
        return passed

    # ---------------------------------------------------------------- forces

    def slots(self, multiplier: int) -> Slots:
        own = () if self.target.is_rigid else tuple(f"x,{α}" for α in range(self.target.dim))
        return Slots(self.target.dim + 1, multiplier, ("x", "w", *own, "w_e"))

    def _total(self, state: LawState, act: Index | None = None) -> Array:
        """(n, gdim) 𝐅 = 𝐭 + p(𝐦̂ − ν + κ𝐰) at all points, or those `act` whose `state` it is."""
        return np.asarray(state.t + state.p[:, None] * (self._c if act is None else self._c[act]))

    def forces(self, state: LawState) -> Forces:
        F = self._total(state)
        return Forces(-F, F, None if self.target.is_rigid else self.lever.transposed(F))

    def traction(self, state: LawState) -> Array:
        return self._total(state)

    def work(self, state: LawState, j: Array) -> StepWork:
        """What the tractions did in the step; j (n,) weights (m²)."""
        total = float(j @ dot(self._total(state), self._w))
        friction = float(j @ dot(state.t - state.p[:, None] * self.at.ν, self._w))
        by_obstacle = 0.0
        if self.target.is_rigid:
            moved = self.target.positions(self.pair.point, self.pair.N) - self.target.positions(
                self.pair.point, self.pair.N, self._place0
            )
            by_obstacle = float(j @ dot(self._total(state), moved))
        return StepWork(total - friction, friction, by_obstacle)

    def linearise(
        self, law: Frictionless | Coulomb, state: LawState, Λ: Array, act: Index, slots: Slots
    ) -> tuple[Array, Array]:
        """δ of −𝐅 (on N1 U1*), 𝐅 (on N2 U2*) and (𝐀^α)ᵀ𝐅 (on N1,α U1*)."""
        at, w, κ, q = self.at.take(act), self._w[act], self._κ[act], self._q[act]
        n, z, d = len(act), slots.size, slots.gdim
        δr = slots.slot("x") - slots.slot("w")
        δw = np.broadcast_to(δr, (n, d, z))
        if not self.target.is_rigid:
            lever, δa = Lever(*(v[act] for v in vars(self.lever).values())), slots.derivatives("x")
            varied = lever.vary(δa / 2, δr / 2)  # the lever is that of the middle
            δw = δw - lever.carry_map(δa) - lever.vary_carry(self._Δa[act], varied)
        δg = vary_gap(self.end.take(act), slots, "w_e")
        δ = Variation(np.zeros((n, 0, z)), δg, np.zeros((n, d, z)), slots.multiplier_slot()[None], δw)
        δt, δresidual = law.linearise(state, Λ, at, None if self.s is None else self.s[act], δ)
        δp = np.einsum("ni,niz->nz", at.ν, δt)
        turn = np.einsum("ni,niz->nz", w, δw)
        on = (κ != 0.0)[:, None]
        δκ = on * (-(δg + np.einsum("ni,niz->nz", self._m[act], δw)) - 2 * κ[:, None] * turn) / q[:, None]
        p = state.p[:, None, None]
        δF = δt + self._c[act][:, :, None] * δp[:, None] + p * (w[:, :, None] * δκ[:, None] + κ[:, None, None] * δw)
        C = np.stack([-δF, δF], axis=1)
        if not self.target.is_rigid:
            F = self._total(state, act)
            on_tangents = lever.transposed_map(δF) + lever.vary_transposed(F, varied)
            C = np.concatenate([C, on_tangents], axis=1)
        return C, δresidual

    def rows(self, act: Index) -> Array:
        """N1; N2; N1,α."""
        own = 0 if self.target.is_rigid else self.target.dim
        B, k1, _ = self._shape_rows(act, 2 + own)
        if own:
            B[:, 2:, :k1] = self.points.dN[act]
        return B

    def columns(self, act: Index) -> Array:
        """The rows' operators, and N2 on the facet faced at the end."""
        rows, end = self.rows(act), self.end.N[act]
        n, r, k = rows.shape
        B = np.zeros((n, r + 1, k + end.shape[1]))
        B[:, :r, :k], B[:, r, k:] = rows, end
        return B

    @property
    def extra(self) -> TargetPoint | None:
        return self.end.point

    # ---------------------------------------------------------------- velocities at the end of the step

    def rates(self, state: LawState, hold: Bool, drag: bool) -> Rates:
        """Relative velocities at the end of the step that persistent contact does not allow: normal ones at closed points,
        tangential ones too where they stick and `hold` (n,) says so. Impulses where points slip have a tangential part if
        there is `drag`."""
        act = np.flatnonzero((state.status != OPEN) & (state.p > 0))
        end, d = self.end.take(act), self.target.dim + 1
        own = () if self.target.is_rigid else tuple(f"x,{α}" for α in range(self.target.dim))
        slots = Slots(d, 0, ("x", "w", *own))
        N1 = self.points.N[act]
        k1 = N1.shape[1]
        B = np.zeros((len(act), len(slots.names), k1 + end.N.shape[1]))
        B[:, 0, :k1], B[:, 1, k1:] = N1, end.N
        if own:
            B[:, 2:, :k1] = self.points.dN[act]
        swept: Array = np.zeros((len(act), d))
        if self.target.is_rigid:
            assert isinstance(self.target, RigidTarget) and isinstance(self._place0, Pose)
            swept = self.target.obstacle.sweep(end.y, self._place0)
        part = -vary_gap(end, slots, "w")
        if not self.friction:
            one, none = part[:, None], np.zeros((len(act), 1, 1))
            return Rates(act, end.point.facet, one, one, B, none, None, dot(end.ν, swept)[:, None], swept)
        slide = np.broadcast_to(slots.slot("x") - slots.slot("w"), (len(act), d, slots.size))
        if own:
            now = self.contactor()
            lever = Lever.of(now.tangents[act], now.normal[act], now.x[act] - end.y)
            slide = slide - lever.carry_map(slots.derivatives("x"))
        νν = end.ν[:, :, None] * end.ν[:, None]
        held = (hold & (state.status == STICK))[act, None, None]
        P = (np.eye(d) - νν) * held
        f = (state.p[:, None] * self.at.ν - state.t)[act] / state.p[act, None]
        along = part - np.einsum("ni,niz->nz", f * (drag & ~held[:, 0]), slide)
        G, H = (P @ slide + end.ν[:, :, None] * normal[:, None] for normal in (part, along))
        normals, moved = self.at.ν.copy(), ((P + νν) @ swept[:, :, None])[:, :, 0]
        normals[act] = end.ν
        return Rates(act, end.point.facet, G, H, B, np.eye(d) - P - νν, normals, moved, swept)


def _axes(ν: Array, a: Array) -> Array:
    """(n, gdim − 1, gdim) orthonormal axes across ν (n, gdim), the first as near as may be to the first tangent of `a`
    (n, dim, gdim): vectors with the same components in them turn with the facet and keep their length."""
    first = a[:, 0] - ν * dot(ν, a[:, 0])[:, None]
    size = np.linalg.norm(first, axis=1, keepdims=True)
    first = first / np.where(size > 0.0, size, 1.0)
    return first[:, None] if ν.shape[1] == 2 else np.stack([first, np.cross(ν, first)], axis=1)
