"""Sums and extremes over the ranks, against gathered values."""

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_mortar_al.reductions import all_over, any_over, max_over, min_over, sum_over

COMM = MPI.COMM_WORLD
EVERY = np.arange(COMM.size)


def test_numbers_of_all_ranks():
    mine = COMM.rank - 0.5
    assert sum_over(COMM, mine) == pytest.approx(np.sum(EVERY - 0.5), abs=1e-15 * COMM.size)  # round-off
    assert max_over(COMM, mine) == COMM.size - 1.5
    assert min_over(COMM, mine) == -0.5
    assert isinstance(sum_over(COMM, mine), float)


def test_types_of_other_ranks():
    """A rank that owns nothing counts it in whole numbers: np.bincount does, with weights, too."""
    mine = np.arange(3) if COMM.rank == 0 else np.arange(3) + 0.25
    assert np.array_equal(sum_over(COMM, mine), np.arange(3) * COMM.size + 0.25 * (COMM.size - 1))
    assert max_over(COMM, 1 if COMM.rank == 0 else 0.5) == 1.0


@pytest.mark.parametrize("layout", ["C", "F"])
def test_arrays_of_all_ranks(layout):
    """Each entry for itself, whatever the order in memory; the argument stays as it is."""
    table = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], order=layout)
    mine = table * (COMM.rank + 1)
    before = mine.copy()
    assert np.array_equal(sum_over(COMM, mine), table * (EVERY + 1).sum())
    assert np.array_equal(max_over(COMM, mine), table * COMM.size)
    assert np.array_equal(mine, before)


def test_nothing_is_nothing():
    assert sum_over(COMM, np.zeros((0, 2))).shape == (0, 2)


def test_truth_on_some_and_on_all_ranks():
    assert any_over(COMM, COMM.rank == COMM.size - 1) is True
    assert all_over(COMM, COMM.rank == COMM.size - 1) is (COMM.size == 1)
    assert any_over(COMM, False) is False
    assert all_over(COMM, True) is True
