"""Contact surfaces: which facets, their nodes, shape functions, reference geometry and outward side.

A :class:`Surface` is what the user names; :class:`Facets` is the same surface seen through a displacement space. All
facets are brought to the node order of one Lagrange element on the reference facet, so that every later array is batched
as (facets, points, …) whatever the cells were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem, mesh
from numpy.typing import NDArray

from dolfinx_mortar_al.compiling import compiled_expression
from dolfinx_mortar_al.pieces import connected
from dolfinx_mortar_al.reductions import max_over, sum_over
from dolfinx_mortar_al.validation import are_tags_of, vector, whole

__all__ = ["SHARP", "Facets", "GatheredFacets", "ShapeFunctions", "Surface", "surface_normal"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# A round body has three facets at least on a right angle, which turn by 30°; a chamfer, which is a corner, by 45°.
SHARP = np.cos(np.deg2rad(37.5))
FLAT = 1e-6  # rad: what straight surfaces turn by in round-off
ASKEW = np.sqrt([2.0, 3.0, 5.0])  # a direction along which no two facets of a regular mesh are alike
SQUARES = ((0, 4, 5, 8), (4, 1, 8, 6), (5, 8, 2, 7), (8, 6, 7, 3))  # of a quadrilateral of order 2, by its nodes


@dataclass(frozen=True)
class Surface:
    """A contact surface: the facets of a body, or the cells of a membrane, that carry a tag.

    Args:
        mesh: of the body or membrane.
        tags: mesh tags of the facets' dimension, or of a membrane's cells.
        tag: the value that marks the surface, or several.
        side: for a membrane, the side that touches: a vector (numbers, or UFL in reference coordinates) that points to
            it everywhere. A body's facets have their outward side and take none.

    Raises:
        ValueError: if `mesh` is no mesh or `tags` are none.
    """

    mesh: mesh.Mesh
    tags: Any
    tag: int | Sequence[int]
    side: Any = None

    def __post_init__(self) -> None:
        if not isinstance(self.mesh, mesh.Mesh) or not isinstance(self.tags, mesh.MeshTags):
            raise ValueError(
                "Surface: takes a mesh, MeshTags and a tag in this order, not "
                f"{', '.join(type(said).__name__ for said in (self.mesh, self.tags, self.tag))}"
            )
        if np.ndim(self.tag) == 1:
            object.__setattr__(self, "tag", tuple(np.ravel(self.tag).tolist()))

    @property
    def _values(self) -> list[int]:
        """The values that mark it."""
        values = self.tag if isinstance(self.tag, tuple) else (self.tag,)
        if not values:
            raise ValueError("tag = (): name a value that marks the surface, or several")
        return [whole("tag", value, least=-(2**31), most=2**31 - 1) for value in values]

    @property
    def is_membrane(self) -> bool:
        """Whether the surface is made of cells."""
        return bool(self.mesh.topology.dim == self.mesh.geometry.dim - 1)

    def owned_facets(self) -> NDArray[np.int32]:
        """The surface's facets (a membrane's cells) owned by this rank.

        Raises:
            ValueError: on every rank, if the tags are of another dimension, the surface is empty, a facet of it is not
                on the boundary, or the side is missing (membrane) or too much (body).
        """
        values = self._values
        dim, kind = self.mesh.geometry.dim - 1, "cells" if self.is_membrane else "facets"
        if self.tags.dim != dim:
            raise ValueError(
                f"tags of dimension {self.tags.dim} for a contact surface in space of dimension {dim + 1}: "
                f"it is made of {kind}, pass mesh tags of dimension {dim}"
            )
        if not are_tags_of(self.tags, self.mesh):
            raise ValueError(f"tags of tag {self.tag} are of another mesh: pass those made with the surface's mesh")
        if self.is_membrane == (self.side is None):
            raise ValueError(
                f"side = {self.side} of tag {self.tag}: "
                + (
                    "name the side of the membrane that touches"
                    if self.is_membrane
                    else "facets have their outward side"
                )
            )
        comm = self.mesh.comm
        marked = [self.tags.find(value) for value in values]
        facets = np.unique(np.concatenate(marked))
        facets = facets[facets < self.mesh.topology.index_map(dim).size_local]
        empty = sum_over(comm, np.array([len(found) for found in marked])) == 0
        if empty.any():
            known = sorted(set().union(*comm.allgather(set(self.tags.values.tolist()))))
            raise ValueError(
                f"tag {values[int(np.argmax(empty))]} marks no {kind[:-1]}; the tags of this mesh are {known}"
            )
        if not self.is_membrane:
            self.mesh.topology.create_connectivity(dim, dim + 1)
            # a facet with one cell on this rank may have another on the next
            inner = int(np.sum(~np.isin(facets, mesh.exterior_facet_indices(self.mesh.topology))))
            if sum_over(comm, inner):
                raise ValueError(
                    f"tag {self.tag} marks facets between two cells; a contact surface lies on the boundary (bodies "
                    "that share nodes there are joined, as gmsh's fragment does: leave that out)"
                )
        return facets


class ShapeFunctions:
    """Lagrange shape functions of one facet: interval, triangle or quadrilateral, order 1 or 2."""

    def __init__(self, cell: basix.CellType, order: int) -> None:
        self.cell = cell
        self.order = order
        self.element = basix.create_element(basix.ElementFamily.P, cell, order, basix.LagrangeVariant.gll_warped)
        self.dim = self.element.points.shape[1]
        # an affine facet has no second derivatives
        self.flat = order == 1 and cell != basix.CellType.quadrilateral

    @property
    def nodes(self) -> Array:
        """Reference coordinates of the nodes, (nodes, dim)."""
        return self.element.points

    @cached_property
    def corners(self) -> Array:
        """Reference coordinates of the vertices, (vertices, dim)."""
        return basix.geometry(self.cell)

    @cached_property
    def sides(self) -> list[list[int]]:
        """Nodes on each of the facet's own sides (vertices of an interval, edges of a polygon)."""
        return self.element.entity_closure_dofs[self.dim - 1]

    @property
    def spacing(self) -> float:
        """Distance of neighbouring nodes over the root of a facet's area; two triangles have as many nodes as a square."""
        return (np.sqrt(2.0) if len(self.corners) == 3 else 1.0) / self.order

    @cached_property
    def pieces(self) -> Index:
        """(pieces, dim + 1) nodes of the simplices that a facet is divided into, each oriented as the facet."""
        nodes = {
            (2, 1): [[0, 1]],
            (2, 2): [[0, 2], [2, 1]],
            (3, 1): [[0, 1, 2]],
            (3, 2): [[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]],
            (4, 1): [[0, 1, 2], [3, 2, 1]],
            (4, 2): [[a, b, c] for s in SQUARES for a, b, c in ((s[0], s[1], s[2]), (s[3], s[2], s[1]))],
        }
        return np.array(nodes[len(self.corners), self.order], dtype=np.int64)

    def tabulate(self, η: Array, derivatives: int = 0) -> tuple[Array, ...]:
        """N (n, nodes), N,α (n, dim, nodes) and N,αβ (n, dim, dim, nodes) at η (n, dim), up to `derivatives`."""
        d = self.dim
        # basix does not take an empty set of points, which a rank without facets has
        points = η if len(η) else np.zeros((1, d))
        table = self.element.tabulate(derivatives, points)[:, : len(η), :, 0]
        result: list[Array] = [table[0]]
        if derivatives > 0:
            result.append(np.moveaxis(table[1 : d + 1], 0, 1))
        if derivatives > 1:
            order = (
                [basix.index(2)]
                if d == 1
                else [basix.index(2, 0), basix.index(1, 1), basix.index(1, 1), basix.index(0, 2)]
            )
            result.append(np.moveaxis(table[order], 0, 1).reshape(len(η), d, d, table.shape[-1]))
        return tuple(result)

    def quadrature(self, degree: int) -> tuple[Array, Array]:
        """Gauss points (points, dim) and weights (points,)."""
        return basix.make_quadrature(self.cell, degree)


def surface_normal(tangents: Array) -> Array:
    """a₁ × a₂ (3D) or a₁ turned by −90° (2D), not normalised: (…, dim, gdim) to (…, gdim)."""
    if tangents.shape[-1] == 2:
        return np.asarray(tangents[..., 0, ::-1] * np.array([1.0, -1.0]))
    return np.asarray(np.cross(tangents[..., 0, :], tangents[..., 1, :]), dtype=np.float64)


@dataclass(frozen=True)
class Facets:
    """The facets of a surface that one rank owns, with the nodes of a displacement space on them.

    Attributes:
        space: the displacement space V.
        entities: (nf,) the facets, local to this rank.
        shape: shape functions, shared by all facets.
        dofs: (nf, nodes) local block dofs of V.
        X: (nf, nodes, gdim) reference positions (m).
        orientation: (nf,) ±1, the sign that makes :func:`surface_normal` point out of the body.
    """

    space: fem.FunctionSpace
    entities: NDArray[np.int32]
    shape: ShapeFunctions
    dofs: NDArray[np.int32]
    X: Array
    orientation: Array

    def cell_depths(self) -> Array:
        """(nf,) how far the cell behind each facet of a body reaches from the facet's plane, undeformed (m)."""
        domain = self.space.mesh
        per_cell = len(basix.topology(domain.basix_cell())[domain.topology.dim - 1])
        cells = _cells_of(domain, self.entities, per_cell)[0]
        middle = self.shape.corners.mean(axis=0)[None]
        N, dN = self.shape.tabulate(middle, 1)
        outward = surface_normal(dN[0] @ self.X) * self.orientation[:, None]
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        nodes = self.space.tabulate_dof_coordinates()[:, : domain.geometry.dim][self.space.dofmap.list[cells]]
        return np.asarray(np.einsum("fki,fi->fk", (N[0] @ self.X)[:, None] - nodes, outward).max(axis=1, initial=0.0))

    @classmethod
    def of(cls, surface: Surface, V: fem.FunctionSpace) -> Facets:
        """The surface's owned facets seen through V.

        Raises:
            ValueError: on every rank, as :meth:`Surface.owned_facets`, and if a membrane's side lies in its own plane.
        """
        entities = surface.owned_facets()
        element = V.element.basix_element
        cell = surface.mesh.basix_cell()
        if surface.is_membrane:
            shape = ShapeFunctions(cell, element.degree)
            cells, closure = entities, _facet_nodes(element, shape, [list(range(len(basix.geometry(cell))))])
            local: Any = np.zeros(len(cells), dtype=np.int64)
        else:
            facet_vertices = basix.topology(cell)[surface.mesh.topology.dim - 1]
            shape = ShapeFunctions(basix.cell.subentity_types(cell)[surface.mesh.topology.dim - 1][0], element.degree)
            closure = _facet_nodes(element, shape, facet_vertices)
            cells, local = _cells_of(surface.mesh, entities, len(facet_vertices))

        dofs = np.take_along_axis(V.dofmap.list[cells], closure[local], axis=1)
        x = V.tabulate_dof_coordinates()[:, : surface.mesh.geometry.dim]
        X = x[dofs]
        tangents = shape.tabulate(shape.corners.mean(axis=0)[None], 1)[1][0] @ X  # at the facet's middle
        if surface.is_membrane:
            outward = _side_at_middle(surface, cells)
        else:
            outward = X.mean(axis=1) - x[V.dofmap.list[cells]].mean(axis=1)
        normal = surface_normal(tangents)
        areas, comm = _areas(shape, X), surface.mesh.comm
        largest = max_over(comm, float(areas.max(initial=0.0)))
        if sum_over(comm, int(np.sum(~(areas > 1e-10 * largest)))):
            raise ValueError(f"tag {surface.tag} marks facets without area: mesh the surface again")
        cosine = np.einsum("fi,fi->f", normal, outward)
        flat = np.abs(cosine) <= 1e-6 * np.linalg.norm(normal, axis=1) * np.linalg.norm(outward, axis=1)
        if sum_over(surface.mesh.comm, int(flat.sum())):
            raise ValueError(f"side = {surface.side} lies in the plane of the membrane of tag {surface.tag} somewhere")
        return cls(V, entities, shape, dofs, X, np.sign(cosine))

    @property
    def size(self) -> int:
        return len(self.entities)

    def areas(self) -> Array:
        """(nf,) reference areas (m², or m in two dimensions)."""
        return _areas(self.shape, self.X)

    def extents(self) -> Array:
        """(nf,) reference areas to the power 1/dim (m)."""
        return _extents(self.shape, self.X)

    def normals(self) -> Array:
        """(nf, nodes, gdim) unit normals at the facets' nodes, in the reference configuration."""
        return _normals(self.shape, self.X, self.orientation)

    def widths(self) -> Array:
        """(nf,) reference extents, or less of facets that are longer than wide (m)."""
        return _widths(self.shape, self.X)

    def gather(self) -> GatheredFacets:
        """The whole surface on every rank (its topology only; positions follow each Newton iteration)."""
        comm, V = self.space.mesh.comm, self.space
        mine = V.dofmap.index_map.local_to_global(self.dofs.ravel()).reshape(self.dofs.shape)
        blocks = np.concatenate(comm.allgather(mine))
        X = np.concatenate(comm.allgather(self.X))
        orientation = np.concatenate(comm.allgather(self.orientation))
        # the same order of facets whatever the number of ranks
        order = np.lexsort(np.round(X.mean(axis=1) / np.ptp(X, axis=(0, 1)).max(), 9).T)
        blocks, X, orientation = blocks[order], X[order], orientation[order]
        nodes, first, inverse = np.unique(blocks, return_index=True, return_inverse=True)
        return GatheredFacets(
            self.shape, inverse.reshape(blocks.shape), nodes, X.reshape(-1, X.shape[-1])[first], orientation
        )


def _cells_of(
    domain: mesh.Mesh, facets: NDArray[np.int32], facets_per_cell: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The cell of each boundary facet, and the facet's local number in it."""
    topology, d = domain.topology, domain.topology.dim
    topology.create_connectivity(d - 1, d)
    topology.create_connectivity(d, d - 1)
    facet_cells = topology.connectivity(d - 1, d)
    cell_facets = topology.connectivity(d, d - 1).array.reshape(-1, facets_per_cell)
    cells = facet_cells.array[facet_cells.offsets[facets]]
    return cells, np.argmax(cell_facets[cells] == facets[:, None], axis=1)


def _side_at_middle(surface: Surface, cells: NDArray[np.int32]) -> Array:
    """(nf, gdim) the membrane's side at the middle of its cells."""
    gdim = surface.mesh.geometry.dim
    if not isinstance(surface.side, ufl.core.expr.Expr):
        side = vector("side", surface.side, gdim)
        return np.broadcast_to(side, (len(cells), gdim))
    middle = basix.geometry(surface.mesh.basix_cell()).mean(axis=0)[None]
    values = compiled_expression(surface.side, middle, surface.mesh).eval(surface.mesh, cells)
    return np.asarray(values).reshape(len(cells), gdim)


def _facet_nodes(element: Any, shape: ShapeFunctions, facets: list[list[int]]) -> NDArray[np.int64]:
    """For each facet (its vertices in the reference cell; a membrane's only one is the cell itself), its nodes in the
    order of the facet's own Lagrange element."""
    geometry = basix.geometry(element.cell_type)
    dim = shape.dim
    result = []
    for facet, nodes in zip(facets, element.entity_closure_dofs[dim], strict=True):
        v = geometry[facet]
        wanted = v[0] + shape.nodes @ (v[1 : dim + 1] - v[0])  # facet coordinates → cell coordinates
        distance = np.linalg.norm(wanted[:, None] - element.points[nodes][None], axis=2)
        result.append(np.array(nodes)[np.argmin(distance, axis=1)])
    return np.array(result)


@dataclass(frozen=True)
class GatheredFacets:
    """A target surface as every rank sees it.

    Attributes:
        shape: shape functions.
        facets: (nf, nodes) indices into `blocks`.
        blocks: (n,) global block dofs of its nodes.
        X: (n, gdim) reference positions (m).
        orientation: (nf,) see :class:`Facets`.
    """

    shape: ShapeFunctions
    facets: Index
    blocks: Index
    X: Array
    orientation: Array

    @cached_property
    def boundary_sides(self) -> NDArray[np.bool_]:
        """(nf, sides) whether a side of a facet is an end of the surface: no other facet has it."""
        sides = np.stack([np.sort(self.facets[:, s], axis=1) for s in self.shape.sides], axis=1)
        _, inverse, count = np.unique(
            sides.reshape(-1, sides.shape[-1]), axis=0, return_inverse=True, return_counts=True
        )
        return (count[inverse.ravel()] == 1).reshape(sides.shape[:2])

    @cached_property
    def end_nodes(self) -> NDArray[np.bool_]:
        """(n,) whether a node lies on an end of the surface."""
        flag = np.zeros(len(self.blocks), dtype=bool)
        for k, side in enumerate(self.shape.sides):
            flag[self.facets[self.boundary_sides[:, k]][:, side]] = True
        return flag

    @cached_property
    def neighbours(self) -> Index:
        """(nf, k) the facets that share a side with each, itself first and in place of neighbours it does not have."""
        sides = np.concatenate([np.sort(self.facets[:, s], axis=1) for s in self.shape.sides])
        _, side = np.unique(sides, axis=0, return_inverse=True)
        own = np.tile(np.arange(len(self.facets)), len(self.shape.sides))
        first, last = np.full(side.max() + 1, len(own)), np.full(side.max() + 1, -1)
        np.minimum.at(first, side.ravel(), own)
        np.maximum.at(last, side.ravel(), own)
        other = np.where(first[side.ravel()] == own, last[side.ravel()], first[side.ravel()])
        return np.concatenate(
            [np.arange(len(self.facets))[:, None], other.reshape(len(self.shape.sides), -1).T], axis=1
        )

    def amid(self, marked: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
        """(nf,) which facets lie within the marked ones (nf,), holes of up to twice `most` facets across included."""
        at_end = self.boundary_sides.any(axis=1)
        grown = marked
        for _ in range(most):
            grown = np.asarray(grown[self.neighbours].any(axis=1))
        for _ in range(most):
            grown = np.asarray(grown[self.neighbours].all(axis=1)) & ~at_end
        grown = grown | marked
        return np.asarray(grown[self.neighbours].all(axis=1))

    def zones(self, marked: NDArray[np.bool_]) -> Index:
        """(nf,) the number, from 0, of the connected zone that each of the marked facets (nf,) is in; −1 of the others."""
        label = connected(self.facets[marked], len(self.blocks))
        zone = np.full(len(self.facets), -1)
        zone[marked] = np.unique(label[self.facets[marked, 0]], return_inverse=True)[1].ravel()
        return zone

    @cached_property
    def _own_normals(self) -> Array:
        """(nf, corners, gdim) each facet's unit normal at its corners, in the reference configuration."""
        return self.normals()[:, : len(self.shape.corners)]

    @cached_property
    def normals_at_corners(self) -> Array:
        """(nf, corners, gdim) the mean unit normal of the facets that meet at each corner, in the reference configuration."""
        corners, mean = self.facets[:, : len(self.shape.corners)], np.zeros_like(self.X)
        np.add.at(mean, corners, self._own_normals)
        return np.asarray(mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300))[corners]

    def ends(self, cosine: float) -> NDArray[np.bool_]:
        """(nodes,) whether the surface ends at a node, or its facets' normals there differ by more than an angle with this
        cosine, in the reference configuration."""
        flag = self.end_nodes.copy()
        apart = np.einsum("fki,fki->fk", self._own_normals, self.normals_at_corners)
        flag[self.facets[:, : apart.shape[1]][apart < np.sqrt((1.0 + cosine) / 2.0) - FLAT]] = True
        return flag

    @cached_property
    def at_ends(self) -> NDArray[np.bool_]:
        """(nf,) which facets have a node where the surface ends or has a sharp corner."""
        return np.asarray(self.ends(SHARP)[self.facets].any(axis=1))

    @cached_property
    def turns(self) -> Array:
        """(nf,) by how much the surface turns over each facet (rad): between the mean normals at its corners."""
        normal = self.normals_at_corners
        return np.asarray(np.arccos(np.clip(normal @ np.swapaxes(normal, 1, 2), -1.0, 1.0)).max(axis=(1, 2)))

    @cached_property
    def rises(self) -> Array:
        """(nf,) how far facets are from the straight ones with the same corners (m); 0 of straight ones."""
        X, N = self.X[self.facets], ShapeFunctions(self.shape.cell, 1).tabulate(self.shape.nodes)[0]
        risen = np.linalg.norm(X - N @ X[:, : N.shape[1]], axis=2).max(axis=1)
        return np.where(risen > FLAT * np.ptp(X, axis=1).max(axis=1), risen, 0.0)

    @cached_property
    def sagittas(self) -> Array:
        """(nf,) how far facets fall short of the smooth surface that they stand for (m): one that turns by θ over a facet of
        length h rises by hθ/8, and what a curved facet rises by itself does not lack. None beside a sharp corner or edge,
        from which a straight flank may go on."""
        normal = self._own_normals.mean(axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        is_smooth = (np.einsum("fi,fki->fk", normal, normal[self.neighbours]) > SHARP).all(axis=1)
        lacks = np.maximum(self.diameters * self.turns / 8 - self.rises, 0.0)
        return np.where(is_smooth & (self.turns > FLAT), lacks, 0.0)

    @cached_property
    def smooth_turns(self) -> Array:
        """(nf,) by how much the surface that they stand for turns over each facet (rad), but at sharp corners."""
        return np.asarray(8 * (self.rises + self.sagittas) / self.diameters)

    def doubled(self) -> Index:
        """The facets that lie on another one and face the same way, as those of a body that was imported twice."""
        middle, normal = self.X[self.facets].mean(axis=1), self._own_normals.mean(axis=1)
        order = np.argsort(middle @ ASKEW[: middle.shape[1]], kind="stable")
        apart, turned = np.linalg.norm(np.diff(middle[order], axis=0), axis=1), normal[order[1:]] - normal[order[:-1]]
        same = (apart < FLAT * self.diameters[order[1:]]) & (np.linalg.norm(turned, axis=1) < FLAT)
        return order[1:][same]

    @cached_property
    def diameters(self) -> Array:
        """(nf,) of the facets in the reference configuration (m)."""
        X = self.X[self.facets]
        return np.asarray(2 * np.linalg.norm(X - X.mean(axis=1, keepdims=True), axis=2).max(axis=1))

    @cached_property
    def size_of_facets(self) -> float:
        """Largest diameter of a facet in the reference configuration (m)."""
        return float(np.max(self.diameters))

    def areas(self) -> Array:
        """(nf,) reference areas (m², or m in two dimensions)."""
        return _areas(self.shape, self.X[self.facets])

    def extents(self) -> Array:
        """(nf,) reference areas to the power 1/dim (m)."""
        return _extents(self.shape, self.X[self.facets])

    def normals(self) -> Array:
        """(nf, nodes, gdim) unit normals at the facets' nodes, in the reference configuration."""
        return _normals(self.shape, self.X[self.facets], self.orientation)

    def widths(self) -> Array:
        """(nf,) reference extents, or less of facets that are longer than wide (m)."""
        return _widths(self.shape, self.X[self.facets])

    def places_of(self, facets: Facets) -> Index:
        """(own nf,) which of these facets each of this rank's is, by its nodes."""
        mine = facets.space.dofmap.index_map.local_to_global(facets.dofs.ravel()).reshape(facets.dofs.shape)
        every = np.sort(self.blocks[self.facets], axis=1)
        mine = np.sort(mine, axis=1)
        rows = np.unique(np.concatenate([every, mine]), axis=0, return_inverse=True)[1].ravel()
        place = np.empty(rows.max(initial=-1) + 1, dtype=np.int64)
        place[rows[: len(every)]] = np.arange(len(every))
        return place[rows[len(every) :]]


def _areas(shape: ShapeFunctions, X: Array) -> Array:
    """(nf,) areas of facets with nodes X (nf, nodes, gdim)."""
    points, weights = shape.quadrature(2 * shape.order)
    a = np.einsum("qak,fki->fqai", shape.tabulate(points, 1)[1], X)
    return np.asarray(np.linalg.norm(surface_normal(a), axis=2) @ weights)


def _extents(shape: ShapeFunctions, X: Array) -> Array:
    """(nf,) areas of facets with nodes X (nf, nodes, gdim) to the power 1/dim."""
    return np.asarray(_areas(shape, X) ** (1.0 / shape.dim))


def _normals(shape: ShapeFunctions, X: Array, orientation: Array) -> Array:
    """(nf, nodes, gdim) unit normals at the nodes X (nf, nodes, gdim) of facets."""
    normal = surface_normal(shape.tabulate(shape.nodes, 1)[1] @ X[:, None]) * orientation[:, None, None]
    return np.asarray(normal / np.linalg.norm(normal, axis=2, keepdims=True))


def _widths(shape: ShapeFunctions, X: Array) -> Array:
    """(nf,) of facets with nodes X (nf, nodes, gdim): their extents, as they are of squares and halves of squares, or if that
    is less, the least distance of a side from the corner that is farthest from it."""
    extent = _extents(shape, X)
    if shape.dim == 1:
        return extent
    corners = X[:, : len(shape.corners)]
    width = extent.copy()
    for side in shape.sides:
        first, last = corners[:, side[0]], corners[:, side[1]]
        along = (last - first) / np.linalg.norm(last - first, axis=1)[:, None]
        arm = corners - first[:, None]
        apart = arm - np.einsum("fki,fi->fk", arm, along)[:, :, None] * along[:, None]
        width = np.minimum(width, np.linalg.norm(apart, axis=2).max(axis=1))
    return width
