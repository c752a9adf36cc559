"""Polygons clipped by convex polygons and cut into triangles, many at a time (Sutherland and Hodgman 1974).

Rows of padded arrays are polygons: (m, v, 2) vertices, of which the first `count` (m,) are meant, anticlockwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["areas", "clip", "contains", "triangulate", "without_flat_corners"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SKEW = np.array([1.0, 0.618])  # parallel to no side of a reference facet
ON_LINE = 1e-12  # distance from a clipping line, over the clipping polygon's size, up to which a vertex lies on it


def clip(subject: Array, window: Array) -> tuple[Array, Index]:
    """What of each polygon `subject` (m, v, 2) lies in the convex polygon `window` (m, w, 2), both anticlockwise: vertices
    (m, v', 2), and how many there are (m,)."""
    count: Index = np.full(len(subject), subject.shape[1], dtype=np.int64)
    size = np.ptp(window, axis=1).max(axis=1)
    for k in range(window.shape[1]):
        start, along = window[:, k], window[:, (k + 1) % window.shape[1]] - window[:, k]
        inward = np.stack([-along[:, 1], along[:, 0]], axis=1)
        inward /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        height = ((subject - start[:, None]) @ inward[:, :, None])[:, :, 0]
        height[np.abs(height) <= ON_LINE * size[:, None]] = 0.0
        subject, count = _clip_by_line(subject, count, height)
    return subject, count


def _clip_by_line(subject: Array, count: Index, height: Array) -> tuple[Array, Index]:
    """The part of each polygon where `height` (m, v) of its vertices is not negative."""
    place = np.arange(subject.shape[1])
    there = place < count[:, None]
    following = np.where(place + 1 < count[:, None], place + 1, 0)
    h, h_next = height, np.take_along_axis(height, following, axis=1)
    crosses = there & (h * h_next < 0.0)
    t = np.where(crosses, h / np.where(crosses, h - h_next, 1.0), 0.0)[:, :, None]
    crossing = (1.0 - t) * subject + t * np.take_along_axis(subject, following[:, :, None], axis=1)
    n, v = there.shape
    emit = np.stack([there & (h >= 0.0), crosses], axis=2).reshape(n, 2 * v)
    vertices = np.stack([subject, crossing], axis=2).reshape(n, 2 * v, 2)
    count = emit.sum(axis=1)
    result = np.zeros((n, max(int(count.max(initial=0)), 1), 2))
    row, column = np.nonzero(emit)
    result[row, np.cumsum(emit, axis=1)[row, column] - 1] = vertices[row, column]
    return result, count


def areas(polygons: Array, count: Index) -> Array:
    """(m,) signed areas."""
    place = np.arange(polygons.shape[1])
    following = np.where(place + 1 < count[:, None], place + 1, 0)
    arm = polygons - polygons[:, :1]
    other = np.take_along_axis(arm, following[:, :, None], axis=1)
    cross = arm[..., 0] * other[..., 1] - arm[..., 1] * other[..., 0]
    return np.asarray(0.5 * np.where(place < count[:, None], cross, 0.0).sum(axis=1))


def contains(polygons: Array, count: Index, x: Array) -> NDArray[np.bool_]:
    """(m, k) which points x (k, 2) lie in each convex polygon, anticlockwise, its sides included."""
    place = np.arange(polygons.shape[1])
    following = np.where(place + 1 < count[:, None], place + 1, 0)
    along = np.take_along_axis(polygons, following[:, :, None], axis=1) - polygons
    arm = x[None, :, None] - polygons[:, None]
    left = along[:, None, :, 0] * arm[..., 1] - along[:, None, :, 1] * arm[..., 0] >= 0.0
    return np.asarray((left | (place >= count[:, None])[:, None]).all(axis=2))


def without_flat_corners(polygons: Array, count: Index, least: float) -> tuple[Array, Index]:
    """The convex polygons without corners whose triangle with those on either side is smaller than `least`, and how many are
    left: what a small motion adds and takes away again is not there."""
    rows, place = np.arange(len(polygons)), np.arange(polygons.shape[1])
    kept, left, before = place < count[:, None], count.copy(), count - 1
    for k in place:
        there, after = k < count, np.where(k + 1 < count, k + 1, kept.argmax(axis=1))
        one, other = (
            polygons[:, k] - polygons[rows, before],
            polygons[rows, after % len(place)] - polygons[rows, before],
        )
        flat = there & (np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) < 2 * least) & (left > 3)
        kept[:, k] &= ~flat
        left -= flat
        before = np.where(there & ~flat, k, before)
    order = np.argsort(~kept, axis=1, kind="stable")
    return np.take_along_axis(polygons, order[:, :, None], axis=1), left


def triangulate(polygons: Array, count: Index) -> tuple[Index, Array]:
    """Fans of triangles: which polygon each is of (k,), and its vertices (k, 3, 2). Signed areas add up to the polygon's,
    convex or not. Fans start at the vertex farthest in a fixed direction: a vertex more or less changes slivers only."""
    place = np.arange(polygons.shape[1])
    far = np.where(place < count[:, None], polygons @ SKEW, np.inf).argmin(axis=1)
    row, second = np.nonzero((place > 0) & (place < count[:, None] - 1))
    corners = [polygons[row, (far[row] + k) % count[row]] for k in (0 * second, second, second + 1)]
    return row, np.stack(corners, axis=1)
