"""Impact of two elastic bars (section 4.3 and figure 3), beside the exact solution.

It illustrates bodies in motion and the energy ledger of each step. Bar 1, at V = 0.1 m/s, hits bar 2, at rest, end to end.
Both are 10 m long, without friction or loads, and linear but for 4e-4:

    ∫ ρ (v_{n+1} − v_n)/Δt · w dΩ + ∫ P̄ : ∇w dΩ − ∫ t·(w₁ − w₂∘η) dS₀ = 0,     u_{n+1} = u_n + Δt (v_n + v_{n+1})/2.

Compression runs through both bars at c = 100 m/s and comes back as tension: after 2L/c = 0.2 s with a force of 0.05 N the
bars part, and have changed roles. The scheme conserves momentum; its energy is lost only where the mass at the faces stops,
of order h.

    ./run python3 demos/two_bars.py
    ./run mpirun -n 2 python3 demos/two_bars.py --cells 80 --paraview
"""

import argparse
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from demos.demo_options import add_options
from dolfinx_mortar_al import Contact, ContactProblem, Surface, dynamics, materials, output
from dolfinx_mortar_al.command_line import parse
from exact.two_bars import TwoBars as Exact
from meshes.two_bars import BAR1, BAR2, FACE1, FACE2, TwoBars

COLUMNS = [
    "time", "tip1_u", "tip2_u", "tip1_v", "tip2_v", "contact_force", "kinetic_1", "kinetic_2", "strain_1", "strain_2",
    "contact", "external_work", "friction_dissipation", "impact_loss", "energy_defect", "momentum", "penetration",
    "newton_iterations", "wall_time",
]  # fmt: skip
E, RHO, SPEED = 100.0, 0.01, 0.1  # Pa, kg/m³, m/s


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--cells", type=int, default=20, help="along each bar (%(default)s)")
    add("--step", type=float, help="Δt in s, default 0.1 / cells: a wave crosses a cell in one step")
    add("--time", type=float, default=0.5, help="end of the run in s (%(default)s)")
    add("--dim", type=int, default=2, choices=(2, 3), help="plane strain or three-dimensional (%(default)s)")
    add("--order", type=int, default=1, choices=(1, 2), help="of the displacement (%(default)s)")
    add("--theta", type=float, default=0.5, help="of the scheme, 1/2 … 1 (%(default)s)")
    add("--force", default="consistent", choices=("consistent", "trapezoidal"), help="internal force (%(default)s)")
    add("--gap", type=float, default=0.0, help="between the bars at first, in m (%(default)s)")
    add_options(parser, "two_bars", figure=3)
    return parse(parser)


def simulate(args: argparse.Namespace, directory: Path) -> output.History:
    """The impact as its history: energies in J, momentum along the bars in N s."""
    bars = TwoBars(along=args.cells, dim=args.dim, gap=args.gap)
    mesh, cell_tags, facet_tags = bars.create()
    V = fem.functionspace(mesh, ("Lagrange", args.order, (args.dim,)))
    u = fem.Function(V)

    material, Δt = materials.saint_venant_kirchhoff(E, nu=0.0), args.step or 0.1 / args.cells
    motion = dynamics.Motion(u, material, density=RHO, step=Δt, theta=args.theta, force=args.force)
    start = np.eye(args.dim)[:, :1] * SPEED
    motion.velocity.interpolate(lambda x: start + 0 * x[: args.dim], cells0=cell_tags.find(BAR1))
    motion.velocity.x.scatter_forward()
    contact = Contact(Surface(mesh, facet_tags, FACE1), Surface(mesh, facet_tags, FACE2), multiplier_order=args.order)
    problem = ContactProblem(motion, contacts=[contact])

    # The faces coincide when they touch: each is asked for on its own bar.
    middle = [bars.height / 2] + [bars.width / 2] * (args.dim - 2)
    faces = [([x, *middle], cell_tags.find(b)) for x, b in [(bars.length, BAR1), (bars.length + bars.gap, BAR2)]]
    v = motion.velocity
    probes = [output.Probe(f, X, cells) for f in (u, v) for X, cells in faces]
    dx = [ufl.Measure("dx", mesh, subdomain_data=cell_tags)(bar) for bar in (BAR1, BAR2)]
    kinetic = [fem.form(RHO / 2 * ufl.inner(v, v) * dx_k) for dx_k in dx]
    strain = [motion.energy_forms(dx_k)[1] for dx_k in dx]
    mean_velocity = [fem.form(v[0] / (bars.length * bars.height * bars.width) * dx_k) for dx_k in dx]

    said = vars(args) | {"step": Δt}
    run = output.Run(problem, directory, COLUMNS, said, args.paraview, checkpoint=args.checkpoint)
    rest = {"to": args.time, "start": run.start, "ledger": run.ledger}
    for step in dynamics.march(problem, **rest) if run.start < args.time * (1 - 1e-9) else ():
        u1, u2, v1, v2 = (value()[0] for value in probes)
        (k1, k2), (w1, w2) = ([motion.integral(form) for form in forms] for forms in (kinetic, strain))
        ledger = step.ledger
        run.record(
            step, step.time, time=step.time, tip1_u=u1, tip2_u=u2, tip1_v=v1, tip2_v=v2,
            contact_force=-step.forces[0][0], kinetic_1=k1, kinetic_2=k2, strain_1=w1, strain_2=w2,
            contact=ledger.contact, external_work=ledger.external_work, friction_dissipation=ledger.friction_dissipation,
            impact_loss=ledger.impact_loss, energy_defect=ledger.energy_defect, momentum=ledger.momentum[0],
            penetration=step.penetration,
        )  # fmt: skip
    v1, v2 = (motion.integral(form) for form in mean_velocity)
    run.finish(mean_velocities=[v1, v2])
    if mesh.comm.rank == 0:
        exact, last = Exact(E=E, rho=RHO, speed=SPEED, gap=args.gap), run.history.rows[-1]
        print(f"mean contact force {plateau_force(run.history, exact):.6f} N (exact {exact.contact_force:g})")
        print(f"the bars part at {release_time(run.history, exact):.4f} s (exact {exact.contact_end:g})")
        print(f"mean velocities at the end {v1:.5f}, {v2:.5f} m/s (exact {exact.momenta(args.time) / exact.mass})")
        print(f"impact loss {last['impact_loss'] / exact.energy:.3%} of {exact.energy:g} J, ", end="")
        print(f"defect of the energy balance {last['energy_defect'] / exact.energy:.1e}")
    return run.history


def plateau_force(history: output.History, exact: Exact) -> float:
    """Mean contact force (N) while the exact force is far from its jumps, 0.02 … 0.18 s after touch."""
    since_touch = history.column("time") - exact.contact_start
    force = history.column("contact_force")[(since_touch > 0.02) & (since_touch < 0.18)]
    return float(force.mean()) if len(force) else 0.0


def release_time(history: output.History, exact: Exact) -> float:
    """End (s) of the last step with contact, 0 without any."""
    touching = history.column("contact_force") > 1e-6 * exact.contact_force
    return float(history.column("time")[touching].max(initial=0.0))


def draw(history: output.History, exact: Exact, directory: Path) -> None:
    """Figure 3: displacements and velocities of the contact faces, and energies, against time."""
    import matplotlib.pyplot as plt

    t, fine = history.column("time"), np.linspace(0.0, history.column("time")[-1], 2001)
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.2), layout="constrained")
    for axis, name, solution in zip(axes, "uv", (exact.tip_displacements, exact.tip_velocities), strict=False):
        for k, shown in enumerate(("-", "--")):
            axis.plot(t, history.column(f"tip{k + 1}_{name}"), color=f"C{k}", label=f"bar {k + 1}")
            axis.plot(fine, solution(fine)[k], shown, color="k", linewidth=0.7, label="exact" if k == 0 else None)
    lost = history.column("friction_dissipation") + history.column("impact_loss") - history.column("energy_defect")
    axes[2].plot(t, exact.energy + history.column("external_work") - lost, color="C2", label="total")
    axes[2].axhline(exact.energy, color="k", linewidth=0.7, label="exact")
    for k, name in enumerate(("kinetic_1", "kinetic_2", "strain_1", "strain_2")):
        style = {"color": f"C{k % 2}", "linestyle": "-" if k < 2 else ":"}
        axes[2].plot(t, history.column(name), label=name.replace("_", ", bar "), **style)
        axes[2].plot(fine, exact.energies(fine)[k], "--", color="k", linewidth=0.7)
    for axis, letter, what in zip(axes, "abc", ("displacement (m)", "velocity (m/s)", "energy (J)"), strict=True):
        axis.set(xlabel="t (s)", ylabel=what)
        axis.set_title(f"({letter}) " + ("contact faces" if letter < "c" else "both bars"), fontsize=10)
        axis.legend(fontsize=8)
    figure.savefig(directory / "figure3.png", dpi=150)


if __name__ == "__main__":
    args = options()
    history = simulate(args, args.output)
    if MPI.COMM_WORLD.rank == 0 and not args.no_figure:
        draw(history, Exact(E=E, rho=RHO, speed=SPEED, gap=args.gap), args.output)
