"""Every block of the Jacobian against central differences of the residual, in open, slipping and sticking states."""

import numpy as np
import pytest
from scenes import assert_tangent, beams, rough, set_field

from dolfinx_mortar_al.law import OPEN, SLIP, STICK
from dolfinx_mortar_al.zone_width import ZoneWidth

#: projection and order of the multiplier: the defaults, and the paper's
RULES = [("rays", 1), ("closest", 2), ("rays", 2), ("closest", 1)]
CASES = [
    pytest.param(
        dim, triangles, order, friction, *rule,
        id=f"{dim}D-{'simplex' if triangles else 'box'}-P{order}P{rule[1]}-mu{friction}-{rule[0]}",
    )
    for dim in (2, 3)
    for triangles in (False, True)
    for order in (1, 2)
    for friction in (0.0, 0.8)
    for rule in RULES
    if rule[1] <= order
]  # fmt: skip


def bend(X):
    """A common bending of both beams with a small random mismatch of the surfaces."""
    u = np.zeros_like(X)
    u[:, 1] = -0.2 * X[:, 0] ** 2
    u[:, 0] = 0.2 * X[:, 0] * X[:, 1] * 2
    return u


GAP = 3e-4  # m, between the beams as they are meshed


def close(X):
    """The upper beam moved onto the lower one, along the bent surfaces' normal."""
    u = np.zeros_like(X)
    u[:, 0], u[:, 1] = 0.4 * X[:, 0], 1.0
    return -GAP * u * (X[:, 1] > GAP / 2)[:, None]


@pytest.mark.parametrize("dim, triangles, order, friction, projection, multiplier", CASES)
@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_directional_derivative(dim, triangles, order, friction, projection, multiplier, ratio):
    """K d against (R(x + h d) − R(x − h d))/2h, per block, below 1e-6; ε_T = ratio × ε_N. With
    h = 1e-9 round-off is 4e-8 and no kink is within reach of a point."""
    mesh = {"along": (9, 8), "across": 1, "dim": dim, "triangles": triangles, "gap": GAP}
    ε = 1e7
    rule = {"projection": projection, "multiplier_order": multiplier}
    augmentation = {"epsilon_normal": ε, "epsilon_tangential": ratio * ε}
    problem, P = beams(order=order, friction=friction, mesh=mesh, **augmentation, **rule)
    pair = problem.pairs[0]
    P.value = 1.0
    # multipliers held smooth by gaps of comparable size, other ones in each facet
    small = np.full(pair.facets.size, 1e-3)  # facets of a target beside which every zone is wide
    contactor = pair.facets.gather()
    width = ZoneWidth(contactor, contactor.places_of(pair.facets), small, problem.comm)
    pair.blocks.hold_smooth(1e-9 * (1.0 + np.sin(pair.facets.X[:, 0, 0]) ** 2), width)
    # an earlier state, open, for the slip to count from; then one with gaps, slips and multipliers of comparable weight
    set_field(problem, lambda X: bend(X) + rough(1e-5, 1)(X))
    pair.evaluate()
    pair.commit()
    apart = np.concatenate(problem.comm.allgather(np.abs(pair.kinematics.ρ[pair.at.facing]).max(axis=1)))
    assert not pair.kinematics.carries or apart.mean() > GAP / 2
    state = [
        lambda X: bend(X) + close(X) + rough(3e-4, 2)(X),
        lambda X: 2e3 * (rough(1, 3)(X) + np.array([0.2, 0.6, 0.1])[: X.shape[1]]),
    ]
    direction = [rough(1.0, 4), rough(ε, 5)]

    def at(h):
        set_field(problem, lambda X: state[0](X) + h * direction[0](X), lambda X: state[1](X) + h * direction[1](X))
        problem.pack(problem.x)
        problem.assemble_residual(problem.x, problem.residual)
        return [part.array.copy() for part in problem.residual.getNestSubVecs()]

    at(0.0)
    pair.active.closed = pair.at.facing & (pair.state.λN_hat > 0)  # the law itself, without Newton's caution
    at(0.0)
    counts = np.bincount(np.concatenate(problem.comm.allgather(pair.state.status)), minlength=3)
    assert counts[OPEN] > 0 and counts[SLIP] > 0
    assert counts[STICK] > 0 or friction == 0
    assert_tangent(problem, at, lambda: set_field(problem, direction[0], direction[1]), h=1e-9)
