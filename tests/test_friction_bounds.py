"""Bounds brought up to date by Aitken's rule, on maps whose fixed points and eigenvalues are known."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_mortar_al.friction_bounds import NEARER, NEARLY, FrictionBounds

pytestmark = pytest.mark.one_rank


class Bounds:
    """What FrictionBounds asks of an active set, of n bounds that ask for target(b)."""

    def __init__(self, start, target):
        self.frozen, self.target, self.off = np.array(start, dtype=float), target, None

    def staleness(self, state, μ):
        wanted = self.target(self.frozen)
        return float(np.max(np.abs(wanted - self.frozen)) / np.max(np.abs(wanted)))

    def compare_bounds(self, state, μ):
        off, last = self.target(self.frozen) - self.frozen, self.off
        self.off = off
        return np.zeros(2) if last is None else np.array([off @ last, last @ last])

    def move_bounds(self, share):
        self.frozen = self.frozen + share * self.off

    def thaw(self):
        self.frozen = None


def rounds(eigenvalue, start=1.05, most=60, until=1e-6):
    """Bounds after each round with wanted = 1 + eigenvalue (b − 1), never freed, until their error is small; and whether they
    have been led away from 1."""
    active = Bounds([start, 2.0], lambda b: np.array([1.0 + eigenvalue * (b[0] - 1.0), 2.0]))
    pair = SimpleNamespace(active=active, state=None, friction_coefficient=0.5)
    bounds = FrictionBounds(SimpleNamespace(comm=MPI.COMM_SELF, frozen_bounds=[pair]))
    bounds._nearly = 0.0
    history = [active.frozen[0]]
    while bounds.error > until and bounds.rounds < most:
        bounds.renew(bounds.error)
        history.append(active.frozen[0])
    return history, bounds.leave


@pytest.mark.parametrize("eigenvalue", [-0.99, -1.5, -0.5, 0.3, 0.6, 0.9])
def test_what_swings_is_damped_and_what_creeps_extrapolated(eigenvalue):
    """Plain rounds would take 1 300, for ever, 16, 10, 24 and 112 for an error of 1e-6; a linear map takes two and what θ may
    grow in."""
    history, left = rounds(eigenvalue)
    assert not left and abs(history[-1] - 1.0) < 1e-5
    assert len(history) <= 9


@pytest.mark.parametrize("eigenvalue", [1.02, 1.15])
def test_an_unstable_fixed_point_is_left(eigenvalue):
    """Away from where the error came from, ever faster, and never back."""
    history, left = rounds(eigenvalue, start=1.001, most=12)
    assert left and np.all(np.diff(history) > 0)
    assert history[-1] - 1.0 > 10 * (0.001 * eigenvalue**11)


def test_bounds_are_freed_when_they_are_nearly_right_and_then_nearer():
    """Freed below NEARLY, and next below a tenth of the error that they were freed with."""
    active = Bounds([1.0, 2.0], lambda b: np.array([1.0, 2.0]))
    pair = SimpleNamespace(active=active, state=None, friction_coefficient=0.5)
    bounds = FrictionBounds(SimpleNamespace(comm=MPI.COMM_SELF, frozen_bounds=[pair]))
    bounds.renew(0.9 * NEARLY)
    assert active.frozen is None
    active.frozen = np.array([1.1, 2.0])
    bounds.renew(0.5 * NEARLY)
    assert active.frozen is not None
    bounds.renew(0.9 * NEARER * 0.9 * NEARLY)
    assert active.frozen is None
