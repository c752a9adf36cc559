"""Bad input: one clear message, the same on every rank, never a hang."""

import re
import subprocess
import sys
import warnings
from contextlib import nullcontext as nothing
from pathlib import Path

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc
from scenes import beams, tip

from dolfinx_mortar_al import (
    Body,
    Checkpoint,
    Contact,
    ContactProblem,
    NewtonSolver,
    Surface,
    dynamics,
    loads,
    materials,
    membrane,
    monitors,
    obstacles,
    output,
    quasistatic,
    reaction,
    read_msh,
)
from dolfinx_mortar_al.monitors import Finding, Reporter
from meshes.two_beams import LOWER_TOP, UPPER_BOTTOM, TwoBeams


@pytest.fixture(scope="module")
def domain():
    return TwoBeams(along=(4, 4), across=1).create()


def problem_on(domain, contact, order=1, shape=None, start=None):
    built = domain[0]
    V = fem.functionspace(built, ("Lagrange", order, shape or (2,)))
    u = fem.Function(V)
    if start is not None:
        u.interpolate(start)
    F = ufl.inner(ufl.grad(u), ufl.grad(ufl.TestFunction(V))) * ufl.dx
    return ContactProblem(F, u, contacts=[contact])


def pair(domain, a=UPPER_BOTTOM, b=LOWER_TOP, **options):
    return Contact(Surface(domain[0], domain[2], a), Surface(domain[0], domain[2], b), **options)


def test_a_missing_tag_names_the_tags_there_are(domain):
    with pytest.raises(ValueError, match=r"tag 99 marks no facet; the tags of this mesh are \[11, 12, 13, 14\]"):
        problem_on(domain, pair(domain, a=99))


def test_a_surface_of_several_tags(domain):
    """It is the facets of all of them, and none may be missing."""
    both = Surface(domain[0], domain[2], [UPPER_BOTTOM, LOWER_TOP]).owned_facets()
    each = [Surface(domain[0], domain[2], tag).owned_facets() for tag in (UPPER_BOTTOM, LOWER_TOP)]
    assert np.array_equal(both, np.sort(np.concatenate(each)))
    with pytest.raises(ValueError, match="tag 99 marks no facet"):
        Surface(domain[0], domain[2], (UPPER_BOTTOM, 99)).owned_facets()
    with pytest.raises(ValueError, match="name a value"):
        Surface(domain[0], domain[2], ()).owned_facets()
    with pytest.raises(ValueError, match="facets in common"):
        problem_on(domain, pair(domain, a=(UPPER_BOTTOM, LOWER_TOP)))


def test_tags_of_cells_are_not_a_surface(domain):
    with pytest.raises(ValueError, match="tags of dimension 2"):
        Surface(domain[0], domain[1], 1).owned_facets()


def test_a_surface_inside_a_body_is_refused(domain):
    built = domain[0]
    inner = mesh.locate_entities(built, 1, lambda x: np.isclose(x[0], 0.5))
    tags = mesh.meshtags(built, 1, np.sort(inner), np.full(len(inner), 7, dtype=np.int32))
    with pytest.raises(ValueError, match="between two cells"):
        Surface(built, tags, 7).owned_facets()


def test_contactor_equal_to_target(domain):
    with pytest.raises(ValueError, match="the same surface"):
        pair(domain, b=UPPER_BOTTOM)


@pytest.mark.parametrize("μ", [-0.1, float("nan"), float("inf")])
def test_friction_must_be_a_number_not_below_zero(domain, μ):
    with pytest.raises(ValueError, match="friction = "):
        pair(domain, friction=μ)


def test_a_function_is_no_number(domain):
    """UFL tries for ever to make one of it: each of these hung."""
    f = fem.Function(fem.functionspace(domain[0], ("DG", 0)), name="f")
    for friction in (f, 2.0 * f):
        with pytest.raises(
            ValueError, match="is one number on a contactor; give each of its parts a tag and a Contact"
        ):
            pair(domain, friction=friction)
    with pytest.raises(ValueError, match="epsilon_normal = f"):
        pair(domain, epsilon_normal=f)
    with pytest.raises(ValueError, match="tag = f"):
        Surface(domain[0], domain[2], f).owned_facets()
    with pytest.raises(ValueError, match="point = "):
        obstacles.RigidPlane([0.0, f], [0.0, 1.0])


@pytest.mark.parametrize("constant", [False, True])
def test_a_friction_beyond_that_of_any_surface_is_said(constant):
    """30 for 30 %, once however many solves there are; that of rubber is nothing to say."""
    μ = fem.Constant(beams(order=1)[0].u.function_space.mesh, 4.0)
    problem, P = beams(order=1, friction=μ if constant else 30.0)
    if constant:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            list(quasistatic.march(problem, P, to=0.5, increments=1))
        μ.value = 30.0
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        list(quasistatic.march(problem, P, to=1.0, increments=2))
    said = [str(w.message) for w in caught if issubclass(w.category, monitors.ModelWarning)]
    assert len(said) == (problem.comm.rank == 0)
    assert all("friction = 30: " in text and "30 % are written 0.3" in text for text in said)


@pytest.mark.parametrize("name", ["epsilon_normal", "epsilon_tangential", "thickness"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_parameters_must_be_positive(domain, name, value):
    with pytest.raises(ValueError, match=f"{name} = "):
        pair(domain, **{name: value})


def test_a_form_that_is_no_number_at_the_start(domain):
    """Without a word of NumPy's about it."""
    V = fem.functionspace(domain[0], ("Lagrange", 1, (2,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) / ufl.sqrt(ufl.dot(u, u)) * ufl.dx
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=r"stiffness of nan .* F or its derivative is not a number there"):
            ContactProblem(F, u, contacts=[pair(domain)])


def test_too_few_gauss_points(domain):
    with pytest.raises(ValueError, match="quadrature_degree = 1 has too few points"):
        problem_on(domain, pair(domain, quadrature_degree=1))


def test_a_target_that_faces_away(domain):
    """The far side of the lower beam: its outward normal points away from the contactor."""
    built = domain[0]
    far = mesh.locate_entities_boundary(built, 1, lambda x: np.isclose(x[1], -0.05))
    tags = mesh.meshtags(built, 1, np.sort(far), np.full(len(far), 7, dtype=np.int32))
    contact = Contact(Surface(built, domain[2], UPPER_BOTTOM), Surface(built, tags, 7))
    with pytest.raises(ValueError, match="faces away"):
        problem_on(domain, contact)


def test_a_body_that_is_there_twice():
    """Both copies press on the slab: a third more force, and no word. A crack's faces, which look at each other, are none."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    cells = np.array([[0, 1, 2], [0, 2, 3]])

    def top(second):
        X, every = np.concatenate([corners, second]), np.concatenate([cells, cells + 4])
        mine = slice(None) if MPI.COMM_WORLD.rank == 0 else slice(0, 0)
        built = mesh.create_mesh(MPI.COMM_WORLD, cells=every[mine].astype(np.int64), x=X[mine], e=element)
        facets = np.sort(mesh.locate_entities_boundary(built, 1, lambda x: np.isclose(x[1], 1.0)))
        u = fem.Function(fem.functionspace(built, ("Lagrange", 1, (2,))))
        tags = mesh.meshtags(built, 1, facets, np.ones(len(facets), dtype=np.int32))
        contact = Contact(Surface(built, tags, 1), obstacles.RigidPlane([0.0, 1.5], [0.0, -1.0]))
        return ContactProblem(materials.neo_hookean(1.0, 0.3).virtual_work(u), u, contacts=[contact])

    with pytest.raises(ValueError, match="lie on others of it and face the same way, 1 in all"):
        top(corners)
    top(np.array([[0, 2], [1, 2], [1, 1], [0, 1]])[[2, 3, 0, 1]])  # the other face of y = 1


def test_a_surface_of_another_mesh(domain):
    other = TwoBeams(along=(4, 4), across=1).create()
    with pytest.raises(ValueError, match="another mesh"):
        problem_on(domain, pair(other))


@pytest.mark.parametrize("order, shape, words", [(3, (2,), "order 1 or 2"), (1, (3,), "3 components")])
def test_unsuitable_spaces(domain, order, shape, words):
    with pytest.raises(ValueError, match=words):
        problem_on(domain, pair(domain), order, shape)


def test_a_mesh_of_order_three():
    """No order of u is both allowed and as high."""
    comm = MPI.COMM_WORLD
    element = basix.ufl.element("Lagrange", "interval", 3, shape=(2,))
    line = np.array([[0.0, 0.0], [1.0, 0.0], [1 / 3, 0.0], [2 / 3, 0.0]])
    root = comm.rank == 0
    curve = mesh.create_mesh(comm, cells=np.arange(4)[None][: 1 * root], x=line[: 4 * root], e=ufl.Mesh(element))
    u = fem.Function(fem.functionspace(curve, ("Lagrange", 2, (2,))))
    with pytest.raises(ValueError, match="a mesh of order 3, and u has order 1 or 2; mesh with order 2 at most"):
        ContactProblem(ufl.inner(u, ufl.TestFunction(u.function_space)) * ufl.dx, u)


def test_a_mesh_of_the_wrong_dimension():
    """A curve in space is neither a body nor a membrane."""
    comm = MPI.COMM_WORLD
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]])
    cells = np.array([[0, 1], [1, 2], [2, 3]], dtype=np.int64)
    element = ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(3,)))
    root = comm.rank == 0
    wire = mesh.create_mesh(comm, cells=cells[: 3 * root], x=points[: 4 * root], e=element)
    u = fem.Function(fem.functionspace(wire, ("Lagrange", 1, (3,))))
    F = ufl.inner(u, ufl.TestFunction(u.function_space)) * ufl.dx
    with pytest.raises(ValueError, match="mesh of dimension 1 in space of dimension 3"):
        ContactProblem(F, u)


def test_a_line_is_no_body():
    line = mesh.create_unit_interval(MPI.COMM_WORLD, 4)
    for shape in ((), (1,)):
        u = fem.Function(fem.functionspace(line, ("Lagrange", 1, shape)))
        F = ufl.inner(u, ufl.TestFunction(u.function_space)) * ufl.dx
        for make in (lambda u=u: Body(u, materials.neo_hookean(1.0, 0.3)), lambda F=F, u=u: ContactProblem(F, u)):
            with pytest.raises(ValueError, match="intervals in space of dimension 1"):
                make()


def test_a_body_needs_a_vector_and_a_solid(domain):
    u = fem.Function(fem.functionspace(domain[0], ("Lagrange", 1)))
    with pytest.raises(ValueError, match=r"1 components .* take it from fem.functionspace\(mesh, \(.*, \(2,\)\)\)"):
        Body(u, materials.neo_hookean(1.0, 0.3))


def test_arguments_of_a_surface_in_another_order(domain):
    for said in [(domain[2], domain[0], 12), (domain[0], 12, domain[2])]:
        with pytest.raises(
            ValueError, match=r"takes a mesh, MeshTags and a tag in this order, not (MeshTags|Mesh), .*"
        ):
            Surface(*said)


@pytest.mark.parametrize("kind", [np.float32, np.complex64, np.complex128])
def test_constants_of_other_numbers_than_float64(domain, kind):
    """DOLFINx itself refuses whole ones."""
    built = domain[0]
    V = fem.functionspace(built, ("Lagrange", 1, (2,)))
    u, other, law = fem.Function(V), fem.Constant(built, kind(0.3)), materials.neo_hookean(1.0, 0.3)
    problem = ContactProblem(law.virtual_work(u), u)
    makes = {
        "external": lambda: Body(u, law, external=(ufl.as_vector([other, 0.0]), ufl.dx(built))),
        "F": lambda: ContactProblem(other * law.virtual_work(u), u),
        "E": lambda: materials.neo_hookean(other, 0.3),
        "nu": lambda: materials.neo_hookean(1.0, other),
        "density": lambda: Body(u, law, density=other),
        "friction": lambda: pair(domain, friction=other),
        "load": lambda: quasistatic.march(problem, other, to=1.0, increments=1),
    }
    for name, make in makes.items():
        with pytest.raises(ValueError, match=rf"{name}: a Constant of {np.dtype(kind)}; .*default_scalar_type"):
            make()


def test_an_inverted_start(domain):
    with pytest.raises(ValueError, match="det F ≤ 0"):
        problem_on(domain, pair(domain), start=lambda x: np.stack([-2 * x[0], 0 * x[1]]))


def test_files_that_are_not_there_or_not_meshes(shared_path):
    with pytest.raises(ValueError, match=r"path = None: the name of a .msh file"):
        read_msh(None)
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_msh(shared_path / "missing.msh")
    bad = shared_path / "bad.msh"
    if MPI.COMM_WORLD.rank == 0:
        bad.write_text("not a mesh")
    MPI.COMM_WORLD.Barrier()
    with pytest.raises(ValueError, match=r"gmsh cannot read it|no physical groups"):
        read_msh(bad)


def test_march_needs_somewhere_to_go():
    problem, P = beams()
    with pytest.raises(ValueError, match="increments = 0"):
        next(quasistatic.march(problem, P, to=1.0, increments=0))
    with pytest.raises(ValueError, match="to = 0"):
        next(quasistatic.march(problem, P, to=0.0, increments=1))


def test_moduli_out_of_range():
    with pytest.raises(ValueError, match=r"nu = 0\.6"):
        materials.saint_venant_kirchhoff(1.0, 0.6)


def test_a_step_that_cannot_converge_says_where_it_stopped_and_keeps_what_it_had():
    problem, P = beams()
    done = []
    solver = NewtonSolver(problem, max_iterations=1)
    with pytest.raises(quasistatic.StepFailure, match=r"the steps up to load 0 are converged"):
        for step in quasistatic.march(problem, P, to=20.0, increments=2, solver=solver, smallest=0.1):
            done.append(step)
    assert not done
    assert np.abs(problem.u.x.array).max(initial=0.0) == 0.0
    assert float(P.value) == 0.0


class _GivesUpLater(NewtonSolver):
    """Fails beyond a load of 2 N."""

    def __init__(self, problem, load):
        super().__init__(problem)
        self.load = load

    def solve(self, path=None):
        result = super().solve(path)
        result.converged &= float(self.load.value) <= 2.0
        return result


def test_a_load_that_is_no_number():
    problem, P = beams()
    P.value = np.nan
    with pytest.raises(ValueError, match=r"a Constant in the form of u\[0\], such as a load, has the value \[nan\]"):
        NewtonSolver(problem).solve()


def test_a_finding_is_said_again_when_it_has_doubled():
    reporter, said = Reporter(0), []
    for value in (0.1, 0.19, 0.28, 0.1, 0.55, 0.6):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            reporter.report([Finding("slide", value, (), "", False)], "load 1")
        said += [value] * len(caught)
    assert said == [0.1, 0.28, 0.6]


def test_findings_that_mean_the_same_are_said_at_once():
    """Of many pairs the first three, as of an arch of ten stones."""
    findings = [Finding(f"joint {k}", 0.1 * k, (), "turned", False) for k in range(1, 6)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Reporter(0).report([*findings, Finding("slide", 0.1, (), "tied", False)], "load 1")
    joints = "at load 1: joint 1 = 0.1; joint 2 = 0.2; joint 3 = 0.3; 2 more: turned"
    assert [str(w.message) for w in caught] == [joints, "at load 1: slide = 0.1: tied"]


@pytest.mark.one_rank
def test_a_warning_points_at_the_users_line():
    """However many calls of the package are between."""
    problem, P = beams(order=1, mesh={"gap": 0.05})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        next(quasistatic.march(problem, P, to=1e-3, increments=1))
        next(quasistatic.march(problem, fem.Constant(problem.u.function_space.mesh, 0.0), to=1.0, increments=1))
        quasistatic.march(problem, P, to=1.0, increments=1)
    assert [w.filename for w in caught] == [__file__] * 4
    said = ["least gap", "setting it changes neither", "least gap", "none of its steps"]
    assert all(words in str(w.message) for words, w in zip(said, caught, strict=True))


def test_what_had_converged_stays_on_disk(shared_path):
    problem, P = beams()
    history = output.History(problem, shared_path, ["load", "tip"])
    with pytest.raises(quasistatic.StepFailure, match=r"the steps up to load 2 are converged"):
        for step in quasistatic.march(problem, P, to=4.0, increments=4, solver=_GivesUpLater(problem, P), smallest=0.2):
            history.add(load=step.load, tip=tip(problem)[1])
    MPI.COMM_WORLD.Barrier()
    on_disk = np.genfromtxt(shared_path / "history.csv", delimiter=",", names=True)
    assert on_disk["load"].tolist() == [1.0, 2.0]
    assert on_disk["tip"].tolist() == history.column("tip").tolist()
    assert tip(problem)[1] == on_disk["tip"][-1]  # and the problem is back in the state it had then


def gmsh_file(path, build):
    """Two unit squares, as `build` groups and meshes them, written to a file by rank 0."""
    if MPI.COMM_WORLD.rank == 0:
        import gmsh

        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Verbosity", 1)
        a, b = gmsh.model.occ.addRectangle(0, 0, 0, 1, 1), gmsh.model.occ.addRectangle(2, 0, 0, 1, 1)
        gmsh.model.occ.synchronize()
        build(gmsh, a, b, gmsh.model.addPhysicalGroup)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(3)
        gmsh.option.setNumber("Mesh.SaveAll", path.stem == "only_facets")
        if path.stem == "partitioned":
            gmsh.model.mesh.partition(2)
        gmsh.write(str(path))
        gmsh.finalize()
        if path.stem == "truncated":
            path.write_text(path.read_text()[: path.stat().st_size // 2])
    MPI.COMM_WORLD.Barrier()
    return path


MSH = {
    "mixed": (lambda g, a, b, group: (group(2, [a, b], 1), g.model.mesh.setRecombine(2, b)), "cells of several types"),
    "no_body": (lambda g, a, b, group: (group(2, [a], 1), group(1, [1, 5], 11)), "facets of no cell"),
    "cell_twice": (
        lambda g, a, b, group: (group(2, [a], 1), group(2, [a, b], 2)),
        r"several physical groups.*\[1, 2\]",
    ),
    "facet_twice": (
        lambda g, a, b, group: (group(2, [a, b], 1), group(1, [1], 11), group(1, [1, 2], 12)),
        "facets in sev",
    ),
    "only_facets": (lambda g, a, b, group: group(1, [1], 11), "but not of cells"),
    "partitioned": (lambda g, a, b, group: group(2, [a, b], 1), "partitioned; save it as one piece"),
    "truncated": (lambda g, a, b, group: group(2, [a, b], 1), "gmsh cannot read it"),
    "incomplete": (lambda g, a, b, group: _of_order_2(g, group, a, b), "type Quadrilateral 8.*SecondOrderIncomplete"),
    "prisms": (lambda g, a, b, group: _solid(g, group, a, volume=True), "type Prism 6: mesh with tetrahedra"),
    "no_volume": (lambda g, a, b, group: _solid(g, group, a, volume=False), "put the volumes of bodies into physical"),
}


def _of_order_2(gmsh, group, *squares):
    """Quadrilaterals without a node in their middle."""
    group(2, squares, 1)
    for square in squares:
        gmsh.model.mesh.setRecombine(2, square)
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 1)
    gmsh.option.setNumber("Mesh.ElementOrder", 2)


def _solid(gmsh, group, square, volume):
    """A cube of prisms over a square, in a group or but for a group of its faces."""
    cube = gmsh.model.occ.extrude([(2, square)], 0, 0, 1, numElements=[2], recombine=True)
    gmsh.model.occ.synchronize()
    if volume:
        group(3, [cube[1][1]], 1)
    group(2, [number for dim, number in cube if dim == 2], 2)


@pytest.mark.parametrize("kind", MSH)
def test_mesh_files_that_dolfinx_would_not_survive(shared_path, kind):
    build, message = MSH[kind]
    path = gmsh_file(shared_path / f"{kind}.msh", build)
    with pytest.raises(ValueError, match=message):
        read_msh(path)


def test_a_thickness_in_space():
    """A body in space has that of its mesh: forces would be scaled without a word."""
    built, _, tags = TwoBeams(along=(2, 2), across=1, through=1, dim=3).create()
    u = fem.Function(fem.functionspace(built, ("Lagrange", 1, (3,))))
    law = materials.neo_hookean(1.0, 0.3)
    sides = [Surface(built, tags, tag) for tag in (UPPER_BOTTOM, LOWER_TOP)]
    for make in (
        lambda: Body(u, law, thickness=0.02),
        lambda: Body(u, [(law, ufl.dx(built))], thickness=fem.Constant(built, 0.02)),
        lambda: ContactProblem(Body(u, law), contacts=[Contact(*sides, thickness=0.02)]),
    ):
        with pytest.raises(ValueError, match=r"thickness = 0\.02: out of the plane, and this body is in space"):
            make()


@pytest.mark.one_rank
@pytest.mark.parametrize("drawn", [True, False])
def test_reading_a_file_leaves_the_callers_models(tmp_path, drawn):
    """Those with something in them, and an empty one."""
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("other")
        gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [1], 1)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(tmp_path / "square.msh"))
        gmsh.model.add("mine")
        if drawn:
            gmsh.model.occ.addRectangle(0, 0, 0, 2, 1)
            gmsh.model.occ.synchronize()
        before = gmsh.model.list()
        read_msh(tmp_path / "square.msh", MPI.COMM_SELF)
        assert gmsh.model.list() == before and gmsh.model.getCurrent() == "mine"
        assert gmsh.model.getEntities(2) == [(2, 1)] * drawn
    finally:
        gmsh.finalize()


def test_pairs_that_are_there_twice(domain):
    a = pair(domain)
    with pytest.raises(ValueError, match="is there twice"):
        problem_with(domain, [a, pair(domain)])
    with pytest.raises(ValueError, match="in both directions"):
        problem_with(domain, [a, pair(domain, LOWER_TOP, UPPER_BOTTOM)])
    with pytest.raises(ValueError, match="name = 'x' of several contacts"):
        problem_with(domain, [pair(domain, name="x"), pair(domain, name="x")])


def problem_with(domain, contacts, u=None):
    V = fem.functionspace(domain[0], ("Lagrange", 1, (2,)))
    u = fem.Function(V)
    return ContactProblem(materials.neo_hookean(1e6, 0.3).virtual_work(u), u, contacts=contacts)


def test_tags_of_another_mesh(domain):
    other = TwoBeams(along=(4, 5), across=1).create()
    contact = Contact(Surface(domain[0], other[2], UPPER_BOTTOM), Surface(domain[0], domain[2], LOWER_TOP))
    with pytest.raises(ValueError, match="tags of tag 13 are of another mesh"):
        problem_with(domain, [contact])


def test_a_body_wholly_behind_its_target(domain):
    """The upper beam lies behind a plane through its top that faces upwards."""
    contact = Contact(Surface(domain[0], domain[2], UPPER_BOTTOM), obstacles.RigidPlane([0, 0.05], [0, 1]))
    with pytest.raises(ValueError, match=r"faces away|whole body behind"):
        problem_with(domain, [contact])


def test_a_body_in_a_sphere_that_is_no_hollow(domain):
    """It has no other side to pass: the hollow is meant."""
    contact = Contact(Surface(domain[0], domain[2], UPPER_BOTTOM), obstacles.RigidSphere([0.5, 2.0], 3.0))
    with pytest.raises(ValueError, match="inside=True"):
        problem_with(domain, [contact])


def test_laws_and_forms_of_the_wrong_kind(domain):
    V = fem.functionspace(domain[0], ("Lagrange", 1, (2,)))
    u, other = fem.Function(V), fem.Function(V)
    with pytest.raises(ValueError, match="is for a membrane"):
        membrane.neo_hookean_membrane(1e6, 0.3, 1e-3).virtual_work(u)
    with pytest.raises(ValueError, match="F does not depend on u"):
        ContactProblem(materials.neo_hookean(1e6, 0.3).virtual_work(other), u)
    with pytest.raises(ValueError, match="F: int is not a UFL form"):
        ContactProblem(0, u)
    dx = ufl.Measure("dx", domain[0], subdomain_data=domain[1])
    law = materials.neo_hookean(1e6, 0.3)
    with pytest.raises(ValueError, match="different subdomain_data"):
        ContactProblem(law.virtual_work(u) + law.virtual_work(u, dx=dx(1)), u)
    with pytest.raises(ValueError, match="a form has its own"):
        Body(u, law, external=[(ufl.inner(ufl.as_vector([0.0, 1.0]), ufl.TestFunction(V)) * ufl.ds, ufl.ds)])


def test_loads_that_are_no_parameter():
    problem, _ = beams(order=1)
    domain = problem.u.function_space.mesh
    for load, words in [
        (problem.u, "load: Function"),
        (fem.Constant(domain, (0.0, 1.0)), "shape"),
        (lambda: 1, "one argument"),
    ]:
        with pytest.raises(ValueError, match=words):
            quasistatic.march(problem, load, to=1.0, increments=1)
    warned = (
        pytest.warns(monitors.ModelWarning, match="setting it changes neither") if problem.comm.rank == 0 else nothing()
    )
    with warned:
        list(quasistatic.march(problem, fem.Constant(domain, 0.0), to=1.0, increments=1))


def test_friction_may_be_a_constant_that_changes():
    """What a number gives at first, and no friction as soon as the Constant is 0."""
    mu = fem.Constant(beams(order=1)[0].u.function_space.mesh, 0.4)
    changing, P = beams(order=1, friction=mu)
    fixed, Q = beams(order=1, friction=0.4)
    list(quasistatic.march(changing, P, to=2.0, increments=2))
    list(quasistatic.march(fixed, Q, to=2.0, increments=2))
    assert np.allclose(tip(changing), tip(fixed), rtol=1e-9)
    mu.value = 0.0
    list(quasistatic.march(changing, P, to=4.0, increments=2))
    pair = changing.pairs[0]
    assert abs(pair.force() @ [1.0, 0.0]) < 0.2 * abs(pair.force()[1])  # what is left of it is the tilt of the normals
    assert pair.stick_fraction() == 0.0


def test_values_that_differ_between_ranks():
    problem, P = beams(order=1)
    several = MPI.COMM_WORLD.size > 1
    with pytest.raises(ValueError, match=r"on rank 0, .* on rank 1") if several else nothing():
        list(quasistatic.march(problem, P, to=1.0 + problem.comm.rank, increments=1))
    with pytest.raises(ValueError, match=r"until\(\): ") if several else nothing():
        list(quasistatic.march(problem, P, to=3.0, increments=1, until=lambda: problem.comm.rank == 1))


def pulled_square(value=(0.0, 0.0), start=None, load=0.0):
    """A square on a plane, held below, with values prescribed on top and a force: (march of 2 increments, what a user may
    change by name)."""
    comm = MPI.COMM_WORLD
    domain = mesh.create_unit_square(comm, 2, 2)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, P, field = fem.Function(V, name="displacement"), fem.Constant(domain, load), fem.Function(V, name="weight")
    u.x.array[:] = 0.0 if start is None else start
    pull, μ = fem.Function(V, name="pull"), fem.Constant(domain, 0.3)
    top = fem.Constant(domain, value)
    at = [fem.locate_dofs_geometrical(V, where) for where in (on_the_left, on_top)]
    bcs = [fem.dirichletbc(pull, at[0]), fem.dirichletbc(top, at[1], V)]
    loads = [(ufl.as_vector([P, 0.0]), ufl.dx(domain)), (field, ufl.dx(domain))]
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    tags = mesh.meshtags(domain, 1, np.sort(bottom), np.full(len(bottom), 7, dtype=np.int32))
    floor = obstacles.RigidPlane([0.0, -0.1], [0.0, 1.0])
    body = Body(u, materials.neo_hookean(1.0, 0.3), external=loads, bcs=bcs)
    problem = ContactProblem(body, contacts=[Contact(Surface(domain, tags, 7), floor, friction=μ, name="sole")])
    given = {
        "problem": problem,
        "u": u,
        "P": P,
        "weight": field,
        "pull": pull,
        "top": top,
        "friction": μ,
        "floor": floor,
    }
    return quasistatic.march(problem, P, to=0.02, increments=2), given


def on_the_left(x):
    return np.isclose(x[0], 0.0)


def on_top(x):
    return np.isclose(x[1], 1.0)


@pytest.mark.several_ranks
@pytest.mark.parametrize(
    "name, words",
    [
        ("P", "load: its present value"),
        ("top", r"the Dirichlet condition 1 of u\[0\]"),
        ("friction", "friction of sole"),
        ("floor", "the pose of sole's obstacle"),
    ],
)
def test_what_is_changed_between_steps_on_one_rank_alone(name, words):
    rank = MPI.COMM_WORLD.rank
    march, given = pulled_square()
    next(march)
    if name == "floor":
        given[name].move([0.0, -0.01 * rank])
    else:
        given[name].value = given[name].value + 0.01 * rank
    with pytest.raises(ValueError, match=rf"{words}.*on rank 0, .* on rank 1; must be the same on all ranks"):
        next(quasistatic.march(given["problem"], given["P"], to=1.0, increments=1))


@pytest.mark.parametrize("wrong", [np.nan, -np.inf])
@pytest.mark.parametrize(
    "name, words",
    [
        ("u", r"u\[0\] \(Function 'displacement'\): component . has the value VALUE at X = \(.*\)"),
        (
            "pull",
            r"the Dirichlet condition 0 of u\[0\] \(Function 'pull'\): component . has the value VALUE at X = \(.*\)",
        ),
        ("top", r"the Dirichlet condition 1 of u\[0\] has the value \[ *0. VALUE\]"),
        ("weight", r"Function 'weight' in the form of u\[0\]: 18 of its values are no finite numbers"),
        ("friction", "friction of sole has the value .VALUE."),
    ],
)
def test_what_is_changed_between_steps_to_no_number(name, words, wrong):
    march, given = pulled_square()
    next(march)
    if name == "top":
        given[name].value[1] = wrong
    elif name == "friction":
        given[name].value = wrong
    else:
        given[name].x.array[:] = wrong
    with pytest.raises(ValueError, match=words.replace("VALUE", str(wrong))), warnings.catch_warnings():
        warnings.simplefilter("error")
        next(quasistatic.march(given["problem"], given["P"], to=1.0, increments=1))


def test_a_refused_end_leaves_the_load_as_it_was():
    march, given = pulled_square()
    march.close()
    problem, pull = given["problem"], given["pull"]
    there = fem.Function(pull.function_space, name="there")
    there.x.array[-1] = np.inf
    for to, words in [
        (lambda x: np.where(x[:2] > 0.6, np.nan, 0.1), "to = .*lambda"),
        (there, "to = Function 'there'"),
    ]:
        with pytest.raises(ValueError, match=rf"{words}.*: some of its values are not finite"):
            quasistatic.march(problem, pull, to=to, increments=1)
        assert np.all(pull.x.array == 0.0)
    assert len(list(quasistatic.march(problem, pull, to=lambda x: 0.01 + 0.0 * x[:2], increments=1))) == 1


def test_a_path_as_the_start_of_several_components():
    """That of stages is a path, of a single load its value."""
    march, given = pulled_square()
    march.close()
    problem, top = given["problem"], given["top"]
    for load, to in ((top, (0.0, 0.01)), (given["pull"], lambda x: 0.01 + 0.0 * x[:2])):
        with pytest.raises(ValueError, match=r"start = 0\.0: the load has several .* pass the load as Stage\(load, to"):
            quasistatic.march(problem, load, to=to, increments=1, start=0.0)
    steps = list(quasistatic.march(problem, quasistatic.Stage(top, (0.0, 0.01), 2), start=0.0))
    assert [step.path for step in steps] == [0.5, 1.0]


def test_a_mesh_that_is_moved_after_the_problem_was_made():
    march, given = pulled_square()
    next(march)
    given["u"].function_space.mesh.geometry.x[:] *= 1e-3
    with pytest.raises(ValueError, match=r"mesh of u\[0\] has been changed since"):
        next(march)


@pytest.mark.parametrize(
    "options, words", [({"start": np.nan}, r"u\[0\] "), ({"value": (0.0, np.inf)}, "condition 1 of")]
)
def test_a_start_that_is_no_number(options, words):
    with pytest.raises(ValueError, match=rf"{words}.*(nan|inf)"):
        pulled_square(**options)


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_a_history_resumed(shared_path, up):
    problem, _ = beams(order=1)
    history = output.History(problem, str(shared_path), ["load", "x"])
    for k in (1, 2, 3, 4):
        history.add(load=up * k, x=0.0)
    assert output.History(problem, shared_path, ["load", "x"], resume=up * 2).column("load").tolist() == [up, 2 * up]
    with pytest.raises(ValueError, match="has the columns"):
        output.History(problem, shared_path, ["load", "y"], resume=1.0)
    with pytest.raises(ValueError, match="x = None: a row has one number"):
        history.add(load=1.0, x=None)


def test_a_folder_that_cannot_be_made(shared_path):
    """A file in its place, or above it: the argument and the way out are named, whoever writes."""
    problem, _ = beams(order=1)
    if problem.comm.rank == 0:
        (shared_path / "file").write_text("not a folder")
    problem.comm.Barrier()
    for folder in (shared_path / "file", shared_path / "file" / "results"):
        for make in (lambda f: output.History(problem, f, ["load"]), lambda f: Checkpoint(f, problem)):
            with pytest.raises(OSError, match=r"directory = .*file.*pass one to write in"):
                make(folder)


@pytest.mark.one_rank
def test_an_exception_on_one_rank_ends_the_job():
    """The other rank waits in a collective call; the traceback is printed once, within seconds."""
    script = "import dolfinx_mortar_al\nfrom mpi4py import MPI\nc = MPI.COMM_WORLD\n1 / c.rank\nc.Barrier()"
    run = subprocess.run(
        ["mpirun", "-n", "2", sys.executable, "-c", script], capture_output=True, text=True, timeout=60
    )
    assert run.returncode != 0
    assert run.stderr.count("ZeroDivisionError: division by zero") == 1
    assert "rank 0 of 2 failed while others went on" in run.stderr


@pytest.mark.one_rank
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_script_ends_with_the_message_and_a_non_zero_status(ranks):
    root = Path(__file__).parents[1]
    command = [sys.executable, str(root / "demos" / "two_beams.py"), "--friction", "-1", "--output", "/tmp/never"]
    launched = ["mpirun", "-n", str(ranks), *command] if ranks > 1 else command
    run = subprocess.run(launched, capture_output=True, text=True, timeout=120)
    assert run.returncode != 0
    assert "friction = -1.0: Coulomb's coefficient must be a number" in run.stderr


def test_petsc_options_come_from_the_command_line(monkeypatch):
    problem, P = beams()
    P.value = 0.1
    monkeypatch.setattr(sys, "argv", ["script", "--load", "2", "-mine_snes_max_it", "17", "-mine_snes_stol", "-1"])
    solver = NewtonSolver(problem, prefix="mine_")
    assert solver.snes.getTolerances()[3] == 17
    assert solver.solve().converged
    monkeypatch.setattr(sys, "argv", ["script"])
    P.value = 0.2
    solver = NewtonSolver(problem, prefix="other_")
    assert solver.snes.getTolerances()[3] == 80
    assert solver.solve().converged


def test_a_small_step_is_no_convergence(monkeypatch):
    """A line search that fails, of PETSc's options: SNES takes a step below its `stol` for convergence, 1e9 times off."""
    problem, P = beams()
    P.value = 1.0
    options = ["-short_snes_linesearch_type", "bt", "-short_snes_linesearch_minlambda", ".9", "-short_snes_stol", "1e9"]
    monkeypatch.setattr(sys, "argv", ["script", *options])
    solver = NewtonSolver(problem, prefix="short_")
    result = solver.solve()
    assert solver.snes.getConvergedReason() == PETSc.SNES.ConvergedReason.CONVERGED_SNORM_RELATIVE
    assert not result.converged and result.residual > 1e6 * solver.rtol


def test_what_is_worst_is_not_what_is_prescribed(monkeypatch):
    """Very soft beams whose clamp has a millimetre to go: its rows are no forces, and larger than those beside it."""
    problem, _ = beams(young=1e-6)
    problem.bodies.bodies[0].bcs[0].g.value[:] = 1e-3
    monkeypatch.setattr(sys, "argv", ["script", "-worst_snes_max_it", "0"])
    message = NewtonSolver(problem, prefix="worst_").solve().message
    assert float(re.search(r"worst at X = \(([^,]+),", message)[1]) > 0.04


def squares():
    """Two squares with a space each: (u, surfaces of their bottoms and tops by tag 1 and 2)."""
    made = []
    for y in (0.0, 1.1):
        square = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, y), (1.0, y + 1.0)], (3, 3))
        ends = [mesh.locate_entities_boundary(square, 1, lambda x, h=h: np.isclose(x[1], h)) for h in (y, y + 1.0)]
        facets = np.concatenate(ends).astype(np.int32)
        order, values = np.argsort(facets), np.repeat(np.array([1, 2], dtype=np.int32), [len(f) for f in ends])
        tags = mesh.meshtags(square, 1, facets[order], values[order])
        u = fem.Function(fem.functionspace(square, ("Lagrange", 1, (2,))))
        made.append((u, [Surface(square, tags, tag) for tag in (1, 2)]))
    return made


@pytest.mark.several_ranks
@pytest.mark.parametrize(
    "what",
    [
        "bcs",
        "bcs of a Body",
        "bodies",
        "contacts",
        "material",
        "external",
        "tag",
        "obstacle",
        "quadrature",
        "rtol",
        "calls",
    ],
)
def test_what_one_rank_alone_makes_otherwise(what):
    """Conditions only where there are nodes of them, numbers drawn on each rank: refused before ranks wait for each other."""
    (lower, (_, top)), (upper, (bottom, other)) = squares()
    rank, law, here = MPI.COMM_WORLD.rank, materials.neo_hookean(1.0, 0.3), MPI.COMM_WORLD.rank == 0
    V = lower.function_space
    clamp = fem.dirichletbc(np.zeros(2), fem.locate_dofs_geometrical(V, on_the_left), V)
    bodies, pair = [Body(lower, law), Body(upper, law)], Contact(bottom, top)
    makes = {
        "bcs": (lambda: ContactProblem(law.virtual_work(lower), lower, bcs=[clamp] if here else []), "bcs: how many"),
        "bcs of a Body": (lambda: Body(lower, law, bcs=[clamp] if here else []), "bcs: how many: 1 on rank 0, 0 on"),
        "bodies": (
            lambda: ContactProblem(bodies if here else bodies[::-1], contacts=[pair]),
            r"F: the bodies' order, .*: \[0, 1\] on rank 0, \[1, 0\] on rank 1",
        ),
        "contacts": (lambda: ContactProblem(bodies, contacts=[pair] if here else []), "contacts: how many"),
        "material": (
            lambda: ContactProblem(Body(lower, materials.neo_hookean(1.0 + rank, 0.3))),
            "not the same form on",
        ),
        "external": (
            lambda: ContactProblem(Body(lower, law, external=[((0.0, 1.0), ufl.dx)] if here else None)),
            "not the same form on all ranks",
        ),
        "tag": (
            lambda: ContactProblem(bodies, contacts=[Contact(bottom if here else other, top)]),
            "contactor of the contact 'contact': 1 on rank 0, 2 on rank 1",
        ),
        "obstacle": (
            lambda: ContactProblem(bodies, contacts=[Contact(bottom, obstacles.RigidSphere((0.5, -1.0), 0.5 + rank))]),
            "target of the contact 'contact': RigidSphere .*'radius': 0.5} on rank 0, .*'radius': 1.5} on rank 1",
        ),
        "quadrature": (
            lambda: ContactProblem(bodies, contacts=[Contact(bottom, top, quadrature_degree=4 + rank)]),
            "quadrature_degree of the contact 'contact': 4 on rank 0",
        ),
        "rtol": (lambda: NewtonSolver(ContactProblem(bodies), rtol=1e-9 * (1 + rank)), "rtol, max_iterations"),
        "calls": (
            lambda: Body(lower, law, bcs=[clamp]) if here else NewtonSolver(whole),
            "ranks are at different calls: 'bcs: how many' is looked at on rank 0, 'rtol, max_iterations of a NewtonSolver'",
        ),
    }
    whole = ContactProblem(bodies) if what == "calls" else None
    make, words = makes[what]
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.several_ranks
def test_a_march_that_is_another_on_one_rank():
    """Refused at the call, before ranks wait for each other."""
    here = MPI.COMM_WORLD.rank == 0
    problem, P = beams(order=1)
    moving = ContactProblem(dynamics.Motion(Body(problem.u, materials.neo_hookean(1.0, 0.3), density=1.0), step=1e-3))
    event, solver = (lambda: False) if here else None, NewtonSolver(problem)

    def march(load=P, to=1.0, increments=1, **options):
        return quasistatic.march(problem, load, to=to, increments=increments, **options)

    def follow(**options):
        return quasistatic.follow(problem, P, first=1.0, length=0.1, steps=1, **options)

    stages = [quasistatic.Stage(P, 1.0, 1, until=event), quasistatic.Stage(P, 2.0, 1)]
    smallest = 0.1 if here else 0.2
    for make, words in [
        (lambda: march(until=event), "until: whether it is passed: True on rank 0, False on rank 1"),
        (lambda: march(stages, None, None), "until: whether it is passed"),
        (lambda: follow(until=event), "until: whether it is passed"),
        (lambda: dynamics.march(moving, to=1.0, until=event), "until: whether it is passed"),
        (lambda: march(stages[1:] * (1 + here), None, None), "load: how many stages: 2 on rank 0, 1 on rank 1"),
        (lambda: march(solver=solver if here else None), "solver: whether it is passed"),
        (lambda: march(smallest=smallest), "smallest: 0.1 on rank 0"),
        (lambda: follow(smallest=smallest), "smallest: .* on rank 0"),
        (lambda: dynamics.march(moving, to=1.0, smallest=smallest), "smallest, Δt: .* on rank 0"),
        (
            lambda: dynamics.march(moving, to=1.0, ledger=dynamics.Ledger(0.0, 0.0) if here else None),
            "ledger: its energies: 0.0 on rank 0, None on rank 1",
        ),
    ]:
        with pytest.raises(ValueError, match=words):
            make()


def test_a_bar_that_rank_0_alone_asks_for(capfd):
    """As programs do who print on one rank: it shows contact, which is collective."""
    problem, P = beams(order=1)
    here = problem.comm.rank == 0
    list(quasistatic.march(problem, P, to=1.0, increments=1, progress=here))
    assert ("closed" in capfd.readouterr().err) == here


@pytest.mark.several_ranks
def test_a_reaction_of_another_support_on_one_rank():
    here, law = MPI.COMM_WORLD.rank == 0, materials.neo_hookean(1.0, 0.3)
    (lower, (base, top)), _ = squares()
    V = lower.function_space
    first, other, foreign = (
        fem.dirichletbc(np.zeros(2), fem.locate_dofs_geometrical(V, where), V)
        for where in (on_the_left, on_top, on_the_left)
    )
    problem = ContactProblem(Body(lower, law, bcs=[first, other]))
    for at, elsewhere in [(first, other), (base, top), (first, base), (first, foreign)]:
        with pytest.raises(ValueError, match=r"^at: '.*u\[0\]' on rank 0, .* on rank 1; must be the same"):
            reaction(problem, at if here else elsewhere)
    assert np.array_equal(reaction(problem, first).force, np.zeros(2))


@pytest.mark.several_ranks
@pytest.mark.parametrize("argument", ["directory", "columns", "paraview", "resume", "checkpoint"])
def test_a_run_that_is_another_on_one_rank(shared_path, argument):
    here = MPI.COMM_WORLD.rank == 0
    problem, _ = beams(order=1)
    columns = ["load", "newton_iterations", "wall_time"]
    alike = {"directory": shared_path, "columns": columns, "paraview": False, "resume": None, "checkpoint": False}
    other = {
        "directory": shared_path / "b",
        "columns": columns[::-1],
        "paraview": True,
        "resume": 1.0,
        "checkpoint": True,
    }
    with pytest.raises(ValueError, match=rf"{argument}: .* on rank 0, .* on rank 1; must be the same on all ranks"):
        output.Run(problem, parameters={}, **(alike if here else alike | {argument: other[argument]}))


def test_forms_over_another_mesh():
    (lower, _), (upper, _) = squares()
    law, w = materials.neo_hookean(1.0, 0.3), ufl.TestFunction(lower.function_space)
    own, foreign = (ufl.Measure("dx", u.function_space.mesh) for u in (lower, upper))
    for make, words in [
        (lambda: Body(lower, [(law, foreign)]), "material: an integral over another mesh"),
        (lambda: Body(lower, law, external=((0.0, 1.0), foreign)), "external: an integral over another mesh"),
        (lambda: Body(lower, law, external=ufl.inner(upper, w) * own), "external: .* is a Function on another mesh"),
        (lambda: ContactProblem(law.virtual_work(lower, dx=foreign), lower), "F: an integral over another mesh"),
    ]:
        with pytest.raises(ValueError, match=words):
            make()


def test_arguments_of_another_kind(shared_path):
    problem, P = beams(order=1)
    u, law = problem.u, materials.neo_hookean(1.0, 0.3)
    built = u.function_space.mesh
    two = fem.Constant(built, (1.0, 2.0))
    prescribed = fem.Function(u.function_space)
    body, pair = Body(u, law, density=1.0), problem.pairs[0]

    def march(load=P, to=1.0, **options):
        return quasistatic.march(problem, load, to=to, increments=1, **options)

    moving, damped = (ContactProblem(dynamics.Motion(body, step=1e-3, theta=θ)) for θ in (0.5, 1.0))
    for make, words in [
        (lambda: materials.neo_hookean(two, 0.3), r"E: a Constant of shape \(2,\); must be one number"),
        (lambda: materials.neo_hookean(1.0, 0.3 * two), r"nu: UFL of shape \(2,\); must be a scalar"),
        (lambda: Body(u, law, thickness=two), r"thickness: a Constant of shape \(2,\)"),
        (lambda: Body(u, law, density=[2 * two]), r"density: UFL of shape \(2,\)"),
        (lambda: march(until=lambda x: True), "pass a function without arguments"),
        (lambda: next(march(until=lambda: None)), r"until\(\) = None: must return True or False"),
        (lambda: march(prescribed, lambda x: x[1]), r"interpolate does not take it .* returns \(2, n\) values"),
        (lambda: dynamics.march(moving, to=1.0, ledger=0), "ledger: int is no Ledger"),
        (lambda: dynamics.march(damped, to=1.0, tolerance=1e-3), "tolerance = 0.001 with theta = 1"),
        (
            lambda: ContactProblem([law.virtual_work(u)], [u], jacobian=[None, None]),
            "jacobian: 2 forms for 1 displacements",
        ),
        (
            lambda: NewtonSolver(problem, prefix="-contact_"),
            "prefix = '-contact_': of PETSc's options without their dash",
        ),
        (lambda: NewtonSolver(body), r"problem: Body is no ContactProblem; pass ContactProblem\(body, contacts=…\)"),
        (lambda: quasistatic.march(body, P, to=1.0, increments=1), "problem: Body is no ContactProblem"),
        (lambda: dynamics.march(body, to=1.0), "problem: Body is no ContactProblem"),
        (lambda: Checkpoint(problem, shared_path), "directory: ContactProblem is no path"),
        (lambda: output.picture(problem, 5), "path: int is no path"),
        (lambda: output.History(problem, shared_path, "load"), "columns = 'load': pass a list of names"),
        (lambda: output.History(problem, shared_path, ["load", "load"]), "none of them twice"),
        (
            lambda: output.History(problem, shared_path, ["load"]).column("x"),
            r"name = 'x': no column .* known are \['load'\]",
        ),
        (lambda: output.Run(problem, shared_path, ["load"], {}), "newton_iterations and wall_time of each step"),
        (lambda: output.History(problem, shared_path, ["load"], resume="x"), "resume = 'x': must be a number"),
        (lambda: Checkpoint(shared_path, problem).save("x"), "at = 'x': must be a number"),
        (lambda: pair.moment((0.0, 0.0, 0.0)), "about = .*: needs 2 components"),
        (lambda: loads.pressure(u, 1.0, ufl.dx(built)), "is no measure of facets"),
        (lambda: ContactProblem(body, [pair.contact]), r"name what follows: contacts=\[…\]"),
        (lambda: ContactProblem(law.virtual_work(u), u, jacobian=law.virtual_work(u)), "jacobian: must be a bilinear"),
    ]:
        with pytest.raises(ValueError, match=words):
            make()


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_density_that_makes_no_mass(value):
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    u, ρ = (fem.Function(fem.functionspace(domain, kind)) for kind in (("Lagrange", 1, (2,)), ("DG", 0)))
    motion = dynamics.Motion(Body(u, materials.neo_hookean(1.0, 0.3), density=ρ), step=1e-3)
    ρ.x.array[:] = value
    with pytest.raises(
        ValueError, match=r"mass of motion 0 \(kg\) = .*: its density must make it a number > 0|Function"
    ):
        dynamics.march(ContactProblem(motion), to=1e-3)


@pytest.mark.parametrize("kind", [("DG", 0), ("Lagrange", 1)])
def test_a_density_that_is_negative_somewhere(kind):
    """Though the mass is positive; at the Body, and at the march where it was changed since. What it is outside its part does
    not count."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    u, ρ = (fem.Function(fem.functionspace(domain, k)) for k in (("Lagrange", 1, (2,)), kind))
    ρ.interpolate(lambda x: np.where(x[0] < 0.3, -2.5, 1e3))
    ρ.name = "ρ"
    law = materials.neo_hookean(1.0, 0.3)
    with pytest.raises(ValueError, match=r"density: Function 'ρ' has the value -2\.5; none may be negative"):
        Body(u, law, density=ρ)
    cells = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    left = mesh.compute_midpoints(domain, 2, cells)[:, 0] < 0.5
    dx = ufl.Measure("dx", domain, subdomain_data=mesh.meshtags(domain, 2, cells, left.astype(np.int32)))
    with pytest.raises(ValueError, match=r"density\[1\]: Function 'ρ' has the value -2\.5"):
        Body(u, [(law, dx(0)), (law, dx(1))], density=[1e3, ρ])
    Body(u, [(law, dx(0)), (law, dx(1))], density=[ρ, 1e3])
    ρ.x.array[:] = 1e3
    motion = dynamics.Motion(u, law, density=ρ, step=1e-3)
    ρ.x.array[:1] = -1.0
    with pytest.raises(ValueError, match="density: Function 'ρ' has the value -1"):
        dynamics.march(ContactProblem(motion), to=1e-3)


def test_a_march_whose_steps_nobody_asks_for():
    """It solves nothing, and says so; one that has been begun may be left at any step."""
    problem, P = beams(order=1)
    said = pytest.warns(monitors.ModelWarning, match="none of its steps was asked for")
    with said if problem.comm.rank == 0 else nothing():
        quasistatic.march(problem, P, to=1.0, increments=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        next(quasistatic.march(problem, P, to=1.0, increments=2))


@pytest.mark.one_rank
def test_a_program_that_ends_within_a_march():
    """It ends as it would without: the march does not outlive PETSc."""
    script = (
        "from scenes import beams\nfrom dolfinx_mortar_al import quasistatic\nproblem, P = beams(order=1)\n"
        "march = quasistatic.march(problem, P, to=1.0, increments=2, progress=True)\nnext(march)"
    )
    subprocess.run(
        [sys.executable, "-c", script], capture_output=True, timeout=60, cwd=Path(__file__).parent, check=True
    )


@pytest.mark.one_rank
@pytest.mark.parametrize("solve", [False, True])
def test_options_that_nothing_reads(solve):
    """A misspelt option is named; of options that the user has not set PETSc says nothing at its end."""
    script = f"from scenes import beams, NewtonSolver\ns = NewtonSolver(beams(order=1)[0])\nif {solve}: s.solve()"
    options = ["-contact_kps_rtol", "1e-5", "-contact_snes_rtol", "1e-9", "-contact_direct_pc_type", "lu"]
    command, here = [sys.executable, "-c", script], Path(__file__).parent
    for asked in ([], options):
        run = subprocess.run([*command, *asked], capture_output=True, text=True, timeout=60, cwd=here, check=True)
        assert ("no part of this solver reads: -contact_kps_rtol 1e-5; are they" in run.stderr) == bool(solve and asked)
        assert ("WARNING! There are options" in run.stderr + run.stdout) == bool(asked)
        assert "mumps" not in run.stderr + run.stdout


@pytest.mark.parametrize("where", ["material", "load", "plain", "condition"])
def test_a_tag_that_marks_nothing_is_refused(where):
    """A misspelt tag would leave a material, a load or a support out without a word."""
    domain = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    cells = mesh.meshtags(domain, 2, np.arange(1, dtype=np.int32), np.array([3], dtype=np.int32))
    dx = ufl.Measure("dx", domain, subdomain_data=cells)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    plain = materials.neo_hookean(1.0, 0.3)
    w = ufl.TestFunction(u.function_space)
    build = {
        "material": lambda: Body(u, plain.virtual_work(u, dx=dx(7))),
        "load": lambda: Body(u, plain, external=(ufl.as_vector([0.0, 1.0]), dx(7))),
        "plain": lambda: Body(u, plain, external=w[1] * ufl.ds(7)),
        "condition": lambda: Body(
            u, plain, bcs=[fem.dirichletbc(np.zeros(2), np.zeros(0, dtype=np.int32), u.function_space)]
        ),
    }
    with pytest.raises(ValueError, match="no node" if where == "condition" else "the tag 7, which marks nothing"):
        build[where]()


def test_two_sides_of_one_body_are_one_surface():
    """A strip's lower side against its upper one, as if it were to be wound: the strip lies behind its own upper side."""
    strip = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 0.1)], [10, 1])
    sides = [mesh.locate_entities_boundary(strip, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, 0.1)]
    facets = np.sort(np.concatenate(sides))
    tags = mesh.meshtags(strip, 1, facets, np.isin(facets, sides[1]).astype(np.int32))
    contact = Contact(Surface(strip, tags, 0), Surface(strip, tags, 1))
    u = fem.Function(fem.functionspace(strip, ("Lagrange", 1, (2,))))
    with pytest.raises(ValueError, match="named as one surface"):
        ContactProblem(Body(u, materials.neo_hookean(1e6, 0.3)), contacts=[contact])
