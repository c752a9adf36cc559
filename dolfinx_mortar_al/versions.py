"""Where DOLFINx 0.9, 0.10 and 0.11 differ. All other calls are written as each of the three takes them."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from numpy.typing import NDArray

try:
    from dolfinx.io import gmsh as _gmsh
except ImportError:  # 0.9
    from dolfinx.io import gmshio as _gmsh

__all__ = ["geometry_degree", "geometry_nodes", "model_to_mesh", "submesh", "whole_form"]


def model_to_mesh(model: Any, comm: MPI.Comm, gdim: int) -> tuple[mesh.Mesh, Any, Any]:
    """(mesh, cell tags, facet tags) of the gmsh model that rank 0 has (None on the others), spread over `comm`. What follows
    these three since 0.10 is left out."""
    data = _gmsh.model_to_mesh(model, comm, 0, gdim)
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


def geometry_nodes(domain: mesh.Mesh) -> NDArray[np.int32]:
    """(cells, nodes) the geometry's node that each node of a cell is; `dofmap` gave way to `dofmaps` in 0.11."""
    geometry = domain.geometry
    return np.asarray(geometry.dofmaps[0] if hasattr(geometry, "cmaps") else geometry.dofmap)


def whole_form(F: Any, domain: mesh.Mesh) -> Any:
    """F so written that no integral of it is lost.

    UFL gathers equal integrands over several subdomains into one integral; DOLFINx 0.9 keeps one integral per subdomain and
    so drops, without a word, what is integrated there with other metadata: the weight of one of two bodies of the same
    material, say. A factor of one, its own on each subdomain, keeps the integrands apart where that may happen.
    """
    ids, metadata = defaultdict(set), defaultdict(set)
    for integral in F.integrals():
        ids[integral.integral_type()].add(integral.subdomain_id())
        metadata[integral.integral_type()].add(repr(sorted(integral.metadata().items(), key=repr)))
    mixed = {kind for kind in ids if len(ids[kind]) > 1 and len(metadata[kind]) > 1}
    if not mixed:
        return F
    one = {(kind, k): fem.Constant(domain, 1.0) for kind in mixed for k in ids[kind]}
    keys = [(integral.integral_type(), integral.subdomain_id()) for integral in F.integrals()]
    return ufl.Form(
        [
            integral.reconstruct(one[key] * integral.integrand()) if key in one else integral
            for key, integral in zip(keys, F.integrals(), strict=True)
        ]
    )
