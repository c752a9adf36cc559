"""The coupled problem, eq. (3): a UFL bulk residual and contact pairs in PETSc nested vectors and matrices.

Unknowns are [U, Λ₁/k₁, Λ₂/k₂, …], one multiplier block per pair, and the multipliers' residual is taken times k, the
pair's default ε: all unknowns are lengths, all residuals forces, and the blocks of the Jacobian, the MATNEST of eq. (6),
are of one magnitude whatever the units, so that the direct solver needs no scaling of its own. Contact couples nodes
of ranks that share no ghost: element blocks are inserted with global indices and PETSc ships the rows of other ranks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.bodies import SLACK, Bodies
from dolfinx_mortar_al.body import Body
from dolfinx_mortar_al.bulk_stiffness import BulkStiffness
from dolfinx_mortar_al.contact import Contact, check_surfaces
from dolfinx_mortar_al.contact_motions import ContactMotions
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.dashpots import Dashpots
from dolfinx_mortar_al.given import Given
from dolfinx_mortar_al.led import lead
from dolfinx_mortar_al.load import Loads
from dolfinx_mortar_al.monitors import Monitor, Reporter
from dolfinx_mortar_al.motion import Motion
from dolfinx_mortar_al.petsc_blocks import Layout, empty_matrix, insert, insert_vector, matrix_with_pattern, row_by_row
from dolfinx_mortar_al.problem_ties import ProblemTies
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over
from dolfinx_mortar_al.shared_nodes import SharedNodes
from dolfinx_mortar_al.standing import Standing
from dolfinx_mortar_al.stopwatch import Stopwatch
from dolfinx_mortar_al.ties import Ties
from dolfinx_mortar_al.validation import check_names, joint_thickness, listed

__all__ = ["ContactProblem", "Snapshot", "check_problem"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


LEAST_SPRING = 1e-13  # share of a piece's stiffness that keeps the Jacobian regular where a motion stays free
SPARE = 2  # rings of target facets around contact in the plane that matrices have room for from the start
UNSEEN = 1e-6  # share of round-off in a body's forces below which a load counts as none from the start


#: All that a step may change, on this rank: arrays by the name of the member that owns them and their own.
Snapshot = dict[str, dict[str, Array]]


class Member(Protocol):
    """What has a state that steps change: loads, bodies, pairs, motions."""

    def snapshot(self) -> dict[str, Array]:
        """Copies of its arrays."""

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot."""


class ContactProblem(ProblemTies):
    """Bodies with contact pairs: ``ContactProblem(body, contacts=…)`` with a :class:`~dolfinx_mortar_al.body.Body`, in motion
    with a :class:`~dolfinx_mortar_al.motion.Motion`, or several; or ``ContactProblem(F, u, bcs=…, contacts=…)`` with any
    residuals F(u; v) = 0.

    Args:
        F: the bodies or motions; or a UFL residual, internal minus external virtual work, linear in the test function, or one
            per displacement.
        u: with residuals their displacement (m), Lagrange of order 1 or 2 with gdim components; holds the start state. Bodies
            on different meshes, such as a membrane and a bulk body, have a displacement each.
        bcs: Dirichlet conditions on u, besides those of the bodies.
        contacts: the pairs. Those that do not say their thickness have that of the bodies.
        monitors: looked at in every converged state, such as :func:`~dolfinx_mortar_al.monitors.wrinkling`.
        jacobian: UFL bilinear form (or one per displacement), default the derivative of F in the direction of u.

    Raises:
        ValueError: on every rank: an unsuitable displacement (:class:`~dolfinx_mortar_al.bodies.Bodies`) or surface
            (:class:`~dolfinx_mortar_al.contact.Contact`), a contact between bodies of different thickness, pairs that are
            there twice or of one name, a start state with det F ≤ 0 or a contactor wholly behind its target.
    """

    def __init__(
        self,
        F: Any,
        u: fem.Function | Sequence[fem.Function] | None = None,
        *,
        bcs: Sequence[fem.DirichletBC] = (),
        contacts: Sequence[Contact] = (),
        monitors: Sequence[Monitor] = (),
        jacobian: Any = None,
    ) -> None:
        self.stopwatch = Stopwatch()
        contacts = listed("contacts", contacts, Contact, "a Contact")
        said = _bodies_in(F, u)
        #: those of the bodies that move, in the order of the displacements
        self.motions = [body for body in said if isinstance(body, Motion)]
        if said:
            bcs = _joined([body.bcs for body in said], bcs)
            F, u = [body.residual for body in said], [body.u for body in said]
            u = u if len(u) > 1 else u[0]
        assert u is not None
        self.u, self.monitors = u, listed("monitors", monitors, Monitor, "a Monitor")
        with self.stopwatch("forms"):
            residuals = list(F) if isinstance(F, list | tuple) else [F]
            jacobians = [jacobian] if isinstance(jacobian, ufl.Form) else jacobian
            foreseen = [body.foreseen if isinstance(body, Body) else None for body in said]
            self.bodies = Bodies(residuals, listed("u", u, fem.Function, "a Function"), bcs, jacobians, foreseen)
        for body, forms in zip(said, self.bodies.bodies, strict=False):
            forms.sheets = body.sheets if isinstance(body, Body) else []
            forms.has_inertia = isinstance(body, Motion)
        self.comm, self.gdim = self.bodies.comm, self.bodies.gdim
        agreed(self.comm, "contacts: how many", len(contacts))
        Given(self.comm, self.bodies.bodies).check()
        self._check_cells()
        with self.stopwatch("contact set-up"):
            names = check_names([contact.name for contact in contacts])
            contacts = [
                replace(contact, thickness=joint_thickness(contact, name, said))
                for contact, name in zip(contacts, names, strict=True)
            ]
            for contact, name in zip(contacts, names, strict=True):
                for argument, value in contact.said.items():
                    agreed(self.comm, f"{argument} of the contact {name!r}", value)
            check_surfaces(contacts)
            self.pairs = [
                ContactPair(contact, self.bodies, self.stopwatch, name)
                for contact, name in zip(contacts, names, strict=True)
            ]
        named = [surface for pair in self.pairs for surface in pair.named]
        for pair in self.pairs:
            pair.named = named
        #: what a user may change between solves
        self.given = Given(self.comm, self.bodies.bodies, self.pairs)
        #: what marches have moved
        self.loads = Loads()
        #: what a snapshot is made of, in the order in which it is restored
        self.members: dict[str, Member] = {"loads": self.loads, "bodies": self.bodies}
        self.members |= {f"pair{k}": pair for k, pair in enumerate(self.pairs)}
        self.members |= {f"motion{k}": motion for k, motion in enumerate(self.motions)}
        self._touched = [self._pieces_of(pair) for pair in self.pairs]
        self._rough = np.array([pair.friction > 0 for pair in self.pairs], dtype=bool)  # which pairs have friction
        self._contact_motions = ContactMotions(self.bodies, self.pairs, self._touched)
        with self.stopwatch("bulk"):
            diagonals = self._create_matrices()
        #: as pairs take it, and tests for round-off
        self.stiffness = BulkStiffness(self.bodies, self.pairs, diagonals)
        self.members = {"stiffness": self.stiffness, **self.members}  # what pairs restore depends on ε
        for pair in self.pairs:
            pair.start()
        self._shared_nodes = SharedNodes(self.pairs)
        if self.motions:
            self._shared_nodes.leave_out(everywhere=True)
        self._check_start()
        #: whether matrices get room for facets near contact and their neighbours in space, too: fill for factors
        self.spare_pattern = False
        #: what solves the linear systems, in words if made a text; set by the Newton solver
        self.linear_solver: object = None
        diameter = self.bodies.diameter()
        #: (pieces,) norm of the bulk's forces at the last evaluation on each connected piece, and their round-off (N)
        self.force_scale: Array = np.zeros(self.bodies.pieces)
        #: size of forces that a step of bodies in motion resolves, on all pieces (N); None in statics
        self.force_reference: float | None = None
        self._travel: Array = np.ones(self.bodies.pieces)
        self._least_gap = 2e-15 * diameter  # (m)

    def _check_cells(self) -> None:
        """Refuse inverted cells at the start (collective)."""
        if self.inverted_volume() > 0:
            raise ValueError(
                "u: det F ≤ 0 somewhere in the start state; start from a displacement without inverted cells"
            )

    def _check_start(self) -> None:
        """Refuse a contactor that is behind its target, and warn of surfaces that overlap (collective)."""
        for pair in self.pairs:
            pair.check_behind()
        found = [finding for pair in self.pairs if (finding := pair.overlap_at_start()) is not None]
        Reporter(self.comm.rank).report(found, "the start")

    def take_up(self) -> None:
        """Begin where bodies are: where displacements were set since the last converged state, what contact remembers of that
        says nothing of this one, and slip is counted anew (collective).

        Raises:
            ValueError: as at a problem's start: inverted cells, surfaces on the wrong side of each other.
        """
        if not any_over(self.comm, any(pair.is_elsewhere() for pair in self.pairs)):
            return
        self.bodies.set(self.bodies.get())  # ghosts may not have been
        self._check_cells()
        for pair in self.pairs:
            pair.forget()
            pair.start()
        self._check_start()

    def pair(self, name: str) -> ContactPair:
        """The pair of a name.

        Raises:
            ValueError: if there is none, with the names there are.
        """
        for pair in self.pairs:
            if pair.name == name:
                return pair
        known = ", ".join(repr(pair.name) for pair in self.pairs) or "none: the problem has no contacts"
        raise ValueError(f"name = {name!r}: no contact pair is called that; known are {known}")

    def _pieces_of(self, pair: ContactPair) -> NDArray[np.bool_]:
        """(pieces,) which connected pieces a pair's forces act on (collective)."""
        touched = np.zeros(self.bodies.pieces, dtype=np.int32)
        for k, body in enumerate(self.bodies.bodies):
            number = fem.Function(body.space)
            number.x.array[:] = np.repeat(body.piece + self.bodies.first_piece[k], self.gdim)
            touched[pair.nodal_values(number).astype(int).ravel()] = 1
        self.comm.Allreduce(MPI.IN_PLACE, touched, MPI.MAX)
        return np.asarray(touched > 0)

    @property
    def gap_floor(self) -> list[float]:
        """Round-off of the gaps of each pair, over its area (m³)."""
        return [max(self._least_gap, pair.kinematics.round_off) * pair.area for pair in self.pairs]

    def residual_ratios(self, f: Sequence[PETSc.Vec], rtol: float, corrected: bool) -> list[float]:
        """Norm of each block of the residual over that below which it counts as converged: forces against those on the same
        connected piece of a body, of which the worst counts; gaps against pressure over stiffness (collective).

        Forces below round-off count as none only where a whole Newton step has `corrected` the state: a load may be that
        small beside the stiffness of the body it acts on, and be much for a softer one which that body presses, or be all
        that acts in a short time step. Nor may a piece at rest that nothing holds along an axis have a resultant there, but
        for what round-off of positions makes of contact.
        """
        forces = [pair.nodal_forces() for pair in self.pairs]
        moving, reference = self.force_reference is not None, self.force_reference or 0.0
        scale = np.array(np.maximum(self.force_scale, reference))
        for force, touched in zip(forces, self._touched, strict=True):
            np.maximum(scale, force, out=scale, where=touched)
        seen = np.maximum(rtol * scale, self.force_floor * UNSEEN)
        if corrected:
            seen = np.maximum(seen, self._contact_round_off(self._in_contact()[0]))
        worst = self.bodies.norms(f[0].array_r) / (np.maximum(seen, self.force_floor) if corrected else seen)
        if not moving:  # the bodies' round-off is no force on a piece as a whole
            worst = np.maximum(worst, self.bodies.resultants(f[0].array_r) / seen)
        ratios = [float(np.max(worst))]
        for pair, force, floor, part in zip(self.pairs, forces, self.gap_floor, f[1:], strict=True):
            gap = max(rtol * max(force, reference) / pair.augmentation.stiffness, floor)
            ratios.append(part.norm() / (pair.augmentation.unit * gap))
        return ratios

    def force_over_firmness(self) -> float:
        """The largest norm of the bulk's forces on a piece over those that strain it by one (collective)."""
        return float((self.bodies.residual(self.bodies.layout.vector()) / self.stiffness.firmness).max())

    def inverted_volume(self) -> float:
        """Reference volume where det F ≤ 0 or is not a number, at the bulk's Gauss points (collective)."""
        return self.bodies.inverted_volume()

    # ---------------------------------------------------------------- matrices and vectors

    def _create_matrices(self) -> list[fem.Function]:
        """Make the nest; returns the diagonal of each body's stiffness (N/m) at the start state."""
        self._seen: list[Index] = [np.empty(0, dtype=np.int64) for _ in self.pairs]
        self._layouts = [self.bodies.layout] + [Layout.of(pair.multiplier.field.function_space) for pair in self.pairs]
        n = len(self._layouts)
        self.blocks: list[list[Any]] = [[None] * n for _ in range(n)]
        diagonals, pattern = self.bodies.stiffness()
        self.blocks[0][0] = matrix_with_pattern(self.bodies.layout, pattern)
        del pattern
        #: contact's share of blocks[0][0], in rows of the surfaces alone
        self.contact_share = empty_matrix(self.bodies.layout, self.bodies.layout)
        self.contact_share.assemble()
        self._outgrown = False  # whether its pattern has grown since it was part of the matrix
        self._diagonals = diagonals
        #: (pieces,) some unprescribed displacement meets no stiffness, as a flat membrane's across it; until the piece bears
        self.slack = self.bodies.slack(diagonals)
        #: a fictitious tension of slack pieces in the Jacobian, as a share of the stiffness (no part of the residual)
        self.tension, self._tension_matrix, self._tensed = 0.0, None, self.slack
        #: springs on the pieces that contact alone holds, in the Jacobian only: (N/m) and the share of them in use
        self.springs, self.spring_share = self.bodies.springs(diagonals), 0.0
        self._spring_shares = self.bodies.spring_shares(diagonals, self._touched)
        #: on the nodes, while the bodies go to where they come to rest (`relaxation`)
        self.dashpots: Dashpots | None = None
        # (pieces,) most of the contact forces (N), and (pairs,) whether all points have slipped, in this solve
        self._pressed: Array = np.zeros(self.bodies.pieces)
        self._slid: NDArray[np.bool_] = np.zeros(len(self.pairs), dtype=bool)
        #: of pieces that contact alone holds; None if there are none
        self.ties = None if self.springs is None else Ties(self.bodies, self.springs.array_r * self._spring_shares)
        # which pieces nothing presses on, as found last
        self._free: NDArray[np.bool_] = np.zeros(self.bodies.pieces, dtype=bool)
        #: of pieces, in the last equilibrium
        self.standing = Standing(not self.floating, self._free, *np.zeros((2, self.bodies.pieces)))
        if self.ties is not None:
            self.members |= {"ties": self.ties, "standing": self.standing}
        for k in range(1, n):
            for i, j in [(0, k), (k, 0), (k, k)]:
                self.blocks[i][j] = empty_matrix(self._layouts[i], self._layouts[j])
                self.blocks[i][j].assemble()
        self._make_nest()
        self.x = PETSc.Vec().createNest([layout.vector() for layout in self._layouts], comm=self.comm)
        self.residual = self.x.duplicate()
        #: the bulk's forces at the last evaluation (N)
        self.bulk_forces = self.bodies.layout.vector()
        return diagonals

    def _grow_pattern(self) -> None:
        """Give contact's matrices room for the facet couples now in contact, beside all those seen before.

        The pattern only grows, so that the symbolic factorisation is kept while contact stays on the same couples.
        """
        new = [pair.couples() for pair in self.pairs]
        grown = any(len(np.setdiff1d(n, seen, assume_unique=True)) for n, seen in zip(new, self._seen, strict=True))
        if not any_over(self.comm, grown):
            return
        self._outgrown = True
        for k, pair in enumerate(self.pairs, start=1):
            rings = SPARE if self.gdim == 2 else int(self.spare_pattern)
            wide = pair.couples(near=True) if rings else new[k - 1]
            for _ in range(rings):
                wide = pair.blocks.with_neighbours(wide, pair.kinematics)
            unseen = np.setdiff1d(wide, self._seen[k - 1], assume_unique=True)
            self._seen[k - 1] = np.union1d(self._seen[k - 1], unseen)
            for (i, j), elements in zip([(0, 0), (0, k), (k, 0), (k, k)], pair.blocks.pattern(unseen), strict=True):
                entries = empty_matrix(self._layouts[i], self._layouts[j])
                for element in elements:
                    insert(entries, *element)
                if i == j == k:
                    own = np.arange(*entries.getOwnershipRange(), dtype=np.int32)[:, None]  # any of them may be idle
                    entries.setValuesRCV(own, own, np.zeros((len(own), 1, 1)), _ADD)
                entries.assemble()
                # into the new matrix: a preconditioner may still work with the old one
                if i == j == 0:
                    entries.axpy(1.0, self.contact_share, structure=_DIFFERENT)
                    self.contact_share = entries
                else:
                    entries.axpy(1.0, self.blocks[i][j], structure=_DIFFERENT)
                    self.blocks[i][j] = entries

    def _make_nest(self) -> None:
        self.matrix = PETSc.Mat().createNest(self.blocks, comm=self.comm)
        self.matrix.assemble()

    # ---------------------------------------------------------------- evaluation

    def unpack(self, x: PETSc.Vec) -> None:
        """Copy the nested vector into the Functions, ghosts included."""
        parts = x.getNestSubVecs()
        self.bodies.set(parts[0].array_r)
        for pair, part in zip(self.pairs, parts[1:], strict=True):
            field = pair.multiplier.field
            field.x.array[: part.getLocalSize()] = pair.augmentation.unit * part.array_r
            field.x.scatter_forward()

    def pack(self, x: PETSc.Vec) -> None:
        """Copy the Functions into the nested vector."""
        parts = x.getNestSubVecs()
        parts[0].array[:] = self.bodies.get()
        for pair, part in zip(self.pairs, parts[1:], strict=True):
            part.array[:] = pair.multiplier.field.x.array[: part.getLocalSize()] / pair.augmentation.unit
        x.assemble()

    def assemble_residual(self, x: PETSc.Vec, f: PETSc.Vec, *, contact: bool = False, bulk: bool = False) -> None:
        """The left-hand side of eq. (3) at x with the active sets as they are: forces, and k times the multipliers'
        residual (N); `contact` if the pairs are up to date with x, `bulk` if the bulk's forces are."""
        self.unpack(x)
        if not bulk:
            self.assemble_bulk()
        if not contact:
            self.evaluate()
        self.add_contact(f)

    def assemble_bulk(self) -> None:
        """Bring the bulk's forces up to date with the displacements, those of ties and dashpots among them (collective)."""
        with self.stopwatch("bulk"):
            self.force_scale = self.bodies.residual(self.bulk_forces)
            if self.ties is not None and self.ties.acts:
                self.bulk_forces.array[:] += self.ties.forces()
            if self.dashpots is not None:
                self.bulk_forces.array[:] += self.dashpots.forces(self.bodies.get())

    def add_contact(self, f: PETSc.Vec) -> None:
        """f ← the bulk's forces and those of contact, as last evaluated."""
        forces = f.getNestSubVecs()[0]
        self.bulk_forces.copy(forces)
        with self.stopwatch("contact"):
            for pair in self.pairs:
                for blocks, values in pair.body_residual():
                    insert_vector(forces, blocks, values)
            forces.assemble()
        self.set_gaps(f)

    def set_gaps(self, f: PETSc.Vec) -> None:
        """Of add_contact the multipliers' residuals alone."""
        with self.stopwatch("contact"):
            for pair, part in zip(self.pairs, f.getNestSubVecs()[1:], strict=True):
                part.set(0.0)  # and stays so at redundant nodes, whose row is diagonal
                insert_vector(part, *pair.multiplier_residual(), pair.augmentation.unit)
                part.assemble()
            f.assemble()

    def decide(self, f: PETSc.Vec) -> bool:
        """Let the active sets change, once per Newton iteration, and bring the residual f up to date with them; whether any
        point opened or closed (collective)."""
        changed, turned = self.choose(f)
        if changed or turned:
            self.add_contact(f)
        return changed

    def choose(self, f: PETSc.Vec) -> tuple[bool, bool]:
        """Let the active sets change for the multipliers' residuals in f, which stays as it is; whether any point opened or
        closed, and whether any is held or was because it slips to and fro (collective)."""
        with self.stopwatch("contact"):
            changed = any([pair.decide(part) for pair, part in zip(self.pairs, f.getNestSubVecs()[1:], strict=True)])
            turned = any([pair.hold_turned() for pair in self.pairs])
            for pair in self.pairs if changed or turned else ():
                pair.apply_law()
            for pair in self.pairs:
                pair.active.note_slip(pair.state)
        return changed, turned

    def follow(self, f: PETSc.Vec) -> None:
        """At the start of a Newton iteration let the pairs choose anew what they hold in between (collective)."""
        if any([pair.follow() for pair in self.pairs]):
            self.reconsider(f)

    def reconsider(self, f: PETSc.Vec) -> None:
        """Bring the residual f up to date with friction bounds that were frozen or freed, or other choices of the pairs."""
        for pair in self.pairs:
            pair.apply_law()
        self.add_contact(f)

    @property
    def free_bounds(self) -> list[ContactPair]:
        """The pairs with friction bounds that are not frozen."""
        return [pair for pair in self.pairs if pair.friction and pair.active.frozen is None]

    @property
    def frozen_bounds(self) -> list[ContactPair]:
        """The pairs with friction bounds that are frozen."""
        return [pair for pair in self.pairs if pair.active.frozen is not None]

    def freeze_bounds(self) -> list[ContactPair]:
        """Hold the bounds that are free at their present μp: Tresca's law; returns their pairs."""
        free = self.free_bounds
        for pair in free:
            pair.active.freeze(pair.state, pair.friction_coefficient)
        return free

    def support_forces(self) -> list[Array]:
        """Of each body (owned dofs,) the residual in the state last solved for, with what supports bear in the
        prescribed rows (N), collective. In time steps it is the mean over the last one."""
        total = self.bodies.layout.vector()
        total.array[:] = self.bodies.forces(again=self.force_reference is None)
        total.assemble()
        for pair in self.pairs:
            for blocks, values in pair.body_residual(reactions=True):
                insert_vector(total, blocks, values)
        total.assemble()
        return self.bodies.split(total.array_r)

    def holding_dashpots(self) -> Dashpots:
        """Such as bear the bulk's present forces, so that without contact it stays, and hold each node about as firmly as its
        neighbours do (collective)."""
        k = self.nodal_stiffness(self.bodies.diagonals())
        forces = np.where(k > 0.0, self.bodies.forces(again=True), 0.0)
        return Dashpots(k, self.bodies.get() + forces / np.where(k > 0.0, k, 1.0))

    def nodal_stiffness(self, diagonals: Sequence[fem.Function] | None = None) -> Array:
        """(owned dofs,) mean diagonal (N/m) of the bulk's stiffness at each node, at the start state or of these `diagonals`;
        0 at displacements that are prescribed (collective)."""
        diagonals = self._diagonals if diagonals is None else diagonals
        nodal = np.abs(self.bodies.owned(diagonals)).reshape(-1, self.gdim).mean(axis=1)
        return np.where(self.bodies.prescribed(), 0.0, nodal.repeat(self.gdim))

    def masses(self, forms: Sequence[Any]) -> tuple[PETSc.Mat, list[fem.Function]]:
        """The bodies' mass matrix from one bilinear form per body, and its diagonal on each."""
        return self.bodies.masses(forms, self.blocks[0][0].duplicate())

    def assemble_jacobian(self) -> None:
        """The derivative of the residual at the state last evaluated."""
        self.assemble_contact()
        with self.stopwatch("bulk"):
            if self._outgrown:
                wider = self.contact_share.copy()
                wider.axpy(1.0, self.blocks[0][0], structure=_DIFFERENT)
                self.blocks[0][0] = row_by_row(wider)
                self._make_nest()
                self._outgrown = False
            A = self.blocks[0][0]
            A.zeroEntries()
            self._add_bulk()
            A.assemble()
            A.axpy(1.0, self.contact_share, structure=_SUBSET)
            self.matrix.assemble()

    def assemble_contact(self) -> None:
        """Contact's share of that derivative, with all of the multipliers' rows and columns; the displacements' block stays
        as it is, and with it :attr:`matrix`, which is of no use from then on if the pattern has grown."""
        with self.stopwatch("contact"):
            self._grow_pattern()
            mine = [self.contact_share] + [B for row in self.blocks for B in row[1:] if B is not None]
            mine += [row[0] for row in self.blocks[1:]]
            for block in mine:
                block.zeroEntries()
            for k, pair in enumerate(self.pairs, start=1):
                element, unit = pair.tangent(), pair.augmentation.unit
                insert(self.contact_share, *element.UU)
                insert(self.blocks[0][k], *element.UΛ, unit)
                insert(self.blocks[k][0], *element.ΛU, unit)
                insert(self.blocks[k][k], *element.ΛΛ, unit**2)
                if (cuts := pair.tangent_of_cuts()) is not None:
                    insert(self.contact_share, *cuts.UU)
                    insert(self.blocks[k][0], *cuts.ΛU, unit)
                idle = pair.multiplier.idle
                self.blocks[k][k].setValuesRCV(idle[:, None], idle[:, None], np.full((len(idle), 1, 1), unit), _ADD)
            for block in mine:
                block.assemble()

    def _add_bulk(self) -> None:
        """Add the bulk's derivative, and what helps singular Jacobians."""
        self.bodies.assemble_jacobian(self.blocks[0][0])
        if self.tension:
            self._add_tension()
        if self.springs is not None:
            self._add_springs()
        if self.dashpots is not None:
            A = self.blocks[0][0]
            A.assemble()
            mine = np.arange(*A.getOwnershipRange(), dtype=np.int32)[:, None]
            A.setValuesRCV(mine, mine, self.dashpots.stiffness[:, None, None], _ADD)

    def evaluate(self) -> None:
        """Bring the pairs' contact state, and all that is reported of it, up to date with the displacements."""
        for pair in self.pairs:
            pair.evaluate()

    def show_committed(self) -> None:
        """The pairs' results as they were in the last committed step, at which the displacements are (collective)."""
        for pair in self.pairs:
            pair.show_committed()

    def _add_tension(self) -> None:
        A = self.blocks[0][0]
        A.assemble()
        if self._tension_matrix is None or not np.array_equal(self._tensed, self.slack):
            self._tension_matrix = self.bodies.tension(A, self._diagonals, self.slack)
            self._tensed = self.slack.copy()
        A.axpy(self.tension, self._tension_matrix, structure=_SUBSET)

    def _add_springs(self) -> None:
        A, k = self.blocks[0][0], self.springs
        assert k is not None
        A.assemble()
        mine = np.arange(*A.getOwnershipRange(), dtype=np.int32)[:, None]
        loose = self.ties is not None and self.ties.are_loose  # what sticks holds everything
        share = np.maximum((0.0 if loose else self.spring_share) * self._spring_shares, LEAST_SPRING)
        A.setValuesRCV(mine, mine, (share * k.array_r)[:, None, None], _ADD)
        if self.ties is not None and self.ties.acts and not loose:
            nodes = mine.reshape(-1, self.gdim)
            A.setValuesRCV(nodes, nodes, self.ties.springs(multigrid=self.spare_pattern), _ADD)

    def begin(self) -> None:
        """A new solve (collective)."""
        if not self.motions:  # time steps need one space of multipliers, and one ε
            self.stiffness.follow()
            self._shared_nodes.leave_out(everywhere=False)
        ways = self.bodies.ways()
        self._travel = np.maximum(ways / self.stiffness.diameters, 1.0)
        for pair in self.pairs:
            pair.begin(float(ways.max()))

    def unsupported(self) -> bool:
        """Whether some piece may float while some pair is open all over (collective)."""
        closed = [any_over(self.comm, pair.active.closed.any()) for pair in self.pairs]
        return bool(self.floating) and not all(closed)

    def longest_motion(self, du: Array) -> float:
        """Largest change of a node's position in `du` (owned dofs,), in target facets (collective)."""
        nodal = np.linalg.norm(du.reshape(-1, self.gdim), axis=1)
        size = min((pair.target.size for pair in self.pairs), default=np.inf)
        return max_over(self.comm, float(nodal.max(initial=0.0))) / size

    def contact_pattern(self) -> int:
        """A number that changes with the open/slip/stick state of any point on any rank (collective)."""
        mine = hash(tuple(pair.state.status.tobytes() for pair in self.pairs)) % 2**40  # as a float exact on 8192 ranks
        return int(sum_over(self.comm, mine))

    def changed_points(self, before: Sequence[NDArray[np.int8]]) -> str:
        """Where points of the pairs have changed the open/slip/stick states that they had `before`, in words; where others
        have taken their place since that is not known (collective)."""
        parts = []
        for pair, then in zip(self.pairs, before, strict=True):
            now = pair.state.status
            X = np.concatenate(self.comm.allgather(pair.points()[now != then if len(now) == len(then) else []]))
            if len(X):
                parts.append(f"{pair.name}: {len(X)} points, the first at X = {np.array2string(X[0], precision=4)}")
        return "; ".join(parts) or "at points that move with the target's end or segments"

    # ---------------------------------------------------------------- transactions

    def snapshot(self) -> Snapshot:
        """A copy of all that a step may change."""
        return {name: member.snapshot() for name, member in self.members.items()}

    def restore(self, saved: Snapshot) -> None:
        """Back to an earlier state, slip history included; Newton starts from the active set that λ̂_N says."""
        for name, member in self.members.items():
            member.restore(saved[name])

    def slip_from_touch(self, ratio: float) -> None:
        """Let points that touch in the next step, `ratio` times as long as the last, slip from there; 0 where that one says
        nothing of it (collective)."""
        for pair in self.pairs if ratio > 0.0 else ():
            pair.slip_from_touch(ratio)

    def lead(self) -> None:
        """Move bodies with the supports that lead them, along what they touch (collective)."""
        lead(self.bodies, self.pairs, self._touched)

    def resume(self, saved: Snapshot) -> None:
        """To a converged state of an earlier run (collective)."""
        self.restore(saved)
        if self.lacks_stiffness:
            self.assemble_bulk()
            self._look_what_bears()

    @property
    def lacks_stiffness(self) -> bool:
        """Whether some piece has met no forces yet that would give it stiffness."""
        return bool(self.slack.any())

    def _look_what_bears(self) -> None:
        """In a converged state, a piece that bears forces is taut; one that nothing has met is as slack as it was."""
        self.slack &= self.force_scale <= SLACK * self.stiffness.firmness

    def commit(self) -> None:
        """The step has converged: it becomes the origin of the next one's slip."""
        self.standing.free, self.standing.held = self._free, not self.floating or self.contact_holds()
        self.standing.pressed = self._pressing()
        self.standing.pressing = np.maximum(self.standing.pressing, self.standing.pressed)
        self._look_what_bears()
        self.bodies.begin()
        if self.ties is not None:
            self.ties.release()
        for pair in self.pairs:
            pair.commit()

    @property
    def unknowns(self) -> dict[str, int]:
        """Global number of unknowns per block."""
        counts = {"u": self.bodies.layout.sizes[1]}
        return counts | {f"multiplier of {pair.name}": pair.multiplier.size for pair in self.pairs}


def check_problem(problem: Any) -> None:
    """What is to be solved, or has been, is a problem.

    Raises:
        ValueError: if it is something else, such as a Body.
    """
    if not isinstance(problem, ContactProblem):
        kind = type(problem).__name__
        way = "ContactProblem(body, contacts=…)" if isinstance(problem, Body | Motion) else "a ContactProblem"
        raise ValueError(f"problem: {kind} is no ContactProblem; pass {way}")


def _bodies_in(F: Any, u: Any) -> list[Body | Motion]:
    """The bodies that a problem is made of, none if it is made of residuals."""
    items = list(F) if isinstance(F, list | tuple) else [F]
    found = [item for item in items if isinstance(item, Body | Motion)]
    if not found and u is None:
        raise ValueError(
            "u = None: pass the displacement of a residual, ContactProblem(F, u), or a Body in place of both"
        )
    if not found:
        return []
    for k, item in enumerate(items):
        if not isinstance(item, Body | Motion):
            raise ValueError(f"F[{k}]: {type(item).__name__} beside a Body; make a form one, too: Body(u, form)")
        if any(item.u is other.u for other in items[:k]):
            raise ValueError(f"F[{k}]: a Body of the same displacement is there before; say all of it in one")
    if u is not None:
        raise ValueError("u: a Body says it; leave it out, and name what follows: contacts=[…]")
    return found


def _joined(own: Sequence[Sequence[fem.DirichletBC]], more: Any) -> list[fem.DirichletBC]:
    """Conditions of the bodies and the problem's, each once."""
    all_of_them = [bc for bcs in own for bc in bcs] + listed("bcs", more, fem.DirichletBC, "a Dirichlet condition")
    return list({id(bc): bc for bc in all_of_them}.values())


_ADD = PETSc.InsertMode.ADD
_DIFFERENT, _SUBSET = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
