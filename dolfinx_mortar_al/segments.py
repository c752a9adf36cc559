"""Segments: the contactor's facets cut where target facets end, as its rays see them, so that no integrand has a kink inside.

On a curve a segment is an interval between two cuts; on a surface the part of a contactor facet that sees one target facet: a
polygon, clipped in the contactor facet's own reference coordinates and cut into triangles.

The points follow the bodies from one evaluation to the next; they stay where they are while the ends of the target's facets
have moved by less than STILL. A cut displaced by δ changes the integral of a continuous integrand by δ²/2 times the jump of
its slope: Newton's tangent may leave the motion of the points out, and a small δ does not matter (``docs/integration.md``).
Where the target ends the integrand itself jumps: there Gauss points of whole facets give way to points that follow the end,
too, and in the plane the tangent has that motion (`moving_cuts.py`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import basix
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.clipping import areas, clip, contains, triangulate, without_flat_corners
from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.moving_cuts import MovingCuts
from dolfinx_mortar_al.projection import dot, inverse
from dolfinx_mortar_al.rays import OPPOSED
from dolfinx_mortar_al.reductions import max_over
from dolfinx_mortar_al.search import balls, where
from dolfinx_mortar_al.surface import Facets, GatheredFacets, ShapeFunctions, surface_normal

__all__ = ["UNCOVERED", "Segments", "cuts_on_curve", "ends_of", "images_on_curve", "segments_of"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

STILL = 3e-5  # in facets: the root of Newton's tolerance on forces, as a cut's displacement counts squared
GROWTH = 30.0  # of STILL with each move in a solve: points that would chatter with the contact state come to rest
# the same where the target ends, as the integrand jumps and a cut's displacement counts once there, for a share of one facet:
# forces are the same to 1e-6 however a state is reached (`tests/test_target_end.py`)
STILL_AT_ENDS = 3e-7
GROWTH_AT_ENDS = 10.0  # with each move that is more than a share SETTLES of the one before: others do not chatter
SETTLES = 0.5
GROWN = 2  # times in a row that cuts have moved farther: they do not settle
SNAP = 1e-6  # in facets: a cut closer to another, or to a facet's end, is none; its displacement counts squared, too
NEWTON = 8  # iterations for the ray of a curved facet through a point, or a point of a quadrilateral
# weight in the multiplier's equation of what faces nothing: where more than a tenth of the facets around a node is covered,
# the third root, that determines its multiplier, and with less its force fades
UNCOVERED = 1e-3
SLIVER = 1e-13  # share of a facet below which a polygon is round-off
THIN = 1e-4  # the same with Gauss points: edges amid the target, where they lie on those of the contactor, come and go
# of a facet's extent, beside which the target's end makes polygons of it: what passes to and fro over its side is no change
BESIDE = 0.25
HARDLY = 1e-6  # share of a facet that counts as nothing: seen at all, or seen twice
# degree of the points where a facet in space faces nothing: eight across, as their weight matters and their places hardly do
LEFT_OVER = 15


class Segments(ABC):
    """The points of a pair's segments, where the bodies are now.

    Args:
        facets: of the contactor, on this rank.
        target: the target, whole.
        degree: of the quadrature on each segment.
        thickness: out of the plane (m).
        comm: of the ranks that have the contactor: their points follow together, as on one rank.
    """

    #: motion (in facets) up to which points stay, its growth, and the share of the motion before above which it grows
    still, growth, settles = STILL, GROWTH, 0.0

    def __init__(
        self, facets: Facets, target: GatheredFacets, degree: int, thickness: float, comm: MPI.Intracomm
    ) -> None:
        self._facets, self._target, self._comm = facets, target, comm
        self._degree, self._thickness = degree, thickness
        own = max_over(comm, float(np.linalg.norm(np.ptp(facets.X, axis=1), axis=1).max(initial=0.0)))
        #: farther from the contactor (m) an end of a target facet makes no cut: nothing is closed there
        self._reach = max(target.size_of_facets, own)
        # (nodes,) where the target ends, or turns away by more than makes its side
        self._sharp = target.ends(OPPOSED)
        #: nodes of the latter kind
        self.turning_nodes = np.flatnonzero(self._sharp & ~target.end_nodes)
        self._x1, self._x2 = facets.X, target.X
        #: (nf,) facets in space that have points where they see nothing, too, when the target covers less than half of them:
        #: at the contactor's end, where all facets around a node may be such
        self.fills: Bool = np.zeros(facets.size, dtype=bool)
        self.begin()
        self.forget()

    def begin(self) -> None:
        """A new solve: points follow closely at first, less and less as they are moved again."""
        self._still, self._last, self.rest, self.lags = self.still, np.inf, False, False
        # how often in a row points have moved farther than the time before, and how far cuts are from them now
        self._growing, self._lag = 0, 0.0

    def _follows(self, motion: float) -> bool:
        """Whether points follow cuts that have moved so far (in facets)."""
        self._lag = motion
        #: whether they stay though cuts have moved, after they have followed them in this solve, and by more than `still`
        self.rest = 0.0 < motion <= self._still and self._last < np.inf
        self.lags = self.still < motion <= self._still
        if motion <= self._still:
            return False
        if motion > self.settles * self._last:
            self._still *= self.growth
        self._growing = self._growing + 1 if motion > self._last else 0
        self._last = motion
        if self._growing >= GROWN and self.settles:
            self._still = max(self._still, self.growth * motion)
        return True

    @property
    def diverges(self) -> bool:
        """Whether to follow the cuts moves them on, farther each time, as edges that lie on each other may be."""
        return self._growing >= GROWN and self._lag > self._last

    def forget(self) -> None:
        """Make new points next time, whether anything has moved or not."""
        self._couples: tuple[Index, Index] | None = None

    def follow(self, contactor: Array, target: Array) -> IntegrationPoints | None:
        """New points, if they have to move (collective); `contactor` (nf, nodes, gdim) and `target` (nodes, gdim): nodes now
        (m)."""
        motion = np.inf if self._find_couples(contactor, target) else 0.0
        assert self._couples is not None
        images, near = self._images(*self._couples, contactor, target)
        if motion == 0.0:
            seen = near | self._near
            motion = min(np.abs(images[seen] - self._seen[seen]).max(initial=0.0), 1.0)  # off a facet: infinite
        motion = max_over(self._comm, float(motion))
        if not np.isfinite(motion):
            self.rest = self.lags = False
        elif not self._follows(motion):
            return None
        self._seen: Array = images
        self._near: Bool = near
        return self._points(self._couples[0][near], self._couples[1][near], images[near])

    def _find_couples(self, contactor: Array, target: Array) -> bool:
        """Bring up to date which facets may be cut by which ends of the target; whether that was due."""
        margin = 0.5 * self._reach
        if self._couples is not None:
            moved = [np.abs(now - then).max(initial=0.0) for now, then in ((contactor, self._x1), (target, self._x2))]
            if max(moved) <= margin / 8:
                return False
        self._x1, self._x2 = contactor.copy(), target.copy()
        centre, radius = balls(contactor)
        other, size = self._ends(target)
        self._couples = self._near_ends((centre, radius + self._reach + margin), (other, size))
        return True

    def _near_ends(self, facets: tuple[Array, Array], ends: tuple[Array, Array]) -> tuple[Index, Index]:
        """Couples of the contactor's facets and the target's ends that meet, as balls: centres (n, gdim), radii (n,) in m."""
        return _near_balls(*facets, *ends)

    @abstractmethod
    def _ends(self, target: Array) -> tuple[Array, Array]:
        """Balls around what may cut a facet: centres (ne, gdim) and radii (ne,) in m."""

    @abstractmethod
    def _images(self, facet: Index, end: Index, contactor: Array, target: Array) -> tuple[Array, Bool]:
        """Of each couple (m,), where on the facet the end is seen (m, …), and whether it may cut it."""

    @abstractmethod
    def _points(self, facet: Index, end: Index, images: Array) -> IntegrationPoints:
        """Points of the segments between the images (m, …) of ends (m,) on facets (m,)."""


def segments_of(facets: Facets, target: GatheredFacets, degree: int, thickness: float, comm: MPI.Intracomm) -> Segments:
    """Segments for a contactor of either dimension, as :class:`Segments`."""
    if facets.shape.dim == 1:
        return _Intervals(facets, target, degree, thickness, comm)
    whole = IntegrationPoints.gauss(facets, np.full(facets.size, degree), thickness)
    return _Polygons(target, whole, degree, comm)


def ends_of(target: GatheredFacets, gauss: IntegrationPoints, degree: int, comm: MPI.Intracomm) -> Segments:
    """The points `gauss` of whole facets, and others of the quadrature's `degree` where the target ends, for a contactor of
    either dimension; `comm` as in :class:`Segments`."""
    kind = _IntervalsAtEnds if gauss.facets.shape.dim == 1 else _PolygonsAtEnds
    return kind(target, gauss, degree, comm)


def _near_balls(a: Array, radius_a: Array, b: Array, radius_b: Array) -> tuple[Index, Index]:
    """Couples of balls that meet."""
    rows: list[NDArray[Any]] = [np.zeros(0, dtype=np.int64)]
    columns: list[NDArray[Any]] = [np.zeros(0, dtype=np.int64)]
    batch = max(1, 2**20 // max(len(b), 1))
    for first in range(0, len(a), batch):
        part = slice(first, first + batch)
        squared = sum((a[part, None, i] - b[None, :, i]) ** 2 for i in range(a.shape[1]))
        i, j = where(squared <= (radius_a[part, None] + radius_b) ** 2)
        rows.append(first + i)
        columns.append(j)
    return np.concatenate(rows), np.concatenate(columns)


# -------------------------------------------------------------------- on a curve


class _Intervals(Segments):
    """Intervals between the rays through the target's vertices."""

    def _ends(self, target: Array) -> tuple[Array, Array]:
        sides = self._target.facets[:, np.concatenate(self._target.shape.sides)]
        self._vertices, first = np.unique(sides, return_index=True)
        self._facet_at = first // sides.shape[1]
        # the target's own ends count however far ahead they are: what faces nothing there hardly counts
        return target[self._vertices], np.where(self._sharp[self._vertices], np.inf, 0.0)

    def _images(self, facet: Index, end: Index, contactor: Array, target: Array) -> tuple[Array, Bool]:
        node = self._vertices[end]
        η, d = images_on_curve(self._facets.shape, contactor[facet], target[node])
        d *= self._facets.orientation[facet]
        return η, (d >= -self._reach) & ((d <= self._reach) | self._sharp[node]) & (np.abs(η - 0.5) <= 0.5)

    def _points(self, facet: Index, end: Index, images: Array) -> IntegrationPoints:
        facet, first, last, *cuts = cuts_on_curve(facet, images, self._facets.size)
        points, node = self._on_intervals(facet, first, last), self._vertices[end]
        moves = np.append(self._sharp[node], False)  # where the integrand jumps, and not at a facet's end, −1
        begin, close = (np.where(moves[cut], cut, -1) for cut in cuts)
        at = points.facet, points.η[:, 0], points.weight
        moving = MovingCuts.of(at, (facet, first, last), (begin, close), (node, self._facet_at[end]))
        return points if moving is None else replace(points, cuts=moving)

    def _on_intervals(self, facet: Index, first: Array, last: Array) -> IntegrationPoints:
        """Points of intervals (m,) of facets, between a first and a last η."""
        ξ, weight = self._facets.shape.quadrature(self._degree)
        length = (last - first)[:, None]
        points = (first[:, None] + length * ξ[:, 0]).reshape(-1, 1)
        weights = (length * weight).ravel()
        return IntegrationPoints(self._facets, np.repeat(facet, len(weight)), points, weights, self._thickness)


class _IntervalsAtEnds(_Intervals):
    """Gauss points, on a curve, of whole facets, and of each part of a facet inside which the target ends or shows its side:
    points that would slide off with all that they bear move along with the end.

    Args:
        target: the target, whole.
        gauss: points of whole facets.
        degree: of the quadrature on each part.
        comm: of the ranks that have the contactor.
    """

    still, growth, settles = STILL_AT_ENDS, GROWTH_AT_ENDS, SETTLES

    def __init__(self, target: GatheredFacets, gauss: IntegrationPoints, degree: int, comm: MPI.Intracomm) -> None:
        self._gauss = gauss
        self._first = np.ones(gauss.facets.size)
        np.minimum.at(self._first, gauss.facet, gauss.η[:, 0])
        super().__init__(gauss.facets, target, degree, gauss.thickness, comm)

    def _ends(self, target: Array) -> tuple[Array, Array]:
        every = super()._ends(target)
        sharp = self._sharp[self._vertices]
        self._vertices, self._facet_at = self._vertices[sharp], self._facet_at[sharp]
        return every[0][sharp], every[1][sharp]

    def _points(self, facet: Index, end: Index, images: Array) -> IntegrationPoints:
        amid = np.abs(images - 0.5) < 0.5 - self._first[facet]
        facet, images = facet[amid], images[amid]
        return super()._points(facet, end[amid], images) if len(facet) else self._gauss

    def _on_intervals(self, facet: Index, first: Array, last: Array) -> IntegrationPoints:
        whole = np.bincount(facet, minlength=self._facets.size) == 1
        return self._gauss.spliced(super()._on_intervals(facet, first, last), whole)


def images_on_curve(shape: ShapeFunctions, nodes: Array, y: Array) -> tuple[Array, Array]:
    """Where the rays of curved facets with `nodes` (n, k, 2) pass through 𝐲 (n, 2): η (n,), infinite where none does near the
    facet, and the signed distance d (n,) along the normal's line (m)."""
    powers = np.linalg.inv(shape.nodes ** np.arange(shape.order + 1))  # 𝐱(η) = Σ_k 𝐜_k η^k
    c0, c1, *rest = np.moveaxis(powers @ nodes, 1, 0)
    chord = c1 + rest[0] if rest else c1
    η = dot(y - c0, chord) / dot(chord, chord)
    outside = np.abs(η - 0.5) > 1.5  # so far off that a curved facet's rays mean nothing
    a, r = c1, y - c0 - c1 * η[:, None]
    if rest:
        η = np.clip(η, -1.0, 2.0)
        for _ in range(NEWTON):
            a, r = c1 + 2 * rest[0] * η[:, None], y - c0 - (c1 + rest[0] * η[:, None]) * η[:, None]
            slope = 2 * dot(r, rest[0]) - dot(a, a)
            step = np.clip(-dot(r, a) / np.where(slope == 0.0, -1.0, slope), -0.5, 0.5)
            if np.max(np.abs(step)[~outside], initial=0.0) <= SNAP**2:
                break
            η = np.clip(η + step, -1.0, 2.0)
        outside |= np.abs(step) > SNAP
    d = (r[:, 0] * a[:, 1] - r[:, 1] * a[:, 0]) / np.linalg.norm(a, axis=1)
    return np.where(outside, np.inf, η), d


def cuts_on_curve(facet: Index, η: Array, size: int) -> tuple[Index, Array, Array, Index, Index]:
    """Intervals between cuts at η (n,) in [0, 1] of facets (n,) out of `size`: facet, first and last η of each (m,), and
    which cuts these are, −1 at a facet's end."""
    all_facets = np.arange(size)
    owner, at = np.concatenate([facet, all_facets, all_facets]), np.concatenate([η, np.zeros(size), np.ones(size)])
    cut = np.concatenate([np.arange(len(facet)), np.full(2 * size, -1)])
    order = np.lexsort([at, owner])
    owner, at, cut = owner[order], at[order], cut[order]
    at = np.where(at > 1.0 - SNAP, 1.0, at)  # ends win over cuts that are close
    keep = np.r_[True, (np.diff(owner) > 0) | (np.diff(at) > SNAP)] if len(at) else np.zeros(0, dtype=bool)
    owner, at, cut = owner[keep], at[keep], np.where((at == 0.0) | (at == 1.0), -1, cut)[keep]
    same = np.flatnonzero(np.diff(owner) == 0)
    return owner[same], at[same], at[same + 1], cut[same], cut[same + 1]


# -------------------------------------------------------------------- on a surface


class _Polygons(Segments):
    """Polygons: target facets as seen along each contactor facet's mean normal, in the coordinates of its mean tangents.

    On flat triangles and parallelograms these are the reference coordinates; on other facets they are off by a share of
    their size that shrinks with it, and so are the cuts (``docs/integration.md``).

    Args:
        target: the target, whole.
        whole: points of facets that see no target, or layer behind layer.
        degree: of the quadrature on each triangle.
        comm: of the ranks that have the contactor.
    """

    def __init__(self, target: GatheredFacets, whole: IntegrationPoints, degree: int, comm: MPI.Intracomm) -> None:
        facets, self._whole = whole.facets, whole
        own, other = facets.shape.corners, target.shape.corners
        self._loop, self._other_loop = _loop(own), _loop(other)
        # the corners' own shape functions at the facet's middle
        self._linear = ShapeFunctions(facets.shape.cell, 1)
        self._dN = self._linear.tabulate(own.mean(axis=0)[None], 1)[1][0]
        self._triangle = ShapeFunctions(basix.CellType.triangle, 1)
        self._area = 1.0 if len(own) == 4 else 0.5
        super().__init__(facets, target, degree, whole.thickness, comm)

    def _ends(self, target: Array) -> tuple[Array, Array]:
        return balls(target[self._target.facets])

    def _chart(self, contactor: Array) -> tuple[Array, Array, Array]:
        """Of each facet's corners: centre (nf, 3), outward unit normal (nf, 3) and contravariant tangents (nf, 2, 3)."""
        corners = contactor[:, : len(self._facets.shape.corners)]
        a = self._dN @ corners
        normal = surface_normal(a) * self._facets.orientation[:, None]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return corners.mean(axis=1), normal, np.linalg.inv(a @ np.swapaxes(a, 1, 2)) @ a

    def _images(self, facet: Index, end: Index, contactor: Array, target: Array) -> tuple[Array, Bool]:
        centre, normal, dual = self._chart(contactor)
        middle = self._facets.shape.corners.mean(axis=0)
        corners = target[self._target.facets[end][:, self._other_loop]]
        r = corners - centre[facet, None]
        image = middle + r @ np.swapaxes(dual[facet], 1, 2)
        d = (r @ normal[facet][:, :, None])[:, :, 0]
        own = contactor[:, self._loop] - centre[:, None]
        #: (nf, corners, 2) the facets' own corners in these coordinates
        self._window: Array = middle + own @ np.swapaxes(dual, 1, 2)
        low, high = self._window.min(axis=1)[facet], self._window.max(axis=1)[facet]
        near = ((image.min(axis=1) < high - SNAP) & (image.max(axis=1) > low + SNAP)).all(axis=1)
        return image, near & (np.abs(d).min(axis=1) <= self._reach)

    def _points(self, facet: Index, end: Index, images: Array) -> IntegrationPoints:
        turn = areas(images, np.full(len(images), images.shape[1]))
        facing = turn * self._facets.orientation[facet] * self._target.orientation[end] < 0.0
        facet, images, turn = facet[facing], images[facing], turn[facing]
        images[turn < 0.0] = images[turn < 0.0, ::-1]
        polygons, count = clip(images, self._window[facet])
        polygons = self._to_reference(self._window[facet], polygons)
        area = areas(polygons, count) / self._area
        real = (count > 2) & (area > SLIVER)
        covered = np.bincount(facet[real], area[real], minlength=self._facets.size)
        polygons, count, left = self._without_trifles(facet, polygons, count, np.where(real, area, 0.0))
        kept = np.bincount(facet, left, minlength=self._facets.size)
        # where the target is seen twice, layer behind layer, or all but not at all
        plain = (covered > 1.0 + HARDLY) | (covered < HARDLY)
        real = (left > 0.0) & ~plain[facet]
        row, triangles = triangulate(polygons[real], count[real])
        seen = list(self._on_triangles(facet[real][row], triangles))
        seen[2] = seen[2] * (covered / np.maximum(kept, SLIVER))[seen[0]]
        rest = self._left_over(facet[real], polygons[real], count[real], np.where(plain, 1.0, covered))
        owner: Index = np.concatenate([seen[0], rest[0]])
        η, weight = (np.concatenate([seen[k], rest[k]]) for k in (1, 2))
        parts = IntegrationPoints(self._facets, owner, η, weight, self._thickness)
        return self._whole.spliced(parts, plain)

    def _without_trifles(self, facet: Index, polygons: Array, count: Index, area: Array) -> tuple[Array, Index, Array]:
        """Polygons of facets (m,) of areas (m,), as they are integrated over, and their areas, 0 where they are not: the
        others on the facet have what these cover."""
        return polygons, count, area

    def _left_over(self, facet: Index, polygons: Array, count: Index, covered: Array) -> tuple[Index, Array, Array]:
        """Facet, η and weight of points where facets see nothing, of which the share `covered` (nf,) lies in `polygons` of
        facets (m,): they hold multipliers of which the target sees next to nothing."""
        η, weight = self._facets.shape.quadrature(LEFT_OVER)
        hardly = self.fills & (covered < 0.5)
        partly = np.flatnonzero(hardly)
        free = np.ones((self._facets.size, len(weight)), dtype=bool)
        some = np.flatnonzero(hardly[facet])
        np.logical_and.at(free, facet[some], ~contains(polygons[some], count[some], η))
        row, point = np.nonzero(free[partly])
        total = np.bincount(row, weight[point], minlength=len(partly))
        share = (1.0 - covered[partly]) * self._area / np.maximum(total, SLIVER)
        return partly[row], η[point], weight[point] * share[row]

    def _to_reference(self, window: Array, polygons: Array) -> Array:
        """Reference coordinates of vertices (m, v, 2) given in those of the mean tangents, where the facets' corners in order
        are `window` (m, corners, 2)."""
        if window.shape[1] == 3:
            return polygons
        nodes = np.empty_like(window)
        nodes[:, self._loop] = window
        η = polygons.copy()
        for _ in range(NEWTON):
            N, dN = self._linear.tabulate(η.reshape(-1, 2), 1)
            N, dN = N.reshape(*η.shape[:2], 4), dN.reshape(*η.shape[:2], 2, 4)
            A = np.swapaxes(dN @ nodes[:, None], 2, 3)
            step = (inverse(A.reshape(-1, 2, 2)).reshape(A.shape) @ (polygons - N @ nodes)[..., None])[..., 0]
            η += step
            if np.abs(step).max(initial=0.0) <= SLIVER:
                break
        return η

    def _on_triangles(self, facet: Index, triangles: Array) -> tuple[Index, Array, Array]:
        """Facet, η and weight of the points of triangles (m, 3, 2) in the reference facet."""
        ξ, weight = self._triangle.quadrature(self._degree)
        η = self._triangle.tabulate(ξ)[0] @ triangles
        side = triangles[:, 1:] - triangles[:, :1]
        jacobian = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]
        return np.repeat(facet, len(weight)), η.reshape(-1, 2), (jacobian[:, None] * weight).ravel()


class _PolygonsAtEnds(_Polygons):
    """Gauss points of whole facets, and polygons of those inside which, or near which, the target ends or shows its side.
    The arguments are those of :class:`_Polygons`."""

    still, growth, settles = STILL_AT_ENDS, GROWTH_AT_ENDS, SETTLES

    def __init__(self, target: GatheredFacets, gauss: IntegrationPoints, degree: int, comm: MPI.Intracomm) -> None:
        super().__init__(target, gauss, degree, comm)
        corners = self._sharp[target.facets[:, self._other_loop]]
        #: (nf, sides) which sides of the target's facets, from corner to corner, are such ends
        self._sharp_sides = corners & np.roll(corners, -1, axis=1)
        self._is_end = np.asarray(corners.any(axis=1))

    def _near_ends(self, facets: tuple[Array, Array], ends: tuple[Array, Array]) -> tuple[Index, Index]:
        x, radius = facets
        cut = np.unique(_near_balls(x, radius, *(a[self._is_end] for a in ends))[0])
        facet, end = _near_balls(x[cut], radius[cut], *ends)
        return cut[facet], end

    def _images(self, facet: Index, end: Index, contactor: Array, target: Array) -> tuple[Array, Bool]:
        images, near = super()._images(facet, end, contactor, target)
        at_end = near & self._is_end[end]
        at_end[at_end] = self._ends_inside(facet[at_end], end[at_end], images[at_end])
        cut = np.zeros(self._facets.size, dtype=bool)
        cut[facet[at_end]] = True
        return images, near & cut[facet]

    def _ends_inside(self, facet: Index, end: Index, images: Array) -> Bool:
        """(m,) whether an end of the target, a side of facets `end` (m,) that are seen as `images` (m, corners, 2), passes
        the box around the contactor's facets (m,), or goes by within BESIDE of it."""
        low, high = self._window[facet].min(axis=1)[:, None], self._window[facet].max(axis=1)[:, None]
        middle, half = (low + high) / 2, (0.5 + BESIDE) * (high - low)
        first = images - middle
        last = np.roll(first, -1, axis=1)
        overlap = (np.minimum(first, last) <= half) & (np.maximum(first, last) >= -half)
        side = np.abs(last - first)
        across = np.abs(
            first[..., 0] * last[..., 1] - first[..., 1] * last[..., 0]
        )  # of the middle's distance from the line
        meets = overlap.all(axis=2) & (across <= side[..., 1] * half[..., 0] + side[..., 0] * half[..., 1])
        return np.asarray((meets & self._sharp_sides[end]).any(axis=1))

    def _without_trifles(self, facet: Index, polygons: Array, count: Index, area: Array) -> tuple[Array, Index, Array]:
        polygons, count = without_flat_corners(polygons, count, THIN * self._area)
        left = np.where(area > 0.0, areas(polygons, count) / self._area, 0.0)
        covers = np.bincount(facet[left > THIN], minlength=self._facets.size) > 0
        return polygons, count, np.where((left > THIN) | ~covers[facet], left, 0.0)

    def _points(self, facet: Index, end: Index, images: Array) -> IntegrationPoints:
        return super()._points(facet, end, images) if len(facet) else self._whole


def _loop(corners: Array) -> Index:
    """The corners of a reference facet in anticlockwise order."""
    arm = corners - corners.mean(axis=0)
    return np.asarray(np.argsort(np.arctan2(arm[:, 1], arm[:, 0])))
