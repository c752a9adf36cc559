"""Tests run on any number of ranks: `./run pytest`, `./run mpirun -n 2 python3 -m pytest`."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ffcx.codegeneration import jit
from mpi4py import MPI

PATIENCE = 120  #: seconds


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Several ranks leave out what is marked `one_rank`, one rank what is marked `several_ranks`."""
    mark = "one_rank" if MPI.COMM_WORLD.size > 1 else "several_ranks"
    left_out = [item for item in items if item.get_closest_marker(mark)]
    items[:] = [item for item in items if not item.get_closest_marker(mark)]
    config.hook.pytest_deselected(items=left_out)


@pytest.fixture(scope="session", autouse=True)
def kept_modules() -> Iterator[None]:
    """A compiled form that is loaded already is not looked for again: FFCx lists the folder of its cache each time. One that
    another run of tests is compiling is waited for, longer than FFCx would."""
    loaded: dict[tuple[str, ...], Any] = {}
    look_up = jit.get_cached_module

    def kept(name: str, objects: list[str], folder: Path, _: int) -> Any:
        key = (name, *objects)
        found = loaded.get(key) or look_up(name, objects, folder, PATIENCE)
        if found[0] is not None:
            loaded[key] = found
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jit, "get_cached_module", kept)
        yield


@pytest.fixture(scope="module", autouse=True)
def keep_what_is_loaded() -> None:
    """Modules stay: the collections after each test need not look at what they hold, which takes a tenth of a second."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def clean_up() -> Iterator[None]:
    """PETSc objects are freed collectively: collect them at the same place on all ranks."""
    yield
    gc.collect()
    MPI.COMM_WORLD.Barrier()


@pytest.fixture
def shared_path(tmp_path: Path) -> Path:
    """One temporary folder, the same on all ranks."""
    return MPI.COMM_WORLD.bcast(tmp_path)
