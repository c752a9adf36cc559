"""A user's own gmsh file, read on one rank and spread over all with its tags.

DOLFINx takes one kind of cell, each in one physical group, and facets that are sides of these cells; with other files it, or
gmsh, ends the process. They are looked at here first.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from math import comb
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import mesh
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.ranks import on_root
from dolfinx_mortar_al.validation import whole
from dolfinx_mortar_al.versions import model_to_mesh

__all__ = ["read_msh"]

Index = NDArray[np.int64]

FLAT = 1e-9  # of a plane mesh's diameter: how far its nodes may lie off the plane z = const


def read_msh(path: Path | str, comm: MPI.Comm = MPI.COMM_WORLD, gdim: int | None = None) -> tuple[mesh.Mesh, Any, Any]:
    """(mesh, cell tags, facet tags) of a gmsh .msh file with physical groups.

    Args:
        path: the file.
        comm: the ranks to spread it over.
        gdim: dimension of space, 2 or 3; default 3 for solid cells and 2 for others, which may also be membranes in space.

    Raises:
        FileNotFoundError: on every rank.
        ValueError: on every rank, if gmsh cannot read the whole file, its cells are not of dimension `gdim` (bodies) or
            gdim − 1 (membranes), of several types, in no or in several physical groups, or a physical group has facets of
            no such cell; or if it is partitioned.
    """
    if not isinstance(path, str | PathLike):
        raise ValueError(f"path = {path!r}: the name of a .msh file; a model of gmsh's goes to DOLFINx's model_to_mesh")
    path = Path(path)
    asked = None if gdim is None else whole("gdim", gdim, least=2, most=3)
    with ExitStack() as stack:
        dimension = on_root(comm, lambda: _open(path, asked, stack))
        if comm.rank > 0:
            return model_to_mesh(None, comm, dimension)
        import gmsh

        return model_to_mesh(gmsh.model, comm, dimension)


def _open(path: Path, gdim: int | None, stack: ExitStack) -> int:
    """Open the file in gmsh until the end of `stack`; refuse what DOLFINx would not survive; the dimension of space."""
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such file; write it with gmsh or with `python3 -m meshes.two_beams {path}`"
        )
    try:
        gmsh, complaints = stack.enter_context(_opened(path))
        if complaints:
            raise ValueError(f"gmsh cannot read it: {complaints[0]}")
        return _check_model(gmsh, gdim)
    except Exception as error:  # gmsh raises plain Exceptions
        said = str(error) if isinstance(error, ValueError) else f"gmsh cannot read it: {error}"
        raise ValueError(f"{path}: {said}") from None


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, list[str]]]:
    """gmsh with the file open, quiet, and its complaints about it."""
    import gmsh

    started = not gmsh.isInitialized()
    if started:
        gmsh.initialize(interruptible=False)
    current, talks = gmsh.model.getCurrent(), gmsh.option.getNumber("General.Terminal")
    gmsh.model.add("file")  # the caller's models stay as they are
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.logger.start()
        before = len(gmsh.logger.get())  # of earlier files
        gmsh.merge(str(path))
        said = gmsh.logger.get()[before:]
        yield gmsh, [line for line in said if line.startswith(("Error", "Warning"))]
    finally:
        gmsh.logger.stop()
        if started:
            gmsh.finalize()
        else:
            gmsh.option.setNumber("General.Terminal", talks)
            gmsh.model.remove()
            gmsh.model.setCurrent(current)


def _check_model(gmsh: Any, gdim: int | None) -> int:
    """Refuse a model that is none of bodies or membranes; the dimension of space."""
    groups = gmsh.model.getPhysicalGroups()
    dim = max((d for d, _ in groups), default=-1)
    if dim < 0:
        raise ValueError("no physical groups; name the bodies and surfaces as such in gmsh")
    if gmsh.model.getNumberOfPartitions():
        raise ValueError(
            "partitioned; save it as one piece (gmsh.model.mesh.unpartition), the ranks share it out themselves"
        )
    largest = max((d for d, tag in gmsh.model.getEntities() if len(gmsh.model.mesh.getElements(d, tag)[0])), default=-1)
    gdim = max(largest, 2) if gdim is None else gdim
    if dim < largest <= gdim:
        raise ValueError(
            f"physical groups of facets (dimension {dim}) but not of cells (dimension {largest}): put the bodies into groups"
        )
    if dim not in (gdim - 1, gdim):
        raise ValueError(f"cells of dimension {dim} in space of dimension gdim = {gdim}")
    _check_plane(gmsh, gdim)
    sides = _check_cells(gmsh, dim)
    if dim - 1 in {d for d, _ in groups}:
        _check_facets(gmsh, dim - 1, sides)
    return gdim


def _check_plane(gmsh: Any, gdim: int) -> None:
    x = np.asarray(gmsh.model.mesh.getNodes()[1]).reshape(-1, 3)
    if gdim == 2 and len(x) and np.ptp(x[:, 2]) > FLAT * np.linalg.norm(np.ptp(x, axis=0)):
        raise ValueError(
            f"nodes off a plane (z from {x[:, 2].min():g} to {x[:, 2].max():g}): put the volumes of bodies into physical "
            "groups, too; for membranes in space pass gdim=3"
        )


def _in_groups(gmsh: Any, dim: int) -> tuple[Index, Index, set[int]]:
    """Elements of all physical groups of a dimension: (n,) their numbers, (n,) tags of their groups; the element types."""
    numbers: list[Index] = [np.zeros(0, dtype=np.int64)]
    tags: list[Index] = [np.zeros(0, dtype=np.int64)]
    types: set[int] = set()
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            kinds, elements, _ = gmsh.model.mesh.getElements(dim, entity)
            types |= set(map(int, kinds))
            numbers += [np.asarray(e, dtype=np.int64) for e in elements]
            tags += [np.full(len(e), tag) for e in elements]
    return np.concatenate(numbers), np.concatenate(tags), types


def _once(numbers: Index, tags: Index, what: str) -> None:
    """Each element belongs to one group."""
    different, where, count = np.unique(numbers, return_inverse=True, return_counts=True)
    if len(different) < len(numbers):
        both = sorted(set(tags[where == int(np.argmax(count))].tolist()))
        raise ValueError(
            f"{what} in several physical groups, such as {both}: mesh tags hold one number each. Of bodies that are to be in "
            "contact, each needs facets and nodes of its own: leave out gmsh's fragment"
        )


def _check_cells(gmsh: Any, dim: int) -> set[tuple[int, ...]]:
    """Cells are of one type and in one group each; returns the corner nodes, sorted, of their sides."""
    numbers, tags, types = _in_groups(gmsh, dim)
    if not len(numbers):
        raise ValueError(f"the physical groups of dimension {dim} have no cells: mesh before you save")
    if len(types) > 1:
        names = " and ".join(gmsh.model.mesh.getElementProperties(t)[0] for t in sorted(types))
        raise ValueError(f"cells of several types, {names}: mesh with one (recombine all surfaces or none)")
    _once(numbers, tags, "cells")
    mesh_ = gmsh.model.mesh
    kind = types.pop()
    _check_kind(*mesh_.getElementProperties(kind)[:4])
    sides: list[Index] = []
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            if dim == 3:
                for n in (3, 4):
                    sides.append(
                        np.asarray(mesh_.getElementFaceNodes(kind, n, entity, True), dtype=np.int64).reshape(-1, n)
                    )
            elif dim == 2:
                sides.append(np.asarray(mesh_.getElementEdgeNodes(kind, entity, True), dtype=np.int64).reshape(-1, 2))
            else:
                nodes = np.asarray(mesh_.getElementsByType(kind, entity)[1], dtype=np.int64)
                sides.append(nodes.reshape(-1, mesh_.getElementProperties(kind)[3])[:, :2].reshape(-1, 1))
    return {side for block in sides for side in _sorted(block)}


def _check_kind(name: str, dim: int, order: int, nodes: int) -> None:
    """Cells are complete simplices or cubes, as DOLFINx takes them."""
    family = name.split()[0]
    cube, simplex = (order + 1) ** dim, comb(order + dim, dim)
    complete = {"Line": cube, "Triangle": simplex, "Quadrilateral": cube, "Tetrahedron": simplex, "Hexahedron": cube}
    if family not in complete:
        raise ValueError(f"cells of type {name}: mesh with tetrahedra or with hexahedra")
    if nodes != complete[family]:
        raise ValueError(
            f"cells of type {name}, which lack nodes of their faces or middle: set gmsh's Mesh.SecondOrderIncomplete to 0"
        )


def _check_facets(gmsh: Any, dim: int, sides: set[tuple[int, ...]]) -> None:
    """Facets are in one group each and sides of cells."""
    _once(*_in_groups(gmsh, dim)[:2], "facets")
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            for kind, _, nodes in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
                _, _, _, count, _, corners = gmsh.model.mesh.getElementProperties(kind)
                facets = np.asarray(nodes, dtype=np.int64).reshape(-1, count)[:, :corners]
                if not sides.issuperset(_sorted(facets)):
                    raise ValueError(
                        f"physical group {tag} has facets of no cell that is in a group: put their body into one, too"
                    )


def _sorted(nodes: Index) -> list[tuple[int, ...]]:
    """Node numbers (n, k) as tuples in ascending order."""
    rows: Any = np.sort(nodes, axis=1).tolist()
    return [tuple(row) for row in rows]
