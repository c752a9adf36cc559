"""The same numbers on any number of ranks: each scene on all ranks together and on every rank by itself."""

import numpy as np
import pytest
import scaling
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_box
from mpi4py import MPI
from petsc4py import PETSc
from scenes import beams, blocks, tip

from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, materials, quasistatic
from meshes.ironing import PUNCH, PUNCH_BOTTOM, PUNCH_TOP, SLAB, SLAB_BOTTOM, SLAB_TOP, Ironing
from meshes.two_beams import LOWER_TOP, UPPER_BOTTOM


@pytest.mark.several_ranks
@pytest.mark.parametrize(
    "dim, triangles, friction, projection",
    [(2, False, 0.0, "rays"), (2, True, 0.3, "rays"), (2, False, 0.3, "closest"), (3, False, 0.3, "rays")],
)
def test_together_and_alone(dim, triangles, friction, projection):
    results = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        mesh = {"dim": dim, "triangles": triangles, "along": (8, 8), "across": 1}
        problem, P = beams(comm, friction=friction, mesh=mesh, projection=projection)
        for _ in quasistatic.march(problem, P, to=4.0, increments=4):
            pass
        results.append((tip(problem), problem.pairs[0].force(), problem.pairs[0].closed_fraction()))
    together, alone = results
    assert np.allclose(together[0], alone[0], rtol=1e-8)
    assert np.allclose(together[1], alone[1], rtol=1e-8, atol=1e-8)
    assert together[2] == pytest.approx(alone[2], rel=1e-12)


@pytest.mark.several_ranks
def test_a_mesh_is_shared_out_alike_each_time():
    """Twenty times; with four threads PT-Scotch makes 20 partitions of this mesh, on two and on three ranks."""
    found = set()
    for _ in range(20):
        box = create_box(MPI.COMM_WORLD, [[0, 0, 0], [1, 1, 1]], [9, 9, 4], CellType.tetrahedron)
        found.add(tuple(MPI.COMM_WORLD.allgather(box.topology.original_cell_index.tobytes())))
    assert len(found) == 1


@pytest.mark.several_ranks
@pytest.mark.parametrize("dim", [2, 3])
def test_corners_together_and_alone(dim):
    """A block whose sides are in its surface: facets at an edge may be those of different ranks."""
    results = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        problem, p = blocks(comm, order=1, dim=dim, cells=(7, 5), friction=0.3, sides=True)
        steps = list(quasistatic.march(problem, p, to=2e4, increments=2))
        pair = problem.pairs[0]
        left_out = comm.allreduce(int(pair.blocks.left_out_at_corners.sum()))
        results.append(([step.iterations for step in steps], left_out, pair.largest_pressure(), pair.force()))
    together, alone = results
    assert together[:2] == alone[:2] and alone[1] > 0
    assert together[2] == pytest.approx(alone[2], rel=1e-8)
    assert np.allclose(together[3], alone[3], rtol=1e-8, atol=1e-6)


def ironing(comm, slab_is_contactor):
    """A punch of ten times the slab's stiffness, μ = 0.3, pressed in by 0.1 m and dragged by 0.2 m, a facet a step."""
    mesh, cells, facets = Ironing(cells=8).create(comm)
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (2,))))
    top, V = fem.Constant(mesh, np.zeros(2)), u.function_space
    dx = ufl.Measure("dx", mesh, subdomain_data=cells)
    bodies = {SLAB: 100.0, PUNCH: 1000.0}
    F = sum(materials.saint_venant_kirchhoff(E, 0.32).virtual_work(u, dx=dx(body)) for body, E in bodies.items())
    held = {SLAB_BOTTOM: fem.Constant(mesh, np.zeros(2)), PUNCH_TOP: top}
    bcs = [fem.dirichletbc(v, fem.locate_dofs_topological(V, 1, facets.find(tag)), V) for tag, v in held.items()]
    sides = [Surface(mesh, facets, PUNCH_BOTTOM), Surface(mesh, facets, SLAB_TOP)]
    contactor, target = reversed(sides) if slab_is_contactor else sides
    contact = Contact(contactor, target, friction=0.3)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact])

    def press(share):
        top.value[1] = -0.1 * share

    def drag(share):
        top.value[0] = 0.2 * share

    iterations = [step.iterations for step in quasistatic.march(problem, press, to=1.0, increments=2, start=0.0)]
    iterations += [step.iterations for step in quasistatic.march(problem, drag, to=1.0, increments=2, start=0.0)]
    return problem, iterations


@pytest.mark.several_ranks
@pytest.mark.parametrize("slab_is_contactor", [False, True], ids=["punch", "slab"])
def test_ironing_together_and_alone(slab_is_contactor):
    """Ranks without a part of the punch or of the zone, and points that slide from facet to facet, stick and slip."""
    together, iterations = ironing(MPI.COMM_WORLD, slab_is_contactor)
    alone, same = ironing(MPI.COMM_SELF, slab_is_contactor)
    assert iterations == same
    pair, other = together.pairs[0], alone.pairs[0]
    force = other.force()
    # the punch is drawn back by less than μ times what presses
    assert 0.1 < abs(force[0]) / abs(force[1]) < 0.3 + 1e-3
    assert np.allclose(pair.force(), force, rtol=1e-8)
    corner = (1.0, 2.0 + 0.6**2 / 2)  # of the punch's bottom
    assert np.allclose(tip(together, corner), tip(alone, corner), rtol=1e-8)
    assert pair.largest_pressure() == pytest.approx(other.largest_pressure(), rel=1e-8)
    assert pair.contact_area() == pytest.approx(other.contact_area(), rel=1e-8)
    assert pair.stick_fraction() == pytest.approx(other.stick_fraction(), rel=1e-12)


@pytest.mark.several_ranks
@pytest.mark.parametrize("kind", ["direct", "iterative"])
def test_block_in_space_together_and_alone(kind):
    """Pressed and dragged with friction, by MUMPS and by FGMRES, whose multigrid is another on each number of ranks."""
    prefix = f"ranks_{kind}_"
    PETSc.Options(prefix)["linear_solver"] = kind
    if kind == "iterative":
        PETSc.Options(prefix)["ksp_rtol"] = 1e-10
    results = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        problem, top = scaling.build(scaling.Row(400), comm)
        solver = NewtonSolver(problem, rtol=1e-12, prefix=prefix)
        for _ in scaling.press_and_drag(problem, top, solver, steps=(1, 1)):
            pass
        pair = problem.pairs[0]
        assert solver.linear.iterative == (kind == "iterative") and solver.linear.failures == 0
        results.append((pair.force(), pair.largest_pressure(), pair.closed_fraction(), pair.stick_fraction()))
    (force, pressure, *shares), (same, largest, *alone) = results
    assert abs(force[0]) > 0.1 * force[2]  # friction draws
    assert np.allclose(force, same, rtol=0.0, atol=1e-8 * np.linalg.norm(same))
    assert pressure == pytest.approx(largest, rel=1e-8)
    assert shares == pytest.approx(alone, abs=1e-12)


def test_contactor_and_target_on_different_ranks():
    """The partition of this mesh does split the interface's two sides when there is more than one rank."""
    problem, _ = beams()
    mesh, tags = problem.u.function_space.mesh, problem.pairs[0].contact.contactor.tags
    sides = [len(Surface(mesh, tags, tag).owned_facets()) for tag in (UPPER_BOTTOM, LOWER_TOP)]
    counts = np.array(problem.comm.allgather(sides))
    assert counts.sum(axis=0).tolist() == [10, 10]
    if problem.comm.size > 1:
        assert np.any(counts[:, 0] != counts[:, 1])
