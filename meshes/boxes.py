"""Structured rectangles (boxes in space) that share no node: one description, for DOLFINx's own meshes and for gmsh's files.

A mesh of boxes needs no mesh generator, and loading gmsh takes longer than making one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import compress
from typing import Any

import numpy as np
from basix.ufl import element
from dolfinx import mesh
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.versions import geometry_nodes
from meshes.gmsh_session import structured_box

__all__ = ["Box", "boxes_in_gmsh", "create_boxes"]

Face = tuple[int, int]  # axis that it is normal to, and at which end: 0 or 1
ON_FACE = 1e-9  # of a box' size


@dataclass(frozen=True)
class Box:
    """A box of structured `cells` (gdim,) from `origin` (gdim,) on, of `size` (gdim,) (m).

    Its cells are tagged `tag`, its faces (axis, end) as `faces` say.
    """

    origin: Sequence[float]
    size: Sequence[float]
    cells: Sequence[int]
    tag: int
    faces: Mapping[Face, int] = field(default_factory=dict)

    def is_on(self, face: Face, x: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(n,) which points 𝐱 (n, 3) lie on a face."""
        axis, end = face
        return np.asarray(np.abs(x[:, axis] - self.origin[axis] - end * self.size[axis]) < ON_FACE * self.size[axis])


def create_boxes(comm: MPI.Comm, boxes: Sequence[Box], simplices: bool) -> tuple[mesh.Mesh, Any, Any]:
    """(mesh, cell tags, facet tags) of boxes, spread over `comm`."""
    gdim = len(boxes[0].size)
    parts = [_alone(box, simplices) for box in boxes]
    nodes, first = [geometry_nodes(part).astype(np.int64) for part in parts], 0
    for part, own in zip(parts, nodes, strict=True):
        own += first
        first += len(part.geometry.x)
    x, cells = np.concatenate([part.geometry.x[:, :gdim] for part in parts]), np.concatenate(nodes)
    mine = slice(None) if comm.rank == 0 else slice(0)
    cell = parts[0].topology.cell_name()
    domain = mesh.create_mesh(comm, cells=cells[mine], x=x[mine], e=element("Lagrange", cell, 1, shape=(gdim,)))
    box = np.repeat(np.arange(len(boxes)), [len(own) for own in nodes])[domain.topology.original_cell_index]
    tags = np.array([b.tag for b in boxes], dtype=np.int32)[box]
    everywhere = np.arange(len(box), dtype=np.int32)
    return domain, mesh.meshtags(domain, gdim, everywhere, tags), _facet_tags(domain, boxes, box)


def _alone(box: Box, simplices: bool) -> mesh.Mesh:
    """The box on this process alone."""
    corners = [np.asarray(box.origin, dtype=float), np.add(box.origin, box.size)]
    if len(box.size) == 2:
        cell = mesh.CellType.triangle if simplices else mesh.CellType.quadrilateral
        return mesh.create_rectangle(MPI.COMM_SELF, corners, box.cells, cell, diagonal=mesh.DiagonalType.left)
    cell = mesh.CellType.tetrahedron if simplices else mesh.CellType.hexahedron
    return mesh.create_box(MPI.COMM_SELF, corners, list(box.cells), cell)


def _facet_tags(domain: mesh.Mesh, boxes: Sequence[Box], box: NDArray[np.int64]) -> mesh.MeshTags:
    """Tags of the boxes' faces; `box` says which box each cell is of."""
    topology = domain.topology
    dim = topology.dim - 1
    topology.create_connectivity(dim, dim + 1)
    facets = mesh.exterior_facet_indices(topology)
    cells = topology.connectivity(dim, dim + 1)
    owner = box[cells.array[cells.offsets[facets]]]
    x, tags = mesh.compute_midpoints(domain, dim, facets), np.full(len(facets), -1, dtype=np.int32)
    for k, b in enumerate(boxes):
        for face, tag in b.faces.items():
            tags[(owner == k) & b.is_on(face, x)] = tag
    return mesh.meshtags(domain, dim, facets[tags >= 0], tags[tags >= 0])


def boxes_in_gmsh(gmsh: Any, boxes: Sequence[Box], simplices: bool) -> None:
    """Add boxes to the current gmsh model and mesh it."""
    model, d = gmsh.model, len(boxes[0].size)
    entities: dict[int, list[int]] = {}
    for box in boxes:
        origin = [*box.origin, 0.0][:3]
        facets = structured_box(gmsh, origin, box.size, box.cells, simplices, box.tag)
        centres = np.array([model.occ.getCenterOfMass(d - 1, facet) for facet in facets])
        for face, tag in box.faces.items():
            entities.setdefault(tag, []).extend(compress(facets, box.is_on(face, centres)))
    for tag, members in entities.items():
        model.addPhysicalGroup(d - 1, members, tag)
    model.mesh.generate(d)
