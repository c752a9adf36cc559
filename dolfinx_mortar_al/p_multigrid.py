"""Displacements of order 1 below those of order 2: the coarse space of the linear solver's p-multigrid."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as dolfinx_petsc
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.bodies import Bodies, BodyForms
from dolfinx_mortar_al.petsc_blocks import JointNumbering

__all__ = ["FirstOrder"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ONE = 1e-9  # how near to 1 an interpolation weight counts as that of the node itself


class FirstOrder:
    """The displacements of order 1 on the bodies' meshes, numbered rank by rank and, within a rank, body by body.

    A prescribed node is interpolated from itself alone, and to no other: the Galerkin product keeps its unit diagonal.

    Attributes:
        interpolation: (owned dofs, owned coarse dofs) to the bodies' displacements.
    """

    def __init__(self, bodies: Bodies) -> None:
        self._bodies, comm, d = bodies, bodies.comm, bodies.gdim
        spaces = [fem.functionspace(body.mesh, ("Lagrange", 1, (d,))) for body in bodies.bodies]
        self._coarse = [fem.Function(V) for V in spaces]
        numbering = JointNumbering(comm, [V.dofmap.index_map.size_local for V in spaces], d)
        self._layout = numbering.layout
        indptr, columns, values = [np.zeros(1, dtype=np.int64)], [], []
        for k, body in enumerate(bodies.bodies):
            rows, block, component, weight = self._of(body, k)
            columns.append(numbering.common(k, block) * d + component)
            values.append(weight)
            indptr.append(rows[1:].astype(np.int64) + indptr[-1][-1])
        self.interpolation = PETSc.Mat().create(comm)
        self.interpolation.setSizes((bodies.layout.sizes, self._layout.sizes))
        self.interpolation.setType(PETSc.Mat.Type.AIJ)
        self.interpolation.setBlockSizes(d, d)
        csr = np.concatenate(indptr).astype(np.int32), np.concatenate(columns).astype(np.int32)
        self.interpolation.setPreallocationCSR((*csr, np.concatenate(values)))

    def _of(self, body: BodyForms, k: int) -> tuple[Index, Index, Index, Array]:
        """Interpolation to one body in compressed rows: starts, the columns' global nodes and components, weights."""
        fine, coarse, d = body.prescribed(), self._coarse[k], self._bodies.gdim
        coarse.interpolate(fine)
        A = dolfinx_petsc.interpolation_matrix(coarse.function_space, body.space)
        A.assemble()
        rows, columns, plain = A.getValuesCSR()
        keep_rows, keep_columns = A.createVecs()[::-1]
        owned = body.owned * d
        fixed = fine.x.array[:owned] > 0
        keep_rows.array[:] = ~fixed
        keep_columns.array[:] = 1.0 - np.round(coarse.x.array[: keep_columns.getLocalSize()])
        A.diagonalScale(keep_rows, keep_columns)
        itself = np.repeat(fixed, np.diff(rows)) & (np.abs(plain - 1.0) < ONE)
        weight = np.where(itself, 1.0, A.getValuesCSR()[2])
        used = np.abs(weight) > ONE
        starts = np.r_[0, np.cumsum(used)][rows]
        block, component = np.divmod(columns[used].astype(np.int64), d)
        return starts, block, component, weight[used]

    def positions(self) -> PETSc.Vec:
        """Current positions of the nodes (m)."""
        d, parts = self._bodies.gdim, []
        for body, coarse in zip(self._bodies.bodies, self._coarse, strict=True):
            coarse.interpolate(body.u)
            n = coarse.function_space.dofmap.index_map.size_local
            X = coarse.function_space.tabulate_dof_coordinates()[:n, :d]
            parts.append(X.ravel() + coarse.x.array[: n * d])
        x = self._layout.vector()
        x.array[:] = np.concatenate(parts)
        return x
