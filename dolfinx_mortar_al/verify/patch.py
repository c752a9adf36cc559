"""Patch tests: a uniform pressure across a flat interface of meshes that do not match."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_mortar_al import ContactProblem, Surface, loads, materials
from dolfinx_mortar_al.contact_fields import ContactFields
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import hold, make_contact, march, measures, profile, space, unknowns

__all__: list[str] = []

BOTTOM, LOWER, UPPER, TOP, SIDE = 1, 2, 3, 4, 10
PRESSURE, YOUNG = 2e4, 2e6  # Pa
EXACT = 1e-10
WHY = "exact: a uniform stress is in every finite-element space"


def stress_defect(u: fem.Function, laws: Sequence[materials.Hyperelastic], cell_tags: Any) -> float:
    """Largest |P + p| / p of the nominal stress across the interface, at Gauss points of all cells."""
    V = u.function_space
    points = basix.make_quadrature(V.mesh.basix_cell(), 2)[0]
    axis, worst = V.mesh.geometry.dim - 1, 0.0
    owned = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    for k, law in enumerate(laws, start=1):
        P = law.first_piola(materials.deformation_gradient(u))[axis, axis]
        cells = cell_tags.find(k)
        found = fem.Expression(P, points).eval(V.mesh, cells[cells < owned])
        worst = max(worst, float(np.abs(found / PRESSURE + 1).max(initial=0.0)))
    return float(V.mesh.comm.allreduce(worst, MPI.MAX))


def patch(
    dim: int, order: int, simplices: bool, stiff: bool, cells: tuple[int, int], effort: Effort
) -> tuple[float, float, int, ContactFields]:
    """(defect of the pressure, of the stress, unknowns, contact) of two blocks, the upper one the contactor."""
    bodies = []
    for k, n in enumerate(cells):
        axes = [np.linspace(0, 1, n + 1)] * (dim - 1) + [np.linspace(0, 0.5, max(2, n // 3) + 1) + 0.5 * (k - 1)]
        faces = {(dim - 1, 0): (BOTTOM, UPPER)[k], (dim - 1, -1): (LOWER, TOP)[k]} | {
            (a, 0): SIDE + a for a in range(dim - 1)
        }
        bodies.append(grid(axes, faces, order=1, simplices=simplices))
    domain, cell_tags, facets = build(bodies)
    V, u = space(domain, order)
    dx, ds = measures(domain, cell_tags, facets)
    lower, upper = ((YOUNG, 0.3), (YOUNG, 0.3)) if not stiff else ((10 * YOUNG, 0.0), (YOUNG, 0.0))
    laws, p = [materials.saint_venant_kirchhoff(*moduli) for moduli in (lower, upper)], fem.Constant(domain, 0.0)
    F = sum(law.virtual_work(u, dx=dx(k)) for k, law in enumerate(laws, start=1))
    F -= loads.dead_traction(u, -p * ufl.as_vector(np.eye(dim)[-1].tolist()), ds(TOP))
    bcs = [hold(V, facets, BOTTOM, dim - 1), *(hold(V, facets, SIDE + a, a) for a in range(dim - 1))]
    contact = make_contact(Surface(domain, facets, UPPER), Surface(domain, facets, LOWER), integration="segments")
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    march(problem, p, to=PRESSURE, increments=1, effort=effort)
    pair = problem.pairs[0]
    worst = pair.comm.allreduce(float(np.abs(pair.state.p / PRESSURE - 1).max(initial=0.0)), MPI.MAX)
    return worst, stress_defect(u, laws, cell_tags), unknowns(u), profile(problem)


def series(dim: int, quick: bool) -> Outcome:
    """The worst of all cells and orders, on matching and on non-matching meshes."""
    if dim == 2:
        meshes = [(5, 7)] if quick else [(5, 7), (10, 14), (20, 28)]
    else:
        meshes = [(2, 3)] if quick else [(2, 3), (4, 6)]
    runs = []
    for one in meshes:
        effort, values, count = Effort(), dict[str, tuple[float, float]](), 0
        for name, cells in (("matching", (one[0], one[0])), ("", one), ("coarse contactor, ", (one[1], one[0]))):
            found = []
            for order, simplices, stiff in product((1, 2), (False, True), (False, True)[: 4 - dim]):
                if dim == 3 and order == 2 and one != meshes[0]:
                    continue  # a Newton step of 30 s says nothing new
                pressure, stress, n, contact = patch(dim, order, simplices, stiff, cells, effort)
                found.append((pressure, stress))
                count = max(count, n)
            worst = np.max(found, axis=0)
            if name == "matching":
                values["matching: pressure and stress"] = (float(worst.max()), 0.0)
            else:
                values |= {f"{name}pressure": (float(worst[0]), 0.0), f"{name}stress": (float(worst[1]), 0.0)}

        def draw(axes: Any, contact: ContactFields = contact) -> None:
            axes.plot(contact.X[:, 0], contact.pressure / PRESSURE, ".", markersize=3)
            axes.set(xlabel="x (m)", ylabel="pressure / applied", title="coarse contactor, order 2, simplices")

        runs.append(Run(f"{one[0]}:{one[1]}", 1 / one[0], values, effort, count, draw))
    return Outcome(runs)


def quantities() -> list[Quantity]:
    made = [Quantity("matching: pressure and stress", WHY, EXACT, scale=1.0)]
    for name in ("pressure", "stress", "coarse contactor, pressure", "coarse contactor, stress"):
        made.append(Quantity(name, WHY, EXACT, scale=1.0))
    return made


@case("patch-2d", "Patch test in the plane", quantities())
def patch_plane(quick: bool) -> Outcome:
    """Two blocks of 1 m × 0.5 m on rollers, St Venant–Kirchhoff (E = 2 MPa, ν = 0.3; and ν = 0 with the lower one ten
    times stiffer), under a uniform dead pressure of 20 kPa: pressure and nominal stress are uniform, whatever the
    meshes. Largest pointwise error, as a share of the pressure, over quadrilaterals and triangles of orders 1 and 2;
    meshes of n : m facets across the interface, either side contactor.
    """
    return series(2, quick)


@case("patch-3d", "Patch test in space", quantities())
def patch_space(quick: bool) -> Outcome:
    """The same with two blocks of 1 m × 1 m × 0.5 m of hexahedra and tetrahedra, equally stiff; order 2 on the
    first mesh only."""
    return series(3, quick)
