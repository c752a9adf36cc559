"""A ring is pressed flat between two rigid plates until its bore closes on itself.

It illustrates a surface in contact with itself, rigid obstacles that move, and a body that contact alone holds. The plates
come together by 2d; the ring's rim is the contactor of a pair with each. The bore is both sides of a pair,

    Contact(bore, friction=μ),

so that of each two parts of it that meet one is chosen as contactor; the same equality as for two bodies then holds there,

    ∫ P(u) : ∇v dΩ − Σ ∫ t·(v − v∘η) dS₀ = 0,

with v∘η at the place that the point faces, on the same surface or, for the plates, zero. At first the ring bends and rolls on
the plates; a slender one would dent inwards. Once the bore has closed, it is a double beam, and the force climbs.

    ./run python3 demos/flattened_ring.py --friction 0.2
    ./run mpirun -n 2 python3 demos/flattened_ring.py --bore 0.09 --paraview
"""

import argparse
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from demos.demo_options import add_options
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, output, quasistatic
from dolfinx_mortar_al.command_line import parse
from meshes.round_bodies import Round, RoundBodies

RADIUS, E, NU = 0.1, 1e6, 0.3  # m, Pa
COLUMNS = ["closing", "force", "bore_area", "bore_pressure", "rim_stick", "newton_iterations", "wall_time"]


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--friction", type=float, default=0.2, help="Coulomb's μ, at the plates and in the bore (%(default)s)")
    add("--bore", type=float, default=0.085, help="inner radius in m; the outer is 0.1 (%(default)s)")
    add("--closing", type=float, help="way d of each plate in m (until 2 %% of the radius after the bore has closed)")
    add("--increments", type=int, default=20, help="steps of the plates (%(default)s)")
    add("--size", type=float, default=0.0075, help="of the elements in m (%(default)s)")
    add("--order", type=int, default=2, choices=(1, 2), help="of displacement and geometry (%(default)s)")
    add_options(parser, "flattened_ring", figure=6)
    args = parse(parser)
    args.closing = args.bore + 0.02 * RADIUS if args.closing is None else args.closing
    return args


def simulate(args: argparse.Namespace, directory: Path) -> tuple:
    """The plates come together: (history, deformed cells at four of the steps on rank 0)."""
    ring = RoundBodies((Round((0.0, 0.0), RADIUS, args.bore, args.size),), order=args.order)
    mesh, _, facets = ring.create()
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", args.order, (2,))))
    rim, bore = Surface(mesh, facets, ring.rim(0)), Surface(mesh, facets, ring.bore(0))

    up = np.array([0.0, 1.0])
    plates = [obstacles.RigidPlane(point=side * RADIUS * up, normal=-side * up) for side in (1, -1)]
    contacts = [Contact(rim, plate, friction=args.friction) for plate in plates]
    contacts.append(Contact(bore, friction=args.friction))  # no target: the surface itself
    problem = ContactProblem(Body(u, materials.neo_hookean(E, NU)), contacts=contacts)
    top, _, itself = problem.pairs

    def close(d: float) -> None:
        for plate, side in zip(plates, (1, -1), strict=True):
            plate.pose = obstacles.Pose(-side * d * up, np.eye(2))

    run = output.Run(problem, directory, COLUMNS, vars(args), args.paraview, checkpoint=args.checkpoint)
    left = round(args.increments * (1 - run.start / args.closing))
    close(run.start)
    shown = {round(args.increments * share) for share in (0.25, 0.5, 0.75, 1.0)}
    march = quasistatic.march(problem, close, to=args.closing, increments=left, start=run.start, progress=True)
    states = []
    for step in march if left else ():
        run.record(
            step, step.load, closing=step.load, force=abs(top.force()[1]), bore_area=itself.contact_area(),
            bore_pressure=itself.largest_pressure(), rim_stick=top.stick_fraction(),
        )  # fmt: skip
        if step.nominal and round(args.increments * step.load / args.closing) in shown:
            states.append((step.load, output.deformed_cells(u)))
    run.finish()
    return run.history, states


def draw(history: output.History, states: list, directory: Path) -> None:
    """Figure 6: the ring at four steps, and the plates' force."""
    import matplotlib.pyplot as plt
    from matplotlib.collections import PolyCollection

    figure, axes = plt.subplots(1, len(states) + 1, figsize=(3.4 * (len(states) + 1), 3.6), layout="constrained")
    for axis, (d, cells), letter in zip(axes, states, "abcd", strict=False):
        axis.add_collection(PolyCollection(cells, facecolor="0.85", edgecolor="0.4", linewidth=0.3))
        for side in (1, -1):
            axis.axhline(side * (RADIUS - d), color="tab:red")
        axis.set(aspect="equal", xlim=(-0.16, 0.16), ylim=(-0.11, 0.11), title=f"({letter}) d = {100 * d:.1f} cm")
    axes[-1].plot(100 * history.column("closing"), history.column("force"), ".-")
    closed = history.column("bore_area") > 0
    if closed.any():
        axes[-1].axvline(
            100 * history.column("closing")[closed][0], color="0.7", linestyle="--", label="the bore touches"
        )
        axes[-1].legend()
    axes[-1].set(xlabel="d (cm)", ylabel="force of a plate (N per m)", yscale="log", title="force")
    figure.savefig(directory / "figure6.png", dpi=150)


if __name__ == "__main__":
    args = options()
    history, states = simulate(args, args.output)
    if MPI.COMM_WORLD.rank == 0:
        last = history.rows[-1]
        print(f"d = {last['closing']:.4g} m: {last['force']:.5g} N per m, bore closed over {last['bore_area']:.4g} m")
        if not args.no_figure and states:
            draw(history, states, args.output)
