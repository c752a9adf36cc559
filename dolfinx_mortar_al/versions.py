"""Where DOLFINx 0.9, 0.10 and 0.11 differ. All other calls are written as each of the three takes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import mesh
from mpi4py import MPI
from numpy.typing import NDArray

try:
    from dolfinx.io import gmsh as _gmsh
except ImportError:  # 0.9
    from dolfinx.io import gmshio as _gmsh

__all__ = ["geometry_degree", "model_to_mesh", "read_from_msh", "submesh"]


def model_to_mesh(model: Any, comm: MPI.Comm, gdim: int) -> tuple[mesh.Mesh, Any, Any]:
    """(mesh, cell tags, facet tags) of the gmsh model that rank 0 has (None on the others), spread over `comm`. What follows
    these three since 0.10 is left out."""
    data = _gmsh.model_to_mesh(model, comm, 0, gdim)
    return data[0], data[1], data[2]


def read_from_msh(path: Path, comm: MPI.Comm, gdim: int) -> tuple[mesh.Mesh, Any, Any]:
    """(mesh, cell tags, facet tags) of a gmsh file, read on rank 0 and spread over `comm`."""
    data = _gmsh.read_from_msh(str(path), comm, 0, gdim=gdim)
    return data[0], data[1], data[2]


def submesh(domain: mesh.Mesh, dim: int, entities: NDArray[np.int32]) -> tuple[mesh.Mesh, NDArray[np.int32]]:
    """The mesh of these entities of dimension `dim`, and the entity of `domain` that each of its cells is: an array in 0.9,
    an EntityMap since."""
    part, parents = mesh.create_submesh(domain, dim, entities)[:2]
    if hasattr(parents, "sub_topology_to_topology"):
        index_map = part.topology.index_map(dim)
        cells = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        parents = parents.sub_topology_to_topology(cells, False)
    return part, np.asarray(parents)


def geometry_degree(domain: mesh.Mesh) -> int:
    """Degree of the cells' map from their reference cell; `cmap` gave way to `cmaps` in 0.11."""
    geometry = domain.geometry
    return int((geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap).degree)
