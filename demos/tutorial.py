"""Tutorial: from a CAD model to a rubber foot that is pressed onto a plate and dragged along it, with friction, in space.

Read it from top to bottom; each part says what it does and why. It takes half a minute:

    ./run python3 demos/tutorial.py                 # pictures, history.csv and ParaView files in results/tutorial
    ./run mpirun -n 2 python3 demos/tutorial.py     # the same numbers on two ranks
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, output, quasistatic, reaction, read_msh
from dolfinx_mortar_al.command_line import parse

PLATE, FOOT, BASE, FACE, SOLE, HEAD = 1, 2, 11, 12, 13, 14  # physical groups: two volumes, four surfaces
COLUMNS = ["path", "drag", "press", "closed", "stick", "newton_iterations", "wall_time"]  # of history.csv


# 1. Geometry and mesh. One gmsh model holds both bodies. They may touch, but must not share nodes: never `fragment` them.
#    Everything that is named later, by material, support or contact, needs a physical group. gmsh's numbers of
#    surfaces change with each CAD operation, so the surfaces are found by where they are.
def build(path: Path, size: float) -> None:
    """Write the mesh: a plate of 80 × 40 × 10 mm and on it a foot, a cylinder with a rounded edge. Lengths in metres."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 2)
    occ = gmsh.model.occ
    plate = occ.addBox(0.0, 0.0, -0.010, 0.080, 0.040, 0.010)
    foot = occ.addCylinder(0.022, 0.020, 0.0, 0.0, 0.0, 0.016, 0.012)
    occ.synchronize()
    rim = [e for _, e in gmsh.model.getBoundary(gmsh.model.getBoundary([(3, foot)]), combined=False, oriented=False)]
    rim = [e for e in set(rim) if abs(gmsh.model.occ.getCenterOfMass(1, e)[2]) < 1e-6]
    ((_, foot),) = occ.fillet([foot], rim, [0.004])
    occ.synchronize()

    def name(tag: int, body: int, is_in: Callable[[float], bool]) -> None:
        surfaces = [s for _, s in gmsh.model.getBoundary([(3, body)], oriented=False)]
        gmsh.model.addPhysicalGroup(2, [s for s in surfaces if is_in(occ.getCenterOfMass(2, s)[2])], tag)

    gmsh.model.addPhysicalGroup(3, [plate], PLATE)
    gmsh.model.addPhysicalGroup(3, [foot], FOOT)
    name(BASE, plate, lambda z: z < -0.0099)
    name(FACE, plate, lambda z: z > -1e-6)
    name(SOLE, foot, lambda z: z < 0.004)
    name(HEAD, foot, lambda z: z > 0.0159)
    # The foot is the softer body and the contactor: its mesh is the finer one.
    gmsh.option.setNumber("Mesh.MeshSizeMax", 1.8 * size)
    gmsh.model.mesh.setSize(gmsh.model.getBoundary([(3, foot)], recursive=True), size)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)  # curved cells for a curved surface; only with displacements of second order
    gmsh.write(str(path))
    gmsh.finalize()


def main(directory: Path, size: float) -> tuple[float, float]:
    comm = MPI.COMM_WORLD
    directory.mkdir(parents=True, exist_ok=True)
    if comm.rank == 0:
        build(directory / "foot.msh", size)
    comm.Barrier()
    mesh, cells, facets = read_msh(directory / "foot.msh")

    # 2. Materials. One displacement for both bodies; a stored energy each, on the cells of its volume. Second order pays on
    #    curved surfaces and where bodies bend; first order (change the 2 and leave out `setOrder`) is quicker.
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u = fem.Function(V)
    dx = ufl.Measure("dx", mesh, subdomain_data=cells)
    rubber, plastic = materials.neo_hookean(E=2e6, nu=0.40), materials.saint_venant_kirchhoff(E=50e6, nu=0.3)  # Pa

    # 3. Supports. The plate rests on its base. The head of the foot is led by a Constant, which the load steps change.
    #    To lead it by a force instead, leave this condition out and tell the Body `external=[(traction, ds(HEAD))]`, in Pa.
    #    What the bodies are made of, loaded with and held by is said once, in a Body; a UFL residual of your own goes, too.
    led = fem.Constant(mesh, np.zeros(3))
    base = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, facets.find(BASE)), V)
    head = fem.dirichletbc(led, fem.locate_dofs_topological(V, 2, facets.find(HEAD)), V)
    bodies = Body(u, [(rubber, dx(FOOT)), (plastic, dx(PLATE))], bcs=[base, head])

    # 4. Contact. The contactor carries the integration points and the multiplier: take the softer side, of equally stiff ones
    #    the finer, rather one without sharp corners where it touches, and name all of it that may ever touch. There is
    #    nothing to tune: ε comes from the bodies' stiffness.
    contact = Contact(Surface(mesh, facets, SOLE), Surface(mesh, facets, FACE), friction=0.4, name="sole")
    problem = ContactProblem(bodies, contacts=[contact])
    sole = problem.pair("sole")

    # 5. Load steps. A march moves a load (a Constant, a Function or a function of yours) through stages, each in increments,
    #    and yields every converged step. Friction remembers the way: first press, then drag. An increment that does not
    #    converge is undone, slip included, and tried again at half its size; `step.rejected` counts these trials, and a few
    #    are no harm. If the smallest increment fails too, the march ends with a StepFailure whose text says where and why;
    #    docs/when_it_does_not_converge.md says what to do then.
    press = quasistatic.Stage(led, to=(0.0, 0.0, -0.002), increments=4)
    drag = quasistatic.Stage(led, to=(0.008, 0.0, -0.002), increments=8)
    run = output.Run(problem, directory, COLUMNS, {"size": size}, paraview=True)
    for step in quasistatic.march(problem, [press, drag], progress=True):
        push = reaction(problem, head).force  # with which the foot is led (N)
        run.record(
            step, step.path, path=step.path, drag=push[0], press=-push[2], closed=sole.closed_fraction(),
            stick=sole.stick_fraction(),
        )  # fmt: skip
        if step.path == 1.0:
            output.picture(problem, directory / "pressed.png", "pressure", title="pressed by 2 mm")
    output.picture(problem, directory / "dragged.png", title="dragged by 8 mm")
    output.picture(problem, directory / "pressure.png", "pressure", view=(0.3, -0.6, -1.0), title="from below")

    # 6. Results. Numbers of each pair (force, contact_area, stick_fraction, ...); its fields at the integration points as
    #    arrays, here gathered on rank 0; reactions of supports. Whether to believe them: the support below bears what the
    #    head puts in, and where the whole sole slides, friction is μ times the pressure (the ratio printed here is a little
    #    off 0.4, as pressure on the rounded edge has a part along the drag). For ParaView open displacement.bp and
    #    contactor_sole.bp and warp both by "displacement".
    run.finish()
    down = reaction(problem, base).force
    now = sole.fields_on_root()
    if now is not None:
        print(f"the base bears {down[2]:.2f} N and is dragged by {-down[0]:.2f} N, {-down[0] / down[2]:.3f} of it")
        area = np.sum(now.area[now.status > 0]) * 1e6
        print(
            f"largest pressure {now.pressure.max() / 1e6:.3f} MPa on {area:.0f} mm² (at a point; pictures: nodal means)"
        )
        print(f"pictures in {directory}")
    return float(-down[0]), float(down[2])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("results/tutorial"), help="folder (%(default)s)")
    parser.add_argument("--size", type=float, default=0.004, help="of the foot's elements in m (%(default)s)")
    args = parse(parser)
    main(args.output, args.size)
