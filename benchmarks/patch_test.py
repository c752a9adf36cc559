"""The defect of the patch test against the number of integration points, as Markdown tables.

    ./run python3 benchmarks/patch_test.py

Two blocks, 1 m × 0.5 m, in space 0.5 m wide, St Venant–Kirchhoff, on rollers under a uniform pressure, the upper one the
contactor: the largest relative error of the pressure at the contactor's points, for numbers of cells along the two sides of
the interface. Gauss points of some degrees, by default as many as the package takes, and segments, also with blocks of unlike
stiffness (the worse of upper to lower 1e-3 and 1e3; ν = 0, or the softer would bulge over the other's edge).

Then a curved interface: two nested shells of radii 0.8, 1 and 1.2 m, a part of a sphere or a cylinder, elements and geometry
of order 2, linear elasticity. The same pressure acts on all of their boundary, so that both contract alike, by
𝐮 = −(1 − 2ν) p/E 𝐱, and the stress is −p everywhere: in the finite-element space, so that the bulk does not err. What
errs are two surfaces that do not fit, as the facets of each pass through its own nodes, and the integration. `--curved` runs
this part only; `--increments` brings the pressure on in few increments instead.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary
from mpi4py import MPI

from dolfinx_mortar_al import Contact, ContactProblem, Surface, loads, materials, quasistatic
from dolfinx_mortar_al.verify.meshes import Body, build, grid
from dolfinx_mortar_al.verify.model import elastic_work, hold
from meshes.two_beams import LOWER, LOWER_TOP, UPPER, UPPER_BOTTOM, TwoBeams

PRESSURE, HEIGHT = 2e4, 0.5  # Pa, m
YOUNG = 2e6  # Pa, of the softer block
DEGREES, DEGREES_IN_SPACE, THROUGH = (2, 4, 8, 14, 30), (4, 8, 14), 2
RADII, STRAIN, NU = (0.8, 1.0, 1.2), 0.1, 0.3  # of the shells (m); p/E
FIRST, SECOND, ENDS, LOADED, SIDES = 1, 2, 3, 4, 10  # facets: the interface's two sides, fixed planes from SIDES on
REFINEMENTS = (1, 2, 4)


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


def shell(kind: str, k: int, cells: tuple[int, int, int], simplices: bool) -> Body:
    """The inner (k = 0) or outer (1) shell: x and z round the axis y of a cylinder; or of a sphere the cone over a square."""

    def on_cylinder(x: np.ndarray) -> np.ndarray:
        return np.column_stack([x[:, 2] * np.sin(x[:, 0]), x[:, 1], x[:, 2] * np.cos(x[:, 0])])

    def on_sphere(x: np.ndarray) -> np.ndarray:
        ray = np.column_stack([np.tan(x[:, 0]), np.tan(x[:, 1]), np.ones(len(x))])
        return x[:, 2:] * ray / np.linalg.norm(ray, axis=1, keepdims=True)

    axes = [np.linspace(0, end, n + 1) for n, end in zip(cells, (np.pi / 4, np.pi / 4, 1.0), strict=True)]
    axes[2] = RADII[k] + (RADII[k + 1] - RADII[k]) * axes[2]
    faces = {(0, 0): SIDES, (1, 0): SIDES + 1, (0, -1): LOADED, (1, -1): LOADED}
    faces |= {(2, 0): (LOADED, SECOND)[k], (2, -1): (FIRST, LOADED)[k]}
    return grid(axes, faces, simplices=simplices, place=on_sphere if kind == "sphere" else on_cylinder)


def squeezed_shells(
    kind: str, simplices: bool, cells: tuple[int, int], swap: bool, increments: int = 8, **options: Any
) -> tuple[ContactProblem, int, int]:
    """The problem at its end, Newton's iterations and rejected trials, for numbers of cells (inner, outer) along each side of
    the interface; the inner shell is the contactor unless `swap`."""
    mesh, tags, facets = build([shell(kind, k, (n, n, 1), simplices) for k, n in enumerate(cells)])
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u, p = fem.Function(V), fem.Constant(mesh, 0.0)
    dx, ds = ufl.Measure("dx", mesh, subdomain_data=tags), ufl.Measure("ds", mesh, subdomain_data=facets)
    F = elastic_work(u, 1.0, NU, dx)
    F += p * ufl.inner(ufl.FacetNormal(mesh), ufl.TestFunction(V)) * ds(LOADED)
    W = V.sub(2).collapse()[0]
    height = fem.Function(W)  # of one node: all else is held by the planes and by contact
    height.interpolate(lambda x: -(1 - 2 * NU) * STRAIN * x[2])
    top = fem.locate_dofs_geometrical((V.sub(2), W), lambda x: np.isclose(x[2], RADII[2]) & np.isclose(x[1], 0.0))
    bcs = [hold(V, facets, SIDES + a, a) for a in (0, 1)] + [fem.dirichletbc(height, top, V.sub(2))]
    sides = [Surface(mesh, facets, tag) for tag in ((SECOND, FIRST) if swap else (FIRST, SECOND))]
    problem = ContactProblem(F, u, bcs=bcs, contacts=[Contact(*sides, **options)])
    steps = list(quasistatic.march(problem, p, to=STRAIN, increments=increments))
    return problem, sum(step.iterations for step in steps), sum(step.rejected for step in steps)


def pressure_error(problem: ContactProblem) -> tuple[float, float]:
    """Relative error of the pressure, in L2 and at most (collective)."""
    pair = problem.pairs[0]
    off = pair.state.p / STRAIN - 1
    square = problem.comm.allreduce(float(pair.j @ off**2))
    largest = problem.comm.allreduce(float(np.abs(off).max(initial=0.0)), MPI.MAX)
    return float(np.sqrt(square / pair.area)), largest


def curved_defect(
    kind: str, simplices: bool, cells: tuple[int, int], swap: bool, **options: Any
) -> tuple[float, float]:
    """:func:`pressure_error` of :func:`squeezed_shells`."""
    return pressure_error(squeezed_shells(kind, simplices, cells, swap, **options)[0])


def curved() -> None:
    """Defects and their orders, for Gauss points of the default and of degree 14, and for segments."""
    print("\n| interface, cells | inner, outer | contactor | integration | " + " | ".join(
        f"L2, {n}×" for n in REFINEMENTS) + " | order | " + " | ".join(
        f"largest, {n}×" for n in REFINEMENTS) + " | order |")  # fmt: skip
    print("|" + "---|" * (2 * len(REFINEMENTS) + 6))
    ways: dict[str, dict[str, Any]] = {
        "Gauss": {},
        "Gauss, degree 14": {"quadrature_degree": 14},
        "segments": {"integration": "segments"},
    }
    for kind in ("cylinder", "sphere"):
        for simplices in (False, True):
            for swap in (False,) if simplices else (False, True):
                for name, options in ways.items():
                    found = [curved_defect(kind, simplices, (3 * n, 2 * n), swap, **options) for n in REFINEMENTS]
                    said = [
                        f"{kind}, {'tetrahedra' if simplices else 'hexahedra'}",
                        "3, 2",
                        ("inner", "outer")[swap],
                        name,
                    ]
                    for column in zip(*found, strict=True):
                        order = np.log(column[-2] / column[-1]) / np.log(REFINEMENTS[-1] / REFINEMENTS[-2])
                        said += [*(f"{x:.1e}" for x in column), f"{order:.1f}"]
                    print("| " + " | ".join(said) + " |", flush=True)


def in_few_increments() -> None:
    """The coarsest curved interfaces, with the pressure brought on in 1, 2, 4 and 8 increments: largest relative error,
    iterations and rejected trials."""
    counts = (1, 2, 4, 8)
    print("\n| interface, cells | inner, outer | contactor | " + " | ".join(f"{n} increments" for n in counts) + " |")
    print("|" + "---|" * (len(counts) + 3))
    for kind in ("cylinder", "sphere"):
        for simplices in (False, True):
            for cells in ((2, 3), (3, 2)):
                for swap in (False, True):
                    said = []
                    for increments in counts:
                        try:
                            problem, iterations, rejected = squeezed_shells(kind, simplices, cells, swap, increments)
                        except quasistatic.StepFailure:
                            said.append("failed")
                        else:
                            said.append(f"{pressure_error(problem)[1]:.1e}, {iterations} ({rejected})")
                    name = f"{kind}, {'tetrahedra' if simplices else 'hexahedra'}"
                    head = f"{name} | {cells[0]}, {cells[1]} | {('inner', 'outer')[swap]}"
                    print(f"| {head} | " + " | ".join(said) + " |", flush=True)


def flat() -> None:
    """The tables of the flat interface."""
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


if __name__ == "__main__":
    if "--increments" in sys.argv:
        in_few_increments()
    else:
        if "--curved" not in sys.argv:
            flat()
        curved()
