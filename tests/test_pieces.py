"""Connected pieces by least labels, against SciPy's."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dolfinx_mortar_al.pieces import connected


def test_pieces_are_those_of_scipy():
    """Random cells that leave many pieces and lone nodes, and one long chain in random order."""
    rng = np.random.default_rng(1)
    for n in (1, 2, 30, 400):
        cells = rng.integers(0, n, (n // 2, 3))
        i, j = np.repeat(cells[:, 0], 3), cells.ravel()
        count, expected = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
        label = connected(cells, n)
        assert np.array_equal(label, [np.flatnonzero(expected == piece)[0] for piece in expected])
        assert len(np.unique(label)) == count
    order = rng.permutation(20000)
    assert not connected(np.stack([order[:-1], order[1:]], axis=1), 20000).any()
