"""Where the contactor's integrals are taken: points and weights on its reference facets.

Either Gauss points, which stay where they are, or those of segments (`segments.py`). Their number differs from facet to
facet; all that comes after takes points one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from basix import CellType
from numpy.typing import NDArray

from dolfinx_mortar_al.moving_cuts import MovingCuts
from dolfinx_mortar_al.surface import Facets, GatheredFacets, ShapeFunctions, surface_normal

__all__ = ["IntegrationPoints", "default_degree", "degrees_on", "segment_degree"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Non-matching target facets make integrands with kinks: twice the degree of the products of shape functions
# (docs/integration.md has the defect of the patch test against the number of points)
PER_ORDER = 4
# six points on a facet of order 1 in the plane: with three pressures were up to 3.5 % off, now 1.2 % (docs/robustness.md)
ORDER_1_IN_PLANE = 10
# a membrane has no bending stiffness: its pressure jumps at the edge of contact, inside a facet (docs/membranes.md)
PER_ORDER_ON_CURVES = 6
PER_TARGET_FACET = 2.0  # points along each target facet's length: none is passed over
# points across a surface in space: where a few facets are all of it contact is a part of one (docs/integration.md)
ACROSS = 32
UNFELT = 0.02  # of a facet: overlaps that are said (`unfelt.py`)
HIGHEST = 30
APART = 1e-12  # in η: points that are no farther apart are the same
FLAT = 1e-9  # of the spread of points, that across it counts for none
ROUND_OFF = 1e-6  # of a number of points: facets that are alike but for it get as many


def default_degree(facets: Facets, is_membrane: bool) -> int:
    """The quadrature degree that is used unless the user names one or the target's facets are finer."""
    order = facets.shape.order
    if facets.shape.dim == 2:
        return PER_ORDER * order
    if is_membrane:
        return PER_ORDER_ON_CURVES * order + 1
    return ORDER_1_IN_PLANE if order == 1 else PER_ORDER * order


def degrees_on(facets: Facets, degree: int, faced: Array, surface: GatheredFacets) -> Index:
    """(nf,) the degree on each facet of the contactor `surface`, `degree` or more: with PER_TARGET_FACET points on each of
    the target's facets, whose extents are `faced` (nf,) in metres; in space with ACROSS points across the surface, too, and
    with one near each corner that a plane may touch first."""
    dim, size = facets.shape.dim, facets.extents()
    points = PER_TARGET_FACET * size / faced
    if dim == 2:
        points = np.maximum(points, ACROSS * size / np.sqrt(surface.areas().sum()))
    degrees = np.clip(2 * np.ceil(points - ROUND_OFF).astype(np.int64) - 1, degree, HIGHEST)
    return _degrees_at_corners(facets, degrees, surface) if dim == 2 else degrees


def _degrees_at_corners(facets: Facets, degrees: Index, surface: GatheredFacets) -> Index:
    """(nf,) the `degrees` (nf,) or more, with which a plane across the mean normal at a corner meets a point of the facet
    before the corner has dipped into it by UNFELT facets."""
    degrees, shape, most = degrees.copy(), facets.shape, UNFELT * np.sqrt(facets.areas())
    normal = surface.normals_at_corners[surface.places_of(facets)]
    corner = shape.tabulate(shape.corners)[0] @ facets.X
    for degree in range(int(degrees.min(initial=HIGHEST)), HIGHEST):
        rows = np.flatnonzero(degrees == degree)
        x = shape.tabulate(shape.quadrature(degree)[0])[0] @ facets.X[rows]
        apart = corner[rows][:, :, None] - x[:, None]  # (rows, corners, points, gdim)
        felt = (apart @ normal[rows][..., None])[..., 0].min(axis=2)
        degrees[rows[(felt > most[rows, None]).any(axis=1)]] += 1
    return degrees


def segment_degree(contactor: ShapeFunctions, target: ShapeFunctions, multiplier_order: int) -> int:
    """The degree on each segment that is used unless the user names one: on flat facets exact for products of the
    multiplier with displacements of either side, and of the contactor's displacements with each other where they are
    triangles or lines (on quadrilaterals a shape function's degree is twice its order)."""
    double, other = (2 if shape.cell == CellType.quadrilateral else 1 for shape in (contactor, target))
    own = double * (contactor.order + multiplier_order) if double == 2 else 2 * contactor.order
    return max(own, double * multiplier_order + other * target.order)


@dataclass(frozen=True)
class IntegrationPoints:
    """The n points of this rank, facet after facet.

    Attributes:
        facets: they lie on.
        facet: (n,) the facet of each point, ascending.
        η: (n, dim) where on it; weight: (n,) in the reference facet.
        thickness: out of the plane (m).
    """

    facets: Facets
    facet: Index
    η: Array
    weight: Array
    thickness: float
    #: which of them move with ends of the target, if any do
    cuts: MovingCuts | None = None

    @classmethod
    def gauss(cls, facets: Facets, degrees: Index, thickness: float) -> IntegrationPoints:
        """Gauss points, on each facet of its own of the `degrees` (nf,)."""
        facet: list[Index] = [np.zeros(0, dtype=np.int64)]
        η: list[Array] = [np.zeros((0, facets.shape.dim))]
        weight: list[Array] = [np.zeros(0)]
        for degree in np.unique(degrees):
            own, (points, weights) = np.flatnonzero(degrees == degree), facets.shape.quadrature(int(degree))
            facet.append(np.repeat(own, len(weights)))
            η.append(np.tile(points, (len(own), 1)))
            weight.append(np.tile(weights, len(own)))
        order = np.argsort(np.concatenate(facet), kind="stable")
        return cls(
            facets, np.concatenate(facet)[order], np.concatenate(η)[order], np.concatenate(weight)[order], thickness
        )

    @property
    def size(self) -> int:
        return len(self.facet)

    @cached_property
    def _tabulated(self) -> tuple[Array, Array]:
        N, dN = self.facets.shape.tabulate(self.η, 1)
        return N, dN

    @property
    def N(self) -> Array:
        """(n, nodes) the contactor's shape functions N1."""
        return self._tabulated[0]

    @property
    def dN(self) -> Array:
        """(n, dim, nodes) their derivatives N1,α."""
        return self._tabulated[1]

    @cached_property
    def j(self) -> Array:
        """(n,) weight × reference area of each point (m², thickness included)."""
        normal = surface_normal(self.tangents(self.facets.X))
        return np.asarray(self.weight * np.linalg.norm(normal, axis=1) * self.thickness)

    def interpolate(self, nodal: Array) -> Array:
        """(n, gdim) values at the points of a nodal field (nf, nodes, gdim)."""
        return np.asarray((self.N[:, None, :] @ nodal[self.facet])[:, 0])

    def tangents(self, X: Array) -> Array:
        """(n, dim, gdim) 𝐚₁_α = N1,α X with the nodes at X (nf, nodes, gdim)."""
        return np.asarray(self.dN @ X[self.facet])

    def normals(self, tangents: Array) -> Array:
        """(n, gdim) outward normal × area ratio of the contactor with the given tangents."""
        return surface_normal(tangents) * self.facets.orientation[self.facet, None]

    def sum_by_facet(self, values: Array) -> Array:
        """(nf, …) sums of (n, …) over each facet's points."""
        total = np.zeros((self.facets.size, *values.shape[1:]))
        if self.size:
            total[self.facet[self._starts]] = np.add.reduceat(values, self._starts, axis=0)
        return total

    @cached_property
    def _starts(self) -> Index:
        """Where each facet's points begin."""
        return np.flatnonzero(np.r_[True, np.diff(self.facet) > 0])

    def between(self, values: Array, facet: Index, η: Array) -> Array:
        """(m, …) values (n, …) of these points between them, at (m,) facets and (m, dim) η: weighted by inverse fourth powers
        of distances (Shepard 1968), so that they are those of a point where one is, and continuous; zero on facets that have
        none."""
        place, there = self._places(facet)
        apart = sum((self.η[place, i] - η[:, i, None]) ** 2 for i in range(η.shape[1]))
        weight = there / (apart + APART**2) ** 2
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
        return np.asarray(np.einsum("mk,mk...->m...", weight, values[place]))

    def in_line(
        self, values: Array, kind: Index, wanted: Index, facet: Index, η: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """(m, v) values (n, v) of those of these points that are of the `wanted` kind (m,), of kinds (n,), at (m,) facets
        and (m, dim) η, affine between and beyond them, weighted as in :meth:`between` (moving least squares); and (m,) where
        there are enough of them."""
        place, there = self._places(facet)
        there &= kind[place] == wanted[:, None]
        apart = self.η[place] - η[:, None]  # (m, k, dim)
        weight = there / ((apart**2).sum(axis=2) + APART**2) ** 2
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
        middle, mean = (np.einsum("mk,mkv->mv", weight, v) for v in (apart, values[place]))
        off, more = apart - middle[:, None], values[place] - mean[:, None]
        spread, with_values = (np.einsum("mk,mka,mkv->mav", weight, off, v) for v in (off, more))
        size = np.trace(spread, axis1=1, axis2=2)
        spread += (FLAT * size + 1e-300)[:, None, None] * np.eye(η.shape[1])  # points on a line say nothing across it
        slope = np.linalg.solve(spread, with_values)
        return mean - np.einsum("ma,mav->mv", middle, slope), there.sum(axis=1) > η.shape[1]

    def _places(self, facet: Index) -> tuple[Index, NDArray[np.bool_]]:
        """(m, k) the points on the facets (m,), the last again where there are fewer, and which are no such repetition."""
        count = np.bincount(self.facet, minlength=self.facets.size)
        first = np.cumsum(count) - count
        number = np.arange(count.max(initial=1))
        place = np.minimum(number, count[facet, None] - 1) + first[facet, None]
        return place, number < count[facet, None]

    def nearest(self, facet: Index, η: Array) -> Index:
        """(m,) which of these points is the nearest on the same facet to each of (m,) facets and (m, dim) η."""
        place, _ = self._places(facet)
        distance = np.zeros(place.shape)
        for i in range(η.shape[1]):
            distance += np.abs(self.η[place, i] - η[:, i, None])
        return np.asarray(place[np.arange(len(facet)), distance.argmin(axis=1)])

    def spliced(self, others: IntegrationPoints, keep: NDArray[np.bool_]) -> IntegrationPoints:
        """These points on the facets `keep` (nf,), others on the rest."""
        mine, theirs = keep[self.facet], ~keep[others.facet]
        columns = [
            np.concatenate([getattr(self, name)[mine], getattr(others, name)[theirs]])
            for name in ("facet", "η", "weight")
        ]
        order = np.argsort(columns[0], kind="stable")
        facet, η, weight = (column[order] for column in columns)
        return IntegrationPoints(self.facets, facet, η, weight, self.thickness)

    @cached_property
    def spacing(self) -> Array:
        """(n,) reference distance between points, roughly: the facet's area per point to the power 1/dim (m)."""
        count = np.bincount(self.facet, minlength=self.facets.size)[self.facet]
        area = self.sum_by_facet(self.j)[self.facet] / self.thickness
        return np.asarray((area / count) ** (1.0 / self.facets.shape.dim))
