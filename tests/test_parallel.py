"""The same numbers on any number of ranks: each scene on all ranks together and on every rank by itself."""

import numpy as np
import pytest
from mpi4py import MPI
from scenes import beams, tip

from dolfinx_mortar_al import quasistatic
from dolfinx_mortar_al.surface import Surface
from meshes.two_beams import LOWER_TOP, UPPER_BOTTOM


@pytest.mark.parametrize("dim, triangles, friction", [(2, False, 0.0), (2, True, 0.3), (3, False, 0.3)])
def test_together_and_alone(dim, triangles, friction):
    results = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        mesh = {"dim": dim, "triangles": triangles, "along": (8, 8), "across": 1}
        problem, P = beams(comm, friction=friction, mesh=mesh)
        for _ in quasistatic.march(problem, P, to=4.0, increments=4):
            pass
        results.append((tip(problem), problem.pairs[0].force(), problem.pairs[0].closed_fraction()))
    together, alone = results
    assert np.allclose(together[0], alone[0], rtol=1e-8)
    assert np.allclose(together[1], alone[1], rtol=1e-8, atol=1e-8)
    assert together[2] == pytest.approx(alone[2], rel=1e-12)


def test_contactor_and_target_on_different_ranks():
    """The partition of this mesh does split the interface's two sides when there is more than one rank."""
    problem, _ = beams()
    mesh, tags = problem.u.function_space.mesh, problem.pairs[0].contact.contactor.tags
    sides = [len(Surface(mesh, tags, tag).owned_facets()) for tag in (UPPER_BOTTOM, LOWER_TOP)]
    counts = np.array(problem.comm.allgather(sides))
    assert counts.sum(axis=0).tolist() == [10, 10]
    if problem.comm.size > 1:
        assert np.any(counts[:, 0] != counts[:, 1])
