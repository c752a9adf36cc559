"""Two blocks in a rigid box, pressed by more than their modulus, meshes that do not match: failures, iterations, pressures.

    ./run python3 benchmarks/pressed_blocks.py [--seed N] [--draws M] [--segments] [--space]

Uniaxial strain: the interface stays flat and the pressure uniform. E = 1 Pa, neo-Hookean; drawn are μ, triangles or
quadrilaterals (in space tetrahedra or hexahedra), the numbers of facets, ν, the pressure and the increments.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem

sys.path.append(str(Path(__file__).resolve().parents[1]))
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, loads, materials, quasistatic
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import hold

BOTTOM, TOP, UPPER, LOWER, SIDES = 1, 2, 3, 4, (10, 11)


def pressed_blocks(
    facets: tuple[int, int], *, dim: int = 2, simplices: bool = False, ν: float = 0.45, **options: object
) -> tuple[ContactProblem, fem.Constant]:
    """The problem and the pressure (Pa): a half-height block below, the contactor, and one above, with so many facets in each
    direction; `options` of the contact."""

    def block(n: int, height: float, tags: tuple[int, int]) -> object:
        axes = [*[np.linspace(0.0, 1.0, n + 1)] * (dim - 1), np.linspace(height, height + 0.5, max(n // 2, 1) + 1)]
        faces = {(axis, end): SIDES[axis] for axis in range(dim - 1) for end in (0, -1)}
        return grid(axes, faces | {(dim - 1, 0): tags[0], (dim - 1, -1): tags[1]}, simplices=simplices)

    domain, _, tags = build([block(facets[0], 0.0, (BOTTOM, LOWER)), block(facets[1], 0.5, (UPPER, TOP))])
    V = fem.functionspace(domain, ("Lagrange", 2, (dim,)))
    u, pressure = fem.Function(V), fem.Constant(domain, 0.0)
    body = Body(
        u,
        materials.neo_hookean(1.0, ν),
        # normal to the surface as it is: under a dead load of .8 E and more the free face would ripple
        external=(-pressure * loads.area_normal(u), ufl.Measure("ds", domain, subdomain_data=tags)(TOP)),
        bcs=[hold(V, tags, BOTTOM, dim - 1), *(hold(V, tags, SIDES[axis], axis) for axis in range(dim - 1))],
    )
    sides = Surface(domain, tags, LOWER), Surface(domain, tags, UPPER)
    return ContactProblem(body, contacts=[Contact(*sides, **options)]), pressure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--segments", action="store_true")
    parser.add_argument("--space", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(options.seed)
    integration, dim = "segments" if options.segments else "gauss", 3 if options.space else 2
    failed = iterations = rejected = steps = 0
    print("| facets | cells | μ | ν | p/E | increments | iterations | rejected | p off by, at any point |")
    print("|" + "---|" * 9)
    for _ in range(options.draws):
        facets = tuple(int(n) for n in rng.integers(*((3, 7) if options.space else (8, 51)), 2))
        simplices, μ, ν = bool(rng.integers(2)), float(rng.choice([0.0, 0.1, 0.3, 0.8])), float(rng.uniform(0.1, 0.495))
        p, increments = float(rng.uniform(1.0, 4.0)), int(rng.integers(4, 16))
        problem, load = pressed_blocks(facets, dim=dim, simplices=simplices, ν=ν, friction=μ, integration=integration)
        row = f"| {facets} | {'simplices' if simplices else 'bricks'} | {μ} | {ν:.3f} | {p:.2f} | {increments} |"
        taken, end = [], ""
        try:
            taken.extend(quasistatic.march(problem, load, to=p, increments=increments))
            fields = problem.pairs[0].fields()
            end = f" {abs(fields.pressure / p - 1).max():.1e} |"
        except quasistatic.StepFailure:
            failed, end = failed + 1, " failed |"
        n, r = sum(step.iterations for step in taken), sum(step.rejected for step in taken)
        iterations, rejected, steps = iterations + n, rejected + r, steps + len(taken)
        print(f"{row} {n} | {r} |{end}", flush=True)
    print(f"\n{failed} failed, {iterations} iterations in {steps} steps, {rejected} rejected")


if __name__ == "__main__":
    main()
