"""The linear systems of Newton's method: a direct solver while it is the quicker one, an iterative one for larger problems.

Direct: MUMPS on the matrix of blocks. Iterative: FGMRES with the preconditioner of `block_preconditioner`; where it fails
MUMPS takes over for the rest of the Newton solve, if its factors fit into memory. docs/scaling.md has the measurements that
the choice is made by.

All options are PETSc's, under the solver's prefix (default ``contact_``), but one that makes the choice:
``-contact_linear_solver direct`` or ``iterative``.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.block_preconditioner import SURFACE, BlockPreconditioner, PatchedFactors
from dolfinx_mortar_al.contact_patch import patch_defaults
from dolfinx_mortar_al.multigrid import MULTIGRID_DEFAULTS
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import min_over
from dolfinx_mortar_al.solver_options import Option, SolverOptions

__all__ = ["LinearSolver"]

ITERATIVE_ABOVE = 40_000  # displacement unknowns of bodies in space: where FGMRES takes less time than MUMPS
RTOL = 1e-4  # of FGMRES: Newton takes no more iterations than with factors (docs/scaling.md)
MOST = 200  # iterations of FGMRES before it counts as failed, good states take up to 30
RESTART = 60
PATCHED_ABOVE = 3_000  # displacement unknowns: on smaller meshes contact's patch is nearly the whole matrix
WORKSPACE, TOO_LITTLE_WORKSPACE = 100, (-8, -9)  # % that MUMPS gets beside its estimate; its codes for "not enough"
TOO_LARGE = (-13, -19)  # MUMPS' codes where memory does not suffice
SHARE = 0.8  # of the memory that is free, which factors may take
EXTERNAL = 76  # PETSc's error code when MUMPS gives up on a singular matrix

log = logging.getLogger(__name__)
_Reason = PETSc.KSP.ConvergedReason


class LinearSolver:
    """What solves a problem's linear systems, and how.

    Args:
        problem: whose Jacobian is solved with.
        prefix: of the PETSc options.

    Attributes:
        iterative: whether FGMRES does it.
        options: PETSc's; a context of all solves.
        solves, iterations: of FGMRES so far.
        failures: times that MUMPS had to take over.
    """

    def __init__(self, problem: ContactProblem, prefix: str) -> None:
        self.problem, self._prefix, self.options = problem, prefix, SolverOptions(prefix)
        self.iterative = problem.spare_pattern = self._choose()
        self._workspace = WORKSPACE
        self.iterations = self.solves = self.failures = 0
        self._patched: PatchedFactors | None = None
        self.forget()

    def _choose(self) -> bool:
        """Whether to iterate: as the options say, or by the number of unknowns that fill makes dear.

        Raises:
            ValueError: on every rank, if the option is none of the choices.
        """
        options = PETSc.Options(self._prefix)
        asked = options.getString("linear_solver", "auto")
        if asked not in ("auto", "direct", "iterative"):
            raise ValueError(f"-{self._prefix}linear_solver {asked}: must be direct, iterative or auto, the default")
        if asked != "auto":
            return asked == "iterative"
        solids = [body for body in self.problem.bodies.bodies if body.mesh.topology.dim == 3]
        spread = [body.space.dofmap for body in solids]
        unknowns = sum(dofmap.index_map.size_global * dofmap.index_map_bs for dofmap in spread)
        return unknowns > ITERATIVE_ABOVE and not options.hasName("pc_type")

    # ---------------------------------------------------------------- options

    def configure(self, ksp: PETSc.KSP) -> None:
        """Prepare SNES' linear solver; options are read after."""
        self._ksp = ksp
        if self.iterative:
            self._configure_iterative(ksp)
        else:
            _factorise(ksp)
            self.options.default("", self._mumps_defaults())

    def _configure_iterative(self, ksp: PETSc.KSP) -> None:
        self.options.default("", MULTIGRID_DEFAULTS)
        self.options.default(SURFACE, patch_defaults(self.problem))
        self._blocks = BlockPreconditioner(self.problem, self._prefix)
        ksp.setType("fgmres")
        ksp.setGMRESRestart(RESTART)
        ksp.setTolerances(rtol=RTOL, max_it=MOST)
        ksp.getPC().setType("python")
        ksp.getPC().setPythonContext(self._blocks)
        ksp.setPostSolve(self._after)
        self._direct: PETSc.KSP | None = None
        self._failure: str | None = None

    def _mumps_defaults(self) -> dict[str, Option]:
        """The blocks are scaled already (8: 0); minimum fill is the quickest analysis of plane problems (7: 2). 33: 1 gives
        the determinant, whose sign tells stable equilibria from unstable ones. 14: spare workspace, in %."""
        said: dict[str, Option] = {"mat_mumps_icntl_8": 0, "mat_mumps_icntl_33": 1}
        said["mat_mumps_icntl_14"] = self._workspace
        return said | ({"mat_mumps_icntl_7": 2} if self.problem.gdim == 2 else {})

    def unsuitable(self) -> str:
        """What the options ask for that PETSc cannot do."""
        pc = self._ksp.getPC()
        asked = f"ksp_type {self._ksp.getType()}, pc_type {pc.getType()}"
        if pc.getType() == "lu":
            asked += f", pc_factor_mat_solver_type {pc.getFactorSolverType()}"
        return (
            f"options of the prefix {self._prefix}: {asked} is not known, or does not take a matrix of blocks (MATNEST); "
            "MUMPS does, with or without a Krylov method around it"
        )

    def say_unread(self) -> None:
        """Warn of options of the user that nothing reads, once the first solve is done. What takes over where an iterative
        solver fails, and contact's patch, are needed by some solves only."""
        self.options.say_unread(("direct_", SURFACE), self.problem.comm.rank)

    # ---------------------------------------------------------------- solves

    def begin(self) -> None:
        """A new Newton solve: multigrid follows the matrix, and FGMRES is tried again, where it had failed."""
        if self.iterative:
            self._blocks.stale = True
        if self.iterative and self._failure is not None:
            self._failure, self._blocks.idle = None, False
            self._ksp.setTolerances(max_it=MOST)

    def _after(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """After FGMRES: where it has failed MUMPS takes over, for the rest of the Newton solve."""
        self.iterations, self.solves = self.iterations + ksp.getIterationNumber(), self.solves + 1
        if ksp.getConvergedReason() >= 0:
            return
        if self._failure is None:
            self.failures += 1
            self._failure = (
                f"FGMRES failed (PETSc's reason {ksp.getConvergedReason()}, {ksp.getIterationNumber()} iterations)"
            )
            if self.problem.comm.rank == 0:
                log.warning("%s: MUMPS takes over for the rest of this Newton solve", self._failure)
            self._blocks.idle = True
            ksp.setTolerances(max_it=0)
        direct = self._factorised()
        direct.setOperators(*ksp.getOperators())
        try:
            direct.solve(b, x)
        except PETSc.Error as error:
            if error.ierr != EXTERNAL:
                raise
            return
        if direct.getConvergedReason() > 0:
            ksp.setConvergedReason(_Reason.CONVERGED_ITS)

    def _factorised(self) -> PETSc.KSP:
        """MUMPS, which may take as much memory as is free."""
        if self._direct is None:
            self.options.default("direct_", self._mumps_defaults())
            self.options.default("direct_", {"mat_mumps_icntl_23": int(SHARE * _free_memory(self.problem.comm))})
            self._direct = PETSc.KSP().create(self.problem.comm)
            self._direct.setOptionsPrefix(self._prefix + "direct_")
            _factorise(self._direct)
            self._direct.setFromOptions()
        return self._direct

    def excuse(self) -> str | None:
        """Why a linear solve failed, if it was not for a singular matrix; PETSc's object is of no use after it, and a new one
        has more workspace if that was what was missing."""
        ksp, begun = (self._direct, f"{self._failure}; ") if self.iterative else (self._ksp, "")
        if ksp is None or ksp.getPC().getType() != "lu" or ksp.getPC().getFactorSolverType() != "mumps":
            return f"{begun}the linear solve failed" if self.iterative else None
        said = ksp.getPC().getFactorMatrix().getMumpsInfog(1)
        if said in TOO_LITTLE_WORKSPACE:
            self._workspace *= 4
            return f"{begun}MUMPS ran out of workspace; it has {self._workspace} % more from now on"
        if said in TOO_LARGE:
            return f"{begun}MUMPS' factors do not fit into the memory that is free"
        return None

    def sign(self) -> float | None:
        """Of the Jacobian's determinant, as MUMPS has it: positive at a stable equilibrium. None where it is not known."""
        pc = self._ksp.getPC()
        if pc.getType() != "lu" or pc.getFactorSolverType() != "mumps":
            return None
        return float(np.sign(pc.getFactorMatrix().getMumpsRinfog(12)))

    # ---------------------------------------------------------------- the same matrix with another state of contact

    def apply(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x ← the last Jacobian's inverse times b, or that of the preconditioner; once :meth:`renew_contact` has been called
        nearly the inverse of its matrix."""
        if self.iterative and self._failure is None:
            self._blocks.apply(self._ksp.getPC(), b, x)
        elif self._is_patched and self._patched is not None:
            self._patched.apply(b, x)
        else:
            self._apply_factors(b, x)

    def _apply_factors(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        if not self.iterative:
            pc = self._ksp.getPC()
            if pc.getType() == "lu":  # as they are, whatever the matrix has become
                pc.getFactorMatrix().solve(b, x)
            else:
                pc.apply(b, x)
            self.add_ties(x)
        else:
            self._factorised().getPC().getFactorMatrix().solve(b, x)

    def forget(self) -> None:
        """The Jacobian is another one: what was made from the last goes."""
        self._ties: list[PETSc.Vec] | None = None
        self._is_patched = False

    def response(self, forces: NDArray[np.float64]) -> NDArray[np.float64]:
        """(owned dofs,) displacements that nodal forces (owned dofs,) lead to, with the Jacobian solved with last
        (collective)."""
        right, y = self.problem.x.duplicate(), self.problem.x.duplicate()
        right.set(0.0)
        right.getNestSubVecs()[0].array[:] = forces
        right.assemble()
        self._ksp.solve(right, y)
        return np.asarray(y.getNestSubVecs()[0].array_r.copy())

    def add_ties(self, y: PETSc.Vec) -> None:
        """y = 𝐀⁻¹𝐫 with the sparse Jacobian 𝐀 becomes (𝐀 + ∑ κ 𝐦⊗𝐦)⁻¹𝐫 with the problem's ties: Sherman, Morrison
        and Woodbury's formula (collective)."""
        ties = self.problem.ties
        if ties is None or not ties.acts or ties.are_loose:
            return
        if self._ties is None:
            self._ties = []
            for m in ties.motions:
                right, z = y.duplicate(), y.duplicate()
                right.set(0.0)
                right.getNestSubVecs()[0].array[:] = m
                right.assemble()
                self._ksp.solve(right, z)
                self._ties.append(z)
            u = [z.getNestSubVecs()[0].array_r for z in self._ties]
            flexibility = np.stack([ties.times(v) for v in u], axis=1)
            self._inner = np.linalg.inv(np.eye(len(ties.motions)) / ties.softness + flexibility)
        amount = self._inner @ ties.times(y.getNestSubVecs()[0].array_r)
        for a, z in zip(amount, self._ties, strict=True):
            y.axpy(-float(a), z)

    def renew_contact(self, matrix: PETSc.Mat) -> None:
        """Contact's share has changed, which makes the Jacobian this `matrix`: bring up to date what costs little."""
        if self.iterative and self._failure is None:
            self._blocks.renew_contact(matrix.getNestSubMatrix(0, 0))
        elif self.is_solid and self.problem.bodies.layout.sizes[1] > PATCHED_ABOVE:
            if self._patched is None:
                self.options.default(SURFACE, patch_defaults(self.problem))
                self._patched = PatchedFactors(self.problem, self._prefix, self._apply_factors)
            self._patched.renew_contact(matrix.getNestSubMatrix(0, 0))
            self._is_patched = True

    @property
    def is_solid(self) -> bool:
        """Whether there is a body in space, whose factors cost many solves."""
        return max(body.mesh.topology.dim for body in self.problem.bodies.bodies) == 3

    # ---------------------------------------------------------------- what it says

    def log(self) -> None:
        """Tell the log which solver it is."""
        if self.problem.comm.rank == 0:
            log.info("%d displacement unknowns, linear solver %s", self.problem.bodies.layout.sizes[1], self)

    def __str__(self) -> str:
        """In words, for log and summary."""
        pc = self._ksp.getPC()
        if self.iterative:
            said = f"iterative: {self._ksp.getType()} to {self._ksp.getTolerances()[0]:g}, multigrid in the bodies"
            return f"{said}; {self.iterations} iterations in {self.solves} solves, {self.failures} of which failed"
        by = f"{pc.getType()} by {pc.getFactorSolverType()}" if pc.getType() == "lu" else pc.getType()
        return f"direct: {by}" if self._ksp.getType() == "preonly" else f"{self._ksp.getType()} with {by}"


def _factorise(ksp: PETSc.KSP) -> None:
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")


def _free_memory(comm: MPI.Intracomm) -> float:
    """MB that each rank may take of what its machine has free, the least over the ranks (collective)."""
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        free = next(float(line.split()[1]) / 1024 for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration):  # no Linux
        free = 1e6
    least = min_over(comm, free / node.size)
    node.Free()
    return float(least)
