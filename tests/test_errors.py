"""Bad input: one clear message, the same on every rank, never a hang."""

import subprocess
import sys
from pathlib import Path

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import beams, tip

from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, materials, output, quasistatic, read_msh
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


@pytest.mark.parametrize("name", ["epsilon_normal", "epsilon_tangential", "thickness"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_parameters_must_be_positive(domain, name, value):
    with pytest.raises(ValueError, match=f"{name} = "):
        pair(domain, **{name: value})


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


def test_a_surface_of_another_mesh(domain):
    other = TwoBeams(along=(4, 4), across=1).create()
    with pytest.raises(ValueError, match="another mesh"):
        problem_on(domain, pair(other))


@pytest.mark.parametrize("order, shape, words", [(3, (2,), "order 1 or 2"), (1, (3,), "3 components")])
def test_unsuitable_spaces(domain, order, shape, words):
    with pytest.raises(ValueError, match=words):
        problem_on(domain, pair(domain), order, shape)


def test_a_mesh_of_the_wrong_dimension():
    """A curve in space is neither a body nor a membrane."""
    comm = MPI.COMM_WORLD
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]])
    cells = np.array([[0, 1], [1, 2], [2, 3]], dtype=np.int64)
    element = ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(3,)))
    root = comm.rank == 0
    wire = mesh.create_mesh(comm, cells[: 3 * root], points[: 4 * root], element)
    u = fem.Function(fem.functionspace(wire, ("Lagrange", 1, (3,))))
    F = ufl.inner(u, ufl.TestFunction(u.function_space)) * ufl.dx
    with pytest.raises(ValueError, match="mesh of dimension 1 in space of dimension 3"):
        ContactProblem(F, u)


def test_an_inverted_start(domain):
    with pytest.raises(ValueError, match="det F ≤ 0"):
        problem_on(domain, pair(domain), start=lambda x: np.stack([-2 * x[0], 0 * x[1]]))


def test_files_that_are_not_there_or_not_meshes(shared_path):
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


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
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
