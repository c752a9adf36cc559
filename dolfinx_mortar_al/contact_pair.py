"""A contact pair: two surfaces, a law, and what it takes to evaluate eq. (4) and its derivative.

A :class:`~dolfinx_mortar_al.contact.Contact` is what the user describes. A :class:`ContactPair` is put together from parts,
each in a module of its own: points (`integration`), their kinematics (`kinematics`), the law (`law`), the active set
(`active_set`), element arrays (`blocks`) and results (`results`).
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.active_set import ActiveSet, Decided
from dolfinx_mortar_al.blocks import Blocks, Tangent
from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.contact import Contact
from dolfinx_mortar_al.corners import SharpCorners
from dolfinx_mortar_al.cut_tangent import CutTangent, tangent_of_cuts
from dolfinx_mortar_al.integration import IntegrationPoints, default_degree, degrees_on, segment_degree
from dolfinx_mortar_al.kinematics import Kinematics, PositionLevel, contactor_points
from dolfinx_mortar_al.law import OPEN, SLIP, Coulomb, LawState, augmented_normal
from dolfinx_mortar_al.monitors import Finding, warn
from dolfinx_mortar_al.multiplier import MultiplierSpace, default_order
from dolfinx_mortar_al.obstacles import Pose
from dolfinx_mortar_al.pair_checks import check_apart, check_behind, check_sides, check_single, depth_behind
from dolfinx_mortar_al.pair_firmness import PairFirmness
from dolfinx_mortar_al.prescribed import PrescribedNodes
from dolfinx_mortar_al.reductions import any_over, max_over, min_over, sum_over
from dolfinx_mortar_al.redundant import RedundantNodes
from dolfinx_mortar_al.segments import UNCOVERED, Segments, ends_of, segments_of
from dolfinx_mortar_al.self_target import SelfTarget
from dolfinx_mortar_al.step_level import StepLevel
from dolfinx_mortar_al.stopwatch import Stopwatch
from dolfinx_mortar_al.surface import Facets, GatheredFacets, Surface
from dolfinx_mortar_al.target_end import TargetEnd
from dolfinx_mortar_al.targets import DeformableTarget, Place, RigidTarget, Target, target_of
from dolfinx_mortar_al.unfelt import Converged, Unfelt

__all__ = ["ContactPair"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]
Decisions = tuple[IntegrationPoints, Decided]

AGAIN = 2  # times that points follow the target's end, or nodes are chosen anew, when a state has converged
ROUGHEST = 5.0  # a friction coefficient beyond that of rubber: on a plane that rises by 79° nothing would slide
NEAR = 2.0  # of the target's facets: gaps that may close in a step
ELSEWHERE = 1e-9  # of them: nodes that were put elsewhere have gone farther, and round-off has not


class ContactPair(PairFirmness):
    """A :class:`Contact` on a displacement space: its state at the last evaluation, slip history and outputs."""

    def __init__(self, contact: Contact, bodies: Bodies, stopwatch: Stopwatch, name: str = "contact") -> None:
        self.contact, self.name = contact, name
        assert contact.thickness is not None  # the problem knows it
        self.thickness = contact.thickness
        self.stopwatch = stopwatch
        self.comm, self.gdim = bodies.comm, bodies.gdim
        #: whether there is friction, or may be
        self.friction = friction = isinstance(contact.friction, fem.Constant) or contact.friction > 0
        #: Coulomb's coefficient as the pair is made
        self.friction_at_start = self.friction_coefficient
        k = bodies.index(contact.contactor.mesh)
        self._body1 = bodies.bodies[k]
        self.facets = Facets.of(contact.contactor, self._body1.space)
        contactor = self.facets.gather()
        self.target = self._make_target(bodies, contactor.size_of_facets)
        self._contactor, self._own = contactor, contactor.places_of(self.facets)
        self.multiplier_order = contact.multiplier_order or default_order(contactor, contact.target)
        self.is_segmented = contact.integration == "segments" and isinstance(self.target, DeformableTarget)
        # points, and the target's facets closest to them at the start
        self._closest_to: tuple[IntegrationPoints, Index] | None = None
        #: Gauss points of whole facets, where λ̂_N is kept from step to step
        self.gauss = self._points(contactor)
        self.integration = self.gauss
        self.area = sum_over(self.comm, float(self.j.sum()))
        self._facet_count = sum_over(self.comm, self.facets.size)
        check_single(name, contact, contactor, self.target)
        check_apart(name, contact, contactor, self.target, self._body1)
        reach = max(bodies.reach(), self.target.reach)
        statics = PositionLevel(self.integration, self._body1.u, self.target, friction, reach)
        self.kinematics: Kinematics = statics
        # points, what the law said and slip in the last step that was committed; (nf, nodes, gdim) where the nodes were (m)
        self._committed: tuple[IntegrationPoints, LawState, Array | None] | None = None
        self._committed_at: Array = np.zeros(0)
        #: (nf, nodes) numbers of the contactor's nodes among all bodies'
        self.contactor_blocks: Index = bodies.nodes(k, self.facets.dofs)
        own = self.facets.space.dofmap.index_map.local_to_global(self.facets.dofs.ravel())
        self._at_end = np.isin(own, contactor.blocks[contactor.end_nodes]).reshape(self.facets.dofs.shape)
        # (nf, nodes, gdim) which components are prescribed
        fixed = self._at_nodes(self._body1.prescribed()) > 0
        self._redundant = RedundantNodes(self.facets, self.target, fixed, friction)
        # (nf, nodes) the contactor's nodes in which the multiplier has no part, as another pair's is there, too
        self._out_as_shared: Bool = np.zeros(self.facets.dofs.shape, dtype=bool)
        redundant = self._redundant.at(self.facets.X)
        #: (nf,) facets whose motion relative to the target is prescribed altogether
        self._prescribed_facets = np.asarray(redundant.all(axis=(1, 2)))
        surface = contact.target if isinstance(contact.target, Surface) else None
        self._prescribed_nodes = PrescribedNodes(contact.contactor, self.target, surface, bodies)
        components = self.gdim if friction else 1
        self.multiplier = MultiplierSpace(self.facets, self.multiplier_order, components, redundant)
        corners = None
        if not self.target.is_contactor:  # at a crease the roles decide, and with equal orders both sides count
            corners = SharpCorners.of(self.facets, contactor, self.multiplier.own, self.comm)
        self.blocks = Blocks(self.integration, self.contactor_blocks, fixed, self.target, self.multiplier, corners)
        self.active = ActiveSet(self.blocks, self.comm)
        self._firmness = 0.0  # what is added to ε lest surfaces ripple (Pa/m)
        self.target_end = self._make_end()
        #: whether points stay where they are, whatever moves
        self.holds_points = False
        self._again = AGAIN
        self.segments = self._make_segments()
        if self.segments is not None:  # in statics they end with the target
            self.segments.fills = np.asarray(self._at_end.any(axis=1))
            statics.beyond = UNCOVERED
            statics.turning_nodes = self.segments.turning_nodes
            statics.level = max(self.target.size, contactor.size_of_facets)
        self._bodies = bodies
        self._doubted = False
        self._unfelt: Unfelt | None = None  # impact does without
        #: surfaces that a pair of the problem names, of this one to begin with
        self.named = [side for side in (contact.contactor, contact.target) if isinstance(side, Surface)]

    # ---------------------------------------------------------------- set-up

    def _make_target(self, bodies: Bodies, size: float) -> Target:
        """The target; `size` (m) of the contactor's facets."""
        contact = self.contact
        if contact.target is None:
            return SelfTarget(contact.contactor, self.facets, bodies)
        return target_of(contact.target, bodies, size, contact.projection == "rays")

    def _at_nodes(self, u: fem.Function) -> Array:
        """(nf, nodes, gdim) values of the contactor's body at its facets' nodes; ghosts are up to date."""
        return np.asarray(u.x.array.reshape(-1, self.gdim)[self.facets.dofs])

    def _points(self, contactor: GatheredFacets) -> IntegrationPoints:
        """The Gauss points on this rank's part of the contactor."""
        contact, order = self.contact, self.multiplier_order
        if order not in (1, self.facets.shape.order):
            raise ValueError(
                f"{self.name}: multiplier_order = {order} for a displacement of order {self.facets.shape.order}: "
                f"take 1{f' or {self.facets.shape.order}' if self.facets.shape.order > 1 else ''}"
            )
        degree = contact.quadrature_degree
        if degree is not None and degree < 2 * order:
            raise ValueError(
                f"{self.name}: quadrature_degree = {degree} has too few points to determine multipliers of order "
                f"{order}; take at least {2 * order}{', or multiplier_order=1' if order > 1 else ''}"
            )
        count = self.facets.size
        if degree is not None and not self.is_segmented:
            return IntegrationPoints.gauss(self.facets, np.full(count, degree), self.thickness)
        degree = default_degree(self.facets, contact.contactor.is_membrane)
        points = IntegrationPoints.gauss(self.facets, np.full(count, degree), self.thickness)
        (faced,) = self._faced(points, self.target.extents)
        degrees = degrees_on(self.facets, degree, faced, contactor)
        return points if (degrees == degree).all() else IntegrationPoints.gauss(self.facets, degrees, self.thickness)

    def _make_segments(self) -> Segments | None:
        """What moves the points: segments, where they are wanted and there is a target with ends of facets, and else the
        target's own end."""
        degree, target, shape = self.contact.quadrature_degree, self.target, self.facets.shape
        if not isinstance(target, DeformableTarget) or not target.uses_rays:
            return None
        if shape.dim == 1 and not self.is_segmented:
            if degree is None:
                degree = default_degree(self.facets, self.contact.contactor.is_membrane)
            return ends_of(target.surface, self.gauss, degree, self.comm)
        least = segment_degree(shape, target.surface.shape, self.multiplier_order)
        if not self.is_segmented:  # polygons are many, and exact with this
            return ends_of(target.surface, self.gauss, least, self.comm)
        return segments_of(self.facets, target.surface, degree or least, self.thickness, self.comm)

    def _make_end(self) -> TargetEnd | None:
        """What holds points to a target that rays may miss."""
        target = self.target
        if not isinstance(target, DeformableTarget) or target.is_contactor or not target.uses_rays:
            return None
        return TargetEnd(target, self.integration.size)

    def _leave_out_redundant(self, contactor: Array, place: Place) -> bool:
        """In statics, let go of the multiplier's nodes that have nothing to enforce with the bodies' nodes at `contactor` and
        `place`, and take those up that have; whether that is a change (collective). Time steps need one space of
        multipliers."""
        if isinstance(self.kinematics, StepLevel) or not isinstance(place, np.ndarray):
            return False
        if not self._redundant.are_elsewhere(contactor, place):
            return False
        return self._leave_out(self._redundant.at(contactor, place))

    def near(self, share: float) -> Bool:
        """(nf, nodes) which of the contactor's nodes lie within a share of their facet's length from the target, in the last
        equilibrium."""
        nodes, length = self._converged.nodes, self.facets.extents()
        apart = self.target.distances(nodes.reshape(-1, self.gdim), self._converged.place)
        return np.asarray(apart.reshape(nodes.shape[:2]) <= share * length[:, None])

    def held(self) -> Bool:
        """(nf, nodes) nodes at which supports leave the multiplier nothing to enforce, in the last equilibrium."""
        return np.asarray(self._redundant.at(*self._last_places()).all(axis=2))

    def leave_out_shared(self, nodes: Bool) -> None:
        """Let the multiplier have no part in these of its nodes (nf, nodes), and in all others that it shares with another
        pair's (collective)."""
        if any_over(self.comm, not np.array_equal(nodes, self._out_as_shared)):
            self._out_as_shared = nodes
            self._leave_out(self._redundant.at(*self._last_places()))

    def _last_places(self) -> tuple[Array, Array | None]:
        """Where redundant nodes are looked for: (nf, nodes, gdim) and (nodes, gdim) nodes of both sides in the last
        equilibrium (m), of a target that deforms; None for its undeformed ones."""
        place = self._converged.place
        if isinstance(self.kinematics, StepLevel) or not isinstance(place, np.ndarray):
            return self.facets.X, None
        return self._converged.nodes, place

    def _leave_out(self, redundant: Bool) -> bool:
        """Extrapolate these (nf, nodes, components) of the multiplier's nodes, and shared ones; whether that is a change
        (collective)."""
        if not self.multiplier.leave_out(redundant | self._out_as_shared[:, :, None]):
            return False
        self._prescribed_facets = np.asarray(redundant.all(axis=(1, 2)))
        self.blocks.renew()
        self.active.renew()
        self._read_multiplier()
        return True

    def nodal_values(self, u: fem.Function) -> Array:
        """(n, gdim) values of a Function of one of the bodies at those of its nodes that the pair's forces act on: of this
        rank's contactor and of the whole target (collective)."""
        mine = [self._at_nodes(u)] if u.function_space is self._body1.space else []
        if isinstance(self.target, DeformableTarget) and self.target.is_of(u):
            mine.append(self.target.at_nodes(u))
        return np.concatenate([values.reshape(-1, self.gdim) for values in [np.zeros((0, self.gdim)), *mine]])

    def _doubt(self, μ: float) -> None:
        """Say once of a coefficient that it is more than that of any surfaces, on rank 0."""
        if μ > ROUGHEST and not self._doubted and self.comm.rank == 0:
            warn(
                f"{self.name}: friction = {μ:g}: of steel it is 0.1 to 0.8, rubber reaches 4; 30 % are written 0.3, an angle "
                "of friction φ is np.tan(φ). The march goes on with it, and next to nothing will slide",
            )
        self._doubted |= μ > ROUGHEST

    def is_elsewhere(self) -> bool:
        """Whether nodes on this rank have been put elsewhere since the last converged state."""
        before, place = self._converged, self.target.place
        ways = [self.kinematics.nodes() - before.nodes]
        if isinstance(place, np.ndarray) and isinstance(before.place, np.ndarray):
            ways.append(place - before.place)
        return any(bool((np.abs(way) > ELSEWHERE * self.target.size).any()) for way in ways)

    def forget(self) -> None:
        """Before a start anew: nothing is known of pressures, as of a new problem's."""
        self.multiplier.field.x.array[:] = 0.0
        self.active.guessed = True

    def start(self) -> None:
        """Project for the first time, or anew; slip is counted from the present state. Points that touch count as closed.

        Raises:
            ValueError: on every rank, if contactor and target face the same way all over: one is the wrong side.
        """
        k = self.kinematics
        self.target.refresh()
        none = np.zeros(self.facets.size, dtype=bool), np.zeros(len(self.target.facets), dtype=bool)
        self._converged = Converged(k.nodes(), self.target.place, *none)
        self.follow_segments()
        closest = self.target.closest(k.positions())
        k.set_history(closest.point)
        k.evaluate()
        k.commit(None, np.full(k.points.size, OPEN, dtype=np.int8), closest.point)
        self._divide()
        self.active.closed = self.touches()
        self.active.begin(self._converged.closed[self.integration.facet])
        self.evaluate()
        self._remember()
        check_sides(self.name, self.contact, k, self.target, closest)
        # whether a point lies before the target or faces none of it
        self._is_in_front = min_over(self.comm, float(depth_behind(closest).min(initial=np.inf))) < -k.touch

    def _divide(self) -> None:
        """Of a surface in contact with itself, choose which parts are contactor. Multipliers of a lower order than the
        displacement are determined by the contactor's side of a crease alone: the target's, open, would pull them to zero."""
        if isinstance(self.target, SelfTarget):
            points, closed = self.integration, self.active.closed
            if self.target.divide(points.facet, self.kinematics.faced, closed, self.comm):
                self.kinematics.evaluate()
            if self.multiplier_order < self.facets.shape.order:
                carries = self.target.role[self.target.own] == 0
                self.blocks.left_out = self.multiplier.touched(carries) & ~carries[:, None]

    def check_behind(self) -> None:
        """Refuse a contactor that has gone through, as :func:`~dolfinx_mortar_al.pair_checks.check_behind` (collective)."""
        if not (self.target.is_contactor or self._is_in_front):
            check_behind(self.name, self.contact, self.facets, self.target, self._body1, self.kinematics.touch)

    # ---------------------------------------------------------------- state

    def begin(self, way: float = 0.0) -> None:
        """A new solve, nodes up to `way` (m) from their reference positions."""
        self.kinematics.reach_on(way)
        if isinstance(self.law, Coulomb):
            self.law = replace(self.law, μ=self.friction_coefficient, noise=self._slip_noise)
            self._doubt(self.law.μ)
        self._leave_out_redundant(self._converged.nodes, self._converged.place)
        self._hold_flat()
        self.blocks.holds_facets = False
        self._hold_shares(False)
        self._divide()
        self.active.begin(self._converged.closed[self.integration.facet])
        if self.target_end is not None:
            self._hold_to_target(self.target_end)
        self._again = AGAIN
        self.begin_again()

    def follow_again(self) -> bool:
        """A state has converged: AGAIN times in a solve, let points that rest though the target's end has moved follow it
        once more, choose the multiplier's nodes anew, ease what holds membranes flat, and let points count as they see the
        target; whether anything is another now (collective). Where cuts alone have moved, as those of segments, it does not
        matter, nor does it help where they move on farther each time."""
        segments = self.segments
        if self._again == 0:
            return False
        eased, freed = self._ease(), self._free_shares()
        chosen = self._leave_out_redundant(self.kinematics.nodes(), self.target.place)
        follows = segments is not None and bool(segments.settles) and segments.lags and not segments.diverges
        if not (eased or freed or chosen or follows):
            return False
        self._again -= 1
        if follows:
            self.begin_again()
        self.evaluate()
        return True

    def begin_again(self) -> None:
        """A solve goes on elsewhere: segments follow closely, as at its start."""
        if self.segments is not None:
            self.segments.begin()

    def evaluate(self) -> None:
        """Projection, slip and law at the displacements and the multiplier field; ghosts are up to date."""
        with self.stopwatch("projection"):
            if not self.holds_points:
                self.follow_segments()
            self._project()
        with self.stopwatch("contact"):
            self._read_multiplier()
            self.apply_law()

    def _project(self) -> None:
        """Projection and slip; in statics a solve holds points to the target beyond its end, unless they follow it."""
        self.kinematics.evaluate()
        if self.target_end is None:
            return
        if self.segments is not None and not self.holds_points:
            self._hold_to_target(self.target_end)
        else:
            self.target_end.hold(self.kinematics)

    def _hold_to_target(self, end: TargetEnd) -> None:
        """From now on the points that face the target, on facets that were in contact, do so beyond its end, too."""
        end.begin(self.kinematics.at.facing & self._converged.closed[self.integration.facet])

    def let_go(self) -> bool:
        """Let points beyond the target's end go, on whatever rank; whether there are any (collective)."""
        gone = self.target_end is not None and self.target_end.let_go()
        if not any_over(self.comm, gone):
            return False
        self._project()
        return True

    def _read_multiplier(self) -> None:
        """The multiplier field at the points, in frames that the kinematics hold."""
        if self.kinematics.normals is not None:
            self.blocks.turn(self.kinematics.normals)
        self._Λ = self.blocks.multiplier_at_points()

    def follow(self) -> bool:
        """At the start of an iteration: let the kinematics choose anew what they hold, and hold membranes flat that are more
        compressed than at the solve's start; whether anything changed (collective)."""
        changed = self.kinematics.follow()
        if changed:
            self._read_multiplier()
        return self._hold_flatter() or changed

    def follow_segments(self) -> bool:
        """Let the segments follow the bodies, as far as points may move: all that is kept at points moves along. Whether they
        did on this rank; the pair is to be evaluated then."""
        if self.segments is None or isinstance(self.kinematics, StepLevel):
            return False
        self.target.refresh()
        before, points = self.integration, self.segments.follow(self.kinematics.nodes(), self.target.nodes)
        if points is not None:
            self._adopt(points)
        return self.integration is not before

    def begin_step(self) -> None:
        """A time step starts from the present displacements. Segments follow the bodies on facets without a closed point; on
        the others they stay, as points that move under pressure would give energy (``docs/impact.md``)."""
        level = self.kinematics
        assert isinstance(level, StepLevel)
        if self.segments is not None:
            self.target.refresh()
            self.segments.forget()
            points = self.segments.follow(level.nodes(), self.target.nodes)
            assert points is not None
            held = self.integration.sum_by_facet(self.active.closed.astype(float)) > 0
            self._adopt(self.integration.spliced(points, held))
            self.evaluate()
            if not self.active.guessed:
                level.excuse(*self._decided())
        level.begin(*self._decided())

    def _decided(self) -> tuple[Bool, Array]:
        """(n,) which points are closed; (n,) the penetration (m) from which eq. (1) closes each, multipliers as they are."""
        return self.state.status != OPEN, np.asarray(-self._normal_multiplier() / self.epsilon.normal)

    def _adopt(self, points: IntegrationPoints) -> None:
        """Integrate at these points from now on (collective in time steps)."""
        if points is self.integration and not isinstance(self.kinematics, StepLevel):
            return
        origin = self.integration.nearest(points.facet, points.η)
        self.integration = points
        before = self._converged
        assert isinstance(before.place, np.ndarray)  # a rigid target has no segments
        self.kinematics.take(points, origin, before.nodes, before.place)
        self.blocks.take(points)
        self.active.transfer(origin)
        if self.target_end is not None:
            self.target_end.transfer(origin)

    def _remember(self) -> None:
        """Keep where the bodies' nodes are: slip is counted from there, wherever points will be; and what is in contact."""
        k, closed = self.kinematics, self.active.closed
        own, faced = np.zeros(self.facets.size, dtype=bool), np.zeros(len(self.target.facets), dtype=bool)
        own[self.integration.facet[closed]], faced[k.at.point.facet[closed]] = True, True
        self._converged = Converged(k.nodes(), self.target.place, own, faced)

    def apply_law(self) -> None:
        """What eq. (1) says with the active set as it is."""
        k, active = self.kinematics, self.active
        if self.blocks.leave_out_at_corners(active.closed):
            self._Λ = self.blocks.multiplier_at_points()
        self.blocks.smooth(active.closed & k.at.facing, k.share > UNCOVERED)
        self.state = self.law.evaluate(self._Λ, k.at, k.s, active.closed, active.frozen, active.held)

    def decide(self, residual: PETSc.Vec) -> bool:
        """Let the active set change, once per Newton iteration; whether any point did, on any rank."""
        changed = self.active.decide(self.state, self.kinematics, residual, self.augmentation.unit, self.epsilon.normal)
        return any_over(self.comm, changed)

    @property
    def obstacle_moves(self) -> bool:
        """Whether the target is a rigid obstacle that is elsewhere than in the last converged state."""
        return isinstance(self.target, RigidTarget) and not self.target.is_at(self._converged.place)

    def hold_facets(self) -> bool:
        """Let what opening and closing decides for whole facets, which are held smooth and which have a part in a sharp
        corner, and how much points count that see the target at a slant, be as it is from now on in a solve; whether there
        may be any that are not held yet."""
        decides = self.blocks.is_smoothing or self.blocks.corners is not None or self.segments is not None
        new = decides and not self.blocks.holds_facets
        self.blocks.holds_facets = True
        self._hold_shares(True)
        return new

    def _hold_shares(self, holds: bool) -> None:
        if isinstance(self.kinematics, PositionLevel):
            self.kinematics.holds_shares = holds

    def _free_shares(self) -> bool:
        """Let points that see the target at a slant count as they do there, where :meth:`hold_facets` has held that in a wild
        iterate; whether it makes a difference (collective)."""
        k = self.kinematics
        if not (isinstance(k, PositionLevel) and k.holds_shares):
            return False
        held = k.share
        self._hold_shares(False)
        k.evaluate()
        return any_over(self.comm, not np.array_equal(held, k.share))

    def hold_turned(self) -> bool:
        """Let points stick that slip to and fro, once per Newton iteration; whether there are any, on any rank."""
        return self.friction and any_over(self.comm, self.active.hold_turned(self.state))

    def decisions(self) -> Decisions:
        """What these two may change, and at which points."""
        return self.integration, self.active.snapshot()

    def undo_decisions(self, saved: Decisions) -> None:
        """Take decisions back; segments may have moved since."""
        points, decisions = saved
        self.active.restore(decisions, points.nearest(self.integration.facet, self.integration.η))

    def violation(self) -> float:
        """Largest |λ̂_N| (Pa) at a point that is closed or open against eq. (1), or excess of |λ̂_T| over the friction bound at
        one that is held (collective)."""
        wrong = self.active.at_odds(self.state, self.kinematics, self.epsilon.normal) + self.active.beyond(self.state)
        return max_over(self.comm, float(wrong.max(initial=0.0)))

    def misses_most(self) -> bool:
        """Whether points that slid off in this solve, and penetrate the target now, would bear more than all others do: no
        flicker of the last one on the target (collective)."""
        lost = self.active.lost(self.state, self.kinematics)
        beyond = np.maximum(self.state.λN_hat - self.epsilon.normal * self.kinematics.touch, 0.0)
        missed, borne = sum_over(self.comm, np.array([self.j @ np.where(lost, beyond, 0.0), self.j @ self.state.p]))
        return bool(missed > max(borne, 0.0))

    def relative_motion(self) -> float:
        """How far the present displacements have moved closed points over the target since the last evaluation, in
        target facets (collective)."""
        k = self.kinematics
        if isinstance(k, StepLevel):  # the length of a time step is a better guard
            return 0.0
        self.target.refresh()
        moved = self.target.positions(k.at.point, k.at.N) - k.at.y
        size = np.linalg.norm(k.positions() - k.x - moved, axis=1)[self.state.status != OPEN]
        return max_over(self.comm, float(size.max(initial=0.0))) / self.target.size

    def slid(self) -> Array:
        """(n, gdim) how far points have slid over the target in this step (m); 0 where they stick or are open."""
        state, ε = self.state, self.law.ε
        if state.λT_hat is None or state.bound is None:
            return np.zeros_like(self.at.ν)
        size = np.maximum(np.linalg.norm(state.λT_hat, axis=1), 1e-300)
        beyond = np.where(state.status == SLIP, 1.0 - state.bound / size, 0.0)
        return np.asarray(beyond[:, None] * state.λT_hat / ε.tangential)

    def apart(self) -> Array:
        """(n, gdim) 𝐱 − 𝐲 at the present displacements (m), 𝐲 the point of the target that was faced at the last evaluation
        (collective)."""
        self.target.refresh()
        return self.kinematics.positions() - self.target.positions(self.kinematics.at.point, self.kinematics.at.N)

    def touches(self) -> Bool:
        """(n,) which points touched or overlapped at the last evaluation."""
        k = self.kinematics
        return np.asarray(k.may_close & (k.at.g >= -k.touch))

    def round_off_energy(self) -> float:
        """What ε_N makes of gaps that are round-off of the coordinates (J): bodies that touch and do not press have it."""
        return float(self.epsilon.normal * self.area * self.kinematics.touch**2)

    # ---------------------------------------------------------------- steps

    def use_steps(self) -> StepLevel:
        """Take the kinematics of time steps, for impact; there the multiplier's space is one and the same in all steps, which
        the balance of energy needs: corners' nodes keep all of their facets."""
        if not isinstance(self.kinematics, StepLevel):
            self._leave_ends()
            if self.segments is not None:
                self.segments.fills = np.zeros_like(self.segments.fills)
            self.target_end = None
            self.blocks.keep_at_corners()
            self.blocks.leave_rough()
            self.kinematics = StepLevel(self.kinematics)
            self.active.cautious = False
            self.augmentation.take_steps()
            self._firmness = 0.0
            self._use_law()
        return self.kinematics

    def _leave_ends(self) -> None:
        """Gauss points of whole facets from now on, as points that move under pressure would give energy."""
        if self.segments is not None and not self.is_segmented:
            self.segments = self._committed = None
            self._adopt(self.gauss)
            self.evaluate()

    def unfelt(self) -> list[Finding]:
        """What contact has not felt, or hardly: surfaces that a step has carried through each other, overlaps between the
        integration points, and in contact in statics, patches and ripples. In motion they are told, and a step fails for
        points alone that have passed (collective)."""
        if self._unfelt is None:
            c = self.contact
            surface = c.target if isinstance(c.target, Surface) else None
            self._unfelt = Unfelt(c.contactor, self.facets, self.target, surface, self._bodies, self.named, self.name)
        k, closed = self.kinematics, self.state.status != OPEN
        moves = isinstance(k, StepLevel)
        found = self._unfelt.look(self.integration, k.contactor(), k.at, closed, self._converged, known=moves)
        if moves:
            return [replace(finding, fatal=False) for finding in found]
        hardly = self.overlap_in_contact(), self.patches(), self.ripples()
        return [*found, *(finding for finding in hardly if finding is not None)]

    def is_pressed(self) -> bool:
        """Whether a closed point of this rank has a multiplier: it is not of bodies that only touch."""
        return bool((self._normal_multiplier()[self.active.closed] != 0.0).any())

    def was_in_contact(self) -> bool:
        """Whether a facet of this rank was in contact in the last converged state."""
        return bool(self._converged.closed.any())

    def commit(self) -> None:
        """The step has converged: it becomes the origin of the next one's slip, but for what multipliers of the nodes do not
        see of it, which acts on at each point by ε_T: forgotten in each step, it would let stuck points creep."""
        self._committed = self.integration, self.state, self.kinematics.s
        law = self.law
        unspent = law.unspent(self.state, self.kinematics.at) if isinstance(law, Coulomb) else None
        self.kinematics.commit(unspent, self.state.status)
        if isinstance(self.kinematics, StepLevel):
            self.kinematics.excuse(*self._decided())
        self._remember()
        self._committed_at = self._converged.nodes
        self.multiplier.extend()
        self._end_solve()
        self.active.guessed = False

    def show_committed(self) -> None:
        """After going back to the last step that was committed: its results as they were then, with the slip from the step
        before (collective). Where the state is another one, as that of a checkpoint, slip is zero."""
        if self._committed is None or any_over(
            self.comm, not np.array_equal(self._committed_at, self._converged.nodes)
        ):
            self.evaluate()
            return
        points, state, s = self._committed
        if self.segments is not None and not isinstance(self.kinematics, StepLevel):
            self._adopt(points)
            self.kinematics.evaluate()
            self._read_multiplier()
        self.state, self.kinematics.s = state, s

    def slip_from_touch(self, ratio: float) -> None:
        """In statics, count the slip of open points in the next step from where they touch, as
        :meth:`PositionLevel.slip_from_touch` (collective)."""
        if self.friction and isinstance(self.kinematics, PositionLevel):
            self.kinematics.slip_from_touch(ratio)
            self.apply_law()

    def _end_solve(self) -> None:
        if self.target_end is not None:
            self.target_end.end()

    def snapshot(self) -> dict[str, Array]:
        """All that a step may change, by name; see :class:`~dolfinx_mortar_al.problem.Snapshot`."""
        arrays = {
            "multiplier": self.multiplier.field.x.array.copy(),
            "guessed": np.array(self.active.guessed),
        }
        arrays |= self._state_at_points()
        before = self._converged
        arrays |= {name: getattr(before, name).astype(float) for name in ("nodes", "closed", "faced")}
        if isinstance(before.place, np.ndarray):
            arrays["target"] = before.place.copy()
        else:
            arrays |= {f"{name}_before": value for name, value in vars(before.place).items()}
        if isinstance(self.target, SelfTarget):
            arrays["role"] = self.target.role.copy()
        if isinstance(self.target, RigidTarget):
            arrays |= vars(self.target.obstacle.pose)
        return arrays

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot, at displacements that have been set before; Newton expects the active set that λ̂_N says."""
        self.multiplier.field.x.array[:] = saved["multiplier"]
        self.active.guessed = bool(saved["guessed"])
        if isinstance(self.target, SelfTarget):
            self.target.role = saved["role"].astype(np.int64)
        if isinstance(self.target, RigidTarget):
            self.target.obstacle.pose = Pose(*(saved[part.name] for part in fields(Pose)))
            place: Place = Pose(*(saved[f"{part.name}_before"] for part in fields(Pose)))
        else:
            place = saved["target"].copy()
        was = (saved[name].astype(bool) for name in ("closed", "faced"))
        self._converged = Converged(saved["nodes"].copy(), place, *was)
        self.target.refresh()
        λN_hat = self._restore_at_points(saved)
        self._leave_out_redundant(self._converged.nodes, place)
        self._end_solve()
        self.kinematics.evaluate()
        self.active.expect(λN_hat, self.kinematics, self.epsilon.normal)
        self._read_multiplier()
        self.apply_law()  # a snapshot may be the next thing that is taken

    def _state_at_points(self) -> dict[str, Array]:
        """Where the points are, what they slip from, and λ̂_N (Pa) for the active set: in statics at the Gauss points of whole
        facets, as it is extrapolated from states with points elsewhere."""
        points, k = self.integration, self.kinematics
        moved = points is not self.gauss and not isinstance(k, StepLevel)
        return {
            "points_λN_hat": self._λN_hat_at_gauss() if moved else self._expected(),
            "points_facet": points.facet.astype(float),
            "points_η": points.η.copy(),
            "points_weight": points.weight.copy(),
        } | {f"points_{name}": values for name, values in k.history_at_points().items()}

    def _restore_at_points(self, saved: dict[str, Array]) -> Array:
        """Points, and what they slip from, as in a snapshot; (n,) λ̂_N there (Pa)."""
        λN_hat, k = saved["points_λN_hat"], self.kinematics
        if self.segments is not None:
            facet, η, weight = (saved[f"points_{name}"].copy() for name in ("facet", "η", "weight"))
            points = IntegrationPoints(self.facets, facet.astype(np.int64), η, weight, self.thickness)
            self._adopt(self.gauss if np.array_equal(η, self.gauss.η) else points)
            self.segments.forget()
            if not isinstance(k, StepLevel):
                λN_hat = λN_hat[self.gauss.nearest(points.facet, points.η)]
        k.restore_history({name.removeprefix("points_"): values for name, values in saved.items()})
        return λN_hat

    def _expected(self) -> Array:
        """(n,) λ̂_N (Pa), from which the active set is restored: −∞ at points that time steps leave open whatever it says."""
        λN_hat, held = self.state.λN_hat, isinstance(self.kinematics, StepLevel)
        return np.where(self.active.closed, λN_hat, -np.inf) if held else λN_hat.copy()

    def _λN_hat_at_gauss(self) -> Array:
        """(ng,) λ̂_N (Pa) at the Gauss points, which stay where they are while segments move."""
        points, target = self.gauss, self.target
        assert isinstance(target, DeformableTarget)  # others have no segments
        at = target.project_once(contactor_points(points, self.kinematics.nodes()), target.nodes)
        nodal, out = self.multiplier.own_nodal(), self.blocks.left_out_at_corners
        nodal = nodal if out is None else np.where(out[:, :, None], 0.0, nodal)
        Λ = (self.multiplier.at(points.facet, points.η) * nodal[points.facet]).sum(axis=1)
        λN = np.einsum("ni,ni->n", at.ν, Λ) if self.contact.friction else Λ[:, 0]
        return augmented_normal(λN, at.g, self.epsilon)

    # ---------------------------------------------------------------- element arrays

    def multiplier_residual(self) -> tuple[Index, Array]:
        """∫ r·N1 Λ* dS₀, eq. (4), as :meth:`Blocks.multiplier_residual`."""
        return self.blocks.multiplier_residual(self.state, self.kinematics.share)

    def body_residual(self, *, reactions: bool = False) -> list[tuple[Index, Array]]:
        """−∫ t·(N1 U1* − N2(η) U2*) dS₀, eq. (4), as :meth:`Blocks.body_residual`."""
        return self.blocks.body_residual(self.state, self.kinematics, reactions=reactions)

    def _act(self) -> Index:
        """Points whose derivative is not that of an open point with ε_N = ε_T, or a ν that is held, and with a share that
        stays."""
        n, same = self.integration.size, self._same_ε or self.kinematics.normals is not None
        if not same:
            return np.arange(n)
        act, k = self.state.status != OPEN, self.kinematics
        if isinstance(k, PositionLevel) and k.beyond < 1.0:
            act = act | k.slanted
        return np.flatnonzero(act)

    def tangent(self) -> Tangent:
        """Contact's share of the Jacobian, eq. (6)."""
        return self.blocks.tangent(self.law, self.state, self._Λ, self.kinematics, self._act())

    def tangent_of_cuts(self) -> CutTangent | None:
        """What points that move with the target's end add to it, where they do."""
        k, segments = self.kinematics, self.segments
        if self.holds_points or not isinstance(k, PositionLevel) or segments is None or segments.rest:
            return None
        return tangent_of_cuts(self.blocks, self.law, self.state, self._Λ, k)

    def couples(self, near: bool = False) -> Index:
        """Where the matrices have entries now, as :meth:`Blocks.couples`; with `near` also where they might have soon, for
        points that face the target within NEAR of its facets."""
        act = self._act()
        if near:
            at = self.kinematics.at
            act = np.union1d(act, np.flatnonzero(at.facing & (np.abs(at.g) <= NEAR * self.target.size)))
        return self.blocks.couples(self.kinematics, act)
