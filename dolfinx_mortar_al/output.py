"""Results on disk: history.csv, summary.json, ParaView files, and what a figure needs gathered on rank 0."""

from __future__ import annotations

import contextlib
import csv
import ctypes
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from dolfinx_mortar_al.checkpoint import Checkpoint
from dolfinx_mortar_al.contactor_functions import ContactorFunctions
from dolfinx_mortar_al.picture import picture
from dolfinx_mortar_al.problem import ContactProblem, check_problem
from dolfinx_mortar_al.ranks import agreed, on_root, together
from dolfinx_mortar_al.validation import check_columns, make_folder, number, path_of, vector

__all__ = ["History", "ParaView", "Probe", "Run", "deformed_cells", "extent", "picture", "summary"]

Array = NDArray[np.float64]

ROUND_OFF = 1e-12  # of the largest coordinate: as much outside of its cells a point is in them
FROM_STEPS = ("newton_iterations", "wall_time")  # columns that a Run fills in


class History:
    """history.csv: a row per converged step, on disk at once, so that an interrupted run keeps what it had.

    Args:
        problem: its communicator's rank 0 writes.
        directory: where to write; made if missing.
        columns: names, in order, of every row.
        resume: keep the rows of an interrupted run up to the one with this in its first column.

    Raises:
        OSError: on every rank, if the folder cannot be made or written to.
        ValueError: on every rank, if `columns` are no list of different names, or a file to be resumed has others or text in
            place of numbers.
    """

    def __init__(
        self, problem: ContactProblem, directory: Path | str, columns: Sequence[str], resume: float | None = None
    ) -> None:
        check_problem(problem)
        self.columns, self.comm = check_columns(columns), problem.comm
        self.path = path_of("directory", directory) / "history.csv"
        last = None if resume is None else number("resume", resume)
        self.rows: list[dict[str, float]] = on_root(self.comm, lambda: self._open(last))

    def _open(self, resume: float | None) -> list[dict[str, float]]:
        """Start the file with the rows to keep."""
        make_folder("directory", self.path.parent)
        rows = [] if resume is None else self._rows_until(resume)
        with _replaced(self.path) as file:
            csv.writer(file).writerow(self.columns)
            csv.writer(file).writerows([[repr(row[name]) for name in self.columns] for row in rows])
        return rows

    def _rows_until(self, last: float) -> list[dict[str, float]]:
        """The complete rows on disk up to `last`, which the run has come to from either side."""
        if not self.path.exists():
            return []
        lines = self.path.read_text().split("\n")[:-1]  # a line cut short has no end
        header = next(csv.reader(lines[:1]), self.columns)
        if header != self.columns:
            raise ValueError(
                f"{self.path}: has the columns {header}, this run {self.columns}; resume with the same, or write to "
                "another folder"
            )
        rows = [row for row in csv.reader(lines[1:]) if len(row) == len(self.columns)]
        try:
            kept = [dict(zip(self.columns, map(float, row), strict=True)) for row in rows]
        except ValueError as error:
            raise ValueError(f"{self.path}: {error}; mend the row, or write to another folder") from None
        at = np.array([row[self.columns[0]] for row in kept])
        met = np.flatnonzero(np.abs(at - last) <= 1e-12 * abs(last))
        if len(met):
            return kept[: met[-1] + 1]
        way = np.sign(at[-1] - at[0] if len(at) > 1 else at.sum())  # up or down
        beyond = np.flatnonzero(way * (at - last) > 0)
        return kept[: beyond[0]] if len(beyond) else kept

    def add(self, **row: float) -> None:
        """Append a row (collective; rank 0's numbers count).

        Raises:
            ValueError: on every rank, if the names are not those of the columns, or a value is not a number.
            OSError: on every rank, if it cannot be written; the rows before stay on disk as they are.
        """
        self.rows.append(on_root(self.comm, lambda: self._append(row)))

    def _append(self, row: Mapping[str, Any]) -> dict[str, float]:
        if set(row) != set(self.columns):
            raise ValueError(f"a row has {sorted(row)}; the columns of {self.path.name} are {self.columns}")
        values = {name: _number(name, row[name]) for name in self.columns}
        with self.path.open("r+", newline="") as file:
            end = file.seek(0, os.SEEK_END)
            try:
                csv.writer(file).writerow([repr(value) for value in values.values()])
                file.flush()
            except OSError:
                with contextlib.suppress(OSError):
                    os.truncate(self.path, end)
                raise
        return values

    def column(self, name: str) -> Array:
        """All values of a column so far.

        Raises:
            ValueError: if there is no such column.
        """
        if name not in self.columns:
            raise ValueError(f"name = {name!r}: no column is called that; known are {self.columns}")
        return np.array([row[name] for row in self.rows])


def summary(
    problem: ContactProblem, history: History, directory: Path | str, parameters: Mapping[str, Any], rejected: int
) -> dict[str, Any]:
    """Write summary.json: parameters, versions, ranks, unknowns, linear solver, ε, iterations, times, last row."""
    import dolfinx
    from petsc4py import PETSc

    result = {
        "parameters": {k: str(v) if isinstance(v, Path) else v for k, v in parameters.items()},
        "versions": {"dolfinx": dolfinx.__version__, "petsc": ".".join(map(str, PETSc.Sys.getVersion()))},
        "ranks": problem.comm.size,
        "unknowns": problem.unknowns,
        "linear_solver": None if problem.linear_solver is None else str(problem.linear_solver),
        "epsilon": {p.name: {"normal": p.epsilon.normal, "tangential": p.epsilon.tangential} for p in problem.pairs},
        "newton_iterations": int(sum(row.get("newton_iterations", 0) for row in history.rows)),
        "steps": len(history.rows),
        "rejected_steps": rejected,
        "wall_time": {part: round(s, 4) for part, s in sorted(problem.stopwatch.seconds.items())},
        "last": history.rows[-1] if history.rows else None,
    }
    on_root(problem.comm, lambda: _write_json(Path(directory) / "summary.json", result))
    return result


def _write_json(path: Path, said: Mapping[str, Any]) -> None:
    with _replaced(path) as file:
        file.write(json.dumps(said, indent=2, ensure_ascii=False, default=str) + "\n")


@contextlib.contextmanager
def _replaced(path: Path) -> Iterator[TextIO]:
    """A new text for a file, which stays what it was until the text is whole."""
    temporary = path.with_suffix(".tmp")
    try:
        with temporary.open("w", newline="") as file:
            yield file
        temporary.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


def _number(name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {value}: a row has one number in each column") from None


class ParaView:
    """ParaView series (.bp): the displacement on the bodies, and on each pair's contactor, a surface mesh of its own, what
    :class:`~dolfinx_mortar_al.contactor_functions.ContactorFunctions` holds: displacement, gap, pressure, tangential
    traction, slip, status and multiplier. *Warp By Vector* with "displacement" brings either to the present positions.

    Files are ``displacement.bp`` (``displacement_0.bp`` … of several meshes) and ``contactor_<name of the pair>.bp``.

    Args:
        problem: the problem.
        directory: where to write; made if missing.
        resume: load or time from which an interrupted run goes on: its series are kept, and new ones begun beside them.

    Raises:
        OSError, RuntimeError: on every rank, if they cannot be written.
    """

    def __init__(self, problem: ContactProblem, directory: Path | str, resume: float | None = None) -> None:
        from dolfinx.io import VTXWriter

        check_problem(problem)
        folder, self._comm = path_of("directory", directory), problem.comm
        later = "" if not resume else f"_from_{resume:.6g}"
        on_root(problem.comm, lambda: make_folder("directory", folder))
        self.problem = problem
        self._contactors = [ContactorFunctions(pair) for pair in problem.pairs]
        bodies = problem.bodies.bodies
        names = ["displacement"] if len(bodies) == 1 else [f"displacement_{k}" for k in range(len(bodies))]
        for body in bodies:
            body.u.name = "displacement"
        series = {name: [body.u] for name, body in zip(names, bodies, strict=True)}
        series |= {f"contactor_{c.pair.name}": list(c.functions.values()) for c in self._contactors}
        self._writers = [
            together(
                problem.comm,
                partial(VTXWriter, own[0].function_space.mesh.comm, folder / f"{name}{later}.bp", own, engine="BP4"),
            )
            for name, own in series.items()
        ]

    def write(self, time: float) -> None:
        """Add the present state at `time` (a load or a time).

        Raises:
            RuntimeError: on every rank, if it cannot be written.
        """
        for contactor in self._contactors:
            contactor.update()
        for writer in self._writers:
            self._attempt(partial(writer.write, time))

    def close(self) -> None:
        """Complete the files."""
        for writer in self._writers:
            self._attempt(writer.close)

    def _attempt(self, action: Callable[[], None]) -> None:
        """An action of a writer; where it fails on some rank, an error on all."""
        try:
            together(self._comm, action)
        except Exception:
            # ADIOS2 would try to write again when a writer is collected, and end the process: these never are
            for writer in self._writers:
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(writer._cpp_object))
            raise


class Run:
    """All that a run leaves behind: history.csv, summary.json and, if wanted, ParaView series.

    Args:
        problem: the problem.
        directory: where to write.
        columns: of the history; newton_iterations and wall_time are filled in from the step.
        parameters: for the summary.
        paraview: whether to write .bp series.
        resume: go on with the history of an interrupted run, from this time (or load) in its first column.
        checkpoint: save the steps at asked-for loads or times in the directory, and begin with the last one that an
            interrupted run has saved there (`resume` is then its load or time).

    Attributes:
        start: load, time or path of the problem's state, 0 at its start; ledger: of a dynamic run that goes on.

    Raises:
        OSError, RuntimeError: on every rank, if something cannot be written.
        ValueError: on every rank: unsuitable `columns` (:class:`History`), a checkpoint of another problem, or an argument
            but `parameters` that differs between ranks.
    """

    def __init__(
        self,
        problem: ContactProblem,
        directory: Path | str,
        columns: Sequence[str],
        parameters: Mapping[str, Any],
        paraview: bool = False,
        resume: float | None = None,
        checkpoint: bool = False,
    ) -> None:
        check_problem(problem)
        names, directory = check_columns(columns), path_of("directory", directory)
        resume = None if resume is None else number("resume", resume)
        missing = [name for name in FROM_STEPS if name not in names]
        if missing:
            raise ValueError(
                f"columns = {columns}: {' and '.join(missing)} of each step will be filled in; name them, too"
            )
        for name, value in {
            "directory": str(directory),
            "columns": names,
            "paraview": bool(paraview),
            "resume": resume,
            "checkpoint": bool(checkpoint),
        }.items():
            agreed(problem.comm, name, value)
        self._checkpoint = Checkpoint(directory, problem) if checkpoint else None
        saved = None if self._checkpoint is None else self._checkpoint.load()
        if saved is not None:
            resume = saved.at
        self.start, self.ledger = resume or 0.0, None if saved is None else saved.ledger
        self.problem, self.directory, self.parameters = problem, directory, dict(parameters)
        self.history = History(problem, directory, names, resume)
        self._paraview = ParaView(problem, directory, resume) if paraview else None
        self._rejected = 0

    def record(self, step: Any, at: float, **row: float) -> None:
        """A converged step at load or time `at`."""
        self.history.add(newton_iterations=step.iterations, wall_time=step.wall_time, **row)
        self._rejected += step.rejected
        if self._paraview is not None:
            self._paraview.write(at)
        if self._checkpoint is not None and step.nominal:
            self._checkpoint.save(at, getattr(step, "ledger", None))

    def finish(self, **parameters: Any) -> dict[str, Any]:
        """Close the files and write the summary, with further `parameters`; returns it."""
        if self._paraview is not None:
            self._paraview.close()
        return summary(self.problem, self.history, self.directory, self.parameters | parameters, self._rejected)


class Probe:
    """The value of a Function at a reference point, on every rank: the point is looked up once, the value at each call.

    Args:
        u: the Function.
        X: (gdim,) the point (m).
        cells: this rank's cells, one of which is to hold it, where bodies share the point; any cell by default.

    Raises:
        ValueError: on every rank, if X is no point of the mesh's space or lies in no such cell.
    """

    def __init__(self, u: fem.Function, X: Sequence[float], cells: NDArray[np.int32] | None = None) -> None:
        self._u, mesh = u, u.function_space.mesh
        self._point = np.zeros((1, 3))
        self._point[0, : mesh.geometry.dim] = vector("X", X, mesh.geometry.dim)
        owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
        cells = owned if cells is None else np.intersect1d(cells, owned).astype(np.int32)
        self._cell, self._comm = self._hit(mesh, cells), mesh.comm
        found = self._comm.allgather(len(self._cell) > 0)
        if not any(found):
            raise ValueError(f"X = {tuple(X)} lies in no cell of the mesh")
        self._owner = found.index(True)

    def _hit(self, mesh: Mesh, cells: NDArray[np.int32]) -> NDArray[np.int32]:
        """(0 or 1,) a cell that holds the point."""
        from dolfinx import geometry

        if not len(cells):
            return cells
        padding = ROUND_OFF * float(np.abs(mesh.geometry.x).max())
        tree = geometry.bb_tree(mesh, mesh.topology.dim, entities=cells, padding=padding)
        near = geometry.compute_collisions_points(tree, self._point)
        return np.asarray(geometry.compute_colliding_cells(mesh, near, self._point).links(0)[:1])

    def __call__(self) -> Array:
        """(components,) u at the point now (collective)."""
        value = np.zeros(int(np.prod(self._u.ufl_shape)))
        if self._comm.rank == self._owner:
            value[:] = self._u.eval(self._point, self._cell).ravel()
        self._comm.Bcast(value, root=self._owner)
        return value


def deformed_cells(u: fem.Function) -> Array | None:
    """(cells, points, gdim) current outlines of all cells in drawing order, on rank 0 (else None): the corners of
    two-dimensional cells, all nodes along the cells of a curve."""
    V, mesh = u.function_space, u.function_space.mesh
    if mesh.topology.dim == 3:
        raise ValueError(
            f"u: cells in space ({mesh.topology.cell_name()}) have no outline; output.picture draws bodies"
        )
    order = {"interval": [0, *range(2, V.element.basix_element.dim), 1], "triangle": [0, 1, 2]}.get(
        mesh.topology.cell_name(), [0, 1, 3, 2]
    )
    dofs = V.dofmap.list[: mesh.topology.index_map(mesh.topology.dim).size_local, order]
    gathered = mesh.comm.gather(_current(u)[dofs], root=0)
    return np.concatenate(gathered) if gathered is not None else None


def extent(u: fem.Function, cells: NDArray[np.int32]) -> tuple[Array, Array]:
    """Lower and upper corner (gdim,) of the box around the deformed nodes of `cells` (this rank's), on every rank."""
    V = u.function_space
    x = _current(u)[V.dofmap.list[cells].ravel()]
    low = np.min(V.mesh.comm.allgather(x.min(axis=0, initial=np.inf)), axis=0)
    return low, np.max(V.mesh.comm.allgather(x.max(axis=0, initial=-np.inf)), axis=0)


def _current(u: fem.Function) -> Array:
    """(nodes, gdim) current positions of this rank's nodes."""
    V = u.function_space
    X = V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim]
    return np.asarray(X + u.x.array.reshape(-1, V.dofmap.index_map_bs))
