"""The connected pieces of a body's mesh, and which rigid motions its Dirichlet conditions leave free.

A piece that may still move as a whole is held by contact alone: while the contact is open its stiffness is singular. Newton
then needs help (`NewtonSolver`), and a failure can say which piece it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.reductions import any_over, max_over, sum_over

__all__ = ["Piece", "connected", "floating_pieces", "pieces_of", "rigid_motions", "seen_by_any"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FREE = 1e-10  # share of a rigid motion's square that prescribed components must see, or stiffness, for it to be held


@dataclass(frozen=True)
class Piece:
    """A piece of a mesh that can move as a whole.

    Attributes:
        centre: (gdim,) mean reference position of its nodes (m).
        nodes: numbers, local to this rank, of its nodes, ghosts included.
        number: of the piece in the body.
    """

    centre: Array
    nodes: Index
    number: int

    def __str__(self) -> str:
        return f"the body around X = {np.array2string(self.centre, precision=3)}"


def pieces_of(V: fem.FunctionSpace) -> tuple[Index, int]:
    """(nodes,) the number of the piece of V's mesh that each node of this rank belongs to, ghosts included, and how many
    pieces there are (collective)."""
    label = _labels(V)
    known = seen_by_any(V.mesh.comm, label)
    return np.searchsorted(known, label), len(known)


def seen_by_any(comm: MPI.Intracomm, pieces: Index) -> Index:
    """The numbers of pieces that any rank names, each once and in order (collective)."""
    return np.unique(np.concatenate(comm.allgather(np.unique(pieces))))


def floating_pieces(V: fem.FunctionSpace, label: Index, prescribed: fem.Function, stiffness: PETSc.Mat) -> list[Piece]:
    """The pieces of V's mesh that can move as a whole: neither `prescribed` (1 at prescribed components) nor `stiffness`,
    such as an elastic foundation or inertia, holds them (collective). `label`: as in :func:`pieces_of`."""
    comm, d = V.mesh.comm, V.mesh.geometry.dim
    owned = V.dofmap.index_map.size_local
    diagonal = stiffness.getDiagonal().array.reshape(-1, d)
    X = V.tabulate_dof_coordinates()[:owned, :d]
    held = prescribed.x.array[: owned * d].reshape(-1, d) > 0
    pieces = []
    for number in sorted(set().union(*comm.allgather(set(map(int, label[:owned]))))):
        mine = label[:owned] == number
        nodes = sum_over(comm, int(mine.sum()))
        centre = sum_over(comm, X[mine].sum(axis=0)) / nodes
        size = np.sqrt(sum_over(comm, float(np.sum((X[mine] - centre) ** 2))) / nodes)
        modes = rigid_motions((X - centre) / max(size, 1e-300)) * mine[:, None, None]  # (nodes, d, modes)
        gram = sum_over(comm, modes[held].T @ modes[held]) / nodes
        scale = max_over(comm, float(np.abs(diagonal[mine]).max(initial=0.0)))
        share, combinations = np.linalg.eigh(gram)
        free = (modes @ combinations[:, share < FREE]).reshape(owned * d, int(np.sum(share < FREE)))
        if any(_energy(stiffness, mode) < FREE * scale * nodes for mode in free.T):
            pieces.append(Piece(centre, np.flatnonzero(label == number), number))
    return pieces


def connected(cells: Index, n: int) -> Index:
    """(n,) the least node that each of n nodes is connected with by cells (m, k): least labels move from cell to cell and
    every label takes its own label's (S. C. Liu and R. E. Tarjan, SOSA 2019), in some log n rounds."""
    label: Index = np.arange(n)
    while True:
        seen = label[cells]
        least = seen.min(axis=1, keepdims=True)
        if np.array_equal(seen, np.broadcast_to(least, seen.shape)):
            return label
        np.minimum.at(label, seen, np.broadcast_to(least, seen.shape))
        label = label[label]


def _energy(A: PETSc.Mat, mode: Array) -> float:
    """|𝐦ᵀ𝐀𝐦| of the mode with the owned values `mode`."""
    m, Am = A.createVecs()
    m.array[:] = mode
    A.mult(m, Am)
    return abs(float(m.dot(Am)))


def _labels(V: fem.FunctionSpace) -> Index:
    """(nodes,) the piece of each node of this rank, ghosts included: the largest global number in it (collective)."""
    index_map = V.dofmap.index_map
    n = index_map.size_local + index_map.num_ghosts
    cells = V.dofmap.list
    # cells that share a node share a vertex, and the dofs of vertices are the first
    local = connected(cells[:, : len(basix.geometry(V.mesh.basix_cell()))], n)
    local[cells] = local[cells[:, :1]]
    field = fem.Function(V)
    value = field.x.array.reshape(n, V.dofmap.index_map_bs)  # the same in all components
    value[:] = index_map.local_to_global(np.arange(n, dtype=np.int32))[:, None]
    while True:
        largest = np.full(n, -1.0)
        np.maximum.at(largest, local, value[:, 0])
        changed = bool(np.any(largest[local] != value[:, 0]))
        value[:] = largest[local][:, None]
        if not any_over(V.mesh.comm, changed):
            return value[:, 0].astype(np.int64)
        field.x.petsc_vec.ghostUpdate(addv=PETSc.InsertMode.MAX_VALUES, mode=PETSc.ScatterMode.REVERSE)
        field.x.petsc_vec.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)


def rigid_motions(x: Array) -> Array:
    """(n, d, motions) translations, then infinitesimal rotations about the origin, at points x (n, d)."""
    n, d = x.shape
    modes = [np.broadcast_to(e, (n, d)) for e in np.eye(d)]
    if d == 2:
        modes.append(np.stack([-x[:, 1], x[:, 0]], axis=1))
    else:
        modes += [np.cross(np.broadcast_to(e, (n, d)), x) for e in np.eye(3)]
    return np.stack(modes, axis=2)
