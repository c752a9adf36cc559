"""Why two membranes converge with order 2 where their elements are of order 2, and why tractions ripple, as Markdown tables.

    ./run python3 benchmarks/membrane_edge.py --cells 40 80 160

The scene is section 4.2 at 4023 Pa, μ = 0, P2. The exact pressure jumps at the edge of contact, and the curvature with it.
What could cost the order is changed one by one:

- the integral across the edge: 12 pieces of each facet with 3 points each, which know the edge to a fiftieth of a facet;
- the augmentation, which smears the edge: ε a hundred times smaller or larger;
- the elements: nodes are moved to where the exact edges are, so that neither jump lies inside an element;
- the multiplier, which is continuous: elements of order 1 that are not.

The second table has the largest deviation of the traction at a point from the exact one, 6 and 10 facets inside the zone.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import ufl
from dolfinx import fem

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))
from dolfinx_mortar_al import (
    Contact,
    ContactProblem,
    Surface,
    augmentation,
    loads,
    membrane,
    multiplier,
    output,
    quasistatic,
)
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.surface import GatheredFacets
from dolfinx_mortar_al.versions import geometry_nodes
from exact.two_membranes import MembraneState
from exact.two_membranes import TwoMembranes as Exact
from meshes.two_membranes import EDGE, LOWER, UPPER, TwoMembranes

PRESSURE, STEPS, SHIFT = 4023.0, 20, 1.0
PIECES, DEGREE = 12, 5  # of each facet, and on each


def pieces(pair: ContactPair, contactor: GatheredFacets) -> IntegrationPoints:
    """Points that know the edge of contact to a fiftieth of a facet."""
    ξ, weight = pair.facets.shape.quadrature(DEGREE)
    η = np.concatenate([(k + ξ) / PIECES for k in range(PIECES)])
    weight, n = np.tile(weight / PIECES, PIECES), pair.facets.size
    facet = np.repeat(np.arange(n), len(weight))
    return IntegrationPoints(pair.facets, facet, np.tile(η, (n, 1)), np.tile(weight, n), pair.contact.thickness)


def move_nodes(mesh: Any, tags: Any, edges: tuple[float, float]) -> None:
    """Vertices to the edges of contact of both membranes, all others in proportion; the midpoint stays one."""
    for tag, corner, sign in ((LOWER, 0.0, 1.0), (UPPER, SHIFT + 1.0, -1.0)):  # the upper one mirrors the lower one
        vertices = np.unique(geometry_nodes(mesh)[tags.find(tag)])
        X, n = sign * (mesh.geometry.x[vertices, 0] - corner), len(vertices) - 1
        knots = dict(sorted({0: 0.0, n // 2: 0.5, n: 1.0, **{round(x * n): x for x in edges}}.items()))
        moved = np.interp(X, np.array(list(knots)) / n, list(knots.values()))
        mesh.geometry.x[vertices, 0] = corner + sign * moved


class Broken:
    """What `multiplier` takes of dolfinx.fem, for discontinuous elements."""

    Function = fem.Function

    @staticmethod
    def functionspace(mesh: Any, element: Any) -> fem.FunctionSpace:
        return fem.functionspace(mesh, ("DG", *element[1:]))


def solve(
    cells: tuple[int, int],
    *,
    order: int = 2,
    integration: str = "gauss",
    fine: bool = False,
    share: float = 1.0,
    at_nodes: bool = False,
    discontinuous: bool = False,
) -> tuple[float, list[float]]:
    """With multipliers of some `order`: relative error of the lower midpoint's displacement, and the traction's largest
    deviation 6 and 10 facets inside."""
    exact: MembraneState = Exact(shift=SHIFT).state(PRESSURE)
    mesh, tags, ends = TwoMembranes(shift=SHIFT, cells=cells).create()
    if at_nodes:
        move_nodes(mesh, tags, exact.contact_material)
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u, p = fem.Function(V), fem.Constant(mesh, 0.0)
    dx = ufl.Measure("dx", mesh, subdomain_data=tags)
    F = membrane.neo_hookean_membrane(E=2e6, nu=0.3, thickness=1e-3).virtual_work(u, dx=dx)
    F -= loads.membrane_pressure(u, p, [0, 1], dx(LOWER)) + loads.membrane_pressure(u, p, [0, -1], dx(UPPER))
    bcs = [fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 0, ends.find(EDGE)), V)]
    sides = Surface(mesh, tags, UPPER, side=[0, -1]), Surface(mesh, tags, LOWER, side=[0, 1])
    contact = Contact(*sides, multiplier_order=order, integration=integration)
    with ExitStack() as changes:
        if fine:
            changes.enter_context(patch.object(ContactPair, "_points", pieces))
        if discontinuous:
            changes.enter_context(patch.object(multiplier, "fem", Broken))
        changes.enter_context(patch.object(augmentation, "SOFTER", share * augmentation.SOFTER))
        problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])
    pair = problem.pairs[0]
    for _ in quasistatic.march(problem, p, to=PRESSURE, increments=STEPS):
        pass
    right = exact.midpoint_displacement
    error = np.linalg.norm(output.Probe(u, [0.5, 0.0], tags.find(LOWER))() - right) / np.linalg.norm(right)
    return float(error), ripple(pair, exact)


def ripple(pair: ContactPair, exact: MembraneState) -> list[float]:
    """The traction's largest relative deviation 6 and 10 facets inside the zone."""
    off = np.abs(pair.state.p / exact.multiplier[0] - 1)
    facets = np.unique(pair.integration.facet[pair.state.p > 0])
    inside = facets[np.argsort(pair.facets.X[facets, :, 0].mean(axis=1))]
    return [float(off[np.isin(pair.integration.facet, inside[k:-k])].max(initial=0.0)) for k in (6, 10)]


VARIANTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "12 pieces of each facet": {"fine": True},
    "ε × 0.01": {"share": 0.01},
    "ε × 100": {"share": 100.0},
    "segments": {"integration": "segments"},
    "multiplier of order 1": {"order": 1},
    "discontinuous multiplier of order 1": {"order": 1, "discontinuous": True},
    "edges at nodes": {"at_nodes": True},
    "edges at nodes, discontinuous multiplier": {"at_nodes": True, "order": 1, "discontinuous": True},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=(40, 80, 160), help="per membrane (%(default)s)")
    cells = parser.parse_args().cells
    print("| | " + " | ".join(f"{n} cells" for n in cells) + " | order |")
    print("|" + "---|" * (len(cells) + 2))
    for name, options in VARIANTS.items():
        errors = [solve((n, n), **options)[0] for n in cells]
        order = -np.polyfit(np.log(cells), np.log(errors), 1)[0]
        print(f"| {name} | " + " | ".join(f"{e:.1e}" for e in errors) + f" | {order:.1f} |", flush=True)
    print("\n| cells: target, contactor | Gauss, 6 facets inside | 10 | segments, 6 | 10 |")
    print("|" + "---|" * 5)
    finest = max(cells)
    for n in (finest, finest * 3 // 2, finest * 2):
        for other in (n, n * 3 // 4):
            found = [solve((other, n), integration=kind)[1] for kind in ("gauss", "segments")]
            print(f"| {other}, {n} | " + " | ".join(f"{x:.1e}" for two in found for x in two) + " |", flush=True)


if __name__ == "__main__":
    main()
