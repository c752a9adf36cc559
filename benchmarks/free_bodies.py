"""Bodies without friction that contact alone holds and that may spin or slide: iterations and rejected steps.

    ./run python3 benchmarks/free_bodies.py [--only PATTERN] [--mu MU] [--projection rays|closest] [--anchor]
    ./run python3 benchmarks/free_bodies.py --draw SEED --scenes N      # others, drawn at random

Each is squeezed by a tenth to a half of its radius between tools 1e4 times as stiff, if not said otherwise; some take a
pressure then, from the left or in their bore. With `--anchor` its middle node cannot move along x, and the last column says
what holds it there, as a share of the force that it is squeezed with: nothing should, where a body may slide.
"""

from __future__ import annotations

import argparse
import fnmatch
import warnings
from dataclasses import dataclass
from itertools import pairwise
from time import process_time

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, loads, materials, quasistatic
from dolfinx_mortar_al.versions import model_to_mesh

BODY, LOWER, UPPER, ROUND, LOW, TOP, BASE, HEAD, BORE = 1, 2, 3, 11, 12, 13, 14, 15, 16


@dataclass(frozen=True)
class Scene:
    """A body between a lower and an upper tool. `h`: cells of body and tools; `ratio`: stiffness of tools to body's."""

    body: str  # ring, roller, ball, block
    lower: str  # plate, groove, vee
    order: int = 2
    h: tuple[float, float] = (0.16, 0.16)
    ratio: float = 1e4
    squeeze: float = 0.3
    steps: int = 10
    pressure: float = 0.0  # in the bore or from the left, times E, in 5 steps
    unit: float = 1.0
    dim: int = 2
    nu: float = 0.45


SCENES = {
    "o-ring": Scene("roller", "groove", squeeze=0.5, pressure=0.4, nu=0.49),
    "o-ring, order 1": Scene("roller", "groove", order=1, squeeze=0.5, pressure=0.2, unit=1e-3),
    "o-ring, fine": Scene("roller", "groove", h=(0.1, 0.2), squeeze=0.4, steps=5, pressure=0.2),
    "roller": Scene("roller", "plate"),
    "roller, order 1": Scene("roller", "plate", order=1, unit=1e-3),
    "roller, fine on coarse": Scene("roller", "plate", h=(0.1, 0.4), steps=20),
    "roller, coarse on fine": Scene("roller", "plate", order=1, h=(0.3, 0.1), unit=1e-3),
    "roller, equal stiffness": Scene("roller", "plate", ratio=1.0, squeeze=0.1),
    "stiff roller": Scene("roller", "plate", ratio=1e-2, squeeze=0.1, unit=1e-3),
    "roller, two steps": Scene("roller", "plate", squeeze=0.1, steps=2),
    "roller, fifty steps": Scene("roller", "plate", order=1, squeeze=0.2, steps=50),
    "vee": Scene("roller", "vee", squeeze=0.3),
    "vee, order 1": Scene("roller", "vee", order=1, squeeze=0.2, unit=1e-3),
    "ring with pressure": Scene("ring", "plate", squeeze=0.1, pressure=0.01),
    "ring": Scene("ring", "plate", squeeze=0.4, unit=1e-3),
    "block": Scene("block", "plate", squeeze=0.1, nu=0.3),
    "ball": Scene("ball", "plate", order=1, h=(0.4, 0.5), squeeze=0.2, steps=4, dim=3),
    "ball in a vee": Scene("ball", "vee", order=1, h=(0.4, 0.6), squeeze=0.1, steps=4, dim=3, unit=1e-3),
}


def drawn(seed: int, count: int) -> dict[str, Scene]:
    """Scenes over the ranges that the list above covers."""
    rng, scenes = np.random.default_rng(seed), {}
    for k in range(count):
        dim = int(rng.choice([2, 2, 2, 3]))
        body = str(rng.choice(["ring", "roller", "block"])) if dim == 2 else "ball"
        lower = str(rng.choice(["plate", "plate", "vee"])) if body in ("roller", "ball") else "plate"
        own = float(rng.uniform(0.08, 0.3) if dim == 2 else rng.uniform(0.3, 0.5))
        tools = float(np.clip(own * 2.0 ** rng.uniform(-1.5, 1.5), 0.08 if dim == 2 else 0.4, 0.6))
        ratio, steps = float(10.0 ** rng.uniform(-2, 4)), int(rng.integers(2, 30))
        scenes[f"{seed}/{k}, {body} on {lower}"] = Scene(
            body,
            lower,
            order=int(rng.choice([1, 2])) if dim == 2 else 1,
            h=(own, tools),
            ratio=ratio,
            squeeze=float(rng.uniform(0.02, 0.3 if body == "ring" or ratio > 1 else 0.1)),
            steps=steps if dim == 2 else min(steps, 6),
            unit=float(rng.choice([1.0, 1e-3])),
            dim=dim,
            nu=float(rng.uniform(0.2, 0.48)),
        )
    return scenes


def prism(points: list[tuple[float, float]], dim: int) -> int:
    """A polygon, in space drawn out over 3 units of depth."""
    occ, k = gmsh.model.occ, range(len(points))
    corners = [occ.addPoint(x, y, -1.5 if dim == 3 else 0.0) for x, y in points]
    lines = [occ.addLine(a, b) for a, b in pairwise([*corners, corners[0]])]
    face = occ.addPlaneSurface([occ.addCurveLoop([lines[i] for i in k])])
    return face if dim == 2 else next(tag for d, tag in occ.extrude([(2, face)], 0, 0, 3.0) if d == 3)


def shape(scene: Scene) -> None:
    """Geometry, groups and mesh in Gmsh."""
    occ, dim = gmsh.model.occ, scene.dim
    if scene.body == "ball":
        body = occ.addSphere(0, 1.0, 0, 1.0)
    elif scene.body == "block":
        body = prism([(-1, 0), (1, 0), (1, 2), (-1, 2)], dim)
    else:
        body = occ.addDisk(0, 1.0, 0, 1.0, 1.0)
        if scene.body == "ring":
            body = occ.cut([(2, body)], [(2, occ.addDisk(0, 1.0, 0, 0.6, 0.6))])[0][0][1]
    outline = {
        "plate": [(-2.2, -0.6), (2.2, -0.6), (2.2, 0), (-2.2, 0)],
        "groove": [
            (-2.2, -0.6),
            (2.2, -0.6),
            (2.2, 1.5),
            (1.35, 1.5),
            (1.35, 0),
            (-1.35, 0),
            (-1.35, 1.5),
            (-2.2, 1.5),
        ],
        "vee": [(-2.2, -1.2), (2.2, -1.2), (2.2, 2.2 - 0.4142), (0, -0.4142), (-2.2, 2.2 - 0.4142)],
    }[scene.lower]
    top = 2.0
    lower = prism(outline, dim)
    upper = prism([(-2.2, top), (2.2, top), (2.2, top + 0.5), (-2.2, top + 0.5)], dim)
    occ.dilate([(dim, t) for t in (body, lower, upper)], 0, 0, 0, *3 * [scene.unit])
    occ.synchronize()
    groups: dict[int, list[int]] = {t: [] for t in (ROUND, LOW, TOP, BASE, HEAD, BORE)}
    for part, tag in ((BODY, body), (LOWER, lower), (UPPER, upper)):
        gmsh.model.addPhysicalGroup(dim, [tag], part)
        for d, facet in gmsh.model.getBoundary([(dim, tag)], oriented=False):
            x, y, _ = np.array(occ.getCenterOfMass(d, facet)) / scene.unit
            if part == BODY:
                bore = scene.body == "ring" and occ.getMass(d, facet) < 5.0 * scene.unit
                groups[BORE if bore else ROUND].append(facet)
            elif part == UPPER:
                side = TOP if y < top + 0.01 else HEAD if y > top + 0.49 else None
                if side:
                    groups[side].append(facet)
            elif y < min(p[1] for p in outline) + 0.01:
                groups[BASE].append(facet)
            elif abs(x) < 1.5 and y < 1.4 and (scene.dim == 2 or abs(occ.getCenterOfMass(d, facet)[2]) < scene.unit):
                groups[LOW].append(facet)
    for t, facets in groups.items():
        if facets:
            gmsh.model.addPhysicalGroup(dim - 1, facets, t)
    own, tools = (h * scene.unit for h in scene.h)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    gmsh.model.mesh.setSizeCallback(lambda d, tag, x, y, z, lc: own if (d, tag) in mine else tools)
    mine = {(dim, body), *((dim - 1, t) for t in groups[ROUND] + groups[BORE])}
    gmsh.model.mesh.generate(dim)


def run(scene: Scene, μ: float, projection: str, anchored: bool) -> str:
    """Increments, iterations, rejected trials and processor time (s) of a scene."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 1)
    shape(scene)
    domain, cells, facets = model_to_mesh(gmsh.model, MPI.COMM_WORLD, scene.dim)
    gmsh.finalize()
    d, E = scene.dim, 5e6 * (1.0 if scene.unit == 1.0 else 1e-6)
    V = fem.functionspace(domain, ("Lagrange", scene.order, (d,)))
    u, p, head = fem.Function(V), fem.Constant(domain, 0.0), fem.Constant(domain, np.zeros(d))
    dx, ds = (ufl.Measure(m, domain, subdomain_data=t) for m, t in (("dx", cells), ("ds", facets)))
    tool = materials.neo_hookean(E=E * scene.ratio, nu=0.3)
    form = materials.neo_hookean(E=E, nu=scene.nu).virtual_work(u, dx=dx(1)) + tool.virtual_work(u, dx=dx((2, 3)))
    if scene.pressure:
        left = 1.0 if scene.body == "ring" else ufl.conditional(ufl.SpatialCoordinate(domain)[0] < 0, 1.0, 0.0)
        form -= loads.pressure(u, p * left, ds(BORE if scene.body == "ring" else ROUND))
    bcs = [
        fem.dirichletbc(np.zeros(d), fem.locate_dofs_topological(V, d - 1, facets.find(BASE)), V),
        fem.dirichletbc(head, fem.locate_dofs_topological(V, d - 1, facets.find(HEAD)), V),
    ]
    if anchored:
        middle = np.array([0.0, scene.unit, 0.0])
        X = V.tabulate_dof_coordinates()
        Vx = V.sub(0).collapse()[0]
        nearest = X[np.argmin(np.linalg.norm(X - middle, axis=1))]
        at = fem.locate_dofs_geometrical(
            (V.sub(0), Vx), lambda x: np.linalg.norm(x.T - nearest, axis=1) < 1e-9 * scene.unit
        )
        bcs.append(fem.dirichletbc(fem.Function(Vx), at, V.sub(0)))
    surface = {t: Surface(domain, facets, t) for t in (ROUND, LOW, TOP)}
    contacts = [
        Contact(surface[ROUND], surface[t], friction=μ, name=n, projection=projection)
        for t, n in ((LOW, "lower"), (TOP, "upper"))
    ]
    problem = ContactProblem(Body(u, form, bcs=bcs), contacts=contacts)
    down = np.zeros(d)
    down[1] = -scene.squeeze * scene.unit
    stages = [quasistatic.Stage(head, tuple(down), scene.steps)]
    if scene.pressure:
        stages.append(quasistatic.Stage(p, scene.pressure * E, 5))
    count = iterations = rejected = 0
    start, what = process_time(), "done"
    try:
        for step in quasistatic.march(problem, stages):
            count, iterations, rejected = count + 1, iterations + step.iterations, rejected + step.rejected
    except quasistatic.StepFailure as failure:
        what = f"fails at {step.path if count else 0:.3f}: {str(failure)[:90]}"
    forces = np.abs([pair.force() for pair in problem.pairs])
    if what == "done" and not forces.any():
        what = "done, contact lost"
    elif anchored and count:
        along = abs(sum(pair.force()[0] for pair in problem.pairs))
        what += f", {along / forces[:, 1].max():.1e}"
    return f"{count} | {iterations} | {rejected} | {process_time() - start:.1f} | {what}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="*", help="which scenes, a pattern (%(default)s)")
    parser.add_argument("--mu", type=float, default=0.0, help="friction (%(default)s)")
    parser.add_argument("--anchor", action="store_true", help="hold a node along x")
    parser.add_argument("--projection", default="rays", help="of all pairs (%(default)s)")
    parser.add_argument("--draw", type=int, metavar="SEED", help="scenes drawn at random in place of the list")
    parser.add_argument("--scenes", type=int, default=20, help="how many are drawn (%(default)s)")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| scene | increments | iterations | rejected | s | |\n|---|---|---|---|---|---|")
    for name, scene in (SCENES if asked.draw is None else drawn(asked.draw, asked.scenes)).items():
        if fnmatch.fnmatch(name, asked.only):
            print(f"| {name} | {run(scene, asked.mu, asked.projection, asked.anchor)} |", flush=True)
