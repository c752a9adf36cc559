"""Two beams pressed together by a follower force, solved with GetFEM 5.4: the peer that our own code is timed against.

    ./run python3 benchmarks/getfem_two_beams.py --cells 40 4 [--friction 0.3] [--output getfem.json]

Two beams (1 m × 0.05 m × 0.1 m, St Venant–Kirchhoff, plane strain) lie one on the other, clamped at X = 0. A follower
force of --load newtons is spread over the end of the upper one and stays perpendicular to its deformed axis. Contact is
GetFEM's large-sliding brick with ray tracing: augmented Lagrangian, integrated over the bottom of the upper beam.
Displacements are Q2, the (vector) multiplier is continuous of order 2, the Gauss rule has degree 5.

GetFEM's line search is switched off ("simplest" with any residual accepted): contact changes make the residual grow for
a step or two, and the default search then cuts the steps until Newton stalls. Newton stops on GetFEM's own test: the
residual or the step, relative to the load or the state, is below --tolerance.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import getfem as gf
import numpy as np

LENGTH, HEIGHT, THICKNESS = 1.0, 0.05, 0.1  # m
YOUNG, POISSON = 2e6, 0.3  # Pa, 1
import os
UNIT = float(os.environ.get("UNIT", "200"))
CLAMP, TIP, CONTACT = 1, 2, 3  # regions


def beam(y: float, cells: tuple[int, int], contact_normal: float) -> Any:
    """A rectangle from (0, y) of quadrilaterals; the contact region has the outward normal (0, contact_normal)."""
    size = f"ORG=[0,{y}];SIZES=[{LENGTH},{HEIGHT}];NSUBDIV=[{cells[0]},{cells[1]}]"
    mesh = gf.Mesh("import", "structured", "GT='GT_QK(2,1)';" + size)
    faces = mesh.outer_faces()
    normals = mesh.normal_of_faces(faces)
    for region, normal in ((CLAMP, (-1, 0)), (TIP, (1, 0)), (CONTACT, (0, contact_normal))):
        mesh.set_region(region, faces[:, np.asarray(normal) @ normals > 0.9])
    return mesh


def two_beams(cells: tuple[int, int], friction: float, augmentation: float, release: float) -> tuple[Any, Any]:
    """The GetFEM model, with the load as datum `t` (Pa), and the displacement space of the upper beam."""
    mu = YOUNG / (2 * (1 + POISSON))
    lame = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    model = gf.Model("real")
    model.add_initialized_data("material", [lame / UNIT, mu / UNIT])
    model.add_initialized_data("t", 0.0)
    bodies = {"lower": beam(-HEIGHT, cells, 1), "upper": beam(0, cells, -1)}
    spaces, rules = {}, {}
    for name, mesh in bodies.items():
        spaces[name] = gf.MeshFem(mesh, 2)
        spaces[name].set_fem(gf.Fem("FEM_QK(2,2)"))
        rules[name] = gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(2,5)"))  # 3 × 3 points
        model.add_fem_variable(f"u_{name}", spaces[name])
        model.add_finite_strain_elasticity_brick(rules[name], "SaintVenant Kirchhoff", f"u_{name}", "material")
        model.add_Dirichlet_condition_with_simplification(f"u_{name}", CLAMP)
        if friction:
            model.add_fem_data(f"old_{name}", spaces[name])
    axis = "[Grad_u_upper(2,1), -1-Grad_u_upper(1,1)]"
    model.add_nonlinear_term(rules["upper"], f"-t*Normalized({axis}).Test_u_upper", TIP)

    multiplier = gf.MeshFem(bodies["upper"], 2)
    multiplier.set_fem(gf.Fem("FEM_QK(2,%s)" % __import__("os").environ.get("MO","2")))
    import os
    if os.environ.get("DROP"):
        d = multiplier.basic_dof_on_region(CONTACT)
        nn = multiplier.basic_dof_nodes()
        d = d[nn[0, d] > 1e-9]
        multiplier = (gf.MeshFem("partial", multiplier, d), multiplier)
        model.add_fem_variable("pressure", multiplier[0])
    else:
        model.add_filtered_fem_variable("pressure", multiplier, CONTACT)
    model.add_initialized_data("r", augmentation)
    model.add_initialized_data("f", friction)
    model.add_initialized_data("alpha", 1.0)
    brick = model.add_integral_large_sliding_contact_brick_raytracing("r", release, "f", "alpha", int(__import__("os").environ.get("VER","0")))
    old = ("old_upper", "old_lower") if friction else ("", "")
    model.add_slave_contact_boundary_to_large_sliding_contact_brick(
        brick, rules["upper"], CONTACT, "u_upper", "pressure", old[0]
    )
    model.add_master_contact_boundary_to_large_sliding_contact_brick(brick, rules["lower"], CONTACT, "u_lower", old[1])
    global KEEP
    KEEP = (bodies, spaces, rules, multiplier)
    return model, spaces["upper"]


def getfem_version() -> str:
    """Of the Python package, or of Debian's."""
    import subprocess

    return subprocess.run(["dpkg-query", "-W", "-f", "${Version}", "python3-getfem"], capture_output=True, text=True).stdout


def main() -> int:
    import os
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs=2, default=(40, 4), metavar=("NX", "NY"), help="of each beam")
    parser.add_argument("--friction", type=float, default=0.0, help="Coulomb's coefficient")
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--load", type=float, default=20.0, help="total follower force (N)")
    parser.add_argument("--output", type=Path)
    a = parser.parse_args()
    gf.util_trace_level(0); gf.util_warning_level(int(os.environ.get("WL","0")))
    nx, ny = a.cells
    h = LENGTH / nx
    t0 = time.perf_counter()
    model, V = two_beams((nx, ny), a.friction, float(os.environ.get("RF","1")) * YOUNG / h / UNIT, float(os.environ.get("REL","0.04")))
    nodes = V.basic_dof_nodes(); tipdof = np.nonzero((abs(nodes[0]-1)<1e-9)&(abs(nodes[1]-.025)<1e-9))[0]
    tips = {}; total = 0; ok = True
    opts = json.loads(os.environ.get("OPTS", '["lsearch","simplest","alpha max ratio",1e30,"alpha min",1]'))
    for k in range(1, a.steps + 1):
        p = a.load * k / a.steps
        if a.friction:
            for b in ("upper", "lower"):
                model.set_variable(f"old_{b}", model.variable(f"u_{b}"))
        model.set_variable("t", p / (HEIGHT * THICKNESS) / UNIT)
        nit, conv = model.solve(*(["noisy"] if os.environ.get("NOISY") else []), "max_iter", 60, "max_res", float(os.environ.get("TOL","1e-8")), "lsolver", os.environ.get("LS","mumps"), *opts)
        total += nit
        tip = model.variable("u_upper")[tipdof]
        tips[p] = tip
        print(k, p, nit, conv, np.ravel(tip), round(time.perf_counter()-t0,2), file=sys.stderr, flush=True)
        if not conv:
            ok = False
            break
    print(model.nbdof(), total, ok, time.perf_counter()-t0, opts)
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
