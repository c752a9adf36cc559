"""The nodes that contact acts on, their neighbours and all multipliers: a saddle point of a surface's size, solved exactly.

With 𝐉 = [[A, B], [C, D]] the patch P holds the displacements of those nodes, and its system is [[A_PP, B_P], [C_P, D]]. B and
C are zero elsewhere, so that its solution leaves the residual zero in P and in the gaps, and changes it in the ring around P
alone. Multigrid takes it from there: Schwarz' alternating method with two subspaces, that of contact and that of the bodies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.petsc_blocks import without_zeros
from dolfinx_mortar_al.problem import ContactProblem

__all__ = ["ContactPatch", "patch_defaults"]

Index = NDArray[np.int32]


def patch_defaults(problem: ContactProblem) -> dict[str, str | float]:
    """PETSc options of the factors. Where all unknowns come in vectors MUMPS looks for fill among these (ICNTL(15)): its
    analysis, which each state of contact needs anew and which more ranks do not share, takes two thirds of the time."""
    options: dict[str, str | float] = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    if all(pair.multiplier.components == problem.gdim for pair in problem.pairs):
        options["mat_mumps_icntl_15"] = -problem.gdim
    return options


class ContactPatch:
    """The factors of the patch's system, set up anew for each state of contact.

    Args:
        problem: whose Jacobian is solved with; it has pairs.
        prefix: of PETSc's options of the factors.
    """

    def __init__(self, problem: ContactProblem, prefix: str) -> None:
        self._problem = problem
        self._factors = PETSc.KSP().create(problem.comm)
        self._factors.setOptionsPrefix(prefix)
        self._factors.setErrorIfNotConverged(False)
        self._marks = problem.bodies.layout.vector()

    def renew(self, A: PETSc.Mat) -> None:
        """Bring the patch up to date with the problem's couplings and the block A of displacements, of which rows near
        contact are asked for alone (collective)."""
        blocks, n = self._problem.blocks, len(self._problem.pairs)
        B = [without_zeros(block) for block in blocks[0][1:]]  # patterns have room for facets that points may come to
        C = [without_zeros(row[0]) for row in blocks[1:]]
        neighbours = self._problem.bodies.with_neighbours
        patch = neighbours(self._acted_on(B, C))
        ring = neighbours(patch) & ~patch
        self._patch, self._ring = (np.flatnonzero(np.repeat(nodes, self._problem.gdim)) for nodes in (patch, ring))
        P, R = (self._set(A.getOwnershipRange()[0] + part) for part in (self._patch, self._ring))
        λ = [self._range(*block.getOwnershipRange()) for block in C]
        whole: list[list[PETSc.Mat]] = [[None] * (n + 1) for _ in range(n + 1)]
        whole[0][0] = without_zeros(A.createSubMatrix(P, P))
        for k in range(n):
            whole[0][k + 1] = B[k].createSubMatrix(P, λ[k])
            whole[k + 1][0] = C[k].createSubMatrix(λ[k], P)
            whole[k + 1][k + 1] = without_zeros(blocks[k + 1][k + 1])
        nest = PETSc.Mat().createNest(whole, comm=self._problem.comm)
        nest.assemble()
        self._matrix = nest.convert(PETSc.Mat.Type.AIJ, PETSc.Mat())
        self._to_ring = without_zeros(A.createSubMatrix(R, P))
        self._motion, self._pull = self._to_ring.createVecs()
        self._factors.reset()  # another pattern, as points open and close
        self._factors.setFromOptions()
        self._factors.setOperators(self._matrix)
        self._x, self._b = self._matrix.createVecs()

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, left: PETSc.Vec) -> None:
        """x ← the patch's solution for b, zero in displacements elsewhere; left ← what that leaves of b in the forces."""
        (bu, *bs), (xu, *xs), n = b.getNestSubVecs(), x.getNestSubVecs(), len(self._patch)
        self._b.array[:] = np.concatenate([bu.array_r[self._patch], *[part.array_r for part in bs]])
        self._factors.solve(self._b, self._x)
        xu.set(0.0)
        xu.array[self._patch] = self._motion.array[:] = self._x.array_r[:n]
        for part in xs:
            part.array[:] = self._x.array_r[n : n + part.getLocalSize()]
            n += part.getLocalSize()
        bu.copy(left)
        self._to_ring.mult(self._motion, self._pull)
        forces = left.array
        forces[self._patch] = 0.0
        forces[self._ring] -= self._pull.array_r

    # ---------------------------------------------------------------- which nodes

    def _acted_on(self, B: list[PETSc.Mat], C: list[PETSc.Mat]) -> NDArray[np.bool_]:
        """(owned nodes,) that multipliers act on or gaps depend on (collective)."""
        unknowns = [_full_rows(block) for block in B] + [block.getValuesCSR()[1] for block in C]
        found = np.unique(np.concatenate(unknowns)).astype(np.int32)
        self._marks.set(0.0)
        self._marks.setValues(found, np.ones(len(found)), addv=PETSc.InsertMode.ADD)
        self._marks.assemble()
        return np.asarray(self._marks.array_r.reshape(-1, self._problem.gdim).any(axis=1))

    def _set(self, unknowns: NDArray[np.integer]) -> PETSc.IS:
        return PETSc.IS().createGeneral(unknowns.astype(np.int32), comm=self._problem.comm)

    def _range(self, first: int, end: int) -> PETSc.IS:
        return PETSc.IS().createStride(end - first, first, 1, comm=self._problem.comm)


def _full_rows(A: PETSc.Mat) -> Index:
    """(rows,) global numbers of the owned rows that have entries."""
    indptr = A.getValuesCSR()[0]
    return np.asarray(A.getOwnershipRange()[0] + np.flatnonzero(np.diff(indptr)), dtype=np.int32)
