"""The inf-sup constant of the multipliers, as a Markdown table.

    ./run python3 benchmarks/inf_sup.py

Two blocks in the plane as in `patch_test.py`, closed all over: the least β for which, with the bulk's stiffness K,

    sup_v ∫ λ (v₁ − v₂)·ν dS / |v|_K ≥ β |λ|_h,     |λ|_h² = ∫ (h/E) λ² dS,

the root of the smallest eigenvalue of B K⁻¹ Bᵀ against the mass matrix of the multipliers times h/E, with h of the
contactor's facets and E of the softer block. It must not fall as both meshes are refined.
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

from dolfinx_mortar_al import Contact, ContactProblem, Surface, materials
from meshes.two_beams import LOWER, LOWER_TOP, UPPER_BOTTOM, TwoBeams

YOUNG, HEIGHT = 2e6, 0.5  # Pa of the softer block, m
ELEMENTS = ((1, 1), (2, 1), (2, 2))  # orders of displacement and multiplier
MESHES = ((8, 1), (8, 3), (8, 8), (3, 8), (1, 8))  # cells of contactor and target, times each refinement
REFINEMENTS = (1, 2, 4)
RATIOS = (1e-3, 1.0, 1e3)  # of the contactor's Young's modulus to the target's


def csr(matrix: PETSc.Mat) -> scipy.sparse.csr_matrix:
    i, j, values = matrix.getValuesCSR()
    return scipy.sparse.csr_matrix((values, j, i), shape=matrix.getSize())


def inf_sup(order: int, multiplier: int, cells: tuple[int, int], ratio: float, integration: str) -> float:
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
    pair = problem.pairs[0]

    def jacobian(closed: bool) -> None:
        pair.active.closed[:] = closed
        pair.evaluate()
        problem.assemble_jacobian()

    jacobian(closed=True)
    B = csr(problem.blocks[1][0])
    jacobian(closed=False)
    K, mass = csr(problem.blocks[0][0]).tocsc(), csr(problem.blocks[1][1]).toarray()
    # both have the square of the multipliers' unit, and the open points' residual is λ/ε
    mass *= pair.ε.normal * (1.0 / cells[0]) / YOUNG
    S = B @ scipy.sparse.linalg.splu(K).solve(B.T.toarray())
    return float(np.sqrt(max(scipy.linalg.eigvalsh((S + S.T) / 2, mass)[0], 0.0)))


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


if __name__ == "__main__":
    main()
