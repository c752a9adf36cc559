"""Element vectors and matrices of a pair, eqs. (4) and (6)–(10), and where in the global matrices they stand.

At each point the tangent is j Bᵀ C B: B holds shape functions, C the small matrix of `law` and `variation`. Points that
follow each other on the same facets share an element matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.corners import SharpCorners
from dolfinx_mortar_al.frames import nodal_normals, rotation
from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.kinematics import Kinematics
from dolfinx_mortar_al.law import OPEN, Coulomb, Frictionless, LawState
from dolfinx_mortar_al.moving_cuts import MovingCuts
from dolfinx_mortar_al.multiplier import MultiplierSpace
from dolfinx_mortar_al.projection import Projection
from dolfinx_mortar_al.reductions import all_over
from dolfinx_mortar_al.smoothing import products_of_gradients
from dolfinx_mortar_al.targets import Target
from dolfinx_mortar_al.zone_width import ZoneWidth

__all__ = ["Blocks", "Tangent", "apply_columns", "sums_of_products"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]


@dataclass
class Tangent:
    """Element matrices (m, rows, components, columns, components) of eq. (6), with global block indices (m, nodes).

    The bodies' rows are the nodes of the contactor's and the target's facet; their columns may have the nodes of one more
    target facet, with friction those of e_{n−1}, eq. (9).
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
    """

    def __init__(
        self,
        points: IntegrationPoints,
        contactor: Index,
        fixed: Bool,
        target: Target,
        multiplier: MultiplierSpace,
        corners: SharpCorners | None = None,
    ) -> None:
        self.corners = corners
        self.target, self.multiplier = target, multiplier
        self.contactor, self.fixed = contactor, fixed
        self.gdim = fixed.shape[2]
        #: (nf, multiplier nodes) nodes whose multiplier is no matter of a facet's open points, None if there are none
        self.left_out: Bool | None = None
        #: (nf, nodes) nodes that have no part in a facet at a sharp corner, None where there are none
        self.left_out_at_corners: Bool | None = None
        # (nf, nodes × components, nodes × components) what may hold the multiplier smooth, None where nothing does
        self._smoothing: Array | None = None
        self._gradients: Array | None = None
        #: whether both are to stay as they are, whatever opens or closes
        self.holds_facets = False
        #: (nf,) how much of it counts
        self.smoothed: Array = np.zeros(len(contactor))
        self._gauss = points
        self.take(points)

    def take(self, points: IntegrationPoints) -> None:
        """Integrate at these points from now on."""
        self.points = points
        multiplier = self.multiplier
        N = multiplier.shape.tabulate(points.η)[0]
        if self.corners is not None:  # (n, nodes) integrals of the shape functions about each point
            self._weights: Array = np.abs(N) * points.j[:, None]
        # (n, nodes, own nodes, components): shape functions, with redundant nodes eliminated
        self._nodal = N[:, :, None, None] * np.moveaxis(multiplier.T, 1, 3)[points.facet]
        self._along: Array | None = None
        self.turn(None)

    def renew(self) -> None:
        """The multiplier's nodes that count are others now."""
        self.take(self.points)
        self._gradients = None
        if self._smoothing is not None:
            self.hold_smooth(self._κ, self._width)

    def turn(self, ν: Array | None) -> None:
        """Let the multiplier's normal part be that along ν (n, gdim), or take its components in global axes (collective)."""
        known = ν is not None and self._along is not None and bool(np.array_equal(ν, self._along))
        if ν is not None and all_over(self.multiplier.submesh.comm, known):  # a time step holds its directions
            return
        self._along = None if ν is None else ν.copy()
        #: (n, components, nodes × components) the multiplier at each point from its facet's unknowns
        self.NΛ: Array = self._masked(whole := self._interpolation(ν))
        self._whole = whole

    @property
    def is_smoothing(self) -> bool:
        """Whether anything may hold the multiplier smooth."""
        return self._smoothing is not None

    def hold_smooth(self, κ: Array, width: ZoneWidth) -> None:
        """Add ∫ κ ∇Λ·∇δΛ dS₀ to eq. (4), κ (nf,) in m³/Pa, on closed facets amid a zone that is wide enough."""
        if self._gradients is None:
            self._gradients = products_of_gradients(self._gauss, self.multiplier)
        self._κ, self._width = κ, width
        self._smoothing = κ[:, None, None] * self._gradients

    def leave_rough(self) -> None:
        """Add nothing of the kind."""
        self._smoothing, self.smoothed = None, np.zeros(len(self.contactor))

    def smooth(self, closed: Bool, counts: Bool) -> None:
        """Let what holds the multiplier smooth count on facets that are closed altogether, when the points `closed` (n,) are,
        without those at sharp corners, in which some nodes have no part; `counts` (n,) are points with more than a trifling
        part in the multiplier's equation (collective)."""
        if self._smoothing is None or self.holds_facets:
            return
        zone = np.zeros(len(self.contactor), dtype=bool)
        zone[self.points.facet[closed]] = True
        open_ = self.points.sum_by_facet((~closed & counts).astype(float)) > 0
        if self.left_out_at_corners is not None:
            open_ |= np.any(self.left_out_at_corners, axis=1)
        self.smoothed = np.where(open_, 0.0, self._width.share(zone))

    def _smoothed(self) -> Array | None:
        """(nf, …) what holds the multiplier smooth now."""
        return None if self._smoothing is None else self.smoothed[:, None, None] * self._smoothing

    def leave_out_at_corners(self, closed: Bool) -> bool:
        """Where the contactor has sharp corners, choose in which facets their nodes have a part, in the multiplier and in its
        tests, when the points `closed` (n,) are; whether that is a change on this rank (collective)."""
        if self.corners is None or (self.holds_facets and self.left_out_at_corners is not None):
            return False
        whole, part = (self.points.sum_by_facet(w) for w in (self._weights, self._weights * closed[:, None]))
        out = self.corners.left_out(whole, part)
        if self.left_out_at_corners is not None and np.array_equal(out, self.left_out_at_corners):
            return False
        self.left_out_at_corners = out
        self.NΛ = self._masked(self._whole)
        return True

    def keep_at_corners(self) -> None:
        """Let all nodes have a part in all of their facets, whatever is closed, from now on."""
        self.corners = self.left_out_at_corners = None
        self.NΛ = self._whole

    def _masked(self, NΛ: Array, act: Index | None = None) -> Array:
        """The multiplier's interpolation (n, components, nodes × components), at all points or those `act`, without the nodes
        that have no part in it."""
        if self.left_out_at_corners is None or not self.left_out_at_corners.any():
            return NΛ
        facet = self.points.facet if act is None else self.points.facet[act]
        out = np.repeat(self.left_out_at_corners[facet], self.multiplier.components, axis=1)
        return np.where(out[:, None], 0.0, NΛ)

    def interpolation(self, ν: Array | None) -> Array:
        """(n, components, nodes × components) the multiplier from its facet's unknowns, its normal part along ν (n, gdim); in
        global axes if there is none, or no friction (collective)."""
        return self._masked(self._interpolation(ν))

    def _interpolation(self, ν: Array | None) -> Array:
        """The same with all nodes."""
        n, _, nodes, m = self._nodal.shape
        if ν is None or m == 1:
            return _in_global_axes(self._nodal)
        at_nodes = nodal_normals(self.multiplier, self.points, ν)
        turned = rotation(at_nodes[self.points.facet], ν[:, None])
        return np.asarray(np.einsum("naik,nabk->nibk", turned, self._nodal).reshape(n, m, nodes * m))

    def multiplier_at_points(self) -> Array:
        """(n, components) the multiplier field at the points (Pa)."""
        nodal = self.multiplier.own_nodal()[self.points.facet].reshape(*self.NΛ[:, 0].shape, 1)
        return np.asarray((self.NΛ @ nodal)[:, :, 0])

    def _tests(self, state: LawState, share: Array) -> Array:
        """(n, components, nodes × components) the multiplier's test functions."""
        return self.weighted(self.NΛ, state, share)

    def weighted(self, tests: Array, state: LawState, share: Array, act: Index | None = None) -> Array:
        """Test functions (n, components, nodes × components) at all points, or at those `act`, each as far as it counts:
        `share` (n,)."""
        facet, open_ = self.points.facet, state.status == OPEN
        if act is not None:
            facet, open_, share = facet[act], open_[act], share[act]
        if self.left_out is not None:
            out = self.left_out[facet] & open_[:, None]
            tests = np.where(np.repeat(out, self.multiplier.components, axis=1)[:, None], 0.0, tests)
        if (share < 1.0).any():
            tests = share[:, None, None] * tests
        return tests

    def along_facets(self, act: Index) -> Array:
        """(n, components, nodes × components) derivative along the facet (η) of the multiplier's interpolation in global axes
        at the points `act` of curves."""
        points, multiplier = self.points, self.multiplier
        slope = multiplier.shape.tabulate(points.η[act], 1)[1][:, 0]
        nodal = slope[:, :, None, None] * np.moveaxis(multiplier.T, 1, 3)[points.facet[act]]
        return self._masked(_in_global_axes(nodal), act)

    # ---------------------------------------------------------------- residual, eq. (4)

    def multiplier_residual(self, state: LawState, share: Array) -> tuple[Index, Array]:
        """∫ r·δΛ dS₀ and what holds Λ smooth: global blocks (nf, nodes) and element vectors (nf, nodes, components)."""
        values = ((self.points.j[:, None] * state.r)[:, None] @ self._tests(state, share))[:, 0]
        blocks, total = self.multiplier.blocks, self.points.sum_by_facet(values)
        smoothing = self._smoothed()
        if smoothing is not None:
            total += (smoothing @ self.multiplier.own_nodal().reshape(*total.shape, 1))[:, :, 0]
        return blocks, total.reshape(*blocks.shape, self.multiplier.components)

    def body_residual(
        self, state: LawState, kinematics: Kinematics, *, reactions: bool = False
    ) -> list[tuple[Index, Array]]:
        """What contact adds to the residual at the contactor's and the target's nodes (N): minus its forces on them; where
        prescribed 0, or with `reactions` what the support must bear."""
        forces, j, at = kinematics.forces(state), self.points.j, kinematics.at
        on_contactor = self.points.N[:, :, None] * (j[:, None] * forces.contactor)[:, None, :]
        if forces.tangents is not None:
            on_contactor += np.swapaxes(self.points.dN, 1, 2) @ (j[:, None, None] * forces.tangents)
        closed = np.flatnonzero(state.status != OPEN)
        on_target = at.N[closed][:, :, None] * (j[:, None] * forces.target)[closed][:, None, :]
        nodes = self.target.facets[at.point.facet[closed]]
        parts = [
            (self.contactor, self.points.sum_by_facet(on_contactor), self.fixed),
            (self.target.blocks[nodes], on_target, self.target.fixed[nodes]),
        ]
        return [(blocks, values if reactions else values * ~fixed) for blocks, values, fixed in parts]

    # ---------------------------------------------------------------- tangent, eqs. (6)–(10)

    def tangent(
        self, law: Frictionless | Coulomb, state: LawState, Λ: Array, kinematics: Kinematics, act: Index
    ) -> Tangent:
        """Contact's share of the Jacobian from the points `act`; all others are open with r = Λ/ε."""
        slots = kinematics.slots(self.multiplier.components)
        C, δr = kinematics.linearise(law, state.take(act), Λ[act], act, slots)
        facet, j = self.points.facet[act], self.points.j[act]
        C *= j[:, None, None, None]
        rows, columns = kinematics.rows(act), kinematics.columns(act)

        n, d, m = len(act), self.gdim, self.multiplier.components
        tests = self._tests(state, kinematics.share)
        NΛ, δr = self.NΛ[act], δr * j[:, None, None]
        nodes = NΛ.shape[2] // m
        z = d * len(slots.names)

        R, k, K = rows.shape[1], rows.shape[2], columns.shape[2]
        C_U = apply_columns(C[..., :z].reshape(n, R * d, z), columns, d)  # (n, R·d, nodes, d)
        runs, target, extra = self._runs(facet, kinematics, act)
        UU = sums_of_products(rows, C_U.reshape(n, R, d * K * d), runs).reshape(-1, k, d, K, d)
        C_Λ = C[..., z:].reshape(n, R, d * m)
        on_rows = np.swapaxes((np.swapaxes(rows, 1, 2) @ C_Λ).reshape(n, k * d, m), 1, 2)
        UΛ = sums_of_products(on_rows, NΛ, runs).reshape(-1, k, d, nodes, m)
        r_U = apply_columns(δr[..., :z], columns, d)  # (n, m, nodes, d)
        ΛU = sums_of_products(tests[act], r_U.reshape(n, m, K * d), runs).reshape(-1, nodes, m, K, d)

        ΛΛ_point = law.open_slope(kinematics.at.ν) * self.points.j[:, None, None]
        ΛΛ_point[act] = δr[..., z:]
        ΛΛ = self.points.sum_by_facet(np.swapaxes(tests, 1, 2) @ ΛΛ_point @ self.NΛ)
        smoothing = self._smoothed()
        if smoothing is not None:
            ΛΛ += smoothing

        U_rows = np.concatenate([self.contactor[facet[runs]], self.target.blocks[target]], axis=1)
        fixed = np.concatenate([self.fixed[facet[runs]], self.target.fixed[target]], axis=1)
        U_columns = U_rows if extra is None else np.concatenate([U_rows, self.target.blocks[extra]], axis=1)
        Λ_nodes = self.multiplier.blocks[facet[runs]]
        UU[fixed] = UΛ[fixed] = 0.0
        return Tangent(
            (U_rows, U_columns, UU),
            (U_rows, Λ_nodes, UΛ),
            (Λ_nodes, U_columns, ΛU),
            (self.multiplier.blocks, self.multiplier.blocks, ΛΛ.reshape(len(ΛΛ), nodes, m, nodes, m)),
        )

    def _runs(self, facet: Index, kinematics: Kinematics, act: Index) -> tuple[Index, Index, Index | None]:
        """Points that follow each other with the same facets share one element matrix: where each run starts, and the
        node numbers (runs, nodes) of its target facet and of the extra one."""
        target, extra = kinematics.at.point.facet[act], kinematics.extra
        more = facet if extra is None else extra.facet[act]
        new = np.ones(len(facet), dtype=bool)
        new[1:] = (facet[1:] != facet[:-1]) | (target[1:] != target[:-1]) | (more[1:] != more[:-1])
        starts = np.flatnonzero(new)
        facets = self.target.facets
        return starts, facets[target[starts]], None if extra is None else facets[more[starts]]

    # ---------------------------------------------------------------- sparsity

    def couples(self, kinematics: Kinematics, act: Index) -> Index:
        """Where the matrices have entries: the couples (contactor facet, target facet, extra target facet) of the points
        `act`, sorted, each as one integer."""
        target, extra = kinematics.at.point.facet[act], kinematics.extra
        more = target if extra is None else extra.facet[act]
        couples = [self.points.facet[act], target, more]
        if (cuts := self.points.cuts) is not None:
            moved = cuts.facet[cuts.cut], self.faced_at_cuts(cuts, kinematics.at), cuts.end[cuts.cut]
            couples = [np.concatenate(both) for both in zip(couples, moved, strict=True)]
        return np.unique(np.ravel_multi_index(couples, self._couple_shape))

    def faced_at_cuts(self, cuts: MovingCuts, at: Projection) -> Index:
        """(m,) target facets that the points of the cuts face; where they face none, one at the cut's end."""
        return np.where(at.facing[cuts.point], at.point.facet[cuts.point], cuts.end[cuts.cut])

    def with_neighbours(self, couples: Index, kinematics: Kinematics) -> Index:
        """Couples with the neighbours of their target facets, so that the pattern outlives a point's slip to the next
        facet."""
        facet, target, more = np.unravel_index(couples, self._couple_shape)
        near = self.target.neighbours
        if kinematics.extra is None:  # what differs is where a cut's end is, and stays there
            more = np.where((more == target)[:, None], near[target], more[:, None])
            target = near[target]
        else:
            target, more = near[target][:, :, None], near[more][:, None, :]
        shape = np.broadcast_shapes(target.shape, more.shape)
        facet = facet.reshape(-1, *[1] * (len(shape) - 1))
        wide = [np.broadcast_to(a, shape).ravel() for a in (facet, target, more)]
        return np.unique(np.ravel_multi_index(wide, self._couple_shape))

    @property
    def _couple_shape(self) -> tuple[int, int, int]:
        return max(self.points.facets.size, 1), len(self.target.facets), len(self.target.facets)

    def pattern(self, couples: Index) -> list[list[tuple[Index, Index, Array]]]:
        """For UU, UΛ, ΛU and ΛΛ: zeros (m, 1, ·, 1, ·) with global blocks, wherever the given couples have entries."""
        facet, target, more = np.unravel_index(couples, self._couple_shape)
        on_target, d, m = self.target.blocks[self.target.facets], self.gdim, self.multiplier.components
        rows = [(facet, self.contactor, d), (target, on_target, d)]
        all_facets = np.arange(len(self.contactor))
        Λ, own = (facet, self.multiplier.blocks, m), (all_facets, self.multiplier.blocks, m)
        places: list[tuple[Any, Any]] = [(rows, rows), (rows, [Λ]), ([Λ], rows), ([own], [own])]
        pattern = [[_zeros(i, j) for i in first for j in second] for first, second in places]
        other = np.flatnonzero(more != target)
        extra = more[other], on_target, d
        for block, first in ((0, rows), (2, [Λ])):
            pattern[block] += [_zeros((i[other], blocks, n), extra) for i, blocks, n in first]
        return pattern


def _in_global_axes(nodal: Array) -> Array:
    """(n, components, nodes × components) from shape functions (n, nodes, own nodes, components)."""
    n, _, nodes, m = nodal.shape
    return np.einsum("nabk,ik->nibk", nodal, np.eye(m)).reshape(n, m, nodes * m)


def _zeros(rows: tuple[Index, Index, int], columns: tuple[Index, Index, int]) -> tuple[Index, Index, Array]:
    """A matrix of zeros for each different pair of nodes of the pairs of facets (m,); `rows` and `columns` are the facets,
    the blocks (nf, nodes) of all facets, and the components."""
    (i, blocks_i, a), (j, blocks_j, b) = rows, columns
    i, j = np.divmod(np.unique(i * len(blocks_j) + j), max(len(blocks_j), 1))
    columns_end = blocks_j.max(initial=0) + 1
    # each pair of nodes is in many pairs of facets
    pairs = np.unique(blocks_i[i][:, :, None] * columns_end + blocks_j[j][:, None, :])
    first, second = np.divmod(pairs, columns_end)
    return first[:, None], second[:, None], np.zeros((len(pairs), 1, a, 1, b))


def apply_columns(C: Array, B: Array, d: int) -> Array:
    """Σ_s C[…, s, j] B[s, b]: C (n, R, slots × d) and B (n, slots, nodes) to (n, R, nodes, d)."""
    n, R, z = C.shape
    return np.swapaxes(np.swapaxes(C.reshape(n, R, z // d, d), 2, 3) @ B[:, None], 2, 3)


def sums_of_products(A: Array, B: Array, starts: Index) -> Array:
    """Σ 𝐀ᵀ𝐁 over each run of points, A (n, r, a) and B (n, r, b) to (runs, a, b); `starts`: where the runs begin.

    A run is cut into pieces of at most the mean length of runs, one product each: products of single points are small, and
    their sum costs more than they do.
    """
    (n, r, a), b = A.shape, B.shape[2]
    if not n:
        return np.zeros((0, a, b))
    length = np.diff(starts, append=n)
    if (length == length[0]).all():
        return np.asarray(np.swapaxes(A.reshape(len(length), -1, a), 1, 2) @ B.reshape(len(length), -1, b))
    most = int(np.ceil(n / len(length)))
    pieces = -(-length // most)
    first = np.cumsum(pieces) - pieces
    place = np.arange(n) - np.repeat(starts, length)
    piece, place = np.repeat(first, length) + place // most, place % most
    shape = (int(pieces.sum()), most)
    left, right = np.zeros((*shape, r, a)), np.zeros((*shape, r, b))
    left[piece, place], right[piece, place] = A, B
    product = np.swapaxes(left.reshape(shape[0], most * r, a), 1, 2) @ right.reshape(shape[0], most * r, b)
    return np.asarray(np.add.reduceat(product, first, axis=0))
