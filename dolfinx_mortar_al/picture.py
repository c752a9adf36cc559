"""A picture of the deformed bodies in one line, off screen, by PyVista."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from basix import CellType
from dolfinx import fem, mesh
from numpy.typing import NDArray

from dolfinx_mortar_al import rendering
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.contactor_functions import ContactorFunctions
from dolfinx_mortar_al.problem import ContactProblem, check_problem
from dolfinx_mortar_al.ranks import agreed, on_root
from dolfinx_mortar_al.surface import Facets, ShapeFunctions, Surface
from dolfinx_mortar_al.validation import path_of, vector, whole

__all__ = ["picture"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LABELS = {"displacement": "displacement (m)", "pressure": "contact pressure (Pa)"}
CURVED = 4  # straight pieces of a curved edge
THROUGH = 0.12  # opacity of bodies before the contact surface
PATIENCE = 300  # s that a drawing may take
FROM_FRONT = (0.5, -1.0, 0.5)


def picture(
    problem: ContactProblem,
    path: Path | str,
    colour: str = "displacement",
    *,
    view: Sequence[float] | None = None,
    up: Sequence[float] | None = None,
    size: Sequence[int] = (1200, 800),
    title: str = "",
) -> None:
    """Draw the bodies as they are now into a PNG file, without a screen (collective; rank 0 draws).

    It takes PyVista (Debian: python3-pyvista with xvfb and xauth, for machines without a display; or ``pip install
    pyvista``).

    Args:
        problem: whose bodies to draw.
        path: of the file, which ends in .png; its folder is made if missing.
        colour: "displacement", its length on the surface of all bodies (m), or "pressure", the nominal contact
            pressure on the contactors (Pa), seen through the bodies.
        view: (3,) direction from the bodies to the viewer; default FROM_FRONT, in the plane from above.
        up: (3,) what points up in the picture; default z, in the plane y.
        size: width and height in pixels.
        title: above the bodies.

    Raises:
        ValueError: on every rank: an unknown colour, a file of another kind, or a view along `up`.
        ModuleNotFoundError: on every rank, if there is no PyVista.
        RuntimeError: on every rank, if it cannot draw; OSError, if the file cannot be written.
    """
    check_problem(problem)
    path = path_of("path", path)
    if colour not in LABELS:
        raise ValueError(f'colour = "{colour}": "displacement" or "pressure"')
    if path.suffix.lower() != ".png":
        raise ValueError(f"path = {str(path)!r}: pictures are PNG files; let it end in .png")
    width, height = (whole("size", n, least=16, most=16384) for n in vector("size", size, 2))
    camera = _camera(view, up, problem.gdim)
    agreed(problem.comm, "colour, path", (colour, str(path)))
    on_root(problem.comm, _check_pyvista)
    parts = [_bulk(body.u, coloured=colour == "displacement") for body in problem.bodies.bodies]
    if colour == "pressure":
        parts += _contactors(problem.pairs)
    gathered = problem.comm.gather(parts, root=0)
    scene: dict[str, Any] = {"camera": camera, "size": (width, height), "label": LABELS[colour], "title": title}
    scene["opacity"] = THROUGH if colour == "pressure" and problem.gdim == 3 else 1.0

    def draw() -> None:
        assert gathered is not None
        _draw(scene | _joined([part for rank in gathered for part in rank]), path)

    on_root(problem.comm, draw)


def _camera(view: Sequence[float] | None, up: Sequence[float] | None, gdim: int) -> Array:
    """(2, 3) directions towards the viewer and upwards."""
    plane = gdim == 2
    towards = vector("view", ((0.0, 0.0, 1.0) if plane else FROM_FRONT) if view is None else view, 3)
    upwards = vector("up", ((0.0, 1.0, 0.0) if plane else (0.0, 0.0, 1.0)) if up is None else up, 3)
    if np.linalg.norm(np.cross(towards, upwards)) <= 1e-9 * np.linalg.norm(towards) * np.linalg.norm(upwards):
        raise ValueError(f"view = {tuple(towards)} is along up = {tuple(upwards)}: choose another up")
    return np.stack([towards, upwards])


# ---------------------------------------------------------------- what is to be seen


@dataclass
class _Part:
    """Something to draw: points (n, 3) with values (n,), and numbers of points that make faces, edges and lines (m, k) each;
    whether it has a colour."""

    points: Array
    values: Array
    faces: Index
    edges: Index
    lines: Index
    coloured: bool


def _bulk(u: fem.Function, coloured: bool) -> _Part:
    """This rank's part of a body's surface."""
    V, gdim = u.function_space, u.function_space.mesh.geometry.dim
    shape, dofs = _outside(V)
    X = V.tabulate_dof_coordinates()[:, :gdim][dofs]
    return _part(shape, X, u.x.array.reshape(-1, gdim)[dofs], None, coloured)


def _contactors(pairs: Sequence[ContactPair]) -> list[_Part]:
    """This rank's part of the contactors with their pressures, of a surface that several pairs have in common with the sum
    (collective)."""
    by_surface: dict[tuple[int, int, Any], list[ContactPair]] = {}
    for pair in pairs:
        surface = pair.contact.contactor
        by_surface.setdefault((id(surface.mesh), id(surface.tags), surface.tag), []).append(pair)
    parts = []
    for alike in by_surface.values():
        facets, x = alike[0].facets, alike[0].kinematics.nodes()
        pressure = np.sum([ContactorFunctions(pair).nodal("pressure")[:, :, 0] for pair in alike], axis=0)
        parts.append(_part(facets.shape, facets.X, x - facets.X, pressure, True))
    return parts


def _outside(V: fem.FunctionSpace) -> tuple[ShapeFunctions, NDArray[np.int32]]:
    """What one sees of a body: shape functions and (nf, nodes) dofs of a solid's outer facets, or of all cells."""
    domain = V.mesh
    dim = domain.topology.dim
    if dim < 3:
        cells = domain.topology.index_map(dim).size_local
        return ShapeFunctions(domain.basix_cell(), V.element.basix_element.degree), V.dofmap.list[:cells]
    domain.topology.create_connectivity(dim - 1, dim)
    outer = np.sort(mesh.exterior_facet_indices(domain.topology))
    tags = mesh.meshtags(domain, dim - 1, outer, np.zeros(len(outer), dtype=np.int32))
    facets = Facets.of(Surface(domain, tags, 0), V)
    return facets.shape, facets.dofs


def _part(shape: ShapeFunctions, X: Array, u: Array, values: Array | None, coloured: bool) -> _Part:
    """Facets or cells with nodes X, u (nf, nodes, gdim), cut into flat pieces; values (nf, nodes), default the length
    of u."""
    count = CURVED if shape.order > 1 else 1
    η, faces, sides = _pieces(shape.cell, count)
    N = shape.tabulate(η)[0]
    x, moved = N @ (X + u), N @ u
    size = np.linalg.norm(moved, axis=2) if values is None else values @ N.T
    first = np.arange(len(X))[:, None, None] * len(η)
    place = np.zeros((x.shape[0] * x.shape[1], 3))
    place[:, : x.shape[2]] = x.reshape(-1, x.shape[2])
    pieces, edges = ((first + part).reshape(-1, part.shape[1]) for part in (faces, sides))
    if shape.dim == 1:
        return _Part(place, size.ravel(), np.zeros((0, 3), dtype=np.int64), edges, pieces, coloured)
    return _Part(place, size.ravel(), pieces, edges, np.zeros((0, 2), dtype=np.int64), coloured)


def _pieces(cell: CellType, n: int) -> tuple[Array, Index, Index]:
    """Points (k, dim) of a grid on the reference cell, n intervals along each side; the triangles, quadrilaterals cut
    in two, or intervals that they make; and the pieces of its sides (m, 2)."""
    if cell == CellType.interval:
        steps = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
        return np.linspace(0.0, 1.0, n + 1, dtype=np.float64)[:, None], steps, steps[:0]
    j, i = (grid.ravel() for grid in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    inside = i + j <= n if cell == CellType.triangle else np.ones(len(i), dtype=bool)
    number = np.full((n + 2, n + 2), -1)
    number[j[inside], i[inside]] = np.arange(inside.sum())
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    triangles = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (b, d, c))])
    triangles = triangles[(triangles >= 0).all(axis=1)]
    k = np.arange(n + 1)
    last = number[k, n - k] if cell == CellType.triangle else number[k, n]
    rows = [number[0, : n + 1], number[: n + 1, 0], last]
    rows += [] if cell == CellType.triangle else [number[n, : n + 1]]
    return np.stack([i, j], axis=1)[inside] / n, triangles, np.concatenate([np.stack([r[:-1], r[1:]], 1) for r in rows])


def _joined(parts: list[_Part]) -> dict[str, Any]:
    """All parts as one."""
    start = np.cumsum([0, *(len(part.points) for part in parts)])
    shifted = list(zip(parts, start, strict=False))

    def cells(kind: str, width: int) -> Index:
        return np.concatenate([np.zeros((0, width), dtype=np.int64), *(getattr(part, kind) + k for part, k in shifted)])

    return {
        "points": np.concatenate([part.points for part in parts]),
        "values": np.concatenate(
            [part.values if part.coloured else np.full_like(part.values, np.nan) for part in parts]
        ),
        "faces": cells("faces", 3),
        "edges": cells("edges", 2),
        "lines": cells("lines", 2),
        "plain": np.concatenate([np.full(len(part.faces), not part.coloured) for part in parts]),
    }


# ---------------------------------------------------------------- drawing


def _check_pyvista() -> None:
    if importlib.util.find_spec("pyvista") is None:
        raise ModuleNotFoundError(
            "picture: there is no PyVista; install it (Debian: python3-pyvista xvfb xauth; or pip install pyvista)"
        )


def _draw(scene: dict[str, Any], path: Path) -> None:
    """Let a process of its own draw the scene."""
    path.parent.mkdir(parents=True, exist_ok=True)
    screen = [] if os.environ.get("DISPLAY") or shutil.which("xvfb-run") is None else ["xvfb-run", "--auto-servernum"]
    alone = {name: value for name, value in os.environ.items() if not name.startswith(("OMPI_", "PMIX_", "PRTE_"))}
    with tempfile.TemporaryDirectory() as folder:
        file, drawn = Path(folder, "scene.npz"), Path(folder, "picture.png")
        np.savez(file, **scene)
        command = [*screen, sys.executable, "-P", rendering.__file__, str(file), str(drawn)]
        done = subprocess.run(command, env=alone, capture_output=True, text=True, timeout=PATIENCE)
        if done.returncode != 0 or not drawn.exists():
            said = "\n".join((done.stderr or done.stdout).strip().splitlines()[-3:])
            raise RuntimeError(
                f"picture: PyVista could not draw {path}; is there a display, or xvfb and xauth? It said: {said}"
            )
        shutil.copyfile(drawn, path)
