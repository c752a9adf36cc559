"""Pressure at the points under a punch: smooth with multipliers of order 1, whichever side carries them or is stiff."""

import warnings
from functools import partial

import hertz_pressure
import ironing
import numpy as np
import pytest

INNER = 0.7  # of the zone's half width: further out the pressure falls to zero as a root, and points open


def roughness(ratio, slab_is_contactor, multiplier_order):
    """Largest relative difference of the points' pressures from their best polynomial of degree 6, which cannot follow what
    changes from facet to facet (7 to 11 of them) and follows Hertz' profile to 1e-3."""
    scene = ironing.Scene(
        cells=24, friction=0.0, steps=(2, 0), depth=0.1, ratio=ratio, slab_is_contactor=slab_is_contactor, curved=True
    )
    problem, top = ironing.build(scene, {"multiplier_order": multiplier_order})
    assert sum(step.rejected for _, step in ironing.iron(scene, problem, top)) == 0
    return off_polynomial(problem.pairs[0])


def off_polynomial(pair):
    """The same of any pair."""
    x, p = pair.points()[:, 0], pair.state.p
    zone = x[pair.state.status > 0]
    ξ = 2 * (x - zone.mean()) / np.ptp(zone)
    inner = np.abs(ξ) < INNER
    assert inner.sum() > 30
    fit = np.polynomial.Polynomial.fit(ξ[inner], p[inner], 6)
    return np.abs(p[inner] / fit(ξ[inner]) - 1).max()


@pytest.mark.one_rank
@pytest.mark.parametrize("slab_is_contactor", [False, True], ids=["punch", "slab"])
@pytest.mark.parametrize("ratio", [1e-2, 1.0, 1e2])
def test_pressures_do_not_oscillate(ratio, slab_is_contactor):
    """Below 3 % (seen: 1.0 to 2.5 %, from facets that do not match)."""
    assert roughness(ratio, slab_is_contactor, multiplier_order=1) < 0.03


@pytest.mark.one_rank
def test_equal_orders_do_not_oscillate_under_a_stiffer_punch():
    """The paper's; seen: 2.4 %, and 33 % where nothing holds them smooth."""
    assert roughness(1e2, False, multiplier_order=2) < 0.03


@pytest.mark.one_rank
@pytest.mark.parametrize(
    "order, slab, oscillates",
    [
        (1, 0.2, True),
        (1, 0.3, False),
        (1, 0.6, False),
        (1, 1.4, False),
        (2, 0.3, False),
        (2, 0.4, False),
        (2, 1.0, False),
    ],
)
def test_a_contactor_that_is_finer_and_stiffer_is_held_smooth(monkeypatch, order, slab, oscillates):
    """The punch has a hundred times the slab's stiffness, the slab `slab` × 0.8 as many cells per metre: up to six facets of
    the punch on one of the slab. The pressure oscillates by less than 8 %, but where the zone is two facets of the slab wide,
    and the step says so."""
    monkeypatch.setattr(ironing, "Ironing", partial(ironing.Ironing, ratio=(slab, 1.0)))
    scene = ironing.Scene(
        cells=48 // order, order=order, friction=0.0, steps=(3, 0), depth=0.1, ratio=1e2, curved=order == 2
    )
    problem, top = ironing.build(scene, {})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        *_, (_, step) = ironing.iron(scene, problem, top)
    assert any("finer than the target and stiffer" in finding.meaning for finding in step.findings) == oscillates
    rough = off_polynomial(problem.pairs[0])
    assert rough > 0.2 if oscillates else rough < 0.08


@pytest.mark.parametrize("block_is_contactor", [False, True], ids=["cylinder", "block"])
@pytest.mark.parametrize("ratio", [1e-3, 1.0, 1e3])
def test_pressures_are_those_of_hertz(ratio, block_is_contactor):
    """Within 3 % at points inside 70 % of the half width, ten facets of order 2 long (seen: 0.8 to 2.4 %; Hertz' solution
    is right to 0.2 %), whichever side is contactor or stiff."""
    assert hertz_pressure.difference(ratio, 10, 2, block_is_contactor, "gauss") < 0.03
