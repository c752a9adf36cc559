"""Wheels under their weight on a slab, rollers in a vee, with friction: what fails, rejected trials, iterations, who rolls.

    ./run python3 benchmarks/rolling.py [--seed 5] [--scenes 24]

Nothing but contact holds them, and contact is a point at first. A wheel may roll anywhere; it counts as rolled where its
middle is more than half of its own facet from where it stood, so that it has passed a place where it would have rested.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

sys.path.append(str(Path(__file__).resolve().parents[1]))
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, quasistatic
from meshes.round_bodies import Round, RoundBodies

R, E = 0.1, 1e6  # m, Pa
OUTER, INNER = 1, 2

Weighed = tuple[ContactProblem, fem.Constant]


@dataclass(frozen=True)
class Scene:
    """A wheel (slab's cells given) or a roller in a vee of sides at `angle` (degrees) to the horizontal.

    Attributes:
        order: of the elements, its geometry among them.
        size: of the round body's cells, bore: of its bore, gap: to the slab, in radii.
        cells: along each plate.
        weight: over E/R (N/m³), in `increments`.
        swap: whether the plates are the contactors.
    """

    order: int = 1
    size: float = 0.15
    bore: float = 0.3
    gap: float = 0.0
    cells: int = 17
    angle: float = 0.0
    friction: float = 0.3
    weight: float = 0.01
    increments: int = 3
    swap: bool = False


def plate(angle: float, young: float, cells: int) -> tuple[Body, Surface]:
    """A plate 4R long and R thick, held at its outer side, whose inner side touches the circle from below, turned by an
    angle (degrees) around its middle, and that side."""
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [[-2 * R, -2 * R], [2 * R, -R]], [cells, 1], mesh.CellType.quadrilateral
    )
    sides = [mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (-2 * R, -R)]
    facets, order = np.concatenate(sides), np.argsort(np.concatenate(sides))
    tags = mesh.meshtags(domain, 1, facets[order], np.repeat(np.int32([OUTER, INNER]), [len(f) for f in sides])[order])
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ [[c, s], [-s, c]]
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    bc = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(OUTER)), V)
    return Body(fem.Function(V), materials.neo_hookean(young, 0.3), bcs=[bc]), Surface(domain, tags, INNER)


def build(scene: Scene) -> Weighed:
    """The problem and the weight (N/m³)."""
    bodies = RoundBodies((Round((0.0, scene.gap * R), R, scene.bore * R, scene.size * R),), order=scene.order)
    domain, _, facets = bodies.create()
    u, weight = fem.Function(fem.functionspace(domain, ("Lagrange", scene.order, (2,)))), fem.Constant(domain, 0.0)
    down = (ufl.as_vector([0 * weight, -weight]), ufl.dx(domain))
    rim = Surface(domain, facets, bodies.rim(0))
    angles, young = ((-scene.angle, scene.angle), E) if scene.angle else ((0.0,), E / 3)
    plates = [plate(angle, young, scene.cells) for angle in angles]
    contacts = [
        Contact(*((side, rim) if scene.swap else (rim, side)), friction=scene.friction, name=f"plate {k}")
        for k, (_, side) in enumerate(plates)
    ]
    round_body = Body(u, materials.neo_hookean(E, 0.3), external=down)
    return ContactProblem([round_body, *(body for body, _ in plates)], contacts=contacts), weight


def middle(problem: ContactProblem) -> np.ndarray:
    """(2,) mean displacement of the round body (m), collective."""
    u = problem.bodies.bodies[0].u
    own = u.x.array[: 2 * u.function_space.dofmap.index_map.size_local].reshape(-1, 2)
    total = problem.comm.allreduce(np.r_[own.sum(axis=0), len(own)], MPI.SUM)
    return np.asarray(total[:2] / total[2])


def listed() -> Iterator[Scene]:
    """Orders, cells, friction, either side the contactor."""
    for order in (1, 2):
        for size, cells in ((0.15, 17), (0.3, 17), (0.1, 40), (0.2, 9)):
            for μ in (0.02, 0.3, 1.0):
                yield Scene(order, size, cells=cells, friction=μ)
        yield from (Scene(order, swap=True), Scene(order, gap=0.05), Scene(order, weight=0.03, increments=1))
        yield Scene(order, increments=20)
        for size in (0.15, 0.3):
            for μ in (0.1, 0.6):
                yield from (Scene(order, size, angle=45.0, cells=11, friction=μ, swap=swap) for swap in (False, True))
                yield Scene(order, size, angle=20.0, cells=11, friction=μ)


def drawn(seed: int, count: int) -> Iterator[Scene]:
    """As many wheels as rollers, over the ranges that the list covers and beyond."""
    rng = np.random.default_rng(seed)
    for k in range(2 * count):
        yield Scene(
            order=int(rng.choice([1, 2])),
            size=float(rng.uniform(0.08, 0.35)),
            bore=float(rng.uniform(0.1, 0.6)),
            gap=float(rng.choice([0.0, 0.0, 0.03])) if k % 2 else 0.0,
            cells=int(rng.integers(8, 45)),
            angle=0.0 if k % 2 else float(rng.uniform(15.0, 60.0)),
            friction=float(10.0 ** rng.uniform(-2, 0)),
            weight=float(10.0 ** rng.uniform(-3, -1.5)),
            increments=int(rng.integers(1, 12)),
            swap=bool(rng.integers(2)),
        )


def row(name: str, scenes: list[Scene]) -> None:
    """March scenes: a line of the table."""
    failed = tried_again = iterations = rejected = rolled = 0
    for scene in scenes:
        problem, weight = build(scene)
        try:
            steps = list(quasistatic.march(problem, weight, to=scene.weight * E / R, increments=scene.increments))
        except quasistatic.StepFailure:
            failed += 1
            continue
        again = sum(step.rejected for step in steps)
        tried_again, rejected = tried_again + (again > 0), rejected + again
        iterations += sum(step.iterations for step in steps)
        rolled += not scene.angle and abs(middle(problem)[0]) > scene.size / 2 * R
    print(f"| {len(scenes)} {name} | {failed} | {tried_again} | {iterations} ({rejected}) | {rolled} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, help="draw scenes at random in place of the list")
    parser.add_argument("--scenes", type=int, default=24, help="of each kind, if drawn (%(default)s)")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| | failed | with rejected trials | iterations (rejected) of the others | rolled |\n|---|---|---|---|---|")
    scenes = list(listed() if asked.seed is None else drawn(asked.seed, asked.scenes))
    row("wheels", [scene for scene in scenes if not scene.angle])
    row("rollers in a vee", [scene for scene in scenes if scene.angle])


if __name__ == "__main__":
    main()
