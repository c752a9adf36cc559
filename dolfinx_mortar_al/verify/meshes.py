"""Meshes of the cases: grids placed by a map, glued to bodies, several bodies in one mesh; no mesh generator is needed."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import basix
import basix.ufl
import numpy as np
from dolfinx import mesh
from dolfinx.graph import adjacencylist
from dolfinx.io import distribute_entity_data
from mpi4py import MPI
from numpy.typing import NDArray

__all__ = ["Body", "build", "disc", "glue", "graded", "grid", "half_space"]

Array = NDArray[np.float64]
AnyArray = NDArray[np.floating[Any]]
Index = NDArray[np.int64]
CELLS = {
    (2, False): "quadrilateral",
    (2, True): "triangle",
    (3, False): "hexahedron",
    (3, True): "tetrahedron",
}


@dataclass(frozen=True)
class Body:
    """Nodes (n, gdim), cells (m, k) in DOLFINx's order of nodes, marked facets (f, l) and their tags (f,)."""

    x: Array
    cells: Index
    facets: Index
    tags: NDArray[np.int32]
    kind: str
    order: int


def graded(zone: float, cells: int, end: float, growth: float = 1.4) -> Array:
    """Coordinates from 0 to `end`: `cells` equal cells up to `zone`, then cells that grow by about `growth`."""
    inner = np.linspace(0.0, zone, cells + 1)
    n = max(1, int(np.ceil(np.log(1 + (end - zone) * (growth - 1) / inner[1]) / np.log(growth) - 1e-9)))
    steps = growth ** np.arange(1, n + 1)
    return np.concatenate([inner, zone + (end - zone) * np.cumsum(steps) / steps.sum()])


def grid(
    axes: Sequence[AnyArray],
    faces: Mapping[tuple[int, int], int],
    *,
    order: int = 2,
    simplices: bool = False,
    place: Callable[[Array], Array] = lambda x: x,
    near: float = np.inf,
) -> Body:
    """A tensor grid.

    Args:
        axes: coordinates of the vertices along each axis.
        faces: tags of its sides by (axis, 0 or −1 for its lower or upper end).
        order: of the geometry, so that cells follow `place`.
        simplices: cut each cell into triangles or tetrahedra.
        place: positions (n, gdim) of grid coordinates (n, gdim).
        near: on the side (last axis, 0), mark only facets that are within this distance along every other axis: a contact
            surface no larger than contact has facets of one size.
    """
    d = len(axes)
    kind = CELLS[d, simplices]
    fine = [np.interp(np.arange(order * (len(a) - 1) + 1) / order, np.arange(len(a)), a) for a in axes]
    shape = [len(f) for f in fine]
    x = place(np.stack([c.ravel() for c in np.meshgrid(*fine, indexing="ij")], axis=1))
    element = basix.create_element(
        basix.ElementFamily.P, getattr(basix.CellType, kind), order, basix.LagrangeVariant.gll_warped
    )
    corners = np.array(list(np.ndindex(*[len(a) - 1 for a in axes]))) * order
    if simplices:  # Kuhn's: one simplex per order in which the axes are walked
        walks = [
            np.concatenate([np.zeros((1, d)), np.cumsum(np.eye(d)[list(p)], axis=0)])
            for p in itertools.permutations(range(d))
        ]
        inside = [w[0] + element.points @ (w[1:] - w[0]) for w in walks]
    else:
        inside = [element.points]
    nodes = np.concatenate([corners[:, None, :] + np.rint(order * p).astype(int) for p in inside])
    cells = np.ravel_multi_index(tuple(np.moveaxis(nodes, 2, 0)), tuple(shape))
    facets, tags = [], []
    for (axis, end), tag in faces.items():
        level = 0 if end == 0 else shape[axis] - 1
        for side in element.entity_closure_dofs[d - 1]:
            on = (nodes[:, side, axis] == level).all(axis=1)
            if np.isfinite(near) and axis == d - 1 and end == 0:
                at = np.stack([fine[a][nodes[:, side, a]] for a in range(d - 1)], axis=-1)
                on &= (np.abs(at) <= near * (1 + 1e-9)).all(axis=(1, 2))
            facets.append(cells[on][:, side])
            tags.append(np.full(int(on.sum()), tag, dtype=np.int32))
    width = len(element.entity_closure_dofs[d - 1][0])
    marked = np.concatenate(facets) if facets else np.empty((0, width), dtype=np.int64)
    return Body(x, cells, marked, np.concatenate(tags) if tags else np.empty(0, dtype=np.int32), kind, order)


def glue(parts: Sequence[Body], tolerance: float) -> Body:
    """One body of grids whose nodes coincide where they meet, to `tolerance` (m)."""
    x = np.concatenate([part.x for part in parts])
    _, first, inverse = np.unique(np.rint(x / tolerance), axis=0, return_index=True, return_inverse=True)
    starts = np.cumsum([0] + [len(part.x) for part in parts[:-1]])
    return Body(
        x[first],
        np.concatenate([inverse.ravel()[part.cells + s] for part, s in zip(parts, starts, strict=True)]),
        np.concatenate([inverse.ravel()[part.facets + s] for part, s in zip(parts, starts, strict=True)]),
        np.concatenate([part.tags for part in parts]),
        parts[0].kind,
        parts[0].order,
    )


def build(bodies: Sequence[Body], comm: MPI.Comm = MPI.COMM_WORLD) -> tuple[mesh.Mesh, Any, Any]:
    """(mesh, cell tags, facet tags) of bodies that share no node; cells of the first have tag 1, of the second 2, …"""
    first = bodies[0]
    starts = np.cumsum([0] + [len(body.x) for body in bodies[:-1]])
    x = np.concatenate([body.x for body in bodies])
    cells = np.concatenate([body.cells + s for body, s in zip(bodies, starts, strict=True)])
    values = np.concatenate([np.full(len(b.cells), k, dtype=np.int32) for k, b in enumerate(bodies, start=1)])
    facets = np.concatenate([body.facets + s for body, s in zip(bodies, starts, strict=True)])
    tags = np.concatenate([body.tags for body in bodies])
    if comm.rank:
        x, cells, values, facets, tags = x[:0], cells[:0], values[:0], facets[:0], tags[:0]
    element = basix.ufl.element("Lagrange", first.kind, first.order, shape=(x.shape[1],))
    domain = mesh.create_mesh(comm, cells=cells, x=x, e=element)
    marks = [
        _tags(domain, dim, *data) for dim, data in ((x.shape[1], (cells, values)), (x.shape[1] - 1, (facets, tags)))
    ]
    return domain, marks[0], marks[1]


def _tags(domain: mesh.Mesh, dim: int, entities: Index, values: NDArray[np.int32]) -> Any:
    local, local_values = distribute_entity_data(domain, dim, entities, values)
    domain.topology.create_connectivity(dim, 0)
    domain.topology.create_connectivity(dim, domain.topology.dim)
    return mesh.meshtags_from_entities(domain, dim, adjacencylist(local), local_values.astype(np.int32, copy=False))


def half_space(
    across: Sequence[AnyArray],
    depth: Array,
    up: bool,
    curvature: float,
    faces: Mapping[tuple[int, int], int],
    **options: Any,
) -> Body:
    """A body above (`up`) or below the plane z = 0, z the last axis, with a surface z = ±(R − √(R² − r²)), R = 1/`curvature`.

    Args:
        across: coordinates along the axes of the plane.
        depth: distances from the surface, from 0 on; the far side stays flat.
        faces: as of :func:`grid`, with the surface at depth 0: (last axis, 0), the far side (last axis, −1).
    """
    end, sign = depth[-1], 1.0 if up else -1.0

    def place(x: Array) -> Array:
        r2 = np.sum(x[:, :-1] ** 2, axis=1)
        rise = curvature * r2 / (1 + np.sqrt(1 - curvature**2 * r2))
        z = x[:, -1] + rise * (1 - x[:, -1] / end)
        return np.column_stack([x[:, :-1], sign * z])

    return grid([*across, depth], faces, place=place, **options)


def disc(
    radius: float, cells: int, layers: int, rim: int, *, axis: int | None = None, height: Array | None = None,
    ends: tuple[int, int] = (0, 0), square: float = 0.5,
) -> Body:  # fmt: skip
    """A disc of order 2: a square of `cells` × `cells` inside, `layers` of cells around it, 4 `cells` on the rim.

    Args:
        radius: of the disc (m).
        cells, layers: see above; `cells` is even.
        rim: tag of the rim.
        axis: makes half a disc, x ≥ 0, and tags x = 0.
        height: coordinates along z, which make a cylinder; its lower and upper `ends` have these tags.
        square: half the side of the inner square, in radii.
    """
    z = [] if height is None else [height]
    flat = {} if height is None else {(2, 0): ends[0], (2, -1): ends[1]}
    side, half = np.linspace(-1.0, 1.0, cells + 1), np.linspace(0.0, 1.0, cells // 2 + 1)
    b = square * radius

    def turned(quarter: int) -> Callable[[Array], Array]:
        c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]

        def place(x: Array) -> Array:
            ρ, φ = x[:, 0], x[:, 1] * np.pi / 4
            X = (1 - ρ) * b + ρ * radius * np.cos(φ)
            Y = (1 - ρ) * b * x[:, 1] + ρ * radius * np.sin(φ)
            return np.column_stack([c * X - s * Y, s * X + c * Y, x[:, 2:]])

        return place

    def inner(x: Array) -> Array:
        return np.column_stack([b * x[:, :2], x[:, 2:]])

    ring = np.linspace(0.0, 1.0, layers + 1)
    if axis is None:
        parts = [grid([side, side, *z], flat, place=inner)]
        parts += [grid([ring, side, *z], {(0, -1): rim} | flat, place=turned(k)) for k in range(4)]
    else:
        parts = [grid([half, side, *z], {(0, 0): axis} | flat, place=inner)]
        for k, along, cut in ((0, side, {}), (1, -half[::-1], {(1, -1): axis}), (3, half, {(1, 0): axis})):
            parts.append(grid([ring, along, *z], {(0, -1): rim} | cut | flat, place=turned(k)))
    return glue(parts, 1e-7 * radius)
