"""Save a run after a step, and go on after it was interrupted, at whatever moment.

A checkpoint has all that the next step depends on but its length and what it is predicted from: displacements, velocities,
multipliers, slip histories, contact states, poses of obstacles, loads, time and ledger. Each rank writes a file of its own
under a temporary name and renames it; the set is whole when all ranks' files carry the same token. Two sets alternate, so
that a whole one is always there. It goes only into the problem that it was made with, as their fingerprints say
(`fingerprint.py`), and by as many ranks: meshes are partitioned alike, and the numbers are those there were, to Newton's
tolerance.
"""

from __future__ import annotations

import contextlib
import json
import os
import uuid
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.fingerprint import differences, fingerprint
from dolfinx_mortar_al.ledger import Ledger
from dolfinx_mortar_al.monitors import warn
from dolfinx_mortar_al.problem import ContactProblem, Snapshot, check_problem
from dolfinx_mortar_al.ranks import on_root, together
from dolfinx_mortar_al.validation import make_folder, number, path_of

__all__ = ["Checkpoint", "Saved"]

Array = NDArray[Any]

HEADER = "header"  # of a file: JSON beside the arrays
NOTE = "checkpoint.json"  # for the reader
SHOWN = 4  # differences that a message lists


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

    Raises:
        OSError: on every rank, if the directory cannot be made.
        ValueError: if it is no path, or `problem` no problem.
    """

    def __init__(self, directory: Path | str, problem: ContactProblem) -> None:
        self._directory, self._problem = path_of("directory", directory), problem
        check_problem(problem)
        if problem.motions:  # what a step keeps at points is part of the state that is loaded
            for pair in problem.pairs:
                pair.use_steps()
        self._slot, self._serial = 0, 0
        on_root(problem.comm, lambda: make_folder("directory", self._directory))

    def _file(self, slot: int) -> Path:
        return self._directory / f"checkpoint_{slot}_{self._problem.comm.rank}.npz"

    # ---------------------------------------------------------------- save

    def save(self, at: float, ledger: Ledger | None = None) -> None:
        """Keep the present state, reached at time or load `at` (collective).

        `checkpoint.json` says for the reader where the run stands; no state is taken from it.

        Raises:
            ValueError: if `at` is no number.
            OSError: on every rank, if it cannot be written; the set saved before stays whole.
        """
        comm, at = self._problem.comm, number("at", at)
        if self._serial == 0:  # not gone on with: sets of an earlier run must not outlive this one's first
            for slot in (0, 1):
                together(comm, partial(self._file(slot).unlink, missing_ok=True))
        said = {
            "token": comm.bcast(uuid.uuid4().hex),
            "serial": self._serial + 1,
            "ranks": comm.size,
            "at": float(at),
            "ledger": None if ledger is None else asdict(ledger),
            "problem": fingerprint(self._problem),
        }
        together(comm, lambda: self._write(1 - self._slot, said))
        self._slot, self._serial = 1 - self._slot, self._serial + 1
        note = {name: said[name] for name in ("serial", "ranks", "at", "ledger")} | {"slot": self._slot}
        on_root(comm, lambda: (self._directory / NOTE).write_text(json.dumps(note) + "\n"))

    def _write(self, slot: int, said: dict[str, Any]) -> None:
        """This rank's file, under its own name only when it is whole and on disk."""
        temporary = self._file(slot).with_suffix(".tmp")
        try:
            with temporary.open("wb") as file:
                np.savez(file, allow_pickle=False, **{HEADER: np.array(json.dumps(said))}, **self._arrays())
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self._file(slot))
        except OSError:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise

    # ---------------------------------------------------------------- load

    def load(self) -> Saved | None:
        """Bring the problem to the last state saved; None if there is none (collective). Where the last set is damaged or
        was not finished, a warning says so and the one before is taken.

        Raises:
            ValueError: on every rank, if it was written by another number of ranks or for another problem (the message says
                in what they differ), or if no set is whole.
        """
        comm = self._problem.comm
        looks = comm.allgather([self._look(slot) for slot in (0, 1)])  # (ranks, slots)
        sets = {
            slot: [look[slot] for look in looks] for slot in (0, 1) if any(look[slot] is not None for look in looks)
        }
        if not sets:
            return None
        ranks = {header["ranks"] for headers in sets.values() for header in headers if header}
        if ranks and comm.size not in ranks:
            raise ValueError(
                f"{self._directory}: written by {ranks.pop()} ranks, resume with as many (not {comm.size})"
            )
        latest_first = sorted(sets.items(), key=lambda item: -_serial(item[1]))
        for damaged, (slot, headers) in enumerate(latest_first):
            arrays = self._read(slot) if _whole(headers) else None
            if all(comm.allgather(arrays is not None)):
                assert arrays is not None
                header = headers[0]
                self._adopt(slot, header, arrays)
                if damaged or header["serial"] < self._noted_serial():
                    self._warn(header["at"])
                return _saved(header)
        raise ValueError(f"{self._directory}: no checkpoint in it is whole; start again in another folder")

    def _look(self, slot: int) -> dict[str, Any] | None:
        """This rank's header: empty where the file cannot be read, None where there is none."""
        if not self._file(slot).exists():
            return None
        try:
            with np.load(self._file(slot)) as arrays:
                header = json.loads(str(arrays[HEADER]))
        except Exception:  # of many kinds, by what is left of the file
            return {}
        return dict(header)

    def _read(self, slot: int) -> dict[str, Array] | None:
        """This rank's arrays, None where the file is damaged."""
        try:
            with np.load(self._file(slot)) as file:
                arrays = {name: file[name] for name in file.files if name != HEADER}
        except Exception:  # a checksum, a length, a name in the archive
            return None
        sound = all(
            np.isfinite(a).all() for name, a in arrays.items() if name.endswith((".u", ".multiplier", ".velocity"))
        )
        return arrays if sound else None

    def _adopt(self, slot: int, header: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Make a set the problem's state, if it is of this problem."""
        other = differences(header["problem"], fingerprint(self._problem))
        shapes = _shapes(self._arrays()) == _shapes(arrays)
        if not other and not all(self._problem.comm.allgather(shapes)):
            other = ["the state's arrays have other shapes"]
        if other:
            more = f" and {len(other) - SHOWN} more" if len(other) > SHOWN else ""
            raise ValueError(
                f"{self._directory}: made by another problem; {'; '.join(other[:SHOWN])}{more}. Resume with the mesh, the "
                "options and the motions it was made with, or start again in another folder"
            )
        self._slot, self._serial = slot, header["serial"]
        self._restore(arrays)

    def _noted_serial(self) -> int:
        """How many sets the reader's note counts (collective)."""

        def read() -> int:
            try:
                return int(json.loads((self._directory / NOTE).read_text())["serial"])
            except (OSError, ValueError, TypeError, KeyError):
                return 0

        return on_root(self._problem.comm, read)

    def _warn(self, at: float) -> None:
        if self._problem.comm.rank == 0:
            warn(
                f"{self._directory}: the last checkpoint is damaged or was not finished; the run goes on from the one "
                f"before, at {at:.6g}",
                UserWarning,
            )

    # ---------------------------------------------------------------- arrays

    def _arrays(self) -> dict[str, Array]:
        """The problem's snapshot, flat."""
        snapshot = self._problem.snapshot()
        return {f"{member}.{name}": a for member, arrays in snapshot.items() for name, a in arrays.items()}

    def _restore(self, arrays: dict[str, Array]) -> None:
        snapshot: Snapshot = {member: {} for member in self._problem.members}
        for key, array in arrays.items():
            member, name = key.split(".")
            snapshot[member][name] = array
        self._problem.resume(snapshot)


def _shapes(arrays: dict[str, Array]) -> dict[str, tuple[int, ...]]:
    """The shapes that two states of a problem have in common: the number of segments' points is not the problem's, and loads
    come with the marches that move them."""
    own = {name: a for name, a in arrays.items() if not name.startswith("loads.")}
    return {name: a.shape[1:] if ".points_" in name else a.shape for name, a in own.items()}


def _whole(headers: Sequence[dict[str, Any] | None]) -> bool:
    """Whether all ranks have written the same set."""
    return all(headers) and len({header["token"] for header in headers if header}) == 1


def _serial(headers: Sequence[dict[str, Any] | None]) -> float:
    """A set's number; one that cannot be read may be the last."""
    return max(np.inf if header == {} else (header or {}).get("serial", 0) for header in headers)


def _saved(header: dict[str, Any]) -> Saved:
    kept: dict[str, Any] | None = header["ledger"]
    if kept is None:
        return Saved(header["at"], None)
    lists = ("momentum", "angular_momentum")
    return Saved(header["at"], Ledger(**kept | {name: tuple(kept[name]) for name in lists}))
