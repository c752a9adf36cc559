"""Convergence of the spinning disc (section 4.4) in mesh size and time step, beside the rigid disc.

    ./run python3 benchmarks/spinning_disc.py --case soft stiff
    ./run python3 benchmarks/spinning_disc.py --case soft --refine space --divide 5 10 20 40 --spin slice

A state is that of the end, when the disc has long left the plane. Losses are shares of the initial energy. The rigid disc
has the restitution e = −V_y'/V_y that was measured.
"""

import argparse
import contextlib
import io
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "demos")]  # before this folder, which has a file of the same name
from spinning_disc import CASES, ENERGIES, RADIUS, SPINS, simulate
from spinning_disc import options as demo_options

from exact.rigid_disc import RigidDisc


def measure(case: str, spin: str, divide: int, step: float) -> dict[str, Any]:
    """One flight on elements of size R / divide."""
    sys.argv = [sys.argv[0], "--case", case, "--size", str(RADIUS / divide), "--step", str(step)]
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        history, _ = simulate(demo_options(), spin, Path(folder))
    last = history.rows[-1]
    start = sum(last[name] for name in ENERGIES) - last["energy_defect"]
    friction, impact = (100 * last[name] / start for name in ENERGIES[2:])
    pushed = np.flatnonzero(history.column("contact_force_y") > 0)
    return {
        "loss": friction + impact,
        "friction": friction,
        "impact": impact,
        "spin": last["spin"],
        "vx": last["velocity_x"],
        "vy": last["velocity_y"],
        "left": 1e3 * history.column("time")[pushed[-1]],
        "det": history.column("min_det_F").min(),
        "iterations": int(history.column("newton_iterations").sum()),
        "seconds": history.column("wall_time").sum(),
    }


def rigid(case: str, spin: str, restitution: float) -> dict[str, float]:
    """The same of a rigid disc."""
    disc, V = RigidDisc(), CASES[case][2] / np.sqrt(2)
    after = disc.rebound(V, V, SPINS[spin], restitution)
    start = disc.kinetic_energy(V, V, SPINS[spin]) / 100
    return {
        "loss": after.energy_loss / start,
        "friction": after.friction_loss / start,
        "spin": after.spin,
        "vx": after.velocity_x,
        "vy": after.velocity_n,
    }


def study(case: str, spins: list[str], meshes: list[tuple[int, float]]) -> None:
    """Markdown table over the (R/h, Δt), and what it shows."""
    print(
        f"\n| {case}: spin | R/h | Δt (s) | lost % | friction % | impact % | spin (rad/s) | V_x' | V_y' (m/s) "
        "| left at ms | least det F | iterations | s |"
    )
    print("|" + "---|" * 13)
    loss = {}
    notes = []
    for spin in spins:
        runs = []
        for divide, step in meshes:
            r = measure(case, spin, divide, step)
            runs.append(r)
            print(
                f"| {spin} | {divide} | {step:g} | {r['loss']:.2f} | {r['friction']:.2f} | {r['impact']:.2f} "
                f"| {r['spin']:.3f} | {r['vx']:.4g} | {r['vy']:.4g} | {r['left']:.4g} | {r['det']:.3f} "
                f"| {r['iterations']} | {r['seconds']:.1f} |",
                flush=True,
            )
        loss[spin] = runs[-1]["loss"]
        e = runs[-1]["vy"] / (CASES[case][2] / np.sqrt(2))
        r = rigid(case, spin, e)
        print(
            f"| {spin} | rigid, e = {e:.3f} | | {r['loss']:.2f} | {r['friction']:.2f} | | {r['spin']:.3f} "
            f"| {r['vx']:.4g} | {r['vy']:.4g} | | | | |",
            flush=True,
        )
        if len(runs) > 1:
            a, b = runs[-2:]
            share = 100 * abs(b["spin"] / a["spin"] - 1)
            notes.append(
                f"- {case}, {spin}: the two finest differ by {abs(b['loss'] - a['loss']):.2f} percentage points of loss "
                f"(target 0.5) and {share:.2f} % of spin (target 3); spin {SPINS[spin]:.2f} → {b['spin']:.2f} rad/s"
            )
    print("\n" + "\n".join(notes))
    order = " > ".join(f"{name} {value:.2f} %" for name, value in sorted(loss.items(), key=lambda item: -item[1]))
    print(f"- {case}: energy lost on the finest: {order}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--case", nargs="+", default=["soft", "stiff"], choices=("soft", "stiff"))
    add("--spin", nargs="+", default=list(SPINS), choices=SPINS)
    add("--refine", nargs="+", default=["space", "both"], choices=("space", "time", "both"), help="(%(default)s)")
    add("--divide", type=int, nargs="+", default=[5, 10, 20], help="R/h of the meshes (%(default)s)")
    add("--step", type=float, help="the longest Δt in s (that of the demo)")
    args = parser.parse_args()
    for case in args.case:
        longest = args.step or CASES[case][3]
        halved = [longest / 2**k for k in range(len(args.divide))]
        for refine in args.refine:
            divide = [args.divide[-1]] * len(halved) if refine == "time" else args.divide
            steps = [longest] * len(divide) if refine == "space" else halved
            study(case, args.spin, list(zip(divide, steps, strict=True)))


if __name__ == "__main__":
    main()
