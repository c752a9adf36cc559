"""What cuts that move with the target's end add to a pair's tangent; see :mod:`dolfinx_mortar_al.moving_cuts`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.blocks import Blocks
from dolfinx_mortar_al.kinematics import PositionLevel
from dolfinx_mortar_al.law import OPEN, Coulomb, Frictionless, LawState
from dolfinx_mortar_al.moving_cuts import MovingCuts
from dolfinx_mortar_al.projection import dot

__all__ = ["CutTangent", "tangent_of_cuts"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass
class CutTangent:
    """Element matrices (m, rows, components, columns, components) with global block indices, as
    :class:`~dolfinx_mortar_al.blocks.Tangent` has them; the columns are the contactor's facet and the target's end node."""

    UU: tuple[Index, Index, Array]
    ΛU: tuple[Index, Index, Array]


@dataclass
class _Rates:
    """What a cut that moves by δη = 1 does to each of its points' shares of the residual, (m, nodes, components): at the
    contactor's, the target's and the multiplier's nodes."""

    contactor: Array
    target: Array
    multiplier: Array


def tangent_of_cuts(
    blocks: Blocks, law: Frictionless | Coulomb, state: LawState, Λ: Array, kinematics: PositionLevel
) -> CutTangent | None:
    """The derivative of the residual with respect to the cuts times theirs with respect to the displacements, in the state
    and at the multipliers Λ (n, components) of the pair's points; None if no cut moves."""
    points, target = blocks.points, blocks.target
    cuts = points.cuts
    if cuts is None:
        return None
    rates = _rates(blocks, cuts, law, state, Λ, kinematics)
    # rows at the nodes of each target facet that points of a cut face, as for other points
    shape = len(cuts.facet), len(target.facets)
    faced = blocks.faced_at_cuts(cuts, kinematics.at)
    runs, run = np.unique(np.ravel_multi_index((cuts.cut, faced), shape), return_inverse=True)
    cut, faced = np.unravel_index(runs, shape)
    facet, nodes = cuts.facet[cut], target.facets[faced]

    def sums(values: Array) -> Array:
        total = np.zeros((len(runs), *values.shape[1:]))
        np.add.at(total, run, values)
        return total

    D, e = cuts.speeds(points.facets, kinematics.nodes(), target.nodes[cuts.node])
    speeds = np.concatenate([D, e[:, None]], axis=1)[cut][:, None, None]
    columns = np.concatenate([blocks.contactor[facet], target.blocks[cuts.node[cut], None]], axis=1)
    U = np.concatenate([sums(rates.contactor), sums(rates.target)], axis=1)
    U[np.concatenate([blocks.fixed[facet], target.fixed[nodes]], axis=1)] = 0.0
    rows = np.concatenate([blocks.contactor[facet], target.blocks[nodes]], axis=1)
    return CutTangent(
        (rows, columns, U[..., None, None] * speeds),
        (blocks.multiplier.blocks[facet], columns, sums(rates.multiplier)[..., None, None] * speeds),
    )


def _rates(
    blocks: Blocks,
    cuts: MovingCuts,
    law: Frictionless | Coulomb,
    state: LawState,
    Λ: Array,
    kinematics: PositionLevel,
) -> _Rates:
    """∂(w f)/∂c = ∂w/∂c f + w ∂f/∂η ∂η/∂c at the points of the cuts, w with the reference area."""
    points, k, m = blocks.points, cuts.point, blocks.multiplier.components
    at, now, facet = kinematics.at.take(k), state.take(k), points.facet[k]
    N, dN, ddN = points.facets.shape.tabulate(points.η[k], 2)
    A, Aη = ((B[:, None] @ points.facets.X[facet])[:, 0] for B in (dN[:, 0], ddN[:, 0, 0]))
    length = np.sqrt(dot(A, A))
    j = (points.j[k] * cuts.dη)[:, None]
    δj = (points.thickness * (cuts.dw * length + points.weight[k] * cuts.dη * dot(A, Aη) / length))[:, None]

    NΛ, slope = blocks.NΛ[k], blocks.along_facets(k)
    nodal = blocks.multiplier.own_nodal()[facet].reshape(len(k), -1, 1)
    δ = kinematics.along_facets(k, 2 * cuts.cut + (cuts.dw > 0.0), (slope @ nodal)[:, :, 0])
    C, δr = kinematics.linearise(law, now, Λ[k], k, kinematics.slots(m))
    δt, moving = (C[:, row] @ δ[:, :, None] for row in (1, 2))  # of t on N2, and t δη₂ on N2,α
    δt, moving, δr = δt[..., 0], moving[..., 0], (δr @ δ[:, :, None])[..., 0]

    t, r = now.t, now.r
    contactor = -N[:, :, None] * (δj * t + j * δt)[:, None] - dN[:, 0, :, None] * (j * t)[:, None]
    target = at.N[:, :, None] * (δj * t + j * δt)[:, None] + at.dN[:, 0, :, None] * (j * moving)[:, None]
    target[now.status == OPEN] = 0.0
    tests, slopes = (blocks.weighted(B, state, kinematics.share, k) for B in (NΛ, slope))
    multiplier = (δj * r + j * δr)[:, None] @ tests + (j * r)[:, None] @ slopes
    return _Rates(contactor, target, multiplier.reshape(len(k), -1, m))
