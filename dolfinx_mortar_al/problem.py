"""The coupled problem, eq. (3): a UFL bulk residual and contact pairs in PETSc nested vectors and matrices.

Unknowns are [U, Λ₁/k₁, Λ₂/k₂, …], one multiplier block per pair, and the multipliers' residual is taken times k, the
pair's default ε: all unknowns are lengths, all residuals forces, and the blocks of the Jacobian, the MATNEST of eq. (6),
are of one magnitude whatever the units, so that the direct solver needs no scaling of its own. Contact couples nodes
of ranks that share no ghost: element blocks are inserted with global indices and PETSc ships the rows of other ranks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as dolfinx_petsc
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.contact import Contact, ContactPair
from dolfinx_mortar_al.materials import deformation_gradient
from dolfinx_mortar_al.projection import TargetPoint
from dolfinx_mortar_al.stopwatch import Stopwatch

__all__ = ["ContactProblem", "State"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass
class State:
    """What a step may change, on this rank: displacement, and of each pair multiplier, slip history and λ̂_N."""

    u: Array
    multipliers: list[Array]
    history: list[TargetPoint]
    pressures: list[Array]


class ContactProblem:
    """Bulk residual F(u; v) = 0 with contact pairs.

    Args:
        F: UFL residual, internal minus external virtual work, linear in the test function.
        u: displacement (m), Lagrange of order 1 or 2 with gdim components; holds the start state.
        bcs: Dirichlet conditions on u.
        contacts: the pairs.
        jacobian: UFL bilinear form, default the derivative of F in the direction of u.

    Raises:
        ValueError: on every rank: a space that is not Lagrange of order 1 or 2 with gdim components, a mesh whose
            geometry is of higher order than u, a surface problem (see :class:`~dolfinx_mortar_al.contact.Contact`), or a
            start state with det F ≤ 0.
    """

    def __init__(
        self,
        F: Any,
        u: fem.Function,
        *,
        bcs: Sequence[fem.DirichletBC] = (),
        contacts: Sequence[Contact] = (),
        jacobian: Any = None,
    ) -> None:
        self.stopwatch = Stopwatch()
        self.u, self.V, self.bcs = u, u.function_space, list(bcs)
        self.comm: MPI.Intracomm = self.V.mesh.comm
        self.gdim: int = self.V.mesh.geometry.dim
        _check_space(self.V)
        with self.stopwatch("forms"):
            self.F = fem.form(F)
            self.J = fem.form(ufl.derivative(F, u) if jacobian is None else jacobian)
            self._inverted = self._inversion_form()
        u.x.scatter_forward()
        if self.inverted_volume() > 0:
            raise ValueError(
                "u: det F ≤ 0 somewhere in the start state; start from a displacement without inverted cells"
            )
        with self.stopwatch("contact set-up"):
            self.pairs = [ContactPair(c, self.V, self.bcs, self.stopwatch) for c in contacts]
        with self.stopwatch("bulk"):
            stiffness = self._create_matrices()
        for pair in self.pairs:
            pair.set_law(pair.surface_stiffness(stiffness))
            pair.start(u)
        self.force_scale = self.force_floor = 0.0
        diameter = _diameter(self.V)
        self.force_floor = 2e-15 * stiffness.x.array.max(initial=0.0) * diameter
        self.force_floor = self.comm.allreduce(self.force_floor, MPI.MAX)
        self.gap_floor = [2e-15 * diameter * pair.area for pair in self.pairs]

    def _inversion_form(self) -> Any:
        mesh, degree = self.V.mesh, 2 * self.V.element.basix_element.degree
        dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": degree})
        return fem.form(ufl.conditional(ufl.gt(ufl.det(deformation_gradient(self.u)), 0.0), 0.0, 1.0) * dx)

    def inverted_volume(self) -> float:
        """Reference volume where det F ≤ 0 or is not a number, at the bulk's Gauss points (collective)."""
        return float(self.comm.allreduce(fem.assemble_scalar(self._inverted)))

    # ---------------------------------------------------------------- matrices and vectors

    def _create_matrices(self) -> fem.Function:
        """Make the nest; returns the diagonal of the bulk's stiffness (N/m) at the start state."""
        self._seen: list[Index] = [np.empty(0, dtype=np.int64) for _ in self.pairs]
        spaces = [self.V] + [pair.multiplier.field.function_space for pair in self.pairs]
        n = len(spaces)
        self.blocks: list[list[Any]] = [[None] * n for _ in range(n)]
        self.blocks[0][0] = dolfinx_petsc.create_matrix(self.J)
        for k in range(1, n):
            for i, j in [(0, k), (k, 0), (k, k)]:
                self.blocks[i][j] = _empty_matrix(spaces[i], spaces[j])
                self.blocks[i][j].assemble()
        bulk = self.blocks[0][0]
        dolfinx_petsc.assemble_matrix(bulk, self.J)
        bulk.assemble()
        self._bulk_pattern = bulk.getValuesCSR()
        diagonal = fem.Function(self.V)
        bulk.getDiagonal(diagonal.x.petsc_vec)
        diagonal.x.scatter_forward()
        self._make_nest()
        fields = [self.u] + [pair.multiplier.field for pair in self.pairs]
        self.x = PETSc.Vec().createNest([_petsc_vector(f.function_space) for f in fields], comm=self.comm)
        self.residual = self.x.duplicate()
        self.fields = fields
        return diagonal

    def _grow_pattern(self) -> None:
        """Give the matrices room for the facet couples now in contact, beside all those seen before.

        The pattern only grows, so that the symbolic factorisation is kept while contact stays on the same couples.
        """
        new = [pair.couples() for pair in self.pairs]
        grown = any(len(np.setdiff1d(n, seen, assume_unique=True)) for n, seen in zip(new, self._seen, strict=True))
        if not self.comm.allreduce(grown, MPI.LOR):
            return
        for k, pair in enumerate(self.pairs):
            self._seen[k] = np.union1d(self._seen[k], pair.with_neighbours(new[k]))
        V, n = self.V, len(self.blocks)
        self.blocks = [[None] * n for _ in range(n)]
        contact = _empty_matrix(V, V)
        for k, pair in enumerate(self.pairs, start=1):
            UU, *others = pair.pattern(self._seen[k - 1])
            _insert(contact, *UU)
            Q = pair.multiplier.field.function_space
            for (i, j), element in zip([(0, k), (k, 0), (k, k)], others, strict=True):
                block = _empty_matrix(V if i == 0 else Q, V if j == 0 else Q)
                _insert(block, *element)
                if i == j:
                    idle = pair.multiplier.idle
                    block.setValuesRCV(idle[:, None], idle[:, None], np.zeros((len(idle), 1, 1)), _ADD)
                block.assemble()
                self.blocks[i][j] = block
        contact.assemble()
        self.blocks[0][0] = _matrix_with_pattern(V, self._bulk_pattern, contact.getValuesCSR())
        self._make_nest()

    def _make_nest(self) -> None:
        self.matrix = PETSc.Mat().createNest(self.blocks, comm=self.comm)
        self.matrix.assemble()

    # ---------------------------------------------------------------- evaluation

    @property
    def _units(self) -> list[float]:
        """What the unknowns of each block are counted in: metres, and Pa/(Pa/m) for multipliers."""
        return [1.0] + [pair.unit for pair in self.pairs]

    def unpack(self, x: PETSc.Vec) -> None:
        """Copy the nested vector into the Functions, ghosts included."""
        for field, part, unit in zip(self.fields, x.getNestSubVecs(), self._units, strict=True):
            field.x.array[: part.getLocalSize()] = unit * part.array_r
            field.x.scatter_forward()

    def pack(self, x: PETSc.Vec) -> None:
        """Copy the Functions into the nested vector."""
        for field, part, unit in zip(self.fields, x.getNestSubVecs(), self._units, strict=True):
            part.array[:] = field.x.array[: part.getLocalSize()] / unit
        x.assemble()

    def assemble_residual(self, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """The left-hand side of eq. (3) at x: forces, and k times the multipliers' residual (N)."""
        self.unpack(x)
        parts = f.getNestSubVecs()
        with self.stopwatch("bulk"):
            b = parts[0]
            with b.localForm() as local:
                local.set(0.0)
            dolfinx_petsc.assemble_vector(b, self.F)
            if self._unmet_bcs(parts[0]):
                dolfinx_petsc.apply_lifting(b, [self.J], [self.bcs], [self.u.x.petsc_vec], -1.0)
            b.ghostUpdate(addv=_ADD, mode=PETSc.ScatterMode.REVERSE)
            self.force_scale = b.norm()
            dolfinx_petsc.set_bc(b, self.bcs, self.u.x.petsc_vec, -1.0)
        for pair, part in zip(self.pairs, parts[1:], strict=True):
            pair.evaluate(self.u)
            with self.stopwatch("contact"):
                part.set(0.0)
                _insert_vector(part, *pair.multiplier_residual(), pair.unit)
                part.assemble()
                pair.switch(part)
                part.set(0.0)  # and stays so at redundant nodes, whose value is 0 and whose row is diagonal
                _insert_vector(part, *pair.multiplier_residual(), pair.unit)
                part.assemble()
                for blocks, values in pair.body_residual():
                    _insert_vector(parts[0], blocks, values)
        parts[0].assemble()
        f.assemble()

    def _unmet_bcs(self, template: PETSc.Vec) -> bool:
        """Whether u does not yet have its prescribed values (then the residual is lifted)."""
        if not self.bcs:
            return False
        gap = template.duplicate()
        gap.set(0.0)
        dolfinx_petsc.set_bc(gap, self.bcs, self.u.x.petsc_vec, -1.0)
        return bool(gap.norm(PETSc.NormType.NORM_INFINITY) > 0)

    def assemble_jacobian(self) -> None:
        """The derivative of the residual at the state last evaluated."""
        with self.stopwatch("contact"):
            self._grow_pattern()
            for row in self.blocks:
                for block in row:
                    if block is not None:
                        block.zeroEntries()
            for k, pair in enumerate(self.pairs, start=1):
                element, unit = pair.tangent(), pair.unit
                _insert(self.blocks[0][0], *element.UU)
                _insert(self.blocks[0][k], *element.UΛ, unit)
                _insert(self.blocks[k][0], *element.ΛU, unit)
                _insert(self.blocks[k][k], *element.ΛΛ, unit**2)
                idle = pair.multiplier.idle
                self.blocks[k][k].setValuesRCV(idle[:, None], idle[:, None], np.full((len(idle), 1, 1), unit), _ADD)
        with self.stopwatch("bulk"):
            dolfinx_petsc.assemble_matrix(self.blocks[0][0], self.J, bcs=self.bcs)
        with self.stopwatch("contact"):
            for row in self.blocks:
                for block in row:
                    if block is not None:
                        block.assemble()
            self.matrix.assemble()

    def contact_pattern(self) -> int:
        """A number that changes with the open/slip/stick state of any point on any rank (collective)."""
        mine = hash(tuple(pair.state.status.tobytes() for pair in self.pairs)) >> 8
        return int(self.comm.allreduce(mine, MPI.SUM))

    def flipping_points(self) -> str:
        """Where the law disagrees with the contact state it holds, in words (collective)."""
        parts = []
        for pair in self.pairs:
            points = self.comm.allgather(pair.points()[pair.closed != (pair.state.λN_hat >= 0.0)])
            X = np.concatenate(points)
            if len(X):
                parts.append(f"{pair.name}: {len(X)} points, the first at X = {np.array2string(X[0], precision=4)}")
        return "; ".join(parts) or "no point at odds with the law"

    # ---------------------------------------------------------------- transactions

    def state(self) -> State:
        """A copy of all that a step may change."""
        return State(
            self.u.x.array.copy(),
            [pair.multiplier.field.x.array.copy() for pair in self.pairs],
            [pair.history.copy() for pair in self.pairs],
            [pair.state.λN_hat.copy() for pair in self.pairs],
        )

    def restore(self, state: State) -> None:
        """Back to an earlier state, slip history included; Newton starts from the contact state that λ̂_N says."""
        self.u.x.array[:] = state.u
        for k, pair in enumerate(self.pairs):
            pair.multiplier.field.x.array[:] = state.multipliers[k]
            pair.restore(state.history[k], state.pressures[k])

    def commit(self) -> None:
        """The step has converged: it becomes the origin of the next one's slip."""
        for pair in self.pairs:
            pair.commit()

    @property
    def unknowns(self) -> dict[str, int]:
        """Global number of unknowns per block."""
        counts = {"u": self.V.dofmap.index_map.size_global * self.V.dofmap.index_map_bs}
        return counts | {f"multiplier of {pair.name}": pair.multiplier.size for pair in self.pairs}


_ADD = PETSc.InsertMode.ADD


def _check_space(V: fem.FunctionSpace) -> None:
    mesh, element = V.mesh, V.element.basix_element
    if mesh.topology.dim != mesh.geometry.dim:
        raise ValueError(
            f"a mesh of dimension {mesh.topology.dim} in space of dimension {mesh.geometry.dim}: not a body"
        )
    if V.dofmap.index_map_bs != mesh.geometry.dim:
        raise ValueError(f"u has {V.dofmap.index_map_bs} components on a mesh of dimension {mesh.geometry.dim}")
    if element.family.name != "P" or element.degree not in (1, 2) or element.discontinuous:
        raise ValueError(f"u: {V.ufl_element()} is not a continuous Lagrange element of order 1 or 2")
    if mesh.geometry.cmap.degree > element.degree:
        raise ValueError(
            f"u has order {element.degree} on a mesh of order {mesh.geometry.cmap.degree}: "
            "take u at least of the mesh's order"
        )


def _diameter(V: fem.FunctionSpace) -> float:
    """Diagonal of the mesh's bounding box (m)."""
    x, comm = V.mesh.geometry.x, V.mesh.comm
    low = np.min(comm.allgather(x.min(axis=0, initial=np.inf)), axis=0)
    high = np.max(comm.allgather(x.max(axis=0, initial=-np.inf)), axis=0)
    return float(np.linalg.norm(high - low))


def _sizes(V: fem.FunctionSpace) -> tuple[int, int]:
    return V.dofmap.index_map.size_local * V.dofmap.index_map_bs, V.dofmap.index_map.size_global * V.dofmap.index_map_bs


def _petsc_vector(V: fem.FunctionSpace) -> PETSc.Vec:
    from dolfinx.la import create_petsc_vector

    return create_petsc_vector(V.dofmap.index_map, V.dofmap.index_map_bs)


def _empty_matrix(left: fem.FunctionSpace, right: fem.FunctionSpace) -> PETSc.Mat:
    """A matrix without a pattern: PETSc collects the entries in a hash table until the first assembly."""
    A = PETSc.Mat().create(left.mesh.comm)
    A.setSizes((_sizes(left), _sizes(right)))
    A.setType(PETSc.Mat.Type.AIJ)
    A.setBlockSizes(left.dofmap.index_map_bs, right.dofmap.index_map_bs)
    A.setUp()
    maps = [_local_to_global(left), _local_to_global(right)]
    A.setLGMap(*maps)
    return A


def _local_to_global(V: fem.FunctionSpace) -> PETSc.LGMap:
    index_map = V.dofmap.index_map
    blocks = index_map.local_to_global(np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32))
    return PETSc.LGMap().create(blocks.astype(np.int32), bsize=V.dofmap.index_map_bs, comm=V.mesh.comm)


def _matrix_with_pattern(V: fem.FunctionSpace, *patterns: tuple[Index, Index, Array]) -> PETSc.Mat:
    """A matrix on V whose pattern is the union of some in compressed rows (of this rank, global columns), entries zero."""
    from scipy.sparse import csr_array

    shape = (_sizes(V)[0], _sizes(V)[1])
    union = sum(csr_array((np.ones(len(j)), j, i), shape=shape) for i, j, _ in patterns)
    union.sort_indices()
    A = PETSc.Mat().create(V.mesh.comm)
    A.setSizes((_sizes(V), _sizes(V)))
    A.setType(PETSc.Mat.Type.AIJ)
    A.setBlockSize(V.dofmap.index_map_bs)
    A.setPreallocationCSR((union.indptr.astype(np.int32), union.indices.astype(np.int32), np.zeros(union.nnz)))
    A.setLGMap(_local_to_global(V), _local_to_global(V))
    return A


def _insert(A: PETSc.Mat, rows: Index, columns: Index, values: Array, factor: float = 1.0) -> None:
    """Add `factor` × element matrices (m, rows, row_bs, columns, column_bs) at global blocks (m, ·), (m, ·)."""
    m, k, row_bs, l, column_bs = values.shape
    values = factor * values.reshape(m, k * row_bs, l * column_bs)
    if row_bs == column_bs and row_bs > 1:
        A.setValuesBlockedRCV(rows.astype(np.int32), columns.astype(np.int32), values, _ADD)
        return
    i = (rows[:, :, None] * row_bs + np.arange(row_bs)).reshape(m, k * row_bs)
    j = (columns[:, :, None] * column_bs + np.arange(column_bs)).reshape(m, l * column_bs)
    A.setValuesRCV(i.astype(np.int32), j.astype(np.int32), values, _ADD)


def _insert_vector(b: PETSc.Vec, blocks: Index, values: Array, factor: float = 1.0) -> None:
    """Add `factor` × element vectors (m, nodes, components) at global blocks (m, nodes)."""
    m = values.shape[2]
    index = (blocks[:, :, None] * m + np.arange(m)).astype(np.int32)
    b.setValues(index.ravel(), factor * values.ravel(), addv=_ADD)
