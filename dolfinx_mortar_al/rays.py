"""Projection along the contactor's normal: 𝐱 + d 𝐧 = 𝐲(η), with ν = −𝐧 and g = −d (``docs/projection.md``).

A Gauss point lies inside its facet, where 𝐧 is smooth, and the target is a continuous surface: 𝐲, ν and g are continuous
in the displacements, also where the ray passes from one target facet to the next. The pressure acts along 𝐲 − 𝐱, so that a
pair's normal forces have no moment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from basix import CellType
from numpy.typing import NDArray

from dolfinx_mortar_al.closest_point import penetrates
from dolfinx_mortar_al.facet_sides import is_behind
from dolfinx_mortar_al.projection import Projection, TargetPoint, combine, dot
from dolfinx_mortar_al.search import BULGE, across, candidates
from dolfinx_mortar_al.surface import GatheredFacets, ShapeFunctions, surface_normal

__all__ = ["Hits", "RayHit", "cast", "extend", "hits"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ALMOST = 1.5e-8  # step in η after which Newton, which squares it, leaves round-off
EDGE = 1e-9  # how far beyond a facet's sides, in η, a hit still counts: no ray slips through between two facets
FACING = 0.1  # least cosine between ray and target's normal: flatter hits have no sensible gap
# the same where integrals end with the target: a multiplier goes on beside its corner, and must not press on the side there;
# elsewhere hits count less and less from there to FACING
OPPOSED = 0.5
# penetration, in facets, beyond which the closest point must confirm a hit behind the contactor: 𝐱 is in the target, and as
# deep as a flat one would be that the ray meets as slantingly as FACING lets it
DEEP = 0.5
ITSELF = 1e-6  # facets behind a point: nearer is, but for round-off, the facet that it is on, where contactor is target
BEYOND = 1.0  # how far beyond the sides of a facet at the target's end, in η, it may go on while a solve is on its way
MAX_ITERATIONS = 12  # of Newton for the hit on a curved facet; five do, unless the ray all but touches the facet


@dataclass
class Hits:
    """Meetings of lines with facets: `row` (m,) of a line, `facet` (m,) and η (m, dim), signed distance d (m,) along the
    line, in m, and the facet's shape functions there, N (m, nodes) and dN (m, dim, nodes)."""

    row: Index
    facet: Index
    η: Array
    d: Array
    N: Array
    dN: Array

    def take(self, which: Index | NDArray[np.bool_]) -> Hits:
        """Some of them."""
        return Hits(self.row[which], self.facet[which], self.η[which], self.d[which], self.N[which], self.dN[which])


@dataclass
class RayHit(Projection):
    """Where the rays of n contactor points meet the target.

    Attributes:
        tangents: (n, dim, gdim) 𝐚₁_α of the contactor at 𝐱.
    """

    tangents: Array

    @property
    def cosine(self) -> Array:
        """(n,) of the angle between each ray and the target's normal, either way."""
        m = surface_normal(self.a)
        return np.asarray(np.abs(dot(m, self.ν)) / np.sqrt(dot(m, m)))

    def opposed(self) -> NDArray[np.bool_]:
        """(n,) where the target's normal opposes the contactor's by an angle that is no side's (OPPOSED)."""
        return np.asarray(self.cosine >= OPPOSED)

    def frontal(self, least: float) -> tuple[Array, Array]:
        """(n,) one where the target's normal opposes the contactor's by no side's angle, down to `least` where it hardly
        faces the ray and where nothing does; and the derivative with respect to the cosine."""
        slope = 1.0 / (OPPOSED - FACING)
        share = np.where(self.facing, slope * (self.cosine - FACING), 0.0)
        return np.clip(share, least, 1.0), np.where((share > least) & (share < 1.0), slope, 0.0)


def cast(
    target: GatheredFacets,
    positions: Array,
    x: Array,
    normal: Array,
    tangents: Array,
    couples: tuple[Index, Index],
    counts: Callable[[Hits], NDArray[np.bool_]] | None = None,
) -> RayHit:
    """The nearest valid hit of each point's ray, in front of the contactor or, in penetration, behind it.

    Args:
        target: the surface.
        positions: (nodes, gdim) current positions of its nodes (m).
        x: (n, gdim) contactor points (m).
        normal: (n, gdim) the contactor's outward unit normal there; tangents: (n, dim, gdim) its covariant tangents (m).
        couples: rays (m,), ascending, and facets (m,) that they may meet.
        counts: which hits do (m,), in place of the closest points where they are deep.
    """
    found = hits(target.shape, positions[target.facets], x, normal, *couples)
    cosine = _cosine(target, positions, found, normal)
    opposed = (cosine < -FACING) & ~_is_beyond(
        found, (cosine > 0.0) & (found.d < -ITSELF * target.size_of_facets), len(x)
    )
    if counts is not None:
        opposed &= counts(found)
    found = found.take(opposed)

    nearest = _first_of_each(found.row, np.abs(found.d))
    limit = DEEP * target.size_of_facets
    deep = nearest[found.d[nearest] < -limit] if counts is None else nearest[:0]
    if len(deep):
        rays = found.row[deep]
        outside = rays[~_is_inside(target, positions, x[rays], FACING * -found.d[deep])]
        found = found.take(~(np.isin(found.row, outside) & (found.d < 0)))
        nearest = _first_of_each(found.row, np.abs(found.d))
    found = found.take(nearest)  # by rows
    if len(found.row) < len(x):
        found, facing = _with_the_rest(found, target.shape, len(x), positions)
    else:
        facing = np.ones(len(x), dtype=bool)
    nodes = positions[target.facets[found.facet]]
    y, a = combine(found.N, nodes), found.dN @ nodes
    return RayHit(TargetPoint(found.facet, found.η), facing, found.N, found.dN, y, a, -normal, -found.d, tangents)


def _with_the_rest(found: Hits, shape: ShapeFunctions, n: int, positions: Array) -> tuple[Hits, NDArray[np.bool_]]:
    """A hit for each of n rays, and (n,) whether it is one: those that meet nothing have the middle of facet 0, at a distance
    that is no gap."""
    facing = np.zeros(n, dtype=bool)
    facing[found.row] = True
    middle = shape.corners.mean(axis=0)[None]
    N, dN = (np.repeat(table, n, axis=0) for table in shape.tabulate(middle, 1))
    far = np.full(n, float(np.linalg.norm(np.ptp(positions, axis=0))))
    every = Hits(np.arange(n), np.zeros(n, dtype=np.int64), np.repeat(middle, n, axis=0), far, N, dN)
    for whole, part in zip(vars(every).values(), vars(found).values(), strict=True):
        whole[found.row] = part
    return every, facing


def extend(at: RayHit, target: GatheredFacets, positions: Array, x: Array, which: Index, near: Index) -> Index:
    """Let points `which` (m,) of n at 𝐱 (n, gdim), which face nothing, face one of the facets `near` (m, k) as it goes on
    beyond its sides, by BEYOND of its size at most: the one that the ray misses by least. Returns those that do."""
    normal, nodes = -at.ν[which], positions[target.facets]
    couples = np.repeat(np.arange(len(which)), near.shape[1]), near.ravel()
    found = hits(target.shape, nodes, x[which], normal, *couples, beyond=BEYOND)
    found = found.take(_cosine(target, positions, found, normal) < -FACING)
    missed = -_inside_by(found.η, len(target.shape.corners) == 3)
    found = found.take(_first_of_each(found.row, missed))
    held, own = which[found.row], nodes[found.facet]
    at.point.facet[held], at.point.η[held], at.facing[held], at.g[held] = found.facet, found.η, True, -found.d
    at.N[held], at.dN[held], at.a[held], at.y[held] = found.N, found.dN, found.dN @ own, combine(found.N, own)
    return np.asarray(held)


def _cosine(target: GatheredFacets, positions: Array, found: Hits, normal: Array) -> Array:
    """(m,) between the target's normal at hits and their rays, along `normal` (n, gdim)."""
    m = surface_normal(found.dN @ positions[target.facets[found.facet]]) * target.orientation[found.facet, None]
    return np.asarray(dot(m, normal[found.row]) / np.maximum(np.sqrt(dot(m, m)), 1e-300))


def _is_beyond(found: Hits, enters: NDArray[np.bool_], n: int) -> NDArray[np.bool_]:
    """(m,) hits behind one of n contactor points on the way back to which the line `enters` (m,) the target: the point itself
    is outside, and what it would penetrate is the far side of a tooth."""
    first = np.full(n, -np.inf)
    np.maximum.at(first, found.row[enters], found.d[enters])
    return np.asarray(found.d < first[found.row])


def _inside_by(η: Array, triangle: bool) -> Array:
    """(m,) how far η (m, dim) are from the nearest side of the reference facet, negative beyond it."""
    upper = 1.0 - η.sum(axis=1) if triangle else (1.0 - η).min(axis=1)
    return np.asarray(np.minimum(η.min(axis=1), upper))


def hits(
    shape: ShapeFunctions,
    nodes: Array,
    x: Array,
    normal: Array,
    row: Index,
    facet: Index,
    beyond: float = EDGE,
) -> Hits:
    """All meetings of the lines through 𝐱 (n, gdim) along `normal` with facets, from the couples (row, facet).

    `nodes` (nf, k, gdim) are the facets' nodes; meetings count up to `beyond` their sides.
    """
    axes = np.swapaxes(across(normal), 1, 2).copy()
    c = (nodes[facet] - x[row, None]) @ axes[row]  # the line is the origin
    c = np.moveaxis(c, (2, 1), (0, 1)).copy()  # NumPy is slow along a short axis that is not the first
    if beyond <= EDGE:  # otherwise facets leave their nodes' box
        near = _may_meet(shape, c)
        row, facet, c = row[near], facet[near], c[:, :, near]
    which, η = _on_curve(shape, c[0], beyond) if shape.dim == 1 else _on_patch(shape, c, beyond)
    row, facet = row[which], facet[which]
    N, dN = shape.tabulate(η, 1)
    return Hits(row, facet, η, dot(combine(N, nodes[facet]) - x[row], normal[row]), N, dN)


def _may_meet(shape: ShapeFunctions, c: Array) -> NDArray[np.bool_]:
    """(m,) whether the origin may lie in facets with nodes at c (dim, k, m): between the nodes' least and largest heights
    across the facet's sides, as they are in its middle."""
    heights = [c[0]]
    if shape.dim == 2:
        a = shape.tabulate(shape.corners.mean(axis=0)[None], 1)[1][0] @ c  # (2, 2, m)
        sides = [a[:, 0], a[:, 1]] + ([a[:, 0] - a[:, 1]] if len(shape.corners) == 3 else [])
        heights = [c[0] * side[1] - c[1] * side[0] for side in sides]
    near = np.ones(c.shape[2], dtype=bool)
    for height in heights:
        low, high = height.min(axis=0), height.max(axis=0)
        slack = BULGE[shape.order] * (high - low)
        near &= (low <= slack) & (high >= -slack)
    return near


def _on_curve(shape: ShapeFunctions, c: Array, beyond: float) -> tuple[Index, Array]:
    """Roots of Σ_k N_k(η) c_k on [0, 1], or up to `beyond` it: which column of c (k, m) each is of, and η (·, 1)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        if shape.order == 1:
            roots = (c[0] / (c[0] - c[1]))[None]
        else:
            a0, a1, a2 = _monomials(shape.cell, shape.order)[1] @ c
            discriminant = a1**2 - 4 * a2 * a0
            q = -0.5 * (a1 + np.where(a1 >= 0, 1.0, -1.0) * np.sqrt(discriminant))
            roots = np.stack([a0 / q, q / a2])  # the second is infinite or far where the curve is straight
        good = (roots >= -beyond) & (roots <= 1 + beyond)  # false where there is none
    η = np.clip(roots[good], EDGE - beyond, 1.0 + beyond - EDGE)
    return np.nonzero(good)[1], η[:, None]


def _on_patch(shape: ShapeFunctions, c: Array, beyond: float) -> tuple[Index, Array]:
    """Newton for Σ_k N_k(η) 𝐜_k = 0 from the middle of each facet, c (2, k, m); one root at most is found."""
    powers, inverse_matrix = _monomials(shape.cell, shape.order)
    c = inverse_matrix @ c
    m = c.shape[2]
    η = np.repeat(shape.corners.mean(axis=0)[:, None], m, axis=1)
    active, converged = np.arange(m), np.zeros(m, dtype=bool)
    for _ in range(MAX_ITERATIONS):
        if not active.size:
            break
        f, fξ, fη = _evaluate(powers, c, η[:, active])
        determinant = fξ[0] * fη[1] - fξ[1] * fη[0]
        determinant[determinant == 0.0] = 1e-300
        step = np.stack([f[1] * fη[0] - f[0] * fη[1], f[0] * fξ[1] - f[1] * fξ[0]]) / determinant
        size = np.abs(step).max(axis=0)
        step *= np.minimum(1.0, 0.7 / np.maximum(size, 1e-300))
        η[:, active] += step
        far = np.abs(η[:, active] - 0.5).max(axis=0) > 2.0
        done = (size < ALMOST) | (shape.flat & (size < 0.7))  # a flat facet's first whole step is exact
        converged[active] = done
        going = ~(done | far)
        active, c = active[going], c[:, :, going]
    which = np.flatnonzero(converged & (_inside_by(η.T, len(shape.corners) == 3) >= -beyond))
    return which, η[:, which].T


@cache
def _monomials(cell: CellType, order: int) -> tuple[Index, Array]:
    """Exponents (dim, k) of the monomials that a facet's shape functions are made of, and the matrix (k, k) from values at
    nodes to their coefficients."""
    nodes = ShapeFunctions(cell, order).nodes
    powers = [
        p for p in product(range(order + 1), repeat=nodes.shape[1]) if cell != CellType.triangle or sum(p) <= order
    ]
    exponents = np.array(powers).T
    return exponents, np.linalg.inv((nodes[:, :, None] ** exponents).prod(axis=1))


def _evaluate(powers: Index, c: Array, η: Array) -> tuple[Array, Array, Array]:
    """Σ_k 𝐜_k ξ^i η^j and its derivatives with respect to ξ and η, (2, m) each: powers (2, k), c (2, k, m), η (2, m)."""
    (i, j), (ξ, ζ) = powers, η
    order = int(powers.max())
    ones = np.ones_like(ξ)
    of_ξ, of_ζ = (np.stack([ones, t, t * t][: order + 1]) for t in (ξ, ζ))
    first, second = of_ξ[i], of_ζ[j]
    less = np.maximum(powers - 1, 0)
    dξ, dζ = i[:, None] * of_ξ[less[0]] * second, j[:, None] * first * of_ζ[less[1]]
    f, fξ, fζ = (np.einsum("dkm,km->dm", c, basis) for basis in (first * second, dξ, dζ))
    return f, fξ, fζ


def _first_of_each(row: Index, key: Array) -> Index:
    """For each row number that occurs, the place where `key` is least."""
    if (row[1:] > row[:-1]).all():
        return np.arange(len(row))
    order = np.lexsort([key, row])
    return order[np.r_[True, np.diff(row[order]) > 0]] if len(order) else order


def _is_inside(target: GatheredFacets, positions: Array, x: Array, depth: Array) -> NDArray[np.bool_]:
    """(n,) whether the closest points say that 𝐱 (n, gdim) lies inside the target, by `depth` (n,) in m or more. They are
    looked for where the side of all facets that may hold them does not tell."""
    near = candidates(x, positions[target.facets], 0.0)
    inside, known = is_behind(target, positions, x, near, depth)
    ask = np.flatnonzero(~known)
    if len(ask):
        inside[ask] = penetrates(target, positions, x[ask], near[ask], depth[ask])
    return inside
