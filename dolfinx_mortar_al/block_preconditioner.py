"""Preconditioners for [U, Λ]: factors of a surface's size first, then what knows the bodies.

The patch of nodes that contact acts on, with all multipliers, is solved exactly (`contact_patch`). What it leaves of the
forces goes through one cycle of multigrid (`multigrid`) for the displacements' block, which holds the bodies' stiffness and,
of closed points, contact's augmentation ε 𝐁ᵀ𝐁; or through factors of the whole Jacobian with another state of contact.
"""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

from dolfinx_mortar_al.contact_patch import ContactPatch
from dolfinx_mortar_al.multigrid import Multigrid
from dolfinx_mortar_al.problem import ContactProblem

__all__ = ["SURFACE", "BlockPreconditioner", "PatchedFactors"]

SURFACE = "surface_"  # prefix of the patch's options


class BlockPreconditioner:
    """PETSc's interface of a preconditioner (type ``python``), set up with the problem's matrix whenever that has changed.

    Args:
        problem: whose Jacobian is solved with.
        prefix: of the parts' options.

    Attributes:
        idle: set to leave everything as it is, while another solver is at work.
        stale: set to bring all levels of multigrid up to date; otherwise its coarse levels serve on, and the finest one alone
            follows the matrix.
    """

    def __init__(self, problem: ContactProblem, prefix: str) -> None:
        self.problem, self.idle, self.stale = problem, False, True
        self._bulk = Multigrid(problem, prefix)
        self._patch = ContactPatch(problem, prefix + SURFACE) if problem.pairs else None
        self._left, self._u = problem.bodies.layout.vector(), problem.bodies.layout.vector()

    def setUp(self, pc: PETSc.PC) -> None:
        """Bring all parts up to date with the problem's matrix."""
        p = self.problem
        if self.idle:
            return
        if self.stale:
            self._bulk.renew()
        else:
            self._bulk.follow()
        self.stale = False
        self.renew_contact(p.blocks[0][0])

    def renew_contact(self, A: PETSc.Mat) -> None:
        """Bring contact's patch up to date with the problem's matrix and this block of displacements, and leave the bodies'
        multigrid as it is."""
        if self._patch is not None:
            self._patch.renew(A)

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x ← the approximate inverse times b."""
        if self._patch is None:
            self._bulk.solve(b.getNestSubVecs()[0], x.getNestSubVecs()[0])
        else:
            self._patch.solve(b, x, self._left)
            self._bulk.solve(self._left, self._u)
            x.getNestSubVecs()[0].axpy(1.0, self._u)
        x.assemble()


class PatchedFactors:
    """Nearly the inverse of a Jacobian, from factors of one whose bulk is the same and whose contact is another.

    Args:
        problem: whose Jacobian it is; it has pairs.
        prefix: of the patch's options.
        factors: x ← the inverse of that other Jacobian times b.
    """

    def __init__(self, problem: ContactProblem, prefix: str, factors: Callable[[PETSc.Vec, PETSc.Vec], None]) -> None:
        self._patch, self._factors = ContactPatch(problem, prefix + SURFACE), factors
        self._left, self._more = problem.residual.duplicate(), problem.x.duplicate()
        self._left.set(0.0)

    def renew_contact(self, A: PETSc.Mat) -> None:
        """Bring contact's patch up to date with the problem's couplings and this block of displacements (collective)."""
        self._patch.renew(A)

    def apply(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x ← nearly the inverse times b."""
        self._patch.solve(b, x, self._left.getNestSubVecs()[0])
        self._factors(self._left, self._more)
        x.axpy(1.0, self._more)
