"""Two beams in contact, one bent by a follower force (section 4.1 and figure 1).

It illustrates how to put a hyperelastic material, a follower load and a contact pair together, march through the load, and
write the results. Two beams of length L = 1 m and height 0.05 m lie on each other and are clamped at X = 0. A force P on the
end of the upper one stays normal to its deformed axis and presses it on the lower one:

    ∫ P(u) : ∇v dΩ − ∫ (P/A) n(u)·v dS₀ − ∫ t·(v₁ − v₂∘η) dS₀ = 0,     n(u) ⟂ F e_X,

with the contact traction t of eq. (1). Without friction the well-bent beams lose contact over most of their length.

    ./run python3 demos/two_beams.py --friction 0.3
    ./run mpirun -n 2 python3 demos/two_beams.py --load 40 --paraview
"""

import argparse
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from demos.demo_options import add_options
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, loads, materials, output, quasistatic
from dolfinx_mortar_al.command_line import parse
from meshes.two_beams import CLAMP, LOWER_TOP, TIP, UPPER, UPPER_BOTTOM, TwoBeams

COLUMNS = [
    "load",
    "tip_ux",
    "tip_uy",
    "contact_force_x",
    "contact_force_y",
    "active_fraction",
    "stick_fraction",
    "newton_iterations",
    "wall_time",
]


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--friction", type=float, nargs="+", default=[0.0, 0.3], help="Coulomb's μ; both cases of figure 1 by default")
    add("--load", type=float, default=20.0, help="final force P in N (%(default)s)")
    add("--increments", type=int, default=20, help="load steps (%(default)s)")
    add("--cells", type=int, nargs=2, default=(40, 4), help="along and across each beam (%(default)s)")
    add("--cells-lower", type=int, help="cells along the lower beam, default those of the upper")
    add("--order", type=int, default=2, choices=(1, 2), help="of the displacement (%(default)s)")
    add("--dim", type=int, default=2, choices=(2, 3), help="plane strain or three-dimensional (%(default)s)")
    add("--triangles", action="store_true", help="simplices instead of quadrilaterals or hexahedra")
    add("--swap", action="store_true", help="make the lower beam the contactor")
    add_options(parser, "two_beams", figure=1)
    return parse(parser)


def simulate(args: argparse.Namespace, friction: float, directory: Path) -> tuple:
    """One load history: (history, deformed cells and contact profile on rank 0)."""
    beams = TwoBeams(
        along=(args.cells_lower or args.cells[0], args.cells[0]),
        across=args.cells[1],
        dim=args.dim,
        triangles=args.triangles,
    )
    mesh, cell_tags, facet_tags = beams.create()
    V = fem.functionspace(mesh, ("Lagrange", args.order, (args.dim,)))
    u = fem.Function(V)

    # In two dimensions the thickness is a factor on every integral, those of contact, too.
    P = fem.Constant(mesh, 0.0)
    ds = ufl.Measure("ds", mesh, subdomain_data=facet_tags)
    traction = P / (beams.height * beams.width) * loads.axis_normal(u)  # Pa
    clamped = fem.locate_dofs_topological(V, args.dim - 1, facet_tags.find(CLAMP))
    body = Body(
        u,
        materials.saint_venant_kirchhoff(E=2e6, nu=0.3),
        thickness=beams.width if args.dim == 2 else 1.0,
        external=[(traction, ds(TIP))],
        bcs=[fem.dirichletbc(np.zeros(args.dim), clamped, V)],
    )

    sides = [Surface(mesh, facet_tags, UPPER_BOTTOM), Surface(mesh, facet_tags, LOWER_TOP)]
    contactor, target = reversed(sides) if args.swap else sides
    problem = ContactProblem(body, contacts=[Contact(contactor, target, friction=friction)])
    pair = problem.pairs[0]

    middle = [beams.length, beams.height / 2] + [beams.width / 2] * (args.dim - 2)
    tip = output.Probe(u, middle, cell_tags.find(UPPER))
    said = vars(args) | {"friction": friction}
    run = output.Run(problem, directory, COLUMNS, said, args.paraview, checkpoint=args.checkpoint)
    left = round(args.increments * (1 - run.start / args.load))
    march = quasistatic.march(problem, P, to=args.load, increments=left, start=run.start, progress=True) if left else ()
    for step in march:
        ux, uy = tip()[:2]
        fx, fy = pair.force()[:2]
        run.record(
            step, step.load, load=step.load, tip_ux=ux, tip_uy=uy, contact_force_x=fx, contact_force_y=fy,
            active_fraction=pair.closed_fraction(), stick_fraction=pair.stick_fraction(),
        )  # fmt: skip
    run.finish()
    return run.history, output.deformed_cells(u) if args.dim == 2 else None, pair.fields_on_root()


def draw(results: dict[float, tuple], directory: Path) -> None:
    """Figure 1: deformed beams with their contact tractions, and the tip's deflection against the force."""
    import matplotlib.pyplot as plt
    from matplotlib.collections import PolyCollection

    figure, axes = plt.subplots(1, len(results) + 1, figsize=(5 * (len(results) + 1), 4.2), layout="constrained")
    for axis, (friction, (history, cells, contact)), letter in zip(axes, results.items(), "abcdefgh", strict=False):
        if cells is not None:
            axis.add_collection(PolyCollection(cells, facecolor="0.85", edgecolor="0.4", linewidth=0.3))
        closed = contact.pressure > 0
        size = np.linalg.norm(contact.traction[closed], axis=1, keepdims=True)
        arrows = 0.15 * contact.traction[closed] / np.sqrt(size * size.max(initial=0.0))  # lengths as √|t|
        axis.quiver(*contact.x[closed, :2].T, *arrows[:, :2].T, color="tab:red", width=3e-3, scale=1, scale_units="xy")
        axis.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
        axis.update_datalim(contact.x[closed, :2] + arrows[:, :2])
        axis.autoscale()
        peak = contact.pressure.max(initial=0.0)
        axis.set_title(
            f"({letter}) μ = {friction:g}, P = {history.column('load')[-1]:g} N, p ≤ {peak:.3g} Pa", fontsize=10
        )
        axes[-1].plot(
            np.r_[0, history.column("load")], np.r_[0, history.column("tip_uy")], ".-", label=f"μ = {friction:g}"
        )
    axes[-1].set(xlabel="P (N)", ylabel="deflection of the tip (m)")
    axes[-1].set_title(f"({'abcdefgh'[len(results)]}) deflection against force", fontsize=10)
    axes[-1].legend()
    figure.savefig(directory / "figure1.png", dpi=150)


if __name__ == "__main__":
    args = options()
    results = {}
    for friction in args.friction:
        directory = args.output if len(args.friction) == 1 else args.output / f"friction_{friction:g}"
        results[friction] = simulate(args, friction, directory)
        if MPI.COMM_WORLD.rank == 0:
            print(f"μ = {friction:g}: tip u_y = {results[friction][0].column('tip_uy')[-1]:.6f} m in {directory}")
    if MPI.COMM_WORLD.rank == 0 and not args.no_figure:
        draw(results, args.output)
