"""Element matrices of runs of points."""

import numpy as np
import pytest

from dolfinx_mortar_al.blocks import sums_of_products

pytestmark = pytest.mark.one_rank


@pytest.mark.parametrize("lengths", [[1, 1, 1], [5], [1, 9, 2, 2, 30, 1], []])
def test_products_are_summed_over_each_run(lengths):
    """Against a loop over the runs; the order of the additions alone differs."""
    rng, n = np.random.default_rng(0), sum(lengths)
    A, B = rng.standard_normal((n, 3, 4)), rng.standard_normal((n, 3, 5))
    ends = np.cumsum(lengths, dtype=np.int64)
    starts = ends - np.array(lengths, dtype=np.int64)
    slow = [np.einsum("pra,prb->ab", A[i:j], B[i:j]) for i, j in zip(starts, ends, strict=True)]
    found = sums_of_products(A, B, starts)
    assert found.shape == (len(lengths), 4, 5)
    assert np.allclose(found, np.reshape(slow, found.shape), rtol=0, atol=1e-13)
