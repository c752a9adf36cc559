"""Save a run after a step, and go on after it was interrupted, at whatever moment.

A checkpoint has all that the next step depends on: displacements, velocities, multipliers, slip histories, contact states,
poses of obstacles, time and ledger. Each rank writes a file of its own under a temporary name and renames it; when all have
done so, rank 0 renames a small file that points to the new set. Two sets alternate, so that a complete one is always there.
A run resumes on as many ranks as it was written with: meshes are partitioned alike, and the numbers are those there were.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.dynamics import Ledger, Motion
from dolfinx_mortar_al.problem import ContactProblem, Snapshot

__all__ = ["Checkpoint", "Saved"]

Array = NDArray[Any]


@dataclass(frozen=True)
class Saved:
    """Where a run stands: its time (or load), and the ledger of a dynamic one."""

    at: float
    ledger: Ledger | None


class Checkpoint:
    """Checkpoints of a problem in a directory.

    Args:
        directory: where they are kept; made if missing.
        problem: the problem.
        motions: of a dynamic run, one per displacement.
    """

    def __init__(self, directory: Path, problem: ContactProblem, motions: Motion | Sequence[Motion] = ()) -> None:
        self._directory, self._problem = directory, problem
        all_motions = [motions] if isinstance(motions, Motion) else list(motions)
        problem.members |= {f"motion{k}": motion for k, motion in enumerate(all_motions)}
        self._pointer, self._slot = directory / "checkpoint.json", 0
        if problem.comm.rank == 0:
            directory.mkdir(parents=True, exist_ok=True)
        problem.comm.Barrier()

    def _file(self, slot: int) -> Path:
        return self._directory / f"checkpoint_{slot}_{self._problem.comm.rank}.npz"

    def save(self, at: float, ledger: Ledger | None = None) -> None:
        """Keep the present state, reached at time or load `at` (collective)."""
        comm = self._problem.comm
        self._slot = 1 - self._slot
        temporary = self._file(self._slot).with_suffix(".tmp")
        with temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **self._arrays())
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self._file(self._slot))
        comm.Barrier()
        if comm.rank == 0:
            said = {
                "slot": self._slot,
                "ranks": comm.size,
                "at": at,
                "ledger": None if ledger is None else asdict(ledger),
            }
            temporary = self._pointer.with_suffix(".tmp")
            temporary.write_text(json.dumps(said))
            temporary.replace(self._pointer)
        comm.Barrier()

    def load(self) -> Saved | None:
        """Bring the problem to the last state saved; None if there is none (collective).

        Raises:
            ValueError: on every rank, if it was written by another number of ranks or for another problem.
        """
        comm = self._problem.comm
        found = self._pointer.read_text() if comm.rank == 0 and self._pointer.exists() else None
        found = comm.bcast(found, root=0)
        if found is None:
            return None
        said = json.loads(found)
        if said["ranks"] != comm.size:
            raise ValueError(
                f"{self._pointer}: written by {said['ranks']} ranks, resume with as many (not {comm.size})"
            )
        self._slot = said["slot"]
        with np.load(self._file(self._slot)) as arrays:
            wanted = {name: a.shape for name, a in self._arrays().items()}
            fits = {name: arrays[name].shape for name in arrays.files} == wanted
            if not comm.allreduce(int(fits)) == comm.size:
                raise ValueError(f"{self._pointer}: made by another problem; resume with the same mesh and options")
            self._restore(arrays)
        kept: dict[str, Any] | None = said["ledger"]
        if kept is None:
            return Saved(said["at"], None)
        lists = ("momentum", "angular_momentum")
        return Saved(said["at"], Ledger(**kept | {name: tuple(kept[name]) for name in lists}))

    def _arrays(self) -> dict[str, Array]:
        """The problem's snapshot, flat."""
        snapshot = self._problem.snapshot()
        return {f"{member}.{name}": a for member, arrays in snapshot.items() for name, a in arrays.items()}

    def _restore(self, arrays: Any) -> None:
        snapshot: Snapshot = {member: {} for member in self._problem.members}
        for key in arrays.files:
            member, name = key.split(".")
            snapshot[member][name] = arrays[key]
        self._problem.limp = False  # a step has converged
        self._problem.restore(snapshot)
