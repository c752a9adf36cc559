"""A contact pair: two surfaces, a law, and the element vectors and matrices of eqs. (4) and (6)–(10).

The integrals run over the contactor's reference facets by Gauss points. Arrays are batched over the n = facets × points
Gauss points of this rank; the target is seen whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.law import OPEN, STICK, Augmentation, Coulomb, Frictionless, LawState
from dolfinx_mortar_al.multiplier import MultiplierSpace
from dolfinx_mortar_al.obstacles import Obstacle
from dolfinx_mortar_al.projection import Projection, TargetPoint
from dolfinx_mortar_al.stopwatch import Stopwatch
from dolfinx_mortar_al.surface import Facets, Surface, surface_normal
from dolfinx_mortar_al.targets import DeformableTarget, RigidTarget, target_of
from dolfinx_mortar_al.variation import Slots, vary, vary_frozen
from dolfinx_mortar_al.velocity import VelocityLevel

__all__ = ["Contact", "ContactPair", "Tangent"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


# How Newton's contact decisions are taken, measured on the two beams (docs/newton.md)
PATIENCE = 1.0  # gaps are trusted to this many times their error
DEEPEST = 1.0 - 1e-6  # of the penetrated points only the deepest of each neighbourhood closes
WEAK = 0.1  # share of the largest pressure below which points of a first, all-closed guess open
RETURNS = 2  # to the target facet it came from, after which a point stays there for the rest of a solve
AT_END = 0.1  # weight of the other nodes where a point counts as at the target's end
SOFTER = 0.1  # ε over the bulk's stiffness at the surface


@dataclass(frozen=True)
class Contact:
    """Two surfaces that may touch.

    Args:
        contactor: carries the multiplier and the integration points; take the finer or softer side.
        target: the surface that contactor points are projected onto, or a rigid obstacle.
        friction: Coulomb's coefficient μ ≥ 0; 0 builds the problem with a scalar multiplier and no slip history.
        epsilon_normal, epsilon_tangential: augmentation parameters ε_N, ε_T (Pa/m). By default both come from the bulk
            stiffness at the surfaces; the answer depends on them only where a facet is partly closed.
        quadrature_degree: of the contactor's Gauss points, at least 2 × order; default 2 × order + 1, on a curved membrane
            in the plane 6 × order + 1.
        thickness: out of the plane (m), for two-dimensional bodies; the same as in the bulk's forms.
        name: for messages and output.

    Raises:
        ValueError: on a friction that is negative or not finite, an ε that is not positive, or equal surfaces.
    """

    contactor: Surface
    target: Surface | Obstacle
    friction: float = 0.0
    epsilon_normal: float | None = None
    epsilon_tangential: float | None = None
    quadrature_degree: int | None = None
    thickness: float = 1.0
    name: str = "contact"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.friction) and self.friction >= 0):
            raise ValueError(f"friction = {self.friction}: Coulomb's coefficient must be a number ≥ 0")
        for label in ("epsilon_normal", "epsilon_tangential", "thickness"):
            value = getattr(self, label)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{label} = {value}: must be positive (leave it out for the default)")
        if self.quadrature_degree is not None and not 0 <= self.quadrature_degree <= 30:
            raise ValueError(f"quadrature_degree = {self.quadrature_degree}: must lie in 0 … 30")
        a, b = self.contactor, self.target
        if isinstance(b, Surface) and a.mesh is b.mesh and a.tags is b.tags and a.tag == b.tag:
            raise ValueError(f"contactor and target are the same surface (tag {a.tag}): a pair needs two")

    @property
    def target_name(self) -> str:
        """The target in a message."""
        return f"tag {self.target.tag}" if isinstance(self.target, Surface) else type(self.target).__name__


@dataclass
class Tangent:
    """Element matrices (m, rows, components, columns, components) of eq. (6), with global block indices (m, nodes).

    The bodies' rows are the nodes of the contactor's and the target's facet; with friction their columns have the nodes
    of the old target facet e_{n−1} besides, eq. (9).
    """

    UU: tuple[Index, Index, Array]
    UΛ: tuple[Index, Index, Array]
    ΛU: tuple[Index, Index, Array]
    ΛΛ: tuple[Index, Index, Array]


class ContactPair:
    """A :class:`Contact` on a displacement space: its state at the last evaluation, slip history and outputs."""

    def __init__(self, contact: Contact, bodies: Bodies, stopwatch: Stopwatch) -> None:
        self.contact, self.name = contact, contact.name
        self.stopwatch = stopwatch
        self.comm, self.gdim = bodies.comm, bodies.gdim
        k = bodies.index(contact.contactor.mesh)
        self._body1 = bodies.bodies[k]
        self.facets = Facets.of(contact.contactor, self._body1.space)
        contactor = self.facets.gather()
        self.target = target_of(contact.target, bodies, contactor.size_of_facets)
        #: (nf, nodes) numbers of the contactor's nodes among all bodies'
        self.contactor_blocks: Index = bodies.nodes(k, self.facets.dofs)
        self._quadrature()
        #: the law between velocities instead of positions, for impact (dynamics.march sets it)
        self.impact: VelocityLevel | None = None
        self._last_points = self._points_at_end(contactor.blocks[contactor.end_nodes])
        self._contactor_fixed = self._at_contactor(self._body1.prescribed()) > 0
        self.multiplier = MultiplierSpace(self.facets, self.gdim if contact.friction else 1, self._redundant())
        self.slots = Slots(self.gdim, self.multiplier.components, contact.friction > 0)
        NΛ = np.einsum("qa,fiab->fqbi", self.N, self.multiplier.T)
        #: (n, nodes, components) multiplier shape functions, redundant nodes eliminated
        self.NΛ: Array = NΛ.reshape(-1, *NΛ.shape[2:])
        Q = self.multiplier.field.function_space
        self._nodal_maximum, area = fem.Function(Q), fem.Function(Q)
        np.add.at(
            area.x.array.reshape(-1, self.multiplier.components),
            self.multiplier.dofs,
            np.einsum("fq,fqbi->fbi", self.j, np.abs(NΛ)),
        )
        area.x.scatter_reverse(InsertMode.add)
        self._node_area = area.x.petsc_vec.copy()
        self._node_area.array[self._node_area.array_r == 0.0] = 1.0  # redundant nodes
        self._touch = 1e-12 * self.target.size  # gaps below are round-off

    # ---------------------------------------------------------------- set-up

    def _at_contactor(self, u: fem.Function) -> Array:
        """(nf, nodes, gdim) values of the contactor's body at its facets' nodes; ghosts are up to date."""
        return np.asarray(u.x.array.reshape(-1, self.gdim)[self.facets.dofs])

    def _quadrature(self) -> None:
        shape = self.facets.shape
        degree = self.contact.quadrature_degree
        if degree is not None and degree < 2 * shape.order:
            raise ValueError(
                f"{self.name}: quadrature_degree = {degree} has too few points to determine multipliers of order "
                f"{shape.order}; take at least {2 * shape.order}"
            )
        # a membrane has no bending stiffness: its pressure jumps at the edge of contact, inside a facet (docs/newton.md)
        default = (6 if self.contact.contactor.is_membrane and shape.dim == 1 else 2) * shape.order + 1
        points, weights = shape.quadrature(default if degree is None else degree)
        self.N, self._dN = shape.tabulate(points, 1)  # (nq, nodes), (nq, dim, nodes)
        area = np.linalg.norm(self._contactor_normal(self.facets.X), axis=2)
        #: (nf, nq) weight × reference area of each Gauss point (m², thickness included)
        self.j: Array = area * weights * self.contact.thickness
        self.facet_of_point: Index = np.repeat(np.arange(self.facets.size), len(weights))
        self.area = float(self.comm.allreduce(float(self.j.sum())))

    def _contactor_normal(self, X: Array) -> Array:
        """(nf, nq, gdim) outward normal × area ratio of the contactor with its nodes at X (nf, nodes, gdim)."""
        normal = surface_normal(np.einsum("qak,fki->fqai", self._dN, X))
        return normal * self.facets.orientation[:, None, None]

    def _redundant(self) -> NDArray[np.bool_]:
        """(nf, nodes, components) nodes prescribed on the contactor and, where they touch it, on the target too."""
        fixed = self._contactor_fixed.copy()
        facet, node = np.nonzero(fixed.any(axis=2))
        if not isinstance(self.target, DeformableTarget):
            fixed[:] = False
        elif len(facet):
            x = self.facets.X[facet, node]
            at = self.target.at_reference(x)
            on_target = self.target.fixed[self.target.facets[at.point.facet]]
            touching = np.linalg.norm(x - at.y, axis=1, keepdims=True) <= self.target.size
            fixed[facet, node] &= touching & (np.einsum("nk,nki->ni", np.abs(at.N), on_target) > 1 - 1e-6)
        return fixed if self.contact.friction else np.asarray(fixed.all(axis=2, keepdims=True))

    def surface_stiffness(self, diagonals: Sequence[fem.Function]) -> float:
        """The softer side's mean nodal stiffness per facet area (Pa/m), from the diagonals (N/m) of the bodies' matrices."""
        mine = next(d for d in diagonals if d.function_space is self._body1.space)
        own = self._at_contactor(mine).mean(axis=(1, 2)) / self.j.sum(axis=1)
        count = self.comm.allreduce(self.facets.size)
        contactor = self.comm.allreduce(float(own.sum())) / count
        return min(contactor, self.target.stiffness(diagonals, self.contact.thickness))

    def set_law(self, stiffness: float) -> None:
        """Fix ε_N and ε_T: the user's, or the bulk's `stiffness` at the two surfaces (Pa/m)."""
        c = self.contact
        default = SOFTER * stiffness
        εN = default if c.epsilon_normal is None else c.epsilon_normal
        εT = default if c.epsilon_tangential is None else c.epsilon_tangential
        self.stiffness, self.unit = stiffness, default
        self.ε = Augmentation(εN, εT)
        # the residual of an open point, ν λ_N/ε_N − λ_T/ε_T, turns with ν unless ε_N = ε_T
        self._same_ε = εN == εT or not c.friction
        self.law: Frictionless | Coulomb = Frictionless(self.ε)
        if c.friction:
            self.law = Coulomb(self.ε, c.friction, noise=εT * self._touch)

    def start(self) -> None:
        """Project for the first time; slip is counted from the present state. Points that touch count as closed.

        Raises:
            ValueError: on every rank, if contactor and target face the same way all over: one is the wrong side.
        """
        self.target.refresh()
        self._x = self.positions()
        self.at = self.target.project(self._x, None, None)
        self.commit()
        self.closed: NDArray[np.bool_] = self.at.facing & (self.at.g >= -self._touch)
        self.fresh = True  # until a step has converged
        self.begin()
        self.evaluate()
        normal = self._contactor_normal(self.facets.X + self._at_contactor(self._body1.u)).reshape(-1, self.gdim)
        cosine = np.einsum("ni,ni->n", normal, self.at.ν) / np.linalg.norm(normal, axis=1)
        comm = self.comm
        facing = comm.allreduce(int(self.at.facing.sum()))
        same_way = comm.allreduce(int((self.at.facing & (cosine > 0.5)).sum()))
        if facing and same_way == facing:
            raise ValueError(
                f"{self.name}: the target ({self.contact.target_name}) faces away from the contactor "
                f"(tag {self.contact.contactor.tag}) everywhere: pass the side of the body that faces it"
            )

    # ---------------------------------------------------------------- state

    def begin(self) -> None:
        """A new solve: points may choose their target facets again, and gaps are trusted as at first."""
        self.patience, self._guess = PATIENCE, self.fresh
        self._choose_facets()
        self._released = False

    def _choose_facets(self) -> None:
        """Let all points choose their target facets."""
        self._returns: Index = np.zeros(len(self.facet_of_point), dtype=np.int64)
        self._left: Index
        self._left, self._held = self._returns - 1, self._returns > 0

    def positions(self) -> Array:
        """(n, gdim) contactor points where the displacements have moved them."""
        X = self.facets.X + self._at_contactor(self._body1.u)
        return np.einsum("qa,fai->fqi", self.N, X).reshape(-1, self.gdim)

    def evaluate(self) -> None:
        """Closest points, slip and law at the displacements and the multiplier field; ghosts are up to date."""
        if self.impact is not None:
            self._evaluate_velocities(self.impact)
            return
        with self.stopwatch("projection"):
            self.target.refresh()
            self._x = self.positions()
            before = self.at.point.facet
            self.at = self.target.project(self._x, self.at.point, self._held)
            moved, returned = self.at.point.facet != before, self.at.point.facet == self._left
            self._returns += moved & returned
            self._left = np.where(moved, before, self._left)
            self._held = self._returns >= RETURNS
        with self.stopwatch("contact"):
            self.Λ = np.einsum("nai,nai->ni", self.NΛ, self.multiplier.own_nodal()[self.facet_of_point])
            self.s = self.slip() if self.contact.friction else None
            self._apply_law(np.where(self.closed, -np.inf, np.inf))

    def predict(self) -> None:
        """Velocity level: take the geometry from the present (predicted) positions, where the step's law will hold."""
        assert self.impact is not None
        self.target.refresh()
        x = self.positions()
        self.at = self.target.project(x, self.at.point, None)
        self.impact.predict(self.at, x, self._touch)
        self.restore(self.at.point)

    def moving_points(self) -> tuple[Array, Array]:
        """Velocity level: contactor points (n, gdim) and the step's target points (n, gdim), where they are now."""
        assert self.impact is not None
        self.target.refresh()
        return self.positions(), self.target.positions(self.impact.at.point, self.impact.at.N)

    @property
    def is_rigid(self) -> bool:
        """Whether the target is a rigid obstacle."""
        return isinstance(self.target, RigidTarget)

    def _evaluate_velocities(self, impact: VelocityLevel) -> None:
        with self.stopwatch("contact"):
            self.target.refresh()
            self._x = self.positions()
            moved = self.target.positions(impact.at.point, impact.at.N)
            self.at, self.s = impact.relative_motion(self._x, moved)
            self.Λ = np.einsum("nai,nai->ni", self.NΛ, self.multiplier.own_nodal()[self.facet_of_point])
            self._apply_law(np.where(impact.touches, 0.0, np.inf))
            self.closed = self.state.status != OPEN

    def _apply_law(self, threshold: Array) -> None:
        self.state: LawState = self.law.evaluate(self.Λ, self.at, self.s, threshold)

    def switch(self, residual: PETSc.Vec) -> None:
        """Let points open and close, as far as the gaps are known (``docs/newton.md``).

        `residual` is `unit` × the multiplier's residual with the points held open or closed as they were. Divided by the
        nodes' area it is how well the gap condition is met, the error e of all gaps. A point that was open closes where
        λ̂_N exceeds `patience`·ε_N e and is the deepest in its neighbourhood; one that was closed opens where λ̂_N is as far
        below zero. As Newton converges e vanishes and what remains is eq. (1).
        """
        if self.impact is not None:
            return  # on the frozen geometry of a time step the law itself decides
        error = residual.duplicate()
        error.pointwiseDivide(residual, self._node_area)
        e = error.norm(PETSc.NormType.NORM_INFINITY) / self.unit
        known = self.ε.normal * (self.patience * e + self._touch)
        λ, was_closed = self.state.λN_hat, self.closed
        close = np.maximum(known, DEEPEST * self._neighbourhood_maximum(np.where(was_closed, 0.0, λ)))
        release = -known
        if self._guess:  # no history: what presses weakly in an all-closed start may open at once
            weak = WEAK * self.comm.allreduce(float(λ[was_closed].max(initial=0.0)), MPI.MAX)
            if known < 0.1 * weak:
                release, self._guess = weak, False
        self._apply_law(np.where(was_closed, release, close))
        self.closed = self.state.status != OPEN

    def reaches_end(self) -> bool:
        """Whether a point is closed at the very end of the contactor or of the target (collective)."""
        closed = self.state.status != OPEN
        facets = self.target.facets[self.at.point.facet]
        at_end = self._last_points | (np.einsum("nk,nk->n", self.at.N, self.target.end_nodes[facets]) > 1 - AT_END)
        return bool(self.comm.allreduce(bool((closed & at_end).any()), MPI.LOR))

    def _points_at_end(self, ends: Index) -> NDArray[np.bool_]:
        """(n,) the Gauss points next to an end of the contactor, whose nodes have the global blocks `ends`."""
        V = self.facets.space
        own = V.dofmap.index_map.local_to_global(self.facets.dofs.ravel()).reshape(self.facets.dofs.shape)
        weight = np.einsum("qa,fa->fq", self.N, np.isin(own, ends))
        nearest = weight.max(axis=1, keepdims=True, initial=0.0)
        near: NDArray[np.bool_] = (nearest > 0.5) & (weight >= nearest - 1e-9)
        return near.ravel()

    def relative_motion(self) -> float:
        """How far the present displacements have moved closed points over the target since the last evaluation, in
        target facets (collective)."""
        if self.impact is not None:
            return 0.0
        self.target.refresh()
        moved = self.target.positions(self.at.point, self.at.N) - self.at.y
        size = np.linalg.norm(self.positions() - self._x - moved, axis=1)[self.state.status != OPEN]
        return self.comm.allreduce(float(size.max(initial=0.0)), MPI.MAX) / self.target.size

    def release_held(self) -> bool:
        """Let points that were held to a target facet choose again, once in a solve; whether there were any
        (collective)."""
        if self._released or not self.comm.allreduce(bool(self._held.any()), MPI.LOR):
            return False
        self._choose_facets()
        self._released = True
        return True

    def violation(self) -> float:
        """Largest |λ̂_N| (Pa) at a point held closed against λ̂_N < 0 or open against λ̂_N > 0, over what round-off
        explains, as a share of the largest pressure (collective)."""
        if self.impact is not None:
            return 0.0
        λ = np.where(self.at.facing, self.state.λN_hat, 0.0)
        wrong = np.where(self.closed, -λ, λ) - self.ε.normal * self._touch
        worst, largest = (self.comm.allreduce(float(v.max(initial=0.0)), MPI.MAX) for v in (wrong, self.state.p))
        return worst / max(largest, 1e-300) if worst > 0 else 0.0

    def _neighbourhood_maximum(self, λ: Array) -> Array:
        """(n,) the largest positive λ (n,) on a point's facet and the facets that share a node with it."""
        nf, nq = self.j.shape
        facet = np.where(self.at.facing, λ, 0.0).reshape(nf, nq).max(axis=1, initial=0.0)
        Q = self._nodal_maximum
        nodal = Q.x.array.reshape(-1, self.multiplier.components)
        nodal[:] = 0.0
        np.maximum.at(nodal[:, 0], self.multiplier.dofs, facet[:, None])
        Q.x.petsc_vec.ghostUpdate(addv=PETSc.InsertMode.MAX_VALUES, mode=PETSc.ScatterMode.REVERSE)
        Q.x.petsc_vec.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        return np.repeat(nodal[:, 0][self.multiplier.dofs].max(axis=1, initial=0.0), nq)

    def slip(self) -> Array:
        """s = V_T Δt = 𝐲 − φ₂(Y_{n−1}, t), eq. (5): (n, gdim) in m."""
        return self.at.y - self.target.positions(self.history, self._N_old)

    def commit(self) -> None:
        """The step has converged: Y_{n−1} ← Y."""
        self.restore(self.at.point)
        self.fresh = False

    def restore(self, history: TargetPoint, λN_hat: Array | None = None) -> None:
        """Count the slip from the target points `history`; with `λN_hat` (n,) expect the contact state that it says."""
        self.history = history.copy()
        if λN_hat is not None:
            self.closed = self.at.facing & (λN_hat >= -self.ε.normal * self._touch)
        self._N_old: Array = self.target.weights(history)

    def resume(self, history: TargetPoint, λN_hat: Array) -> None:
        """Take up a saved slip history and contact state at the present displacements."""
        self.at.point = history.copy()  # where the closest points are searched from
        self.begin()
        self.target.refresh()
        self._x = self.positions()
        self.at = self.target.project(self._x, self.at.point, None)
        self.restore(history, λN_hat)

    # ---------------------------------------------------------------- element arrays

    def _closed(self) -> Index:
        return np.flatnonzero(self.state.status != OPEN)

    def multiplier_residual(self) -> tuple[Index, Array]:
        """∫ r·N1 Λ* dS₀, eq. (4): global blocks (nf, nodes) and element vectors (nf, nodes, components)."""
        jr = self.j.reshape(-1, 1) * self.state.r
        values = (self.NΛ * jr[:, None, :]).reshape(*self.j.shape, *self.NΛ.shape[1:]).sum(axis=1)
        return self.multiplier.blocks, values

    def body_residual(self) -> list[tuple[Index, Array]]:
        """−∫ t·(N1 U1* − N2(η) U2*) dS₀, eq. (4), on the contactor's and the target's nodes; 0 where prescribed."""
        jt = self.j.reshape(-1, 1) * self.state.t
        on_contactor = -np.einsum("qa,fqi->fai", self.N, jt.reshape(*self.j.shape, self.gdim))
        closed = self._closed()
        on_target = self.at.N[closed][:, :, None] * jt[closed][:, None, :]
        nodes = self.target.facets[self.at.point.facet[closed]]
        return [
            (self.contactor_blocks, on_contactor * ~self._contactor_fixed),
            (self.target.blocks[nodes], on_target * ~self.target.fixed[nodes]),
        ]

    def tangent(self) -> Tangent:
        """Contact's share of the Jacobian, eq. (6), as j Bᵀ C B of every closed point."""
        act = self._closed() if self._same_ε else np.arange(len(self.facet_of_point))
        at, s = self.at.take(act), None if self.s is None else self.s[act]
        state = self.state.take(act)
        δ = vary(at, self.slots) if self.impact is None else vary_frozen(at, self.slots, self.impact.θ)
        δt, δr = self.law.linearise(state, self.Λ[act], at, s, δ)
        facet, j = self.facet_of_point[act], self.j.reshape(-1)[act]

        n, d, m = len(act), self.gdim, self.multiplier.components
        # rows: δ of −t (on N1 U1*), t (on N2 U2*), and t_i η^α (on N2,α U2*): the moving η moves the test function too
        moving = state.t[:, None, :, None] * δ.η[:, :, None, :]
        C = np.concatenate([np.stack([-δt, δt], axis=1), moving], axis=1) * j[:, None, None, None]
        rows, columns = self._row_operator(act, at), self._column_operator(act, at)
        NΛ, δr = self.NΛ[act], δr * j[:, None, None]
        z = d * self.slots.displacement_slots

        R, k, K = rows.shape[1], rows.shape[2], columns.shape[2]
        C_U = _apply_columns(C[..., :z].reshape(n, R * d, z), columns, d)  # (n, R·d, nodes, d)
        UU = (np.swapaxes(rows, 1, 2) @ C_U.reshape(n, R, d * K * d)).reshape(n, k, d, K, d)
        C_Λ = C[..., z:].reshape(n, R, d * m)
        UΛ = (np.swapaxes(rows, 1, 2) @ C_Λ).reshape(n, k, d, 1, m) * NΛ[:, None, None]
        r_U = _apply_columns(δr[..., :z], columns, d)  # (n, m, nodes, d)
        ΛU = NΛ[:, :, :, None, None] * r_U[:, None]

        ΛΛ_point = np.broadcast_to(np.eye(m) / self.ε.normal, (len(self.NΛ), m, m)).copy()
        ΛΛ_point *= self.j.reshape(-1, 1, 1)
        ΛΛ_point[act] = δr[..., z:]
        nf, nq = self.j.shape
        ΛΛ = self.NΛ[:, :, :, None, None] * ΛΛ_point[:, None, :, None, :] * self.NΛ[:, None, None]
        ΛΛ = ΛΛ.reshape(nf, nq, *ΛΛ.shape[1:]).sum(axis=1)

        runs, target, old = self._runs(facet, at, act)
        U_rows = np.concatenate([self.contactor_blocks[facet[runs]], self.target.blocks[target]], axis=1)
        fixed = np.concatenate([self._contactor_fixed[facet[runs]], self.target.fixed[target]], axis=1)
        U_columns = np.concatenate([U_rows, self.target.blocks[old]], axis=1) if self.contact.friction else U_rows
        Λ_nodes, free = self.multiplier.blocks[facet[runs]], ~fixed[:, :, :, None, None]
        return Tangent(
            (U_rows, U_columns, _add_runs(UU, runs) * free),
            (U_rows, Λ_nodes, _add_runs(UΛ, runs) * free),
            (Λ_nodes, U_columns, _add_runs(ΛU, runs)),
            (self.multiplier.blocks, self.multiplier.blocks, ΛΛ),
        )

    def _row_operator(self, act: Index, at: Projection) -> Array:
        """(n, 2 + dim, nodes of the contactor's and the target's facet): N1; N2, N2,α."""
        N1 = np.tile(self.N, (self.facets.size, 1))[act]
        n, k1 = N1.shape
        B = np.zeros((n, 2 + self.slots.dim, k1 + at.N.shape[1]))
        B[:, 0, :k1], B[:, 1, k1:], B[:, 2:, k1:] = N1, at.N, at.dN
        return B

    def _column_operator(self, act: Index, at: Projection) -> Array:
        """The row operator, and with friction N2(η_{n−1}) on the nodes of the old target facet."""
        rows = self._row_operator(act, at)
        if not self.contact.friction:
            return rows
        N_old = self._N_old[act]
        n, r, k = rows.shape
        B = np.zeros((n, r + 1, k + N_old.shape[1]))
        B[:, :r, :k], B[:, r, k:] = rows, N_old
        return B

    def _runs(self, facet: Index, at: Projection, act: Index) -> tuple[Index, Index, Index]:
        """Points that follow each other with the same facets share one element matrix: where each run starts, and the
        node numbers (runs, nodes) of its target facet and old target facet."""
        old = self.history.facet[act]
        key = np.stack([facet, at.point.facet, old if self.contact.friction else facet])
        starts = np.flatnonzero(np.r_[True, (np.diff(key, axis=1) != 0).any(axis=0)][: key.shape[1]])
        return starts, self.target.facets[at.point.facet[starts]], self.target.facets[old[starts]]

    # ---------------------------------------------------------------- sparsity

    def couples(self) -> Index:
        """Where the matrices have entries: the couples (contactor facet, target facet, old target facet) of the closed
        points, sorted, each as one integer."""
        closed = self._closed() if self._same_ε else np.arange(len(self.facet_of_point))
        target = self.at.point.facet[closed]
        old = self.history.facet[closed] if self.contact.friction else target
        return np.unique(np.ravel_multi_index((self.facet_of_point[closed], target, old), self._couple_shape))

    def with_neighbours(self, couples: Index) -> Index:
        """Couples with the neighbours of their target facets, so that the pattern outlives a point's slip to the next
        facet. On a curve only: on a surface the fill costs more than the new factorisations."""
        if self.target.dim > 1:
            return couples
        facet, target, old = np.unravel_index(couples, self._couple_shape)
        near = self.target.neighbours
        target, old = near[target][:, :, None], near[old][:, None, :]
        if not self.contact.friction:
            target, old = target[:, :, 0], target[:, :, 0]
        shape = np.broadcast_shapes(target.shape, old.shape)
        facet = facet.reshape(-1, *[1] * (len(shape) - 1))
        wide = [np.broadcast_to(a, shape).ravel() for a in (facet, target, old)]
        return np.unique(np.ravel_multi_index(wide, self._couple_shape))

    @property
    def _couple_shape(self) -> tuple[int, int, int]:
        return max(self.facets.size, 1), len(self.target.facets), len(self.target.facets)

    def pattern(self, couples: Index) -> list[tuple[Index, Index, Array]]:
        """Zero element matrices (UU, UΛ, ΛU, ΛΛ) with the global blocks of the given couples."""
        facet, target, old = np.unravel_index(couples, self._couple_shape)
        bodies = [self.contactor_blocks[facet], self.target.blocks[self.target.facets[target]]]
        rows = np.concatenate(bodies, axis=1)
        past = [self.target.blocks[self.target.facets[old]]] if self.contact.friction else []
        columns = np.concatenate([rows, *past], axis=1)
        Λ, own, d, m = self.multiplier.blocks[facet], self.multiplier.blocks, self.gdim, self.multiplier.components
        places = [(rows, columns, d, d), (rows, Λ, d, m), (Λ, columns, m, d), (own, own, m, m)]
        return [(i, j, np.zeros((len(i), i.shape[1], a, j.shape[1], b))) for i, j, a, b in places]

    # ---------------------------------------------------------------- outputs

    def force(self) -> Array:
        """(gdim,) resultant of the contact tractions on the contactor (N), collective."""
        return self.comm.allreduce(np.einsum("n,ni->i", self.j.reshape(-1), self.state.t))

    def moment(self, about: Sequence[float]) -> Array:
        """Moment of the contact tractions on the contactor about a point (N m; 3 components, or 1 in the plane),
        collective. A rigid obstacle feels the opposite, as it does of :meth:`force`."""
        arm, t = self._x - np.asarray(about), self.j.reshape(-1, 1) * self.state.t
        if self.gdim == 3:
            return np.asarray(self.comm.allreduce(np.cross(arm, t).sum(axis=0)))
        return np.atleast_1d(self.comm.allreduce(float(np.sum(arm[:, 0] * t[:, 1] - arm[:, 1] * t[:, 0]))))

    def nodal_forces(self) -> float:
        """Norm of the contactor's nodal contact forces ∫ N |t| (N), collective: the scale of both residuals."""
        nf, nq = self.j.shape
        size = (self.j * np.linalg.norm(self.state.t, axis=1).reshape(nf, nq)) @ np.abs(self.N)
        return float(np.sqrt(self.comm.allreduce(float(np.sum(size**2)))))

    def largest_pressure(self) -> float:
        """Largest nominal contact pressure at a Gauss point (Pa), collective."""
        return float(self.comm.allreduce(float(self.state.p.max(initial=0.0)), MPI.MAX))

    def contact_area(self) -> float:
        """Current area of the closed part of the contactor (m²; length × thickness in the plane), collective."""
        current = np.linalg.norm(self._contactor_normal(self.facets.X + self._at_contactor(self._body1.u)), axis=2)
        reference = np.linalg.norm(self._contactor_normal(self.facets.X), axis=2)
        closed = (self.state.status != OPEN).reshape(self.j.shape)
        return float(self.comm.allreduce(float((self.j * current / reference)[closed].sum())))

    def closed_fraction(self) -> float:
        """Closed part of the contactor's reference area, collective."""
        return self._share(self.state.status != OPEN)

    def stick_fraction(self) -> float:
        """Sticking part of the contactor's reference area, collective."""
        return self._share(self.state.status == STICK)

    def _share(self, points: NDArray[np.bool_]) -> float:
        return float(self.comm.allreduce(float(self.j.reshape(-1)[points].sum()))) / self.area

    def points(self) -> Array:
        """(n, gdim) reference positions of this rank's Gauss points (m)."""
        return np.einsum("qa,fai->fqi", self.N, self.facets.X).reshape(-1, self.gdim)


def _apply_columns(C: Array, B: Array, d: int) -> Array:
    """Σ_s C[…, s, j] B[s, b]: C (n, R, slots × d) and B (n, slots, nodes) to (n, R, nodes, d)."""
    n, R, z = C.shape
    return np.swapaxes(np.swapaxes(C.reshape(n, R, z // d, d), 2, 3) @ B[:, None], 2, 3)


def _add_runs(values: Array, starts: Index) -> Array:
    return np.add.reduceat(values, starts, axis=0) if len(starts) else values
