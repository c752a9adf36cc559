"""Tests run on any number of ranks: `./run pytest`, `./run mpirun -n 2 python3 -m pytest`."""

import gc

import pytest
from mpi4py import MPI


@pytest.fixture(autouse=True)
def clean_up():
    """PETSc objects are freed collectively: collect them at the same place on all ranks."""
    yield
    gc.collect()
    MPI.COMM_WORLD.Barrier()


@pytest.fixture
def shared_path(tmp_path):
    """One temporary folder, the same on all ranks."""
    return MPI.COMM_WORLD.bcast(tmp_path)
