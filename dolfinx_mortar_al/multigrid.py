"""One cycle of algebraic multigrid for the bodies' displacements, whose coarse spaces outlive the matrix.

PETSc's GAMG chooses aggregates and smooths interpolation with the bodies' stiffness alone: contact's share would make
aggregates with nodes of both surfaces, which have no coarse motion for their sliding. Rigid motions of the current positions
are what must not be lost: all bodies' together say the same of an aggregate, which lies in one of them, as each body's own
would. With another matrix only the Galerkin products are made anew. Below displacements of order 2 there are those of order 1
on the same mesh first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.p_multigrid import FirstOrder
from dolfinx_mortar_al.petsc_blocks import row_by_row
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import any_over

__all__ = ["MULTIGRID_DEFAULTS", "Multigrid"]

_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
MOVED = 0.1  # of its diameter that a piece moves or turns by before coarse spaces are chosen anew

MULTIGRID_DEFAULTS: dict[str, str | float] = {
    "bulk_ksp_type": "preonly",
    "bulk_pc_type": "mg",
    "bulk_mg_coarse_ksp_type": "preonly",
    "bulk_mg_coarse_pc_type": "redundant",
    "spaces_pc_gamg_threshold": 0.0,
    "spaces_pc_gamg_aggressive_coarsening": 1,
}


class Multigrid:
    """An approximate inverse of the displacements' block A, whose coarse levels are those of the last :meth:`renew`; the
    finest one follows A.

    Args:
        problem: whose bodies it is for.
        prefix: of PETSc's options, which are ``prefix + "bulk_"`` of the cycle or of what is used in its place, and
            ``prefix + "spaces_"`` of GAMG, which chooses the coarse spaces.
    """

    def __init__(self, problem: ContactProblem, prefix: str) -> None:
        self._problem, self._prefix = problem, prefix
        order_two = any(body.space.element.basix_element.degree > 1 for body in problem.bodies.bodies)
        self._first = FirstOrder(problem.bodies) if order_two else None
        self._interpolations: list[PETSc.Mat] = []  # from the coarsest level up
        self._chosen_at: NDArray[np.float64] | None = None  # displacements (owned dofs,)

    def renew(self) -> None:
        """Bring all levels up to date with the problem's matrix (collective)."""
        A = self._problem.blocks[0][0]
        self._is_multigrid = PETSc.Options(self._prefix + "bulk_").getString("pc_type", "mg") == "mg"
        if self._is_multigrid:
            if self._outdated():
                self._choose(A)
            self._coarse = self._coarse_operators(A)
        self._create(A)

    def follow(self) -> None:
        """Take the problem's matrix for the finest level, where its pattern has grown; the coarse ones stay (collective)."""
        A = self._problem.blocks[0][0]
        if A.handle != self._of.handle:
            self._create(A)

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x ← the approximate inverse times b."""
        self._ksp.solve(b, x)

    def _coarse_operators(self, A: PETSc.Mat) -> list[PETSc.Mat]:
        """Galerkin's, from the coarsest level up."""
        operators: list[PETSc.Mat] = []
        for P in reversed(self._interpolations):
            A = row_by_row(A.ptap(P).copy())  # a product would keep the matrix of the finest level alive
            operators.insert(0, A)
        return operators

    def _create(self, A: PETSc.Mat) -> None:
        """The solver with A and the coarse operators."""
        self._of = A
        self._ksp = PETSc.KSP().create(self._problem.comm)
        self._ksp.setOptionsPrefix(self._prefix + "bulk_")
        self._ksp.setErrorIfNotConverged(False)
        self._ksp.setOperators(A)
        pc = self._ksp.getPC()
        if self._is_multigrid:
            levels = len(self._interpolations) + 1
            pc.setType("mg")
            pc.setMGLevels(levels)
            for k, (P, coarse) in enumerate(zip(self._interpolations, self._coarse, strict=True), start=1):
                pc.setMGInterpolation(k, P)
                pc.getMGSmoother(k - 1).setOperators(coarse)
                finest_of_two = self._first is not None and k == levels - 1
                # the nodes' blocks are regular where no coarse space has been
                pc.getMGSmoother(k).getPC().setType("pbjacobi" if finest_of_two else "jacobi")
        else:
            _say_rigid_motions(A, self._positions())
        self._ksp.setFromOptions()
        self._ksp.setUp()
        pc.setReusePreconditioner(True)

    # ---------------------------------------------------------------- coarse spaces

    def _outdated(self) -> bool:
        """Whether rotations of some piece are others than those that the coarse spaces have (collective)."""
        bodies, moved = self._problem.bodies, False
        if self._chosen_at is not None:
            motion = np.linalg.norm((bodies.get() - self._chosen_at).reshape(-1, bodies.gdim), axis=1)
            moved = bool((motion > MOVED * bodies.diameters()[bodies.piece_of_dof[:: bodies.gdim]]).any())
        return any_over(bodies.comm, self._chosen_at is None or moved)

    def _choose(self, A: PETSc.Mat) -> None:
        """Choose the coarse spaces from A without contact's share."""
        p = self._problem
        _say_rigid_motions(A, self._positions())
        if p.pairs:
            A.axpy(-1.0, p.contact_share, structure=_SUBSET)
        K, above = A, []
        if self._first is not None:
            above = [self._first.interpolation]
            K = A.ptap(self._first.interpolation)
            _say_rigid_motions(K, self._first.positions())
        gamg = PETSc.PC().create(p.comm)
        gamg.setOptionsPrefix(self._prefix + "spaces_")
        gamg.setType("gamg")
        gamg.setOperators(K)
        gamg.setFromOptions()
        gamg.setUp()
        self._interpolations = [gamg.getMGInterpolation(k) for k in range(1, gamg.getMGLevels())] + above
        gamg.destroy()
        if p.pairs:
            A.axpy(1.0, p.contact_share, structure=_SUBSET)
        self._chosen_at = p.bodies.get()

    def _positions(self) -> PETSc.Vec:
        """Current positions of the bodies' nodes (m)."""
        bodies, x = self._problem.bodies, self._problem.bodies.layout.vector()
        x.array[:] = bodies.owned_positions().ravel() + bodies.get()
        return x


def _say_rigid_motions(A: PETSc.Mat, positions: PETSc.Vec) -> None:
    """Tell multigrid of the rigid motions, which next to nothing resists but the conditions."""
    A.setNearNullSpace(PETSc.NullSpace().createRigidBody(positions))
