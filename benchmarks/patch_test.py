"""The defect of the patch test against the number of integration points, as a Markdown table.

    ./run python3 benchmarks/patch_test.py

Two blocks, 1 m × 0.5 m, St Venant–Kirchhoff, on rollers under a uniform pressure, the upper one the contactor: the largest
relative error of the pressure at the contactor's points, for numbers of cells along the two sides of the interface.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))
from dolfinx_mortar_al import Contact, ContactProblem, Surface, loads, materials, quasistatic
from meshes.two_beams import LOWER_TOP, UPPER_BOTTOM, TwoBeams

PRESSURE, HEIGHT = 2e4, 0.5  # Pa, m
DEGREES = (2, 4, 8, 14, 30)


def defect(order: int, cells: tuple[int, int], degree: int | None) -> tuple[float, int]:
    """Largest relative error of the pressure, and the points on a facet."""
    mesh, _, tags = TwoBeams(height=HEIGHT, along=cells, across=2).create()
    V = fem.functionspace(mesh, ("Lagrange", order, (2,)))
    u = fem.Function(V)
    bcs = []
    for axis, value in ((0, 0.0), (1, -HEIGHT)):
        W = V.sub(axis).collapse()[0]
        facets = locate_entities_boundary(mesh, 1, lambda x, axis=axis, value=value: np.isclose(x[axis], value))
        bcs.append(
            fem.dirichletbc(fem.Function(W), fem.locate_dofs_topological((V.sub(axis), W), 1, facets), V.sub(axis))
        )
    p = fem.Constant(mesh, 0.0)
    on_top = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(mesh)[1], 0.999 * HEIGHT), 1.0, 0.0)
    F = materials.saint_venant_kirchhoff(2e6, 0.3).virtual_work(u)
    F -= loads.dead_traction(u, p * on_top * ufl.as_vector([0.0, -1.0]), ufl.Measure("ds", mesh))
    contact = Contact(Surface(mesh, tags, UPPER_BOTTOM), Surface(mesh, tags, LOWER_TOP), quadrature_degree=degree)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    for _ in quasistatic.march(problem, p, to=PRESSURE, increments=1):
        pass
    pair = problem.pairs[0]
    return float(np.abs(pair.state.p / PRESSURE - 1).max()), pair.integration.size // cells[1]


if __name__ == "__main__":
    print("| order | target, contactor | " + " | ".join(f"degree {d}" for d in DEGREES) + " | default (points) |")
    print("|" + "---|" * (len(DEGREES) + 3))
    for order in (1, 2):
        for cells in ((6, 6), (5, 7), (7, 5), (16, 4), (16, 1)):
            found = [f"{defect(order, cells, degree)[0]:.1e}" for degree in DEGREES]
            error, points = defect(order, cells, None)
            print(
                f"| {order} | {cells[0]}, {cells[1]} | " + " | ".join(found) + f" | {error:.1e} ({points}) |",
                flush=True,
            )
