"""The bodies' displacements as one block of unknowns, and their bulk forms.

A body is a mesh with a displacement: bulk cells, or a membrane of cells of one dimension less. Several bodies of one mesh
share a displacement; a membrane and a bulk body have one each. Their nodes are numbered rank by rank and, within a rank,
body by body: one vector and one matrix hold them all, and a contact pair needs not know which bodies it joins.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, la, mesh
from dolfinx.fem import petsc as dolfinx_petsc
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.compiling import compiled
from dolfinx_mortar_al.compression import Sheet
from dolfinx_mortar_al.foreseen_pressure import ForeseenPressure
from dolfinx_mortar_al.materials import cell_measure, deformation_gradient
from dolfinx_mortar_al.membrane import area_stretch
from dolfinx_mortar_al.moduli import doubt_order, softest, yielding_share
from dolfinx_mortar_al.petsc_blocks import JointNumbering
from dolfinx_mortar_al.pieces import Piece, floating_pieces, pieces_of
from dolfinx_mortar_al.ranks import agreed, agreed_on_group
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over
from dolfinx_mortar_al.validation import check_cells, check_residual, check_space, listed

__all__ = ["Bodies", "BodyForms"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Index32 = NDArray[np.int32]

_ADD = PETSc.InsertMode.ADD
SLACK = 1e-10  # of a piece's largest stiffness, below which a displacement meets none
COLLAPSED = 1e-6  # area stretch below which a membrane counts as torn down to nothing


class BodyForms:
    """A mesh with its displacement u, bulk residual F(u; v) and Jacobian, and its Dirichlet conditions."""

    def __init__(
        self,
        F: Any,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC],
        jacobian: Any = None,
        foreseen: ForeseenPressure | None = None,
    ) -> None:
        self.u, self.space, self.mesh = u, u.function_space, u.function_space.mesh
        check_space(u)
        check_cells(self.mesh)
        check_residual(F, u)
        self.bcs = list(bcs)
        if len(set(self.mesh.comm.allgather(F.signature()))) > 1:
            raise ValueError(
                "F: not the same form on all ranks: is a material, load or number in it made on each alone?"
            )
        J = ufl.derivative(F, u) if jacobian is None else jacobian
        if not isinstance(J, ufl.Form) or len(J.arguments()) != 2:
            raise ValueError("jacobian: must be a bilinear UFL form; leave it out for the derivative of F")
        self.foreseen = foreseen if jacobian is None else None
        if self.foreseen is not None:
            J += self.foreseen.form
        self.F, self.J = (compiled(form, self.mesh, F) for form in (F, J))
        self.signature = str(F.signature())
        #: the residual's Constants, and what they were when the problem was made
        self.constants = list(F.constants())
        self.constant_values = [np.array(c.value) for c in self.constants]
        #: the residual's Functions but u
        self.fields = [c for c in F.coefficients() if isinstance(c, fem.Function) and c is not u]
        #: laws of membranes with the measures of their cells, as far as they are known
        self.sheets: list[Sheet] = []
        self._inverted = compiled(self._inversion_indicator(), self.mesh)
        #: (nodes,) the connected piece of the mesh that each node belongs to, ghosts included; how many there are
        self.piece, self.pieces = pieces_of(self.space)
        #: whether inertia holds what nothing else does
        self.has_inertia = False
        #: pieces that nothing but contact holds, as found with the start state's stiffness
        self.floating: list[Piece] = []
        self._tension: Any = None  # few problems need it
        self._residual = fem.Function(self.space)

    @property
    def owned(self) -> int:
        """Nodes that this rank owns."""
        return int(self.space.dofmap.index_map.size_local)

    def _inversion_indicator(self) -> Any:
        """∫ 1 dΩ over det 𝐅 ≤ 0, or where a membrane's area stretch vanishes; also where either is not a number."""
        dx = ufl.Measure("dx", self.mesh, metadata={"quadrature_degree": 2 * self.space.element.basix_element.degree})
        if self.mesh.topology.dim == self.mesh.geometry.dim:
            sound = ufl.gt(ufl.det(deformation_gradient(self.u)), 0.0)
        else:
            sound = ufl.gt(area_stretch(self.u), COLLAPSED)
        return ufl.conditional(sound, 0.0, 1.0) * dx

    def inverted_volume(self) -> float:
        """This rank's reference volume (m³, m² in the plane) of inverted cells."""
        return float(fem.assemble_scalar(self._inverted))

    def residual(self) -> Array:
        """(owned dofs,) the bulk's residual (N), before Dirichlet rows are set; lifted where u misses its conditions."""
        b = self._residual.x.petsc_vec
        with b.localForm() as local:
            local.set(0.0)
        dolfinx_petsc.assemble_vector(b, self.F)
        if self._unmet_bcs():
            self._foresee()
            dolfinx_petsc.apply_lifting(b, [self.J], [self.bcs], [self.u.x.petsc_vec], -1.0)
        b.ghostUpdate(addv=_ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.asarray(b.array_r)

    def positions(self) -> Array:
        """(owned nodes, gdim) where the nodes are now (m)."""
        X = self.space.tabulate_dof_coordinates()[: self.owned, : self.mesh.geometry.dim]
        return np.asarray(X + self.u.x.array[: X.size].reshape(X.shape))

    def volumes(self) -> Array:
        """(owned nodes,) ∫ φ dΩ of their shape functions φ: the reference volume that is theirs (m³, m² in the plane)."""
        v = ufl.TestFunction(self.space)
        b = fem.Function(self.space)
        fem.assemble_vector(b.x.array, compiled(v[0] * cell_measure(self.u), self.mesh))
        b.x.scatter_reverse(la.InsertMode.add)
        return np.asarray(b.x.array[: self.owned * self.mesh.geometry.dim : self.mesh.geometry.dim])

    def last_residual(self) -> Array:
        """(owned dofs,) what :meth:`residual` returned last (N)."""
        return np.asarray(self._residual.x.petsc_vec.array_r)

    def set_bc_rows(self, b: Array) -> None:
        """Put u − ū on the prescribed rows of `b` (owned dofs,), which the row's unit diagonal then drives to zero."""
        for bc in self.bcs:
            # b ← −(ū − u), as dolfinx' own set_bc with α = −1
            bc.set(b, self.u.x.array[: len(b)], -1.0)

    def _unmet_bcs(self) -> bool:
        gap = np.zeros(self.owned * self.space.dofmap.index_map_bs)
        self.set_bc_rows(gap)
        return bool(max_over(self.mesh.comm, float(np.abs(gap).max(initial=0.0))) > 0)

    def prescribed(self) -> fem.Function:
        """1 at the components that a Dirichlet condition prescribes, 0 elsewhere; ghosts agree."""
        flag = fem.Function(self.space)
        for bc in self.bcs:
            dofs, owned = bc.dof_indices()
            flag.x.array[dofs[:owned]] = 1.0
        flag.x.scatter_forward()
        return flag

    def begin(self) -> None:
        """The displacement is that of a converged state, from which solves begin."""
        if self.foreseen is not None:
            self.foreseen.begin(self.u.x.array)

    def _foresee(self) -> None:
        if self.foreseen is not None:
            self.foreseen.look()

    def assemble_jacobian(self, A: PETSc.Mat) -> None:
        self._foresee()
        dolfinx_petsc.assemble_matrix(A, self.J, bcs=self.bcs)
        if self.foreseen is not None:
            self.foreseen.advance()

    def assemble_tension(self, A: PETSc.Mat) -> None:
        """Add ∫ ∇u : ∇v dΩ, zero on prescribed rows and columns: what a uniform tension of 1 Pa adds to the stiffness."""
        if self._tension is None:
            v, w = ufl.TestFunction(self.space), ufl.TrialFunction(self.space)
            self._tension = compiled(ufl.inner(ufl.grad(w), ufl.grad(v)) * cell_measure(self.u), self.mesh)
        dolfinx_petsc.assemble_matrix(A, self._tension, self.bcs, 0.0)

    def stiffness(self) -> PETSc.Mat:
        """The Jacobian without Dirichlet conditions, alone, in the start state."""
        self.begin()
        self._foresee()
        A = dolfinx_petsc.assemble_matrix(self.J)
        A.assemble()
        return A

    def yielding_share(self, A: PETSc.Mat) -> fem.Function:
        """That of :func:`~dolfinx_mortar_al.moduli.yielding_share`, which takes strains for those of a body that has not
        turned: of the undeformed one, where A is the stiffness of a start state that has (collective)."""
        present = self.u.x.array.copy()
        if self.has_inertia or not any_over(self.mesh.comm, bool(present.any())):
            return yielding_share(self.space, A)
        self.u.x.array[:] = 0.0
        undeformed = self.stiffness()
        self.u.x.array[:] = present
        self.begin()
        share = yielding_share(self.space, undeformed)
        undeformed.destroy()
        return share


class Bodies:
    """Several :class:`BodyForms` numbered as one, in blocks of gdim components.

    Args:
        residuals, displacements: one each per body.
        bcs: Dirichlet conditions of all bodies.
        jacobians: one per body, or None for derivatives of the residuals.
        foreseen: what else derivatives need of nearly incompressible bodies, one each or None.

    Raises:
        ValueError: on every rank: a displacement that is not Lagrange of order 1 or 2 with gdim components, a mesh of
            another dimension than gdim or gdim − 1 or of higher order than u, bodies in spaces of different dimension,
            a condition on a space of no body, as many residuals as there are not displacements, or another order of bodies on
            some ranks.
    """

    def __init__(
        self,
        residuals: Sequence[Any],
        displacements: Sequence[fem.Function],
        bcs: Sequence[fem.DirichletBC],
        jacobians: Sequence[Any] | None,
        foreseen: Sequence[ForeseenPressure | None] | None = None,
    ) -> None:
        if len(residuals) != len(displacements) or not displacements:
            raise ValueError(f"F: {len(residuals)} residuals for {len(displacements)} displacements u: pass one each")
        spaces = [u.function_space for u in displacements]
        self.gdim: int = spaces[0].mesh.geometry.dim
        if any(V.mesh.geometry.dim != self.gdim for V in spaces):
            raise ValueError(f"u: bodies in spaces of dimension {[V.mesh.geometry.dim for V in spaces]}")
        self.comm: MPI.Intracomm = spaces[0].mesh.comm
        for V in spaces[1:]:
            if MPI.Comm.Compare(V.mesh.comm, self.comm) not in (MPI.IDENT, MPI.CONGRUENT):
                raise ValueError(
                    f"u: bodies on communicators of {self.comm.size} and {V.mesh.comm.size} ranks; make all meshes on one"
                )
        agreed_on_group(self.comm, "F: the bodies' order, by when their meshes were made", _order(spaces))
        bcs = listed("bcs", bcs, fem.DirichletBC, "a Dirichlet condition")
        agreed(self.comm, "bcs: how many", len(bcs))
        own = [[bc for bc in bcs if V._cpp_object.contains(bc.function_space)] for V in spaces]
        if sum(map(len, own)) != len(bcs):
            raise ValueError("bcs: a Dirichlet condition is on a space of none of the displacements u")
        if jacobians is not None and len(jacobians) != len(spaces):
            raise ValueError(
                f"jacobian: {len(jacobians)} forms for {len(spaces)} displacements u: pass one each, or none"
            )
        forms, seen = (given or [None] * len(spaces) for given in (jacobians, foreseen))
        self.bodies = [BodyForms(*parts) for parts in zip(residuals, displacements, own, forms, seen, strict=True)]
        for u in displacements:
            u.x.scatter_forward()

        owned = [body.owned for body in self.bodies]
        self._numbering = JointNumbering(self.comm, owned, self.gdim)
        ends = self.gdim * np.cumsum([0, *owned])
        self._slices = [slice(int(first), int(end)) for first, end in pairwise(ends)]
        self.layout = self._numbering.layout
        self._maps = [self._local_to_common(k) for k in range(len(self.bodies))]
        #: connected pieces of all meshes: numbers begin here for each body, how many there are, and (owned dofs,) whose
        first = np.cumsum([0, *(body.pieces for body in self.bodies)])
        self.first_piece, self.pieces = first[:-1], int(first[-1])
        whose = [body.piece[: body.owned] + start for body, start in zip(self.bodies, first, strict=False)]
        self.piece_of_dof = np.repeat(np.concatenate(whose), self.gdim)
        self._free_axes: Array | None = None  # the conditions are those of the start
        self._marks: list[fem.Function] = []  # few problems need them

    def index(self, domain: mesh.Mesh) -> int:
        """Which body lives on a mesh.

        Raises:
            ValueError: if none does.
        """
        for k, body in enumerate(self.bodies):
            if body.mesh is domain:
                return k
        raise ValueError("a surface lives on another mesh than the displacements: pass the mesh of a body")

    # ---------------------------------------------------------------- numbering

    def common(self, k: int, blocks: Index) -> Index:
        """Common numbers of nodes of body k given by the body's own global numbers (any shape)."""
        return self._numbering.common(k, blocks)

    def nodes(self, k: int, dofs: NDArray[np.int32]) -> Index:
        """Common numbers of nodes of body k given by numbers local to this rank (any shape)."""
        own = self.bodies[k].space.dofmap.index_map.local_to_global(dofs.ravel())
        return self.common(k, own.reshape(dofs.shape))

    def _local_to_common(self, k: int) -> PETSc.LGMap:
        index_map = self.bodies[k].space.dofmap.index_map
        local = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        return PETSc.LGMap().create(self.nodes(k, local).astype(np.int32), bsize=self.gdim, comm=self.comm)

    # ---------------------------------------------------------------- vectors

    def set(self, values: Array) -> None:
        """Displacements from an array (owned dofs,), ghosts included."""
        for body, part in zip(self.bodies, self._slices, strict=True):
            body.u.x.array[: part.stop - part.start] = values[part]
            body.u.x.scatter_forward()

    def get(self) -> Array:
        """(owned dofs,) a copy of the displacements."""
        return np.concatenate([b.u.x.array[: p.stop - p.start] for b, p in zip(self.bodies, self._slices, strict=True)])

    def split(self, values: Array) -> list[Array]:
        """The parts (owned dofs,) of each body of an array of all."""
        return [values[part] for part in self._slices]

    def snapshot(self) -> dict[str, Array]:
        """The displacements, and of nearly incompressible bodies those that solves begin from (owned dofs,)."""
        starts = {
            f"start{k}": body.foreseen.last[: part.stop - part.start].copy()
            for k, (body, part) in enumerate(zip(self.bodies, self._slices, strict=True))
            if body.foreseen is not None
        }
        return {"u": self.get()} | starts

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""
        self.set(saved["u"])
        for k, body in enumerate(self.bodies):
            if body.foreseen is not None:
                body.foreseen.begin(saved[f"start{k}"])

    def begin(self) -> None:
        """The displacements are those of a converged state, from which solves begin."""
        for body in self.bodies:
            body.begin()

    def slack(self, diagonals: Sequence[fem.Function]) -> NDArray[np.bool_]:
        """(pieces,) on which some displacement that is not prescribed meets next to no stiffness (collective); see
        `stiffness`."""
        largest, found = self.stiffest(diagonals), np.zeros(self.pieces)
        for body, first, least in zip(self.bodies, self.first_piece, self.softest, strict=True):
            piece = body.piece[: len(least)] + first
            found[piece[least < SLACK * largest[piece]]] = 1.0
        return np.asarray(max_over(self.comm, found) > 0)

    def stiffest(self, diagonals: Sequence[fem.Function]) -> Array:
        """(pieces,) largest diagonal entry of the stiffness (N/m) on each piece (collective)."""
        largest = np.zeros(self.pieces)
        for body, first, diagonal in zip(self.bodies, self.first_piece, diagonals, strict=True):
            # what is no number is not compared: a pair says so, or Newton
            np.fmax.at(largest, np.repeat(body.piece + first, self.gdim), diagonal.x.array)
        return max_over(self.comm, largest)

    def centre(self, piece: int) -> Array:
        """(gdim,) mean reference position of a piece's nodes (m), collective."""
        sums = np.zeros(self.gdim + 1)
        for body, first in zip(self.bodies, self.first_piece, strict=True):
            X = body.space.tabulate_dof_coordinates()[: body.owned, : self.gdim]
            X = X[body.piece[: body.owned] + first == piece]
            sums += np.append(X.sum(axis=0), len(X))
        sums = np.asarray(sum_over(self.comm, sums))
        return np.asarray(sums[:-1] / sums[-1])

    def diameters(self) -> Array:
        """(pieces,) diagonal of each piece's bounding box (m), collective."""
        size = np.zeros((self.pieces, self.gdim))
        for side in (1.0, -1.0):
            reach = np.full((self.pieces, self.gdim), -np.inf)
            for body, first in zip(self.bodies, self.first_piece, strict=True):
                X = body.space.tabulate_dof_coordinates()[:, : self.gdim]
                np.maximum.at(reach, body.piece + first, side * X)
            size += max_over(self.comm, reach)
        return np.asarray(np.linalg.norm(size, axis=1))

    def ways(self) -> Array:
        """(pieces,) how far the farthest node of each piece is from its reference position (m), collective."""
        ways = np.zeros(self.pieces)
        moved = np.linalg.norm(self.get().reshape(-1, self.gdim), axis=1)
        np.maximum.at(ways, self.piece_of_dof[:: self.gdim], moved)
        return max_over(self.comm, ways)

    def resultants(self, values: Array) -> Array:
        """(pieces,) largest component of the sum of nodal forces (owned dofs,) on each piece over the root of its number of
        nodes, of floating pieces along the axes in which nothing is prescribed (collective): of what springs or inertia hold
        the forces on the whole are as large as theirs."""
        if self._free_axes is None:
            free = np.repeat(self.floating().astype(np.float64)[:, None], self.gdim, axis=1)
            for body, first in zip(self.bodies, self.first_piece, strict=True):
                np.minimum.at(free, body.piece + first, 1.0 - body.prescribed().x.array.reshape(-1, self.gdim))
            nodes = np.bincount(self.piece_of_dof, minlength=self.pieces) / self.gdim
            self._free_axes = -max_over(self.comm, -free) / np.sqrt(sum_over(self.comm, nodes))[:, None]
        sums = np.zeros((self.pieces, self.gdim))
        np.add.at(sums, self.piece_of_dof[:: self.gdim], values.reshape(-1, self.gdim))
        return np.asarray(np.abs(self._free_axes * sum_over(self.comm, sums)).max(axis=1))

    def floating(self) -> NDArray[np.bool_]:
        """(pieces,) which nothing but contact holds."""
        result = np.zeros(self.pieces, dtype=bool)
        for body, first in zip(self.bodies, self.first_piece, strict=True):
            result[[first + piece.number for piece in body.floating]] = True
        return result

    def spring_shares(self, diagonals: Sequence[fem.Function], touched: Sequence[NDArray[np.bool_]]) -> Array:
        """(owned dofs,) the stiffness of the softest piece that each piece may press, `touched` with it by a pair, as a share
        of its own (collective)."""
        largest = self.stiffest(diagonals)
        share = np.ones(self.pieces)
        for pieces in touched:
            softest = largest[pieces].min(initial=np.inf)
            np.minimum(share, softest / np.maximum(largest, 1e-300), out=share, where=pieces)
        return share[self.piece_of_dof]

    def prescribed(self) -> NDArray[np.bool_]:
        """(owned dofs,) components that are prescribed (collective)."""
        parts = zip(self.bodies, self._slices, strict=True)
        return np.concatenate([body.prescribed().x.array[: part.stop - part.start] > 0 for body, part in parts])

    def unmet(self) -> Array:
        """(owned dofs,) 𝐮 − 𝐮̄ (m) in the components that Dirichlet conditions prescribe, 0 elsewhere."""
        gap = np.zeros(self._slices[-1].stop)
        for body, part in zip(self.bodies, self._slices, strict=True):
            body.set_bc_rows(gap[part])
        return gap

    def way_over_size(self) -> float:
        """The longest way that prescribed components have still to move, over the diameter of their piece (collective)."""
        way = np.zeros(self.pieces)
        np.maximum.at(way, self.piece_of_dof, np.abs(self.unmet()))
        return float((max_over(self.comm, way) / self.diameters()).max(initial=0.0))

    def norms(self, values: Array) -> Array:
        """(pieces,) norm of nodal values (owned dofs,) on each piece (collective)."""
        squares = np.bincount(self.piece_of_dof, weights=values**2, minlength=self.pieces)
        return np.asarray(np.sqrt(sum_over(self.comm, squares)))

    def residual(self, b: PETSc.Vec) -> Array:
        """Assemble the bulk's residual into `b`; returns its norm on each piece (pieces,) with reactions, before Dirichlet
        rows are set."""
        local = b.array
        for body, part in zip(self.bodies, self._slices, strict=True):
            local[part] = body.residual()
        norms = self.norms(local)
        for body, part in zip(self.bodies, self._slices, strict=True):
            body.set_bc_rows(local[part])
        return norms

    def forces(self, *, again: bool) -> Array:
        """(owned dofs,) the bulk's residual (N) with reactions in the prescribed rows: evaluated `again` at the
        present state, or as it was last."""
        parts = [body.residual() if again else body.last_residual() for body in self.bodies]
        return np.concatenate(parts)

    def inverted_volume(self) -> float:
        """Reference volume of inverted cells, at the bulk's Gauss points (collective)."""
        return sum_over(self.comm, sum(body.inverted_volume() for body in self.bodies))

    def diameter(self) -> float:
        """Diagonal of the bounding box of all meshes (m)."""
        x = np.concatenate([body.mesh.geometry.x for body in self.bodies])
        low = np.min(self.comm.allgather(x.min(axis=0, initial=np.inf)), axis=0)
        high = np.max(self.comm.allgather(x.max(axis=0, initial=-np.inf)), axis=0)
        return float(np.linalg.norm(high - low))

    def reach(self) -> float:
        """Largest distance of a node from the origin (m), collective."""
        x = np.concatenate([body.mesh.geometry.x for body in self.bodies])
        return max_over(self.comm, float(np.linalg.norm(x, axis=1).max(initial=0.0)))

    def farthest(self, values: Array) -> tuple[float, tuple[float, ...]]:
        """The longest nodal vector of (owned dofs,), and the reference position of its node (collective)."""
        nodal = np.linalg.norm(values.reshape(-1, self.gdim), axis=1)
        nodal = np.where(np.isfinite(nodal), nodal, np.inf)
        k = int(np.argmax(nodal)) if len(nodal) else -1
        mine = (float(nodal[k]), tuple(self.owned_positions()[k].tolist())) if len(nodal) else (-1.0, ())
        return max(self.comm.allgather(mine))

    # ---------------------------------------------------------------- matrices

    def diagonals(self) -> list[fem.Function]:
        """Diagonal of the bulk's stiffness (N/m) of each body, as it is now (collective)."""
        found = []
        for body in self.bodies:
            A, diagonal = body.stiffness(), fem.Function(body.space)
            A.getDiagonal(diagonal.x.petsc_vec)
            A.destroy()
            diagonal.x.scatter_forward()
            found.append(diagonal)
        return found

    def yielding(self, diagonals: Sequence[fem.Function]) -> list[fem.Function]:
        """Diagonals of the bulk's stiffness (N/m), on bodies' boundaries as a pressure meets them: by Poisson's ratio in
        the undeformed state."""
        found = [diagonal.copy() for diagonal in diagonals]
        for diagonal, share in zip(found, self._yielding_shares, strict=True):
            diagonal.x.array[:] *= share.x.array
        return found

    def stiffness(self) -> tuple[list[fem.Function], tuple[Index32, Index32]]:
        """Diagonal of the bulk's stiffness (N/m) of each body, and the pattern of all in compressed rows."""
        diagonals, indptr, indices, entries = [], [np.zeros(1, dtype=np.int32)], [], 0
        self._yielding_shares: list[fem.Function] = []
        #: of each body, (owned nodes,) the least stiffness (N/m) that a displacement of a node meets which is not prescribed
        self.softest: list[Array] = []
        for k, body in enumerate(self.bodies):
            A = body.stiffness()
            if not body.has_inertia:
                body.floating = floating_pieces(body.space, body.piece, body.prescribed(), A)
            diagonal = fem.Function(body.space)
            A.getDiagonal(diagonal.x.petsc_vec)
            diagonal.x.scatter_forward()
            diagonals.append(diagonal)
            self.softest.append(softest(body.space, A, body.prescribed()))
            self._yielding_shares.append(body.yielding_share(A))
            doubt_order(self._yielding_shares[-1], f"u[{k}]")
            rows, columns = A.getValuesCSR()[:2]
            A.destroy()  # the pattern takes less memory
            self._shift(k, columns)
            indices.append(columns)
            indptr.append(rows[1:] + np.int32(entries))  # none where this rank has no node of the body
            entries += len(columns)
        return diagonals, (np.concatenate(indptr), np.concatenate(indices))

    def _shift(self, k: int, columns: Index32) -> None:
        """Turn body k's own global columns into common ones."""
        own, common = self._numbering.own_start[:, k], self._numbering.start[:, k]
        starts, shifts = own * self.gdim, ((common - own) * self.gdim).astype(np.int32)
        if len(set(shifts)) == 1:
            columns += shifts[0]
            return
        for part in np.array_split(columns, 1 + columns.size // 2**20):  # views, each with little memory beside it
            part += shifts[np.searchsorted(starts, part, side="right") - 1]

    def assemble_jacobian(self, A: PETSc.Mat) -> None:
        """Add the bulk's Jacobian to A, Dirichlet rows and columns zero with a unit diagonal."""
        for body, map_ in zip(self.bodies, self._maps, strict=True):
            A.setLGMap(map_, map_)
            body.assemble_jacobian(A)
            A.assemble(PETSc.Mat.AssemblyType.FLUSH)

    def masses(self, forms: Sequence[Any], A: PETSc.Mat) -> tuple[PETSc.Mat, list[fem.Function]]:
        """The matrix of one bilinear form per body, Dirichlet rows and columns zero with a unit diagonal, and the diagonal
        for each body; in A, which has room for the bulk's stiffness."""
        A.zeroEntries()
        for body, form, map_ in zip(self.bodies, forms, self._maps, strict=True):
            A.setLGMap(map_, map_)
            dolfinx_petsc.assemble_matrix(A, form, bcs=body.bcs)
            A.assemble(PETSc.Mat.AssemblyType.FLUSH)
        A.assemble()
        diagonal, diagonals = A.getDiagonal(), [fem.Function(body.space) for body in self.bodies]
        self.spread(diagonal.array_r, diagonals)
        return A, diagonals

    def owned(self, fields: Sequence[fem.Function]) -> Array:
        """(owned dofs,) values of one Function per body."""
        return np.concatenate([f.x.array[: p.stop - p.start] for f, p in zip(fields, self._slices, strict=True)])

    def spread(self, values: Array, fields: Sequence[fem.Function]) -> None:
        """One Function per body from an array (owned dofs,), ghosts included."""
        for f, part in zip(fields, self._slices, strict=True):
            f.x.array[: part.stop - part.start] = values[part]
            f.x.scatter_forward()

    def with_neighbours(self, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(owned nodes,) the nodes of all cells that have a marked node (owned nodes,), collective."""
        if not self._marks:
            self._marks = [fem.Function(body.space) for body in self.bodies]
        self.spread(np.repeat(marked, self.gdim), self._marks)
        for body, field in zip(self.bodies, self._marks, strict=True):
            cells, is_marked = body.space.dofmap.list, field.x.array[:: self.gdim] > 0  # (cells, nodes), (nodes,)
            field.x.array[:] = 0.0
            field.x.array[self.gdim * cells[is_marked[cells].any(axis=1)]] = 1.0
            field.x.scatter_reverse(la.InsertMode.add)
        return np.asarray(self.owned(self._marks)[:: self.gdim] > 0)

    def volumes(self) -> Array:
        """(owned nodes,) the reference volume that is each node's (m³, m² in the plane), collective."""
        return np.concatenate([body.volumes() for body in self.bodies])

    def owned_positions(self) -> Array:
        """(owned nodes, gdim) reference positions of this rank's nodes in the common numbering (m)."""
        return np.concatenate([b.space.tabulate_dof_coordinates()[: b.owned, : self.gdim] for b in self.bodies])

    def springs(self, diagonals: Sequence[fem.Function]) -> PETSc.Vec | None:
        """Weak springs on the floating pieces, in shares of the diagonals (N/m) of the bodies' matrices; None if no piece
        floats (collective)."""
        if not any(body.floating for body in self.bodies):
            return None
        k = self.layout.vector()
        for body, diagonal, part in zip(self.bodies, diagonals, self._slices, strict=True):
            floats = np.zeros(len(diagonal.x.array) // self.gdim, dtype=bool)
            for piece in body.floating:
                floats[piece.nodes] = True
            floating = np.repeat(floats, self.gdim) & (body.prescribed().x.array == 0)
            k.array[part] = (diagonal.x.array * floating)[: part.stop - part.start]
        return k

    def tension(self, stiffness: PETSc.Mat, diagonals: Sequence[fem.Function], slack: NDArray[np.bool_]) -> PETSc.Mat:
        """What fictitious tensions of the `slack` pieces (pieces,) add to a matrix with room for the bodies' stiffness,
        in shares of each node's own: of its largest diagonal entry (N/m), so that a soft membrane beside a stiff one has a
        tension of its own size."""
        total = stiffness.duplicate()
        for body, map_ in zip(self.bodies, self._maps, strict=True):
            total.setLGMap(map_, map_)
            body.assemble_tension(total)
            total.assemble(PETSc.Mat.AssemblyType.FLUSH)
        total.assemble()
        own, scale = total.getDiagonal(), self.layout.vector()
        for diagonal, part in zip(diagonals, self._slices, strict=True):
            k = np.repeat(diagonal.x.array.reshape(-1, self.gdim).max(axis=1), self.gdim)
            scale.array[part] = k[: part.stop - part.start]
        scale.array[:] = np.sqrt(scale.array_r / np.where(own.array_r > 0, own.array_r, np.inf))
        scale.array[:] *= slack[self.piece_of_dof]
        total.diagonalScale(scale, scale)
        return total


def _order(spaces: Sequence[fem.FunctionSpace]) -> list[int]:
    """The place of each space's mesh in the order in which they were made, which is that of all ranks: it is collective."""
    made = [V.mesh.ufl_domain().ufl_id() for V in spaces]
    return [sorted(set(made)).index(number) for number in made]
