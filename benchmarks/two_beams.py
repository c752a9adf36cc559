"""Error against run time on the two beams (section 4.1), beside GetFEM; and a Newton iteration beside its floor.

    ./run python3 benchmarks/two_beams.py --runs 3

Both codes run as whole processes in turn (A B A B …) after a warm-up, so that the ratios hold on a noisy machine. The
floor of an iteration is what any Newton method on this mesh pays: bulk Jacobian, bulk residual and an LU by MUMPS with its
defaults. The error is that of the tip's deflection at 20 N against what the meshes 40×4, 80×8 and 160×16 of the demo go to,
−0.779366, −0.779561 and −0.779616 m, with their order of 1.8.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from petsc4py import PETSc

ROOT = Path(__file__).resolve().parents[1]
from dolfinx_mortar_al import loads, materials
from meshes.two_beams import CLAMP, TIP, TwoBeams

REFERENCE = -0.779637


def timed(command: list[str]) -> tuple[float, str]:
    """Wall time (s) of a whole process and what it printed."""
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    return time.perf_counter() - start, done.stdout


def ours(cells: list[str], friction: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        demo = [sys.executable, "demos/two_beams.py", "--no-figure", "--output", folder, "--friction", friction]
        seconds, _ = timed([*demo, "--cells", *cells])
        said = json.loads((Path(folder) / "summary.json").read_text())
    tip, iterations = said["last"]["tip_uy"], said["newton_iterations"]
    parts = {k: 1e3 * v / iterations for k, v in said["wall_time"].items() if k not in ("forms", "contact set-up")}
    return {"seconds": seconds, "iterations": iterations, "tip": tip, "parts": parts}


def getfem(cells: list[str], friction: str, multiplier: str) -> dict[str, Any]:
    script = [sys.executable, "benchmarks/getfem_two_beams.py", "--cells", *cells, "--friction", friction]
    seconds, printed = timed([*script, "--multiplier", multiplier])
    said = json.loads(printed.strip().splitlines()[-1])
    return {"seconds": seconds, "iterations": said["newton_iterations"], "tip": said["tip_uy_20N"]}


def floor(nx: int, ny: int, repeats: int = 20) -> dict[str, float]:
    """Median milliseconds of bulk Jacobian, bulk residual and LU (analysis once, as in a Newton loop)."""
    mesh, _, tags = TwoBeams(along=(nx, nx), across=ny).create()
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    u, P = fem.Function(V), fem.Constant(mesh, 1.0)
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)
    F = materials.saint_venant_kirchhoff(2e6, 0.3).virtual_work(u, thickness=0.1)
    F -= loads.follower_force(u, P / 0.05, ds(TIP))
    residual, jacobian = fem.form(F), fem.form(ufl.derivative(F, u))
    bcs = [fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(CLAMP)), V)]
    A, b = petsc.create_matrix(jacobian), petsc.create_vector(residual)
    x, ksp = b.duplicate(), PETSc.KSP().create(mesh.comm)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    times = []
    for _ in range(repeats):
        t = [time.perf_counter()]
        A.zeroEntries()
        petsc.assemble_matrix(A, jacobian, bcs)
        A.assemble()
        t.append(time.perf_counter())
        with b.localForm() as local:
            local.set(0.0)
        petsc.assemble_vector(b, residual)
        petsc.set_bc(b, bcs)
        t.append(time.perf_counter())
        ksp.setOperators(A)
        ksp.solve(b, x)
        t.append(time.perf_counter())
        times.append(np.diff(t))
    split = 1e3 * np.median(times, axis=0)
    return dict(zip(("jacobian", "residual", "LU"), split.tolist(), strict=True)) | {"all": float(split.sum())}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3, help="counted runs of each code (%(default)s)")
    parser.add_argument("--meshes", nargs="+", default=["40x4", "80x8"])
    parser.add_argument("--friction", nargs="+", default=["0", "0.3"])
    parser.add_argument("--no-getfem", action="store_true")
    args = parser.parse_args()
    print("| mesh | μ | code | Newton iterations | per step | wall s | tip error (m) | ratio of wall time |")
    print("|---|---|---|---|---|---|---|---|")
    splits = []
    for mesh in args.meshes:
        cells = mesh.split("x")
        for friction in args.friction:
            codes: dict[str, Any] = {"dolfinx_mortar_al": lambda c=cells, f=friction: ours(c, f)}
            if not args.no_getfem:
                for order in ("1", "2"):
                    codes[f"GetFEM, multiplier P{order}"] = lambda c=cells, f=friction, o=order: getfem(c, f, o)
            rounds = [{name: code() for name, code in codes.items()} for _ in range(args.runs + 1)][1:]
            first = next(iter(codes))
            for name in codes:
                run = rounds[-1][name]
                wall = statistics.median(r[name]["seconds"] for r in rounds)
                ratio = statistics.median(r[name]["seconds"] / r[first]["seconds"] for r in rounds)
                error = f"{abs(run['tip'] - REFERENCE):.1e}" if friction == "0" else "–"
                per_step = run["iterations"] / 20
                print(f"| {mesh} | {friction} | {name} | {run['iterations']} | {per_step:.1f} ", end="")
                print(f"| {wall:.2f} | {error} | {ratio:.1f} |", flush=True)
            splits.append((mesh, friction, rounds[-1][first]["parts"], floor(*map(int, cells))))
    print("\nMilliseconds per Newton iteration, beside the floor:\n")
    names = list(splits[0][2])
    print("| mesh | μ | " + " | ".join(names) + " | all | floor: J, R, LU | all / floor |")
    print("|" + "---|" * (len(names) + 5))
    for mesh, friction, parts, least in splits:
        total = sum(parts.values())
        numbers = " | ".join(f"{parts[n]:.2f}" for n in names)
        floors = f"{least['jacobian']:.1f} + {least['residual']:.1f} + {least['LU']:.1f} = {least['all']:.1f}"
        print(f"| {mesh} | {friction} | {numbers} | {total:.1f} | {floors} | {total / least['all']:.2f} |")


if __name__ == "__main__":
    main()
