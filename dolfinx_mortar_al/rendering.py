"""Draw a scene with PyVista, off screen: ``python3 -P rendering.py SCENE.npz PICTURE.png``.

A program of its own that `picture` calls: where VTK finds no display it ends the process, which must not be a run of hours.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["render"]

Array = NDArray[np.float64]

COLOURS = {"displacement (m)": "viridis"}  # any other quantity: from pale to dark
PLAIN, EDGES, BACKGROUND = "#c9ced6", "#3a3f47", "white"
LETTERS = 1 / 40  # of the picture's height
THIN, THICK = 1 / 900, 1 / 110
IN_FRONT = 1e-3  # of the scene's size: how far edges lie before their faces
MARGIN = 0.17  # of the width, for the scale


def render(scene: Mapping[str, Any], path: str) -> None:
    """Draw faces, edges and lines, and write a picture.

    Args:
        scene: `points` (n, 3); `faces`, `edges` and `lines` with numbers of points, (m, k) each; `plain` (m',) which faces
            have no colour; `values` (n,) to colour the others and the lines by, `label` of the scale, `opacity` of
            plain faces; `camera` (2, 3) direction towards the viewer and upwards; `size` in pixels; `title`.
        path: of the PNG file.
    """
    import pyvista

    width, height = (int(n) for n in scene["size"])
    plotter = pyvista.Plotter(off_screen=True, window_size=(width, height))
    plotter.set_background(BACKGROUND)
    letters = max(int(LETTERS * height), 8)
    bar = {
        "title": f"{scene['label']}\n", "color": EDGES, "n_labels": 5,
        "title_font_size": letters, "label_font_size": letters, "unconstrained_font_size": True,
        "fmt": "%.3g", "vertical": True, "height": 0.6, "width": 0.07, "position_x": 0.86, "position_y": 0.2,
    }  # fmt: skip
    values = scene["values"]
    coloured: dict[str, Any] = {
        "scalars": "value",
        "cmap": COLOURS.get(str(scene["label"]), "YlOrRd"),
        "clim": _limits(values),
        "nan_color": PLAIN,
        "scalar_bar_args": bar,
    }
    plain, solid = scene["plain"], bool(np.ptp(scene["points"][:, 2]) > 0)
    for cells, style in (
        (scene["faces"][plain], {"color": PLAIN, "opacity": float(scene["opacity"])}),
        (scene["faces"][~plain], coloured),
    ):
        if len(cells):
            plotter.add_mesh(_mesh(scene["points"], values, faces=cells), lighting=solid, ambient=0.3 * solid, **style)
    towards, up = scene["camera"]
    nearer = towards / np.linalg.norm(towards) * IN_FRONT * np.linalg.norm(np.ptp(scene["points"], axis=0))
    if len(scene["lines"]):
        lines = _mesh(scene["points"] + 2 * nearer, values, lines=scene["lines"])
        plotter.add_mesh(lines, line_width=THICK * height, render_lines_as_tubes=solid, lighting=solid, **coloured)
    if len(scene["edges"]):
        edges = _mesh(scene["points"] + nearer, values, lines=scene["edges"])
        opacity = min(1.0, 3 * float(scene["opacity"]))
        plotter.add_mesh(edges, color=EDGES, line_width=max(THIN * height, 1.0), opacity=opacity)
    if str(scene["title"]):
        plotter.add_text(
            str(scene["title"]), position=(0.03, 0.93), viewport=True, font_size=2 * letters // 3, color=EDGES
        )
    _look(plotter, scene["points"], towards, up, width / height)
    plotter.enable_anti_aliasing("ssaa")
    plotter.screenshot(path)
    plotter.close()


def _limits(values: Array) -> tuple[float, float]:
    """Of the scale: from 0 to the largest value."""
    finite = values[np.isfinite(values)]
    return 0.0, max(float(finite.max(initial=0.0)), 1e-300)


def _mesh(points: Array, values: Array, **cells: Any) -> Any:
    import pyvista

    numbered = {kind: np.insert(c, 0, c.shape[1], axis=1).ravel() for kind, c in cells.items()}
    mesh = pyvista.PolyData(points, **numbered)
    mesh["value"] = values
    return mesh


def _look(plotter: Any, points: Array, towards: Array, up: Array, aspect: float) -> None:
    """From far away, all points in sight, left of the scale; `aspect` is the picture's width over its height."""
    back = towards / np.linalg.norm(towards)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back])
    low, high = (points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0)
    width, height = (high - low)[:2]
    half = max(height / 2, width / 2 / (aspect * (1 - MARGIN)), 1e-300) * 1.15
    middle = (low + high) / 2 + np.array([half * aspect * MARGIN, 0.0, 0.0])
    far = np.linalg.norm(high - low)
    plotter.camera_position = [(middle + np.array([0.0, 0.0, far])) @ axes, middle @ axes, axes[1]]
    plotter.camera.parallel_projection, plotter.camera.parallel_scale = True, half
    plotter.renderer.ResetCameraClippingRange()
    if min(np.abs(back)[:2].max(), 1.0) > 0:  # seen from above a plane needs no axes
        plotter.add_axes(color=EDGES, line_width=2)


if __name__ == "__main__":
    with np.load(sys.argv[1]) as file:
        render(dict(file), sys.argv[2])
