"""Meshes of the scenes of `robustness_scenes`: two bodies that share no node, each a mapped grid or a disc.

Bodies are meshed on the unit square or cube, where their faces have names, and then placed node by node, so that facets of
second order follow the curved surfaces.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from dolfinx import mesh
from mpi4py import MPI
from numpy.typing import NDArray
from robustness_scenes import CONTACT, HELD, LOADED, LOWER, UPPER, Body, Scene, turned
from scipy.interpolate import LinearNDInterpolator

from meshes.gmsh_session import distribute, structured_box
from meshes.two_membranes import TwoMembranes

__all__ = ["create"]

Array = NDArray[np.float64]


def _recess(body: Body, x: Array) -> Array:
    """How far (m) a block's contact face lies behind y = 0 at (n, 1 or 2) distances x from its middle."""
    kind, *sizes = body.profile
    if kind == "parabola":
        return sizes[0] * (x**2).sum(axis=1) / 2
    if kind == "barrel":
        return sizes[0] * x[:, -1] ** 2 / 2
    if kind == "wave":
        return sizes[0] * (1 - np.cos(2 * np.pi * x[:, 0] / sizes[1]))
    if kind == "round":  # an eighth of a circle, so that the corner's cell keeps its shape
        radius, arc = sizes[0], sizes[0] * math.sin(math.pi / 4)
        s = np.clip(np.abs(x[:, 0]) - body.size[0] / 2 + arc, 0, arc)
        return radius - np.sqrt(radius**2 - s**2)
    return np.zeros(len(x))


def _place(body: Body, ξ: Array, up: bool) -> Array:
    """(n, dim) positions in m of reference points ξ in the unit square or cube; `up`: the body is the upper one."""
    if body.shape == "disc":
        return body.size[0] * (2 * ξ - [1, 0])
    if body.shape == "arc":
        outer, inner, angle = body.size
        r, θ = outer + (inner - outer) * ξ[:, 1], angle * (ξ[:, 0] - 0.5)
        return np.stack([r * np.sin(θ), outer - r * np.cos(θ)], axis=1)
    x = np.array(ξ)
    x[:, [0, *range(2, x.shape[1])]] -= 0.5
    x *= body.size
    deep = ξ[:, 1] if up else 1 - ξ[:, 1]  # 0 on the contact face
    x[:, 1] = (1 if up else -1) * (body.size[1] * deep + _recess(body, np.delete(x, 1, axis=1)) * (1 - deep))
    x[:, 0] += body.centre
    return x


def _disc(gmsh: Any, x: float, around: int, simplices: bool, tag: int) -> dict[str, int]:
    """A disc of diameter 1 in the unit square at x: its three arcs by name, the top one and two that meet at the bottom."""
    model = gmsh.model
    at = [(x + 0.5 + 0.5 * math.cos(a), 0.5 + 0.5 * math.sin(a)) for a in (math.pi / 6, 5 * math.pi / 6, 1.5 * math.pi)]
    right, left, low, centre = (model.occ.addPoint(*p, 0) for p in [*at, (x + 0.5, 0.5)])
    ends = {"top": (right, left), "left": (left, low), "right": (low, right)}
    arcs = {name: model.occ.addCircleArc(a, centre, b) for name, (a, b) in ends.items()}
    surface = model.occ.addPlaneSurface([model.occ.addCurveLoop(list(arcs.values()))])
    model.occ.remove([(0, centre)])
    model.occ.synchronize()
    for arc in arcs.values():
        model.mesh.setTransfiniteCurve(arc, 2 * max(1, round(around / 6)) + 1)  # even: full-quad halves it
    rim = math.pi / around
    inside = max(rim, min(0.15, 4 * rim))  # elements grow by a quarter of the way
    layer, field = min(0.45, 4 * (inside - rim)), model.mesh.field.add("Ball")
    sizes = {"VIn": inside, "VOut": rim, "Radius": 0.5 - layer, "Thickness": layer, "XCenter": x + 0.5, "YCenter": 0.5}
    for name, value in sizes.items():
        model.mesh.field.setNumber(field, name, value)
    model.mesh.field.setAsBackgroundMesh(field)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    if not simplices:
        model.mesh.setRecombine(2, surface)
        gmsh.option.setNumber("Mesh.RecombinationAlgorithm", 3)  # the one that leaves no triangle
        gmsh.option.setNumber("General.Terminal", 0)  # it warns of the slab, which comes out as it should
    model.addPhysicalGroup(2, [surface], tag)
    return arcs


def create(scene: Scene) -> tuple[Any, Any, Any]:
    """(mesh, cell tags, facet tags) of a scene on one process; of membranes, with the tags of `meshes.two_membranes`."""
    if scene.family == "membranes":
        cells = (scene.lower.cells[0], scene.upper.cells[0])
        return TwoMembranes(shift=scene.upper.centre, height=scene.gap, cells=cells).create(MPI.COMM_SELF)
    d = scene.dim
    bodies = {LOWER: scene.lower, UPPER: scene.upper}

    def build(gmsh: Any) -> None:
        for tag, body in bodies.items():
            x = 2.0 * (tag - LOWER)
            if body.shape == "disc":
                faces = _disc(gmsh, x, body.cells[0], scene.simplices, tag)
            else:
                box = structured_box(gmsh, [x, 0, 0], [1.0] * d, body.cells, scene.simplices, tag)
                centre = np.array([gmsh.model.occ.getCenterOfMass(d - 1, face)[:d] for face in box]) - np.eye(d)[0] * x
                ends = (("left", "right"), ("bottom", "top"), ("back", "front"))[:d]
                faces = {
                    end: box[np.argmin(np.abs(centre[:, i] - k))] for i, e in enumerate(ends) for k, end in enumerate(e)
                }
            for kind, names in ((CONTACT, body.contact), (HELD, body.held), (LOADED, body.loaded)):
                if names:
                    gmsh.model.addPhysicalGroup(d - 1, [faces[name] for name in names], 10 * tag + kind)
        gmsh.model.mesh.generate(d)
        gmsh.model.mesh.setOrder(scene.geometry_order)

    domain, cell_tags, facet_tags = distribute(build, MPI.COMM_SELF, d)
    x = domain.geometry.x
    upper = x[:, 0] > 1.5
    for tag, body in bodies.items():
        mine = upper == (tag == UPPER)
        x[mine, :d] = _place(body, x[mine, :d] - np.eye(d)[0] * 2.0 * (tag - LOWER), tag == UPPER)
    for angle, mine in zip(scene.tilt, (~upper, upper), strict=True):
        if angle:
            axes = [1, 2] if d == 3 and not upper[mine].any() else [0, 1]
            middle = (x[mine].min(axis=0) + x[mine].max(axis=0)) / 2
            x[np.ix_(mine, axes)] = turned(angle, (x[mine] - middle)[:, axes]) + middle[axes]
            x[mine, 1] -= x[mine, 1].max() if not upper[mine].any() else 0.0
    domain.topology.create_connectivity(d - 1, d)
    touching = []
    for tag in bodies:
        nodes = mesh.entities_to_geometry(domain, d - 1, facet_tags.find(10 * tag + CONTACT))
        touching.append(x[np.unique(nodes), :d])
    x[upper, 1] += scene.gap - (_clearance if d == 2 else _clearance_in_space)(*touching)
    x[:, :d] = turned(scene.incline, x[:, :d])
    return domain, cell_tags, facet_tags


def _clearance(lower: Array, upper: Array) -> float:
    """Least vertical distance of two polylines given by their nodes, of the upper one's lower part (m)."""
    heights = []
    upper = upper[upper[:, 1] <= upper[:, 1].min() + 0.4 * np.ptp(upper[:, 1])]
    envelope = []
    for nodes, sign in ((lower, -1), (upper, 1)):  # one node per x: the one nearer to the other body
        order = np.lexsort((sign * nodes[:, 1], np.round(nodes[:, 0], 9)))
        first = np.unique(np.round(nodes[order, 0], 9), return_index=True)[1]
        envelope.append(nodes[order][first].T)
    for (x, y), (xs, ys), sign in ((envelope[1], envelope[0], 1), (envelope[0], envelope[1], -1)):
        inside = (x >= xs[0]) & (x <= xs[-1])
        heights.append((sign * (y - np.interp(x, xs, ys)))[inside].min(initial=np.inf))
    return float(min(heights))


def _clearance_in_space(lower: Array, upper: Array) -> float:
    """The same of two surfaces that are functions of x and z."""
    heights = [np.inf]
    for mine, other, sign in ((upper, lower, 1), (lower, upper, -1)):
        there = LinearNDInterpolator(other[:, [0, 2]], other[:, 1])(mine[:, [0, 2]])
        heights.append(np.nanmin(sign * (mine[:, 1] - there), initial=np.inf))
    return float(min(heights))
