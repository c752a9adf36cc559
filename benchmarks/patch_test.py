"""The defect of the patch test against the number of integration points, as Markdown tables.

    ./run python3 benchmarks/patch_test.py

Two blocks, 1 m × 0.5 m, in space 0.5 m wide, St Venant–Kirchhoff, on rollers under a uniform pressure, the upper one the
contactor: the largest relative error of the pressure at the contactor's points, for numbers of cells along the two sides of
the interface. Gauss points of some degrees, by default as many as the package takes, and segments, also with blocks of unlike
stiffness (the worse of upper to lower 1e-3 and 1e3; ν = 0, or the softer would bulge over the other's edge).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary

from dolfinx_mortar_al import Contact, ContactProblem, Surface, loads, materials, quasistatic
from meshes.two_beams import LOWER, LOWER_TOP, UPPER, UPPER_BOTTOM, TwoBeams

PRESSURE, HEIGHT = 2e4, 0.5  # Pa, m
YOUNG = 2e6  # Pa, of the softer block
DEGREES, DEGREES_IN_SPACE, THROUGH = (2, 4, 8, 14, 30), (4, 8, 14), 2


def defect(
    order: int,
    cells: tuple[int, int],
    *,
    dim: int = 2,
    triangles: bool = False,
    ratio: float = 1.0,
    **options: Any,
) -> tuple[float, float]:
    """Largest relative error of the pressure, and the mean number of points on a facet; `ratio` of the upper block's Young's
    modulus to the lower one's, `options` of :class:`Contact`."""
    shape = TwoBeams(height=HEIGHT, width=HEIGHT, along=cells, across=2, through=THROUGH, dim=dim, triangles=triangles)
    mesh, body, tags = shape.create()
    V = fem.functionspace(mesh, ("Lagrange", order, (dim,)))
    u = fem.Function(V)
    bcs = []
    for axis, value in ((0, 0.0), (1, -HEIGHT), (2, 0.0))[:dim]:
        W = V.sub(axis).collapse()[0]
        facets = locate_entities_boundary(mesh, dim - 1, lambda x, axis=axis, value=value: np.isclose(x[axis], value))
        bcs.append(
            fem.dirichletbc(
                fem.Function(W), fem.locate_dofs_topological((V.sub(axis), W), dim - 1, facets), V.sub(axis)
            )
        )
    p = fem.Constant(mesh, 0.0)
    on_top = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(mesh)[1], 0.999 * HEIGHT), 1.0, 0.0)
    down = ufl.as_vector([0.0, -1.0, 0.0][:dim])
    dx = ufl.Measure("dx", mesh, subdomain_data=body)
    stiffness = {LOWER: max(1.0, 1.0 / ratio) * YOUNG, UPPER: max(1.0, ratio) * YOUNG}
    F = -loads.dead_traction(u, p * on_top * down, ufl.Measure("ds", mesh))
    for tag, young in stiffness.items():
        F += materials.saint_venant_kirchhoff(young, 0.3 if ratio == 1.0 else 0.0).virtual_work(u, dx=dx(tag))
    contact = Contact(Surface(mesh, tags, UPPER_BOTTOM), Surface(mesh, tags, LOWER_TOP), **options)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    for _ in quasistatic.march(problem, p, to=PRESSURE, increments=1):
        pass
    pair = problem.pairs[0]
    return float(np.abs(pair.state.p / PRESSURE - 1).max()), pair.integration.size / pair.facets.size


def row(label: str, order: int, cells: tuple[int, int], degrees: tuple[int, ...], **options: Any) -> None:
    """One line: Gauss points of the degrees and of the default, segments, and segments between unlike blocks."""
    found = [defect(order, cells, quadrature_degree=degree, **options)[0] for degree in degrees]
    said = [f"{error:.1e}" for error in found]
    for integration in ("gauss", "segments"):
        error, points = defect(order, cells, integration=integration, **options)
        said.append(f"{error:.1e} ({points:.0f})")
    unlike = [defect(order, cells, integration="segments", ratio=ratio, **options)[0] for ratio in (1e-3, 1e3)]
    print(f"| {label} | {cells[0]}, {cells[1]} | " + " | ".join([*said, f"{max(unlike):.1e}"]) + " |", flush=True)


def head(degrees: tuple[int, ...]) -> None:
    names = [f"degree {d}" for d in degrees]
    names += ["default (points)", "segments (points)", "unlike blocks"]
    print("\n| order | target, contactor | " + " | ".join(names) + " |")
    print("|" + "---|" * (len(names) + 2))


if __name__ == "__main__":
    head(DEGREES)
    for order in (1, 2):
        for cells in ((6, 6), (5, 7), (7, 5), (16, 4), (16, 2), (2, 16), (16, 1)):
            row(str(order), order, cells, DEGREES)
    head(DEGREES_IN_SPACE)
    for order in (1, 2):
        for triangles in (True, False):
            for cells in ((3, 3), (2, 3), (3, 2), (8, 1), (1, 8)):
                kind = "tetrahedra" if triangles else "hexahedra"
                row(f"{order}, {kind}", order, cells, DEGREES_IN_SPACE, dim=3, triangles=triangles)
