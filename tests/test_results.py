"""What a run reports: contact fields, reactions, pairs by name, files for ParaView, pictures."""

import importlib.util

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, compute_midpoints, create_unit_square, locate_entities_boundary, meshtags
from mpi4py import MPI
from scenes import NU, E, beams, blocks, contact_of, membranes
from test_dynamics import disc
from test_rigid_targets import block

from dolfinx_mortar_al import (
    Contact,
    ContactProblem,
    NewtonSolver,
    Surface,
    dynamics,
    materials,
    obstacles,
    output,
    quasistatic,
    reaction,
)
from dolfinx_mortar_al.contactor_functions import ContactorFunctions
from dolfinx_mortar_al.law import OPEN, SLIP, STICK
from dolfinx_mortar_al.picture import _contactors
from dolfinx_mortar_al.reductions import max_over
from meshes.two_beams import TwoBeams

MU = 0.3
HAS_PYVISTA = importlib.util.find_spec("pyvista") is not None


def beam_pair(comm=MPI.COMM_WORLD, friction=MU):
    """The pair of the two beams of section 4.1 at a small force: open in part, sliding in part."""
    problem, P = beams(comm, friction=friction, order=2)
    for _ in quasistatic.march(problem, P, to=10.0, increments=2):
        pass
    return problem.pair("contact")


def integral(pair, values):
    """∫ values dS₀ over the contactor, on every rank."""
    return np.asarray(pair.comm.allreduce(np.asarray(pair.fields().area @ values)))


def assert_law(pair, friction):
    """Signorini's and Coulomb's conditions at every point, to round-off."""
    now = pair.fields()
    for name in ("pressure", "traction", "tangential_traction", "slip"):
        assert not np.any(getattr(now, name)[now.status == OPEN]), name
    size, bound = np.linalg.norm(now.tangential_traction, axis=1), friction * now.pressure
    along = np.einsum("ni,ni->n", now.tangential_traction, now.slip)
    slides = now.status == SLIP
    assert np.all(now.pressure[slides] >= 0) and np.all(size <= bound * (1 + 1e-12) + 1e-12)
    assert np.allclose(size[slides], bound[slides], rtol=1e-12)
    assert np.allclose(along[slides], -(size * np.linalg.norm(now.slip, axis=1))[slides], rtol=1e-9)
    assert not np.any(now.slip[now.status == STICK])
    assert np.allclose(integral(pair, now.traction), pair.force(), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("friction", [0.0, MU])
def test_fields_say_what_the_law_says(friction):
    """In statics; and all of the contactor is there: areas sum up, shapes agree."""
    pair = beam_pair(friction=friction)
    now = pair.fields()
    assert now.X.shape == now.x.shape == now.traction.shape == now.tangential_traction.shape == now.slip.shape
    assert now.X.shape[:1] == now.area.shape == now.gap.shape == now.pressure.shape == now.status.shape
    seen = pair.comm.allreduce(np.bincount(now.status, minlength=3))
    assert seen[OPEN] > 0 and seen[SLIP] > 0
    assert integral(pair, np.ones(len(now.area))) == pytest.approx(pair.area, rel=1e-12)
    assert_law(pair, friction)


def test_fields_in_impact():
    """A disc that hits a plane askew: the law holds in each step, and tractions sum up to the pair's force."""
    problem, _ = disc(velocity=lambda x: np.stack([8 + 0 * x[0], -8 + 0 * x[0]]), step=2e-3)
    pair, seen = problem.pairs[0], np.zeros(3, dtype=int)
    march = dynamics.march(problem, to=0.01)
    assert not np.any(pair.fields().traction) and not np.any(pair.force())  # before the first step, too
    for _ in march:
        assert_law(pair, 0.3)
        seen += pair.comm.allreduce(np.bincount(pair.fields().status, minlength=3))
    assert seen[OPEN] > 0 and seen[SLIP] > 0


def test_fields_are_those_of_one_rank():
    """Gathered on rank 0 in order of X: as computed alone, to Newton's tolerance; None elsewhere."""
    together, alone = beam_pair().fields_on_root(), beam_pair(MPI.COMM_SELF).fields_on_root()
    assert (together is not None) == (MPI.COMM_WORLD.rank == 0)
    if together is not None:
        peak = alone.pressure.max()
        assert np.allclose(together.X, alone.X, atol=1e-12) and np.all(np.diff(np.round(alone.X[:, 0], 12)) >= 0)
        assert np.allclose(together.pressure, alone.pressure, atol=1e-6 * peak)
        assert np.allclose(together.slip, alone.slip, atol=1e-9)
        assert np.allclose(together.gap, alone.gap, atol=1e-9, equal_nan=True)


def test_slip_is_how_far_the_target_has_gone():
    """Once a plane drags all of a block's face, nothing but the plane moves: the slip of each step is minus the
    plane's motion in the mean, also at the nodes (1e-9 of it; at points to 1 %), with friction along that motion."""
    plane = obstacles.RigidPlane([0.0, 0.0], [0.0, -1.0])
    problem = block(plane, friction=0.2)
    for _ in quasistatic.march(problem, lambda t: plane.move([0.0, -0.02 * t]), to=1.0, increments=2):
        pass
    for _ in quasistatic.march(problem, lambda t: plane.move([0.02 * t, -0.02]), to=2.0, increments=4):
        pass
    pair = problem.pairs[0]
    now = pair.fields()
    assert np.all(now.status == SLIP) and np.all(now.tangential_traction[:, 0] > 0)
    assert np.allclose(integral(pair, now.slip), [-0.01 * pair.area, 0.0], atol=1e-11)
    assert np.allclose(now.slip, [-0.01, 0.0], atol=1e-4)
    assert np.allclose(ContactorFunctions(pair).nodal("slip"), [-0.01, 0.0], atol=1e-11)


# ---------------------------------------------------------------- reactions


def test_reaction_on_a_roller_bears_the_load():
    """Two blocks on rollers under a dead pressure: the lower roller bears it, with its arm, whatever names the roller
    (1e-9)."""
    problem, p = blocks(order=2)
    for _ in quasistatic.march(problem, p, to=1e4, increments=1):
        pass
    domain = problem.u.function_space.mesh
    bottom = locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], -0.5))
    tags = meshtags(domain, 1, np.sort(bottom), np.full(len(bottom), 5, dtype=np.int32))
    bc, load = problem.bodies.bodies[0].bcs[1], 1e4 * 1.0
    roller, named = reaction(problem, bc), reaction(problem, Surface(domain, tags, 5))
    assert np.allclose(roller.force, [0.0, load], atol=1e-9 * load)
    assert named.force[1] == pytest.approx(load, rel=1e-9)
    lever = roller.moment - reaction(problem, bc, about=(1.0, 0.0)).moment
    assert lever == pytest.approx([load], rel=1e-9)


def punch(comm=MPI.COMM_WORLD, dim=2):
    """A block, every node of which is prescribed, pressed and dragged on another that is clamped: (problem, its
    condition, the clamp)."""
    built = TwoBeams(height=0.5, width=0.5, along=(6, 3), across=1, through=1, dim=dim)
    domain, _, tags = built.create(comm)
    V = fem.functionspace(domain, ("Lagrange", 1, (dim,)))
    u, motion = fem.Function(V), fem.Constant(domain, np.zeros(dim))
    lower = fem.locate_dofs_geometrical(V, lambda x: x[1] < -0.4)
    domain.topology.create_connectivity(dim, dim)
    upper = fem.locate_dofs_topological(V, dim, _cells_above(domain))
    bcs = [fem.dirichletbc(motion, upper, V), fem.dirichletbc(np.zeros(dim), lower, V)]
    F = materials.saint_venant_kirchhoff(E, NU).virtual_work(u)
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact_of(domain, tags, friction=MU, name="punch")])
    way = np.eye(dim)[0] * 0.03 - np.eye(dim)[1] * 0.02

    def move(t):
        motion.value[:] = way * t

    for _ in quasistatic.march(problem, move, to=1.0, increments=2):
        pass
    return problem, *bcs


def _cells_above(domain):
    dim = domain.topology.dim
    cells = np.arange(domain.topology.index_map(dim).size_local, dtype=np.int32)
    return cells[compute_midpoints(domain, dim, cells)[:, 1] > 0]


@pytest.mark.parametrize("dim", [2, 3])
def test_reaction_on_a_contactor_that_is_prescribed(dim):
    """Nothing but the support and contact act on a punch: its reaction is minus the contact's force and moment, and the clamp
    of the other block bears the force (1e-8)."""
    problem, held, clamp = punch(dim=dim)
    pair, about = problem.pair("punch"), np.full(dim, 0.3)
    on_punch, on_clamp, size = (
        reaction(problem, held, about=about),
        reaction(problem, clamp),
        np.abs(pair.force()).max(),
    )
    assert size > 1e3 and pair.force()[0] < -0.1 * size
    assert np.allclose(on_punch.force, -pair.force(), atol=1e-8 * size)
    assert np.allclose(on_punch.moment, -pair.moment(about), atol=1e-8 * size)
    assert np.allclose(on_clamp.force, pair.force(), atol=1e-8 * size)


def test_reaction_in_motion_is_the_mean_over_the_step():
    """A clamped block under its weight from rest: reaction and weight change its momentum in each step, to Newton's
    tolerance."""
    domain, _, _ = TwoBeams(height=0.5, width=0.5, along=(4, 4), across=2, gap=0.1).create(MPI.COMM_WORLD)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    V, weight = u.function_space, 2e4
    down = ufl.inner(ufl.as_vector([0.0, -weight]), ufl.TestFunction(V)) * ufl.dx(domain)
    motion = dynamics.Motion(u, materials.neo_hookean(E, NU), density=1e3, step=2e-3, external=down)
    end = fem.dirichletbc(np.zeros(2), fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0)), V)
    problem = ContactProblem(motion, bcs=[end])
    total = weight * problem.comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(domain, 1.0) * ufl.dx)))
    before = motion.momenta()[:2]
    for step in dynamics.march(problem, to=8e-3):
        now = motion.momenta()[:2]
        change = (now - before) / step.step
        borne = reaction(problem, end).force - np.array([0.0, total])
        assert np.allclose(borne, change, atol=1e-7 * total)
        before = now


def test_what_has_no_reaction_is_refused():
    """Each message names the argument and what to pass."""
    problem, _ = blocks(order=1)
    domain, V = problem.u.function_space.mesh, problem.u.function_space
    with pytest.raises(ValueError, match="none of the problem's bcs"):
        reaction(problem, fem.dirichletbc(np.zeros(2), np.zeros(0, dtype=np.int32), V))
    with pytest.raises(ValueError, match="neither a Dirichlet condition nor a Surface"):
        reaction(problem, 3)
    contactor = problem.pairs[0].contact.contactor
    with pytest.raises(ValueError, match=f"nothing is prescribed on the surface of tag {contactor.tag}"):
        reaction(problem, Surface(domain, _without_sides(domain, contactor), contactor.tag))
    with pytest.raises(ValueError, match="about"):
        reaction(problem, problem.bodies.bodies[0].bcs[0], about=(0.0, 0.0, 0.0))


def _without_sides(domain, surface):
    """The surface's facets away from rollers."""
    facets = surface.tags.find(surface.tag)
    inner = facets[compute_midpoints(domain, 1, facets)[:, 0] > 0.3]
    return meshtags(domain, 1, inner, np.full(len(inner), surface.tag, dtype=np.int32))


def test_pairs_by_name():
    """Known names are said where one is not."""
    problem, _ = beams(parts=2)
    assert problem.pair("part 1") is problem.pairs[1]
    with pytest.raises(ValueError, match=r"'part 2'.*known are 'part 0', 'part 1'"):
        problem.pair("part 2")


# ---------------------------------------------------------------- on the contactor's own mesh


def test_functions_on_the_contactor():
    """Means at nodes: resultants kept (1e-12), pressures positive, friction within its bound, none where all is open."""
    pair = beam_pair()
    functions = ContactorFunctions(pair)
    found = functions.functions
    now, mesh = pair.fields(), found["pressure"].function_space.mesh
    thickness = pair.contact.thickness
    for name in ("pressure", "tangential_traction"):
        v = found[name]
        parts = [v] if name == "pressure" else list(ufl.split(v))
        sums = [pair.comm.allreduce(fem.assemble_scalar(fem.form(thickness * c * ufl.dx(mesh)))) for c in parts]
        assert np.allclose(sums, integral(pair, getattr(now, name)), rtol=1e-12)
    pressure, friction = (
        functions.nodal("pressure")[..., 0],
        np.linalg.norm(functions.nodal("tangential_traction"), axis=2),
    )
    status, gap = functions.nodal("status")[..., 0], functions.nodal("gap")[..., 0]
    assert np.all(pressure >= 0) and np.all(friction <= MU * pressure + 1e-9)
    assert set(np.unique(status)) <= {0.0, 1.0, 2.0}
    apart = np.nan_to_num(gap) > 1e-3
    assert not np.any(status[apart])
    u = pair.kinematics.nodes() - pair.facets.X
    assert np.allclose(functions.nodal("displacement"), u, atol=1e-14)
    # where facets meet, all ranks have the same values
    x = found["pressure"].function_space.tabulate_dof_coordinates()[:, 0]
    every = pair.comm.allgather(dict(zip(np.round(x, 9).tolist(), found["pressure"].x.array.tolist(), strict=True)))
    for one in every:
        assert all(one[k] == pytest.approx(other[k]) for other in every for k in one.keys() & other.keys())


@pytest.mark.parametrize("scene", ["beams in space", "membranes", "disc"])
def test_paraview_has_the_contactor(scene, shared_path):
    """A series per body and contactor, in statics and in motion, on any number of ranks."""
    if scene == "disc":
        problem, _ = disc(velocity=lambda x: np.stack([8 + 0 * x[0], -8 + 0 * x[0]]), step=2e-3)
        march = dynamics.march(problem, to=4e-3)
    else:
        small = {"dim": 3, "along": (4, 4), "across": 1, "through": 1}
        problem, load = (
            beams(order=1, friction=MU, mesh=small) if scene.startswith("beams") else membranes(cells=(8, 8))
        )
        march = quasistatic.march(problem, load, to=1.0, increments=1)
    writer = output.ParaView(problem, shared_path)
    for step in march:
        writer.write(getattr(step, "time", 0.0))
    writer.close()
    assert {f.name for f in shared_path.iterdir()} == {"displacement.bp", "contactor_contact.bp"}
    problem.comm.Barrier()
    text = b"".join(f.read_bytes() for f in (shared_path / "contactor_contact.bp").iterdir())
    for name in ("displacement", "gap", "pressure", "tangential_traction", "slip", "status", "multiplier"):
        assert name.encode() in text, name


# ---------------------------------------------------------------- pictures


@pytest.mark.skipif(not HAS_PYVISTA, reason="no PyVista here")
def test_a_picture_shows_the_bodies(shared_path):
    """A PNG of the size asked for, with colours of the scale and plain ones; on any number of ranks."""
    from matplotlib.image import imread

    problem, _ = beams(order=2, mesh={"dim": 3, "along": (4, 4), "across": 1, "through": 1})
    problem.u.interpolate(lambda x: np.stack([0 * x[0], -0.3 * x[0] ** 2, 0 * x[0]]))
    output.picture(problem, shared_path / "new" / "x.png", size=(300, 200), title="bent")
    problem.comm.Barrier()
    image = imread(shared_path / "new" / "x.png")[..., :3]
    assert image.shape == (200, 300, 3)
    assert 0.05 < np.mean(image.min(axis=2) < 0.99) < 0.9  # drawn upon, not filled
    assert np.any(np.ptp(image, axis=2) > 0.4)


def test_a_surface_of_two_pairs_is_drawn_once_with_the_pressures_of_both():
    """Drawn twice in the same place one would hide the other."""
    pressures = []
    for planes in (1, 2):
        domain = create_unit_square(MPI.COMM_WORLD, 4, 4, CellType.quadrilateral)
        u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
        outside = locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0) | np.isclose(x[1], 1.0))
        tags = meshtags(domain, 1, np.sort(outside), np.full(len(outside), 1, dtype=np.int32))
        floor, lid = obstacles.RigidPlane([0, 0.01], [0, 1]), obstacles.RigidPlane([0, 0.99], [0, -1])
        contacts = [Contact(Surface(domain, tags, 1), plane) for plane in (floor, lid)[:planes]]
        still = fem.locate_dofs_geometrical(u.function_space, lambda x: np.isclose(x[1], 0.5))
        bcs = [fem.dirichletbc(np.zeros(2), still, u.function_space)]
        problem = ContactProblem(materials.neo_hookean(1e3, 0.3).virtual_work(u), u, bcs=bcs, contacts=contacts)
        assert NewtonSolver(problem).solve().converged
        parts = _contactors(problem.pairs)
        assert len(parts) == 1
        below = parts[0].points[:, 1] < 0.5
        pressures.append(
            [max_over(problem.comm, float(parts[0].values[side].max(initial=0.0))) for side in (below, ~below)]
        )
    assert pressures[0][0] > 10.0 and pressures[0][1] == 0.0
    assert np.allclose(pressures[1], pressures[0][0], rtol=1e-8)  # Pa, by symmetry


def test_a_picture_that_cannot_be_is_refused(shared_path):
    """On every rank, before anything is drawn."""
    problem, _ = beams(order=1)
    for arguments, said in (
        (("x.png", "stress"), 'colour = "stress"'),
        (("x.pdf",), "let it end in .png"),
    ):
        with pytest.raises(ValueError, match=said):
            output.picture(problem, *arguments)
    with pytest.raises(ValueError, match="is along up"):
        output.picture(problem, shared_path / "x.png", view=(0, 1, 0))
    with pytest.raises(ValueError, match="size"):
        output.picture(problem, shared_path / "x.png", size=(300,))


def test_a_probe_is_at_a_point_of_the_mesh():
    """Values of a linear field to round-off, on every rank, as it is at each call; elsewhere there is none."""
    u = fem.Function(fem.functionspace(create_unit_square(MPI.COMM_WORLD, 3, 3), ("Lagrange", 1, (2,))))
    probe = output.Probe(u, [0.3, 0.2])
    for factor in (1.0, 2.0):
        u.interpolate(lambda x, factor=factor: factor * np.stack([x[0], x[0] + 2 * x[1]]))
        assert np.allclose(probe(), factor * np.array([0.3, 0.7]), rtol=1e-12)
    with pytest.raises(ValueError, match="lies in no cell"):
        output.Probe(u, [0.3, 50.0])
