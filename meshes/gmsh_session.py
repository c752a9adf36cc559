"""What every mesh builder shares: run gmsh on one rank, hand the mesh to all, or write it to a file."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from dolfinx_mortar_al.ranks import on_root
from dolfinx_mortar_al.versions import model_to_mesh

__all__ = ["distribute", "main", "structured_box"]


@contextmanager
def _session() -> Iterator[Any]:
    """An open gmsh, quiet, closed whatever happens."""
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Verbosity", 2)
        yield gmsh
    finally:
        gmsh.finalize()


def distribute(build: Callable[[Any], None], comm: MPI.Comm, gdim: int) -> tuple[mesh.Mesh, Any, Any]:
    """The mesh that `build(gmsh)` makes on rank 0, spread over `comm`: (mesh, cell tags, facet tags)."""
    if comm.rank > 0:
        on_root(comm, lambda: None)
        return model_to_mesh(None, comm, gdim)
    with _session() as gmsh:
        on_root(comm, lambda: build(gmsh))
        return model_to_mesh(gmsh.model, comm, gdim)


def structured_box(
    gmsh: Any, origin: Sequence[float], size: Sequence[float], cells: Sequence[int], triangles: bool, tag: int
) -> list[int]:
    """Add a rectangle (box) of transfinite `cells` along each axis, its own entity that shares no node with others, its
    cells tagged `tag`; returns its facets."""
    model, d = gmsh.model, len(size)
    add = model.occ.addBox if d == 3 else model.occ.addRectangle
    entity = (d, add(*origin, *size))
    model.occ.synchronize()
    facets = model.getBoundary([entity], oriented=False)
    curves = set(model.getBoundary(facets, combined=False, oriented=False)) if d == 3 else facets
    for dim, curve in curves:
        low, high = np.split(np.array(model.getBoundingBox(dim, curve)), 2)
        model.mesh.setTransfiniteCurve(curve, cells[int(np.argmax(high - low))] + 1)
    for dim, surface in facets if d == 3 else [entity]:
        model.mesh.setTransfiniteSurface(surface)
        if not triangles:
            model.mesh.setRecombine(dim, surface)
    if d == 3:
        model.mesh.setTransfiniteVolume(entity[1])
    model.addPhysicalGroup(d, [entity[1]], tag)
    return [facet for _, facet in facets]


def main(description: str, build: Callable[[Any], None], default: str) -> None:
    """Command line of a builder run alone: write its default mesh to a .msh file."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("output", nargs="?", type=Path, default=Path(default), help="the .msh file (%(default)s)")
    path = parser.parse_args().output
    with _session() as gmsh:
        build(gmsh)
        path.parent.mkdir(parents=True, exist_ok=True)
        gmsh.write(str(path))
    print(f"wrote {path}")
