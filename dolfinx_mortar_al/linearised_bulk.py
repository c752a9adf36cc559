"""A Jacobian whose bulk is that of one state and whose contact is that of another, without a copy of the bulk's matrix."""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_mortar_al.petsc_blocks import without_zeros
from dolfinx_mortar_al.problem import ContactProblem

__all__ = ["LinearisedBulk"]

_DIFFERENT = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN


class LinearisedBulk:
    """The bulk's derivative K at the state where the problem's Jacobian was last assembled.

    That Jacobian's displacement block is A = K + C₀ with contact's share C₀, in rows of the surfaces alone. With contact's
    share C of another state the block is A − C₀ + C: three products, and nothing as large as A is touched, nor what has been
    made from A.

    Attributes:
        pattern: of contact in the Jacobian made last, None before.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self._problem, self._A = problem, problem.blocks[0][0]
        self._less = without_zeros(problem.contact_share)  # −C₀
        self._less.scale(-1.0)
        self.pattern: int | None = None

    def renew(self) -> PETSc.Mat:
        """The Jacobian with contact's share at the state last evaluated (collective)."""
        p = self._problem
        PETSc.garbage_cleanup(p.comm)  # on several ranks what Python has let go of stays until all ask
        p.assemble_contact()
        A = PETSc.Mat().createPython((p.bodies.layout.sizes, p.bodies.layout.sizes), self, comm=p.comm)
        A.setUp()
        whole = PETSc.Mat().createNest([[A, *p.blocks[0][1:]], *p.blocks[1:]], comm=p.comm)
        whole.assemble()
        self.pattern = p.contact_pattern()
        return whole

    def forces(self, u: PETSc.Vec, f: PETSc.Vec) -> None:
        """f ← K u."""
        self._A.mult(u, f)
        self._less.multAdd(u, f, f)
        if (ties := self._problem.ties) is not None:
            f.array[:] += ties.pull(u.array_r)

    # ---------------------------------------------------------------- PETSc's interface

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y ← (A − C₀ + C) x."""
        self.forces(x, y)
        self._problem.contact_share.multAdd(x, y, y)

    def createSubMatrix(self, mat: PETSc.Mat, rows: PETSc.IS, columns: PETSc.IS, out: PETSc.Mat | None) -> PETSc.Mat:
        """Rows and columns of A − C₀ + C."""
        part = self._A.createSubMatrix(rows, columns)
        for other in (self._less, self._problem.contact_share):
            part.axpy(1.0, other.createSubMatrix(rows, columns), structure=_DIFFERENT)
        return part
