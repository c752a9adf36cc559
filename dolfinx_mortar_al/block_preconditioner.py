"""A preconditioner for [U, Λ] whose cost grows with the unknowns: multigrid in the bodies, factors of a surface's size.

With 𝐉 = [[A, B], [C, D]] and S = D − C diag(A)⁻¹ B it applies the inverse of [[A, B], [0, S]], A's by one cycle of algebraic
multigrid. A holds the bodies' stiffness and, of closed points, contact's augmentation ε 𝐁ᵀ𝐁; S has the multipliers' unknowns
alone and is factorised. Rigid motions of the current positions are what multigrid must not lose: all bodies' together say the
same of an aggregate, which lies in one of them, as each body's own would. Aggregates are therefore those of the bodies alone,
A without contact's share: one with nodes of both surfaces would have no coarse motion for their sliding.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfinx_mortar_al.p_multigrid import FirstOrder
from dolfinx_mortar_al.petsc_blocks import without_zeros
from dolfinx_mortar_al.problem import ContactProblem

__all__ = ["BlockPreconditioner", "block_defaults"]

_DIFFERENT, _SUBSET = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN

AMG: dict[str, str | float] = {
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.0,
    "pc_gamg_aggressive_coarsening": 1,
    "mg_levels_pc_type": "jacobi",
    "mg_coarse_pc_type": "redundant",
}


def block_defaults(order: int) -> dict[str, str | float]:
    """PETSc options of the parts for displacements of this order: multigrid on the bodies under `bulk_`, below a level of
    order 2 on those of order 1, and the surfaces' factors under `surface_`."""
    said = {f"bulk_{'mg_coarse_' if order > 1 else ''}{name}": value for name, value in AMG.items()}
    said |= {"bulk_ksp_type": "preonly", "surface_ksp_type": "preonly", "surface_pc_type": "lu"}
    said |= {"surface_pc_factor_mat_solver_type": "mumps"}
    if order > 1:
        said |= {"bulk_pc_type": "mg", "bulk_mg_levels_pc_type": "pbjacobi", "bulk_mg_levels_ksp_max_it": 2}
        said |= {"bulk_mg_levels_ksp_type": "chebyshev", "bulk_mg_coarse_ksp_type": "preonly"}
    return said


class BlockPreconditioner:
    """PETSc's interface of a preconditioner (type ``python``), set up with the problem's matrix whenever that has changed.

    Args:
        problem: whose Jacobian is solved with.
        prefix: of the parts' options, which are ``prefix + "bulk_"`` and ``prefix + "surface_"``.

    Attributes:
        surface_size: unknowns of S.
        idle: set to leave everything as it is, while another solver is at work.
        stale: set to have multigrid set up anew. While the pattern is the same its coarse levels serve on otherwise, and the
            finest one alone follows the matrix.
    """

    def __init__(self, problem: ContactProblem, prefix: str) -> None:
        self.problem, self.idle, self.stale = problem, False, False
        self._bulk, self._surface = (self._part(prefix + part) for part in ("bulk_", "surface_"))
        order_two = any(body.space.element.basix_element.degree > 1 for body in problem.bodies.bodies)
        self._first = FirstOrder(problem.bodies) if order_two else None
        self._coarse: PETSc.Mat | None = None
        self._of: PETSc.Mat | None = None  # the nest the patterns are those of
        self._u, self._Bx = problem.bodies.layout.vector(), problem.bodies.layout.vector()
        self.surface_size = sum(pair.multiplier.size for pair in problem.pairs)

    def _part(self, prefix: str) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self.problem.comm)
        ksp.setOptionsPrefix(prefix)
        ksp.setErrorIfNotConverged(False)
        return ksp

    # ---------------------------------------------------------------- PETSc's interface

    def setUp(self, pc: PETSc.PC) -> None:
        """Bring all parts up to date with the problem's matrix."""
        p = self.problem
        if self.idle:
            return
        new = self.stale or self._of is None or self._of.handle != p.matrix.handle
        self._of, self.stale = p.matrix, False
        A = p.blocks[0][0]
        if new:
            self._reset()
            if p.pairs:
                A.axpy(-1.0, p.contact_share, structure=_SUBSET)
                self._set_up_bulk(A)
                A.axpy(1.0, p.contact_share, structure=_SUBSET)
            self._set_up_bulk(A)
            self._bulk.getPC().setReusePreconditioner(True)
        self.renew_surface(A)

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x ← the approximate inverse times b."""
        blocks, (bu, *bs), (xu, *xs) = self.problem.blocks, b.getNestSubVecs(), x.getNestSubVecs()
        bu.copy(self._u)
        if bs:
            self._right.array[:] = np.concatenate([part.array_r for part in bs])
            self._surface.solve(self._right, self._left)
            start = 0
            for k, part in enumerate(xs, start=1):
                part.array[:] = self._left.array_r[start : start + part.getLocalSize()]
                start += part.getLocalSize()
                blocks[0][k].mult(part, self._Bx)
                self._u.axpy(-1.0, self._Bx)
        self._bulk.solve(self._u, xu)
        x.assemble()

    # ---------------------------------------------------------------- parts

    def _set_up_bulk(self, A: PETSc.Mat) -> None:
        """Multigrid for A, on the coarse spaces that it has, if any."""
        if self._first is None:
            _say_rigid_motions(A, self._positions())
        else:
            self._set_up_coarse(A)
        self._bulk.setOperators(A)
        self._bulk.setUp()

    def renew_surface(self, A: PETSc.Mat) -> None:
        """Bring S up to date with the problem's matrix and this block of displacements, of which the diagonal is asked for
        alone, and leave the bodies' multigrid as it is."""
        blocks, n = self.problem.blocks, len(self.problem.pairs)
        if n == 0:
            return
        scale = A.getDiagonal()
        scale.reciprocal()
        scale.scale(-1.0)
        S: list[list[PETSc.Mat]] = [[None] * n for _ in range(n)]
        C = [without_zeros(row[0]) for row in blocks[1:]]
        for j in range(n):
            B = without_zeros(blocks[0][j + 1])  # patterns have room for facets that points may come to
            B.diagonalScale(scale, None)
            for i in range(n):
                S[i][j] = C[i].matMult(B)
            S[j][j].axpy(1.0, without_zeros(blocks[j + 1][j + 1]), structure=_DIFFERENT)
        whole = PETSc.Mat().createNest(S, comm=self.problem.comm)
        whole.assemble()
        self._S = whole.convert(PETSc.Mat.Type.AIJ, PETSc.Mat())
        self._surface.reset()  # another pattern, as points open and close
        self._surface.setFromOptions()
        self._surface.setOperators(self._S)
        self._left, self._right = self._S.createVecs()

    def _reset(self) -> None:
        """Forget the multigrid of an earlier pattern."""
        self._bulk.reset()
        self._bulk.getPC().setReusePreconditioner(False)
        self._coarse = None
        if self._first is not None:
            pc = self._bulk.getPC()
            pc.setType("mg")
            pc.setMGLevels(2)
            pc.setMGInterpolation(1, self._first.interpolation)
        self._bulk.setFromOptions()

    def _set_up_coarse(self, A: PETSc.Mat) -> None:
        assert self._first is not None
        P = self._first.interpolation
        self._coarse = A.ptap(P) if self._coarse is None else A.ptap(P, result=self._coarse)
        _say_rigid_motions(self._coarse, self._first.positions())
        self._bulk.getPC().getMGCoarseSolve().setOperators(self._coarse)

    def _positions(self) -> PETSc.Vec:
        """Current positions of the bodies' nodes (m)."""
        bodies, x = self.problem.bodies, self.problem.bodies.layout.vector()
        x.array[:] = bodies.owned_positions().ravel() + bodies.get()
        return x


def _say_rigid_motions(A: PETSc.Mat, positions: PETSc.Vec) -> None:
    """Tell multigrid of the rigid motions, which next to nothing resists but the conditions."""
    A.setNearNullSpace(PETSc.NullSpace().createRigidBody(positions))
