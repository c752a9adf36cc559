"""A spinning disc bounces off a rigid plane (section 4.4 and figure 4).

It illustrates a body in motion, a rigid obstacle, the energy ledger, and monitors that stop a run. A disc of radius R = 0.1 m
flies at 45° onto the line y = 0, with μ = 0.3 and a spin of ω = 0 or ±200 rev/min. A step reads

    ∫ ρ (v_{n+1} − v_n)/Δt · w dΩ + ∫ P(u_n, u_{n+1}) : ∇w dΩ − ∫ t·w dS₀ = 0,     u_{n+1} = u_n + Δt (v_n + v_{n+1})/2,

where P does exactly the work of the change of strain energy: lost is what friction dissipates and what the impact of nodes
takes, which goes to zero with the step. With ω > 0 (slice) friction dissipates most and reverses the spin.

As printed (St Venant–Kirchhoff, E = 1.333 MPa, V = 200 km/h) there is no solution: V is two to three times the wave speed. In
compression this law's acoustic tensor A(N) = (N·SN) I + (Λ + G) FN⊗FN + G FFᵀ, |N| = 1, stops being positive: in uniaxial
strain at a stretch of 0.738 for oblique N, and of 1/√3 for N along it. With --case printed three meshes show that it comes to
that a fraction of h/V_n after touch, h being the mesh size. --case stiff: E = 1.333 GPa; --case soft: neo-Hookean, 20 km/h.

    ./run python3 demos/spinning_disc.py --animate
"""

import argparse
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from demos.demo_options import add_options
from dolfinx_mortar_al import Contact, ContactProblem, Surface, dynamics, materials, monitors, obstacles, output
from dolfinx_mortar_al.command_line import parse
from meshes.disc import RIM, Disc

RADIUS, THICKNESS, DENSITY, MU, NU = 0.1, 0.02, 6000.0, 0.3, 0.333
SPINS = {"none": 0.0, "top": -200 * np.pi / 30, "slice": 200 * np.pi / 30}  # rad/s
# law, E (Pa), speed (m/s), Δt (s), time until the disc has left (s)
CASES = {
    "printed": (materials.saint_venant_kirchhoff, 1.333e6, 200 / 3.6, 1e-3, 0.01),
    "stiff": (materials.saint_venant_kirchhoff, 1.333e9, 200 / 3.6, 2e-5, 2e-3),
    "soft": (materials.neo_hookean, 1.333e6, 20 / 3.6, 1e-3, 0.045),
}
ENERGIES = ["kinetic", "strain", "friction_dissipation", "impact_loss"]
BOOKS = ["contact", "energy_defect"]
COLUMNS = ["time", "centre_x", "centre_y", "velocity_x", "velocity_y", "momentum_x", "momentum_y", "angular_momentum"]
COLUMNS += ["spin", *ENERGIES, *BOOKS, "penetration", "contact_force_x", "contact_force_y", "min_det_F"]
COLUMNS += ["newton_iterations", "wall_time"]


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--case", default="soft", choices=CASES, help="(%(default)s)")
    add("--spin", nargs="+", default=list(SPINS), choices=SPINS, help="one or several (all)")
    add("--size", type=float, help="of the elements in m (R/10; with --case printed R/5, R/10 and R/20)")
    add("--order", type=int, default=2, choices=(1, 2), help="of displacement and geometry (%(default)s)")
    add("--step", type=float, help="Δt in s (1e-3, with --case stiff 2e-5)")
    add("--time", type=float, help="final time in s (until the disc has left)")
    add("--gap", type=float, default=0.0, help="between disc and plane at the start in m (%(default)s)")
    add_options(parser, "spinning_disc", figure=4)
    add("--animate", action="store_true", help="write spinning_disc.gif")
    return parse(parser)


def simulate(args: argparse.Namespace, spin: str, directory: Path) -> tuple:
    """One flight: (history, deformed cells at each time on rank 0 if --animate, else None)."""
    make, E, speed, Δt, _ = CASES[args.case]
    height, V, ω, law = RADIUS + args.gap, speed / np.sqrt(2), SPINS[spin], make(E, NU)
    mesh, _, tags = Disc(radius=RADIUS, height=height, size=args.size, order=args.order).create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", args.order, (2,))))
    motion = dynamics.Motion(u, law, density=DENSITY, step=args.step or Δt, thickness=THICKNESS)
    motion.velocity.interpolate(lambda X: np.stack([V - ω * (X[1] - height), -V + ω * X[0]]))
    rim, plane = Surface(mesh, tags, RIM), obstacles.RigidPlane([0, 0], [0, 1])
    contact = Contact(rim, plane, friction=MU, multiplier_order=args.order)  # the paper's orders
    watch = [monitors.inversion(u), *([monitors.ellipticity(law, u)] if args.case == "printed" else [])]
    problem = ContactProblem(motion, contacts=[contact], monitors=watch)
    ρ, x = DENSITY * THICKNESS, ufl.SpatialCoordinate(mesh) + motion.old
    m, moments = motion.integral(fem.form(ρ * motion.dx)), [fem.form(ρ * x[i] * motion.dx) for i in range(2)]
    said = vars(args) | {"spin": spin}
    run = output.Run(problem, directory, COLUMNS, said, args.paraview, checkpoint=args.checkpoint)
    start, ledger, until = run.start, run.ledger, args.time or CASES[args.case][4]
    frames, time = [], start
    try:
        for step in dynamics.march(problem, to=until, start=start, ledger=ledger):
            time, ledger, (fx, fy) = step.time, step.ledger, step.forces[0]
            (px, py), (cx, cy) = ledger.momentum, (motion.integral(moment) / m for moment in moments)
            run.record(
                step, time, time=time, centre_x=cx, centre_y=cy, velocity_x=px / m, velocity_y=py / m,
                spin=(ledger.angular_momentum[0] - cx * py + cy * px) / (m * RADIUS**2 / 2),
                **{name: getattr(ledger, name) for name in [*ENERGIES, *BOOKS]}, momentum_x=px, momentum_y=py,
                angular_momentum=ledger.angular_momentum[0], penetration=step.penetration, contact_force_x=fx,
                contact_force_y=fy, min_det_F=watch[0].range()[0],
            )  # fmt: skip
            frames += [output.deformed_cells(u)] if args.animate and step.nominal else []
    except dynamics.StepFailure as failure:
        end = f"{failure}, {(time * V - args.gap) / args.size:.2g} h/V_n from touch"
    else:
        losses = np.array([getattr(ledger, name) for name in ENERGIES[2:]]) / sum(getattr(ledger, e) for e in ENERGIES)
        end = "lost {:.1%} by friction and {:.1%} by impact of nodes; ".format(*losses)
        end += f"spin {ω:.2f} → {run.history.column('spin')[-1]:.2f} rad/s"
    run.finish(end=end)
    if MPI.COMM_WORLD.rank == 0:
        print(f"{args.case}, {spin}, h = {args.size:g} m: {end}")
    return run.history, frames if args.animate and MPI.COMM_WORLD.rank == 0 else None


def draw(results: dict[str, tuple], directory: Path) -> None:
    """Figure 4: energies against time for each spin, and the way of the centre."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(results) + 1, figsize=(4.2 * (len(results) + 1), 4), layout="constrained")
    for axis, letter, (spin, (history, _)) in zip(axes, "abc", results.items(), strict=False):
        energies = np.array([history.column(name) for name in ENERGIES])
        axis.stackplot(1e3 * history.column("time"), energies, labels=ENERGIES, alpha=0.7)
        title = f"({letter}) ω = {SPINS[spin]:.3g} rad/s: {energies[2:, -1].sum() / energies[:, -1].sum():.1%} lost"
        axis.set(title=title, xlabel="time (ms)", ylabel="energy (J)")
        axes[-1].plot(history.column("centre_x"), history.column("centre_y"), ".-", label=spin)
        axis.legend(loc="lower right")
    axes[-1].legend()
    axes[-1].set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=f"({'abcd'[len(results)]}) centre of the disc")
    figure.savefig(directory / "figure4.png", dpi=150)


def animate(results: dict[str, tuple], directory: Path) -> None:
    """spinning_disc.gif: the discs side by side, a half of each in another shade."""
    import matplotlib.pyplot as plt
    from matplotlib.animation import PillowWriter
    from matplotlib.collections import PolyCollection

    figure, axis = plt.subplots(figsize=(3 * len(results), 2.5), layout="constrained")
    moments = list(zip(*(frames for _, frames in results.values()), strict=False))
    with (writer := PillowWriter(fps=15)).saving(figure, directory / "spinning_disc.gif", dpi=100):
        for moment in moments:
            axis.clear()
            axis.axhline(0, color="k")
            for k, (cells, first) in enumerate(zip(moment, moments[0], strict=True)):
                shades = np.where(first[:, :, 0].mean(axis=1) > first[:, :, 0].mean(), "C0", "0.8")
                axis.add_collection(PolyCollection(cells + np.array([0.35 * k, 0]), facecolor=shades))
            axis.set(aspect="equal", xlim=(-0.12, 0.35 * len(results)), ylim=(-0.02, 0.26), title=", ".join(results))
            writer.grab_frame()


if __name__ == "__main__":
    args = options()
    for size in [args.size] if args.size else [RADIUS / n for n in ((5, 10, 20) if args.case == "printed" else (10,))]:
        args.size = size
        results = {spin: simulate(args, spin, args.output / f"{spin}_{size:g}") for spin in args.spin}
    if MPI.COMM_WORLD.rank == 0 and args.case != "printed":
        for picture in [draw] * (not args.no_figure) + [animate] * args.animate:
            picture(results, args.output)
