"""What every mesh builder shares: run gmsh on one rank, hand the mesh to all, or write it to a file."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dolfinx import mesh
from dolfinx.io import gmshio
from mpi4py import MPI

__all__ = ["distribute", "main"]


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
    if comm.rank == 0:
        with _session() as gmsh:
            build(gmsh)
            return gmshio.model_to_mesh(gmsh.model, comm, 0, gdim)
    return gmshio.model_to_mesh(None, comm, 0, gdim)


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
