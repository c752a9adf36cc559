"""A ring hits another off-centre, with friction: energies and angular momenta of both.

It illustrates the impact of two deformable bodies. With the density ρ, the displacement u and the velocity v a step reads

    ∫ ρ (v* − v_n)/Δt · w dΩ + ∫ P(u_n, u_{n+1}) : ∇w dΩ = ∫ (F·w(x) − F·w(y) − (A^α)ᵀF·w,α) dS₀,
    u_{n+1} = u_n + Δt (v_n + v*)/2,

where P does exactly the work of the change of strain energy. A traction F acts on a point x of the contactor, −F on the
point y of the target, with a couple (A^α)ᵀF on the contactor's tangents a_α: together they are conjugate to

    w_rel = Δr − A^α Δa_α,   r = x − y,

which is zero for every rigid motion of the pair. So no contact force changes the sum of the momenta ∫ ρ v dΩ or that of
the angular momenta ∫ (X + u) × ρ v dΩ, though x and y never coincide. Pressure obeys Signorini's law with the gap at
the end of the step, friction Coulomb's with w_rel; at last v_{n+1} is the velocity closest to v*, in the norm of the mass,
with which no closed point flies on into the target. Lost is what friction and the impact of nodes take.

    ./run python3 demos/two_rings.py --animate
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
from meshes.round_bodies import Round, RoundBodies

RADIUS, BORE, DENSITY, E, NU = 0.1, 0.07, 1000.0, 1e6, 0.3
SPEED, OFFSET, GAP = 6.0, 0.1, 0.005  # of the first ring (m/s); of the centres across the flight, between the rims (m)
ENERGIES = ["kinetic_1", "kinetic_2", "strain_1", "strain_2", "friction_dissipation", "impact_loss"]
COLUMNS = ["time", *ENERGIES, "contact", "energy_defect", "momentum_x", "momentum_y", "spin_1", "spin_2"]
COLUMNS += ["angular_momentum", "force_x", "force_y", "penetration", "newton_iterations", "wall_time"]


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--friction", type=float, default=0.4, help="coefficient μ (%(default)s)")
    add("--size", type=float, default=0.01, help="of elements in m; in the second ring 1.3 times it (%(default)s)")
    add("--order", type=int, default=2, choices=(1, 2), help="of displacement and geometry (%(default)s)")
    add("--step", type=float, default=5e-4, help="Δt in s (%(default)s)")
    add("--time", type=float, default=0.08, help="final time in s (%(default)s)")
    add_options(parser, "two_rings", figure=5)
    add("--animate", action="store_true", help="write two_rings.gif")
    return parse(parser)


def simulate(args: argparse.Namespace, directory: Path) -> tuple:
    """The collision: (history, deformed cells at each time on rank 0 if --animate, else None)."""
    reach = 2 * RADIUS + GAP
    first = Round((-np.sqrt(reach**2 - OFFSET**2), OFFSET), RADIUS, BORE, args.size)
    rings = RoundBodies((first, Round((0.0, 0.0), RADIUS, BORE, 1.3 * args.size)), order=args.order)
    mesh, bodies, facets = rings.create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", args.order, (2,))))
    motion = dynamics.Motion(u, materials.neo_hookean(E, NU), density=DENSITY, step=args.step)
    motion.velocity.interpolate(lambda X: np.outer([SPEED, 0], np.ones(X.shape[1])), cells0=bodies.find(rings.cells(0)))
    motion.velocity.x.scatter_forward()
    contact = Contact(Surface(mesh, facets, rings.rim(0)), Surface(mesh, facets, rings.rim(1)), friction=args.friction)
    problem = ContactProblem(motion, contacts=[contact])

    x, p = ufl.SpatialCoordinate(mesh) + motion.old, DENSITY * motion.velocity
    forms = []  # of each ring: kinetic and strain energy, angular momentum about the origin
    for k in range(2):
        dx = materials.cell_measure(u, ufl.Measure("dx", mesh, subdomain_data=bodies)(rings.cells(k)))
        forms += [*motion.energy_forms(dx), fem.form((x[0] * p[1] - x[1] * p[0]) * dx)]
    run = output.Run(problem, directory, COLUMNS, vars(args), args.paraview, checkpoint=args.checkpoint)
    rest = {"to": args.time, "start": run.start, "ledger": run.ledger}
    frames = []
    for step in dynamics.march(problem, **rest) if run.start < args.time * (1 - 1e-9) else ():
        kinetic_1, strain_1, spin_1, kinetic_2, strain_2, spin_2 = (motion.integral(form) for form in forms)
        ledger, (fx, fy) = step.ledger, step.forces[0]
        run.record(
            step, step.time, time=step.time, kinetic_1=kinetic_1, kinetic_2=kinetic_2, strain_1=strain_1, strain_2=strain_2,
            friction_dissipation=ledger.friction_dissipation, impact_loss=ledger.impact_loss, contact=ledger.contact,
            energy_defect=ledger.energy_defect, momentum_x=ledger.momentum[0], momentum_y=ledger.momentum[1],
            spin_1=spin_1, spin_2=spin_2, angular_momentum=ledger.angular_momentum[0], force_x=fx, force_y=fy,
            penetration=step.penetration,
        )  # fmt: skip
        frames += [output.deformed_cells(u)] if args.animate and step.nominal else []
    history = run.history
    total = sum(history.column(name)[-1] for name in [*ENERGIES, "contact"])
    lost = [history.column(name)[-1] / total for name in ENERGIES[-2:]]
    drift = np.ptp(history.column("angular_momentum")) / abs(history.column("angular_momentum")[0])
    end = f"lost {lost[0]:.2%} by friction and {lost[1]:.2%} by impact of nodes; angular momentum drifts by {drift:.0e}"
    run.finish(end=end)
    if MPI.COMM_WORLD.rank == 0:
        print(end)
    return history, frames if args.animate and MPI.COMM_WORLD.rank == 0 else None


def draw(history: output.History, directory: Path) -> None:
    """Energies, angular momenta and the contact force against time."""
    import matplotlib.pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4), layout="constrained")
    t = 1e3 * history.column("time")
    left.stackplot(t, [history.column(name) for name in ENERGIES], labels=ENERGIES, alpha=0.7)
    left.set(title="(a) energies", xlabel="time (ms)", ylabel="energy (J)")
    left.legend(loc="lower left")
    for name, style in (("spin_1", "-"), ("spin_2", "-"), ("angular_momentum", "k--")):
        middle.plot(
            t, history.column(name), style, label={"spin_1": "first ring", "spin_2": "second"}.get(name, "both")
        )
    middle.set(title="(b) angular momenta about the second's first centre", xlabel="time (ms)", ylabel="N m s")
    middle.legend()
    for name in ("force_x", "force_y"):
        right.plot(t, 1e-3 * history.column(name), label=name)
    right.set(title="(c) force on the first ring", xlabel="time (ms)", ylabel="kN")
    right.legend()
    figure.savefig(directory / "figure5.png", dpi=150)


def animate(frames: list, directory: Path) -> None:
    """two_rings.gif."""
    import matplotlib.pyplot as plt
    from matplotlib.animation import PillowWriter
    from matplotlib.collections import PolyCollection

    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    low, high = (
        np.min([f.min(axis=(0, 1)) for f in frames], axis=0),
        np.max([f.max(axis=(0, 1)) for f in frames], axis=0),
    )
    shades = np.where(np.linalg.norm(frames[0].mean(axis=1), axis=1) > RADIUS, "C0", "C1")
    with (writer := PillowWriter(fps=20)).saving(figure, directory / "two_rings.gif", dpi=80):
        for cells in frames[:: max(1, len(frames) // 100)]:
            axis.clear()
            axis.add_collection(PolyCollection(cells, facecolor=shades, edgecolor="w", linewidth=0.2))
            axis.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
            writer.grab_frame()


if __name__ == "__main__":
    args = options()
    history, frames = simulate(args, args.output)
    if MPI.COMM_WORLD.rank == 0:
        if not args.no_figure:
            draw(history, args.output)
        if args.animate:
            animate(frames, args.output)
