"""Two beams pressed together by a follower force, solved with GetFEM 5.4: a peer to time this package against.

    ./run python3 benchmarks/getfem_two_beams.py --cells 40 4 [--friction 0.3] [--multiplier 1] [--output getfem.json]

Two beams (1 m × 0.05 m × 0.1 m, St Venant–Kirchhoff, plane strain, Q2, 3 × 3 Gauss points) lie one on the other,
clamped at X = 0. A follower force, spread over the end of the upper one, stays perpendicular to the deformed axis.
Contact is GetFEM's large-sliding brick with ray tracing: augmented Lagrangian, integrated over the bottom of the upper
beam, with a continuous vector multiplier of order 2 (or, in fewer iterations, 1). The settings make it converge fast:
- The line search is off ("simplest", told to take any full step). Contact that opens or closes makes the residual grow
  for an iteration or two; the default search then cuts the steps until Newton stalls.
- The augmentation parameter is 0.01 E/h, h the element length: E/h takes more iterations or fails.
- The unit of force is the final load, as GetFEM's residual test is absolute if there are no dead loads. Newton stops at
  a residual of 1e-8 of that load (1-norm) or a relative step of 1e-8.

Standard output gets one line of JSON, standard error one line per load step. Exit status 1: a step did not converge.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import getfem as gf
import numpy as np

LENGTH, HEIGHT, THICKNESS = 1.0, 0.05, 0.1  # m
YOUNG, POISSON = 2e6, 0.3  # Pa, 1
AUGMENTATION = 0.01  # times E/h
RELEASE = 0.8 * HEIGHT  # no contact is looked for farther away; less than the beam's height
SOLVER = ("max_iter", 60, "max_res", 1e-8, "lsolver", "mumps")
NO_LINE_SEARCH = ("lsearch", "simplest", "alpha max ratio", 1e30, "alpha min", 1.0)
CLAMP, TIP, CONTACT = 1, 2, 3  # regions


def beam(y: float, cells: list[int], contact_side: int) -> Any:
    """The mesh of [0, LENGTH] × [y, y + HEIGHT]; its contact region has the outward normal (0, contact_side)."""
    sizes = f"ORG=[0,{y}];SIZES=[{LENGTH},{HEIGHT}];NSUBDIV=[{cells[0]},{cells[1]}]"
    mesh = gf.Mesh("import", "structured", f"GT='GT_QK(2,1)';{sizes}")
    faces = mesh.outer_faces()
    normals = mesh.normal_of_faces(faces)
    for region, normal in ((CLAMP, (-1, 0)), (TIP, (1, 0)), (CONTACT, (0, contact_side))):
        mesh.set_region(region, faces[:, np.array(normal) @ normals > 0.9])
    return mesh


def two_beams(cells: list[int], friction: float, order: int, unit: float) -> tuple[Any, int, tuple[Any, ...]]:
    """The model, loaded by the traction `t`, with all stresses in multiples of `unit`; the index of the tip's u_y; and
    the objects that Python has to keep, as GetFEM frees what Python drops.
    """
    model = gf.Model("real")
    lame, shear = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))
    model.add_initialized_data("material", [lame / unit, shear / unit])
    r = AUGMENTATION * YOUNG / (LENGTH / cells[0]) / unit
    for name, value in {"t": 0.0, "r": r, "f": friction, "alpha": 1.0}.items():
        model.add_initialized_data(name, value)

    meshes = {"upper": beam(0.0, cells, -1), "lower": beam(-HEIGHT, cells, 1)}
    spaces = {name: gf.MeshFem(mesh, 2) for name, mesh in meshes.items()}
    rules = {name: gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(2,5)")) for name, mesh in meshes.items()}
    for name in meshes:
        spaces[name].set_fem(gf.Fem("FEM_QK(2,2)"))
        model.add_fem_variable(f"u_{name}", spaces[name])
        model.add_finite_strain_elasticity_brick(rules[name], "SaintVenant Kirchhoff", f"u_{name}", "material")
        model.add_Dirichlet_condition_with_simplification(f"u_{name}", CLAMP)
        model.add_fem_data(f"old_{name}", spaces[name])  # at the last load step, for friction
    normal = "Normalized([Grad_u_upper(2,1), -1-Grad_u_upper(1,1)])"
    model.add_nonlinear_term(rules["upper"], f"-t*{normal}.Test_u_upper", TIP)

    multiplier = gf.MeshFem(meshes["upper"], 2)
    multiplier.set_fem(gf.Fem(f"FEM_QK(2,{order})"))
    model.add_filtered_fem_variable("multiplier", multiplier, CONTACT)
    brick = model.add_integral_large_sliding_contact_brick_raytracing("r", RELEASE, "f", "alpha")
    upper, lower = ((rules[name], CONTACT, f"u_{name}") for name in meshes)
    old_upper, old_lower = ([f"old_{name}"] if friction else [] for name in meshes)
    model.add_slave_contact_boundary_to_large_sliding_contact_brick(brick, *upper, "multiplier", *old_upper)
    model.add_master_contact_boundary_to_large_sliding_contact_brick(brick, *lower, *old_lower)
    distance = np.abs(spaces["upper"].basic_dof_nodes() - [[LENGTH], [HEIGHT / 2]]).sum(axis=0)
    return model, int(np.argmin(distance)) + 1, (meshes, spaces, rules, multiplier)  # u_x, u_y alternate


def main() -> int:
    """Solve all load steps; the exit status."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--cells", type=int, nargs=2, default=[40, 4], metavar=("NX", "NY"), help="of each beam")
    parser.add_argument("--friction", type=float, default=0.0, help="Coulomb's coefficient")
    parser.add_argument("--multiplier", type=int, choices=(1, 2), default=2, help="order of the contact multiplier")
    parser.add_argument("--steps", type=int, default=20, help="equal load steps")
    parser.add_argument("--load", type=float, default=20.0, help="final force (N)")
    parser.add_argument("--output", type=Path, metavar="FILE.json", help="the line of JSON goes here, too")
    options = parser.parse_args()
    gf.util_trace_level(0)
    gf.util_warning_level(0)

    start = perf_counter()
    unit = options.load / THICKNESS  # N/m, and Pa as the unit of length is 1 m
    model, tip, _keep = two_beams(options.cells, options.friction, options.multiplier, unit)
    total, converged = 0, True
    deflection: dict[float, float | None] = {10.0: None, 20.0: None}
    for step in range(1, options.steps + 1):
        load = options.load * step / options.steps
        for name in ("upper", "lower"):
            model.set_variable(f"old_{name}", model.variable(f"u_{name}"))
        model.set_variable("t", load / (HEIGHT * THICKNESS) / unit)
        iterations, success = model.solve(*SOLVER, *NO_LINE_SEARCH)
        uy = float(model.variable("u_upper")[tip])
        total, converged = total + int(iterations), bool(success)
        state = "" if converged else "NOT CONVERGED, "
        print(f"{load:g} N: {state}{iterations} iterations, u_y = {uy:.6f} m", file=sys.stderr, flush=True)
        if not converged:
            break
        deflection |= {p: uy for p in deflection if math.isclose(p, load)}

    package = ["dpkg-query", "-W", "-f", "${Version}", "python3-getfem"]  # the module does not tell its version
    result = {
        "code": "GetFEM",
        "version": subprocess.run(package, capture_output=True, text=True, check=False).stdout or "unknown",
        "cells": options.cells,
        "friction": options.friction,
        "multiplier_order": options.multiplier,
        "unknowns": int(model.nbdof()),
        "newton_iterations": total,
        "seconds_assembly_and_solve": round(perf_counter() - start, 2),
        "tip_uy_10N": deflection[10.0],
        "tip_uy_20N": deflection[20.0],
        "converged": converged,
    }
    print(json.dumps(result))
    if options.output:
        options.output.write_text(json.dumps(result) + "\n")
    return 0 if converged else 1


if __name__ == "__main__":
    sys.exit(main())
