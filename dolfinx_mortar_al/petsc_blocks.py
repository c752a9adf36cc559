"""PETSc matrices and vectors of one block of unknowns: made from a layout, filled with batches of element arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

__all__ = [
    "JointNumbering",
    "Layout",
    "empty_matrix",
    "insert",
    "insert_vector",
    "matrix_with_pattern",
    "row_by_row",
    "without_zeros",
]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Index32 = NDArray[np.int32]

_ADD = PETSc.InsertMode.ADD


@dataclass(frozen=True)
class Layout:
    """How the unknowns of a block are spread: local and global number of nodes, components per node."""

    comm: MPI.Intracomm
    local: int
    total: int
    components: int

    @classmethod
    def of(cls, V: fem.FunctionSpace) -> Layout:
        """The layout of a function space's dofs."""
        index_map = V.dofmap.index_map
        return cls(V.mesh.comm, index_map.size_local, index_map.size_global, V.dofmap.index_map_bs)

    @property
    def sizes(self) -> tuple[int, int]:
        """Local and global number of unknowns."""
        return self.local * self.components, self.total * self.components

    def vector(self) -> PETSc.Vec:
        """A vector of zeros."""
        v = PETSc.Vec().createMPI(self.sizes, bsize=self.components, comm=self.comm)
        v.set(0.0)
        return v


class JointNumbering:
    """Common numbers of the nodes of several spaces: on each rank those of the first, then those of the next.

    Args:
        comm: of the spaces.
        owned: how many nodes of each this rank has.
        components: per node.

    Attributes:
        own_start, start: (ranks, spaces) where each rank's part of each begins, in the space's own numbers and the common.
        layout: of all of them.
    """

    def __init__(self, comm: MPI.Intracomm, owned: Sequence[int], components: int) -> None:
        counts = np.array(comm.allgather(list(owned)), dtype=np.int64)
        self.own_start = np.cumsum(counts, axis=0) - counts
        self.start = (np.cumsum(counts.ravel()) - counts.ravel()).reshape(counts.shape)
        self.layout = Layout(comm, int(counts[comm.rank].sum()), int(counts.sum()), components)

    def common(self, k: int, nodes: Index) -> Index:
        """Common numbers of nodes of space k given by its own global numbers (any shape)."""
        rank = np.searchsorted(self.own_start[:, k], nodes, side="right") - 1
        return np.asarray(nodes - self.own_start[rank, k] + self.start[rank, k])


def empty_matrix(rows: Layout, columns: Layout) -> PETSc.Mat:
    """A matrix without a pattern: PETSc collects the entries in a hash table until the first assembly."""
    A = PETSc.Mat().create(rows.comm)
    A.setSizes((rows.sizes, columns.sizes))
    A.setType(PETSc.Mat.Type.AIJ)
    A.setBlockSizes(rows.components, columns.components)
    A.setUp()
    return A


def matrix_with_pattern(layout: Layout, pattern: tuple[Index32, Index32]) -> PETSc.Mat:
    """A square matrix with a pattern in compressed rows (of this rank, ascending global columns), entries zero."""
    indptr, indices = pattern
    A = PETSc.Mat().create(layout.comm)
    A.setSizes((layout.sizes, layout.sizes))
    A.setType(PETSc.Mat.Type.AIJ)
    A.setBlockSize(layout.components)
    A.setPreallocationCSR((indptr, indices, np.zeros(len(indices))))
    return row_by_row(A)


def row_by_row(A: PETSc.Mat) -> PETSc.Mat:
    """A, whose products go through each row by itself from now on. PETSc takes rows of the same pattern together, as a node's
    are, and needs twice the time (docs/scaling.md)."""
    A.setOption(PETSc.Mat.Option.USE_INODES, False)
    return A


def without_zeros(A: PETSc.Mat) -> PETSc.Mat:
    """A copy of A that stores no zeros: PETSc's products and factors otherwise take them for entries."""
    indptr, columns, values = A.getValuesCSR()
    kept = values != 0.0
    starts = np.r_[0, np.cumsum(kept)][indptr].astype(indptr.dtype)
    return PETSc.Mat().createAIJ(A.getSizes(), csr=(starts, columns[kept], values[kept]), comm=A.comm)


def insert(A: PETSc.Mat, rows: Index, columns: Index, values: Array, factor: float = 1.0) -> None:
    """Add `factor` × element matrices (m, rows, row_bs, columns, column_bs) at global blocks (m, ·), (m, ·)."""
    m, k, row_bs, l, column_bs = values.shape
    values = values.reshape(m, k * row_bs, l * column_bs)
    values = values if factor == 1.0 else factor * values
    if row_bs == column_bs and row_bs > 1:
        A.setValuesBlockedRCV(rows.astype(np.int32), columns.astype(np.int32), values, _ADD)
        return
    i = (rows[:, :, None] * row_bs + np.arange(row_bs)).reshape(m, k * row_bs)
    j = (columns[:, :, None] * column_bs + np.arange(column_bs)).reshape(m, l * column_bs)
    A.setValuesRCV(i.astype(np.int32), j.astype(np.int32), values, _ADD)


def insert_vector(b: PETSc.Vec, blocks: Index, values: Array, factor: float = 1.0) -> None:
    """Add `factor` × element vectors (m, nodes, components) at global blocks (m, nodes)."""
    m = values.shape[2]
    index = (blocks[:, :, None] * m + np.arange(m)).astype(np.int32)
    b.setValues(index.ravel(), factor * values.ravel(), addv=_ADD)
