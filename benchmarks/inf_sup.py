"""The inf-sup constant of the multipliers, as a Markdown table.

    ./run python3 benchmarks/inf_sup.py

Two blocks in the plane as in `patch_test.py`, closed all over: the least β for which, with the bulk's stiffness K,

    sup_v ∫ λ (v₁ − v₂)·ν dS / |v|_K ≥ β |λ|_h,     |λ|_h² = ∫ (h/E) λ² dS,

the root of the smallest eigenvalue of B K⁻¹ Bᵀ against the mass matrix of the multipliers times h/E, with h of the
contactor's facets and E of the softer block. It must not fall as both meshes are refined. A last table has the same with what
holds multipliers smooth (`docs/theory.md`): the square of the left side and ∫ κ |∇λ|² dS.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
import ufl
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary
from petsc4py import PETSc

from dolfinx_mortar_al import Contact, ContactProblem, Surface, materials, membrane
from meshes.two_beams import LOWER, LOWER_TOP, UPPER_BOTTOM, TwoBeams
from meshes.two_membranes import EDGE, TwoMembranes
from meshes.two_membranes import LOWER as UNDER
from meshes.two_membranes import UPPER as OVER

YOUNG, HEIGHT = 2e6, 0.5  # Pa of the softer block, m
ELEMENTS = ((1, 1), (2, 1), (2, 2))  # orders of displacement and multiplier
MESHES = ((8, 1), (8, 3), (8, 8), (3, 8), (1, 8))  # cells of contactor and target, times each refinement
FINER = ((8, 1), (8, 3), (8, 6))  # those that are held smooth
REFINEMENTS = (1, 2, 4)
OF_MEMBRANES = ((8, 2), (8, 6), (8, 8), (6, 8), (2, 8))
THICKNESS = 1e-3  # of membranes (m)
RATIOS = (1e-3, 1.0, 1e3)  # of the contactor's Young's modulus to the target's


def csr(matrix: PETSc.Mat) -> scipy.sparse.csr_matrix:
    i, j, values = matrix.getValuesCSR()
    return scipy.sparse.csr_matrix((values, j, i), shape=matrix.getSize())


def inf_sup(
    order: int, multiplier: int, cells: tuple[int, int], ratio: float, integration: str, smooth: bool = False
) -> float:
    """β for numbers of cells (contactor, target) and the ratio of their stiffnesses; the contactor is the upper block."""
    along = cells[::-1]
    mesh, body, tags = TwoBeams(height=HEIGHT, along=along, across=max(1, min(cells) // 2)).create()
    V = fem.functionspace(mesh, ("Lagrange", order, (2,)))
    u = fem.Function(V)
    ends = locate_entities_boundary(mesh, 1, lambda x: np.isclose(np.abs(x[1]), HEIGHT))
    bcs = [fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, ends), V)]
    dx = ufl.Measure("dx", mesh, subdomain_data=body)
    E = {True: YOUNG * max(1.0, 1.0 / ratio), False: YOUNG * max(1.0, ratio)}  # of the lower block, of the upper one
    F = sum(
        materials.saint_venant_kirchhoff(E[tag == LOWER], 0.3).virtual_work(u, dx=dx(tag))
        for tag in np.unique(body.values)
    )
    contact = Contact(
        Surface(mesh, tags, UPPER_BOTTOM),
        Surface(mesh, tags, LOWER_TOP),
        multiplier_order=multiplier,
        integration=integration,
    )
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    return least(problem, 1.0 / cells[0] / YOUNG, smooth)


def membranes(order: int, multiplier: int, cells: tuple[int, int], integration: str) -> float:
    """β of two membranes for numbers of cells (contactor, target)."""
    mesh, tags, ends = TwoMembranes(shift=0.0, height=0.0, cells=cells[::-1]).create()
    V = fem.functionspace(mesh, ("Lagrange", order, (2,)))
    u = fem.Function(V)
    u.interpolate(lambda x: np.stack([0.1 * x[0], 0.0 * x[0]]))
    bcs = [fem.dirichletbc(u, fem.locate_dofs_topological(V, 0, ends.find(EDGE)))]
    F = membrane.neo_hookean_membrane(YOUNG, 0.3, THICKNESS).virtual_work(u)
    contact = Contact(
        Surface(mesh, tags, OVER, side=[0, -1]),
        Surface(mesh, tags, UNDER, side=[0, 1]),
        multiplier_order=multiplier,
        integration=integration,
    )
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    return least(problem, 1.0 / cells[0] ** 2 / (YOUNG * THICKNESS))


def least(problem: ContactProblem, weight: float, smooth: bool = False) -> float:
    """β of a closed pair, |λ|_h² = `weight` ∫ λ² dS; `smooth`: with what holds multipliers smooth."""
    pair = problem.pairs[0]

    def jacobian(closed: bool) -> None:
        pair.active.closed[:] = closed
        pair.evaluate()
        problem.assemble_jacobian()

    jacobian(closed=True)
    B, smoothing = csr(problem.blocks[1][0]), csr(problem.blocks[1][1]).toarray()
    jacobian(closed=False)
    K, mass = csr(problem.blocks[0][0]).tocsc(), csr(problem.blocks[1][1]).toarray()
    # both have the square of the multipliers' unit, and the open points' residual is λ/ε
    mass *= pair.epsilon.normal * weight
    idle = pair.multiplier.idle  # a fixed end has nothing to enforce
    kept = np.setdiff1d(np.arange(len(mass)), idle)
    S = B @ scipy.sparse.linalg.splu(K).solve(B.T.toarray()) + smooth * smoothing
    S, mass = ((A + A.T)[np.ix_(kept, kept)] / 2 for A in (S, mass))
    return float(np.sqrt(max(scipy.linalg.eigvalsh(S, mass)[0], 0.0)))


def main() -> None:
    print("| order, multiplier | cells of contactor, target | E ratio | integration | " + " | ".join(
        f"β, {n}×" for n in REFINEMENTS) + " |")  # fmt: skip
    print("|" + "---|" * (4 + len(REFINEMENTS)))
    for order, multiplier in ELEMENTS:
        for cells in MESHES:
            for ratio in RATIOS:
                for integration in ("gauss", "segments"):
                    found = [
                        inf_sup(order, multiplier, (n * cells[0], n * cells[1]), ratio, integration)
                        for n in REFINEMENTS
                    ]
                    said = " | ".join(f"{β:.1e}" for β in found)
                    print(f"| {order}, {multiplier} | {cells[0]}, {cells[1]} | {ratio:g} | {integration} | {said} |",
                          flush=True)  # fmt: skip
    print("\nMembranes:\n\n| order, multiplier | cells of contactor, target | integration | " + " | ".join(
        f"β, {n}×" for n in REFINEMENTS) + " |")  # fmt: skip
    print("|" + "---|" * (3 + len(REFINEMENTS)))
    for order, multiplier in ELEMENTS:
        for cells in OF_MEMBRANES:
            for integration in ("gauss", "segments"):
                found = [membranes(order, multiplier, (n * cells[0], n * cells[1]), integration) for n in REFINEMENTS]
                said = " | ".join(f"{β:.1e}" for β in found)
                print(f"| {order}, {multiplier} | {cells[0]}, {cells[1]} | {integration} | {said} |", flush=True)
    print("\nHeld smooth, segments:\n\n| order, multiplier | cells of contactor, target | E ratio | " + " | ".join(
        f"β, {n}×" for n in REFINEMENTS) + " |")  # fmt: skip
    print("|" + "---|" * (3 + len(REFINEMENTS)))
    for order, multiplier in ELEMENTS:
        for cells in FINER:
            for ratio in (1.0, 1e3):
                found = [
                    inf_sup(order, multiplier, (n * cells[0], n * cells[1]), ratio, "segments", True)
                    for n in REFINEMENTS
                ]
                said = " | ".join(f"{β:.1e}" for β in found)
                print(f"| {order}, {multiplier} | {cells[0]}, {cells[1]} | {ratio:g} | {said} |", flush=True)


if __name__ == "__main__":
    main()
