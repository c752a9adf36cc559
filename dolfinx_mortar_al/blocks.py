"""Element vectors and matrices of a pair, eqs. (4) and (6)–(10), and where in the global matrices they stand.

At each point the tangent is j Bᵀ C B: B holds shape functions, C the small matrix of `law` and `variation`. Points that
follow each other on the same facets share an element matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.kinematics import Kinematics
from dolfinx_mortar_al.law import OPEN, Coulomb, Frictionless, LawState
from dolfinx_mortar_al.multiplier import MultiplierSpace
from dolfinx_mortar_al.projection import Projection
from dolfinx_mortar_al.targets import Target
from dolfinx_mortar_al.variation import Slots

__all__ = ["Blocks", "Tangent"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]


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


class Blocks:
    """A pair's element arrays.

    Args:
        points: of integration.
        contactor: (nf, nodes) numbers of the contactor's nodes among all bodies'; fixed: (nf, nodes, gdim) prescribed ones.
        target, multiplier: of the pair.
        friction: whether there is any.
    """

    def __init__(
        self,
        points: IntegrationPoints,
        contactor: Index,
        fixed: Bool,
        target: Target,
        multiplier: MultiplierSpace,
        friction: bool,
    ) -> None:
        self.target, self.multiplier = target, multiplier
        self.contactor, self.fixed, self.friction = contactor, fixed, friction
        self.gdim = fixed.shape[2]
        self.slots = Slots(self.gdim, multiplier.components, friction, target.uses_rays)
        self.take(points)

    def take(self, points: IntegrationPoints) -> None:
        """Integrate at these points from now on."""
        self.points = points
        #: (n, nodes, components) multiplier shape functions, redundant nodes eliminated
        self.NΛ: Array = self.multiplier.at(points.facet, points.η)

    def multiplier_at_points(self) -> Array:
        """(n, components) the multiplier field at the points (Pa)."""
        return np.asarray((self.NΛ * self.multiplier.own_nodal()[self.points.facet]).sum(axis=1))

    # ---------------------------------------------------------------- residual, eq. (4)

    def multiplier_residual(self, state: LawState) -> tuple[Index, Array]:
        """∫ r·N1 Λ* dS₀: global blocks (nf, nodes) and element vectors (nf, nodes, components)."""
        values = self.NΛ * (self.points.j[:, None] * state.r)[:, None, :]
        return self.multiplier.blocks, self.points.sum_by_facet(values)

    def body_residual(self, state: LawState, at: Projection) -> list[tuple[Index, Array]]:
        """−∫ t·(N1 U1* − N2(η) U2*) dS₀, on the contactor's and the target's nodes; 0 where prescribed."""
        jt = self.points.j[:, None] * state.t
        closed = np.flatnonzero(state.status != OPEN)
        on_contactor = self.points.sum_by_facet(-self.points.N[:, :, None] * jt[:, None, :])
        on_target = at.N[closed][:, :, None] * jt[closed][:, None, :]
        nodes = self.target.facets[at.point.facet[closed]]
        return [
            (self.contactor, on_contactor * ~self.fixed),
            (self.target.blocks[nodes], on_target * ~self.target.fixed[nodes]),
        ]

    # ---------------------------------------------------------------- tangent, eqs. (6)–(10)

    def tangent(
        self, law: Frictionless | Coulomb, state: LawState, Λ: Array, kinematics: Kinematics, act: Index
    ) -> Tangent:
        """Contact's share of the Jacobian from the points `act`; all others are open with r = Λ/ε."""
        at, s = kinematics.at.take(act), None if kinematics.s is None else kinematics.s[act]
        δ, state = kinematics.vary(act, self.slots), state.take(act)
        δt, δr = law.linearise(state, Λ[act], at, s, δ)
        facet, j = self.points.facet[act], self.points.j[act]

        n, d, m = len(act), self.gdim, self.multiplier.components
        # rows: δ of −t (on N1 U1*), t (on N2 U2*), and t_i η^α (on N2,α U2*): the moving η moves the test function too
        moving = state.t[:, None, :, None] * δ.η[:, :, None, :]
        C = np.concatenate([np.stack([-δt, δt], axis=1), moving], axis=1) * j[:, None, None, None]
        rows, columns = self._rows(act, at), self._columns(act, at, kinematics)
        NΛ, δr = self.NΛ[act], δr * j[:, None, None]
        z = d * len(self.slots.names)

        R, k, K = rows.shape[1], rows.shape[2], columns.shape[2]
        C_U = _apply_columns(C[..., :z].reshape(n, R * d, z), columns, d)  # (n, R·d, nodes, d)
        UU = (np.swapaxes(rows, 1, 2) @ C_U.reshape(n, R, d * K * d)).reshape(n, k, d, K, d)
        C_Λ = C[..., z:].reshape(n, R, d * m)
        UΛ = (np.swapaxes(rows, 1, 2) @ C_Λ).reshape(n, k, d, 1, m) * NΛ[:, None, None]
        r_U = _apply_columns(δr[..., :z], columns, d)  # (n, m, nodes, d)
        ΛU = NΛ[:, :, :, None, None] * r_U[:, None]

        ΛΛ_point = np.broadcast_to(np.eye(m) / law.ε.normal, (self.points.size, m, m)) * self.points.j[:, None, None]
        ΛΛ_point[act] = δr[..., z:]
        ΛΛ = self.points.sum_by_facet(
            self.NΛ[:, :, :, None, None] * ΛΛ_point[:, None, :, None, :] * self.NΛ[:, None, None]
        )

        runs, target, old = self._runs(facet, at, kinematics.history.facet[act])
        U_rows = np.concatenate([self.contactor[facet[runs]], self.target.blocks[target]], axis=1)
        fixed = np.concatenate([self.fixed[facet[runs]], self.target.fixed[target]], axis=1)
        U_columns = np.concatenate([U_rows, self.target.blocks[old]], axis=1) if self.friction else U_rows
        Λ_nodes, UU, UΛ = self.multiplier.blocks[facet[runs]], _add_runs(UU, runs), _add_runs(UΛ, runs)
        UU[fixed] = UΛ[fixed] = 0.0
        return Tangent(
            (U_rows, U_columns, UU),
            (U_rows, Λ_nodes, UΛ),
            (Λ_nodes, U_columns, _add_runs(ΛU, runs)),
            (self.multiplier.blocks, self.multiplier.blocks, ΛΛ),
        )

    def _rows(self, act: Index, at: Projection) -> Array:
        """(n, 2 + dim, nodes of the contactor's and the target's facet): N1; N2, N2,α."""
        N1 = self.points.N[act]
        n, k1 = N1.shape
        B = np.zeros((n, 2 + self.slots.dim, k1 + at.N.shape[1]))
        B[:, 0, :k1], B[:, 1, k1:], B[:, 2:, k1:] = N1, at.N, at.dN
        return B

    def _columns(self, act: Index, at: Projection, kinematics: Kinematics) -> Array:
        """(n, slots, nodes): the rows' operator; with rays N1,α; with friction N2(η_{n−1}) on the old target facet."""
        rows = self._rows(act, at)
        n, r, k = rows.shape
        old = kinematics.weights[act] if self.friction else np.zeros((n, 0))
        B = np.zeros((n, len(self.slots.names), k + old.shape[1]))
        B[:, :r, :k] = rows
        if self.slots.rays:
            dN1 = self.points.dN[act]
            B[:, r : r + self.slots.dim, : dN1.shape[2]] = dN1
        if self.friction:
            B[:, -1, k:] = old
        return B

    def _runs(self, facet: Index, at: Projection, old: Index) -> tuple[Index, Index, Index]:
        """Points that follow each other with the same facets share one element matrix: where each run starts, and the
        node numbers (runs, nodes) of its target facet and old target facet."""
        key = np.stack([facet, at.point.facet, old if self.friction else facet])
        starts = np.flatnonzero(np.r_[True, (np.diff(key, axis=1) != 0).any(axis=0)][: key.shape[1]])
        return starts, self.target.facets[at.point.facet[starts]], self.target.facets[old[starts]]

    # ---------------------------------------------------------------- sparsity

    def couples(self, kinematics: Kinematics, act: Index) -> Index:
        """Where the matrices have entries: the couples (contactor facet, target facet, old target facet) of the points
        `act`, sorted, each as one integer."""
        target = kinematics.at.point.facet[act]
        old = kinematics.history.facet[act] if self.friction else target
        return np.unique(np.ravel_multi_index((self.points.facet[act], target, old), self._couple_shape))

    def with_neighbours(self, couples: Index) -> Index:
        """Couples with the neighbours of their target facets, so that the pattern outlives a point's slip to the next
        facet. On a curve only: on a surface the fill costs more than the new factorisations."""
        if self.target.dim > 1:
            return couples
        facet, target, old = np.unravel_index(couples, self._couple_shape)
        near = self.target.neighbours
        target, old = near[target][:, :, None], near[old][:, None, :]
        if not self.friction:
            target, old = target[:, :, 0], target[:, :, 0]
        shape = np.broadcast_shapes(target.shape, old.shape)
        facet = facet.reshape(-1, *[1] * (len(shape) - 1))
        wide = [np.broadcast_to(a, shape).ravel() for a in (facet, target, old)]
        return np.unique(np.ravel_multi_index(wide, self._couple_shape))

    @property
    def _couple_shape(self) -> tuple[int, int, int]:
        return max(self.points.facets.size, 1), len(self.target.facets), len(self.target.facets)

    def pattern(self, couples: Index) -> list[list[tuple[Index, Index, Array]]]:
        """For UU, UΛ, ΛU and ΛΛ: zero element matrices with global blocks, wherever the given couples have entries."""
        facet, target, old = np.unravel_index(couples, self._couple_shape)
        on_target, d, m = self.target.blocks[self.target.facets], self.gdim, self.multiplier.components
        rows = [(facet, self.contactor, d), (target, on_target, d)]
        columns = [*rows, (old, on_target, d)] if self.friction else rows
        all_facets = np.arange(len(self.contactor))
        Λ, own = (facet, self.multiplier.blocks, m), (all_facets, self.multiplier.blocks, m)
        places: list[tuple[Any, Any]] = [(rows, columns), (rows, [Λ]), ([Λ], columns), ([own], [own])]
        return [[_zeros(i, j) for i in first for j in second] for first, second in places]


def _zeros(rows: tuple[Index, Index, int], columns: tuple[Index, Index, int]) -> tuple[Index, Index, Array]:
    """An element matrix of zeros for each different pair of facets (m,), with their blocks; `rows` and `columns` are the
    facets, the blocks (nf, nodes) of all facets, and the components."""
    (i, blocks_i, a), (j, blocks_j, b) = rows, columns
    i, j = np.divmod(np.unique(i * len(blocks_j) + j), max(len(blocks_j), 1))
    return blocks_i[i], blocks_j[j], np.zeros((len(i), blocks_i.shape[1], a, blocks_j.shape[1], b))


def _apply_columns(C: Array, B: Array, d: int) -> Array:
    """Σ_s C[…, s, j] B[s, b]: C (n, R, slots × d) and B (n, slots, nodes) to (n, R, nodes, d)."""
    n, R, z = C.shape
    return np.swapaxes(np.swapaxes(C.reshape(n, R, z // d, d), 2, 3) @ B[:, None], 2, 3)


def _add_runs(values: Array, starts: Index) -> Array:
    return np.add.reduceat(values, starts, axis=0) if len(starts) else values
