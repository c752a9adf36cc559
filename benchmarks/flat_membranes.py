"""First steps of flat membranes without tension: iterations and rejected trials of drawn ones, each in one increment.

    ./run python3 benchmarks/flat_membranes.py [--seed 3] [--draws 30]

A square of 1 m (in the plane a strip), held at its edges, 1 mm thick, E = 2 MPa, of order 1 or 2: a rigid ball that touches
it is led in, or a pressure blows it up, free or against a rigid plane. Sizes are drawn, ratios log-uniformly.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

sys.path.append(str(Path(__file__).resolve().parents[1]))
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, loads, membrane, obstacles, quasistatic


@dataclass(frozen=True)
class Sheet:
    """Cells along an edge, the cells' kind ("interval", "triangle", "quadrilateral") and the displacement's order."""

    cells: int
    kind: str
    order: int

    @property
    def gdim(self) -> int:
        return 2 if self.kind == "interval" else 3

    def create(self) -> tuple[fem.Function, mesh.MeshTags]:
        """Its displacement, and tags that mark all cells with 1."""
        n, d = self.cells, self.gdim
        if d == 2:
            x = np.linspace(0.0, 1.0, n + 1)[:, None]
            cells = np.column_stack([np.arange(n), np.arange(1, n + 1)])
        else:
            flat = mesh.create_unit_square(MPI.COMM_SELF, n, n, mesh.to_type(self.kind)).geometry
            x, cells = flat.x[:, :2], flat.dofmap
        element = basix.ufl.element("Lagrange", self.kind, 1, shape=(d,))
        X = np.column_stack([x, np.zeros(len(x))])
        domain = mesh.create_mesh(MPI.COMM_WORLD, cells=np.asarray(cells, dtype=np.int64), x=X, e=element)
        every = np.arange(domain.topology.index_map(d - 1).size_local, dtype=np.int32)
        tags = mesh.meshtags(domain, d - 1, every, np.ones(len(every), dtype=np.int32))
        return fem.Function(fem.functionspace(domain, ("Lagrange", self.order, (d,)))), tags


def problem_of(sheet: Sheet, obstacle: obstacles.Obstacle, side: float) -> tuple[ContactProblem, fem.Constant]:
    """The sheet before an obstacle on one side (±1) of it, and the pressure that blows it up."""
    u, tags = sheet.create()
    V, d = u.function_space, sheet.gdim
    held = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[: d - 1] * (1 - X[: d - 1]), 0.0).any(axis=0))
    P, up = fem.Constant(V.mesh, 0.0), np.eye(d)[-1]
    body = Body(
        u,
        membrane.neo_hookean_membrane(E=2e6, nu=0.3, thickness=1e-3),
        external=loads.membrane_pressure(u, P, up, ufl.dx),
        bcs=[fem.dirichletbc(np.zeros(d), held, V)],
    )
    surface = Surface(V.mesh, tags, 1, side=side * up)
    return ContactProblem(body, contacts=[Contact(surface, obstacle)]), P


def ball(sheet: Sheet, radius: float, way: float, place: float) -> list[quasistatic.Step]:
    """A ball below `place` of each coordinate is led up by a way (m)."""
    centre = np.append(np.full(sheet.gdim - 1, place), -radius)
    obstacle = obstacles.RigidSphere(centre, radius)
    problem, _ = problem_of(sheet, obstacle, -1.0)
    up = np.eye(sheet.gdim)[-1]
    return list(quasistatic.march(problem, lambda s: obstacle.move(s * up), to=way, increments=1))


def pressure(sheet: Sheet, p: float, height: float) -> list[quasistatic.Step]:
    """A pressure p (Pa), below a plane at a height (m)."""
    up = np.eye(sheet.gdim)[-1]
    problem, P = problem_of(sheet, obstacles.RigidPlane(height * up, -up), 1.0)
    return list(quasistatic.march(problem, P, to=p, increments=1))


def draw(rng: np.random.Generator, dim: int) -> Sheet:
    kind = "interval" if dim == 2 else str(rng.choice(["triangle", "quadrilateral"]))
    return Sheet(int(rng.integers(8, 80) if dim == 2 else rng.integers(4, 10)), kind, int(rng.integers(1, 3)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument(
        "--draws", type=int, default=30, help="of each kind in the plane, a third in space (%(default)s)"
    )
    args = parser.parse_args()
    warnings.simplefilter("ignore")

    def ratio(rng: np.random.Generator, low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    kinds: dict[str, Callable[[np.random.Generator, Sheet], list[quasistatic.Step]]] = {
        "ball": lambda r, s: ball(s, ratio(r, 0.03, 2.0), ratio(r, 5e-4, 0.2), r.uniform(0.4, 0.6)),
        "pressure": lambda r, s: pressure(s, ratio(r, 0.1, 3e3), 1e3),
        "pressure, onto a plane": lambda r, s: pressure(s, ratio(r, 1.0, 3e3), ratio(r, 1e-3, 0.1)),
    }
    print("| | draws | failed | steps | rejected | iterations, first step in the median | most | all |")
    print("|" + "---|" * 8)
    for dim in (2, 3):
        for name, run in kinds.items():
            rng, first, steps, failed = np.random.default_rng([args.seed, dim]), [], [], 0
            for _ in range(args.draws if dim == 2 else args.draws // 3):
                try:
                    found = run(rng, draw(rng, dim))
                except quasistatic.StepFailure:
                    failed += 1
                    continue
                first.append(found[0].iterations)
                steps += found
            rejected, all_ = (sum(getattr(step, what) for step in steps) for what in ("rejected", "iterations"))
            numbers = f"{failed} | {len(steps)} | {rejected} | {np.median(first):.0f} | {max(first)} | {all_}"
            print(f"| {name}, {dim}D | {len(first) + failed} | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
