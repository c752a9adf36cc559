"""Impact of two bars (section 4.3) against the exact solution: error against elements, energy, variants, run time.

    ./run python3 benchmarks/two_bars.py --tables 1 2 3

Runs are those of demos/two_bars.py, in this process after a warm-up that compiles the forms: seconds are of set-up, time
steps and history.csv. The error is that of the displacement of bar 1's contact face, in L2 over time and relative to the
exact one. A wave crosses a cell in one step (Δt = 0.1 s / cells) unless said otherwise. The third table has plain Newmark
(β = 1/4, γ = 1/2) with contact between positions besides, written below with the package's statics.
"""

import argparse
import contextlib
import io
import json
import math
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from demos.two_bars import RHO, SPEED, E, plateau_force, release_time, simulate
from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, materials, output
from exact.two_bars import TwoBars as Exact
from meshes.two_bars import BAR1, FACE1, FACE2, TwoBars

EXACT = Exact()
PEERS = [  # energy after impact at 20 elements per bar, measured by the project on the same scene
    ("Newmark, GetFEM", "+213 %"),
    ("Newmark, Kratos", "+213 %"),
    ("Bossak", "−3.4 %"),
]


def tip_error(t: NDArray[np.float64], u: NDArray[np.float64]) -> float:
    """Relative L2 error in time of bar 1's contact face; steps of one length."""
    exact = EXACT.tip_displacements(t)[0]
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))


def run(cells: int, step: float | None = None, **more: Any) -> dict[str, Any]:
    """What the tables show of one run of the demo; energies as shares of E₀."""
    chosen = {"theta": 0.5, "force": "consistent", "checkpoint": False} | more
    args = argparse.Namespace(cells=cells, step=step, time=0.5, dim=2, order=1, gap=0.0, paraview=False, **chosen)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        history = simulate(args, Path(folder))
        seconds = time.perf_counter() - start
        velocities = json.loads((Path(folder) / "summary.json").read_text())["parameters"]["mean_velocities"]
    t, Δt = history.column("time"), step or 0.1 / cells
    loss, defect = (history.column(name) / EXACT.energy for name in ("impact_loss", "energy_defect"))
    return {
        "step": Δt, "force": plateau_force(history, EXACT) / EXACT.contact_force - 1, "velocities": velocities,
        "release": (release_time(history, EXACT) - EXACT.contact_end) / Δt, "loss": float(loss[-1]),
        "defect": float(np.abs(np.diff(defect, prepend=0.0)).max()), "energy": float(defect[-1] - loss[-1]),
        "momentum": float(np.abs(history.column("momentum") / EXACT.momentum - 1).max()),
        "error": tip_error(t, history.column("tip1_u")), "seconds": seconds,
        "iterations": history.column("newton_iterations").sum() / len(t),
    }  # fmt: skip


def newmark(cells: int) -> dict[str, Any]:
    """Newmark's scheme, contact between positions at the end of each step: nothing conserves energy here.

    a_{n+1} = 4/Δt² (u_{n+1} − u_n − Δt v_n) − a_n,     v_{n+1} = v_n + Δt (a_n + a_{n+1})/2.
    """
    start, Δt = time.perf_counter(), 0.1 / cells
    bars = TwoBars(along=cells)
    mesh, cell_tags, facet_tags = bars.create()
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u, u0, v0, a0 = (fem.Function(V) for _ in range(4))
    v0.interpolate(lambda x: np.array([[SPEED], [0.0]]) + 0 * x[:2], cells0=cell_tags.find(BAR1))
    v0.x.scatter_forward()
    material, w, dx = materials.saint_venant_kirchhoff(E, nu=0.0), ufl.TestFunction(V), materials.cell_measure(u)
    h = fem.Constant(mesh, Δt)
    a = 4 / h**2 * (u - u0 - h * v0) - a0
    F = RHO * ufl.inner(a, w) * dx + material.virtual_work(u, w)
    contact = Contact(Surface(mesh, facet_tags, FACE1), Surface(mesh, facet_tags, FACE2))
    problem = ContactProblem(F, u, contacts=[contact])
    solver, pair = NewtonSolver(problem), problem.pairs[0]
    strain = material.energy(materials.deformation_gradient(u))
    energy = fem.form(RHO / 2 * ufl.inner(v0, v0) * dx + strain * dx)
    momentum = fem.form(RHO * v0[0] * dx)

    face = output.Probe(u, [bars.length, bars.height / 2], cell_tags.find(BAR1))

    rows, iterations = [], 0
    for n in range(1, round(0.5 / Δt) + 1):
        u.x.array[:] = u0.x.array + Δt * v0.x.array
        result = solver.solve()
        if not result.converged:
            raise RuntimeError(f"Newmark, {cells} cells, step {n}: {result.message}")
        iterations += result.iterations
        new = 4 / Δt**2 * (u.x.array - u0.x.array - Δt * v0.x.array) - a0.x.array
        v0.x.array[:] += Δt / 2 * (a0.x.array + new)
        u0.x.array[:], a0.x.array[:] = u.x.array, new
        problem.commit()
        total = [mesh.comm.allreduce(fem.assemble_scalar(form)) for form in (energy, momentum)]
        rows.append((n * Δt, face()[0], -pair.force()[0], *total))
    t, tip, force, total, p = np.array(rows).T
    during, touching = (t > 0.02) & (t < 0.18), force > 1e-6 * EXACT.contact_force
    return {
        "step": Δt, "force": force[during].mean() / EXACT.contact_force - 1, "loss": math.nan, "defect": math.nan,
        "release": (t[touching].max() - EXACT.contact_end) / Δt, "energy": total[-1] / EXACT.energy - 1,
        "momentum": np.abs(p / EXACT.momentum - 1).max(), "error": tip_error(t, tip), "iterations": iterations / len(t),
        "seconds": time.perf_counter() - start,
    }  # fmt: skip


def shown(x: float, form: str) -> str:
    """x as `form` says (percent with a space), "–" where there is none."""
    return "–" if math.isnan(x) else f"{x:{form}}".replace("-", "−").replace("%", " %")


def row(*columns: object) -> None:
    print("| " + " | ".join(map(str, columns)) + " |", flush=True)


def head(*columns: str) -> None:
    row(*columns)
    print("|" + "---|" * len(columns))


def orders(errors: Sequence[float], sizes: Sequence[float]) -> list[float]:
    """Orders from each size to the next, nan first."""
    return [math.nan, *(np.diff(np.log(errors)) / np.diff(np.log(sizes))).tolist()]


def refinement(cells: Sequence[int]) -> None:
    print("Refinement in space and time, energy-consistent force, θ = 1/2, shares of E₀ = 5e-4 J:\n")
    head(
        "cells per bar", "Δt (s)", "plateau force: error", "release − 0.2 s (steps)", "v₁ (m/s)", "v₂ (m/s)", "impact loss",
        "order", "largest defect per step", "momentum: error", "tip error", "order", "Newton iterations per step", "wall s",
    )  # fmt: skip
    found = [run(n) for n in cells]
    loss, error = (orders([one[name] for one in found], 1 / np.array(cells)) for name in ("loss", "error"))
    for n, one, a, b in zip(cells, found, loss, error, strict=True):
        row(
            n, f"{one['step']:g}", shown(one["force"], "+.1e"), shown(one["release"], "+.0f"),
            *(shown(v, ".5f") for v in one["velocities"]), shown(one["loss"], "z.2%"), shown(a, ".2f"),
            shown(one["defect"], ".0e"), shown(one["momentum"], ".0e"), shown(one["error"], ".2%"), shown(b, ".2f"),
            f"{one['iterations']:.1f}", f"{one['seconds']:.1f}",
        )  # fmt: skip


def shorter_steps(cells: int) -> None:
    steps = [0.005 / 2**k for k in range(4)]
    print(f"\nShorter steps on one mesh, {cells} cells per bar, shares of E₀:\n")
    head("Δt (s)", "impact loss", "order", "largest defect per step", "plateau force: error", "release − 0.2 s (s)")
    found = [run(cells, step) for step in steps]
    for one, order in zip(found, orders([one["loss"] for one in found], steps), strict=True):
        row(
            f"{one['step']:g}", shown(one["loss"], ".3%"), shown(order, ".2f"), shown(one["defect"], ".0e"),
            shown(one["force"], "+.1e"), shown(one["release"] * one["step"], "+.5f"),
        )  # fmt: skip


def variants(cells: Sequence[int]) -> None:
    print("\nVariants; energy after impact relative to E₀; the peers' was measured by the project on the same scene:\n")
    columns = ["plateau force: error", "release − 0.2 s (steps)", "momentum: error", "tip error", "wall s"]
    head("cells per bar", "scheme", "energy after − before", "impact loss", "largest defect per step", *columns)
    choices: list[tuple[str, dict[str, Any]]] = [
        ("θ = 0.5, energy-consistent force", {}),
        ("θ = 0.5, trapezoidal force", {"force": "trapezoidal"}),
        ("θ = 0.6", {"theta": 0.6}),
        ("θ = 1", {"theta": 1.0}),
    ]
    for n in cells:
        found = [(name, run(n, **more)) for name, more in choices] + [("Newmark, this package's statics", newmark(n))]
        for name, one in found:
            row(
                n, name, shown(one["energy"], "+.2%"), shown(one["loss"], "z.2%"),
                shown(one["defect"], ".0e"), shown(one["force"], "+.1e"), shown(one["release"], "+.0f"),
                shown(one["momentum"], ".0e"), shown(one["error"], ".2%"), f"{one['seconds']:.1f}",
            )  # fmt: skip
        for name, energy in PEERS if n == 20 else []:
            row(n, f"{name} (peer)", energy, *"–––––––")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", type=int, nargs="+", default=(1, 2, 3), choices=(1, 2, 3), help="which (all)")
    parser.add_argument("--cells", type=int, nargs="+", default=(20, 40, 80), help="per bar (%(default)s)")
    args = parser.parse_args()
    for force in ("consistent", "trapezoidal"):
        run(4, force=force)
    newmark(4)
    if 1 in args.tables:
        refinement(args.cells)
    if 2 in args.tables:
        shorter_steps(min(args.cells))
    if 3 in args.tables:
        variants((min(args.cells), max(args.cells)))


if __name__ == "__main__":
    main()
