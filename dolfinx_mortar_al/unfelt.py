"""What contact has not felt in a converged state of statics (``docs/robustness.md``).

Contact is felt at the contactor's integration points, by what lies in front of them there and then. A step may carry points
through a thin target without any state in between; and corners of either surface may lie in the other body between the
points. So the nodes of both surfaces, and open points, are looked at once more:

- what came through the front of the other surface where nothing is in contact, and is not in the body, has been carried
  through it; so has what a rigid obstacle lies behind that was in front of it, wherever contact is: there it would be pushed
  on;
- what lies in the other body where nothing is in contact overlaps it unfelt;
- a membrane, which bears no compression, has folded over where Newton's iterates were wild: an unstable equilibrium;
- where nothing at all is in contact, a node that lies in the other body, at any depth, says that the bodies meet with
  surfaces that the pair does not name;
- boundary that no pair names, beyond the end of a surface, overlaps the other body unfelt, too;
- depth is a function of slope one at most: a node that lies deeper than the next integration point is away, and than meshes
  may err, has taken that along, which contact should have felt and undone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import basix
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.beyond import Beyond
from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.inside import Inside
from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.kinematics import contactor_points
from dolfinx_mortar_al.monitors import Finding
from dolfinx_mortar_al.obstacles import Obstacle, Pose
from dolfinx_mortar_al.pieces import seen_by_any
from dolfinx_mortar_al.projection import Projection
from dolfinx_mortar_al.reductions import any_over, max_over
from dolfinx_mortar_al.self_target import SelfTarget
from dolfinx_mortar_al.surface import Facets, Surface, surface_normal
from dolfinx_mortar_al.swept import DEPTH, changed_side, depth_behind, passed_through
from dolfinx_mortar_al.targets import ContactorPoints, DeformableTarget, Place, RigidTarget, Target

__all__ = ["Converged", "Unfelt"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

PASSED = "the step has carried one surface through the other; take smaller steps"
MISSED = (
    "the surfaces overlap by more than integration points are apart; take smaller steps, refine the contactor, swap "
    'contactor and target, or take integration="segments"; if they touch so from the start, name all of their boundary that '
    "may touch"
)
IN_OBSTACLE = (
    "the contactor lies in the obstacle between its integration points, or within facets that are in contact, which holds it "
    "out on the average; refine it there, raise quadrature_degree, or take smaller steps"
)
BETWEEN = (
    "the surfaces overlap between the integration points, which do not feel it; refine the contactor, raise "
    'quadrature_degree, or take integration="segments"'
)
ON_AVERAGE = (
    "the surfaces overlap within facets that are in contact, which holds them apart on the average; swap contactor and "
    "target, or refine both there"
)
ELSEWHERE = (
    "one body lies in the other while nothing of this pair is in contact: other surfaces of them meet; name these, or all of "
    "the boundary that may ever touch, as contactor and target"
)
UNNAMED = (
    "the body's boundary goes on where the {} (tag {}) ends, and lies in what it touches there, which nothing feels: name "
    "these facets, too"
)
FOLDS = "a membrane has folded over in the step, which it does in compression alone; take smaller steps"
SHARE = 0.02  # of the longer facet: what overlaps by less is an error of the mesh
FOLDED = -0.5  # cosine of the normals of a facet and its neighbour, or in its middle and elsewhere on it
LATTICE = 16  # parts of a facet's edge at most, between which a rigid obstacle is looked for
DEEPEST = 0.25  # of the longer facet: no error of the mesh,
TOLD = DEEPEST / 2  # and what is said: in contact that is right nodes are .1 deep at most (docs/robustness.md)


@dataclass(frozen=True)
class Converged:
    """A converged state, as far as the next one is compared with it.

    Attributes:
        nodes: (nf, nodes, gdim) of the contactor's facets of this rank (m).
        place: of the target.
        closed: (nf,) which of the contactor's facets of this rank are in contact; faced: (target's nf,) which of the target's
            they are in contact with.
    """

    nodes: Array
    place: Place
    closed: Bool
    faced: Bool


class _Side:
    """A surface, and what is known of its facets."""

    def __init__(self, surface: Surface, target: DeformableTarget, bodies: Bodies, named: Sequence[Surface]) -> None:
        self.target, self.inside, self.is_membrane = target, Inside(surface, bodies), surface.is_membrane
        self.beyond, self.tag = Beyond(surface, target, bodies, named), surface.tag
        #: (nodes, gdim) where they were in the last converged state (m)
        self.before = target.nodes
        #: (nf,) which are in contact, and which were then
        self.closed = self.was_closed = np.zeros(len(target.facets), dtype=bool)

    def of_nodes(self, values: Array | Bool) -> Array:
        """(nodes,) the largest of the values (nf,) of the facets that a node belongs to."""
        result = np.zeros(len(self.target.nodes))
        for nodes in self.target.facets.T:
            np.maximum.at(result, nodes, values)
        return result

    @property
    def silent(self) -> Bool:
        """(nf,) where nothing is or was in contact."""
        return ~(self.closed | self.was_closed)

    def depth_behind(self, x: Array) -> Array:
        """(n,) how far 𝐱 (n, gdim) lies behind the surface (m), roughly and at most about a facet."""
        return depth_behind(self.target.surface, self.target.nodes, x, self.target.size)

    def bulge(self) -> float:
        """How far facets rise above their flat pieces (m), by the pieces' middles."""
        shape, nodes = self.target.surface.shape, self.target.nodes[self.target.facets]
        N = shape.tabulate(shape.nodes[shape.pieces].mean(axis=1))[0]
        off = N @ nodes - nodes[:, shape.pieces].mean(axis=2)
        return float(np.linalg.norm(off, axis=2).max(initial=0.0))

    def folded(self) -> Bool:
        """(nf,) which facets of a membrane have folded over in this step, in themselves or onto a neighbour."""
        surface, now, then = self.target.surface, self._normals(self.target.nodes), self._normals(self.before)
        near = surface.neighbours
        turned = [
            np.concatenate([n @ n[:, 0, :, None], n[near][:, :, 0] @ n[:, 0, :, None]], axis=1) for n in (now, then)
        ]
        return np.asarray(((turned[0] < FOLDED) & (turned[1] > 0.0)).any(axis=(1, 2)))

    def _normals(self, nodes: Array) -> Array:
        """(nf, 1 + nodes, gdim) unit normals in the middle of each facet and at its nodes, of a surface with nodes there."""
        shape, surface = self.target.surface.shape, self.target.surface
        η = np.concatenate([shape.corners.mean(axis=0)[None], shape.nodes])
        return _unit(surface_normal(shape.tabulate(η, 1)[1] @ nodes[surface.facets][:, None]))

    def normals_at_nodes(self, nodes: Array) -> Array:
        """(nodes, gdim) mean unit normals of the facets that meet at each node, of the surface with nodes there."""
        surface, mean = self.target.surface, np.zeros_like(nodes)
        np.add.at(mean, surface.facets, self._normals(nodes)[:, 1:] * surface.orientation[:, None, None])
        return _unit(mean)

    def passed(self, x0: Array, x: Array) -> Bool:
        """(n,) which points have come through the surface's front, 𝐱₀ and 𝐱 (n, gdim)."""
        depth = DEPTH * self.target.size
        return passed_through(self.target.surface, self.before, self.target.nodes, x0, x, depth, touching=~self.silent)


@dataclass
class _Points:
    """Nodes of a surface, or integration points.

    Attributes:
        x0, x, X: (n, gdim) where they were in the last converged state, are now, and are in the reference one (m).
        n0, n: (n, gdim) unit normals of the surface there, then and now, where the target is an obstacle.
        loose: (n,) whether nothing is in contact on their facets; silent: (n,) whether nothing is or was.
        extent: (n,) of their facet; reach: (n,) how far away the next integration point may be (m).
        deep: (n,) whether they are to be apart from the other surface even where they have not passed.
        beyond: (n,) whether they lie beyond the surface's end.
    """

    x0: Array
    x: Array
    X: Array
    n0: Array
    n: Array
    loose: Bool
    silent: Bool
    extent: Array
    reach: Array
    deep: Bool
    beyond: Bool

    def take(self, which: Index | Bool) -> _Points:
        return _Points(*(values[which] for values in vars(self).values()))

    @classmethod
    def together(cls, parts: Sequence[_Points]) -> _Points:
        return cls(*(np.concatenate(values) for values in zip(*(vars(part).values() for part in parts), strict=True)))


@dataclass
class _Found:
    """Of points at X (n, gdim): passed (n,) which have been carried through; depth (n,) how deep the others are unfelt, as a
    share of the longer facet; missed (n,) which are deeper than contact can leave them; silent (n,) beside which nothing is
    or was in contact; beyond (n,) which lie beyond their surface's end."""

    X: Array
    passed: Bool
    depth: Array
    missed: Bool
    silent: Bool
    beyond: Bool

    def of(self, beyond: bool) -> _Found:
        """Those beyond their surface's end, or the others."""
        return _Found(*(values[self.beyond == beyond] for values in vars(self).values()))


class Unfelt:
    """Looks at a pair's converged states.

    Args:
        contactor: the surface; facets: it, as this rank owns it.
        target: the pair's; surface: it, if it is one.
        bodies: of the problem.
        named: surfaces of all pairs.
        name: of the pair.
    """

    def __init__(
        self,
        contactor: Surface,
        facets: Facets,
        target: Target,
        surface: Surface | None,
        bodies: Bodies,
        named: Sequence[Surface],
        name: str,
    ) -> None:
        self._comm, self._name, self._facets, self._target = bodies.comm, name, facets, target
        if isinstance(target, SelfTarget):
            return
        self._contactor = _Side(contactor, DeformableTarget(contactor, bodies, uses_rays=False), bodies, named)
        self._own = self._contactor.target.surface.places_of(facets)
        if isinstance(target, DeformableTarget):
            assert surface is not None
            self._other = _Side(surface, target, bodies, named)
            self._is_of_one = _share_a_piece(contactor, surface, bodies)

    def look(
        self,
        points: IntegrationPoints,
        now: ContactorPoints,
        at: Projection,
        closed: Bool,
        before: Converged,
        known: bool,
    ) -> list[Finding]:
        """What is found in the present state (collective).

        Args:
            points: of integration, which are at `now` and face `at`; closed: (n,) which are in contact.
            before: the last converged state.
            known: whether it is known that none of the points has passed through, as in motion.
        """
        if known and isinstance(self._target, SelfTarget):
            return []
        was, X = contactor_points(points, before.nodes), points.interpolate(self._facets.X)
        if isinstance(self._target, SelfTarget):
            found = [self._through_itself(self._target, now, was.x, X, np.flatnonzero(~closed), before.place)]
            return self._findings(found)
        spacing = self._take_contactor(points, closed, before)
        facet = self._own[points.facet]
        silent, extents = self._contactor.silent[facet], self._contactor.target.extents[facet]
        no = np.zeros(len(X), dtype=bool)
        every = _Points(
            was.x, now.x, X, was.normal, now.normal, silent, silent, extents, np.zeros(len(X)), deep=no, beyond=no
        )
        every = every.take(~no & np.bool_(not known))
        nodes = self._nodes(self._contactor, self._contactor.of_nodes(spacing))
        in_contact = any_over(self._comm, closed.any())
        if isinstance(self._target, RigidTarget):
            assert isinstance(before.place, Pose)
            parts = [every, nodes, self._between(self._target.obstacle, spacing)]
            return self._look_at_obstacle(self._target, parts, before.place, in_contact)
        self._take_target(at, closed, before)
        others = self._nodes(self._other, np.zeros(len(self._other.target.nodes)))
        own, theirs = [every.take(every.silent), nodes], [others]
        if in_contact and not self._is_of_one:
            own.append(self._beyond(self._contactor))
            theirs.append(self._beyond(self._other))
        found = [
            self._at_surface(_Points.together(own), self._other),
            self._at_surface(_Points.together(theirs), self._contactor, spacing=spacing),
        ]
        said = self._folds((self._contactor, self._other)) or self._findings([each.of(beyond=False) for each in found])
        sides = ("contactor", self._contactor), ("target", self._other)
        for (name, side), each in zip(sides, found, strict=True):
            said = said + self._unnamed(name, side, each.of(beyond=True))
        if said or in_contact:
            return said
        return self._elsewhere([(nodes, self._other), (others, self._contactor)])

    def _look_at_obstacle(
        self, target: RigidTarget, parts: Sequence[_Points], before: Pose, in_contact: bool
    ) -> list[Finding]:
        """What is found of points and nodes beside an obstacle (collective)."""
        found = [self._at_obstacle(target, part, before) for part in parts]
        said = self._folds((self._contactor,)) or self._findings(found)
        if in_contact:
            ends = self._at_obstacle(target, self._beyond(self._contactor), before)
            said = said + self._unnamed("contactor", self._contactor, ends)
        return said

    # ---------------------------------------------------------------- what is known of both sides

    def _take_contactor(self, points: IntegrationPoints, closed: Bool, before: Converged) -> Array:
        """Take up its present state; (nf,) how far its integration points are apart (m)."""
        side, own = self._contactor, self._own
        side.target.refresh()
        nodes = np.full_like(side.target.nodes, -np.inf)
        nodes[side.target.facets[own]] = before.nodes
        state = np.zeros((3, len(side.target.facets)))
        state[0, own[points.facet]] = points.spacing
        state[1, own[points.facet[closed]]] = 1.0
        state[2, own] = before.closed
        for array in (nodes, state):
            self._comm.Allreduce(MPI.IN_PLACE, array, MPI.MAX)
        side.before, side.closed, side.was_closed = nodes, state[1] > 0, state[2] > 0
        return state[0]

    def _take_target(self, at: Projection, closed: Bool, before: Converged) -> None:
        assert isinstance(before.place, np.ndarray)
        state = np.zeros((2, len(self._target.facets)))
        state[0, at.point.facet[closed]] = 1.0
        state[1] = before.faced
        self._comm.Allreduce(MPI.IN_PLACE, state, MPI.MAX)
        self._other.before, self._other.closed, self._other.was_closed = before.place, state[0] > 0, state[1] > 0

    def _nodes(self, side: _Side, reach: Array) -> _Points:
        """This rank's share of a surface's nodes; `reach` (nodes,) in metres."""
        surface, extent = side.target.surface, side.of_nodes(side.target.extents)
        loose, silent = (side.of_nodes(~values) == 0.0 for values in (~side.closed, side.silent))
        no = np.zeros(len(silent), dtype=bool)
        n0, n = self._normals(side, side.before), self._normals(side, side.target.nodes)
        every = _Points(
            side.before, side.target.nodes, surface.X, n0, n, loose, silent, extent, reach, deep=~no, beyond=no
        )
        return every.take(np.arange(self._comm.rank, len(silent), self._comm.size))

    def _normals(self, side: _Side, nodes: Array) -> Array:
        """(nodes, gdim) unit normals of a surface with nodes there, where the target is an obstacle; else 0."""
        return side.normals_at_nodes(nodes) if isinstance(self._target, RigidTarget) else np.zeros_like(nodes)

    def _beyond(self, side: _Side) -> _Points:
        """This rank's share of the nodes beyond a surface's ends."""
        x, X, no = side.beyond.nodes(), side.beyond.X, np.zeros(len(side.beyond.X), dtype=bool)
        n = np.zeros_like(x)
        every = _Points(x, x, X, n, n, no, no, side.beyond.extent, np.ones(len(X)), deep=~no, beyond=~no)
        return every.take(np.arange(self._comm.rank, len(X), self._comm.size))

    def _between(self, obstacle: Obstacle, spacing: Array) -> _Points:
        """Points of this rank's facets without contact that a narrow obstacle comes near, a quarter of its radius apart;
        `spacing` (nf,) of the integration points (m)."""
        target, surface = self._contactor.target, self._contactor.target.surface
        facets = self._own[self._contactor.silent[self._own]]
        longest = max_over(self._comm, float(target.extents[facets].max(initial=0.0)))
        parts = int(np.ceil(4 * longest / obstacle.smallest_radius))
        facets = facets if parts > 1 else facets[:0]
        nodes = target.nodes[surface.facets[facets]]
        clearance = -obstacle.project(nodes.reshape(-1, nodes.shape[2])).g.reshape(nodes.shape[:2])
        facets = facets[(clearance < target.extents[facets][:, None]).any(axis=1)]
        η = basix.create_lattice(surface.shape.cell, min(max(parts, 1), LATTICE), basix.LatticeType.equispaced, True)
        (N, dN), own = surface.shape.tabulate(η, 1), surface.facets[facets]
        ways = self._contactor.before, target.nodes
        x0, x, X = ((N @ v[own]).reshape(-1, v.shape[1]) for v in (*ways, surface.X))
        n0, n = (
            _unit(surface_normal(dN @ v[own][:, None]) * surface.orientation[facets, None, None]).reshape(x.shape)
            for v in ways
        )
        of, every = np.repeat(facets, len(η)), np.ones(len(x), dtype=bool)
        return _Points(x0, x, X, n0, n, every, every, target.extents[of], spacing[of], deep=every, beyond=~every)

    # ---------------------------------------------------------------- what is found

    def _at_surface(self, points: _Points, other: _Side, spacing: Array | None = None) -> _Found:
        """Points beside the other surface; `spacing` (nf,) of the integration points on it, if they are there (m)."""
        passed, suspect = points.silent.copy(), points.deep.copy()
        if passed.any():
            passed[passed] = other.passed(points.x0[passed], points.x[passed])
        least = np.where(points.silent, SHARE / 2, TOLD / 2) * np.maximum(points.extent, other.target.extents.min())
        least = np.maximum(least - 2 * other.bulge(), 0.0)
        suspect[suspect] = other.depth_behind(points.x[suspect]) > least[suspect]
        suspect |= passed
        points, passed = points.take(suspect), passed[suspect]
        if not any_over(self._comm, suspect.any()):
            return _Found(points.X, passed, np.zeros(0), passed, passed, passed)
        at = other.target.closest(points.x)
        facet = at.point.facet
        longer = np.maximum(points.extent, other.target.extents[facet])
        reach = points.reach if spacing is None else np.where(points.beyond, points.reach, spacing[facet])
        deep = at.facing & (at.g > np.where(passed, 0.0, SHARE * longer))
        within = np.zeros(len(deep), dtype=bool)
        if any_over(self._comm, deep.any()):
            within[deep] = other.inside(points.x[deep], at.y[deep])
        silent = points.silent & other.silent[facet]
        return _found(points, passed & silent & ~within, np.where(within, at.g, 0.0), silent, reach, longer)

    def _at_obstacle(self, target: RigidTarget, points: _Points, before: Pose) -> _Found:
        """Points beside a rigid obstacle, which feels every integration point that is in it now."""
        at = target.obstacle.project(points.x)
        ways, turns = (points.x0, points.x), (points.n0, points.n)
        is_membrane = self._contactor.is_membrane
        passed = changed_side(target.obstacle, before, ways, turns, DEPTH * target.size, is_membrane)
        depth = np.where(points.reach > 0.0, np.maximum(at.g, 0.0), 0.0)
        return _found(points, passed, depth, points.silent, points.reach, points.extent)

    def _through_itself(
        self, target: SelfTarget, now: ContactorPoints, x0: Array, X: Array, free: Index, before: Place
    ) -> _Found:
        """Open points that a step has carried through their own surface."""
        assert isinstance(before, np.ndarray)
        counts = target.crossable(now, free)
        passed = passed_through(
            target.surface, before, target.nodes, x0[free], now.x[free], DEPTH * target.size, counts
        )
        nowhere = np.zeros(len(free), dtype=bool)
        return _Found(X[free], passed, np.zeros(len(free)), nowhere, nowhere, nowhere)

    def _folds(self, sides: tuple[_Side, ...]) -> list[Finding]:
        """Membranes that have folded over."""
        found = [(side.target.surface, np.flatnonzero(side.folded())) for side in sides if side.is_membrane]
        places = [surface.X[surface.facets[facets]].mean(axis=1) for surface, facets in found]
        return [
            Finding(f"{self._name}: folded facets", float(len(X)), tuple(X[0].tolist()), FOLDS, True)
            for X in places
            if len(X)
        ]

    def _unnamed(self, name: str, side: _Side, found: _Found) -> list[Finding]:
        """Nodes beyond the end of a surface that lie in the other body, deeper than any error of the meshes (collective)."""
        k = int(np.argmax(found.depth)) if len(found.depth) else -1
        mine = [(float(found.depth[k]), tuple(map(float, found.X[k])))] if k >= 0 else []
        deepest, place = max((one for part in self._comm.allgather(mine) for one in part), default=(0.0, ()))
        if deepest <= TOLD:
            return []
        words = UNNAMED.format(name, side.tag)
        return [Finding(f"{self._name}: overlap beyond the {name} (facets)", deepest, place, words, False)]

    def _elsewhere(self, sides: list[tuple[_Points, _Side]]) -> list[Finding]:
        """Nodes that lie in the other body, of a pair that is not in contact (collective)."""
        mine = [tuple(map(float, X)) for points, other in sides for X in points.X[self._deep(points, other)]]
        every = [X for part in self._comm.allgather(mine) for X in part]
        name = f"{self._name}: nodes in the other body"
        return [Finding(name, float(len(every)), every[0], ELSEWHERE, False)] if every else []

    def _deep(self, points: _Points, other: _Side) -> Index:
        """Which points lie in the body behind a surface, deeper than any error of the meshes (collective)."""
        suspect = np.flatnonzero(other.inside.may_be(points.x))
        if not any_over(self._comm, len(suspect) > 0):
            return suspect
        at = other.target.closest(points.x[suspect])
        longer = np.maximum(points.extent[suspect], other.target.extents[at.point.facet])
        deep = np.flatnonzero(at.facing & (at.g > DEEPEST * longer))
        return suspect[deep[other.inside(points.x[suspect[deep]], at.y[deep])]]

    def _findings(self, found: list[_Found]) -> list[Finding]:
        """In words, on all ranks (collective)."""
        X, passed, depth, missed, silent, _ = (
            np.concatenate([getattr(part, name) for part in found]) for name in vars(found[0])
        )
        through = [tuple(x) for part in self._comm.allgather(X[passed].tolist()) for x in part]
        if through:
            name = f"{self._name}: points passed through"
            return [Finding(name, float(len(through)), through[0], PASSED, True)]
        k = np.lexsort([depth, missed])[-1:]  # the deepest of those that were missed, or else the deepest
        mine = [(bool(missed[i]), float(depth[i]), tuple(X[i].tolist()), bool(silent[i])) for i in k]
        every = [one for part in self._comm.allgather(mine) for one in part]
        is_missed, deepest, place, is_silent = max(every, default=(False, 0.0, (), True))
        if not is_missed and deepest <= SHARE:
            return []
        meaning = MISSED if is_missed else BETWEEN if is_silent else ON_AVERAGE
        meaning = IN_OBSTACLE if isinstance(self._target, RigidTarget) else meaning
        return [Finding(f"{self._name}: overlap that is not felt (facets)", deepest, place, meaning, is_missed)]


def _unit(m: Array) -> Array:
    """Vectors (…, gdim) brought to length one."""
    return np.asarray(m / np.maximum(np.linalg.norm(m, axis=-1, keepdims=True), 1e-300))


def _found(points: _Points, passed: Bool, depth: Array, silent: Bool, reach: Array, longer: Array) -> _Found:
    """Points that have passed or lie `depth` (n,) in the other body (m): those where nothing is or was in contact, and others
    that are too deep for an error of meshes whose longer facets are `longer` (n,). Missed are such that are `loose` besides,
    and deeper than integration points are away, `reach` (n,)."""
    far = depth > DEEPEST * longer
    missed = points.loose & far & (depth > reach)
    told = silent | (depth > TOLD * longer)
    return _Found(points.X, passed, np.where(told, depth, 0.0) / longer, missed, silent, points.beyond)


def _share_a_piece(a: Surface, b: Surface, bodies: Bodies) -> bool:
    """Whether two surfaces are of the same connected piece of a body (collective)."""
    if a.mesh is not b.mesh:
        return False
    body = bodies.bodies[bodies.index(a.mesh)]
    first, second = (seen_by_any(bodies.comm, body.piece[Facets.of(surface, body.space).dofs]) for surface in (a, b))
    return bool(np.isin(first, second).any())
