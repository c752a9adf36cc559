"""Loose blocks on loose planks on two rigid cylinders, under their weight with friction: who fails, rejections, iterations.

    ./run python3 benchmarks/planks.py [--seed 5] [--scenes 40]

All touch where the meshes have them, and contact alone holds both: the plank touches the cylinders at points, the block lies
on the plank, and both come down together before anything resists. Statics gives the forces on the cylinders while the plank
is nearly straight; draws whose plank would sag by more than .1 of its depth are left out.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import ufl
from dolfinx import fem

sys.path.append(str(Path(__file__).resolve().parents[1]))
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, quasistatic
from dolfinx_mortar_al.verify.meshes import build as build_grids
from dolfinx_mortar_al.verify.meshes import grid

LENGTH, DEPTH, SPAN, WEIGHT = 10.0, 0.5, 6.0, 1000.0  # m, m, m, N/m³
BLOCK = (2.0, 1.0)  # m
RIGHT = 0.01  # of the weight of both: by as much the forces on the cylinders may be off those on a straight plank
LOWER, UPPER = 1, 2


@dataclass(frozen=True)
class Scene:
    """A plank, and a block whose middle is `off` its middle (m).

    Attributes:
        order: of the elements, cell: of both bodies.
        along, across: cells of the plank; block: cells along the block, half as many upwards.
        young: of both bodies (Pa).
        increments: of the weight.
    """

    order: int = 1
    cell: str = "quadrilateral"
    along: int = 20
    across: int = 2
    block: int = 4
    off: float = 0.0
    young: float = 1e7
    friction: float = 0.3
    increments: int = 1

    @property
    def sag(self) -> float:
        """Of a straight beam's middle under its own weight and the block's, in plane stress, over its depth."""
        load = WEIGHT * (DEPTH + BLOCK[0] * BLOCK[1] / SPAN)
        return 5 * load * SPAN**4 / (384 * self.young * DEPTH**3 / 12) / DEPTH

    @property
    def expected(self) -> tuple[float, float]:
        """What the cylinders bear (N)."""
        plank, block = WEIGHT * LENGTH * DEPTH, WEIGHT * BLOCK[0] * BLOCK[1]
        return plank / 2 + block * (0.5 - self.off / SPAN), plank / 2 + block * (0.5 + self.off / SPAN)


def rectangle(
    scene: Scene, corner: tuple[float, float], size: tuple[float, float], cells: tuple[int, int]
) -> tuple[Body, Surface, Surface, fem.Constant]:
    """A body, its lower and its upper side, and its weight (N/m³)."""
    axes = [np.linspace(start, start + length, n + 1) for start, length, n in zip(corner, size, cells, strict=True)]
    sides = {(1, 0): LOWER, (1, -1): UPPER}
    domain, _, tags = build_grids([grid(axes, sides, order=1, simplices=scene.cell == "triangle")])
    u, weight = fem.Function(fem.functionspace(domain, ("Lagrange", scene.order, (2,)))), fem.Constant(domain, 0.0)
    down = (ufl.as_vector([0 * weight, -weight]), ufl.dx(domain))
    body = Body(u, materials.neo_hookean(scene.young, 0.3), external=down)
    return body, Surface(domain, tags, LOWER), Surface(domain, tags, UPPER), weight


def build(scene: Scene) -> tuple[ContactProblem, list[fem.Constant]]:
    """The problem, its pairs those of the left and the right cylinder and of the block, and the weights (N/m³)."""
    plank, below, above, first = rectangle(scene, (-LENGTH / 2, 0.0), (LENGTH, DEPTH), (scene.along, scene.across))
    corner = (scene.off - BLOCK[0] / 2, DEPTH)
    block, under, _, second = rectangle(scene, corner, BLOCK, (scene.block, scene.block // 2))
    contacts = [
        Contact(below, obstacles.RigidSphere([x, -1.0], 1.0), friction=scene.friction, name=name)
        for x, name in ((-SPAN / 2, "left"), (SPAN / 2, "right"))
    ]
    contacts.append(Contact(under, above, friction=scene.friction, name="block"))
    return ContactProblem([plank, block], contacts=contacts), [first, second]


def march(scene: Scene) -> tuple[ContactProblem, list[quasistatic.Step]]:
    """The problem at the end, and the steps."""
    problem, weights = build(scene)

    def lay_on(share: float) -> None:
        for weight in weights:
            weight.value = share * WEIGHT

    return problem, list(quasistatic.march(problem, lay_on, to=1.0, increments=scene.increments))


def drawn(seed: int, count: int) -> Iterator[Scene]:
    """Scenes with straight planks."""
    rng = np.random.default_rng(seed)
    while count:
        scene = Scene(
            order=int(rng.choice([1, 2])),
            cell=str(rng.choice(["triangle", "quadrilateral"])),
            along=int(rng.integers(8, 60)),
            across=int(rng.integers(1, 5)),
            block=2 * int(rng.integers(1, 6)),
            off=float(rng.uniform(-1.9, 1.9)),
            young=float(10 ** rng.uniform(6.5, 9.0)),
            friction=float(10 ** rng.uniform(-1.0, 0.0)),
            increments=int(rng.choice([1, 2, 5])),
        )
        if scene.sag < 0.1:
            count -= 1
            yield scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--scenes", type=int, default=40)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    right, failed, rejected, iterations, steps = 0, 0, 0, 0, 0
    for scene in drawn(args.seed, args.scenes):
        start = perf_counter()
        try:
            problem, taken = march(scene)
        except quasistatic.StepFailure as failure:
            failed += 1
            print(f"failed     {scene}: {str(failure)[:160]}", flush=True)
            continue
        forces = [problem.pairs[k].force()[1] for k in (0, 1)]
        off = max(abs(a - b) for a, b in zip(forces, scene.expected, strict=True)) / sum(scene.expected)
        right += off < RIGHT
        n, again = sum(step.iterations for step in taken), sum(step.rejected for step in taken)
        iterations, rejected, steps = iterations + n, rejected + again, steps + len(taken)
        print(f"{n:4d} its, {again} again, off by {off:.1e}, {perf_counter() - start:.1f} s {scene}", flush=True)
    print(f"{args.scenes} scenes: {right} right to {RIGHT:.0%} of the weight, {failed} failed, {rejected} trials rejected, "
          f"{iterations} iterations in {steps} steps")  # fmt: skip


if __name__ == "__main__":
    main()
