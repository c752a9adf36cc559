"""A user's own gmsh file, read on one rank and spread over all with its tags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dolfinx import mesh
from dolfinx.io import gmshio
from mpi4py import MPI

__all__ = ["read_msh"]


def read_msh(path: Path | str, comm: MPI.Comm = MPI.COMM_WORLD, gdim: int = 2) -> tuple[mesh.Mesh, Any, Any]:
    """(mesh, cell tags, facet tags) of a gmsh .msh file with physical groups.

    Args:
        path: the file.
        comm: the ranks to spread it over.
        gdim: dimension of space.

    Raises:
        FileNotFoundError: on every rank.
        ValueError: on every rank, if gmsh cannot read the file, or its cells are not of dimension `gdim`
            (bodies) or gdim − 1 (membranes).
    """
    trouble: Exception | None = None
    if comm.rank == 0:
        if not Path(path).is_file():
            trouble = FileNotFoundError(
                f"{path}: no such file; write it with gmsh or with `python3 -m meshes.two_beams {path}`"
            )
        else:
            trouble = _unreadable(Path(path), gdim)
    trouble = comm.bcast(trouble)
    if trouble is not None:
        raise trouble
    return gmshio.read_from_msh(str(path), comm, 0, gdim=gdim)


def _unreadable(path: Path, gdim: int) -> ValueError | None:
    """What is wrong with the file, found on one rank before the others wait for it."""
    import gmsh

    started = not gmsh.isInitialized()
    if started:
        gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        groups = gmsh.model.getPhysicalGroups()
        dim = max((d for d, _ in groups), default=-1)
        if dim < 0:
            return ValueError(f"{path}: no physical groups; name the bodies and surfaces as such in gmsh")
        if dim not in (gdim - 1, gdim):
            return ValueError(f"{path}: cells of dimension {dim} in space of dimension gdim = {gdim}")
    except Exception as error:  # gmsh raises plain Exceptions
        return ValueError(f"{path}: gmsh cannot read it: {error}")
    finally:
        if started:
            gmsh.finalize()
        else:
            gmsh.clear()
    return None
