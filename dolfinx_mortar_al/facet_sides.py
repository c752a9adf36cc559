"""On which side of curved facets points lie, for certain and at little cost: bounds in place of closest points.

A facet's normals 𝐚₁ × 𝐚₂ (a curve's turned tangents) and its points are polynomials in η, convex combinations of their
Bernstein coefficients. So normals stay in a cone around a mean normal 𝐦, of half-angle θ, and points in a slab across 𝐦:
what is farther in front of the slab than tan θ times as far as it is beside the facet's points lies in front of all of them.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import factorial

import basix
import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import dot
from dolfinx_mortar_al.search import where
from dolfinx_mortar_al.surface import GatheredFacets, ShapeFunctions, surface_normal

__all__ = ["holding_points", "is_behind"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

ROUND_OFF = 1e-12  # of a facet: a side that hangs on less is not known


def is_behind(target: GatheredFacets, positions: Array, x: Array, candidates: Index, depth: Array) -> tuple[Bool, Bool]:
    """(n,) whether 𝐱 (n, gdim) lies in the target as closest points say, by `depth` or more behind one that is not at an end
    of it; and (n,) whether that is known: 𝐱 lies on the same side of all facets that may hold its closest point.

    Args:
        target: the surface.
        positions: (nodes, gdim) current positions of its nodes (m).
        candidates: (n, k) facets that may hold the closest point, padded with −1.
        depth: (n,) in m.
    """
    centre, normal, low, high, radius, cosine = _bounds(target, positions)
    row, column = where(candidates >= 0)
    facet = candidates[row, column]
    r = x[row] - centre[facet]
    along = dot(r, normal[facet])
    beside = np.sqrt(np.maximum(dot(r, r) - along**2, 0.0)) + radius[facet]
    cos = np.maximum(cosine[facet], 0.0)
    least = beside * np.sqrt(1.0 - cos**2) + ROUND_OFF * target.size_of_facets
    front: Bool = np.zeros(candidates.shape, dtype=bool)
    behind: Bool = np.zeros(candidates.shape, dtype=bool)
    front[row, column] = (along - high[facet]) * cos > least
    below = low[facet] - along
    behind[row, column] = (below * cos > least) & (below >= depth[row]) & ~np.any(target.boundary_sides, axis=1)[facet]
    none = candidates < 0
    inside: Bool = np.all(behind | none, axis=1)
    return inside, inside | np.all(front | none, axis=1)


def _bounds(target: GatheredFacets, positions: Array) -> tuple[Array, ...]:
    """Of each facet: centre (nf, gdim), mean unit normal (nf, gdim), least and largest height of its points along it over
    the centre (nf,), radius of a ball around the centre that holds them (nf,), and least cosine of its normals with it (nf,).
    """
    shape, nodes = target.shape, positions[target.facets]
    points, of_normals = _net(shape.cell, _normal_degree(shape))
    of_points = holding_points(shape)
    a = shape.tabulate(points, 1)[1][None] @ nodes[:, None]
    normals = of_normals @ (surface_normal(a) * target.orientation[:, None, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    mean = normals.mean(axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    net = of_points @ nodes
    centre = net.mean(axis=1)
    net -= centre[:, None]
    height = (net @ mean[:, :, None])[:, :, 0]
    radius = np.linalg.norm(net, axis=2).max(axis=1)
    cosine = np.minimum((normals @ mean[:, :, None])[:, :, 0].min(axis=1), 1.0)
    return centre, mean, height.min(axis=1), height.max(axis=1), radius, cosine


def _normal_degree(shape: ShapeFunctions) -> int:
    """Degree of a facet's normal in η, of a quadrilateral's in each of both."""
    if shape.dim == 1:
        return shape.order - 1
    return 2 * (shape.order - 1) if len(shape.corners) == 3 else 2 * shape.order - 1


@cache
def _net(cell: basix.CellType, degree: int) -> tuple[Array, Array]:
    """Points (m, dim) of a facet and the matrix (m, m) from values there to their polynomial's Bernstein coefficients."""
    if degree == 0:
        return basix.geometry(cell).mean(axis=0)[None], np.ones((1, 1))
    points = np.array(_exponents(cell, degree))[:, : _dim(cell)] / degree
    return points, _coefficients(cell, degree, points)


def holding_points(shape: ShapeFunctions) -> Array:
    """(m, nodes) from a facet's nodes to points between which it lies, whatever their positions: its polynomial's Bernstein
    coefficients."""
    return _of_nodes(shape.cell, shape.order)


@cache
def _of_nodes(cell: basix.CellType, order: int) -> Array:
    return _coefficients(cell, order, ShapeFunctions(cell, order).nodes)


def _coefficients(cell: basix.CellType, degree: int, points: Array) -> Array:
    """(m, m) from values at points (m, dim) to Bernstein coefficients of the degree."""
    values = [_bernstein(cell, degree, e, points) for e in _exponents(cell, degree)]
    return np.asarray(np.linalg.inv(np.stack(values, axis=1)))


def _dim(cell: basix.CellType) -> int:
    return len(basix.topology(cell)) - 1


def _exponents(cell: basix.CellType, degree: int) -> list[tuple[int, ...]]:
    """Of the Bernstein polynomials' factors η, one tuple each."""
    every = list(product(range(degree + 1), repeat=_dim(cell)))
    return [e for e in every if sum(e) <= degree] if cell == basix.CellType.triangle else every


def _bernstein(cell: basix.CellType, degree: int, exponents: tuple[int, ...], η: Array) -> Array:
    """(m,) one of the polynomials at η (m, dim)."""
    if cell == basix.CellType.triangle:
        i, j, k = *exponents, degree - sum(exponents)
        count = factorial(degree) // (factorial(i) * factorial(j) * factorial(k))
        return np.asarray(count * η[:, 0] ** i * η[:, 1] ** j * (1.0 - η.sum(axis=1)) ** k)
    value = np.ones(len(η))
    for i, t in zip(exponents, η.T, strict=True):
        value *= factorial(degree) // (factorial(i) * factorial(degree - i)) * t**i * (1.0 - t) ** (degree - i)
    return value
