"""A domed block of rubber is pressed onto a stiffer plate and dragged over it, at any number of unknowns.

It illustrates contact in space on meshes that do not match, a march in stages, and problems for which the iterative solver
is chosen (above 40 000 unknowns; the log and summary.json say which it was). The block's top is prescribed: first it goes
down, then obliquely along,

    Σ ∫ P(u) : ∇v dΩ − ∫ t·(v₁ − v₂∘η) dS₀ = 0,    u₁ = U(stage) on the top,    u₂ = 0 at the plate's bottom.

The friction of the whole zone is the drag; once all points slip it is μ times the normal force, but for the zone's slope.

    ./run python3 demos/press_and_drag.py
    ./run python3 demos/press_and_drag.py --size 1e5 --paraview --checkpoint --verbose
    ./run mpirun -n 2 python3 demos/press_and_drag.py --order 2 --tetrahedra
"""

import argparse
import logging
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from demos.demo_options import add_options
from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, output, quasistatic
from dolfinx_mortar_al.command_line import parse
from meshes.domed_box import BOTTOM, TOP, DomedBox

PLATE, BLOCK = (2.0, 1.5, 0.8), (1.0, 1.0, 0.5)  # sizes (m)
CORNER = (0.35, 0.25, 0.8)  # of the block, on the plate
RADIUS = 1.0  # of the dome at its lowest point (m)
COARSER = 0.7  # cells per metre in the plate over those in the block
E_PLATE, E_BLOCK, NU = 1000.0, 100.0, 0.3  # moduli (Pa)
DOWN, ALONG = 0.12, (0.2, 0.09)  # motion of the top (m)
COLUMNS = ["stage", "normal_force", "drag", "closed", "stick", "contact_area", "newton_iterations", "wall_time"]


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--size", type=float, default=5e3, help="displacement unknowns, about (%(default)g)")
    add("--cells", type=int, help="per metre of the block, in place of --size; in the plate 0.7 as many")
    add("--order", type=int, default=1, choices=(1, 2), help="of displacement and geometry (%(default)s)")
    add("--tetrahedra", action="store_true", help="instead of hexahedra")
    add("--friction", type=float, default=0.3, help="Coulomb's μ (%(default)s)")
    add("--increments", type=int, nargs=2, default=(2, 4), help="steps of pressing and of dragging (%(default)s)")
    add("--verbose", action="store_true", help="show the log, such as which linear solver is chosen")
    add_options(parser, "press_and_drag", figure=7)
    return parse(parser)


def boxes(n: float, args: argparse.Namespace) -> list[DomedBox]:
    """Block and plate with n cells per metre of the block."""
    same = {"tetrahedra": args.tetrahedra, "order": args.order}
    return [DomedBox(CORNER, BLOCK, n, radius=RADIUS, **same), DomedBox((0.0, 0.0, 0.0), PLATE, COARSER * n, **same)]


def cells_per_metre(args: argparse.Namespace) -> int:
    """Of the block, for a number of displacement unknowns nearest to --size."""
    return min(range(2, 400), key=lambda n: abs(sum(box.unknowns() for box in boxes(n, args)) - args.size))


def simulate(args: argparse.Namespace, directory: Path) -> output.History:
    """Press, then drag."""
    n = cells_per_metre(args) if args.cells is None else args.cells
    (block, block_tags), (plate, plate_tags) = (box.create() for box in boxes(n, args))
    u = [fem.Function(fem.functionspace(domain, ("Lagrange", args.order, (3,)))) for domain in (block, plate)]
    top, held = fem.Constant(block, np.zeros(3)), fem.Constant(plate, np.zeros(3))
    held_by = [
        fem.dirichletbc(value, fem.locate_dofs_topological(v.function_space, 2, tags.find(tag)), v.function_space)
        for value, v, tags, tag in ((top, u[0], block_tags, TOP), (held, u[1], plate_tags, BOTTOM))
    ]
    bodies = [
        Body(v, materials.neo_hookean(E, NU), bcs=[bc]) for v, E, bc in zip(u, (E_BLOCK, E_PLATE), held_by, strict=True)
    ]
    contact = Contact(Surface(block, block_tags, BOTTOM), Surface(plate, plate_tags, TOP), friction=args.friction)
    problem = ContactProblem(bodies, contacts=[contact])
    pair = problem.pairs[0]

    run = output.Run(problem, directory, COLUMNS, vars(args), args.paraview, checkpoint=args.checkpoint)
    stages = [
        quasistatic.Stage(top, (0.0, 0.0, -DOWN), args.increments[0]),
        quasistatic.Stage(top, (*ALONG, -DOWN), args.increments[1]),
    ]
    march = quasistatic.march(problem, stages, start=run.start, progress=True) if run.start < len(stages) else ()
    for step in march:
        force = pair.force()
        run.record(
            step, step.path, stage=step.path, normal_force=force[2], drag=float(np.hypot(*force[:2])),
            closed=pair.closed_fraction(), stick=pair.stick_fraction(), contact_area=pair.contact_area(),
        )  # fmt: skip
    if not args.no_figure:
        try:
            output.picture(problem, directory / "figure7.png", "pressure", title="contact pressure")
        except ModuleNotFoundError as missing:
            if MPI.COMM_WORLD.rank == 0:
                print(missing)
    run.finish()
    return run.history


if __name__ == "__main__":
    args = options()
    logging.basicConfig(level=logging.INFO if args.verbose else logging.WARNING, format="%(message)s")
    history = simulate(args, args.output)
    if MPI.COMM_WORLD.rank == 0:
        last = history.rows[-1]
        print(f"normal force {last['normal_force']:.5g} N, drag {last['drag']:.5g} N; results in {args.output}")
