"""Nearly incompressible rubber: iterations and rejected trials of a `Body`, and of its residual with its own derivative.

    ./run python3 benchmarks/rubber.py

A block glued at its top and pressed on a rough rigid floor, in the plane and in space,
and a seal of 5 mm between the rigid walls of its groove, crushed by a quarter by a lid and let go (N, mm, MPa).
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem

sys.path.append(str(Path(__file__).resolve().parents[1]))
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, quasistatic
from dolfinx_mortar_al.verify.meshes import build, grid
from meshes.round_bodies import Round, RoundBodies

TOP, BOTTOM = 1, 2

Scene = tuple[ContactProblem, list[quasistatic.Stage]]


def problem_of(bodies: Sequence[Body], contacts: Sequence[Contact], with_bodies: bool) -> ContactProblem:
    """Of bodies, or of their residuals."""
    if with_bodies:
        return ContactProblem(bodies, contacts=contacts)
    bcs = [bc for body in bodies for bc in body.bcs]
    return ContactProblem([body.residual for body in bodies], [body.u for body in bodies], bcs=bcs, contacts=contacts)


def block(n: Sequence[int], low: Sequence[float], high: Sequence[float]) -> tuple[Any, fem.Function]:
    """A block of n cells along each axis: its facets' tags, and a displacement of order 2."""
    axes = [np.linspace(a, b, k + 1) for k, a, b in zip(n, low, high, strict=True)]
    domain, _, tags = build([grid(axes, {(len(n) - 1, -1): TOP, (len(n) - 1, 0): BOTTOM})])
    return tags, fem.Function(fem.functionspace(domain, ("Lagrange", 2, (len(n),))))


def driven(u: fem.Function, tags: Any) -> tuple[fem.Constant, fem.DirichletBC]:
    """The displacement of a top (m)."""
    V, place = u.function_space, fem.Constant(u.function_space.mesh, np.zeros(len(u)))
    return place, fem.dirichletbc(place, fem.locate_dofs_topological(V, len(u) - 1, tags.find(TOP)), V)


def pressed(
    ν: float, with_bodies: bool = True, *, cells: int = 6, way: Sequence[float] = (0.0, -0.3), increments: int = 5
) -> Scene:
    """A unit block, E = 1, whose top is moved by `way` onto a floor, in as many dimensions as that has."""
    d = len(way)
    tags, u = block([cells] * d, [0.0] * d, [1.0] * d)
    place, bc = driven(u, tags)
    floor = obstacles.RigidPlane(np.zeros(d), np.eye(d)[-1])
    contact = Contact(Surface(u.function_space.mesh, tags, BOTTOM), floor, friction=0.3)
    body = Body(u, materials.neo_hookean(1.0, ν), bcs=[bc])
    return problem_of([body], [contact], with_bodies), [quasistatic.Stage(place, way, increments)]


def seal(ν: float, with_bodies: bool = True, *, μ: float = 0.2, increments: int = 10) -> Scene:
    """A ring's section of 5 mm, E = 5 MPa, between a floor, two walls .5 mm away and a steel lid."""
    domain, _, tags = RoundBodies((Round((0.0, 2.5), 2.5, 0.0, 0.5),)).create()
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,))))
    lid_tags, v = block((8, 3), (-2.8, 5.0), (2.8, 7.0))
    place, bc = driven(v, lid_tags)
    rim = Surface(domain, tags, RoundBodies.rim(0))
    walls = {"floor": ((0, 0), (0, 1)), "left": ((-3, 0), (1, 0)), "right": ((3, 0), (-1, 0))}
    contacts = [Contact(rim, obstacles.RigidPlane(*at), friction=μ, name=name) for name, at in walls.items()]
    contacts.append(Contact(rim, Surface(v.function_space.mesh, lid_tags, BOTTOM), friction=μ, name="lid"))
    bodies = [Body(u, materials.neo_hookean(5.0, ν)), Body(v, materials.saint_venant_kirchhoff(70e3, 0.3), bcs=[bc])]
    stages = [quasistatic.Stage(place, (0.0, -1.2), increments), quasistatic.Stage(place, (0.0, 0.2), increments)]
    return problem_of(bodies, contacts, with_bodies), stages


SCENES = {
    "floor, ν = .49": lambda on: pressed(0.49, on),
    "floor, ν = .499": lambda on: pressed(0.499, on),
    "floor, ν = .4999": lambda on: pressed(0.4999, on),
    "space, ν = .49": lambda on: pressed(0.49, on, cells=4, way=(0.05, 0.0, -0.25), increments=4),
    "space, ν = .499": lambda on: pressed(0.499, on, cells=4, way=(0.05, 0.0, -0.25), increments=4),
    "space, ν = .4999": lambda on: pressed(0.4999, on, cells=4, way=(0.05, 0.0, -0.25), increments=4),
    "seal, ν = .49": lambda on: seal(0.49, on),
    "seal, ν = .4999": lambda on: seal(0.4999, on),
    "seal, ν = .4999, μ = 0": lambda on: seal(0.4999, on, μ=0.0),
    "seal, ν = .499, μ = .5": lambda on: seal(0.499, on, μ=0.5),
    "seal, ν = .499, half as many steps": lambda on: seal(0.499, on, increments=5),
    "seal, ν = .49999, μ = .1": lambda on: seal(0.49999, on, μ=0.1),
}


def effort(scene: Scene) -> str:
    """Iterations and rejected trials of a march."""
    problem, stages = scene
    taken = []
    try:
        taken.extend(quasistatic.march(problem, stages))
    except quasistatic.StepFailure:
        return f"failed after {sum(step.iterations for step in taken)} ({sum(step.rejected for step in taken)})"
    return f"{sum(step.iterations for step in taken)} ({sum(step.rejected for step in taken)})"


def main() -> None:
    warnings.simplefilter("ignore")
    print("| | residual's own derivative | Body |\n|---|---|---|")
    for name, make in SCENES.items():
        print(f"| {name} | {effort(make(False))} | {effort(make(True))} |", flush=True)


if __name__ == "__main__":
    main()
