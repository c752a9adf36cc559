"""Two beams pressed together by a follower force, solved with GetFEM 5.4: a peer to time this package against.

    ./run python3 benchmarks/getfem_two_beams.py --cells 40 4 [--friction 0.3] [--multiplier 1] [--output getfem.json]

Two beams (1 m × 0.05 m × 0.1 m, St Venant–Kirchhoff, plane strain) lie one on the other, clamped at X = 0. A follower
force, spread over the end of the upper one, stays perpendicular to the deformed axis. Displacements are Q2 with 3 × 3
Gauss points. Contact is GetFEM's large-sliding brick with ray tracing: augmented Lagrangian, integrated over the bottom
of the upper beam, whose vector multiplier is continuous and of order 2 (or, faster and less accurate, 1).

The settings are chosen so that GetFEM converges and does so fast:
- The line search is off ("simplest", which takes the full step where any residual will do). Contact that opens or closes
  makes the residual grow for an iteration or two; the default search then cuts the steps until Newton stalls.
- The augmentation parameter is 0.01 E/h, h the element length: E/h takes more iterations or fails.
- The unit of force is the final load, because GetFEM compares a residual with an absolute tolerance if there are no dead
  loads. Newton stops at a residual of 1e-8 of that load (1-norm) or at a relative step of 1e-8.

One line of JSON goes to standard output, one line per load step to standard error. Exit status 1: a step did not
converge (or GetFEM raised an error); its load and the steps before it are in the JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import getfem as gf
import numpy as np

LENGTH, HEIGHT, THICKNESS = 1.0, 0.05, 0.1  # m
YOUNG, POISSON = 2e6, 0.3  # Pa, 1
AUGMENTATION = 0.01  # times E/h
RELEASE = 0.8 * HEIGHT  # no contact is looked for farther away: less than the beam's height
TOLERANCE, MAX_ITERATIONS = 1e-8, 60
NEWTON = ("lsolver", "mumps", "lsearch", "simplest", "alpha max ratio", 1e30, "alpha min", 1.0)
CLAMP, TIP, CONTACT = 1, 2, 3  # regions


@dataclass
class Scene:
    """The GetFEM model, the degree of freedom of the tip's u_y, and all that GetFEM frees when Python drops it."""

    model: Any
    tip: int
    alive: list[Any]


def beam(y: float, cells: list[int], contact_side: int) -> Any:
    """The mesh of [0, LENGTH] × [y, y + HEIGHT]; the contact region has the outward normal (0, contact_side)."""
    sizes = f"ORG=[0,{y}];SIZES=[{LENGTH},{HEIGHT}];NSUBDIV=[{cells[0]},{cells[1]}]"
    mesh = gf.Mesh("import", "structured", f"GT='GT_QK(2,1)';{sizes}")
    faces = mesh.outer_faces()
    normals = mesh.normal_of_faces(faces)
    for region, normal in ((CLAMP, (-1, 0)), (TIP, (1, 0)), (CONTACT, (0, contact_side))):
        mesh.set_region(region, faces[:, np.array(normal) @ normals > 0.9])
    return mesh


def lagrange(mesh: Any, order: int) -> Any:
    """Continuous vector fields of one order in each direction."""
    space = gf.MeshFem(mesh, 2)
    space.set_fem(gf.Fem(f"FEM_QK(2,{order})"))
    return space


def two_beams(cells: list[int], friction: float, multiplier_order: int, unit: float) -> Scene:
    """The scene under the traction `t`, a datum; forces per thickness, stresses and `t` are in multiples of `unit`."""
    lame, shear = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))
    model = gf.Model("real")
    data = {"material": [lame / unit, shear / unit], "t": 0.0, "f": friction, "alpha": 1.0}
    data["r"] = AUGMENTATION * YOUNG / (LENGTH / cells[0]) / unit
    for name, value in data.items():
        model.add_initialized_data(name, value)

    meshes = {"upper": beam(0.0, cells, -1), "lower": beam(-HEIGHT, cells, 1)}
    spaces = {name: lagrange(mesh, 2) for name, mesh in meshes.items()}
    rules = {name: gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(2,5)")) for name, mesh in meshes.items()}
    for name in meshes:
        model.add_fem_variable(f"u_{name}", spaces[name])
        model.add_finite_strain_elasticity_brick(rules[name], "SaintVenant Kirchhoff", f"u_{name}", "material")
        model.add_Dirichlet_condition_with_simplification(f"u_{name}", CLAMP)
        if friction:
            model.add_fem_data(f"old_{name}", spaces[name])  # at the last load step
    normal = "Normalized([Grad_u_upper(2,1), -1-Grad_u_upper(1,1)])"
    model.add_nonlinear_term(rules["upper"], f"-t*{normal}.Test_u_upper", TIP)

    multiplier = lagrange(meshes["upper"], multiplier_order)
    model.add_filtered_fem_variable("multiplier", multiplier, CONTACT)
    old = {name: [f"old_{name}"] if friction else [] for name in meshes}
    brick = model.add_integral_large_sliding_contact_brick_raytracing("r", RELEASE, "f", "alpha")
    model.add_slave_contact_boundary_to_large_sliding_contact_brick(
        brick, rules["upper"], CONTACT, "u_upper", "multiplier", *old["upper"]
    )
    model.add_master_contact_boundary_to_large_sliding_contact_brick(
        brick, rules["lower"], CONTACT, "u_lower", *old["lower"]
    )
    distance = np.abs(spaces["upper"].basic_dof_nodes() - [[LENGTH], [HEIGHT / 2]]).sum(axis=0)
    tip = int(np.argmin(distance)) + 1  # u_x and u_y alternate
    return Scene(model, tip, [meshes, spaces, rules, multiplier])


def main() -> int:
    """Solve all load steps; the exit status."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--cells", type=int, nargs=2, default=[40, 4], metavar=("NX", "NY"), help="of each beam")
    parser.add_argument("--friction", type=float, default=0.0, help="Coulomb's coefficient")
    parser.add_argument("--multiplier", type=int, choices=(1, 2), default=2, help="order of the contact multiplier")
    parser.add_argument("--steps", type=int, default=20, help="equal load steps")
    parser.add_argument("--load", type=float, default=20.0, help="final force (N)")
    parser.add_argument("--output", type=Path, help="a JSON file to write, too")
    arguments = parser.parse_args()
    gf.util_trace_level(0)
    gf.util_warning_level(0)

    start = perf_counter()
    unit = arguments.load / THICKNESS  # N/m
    scene = two_beams(arguments.cells, arguments.friction, arguments.multiplier, unit)
    model, total, converged, failed_at = scene.model, 0, True, None
    deflection: dict[float, float] = {}
    for step in range(1, arguments.steps + 1):
        load = arguments.load * step / arguments.steps
        if arguments.friction:
            for name in ("upper", "lower"):
                model.set_variable(f"old_{name}", model.variable(f"u_{name}"))
        model.set_variable("t", load / (HEIGHT * THICKNESS) / unit)
        try:
            iterations, success = model.solve("max_iter", MAX_ITERATIONS, "max_res", TOLERANCE, *NEWTON)
        except RuntimeError as error:
            print(error, file=sys.stderr)
            iterations, success = 0, 0
        total, converged = total + int(iterations), bool(success)
        if not converged:
            failed_at = load
            print(f"{load:g} N: not converged after {iterations} iterations", file=sys.stderr)
            break
        deflection[load] = float(model.variable("u_upper")[scene.tip])
        print(f"{load:g} N: {iterations} iterations, u_y = {deflection[load]:.6f} m", file=sys.stderr, flush=True)
    seconds = perf_counter() - start

    package = ["dpkg-query", "-W", "-f", "${Version}", "python3-getfem"]  # the module does not tell its version
    at = {p: next((u for load, u in deflection.items() if math.isclose(load, p)), None) for p in (10, 20)}
    result = {
        "code": "GetFEM",
        "version": subprocess.run(package, capture_output=True, text=True, check=False).stdout or "unknown",
        "cells": arguments.cells,
        "friction": arguments.friction,
        "multiplier_order": arguments.multiplier,
        "unknowns": int(model.nbdof()),
        "newton_iterations": total,
        "seconds_assembly_and_solve": round(seconds, 2),
        "tip_uy_10N": at[10],
        "tip_uy_20N": at[20],
        "converged": converged,
        "failed_at_N": failed_at,
    }
    line = json.dumps(result)
    print(line)
    if arguments.output:
        arguments.output.write_text(line + "\n")
    return 0 if converged else 1


if __name__ == "__main__":
    sys.exit(main())
