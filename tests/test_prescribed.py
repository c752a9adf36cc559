"""Nodes that supports push into what is held as well: a finding, or a failure, names them."""

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, NewtonSolver, Surface, materials, obstacles, quasistatic

GAP, WIDTH, HEIGHT = 0.02, 1.0, 0.5  # m: below the block, and its own
NODE = "contact: prescribed node's overlap (m)"


def body(low, high, cells, face, held, value):
    """A rectangle, its surface on y = `face`, prescribed where `held` says."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [low, high], cells, mesh.CellType.quadrilateral)
    facets = np.sort(mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], face)))
    tags = mesh.meshtags(domain, 1, facets, np.ones(len(facets), dtype=np.int32))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    given = fem.Constant(domain, value)
    bc = fem.dirichletbc(given, fem.locate_dofs_geometrical(V, held), V)
    return Body(fem.Function(V), materials.neo_hookean(1e5, 0.3), bcs=[bc]), Surface(domain, tags, 1), given


def left(x):
    return np.isclose(x[0], 0.0)


def top(x):
    return np.isclose(x[1], GAP + HEIGHT)


def block_on_slab(side, *, swap=False, friction=0.0, rigid=False):
    """A block moved by its `side` onto a slab whose top is held, or a rigid plane: the problem and what moves the side."""
    block, bottom, moved = body([0.0, GAP], [WIDTH, GAP + HEIGHT], [4, 4], GAP, side, (0.0, 0.0))
    if rigid:
        plane = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0])
        return ContactProblem(block, contacts=[Contact(bottom, plane, friction=friction)]), moved
    slab, face, _ = body([-0.5, -0.4], [1.5, 0.0], [11, 2], 0.0, lambda x: np.isclose(x[1], 0.0), (0.0, 0.0))
    sides = (face, bottom) if swap else (bottom, face)
    return ContactProblem([block, slab], contacts=[Contact(*sides, friction=friction)]), moved


@pytest.mark.filterwarnings("ignore::dolfinx_mortar_al.monitors.ModelWarning")
@pytest.mark.parametrize(
    "options", [{}, {"swap": True}, {"friction": 0.3}, {"rigid": True}], ids=["block", "slab", "friction", "rigid"]
)
def test_a_corner_that_a_clamped_side_pushes_in_is_named(options):
    """The block's corner, of the surface and of the side that is moved down by 5 cm through a gap of 2: 3 cm deep in what
    does not move. All that was said of it was to refine the contactor."""
    problem, moved = block_on_slab(left, **options)
    first, last = quasistatic.march(problem, moved, to=(0.0, -0.05), increments=2)
    for step, depth in ((first, 0.005), (last, 0.03)):
        (found,) = [f for f in step.findings if f.name == NODE]
        assert found.value == pytest.approx(depth, rel=1e-9)
        assert np.allclose(found.X, (0.0, GAP), atol=1e-12)
        assert "change the prescribed values" in found.meaning and not found.fatal


@pytest.mark.filterwarnings("ignore::dolfinx_mortar_al.monitors.ModelWarning")
@pytest.mark.parametrize("options", [{}, {"swap": True}, {"rigid": True}], ids=["block", "slab", "rigid"])
def test_a_block_that_its_top_presses_on_has_no_such_node(options):
    """Contact parts the surfaces; and no node of the slab, all of which are held, lies in the block."""
    problem, moved = block_on_slab(top, **options)
    for step in quasistatic.march(problem, moved, to=(0.0, -0.05), increments=2):
        assert not [f for f in step.findings if f.name == NODE]
    assert np.abs(problem.pairs[0].force()[1]) > 1e3


def test_a_failure_names_the_node():
    """28 cm deep, and no more than two iterations to find an equilibrium."""
    problem, moved = block_on_slab(left, swap=True)
    solver = NewtonSolver(problem, max_iterations=2)
    with pytest.raises(
        quasistatic.StepFailure, match=r"node's overlap \(m\) = 0.28 at X = \(.*, 0.02\): supports push"
    ):
        list(quasistatic.march(problem, moved, to=(0.0, -0.3), increments=1, smallest=1.0, solver=solver))


@pytest.mark.filterwarnings("ignore::dolfinx_mortar_al.monitors.ModelWarning")
def test_a_fatal_finding_does_not_hide_the_node(monkeypatch):
    """Of a trial that another finding ends the message has both."""
    problem, moved = block_on_slab(left)
    findings = problem.findings

    def with_fatal():
        return [f.__class__("volume", 0.0, (), "made up", True) if f.name != NODE else f for f in findings()]

    monkeypatch.setattr(problem, "findings", with_fatal)
    with pytest.raises(quasistatic.StepFailure, match=r"made up.*node's overlap \(m\) = 0.03"):
        list(quasistatic.march(problem, moved, to=(0.0, -0.05), increments=1, smallest=1.0))
