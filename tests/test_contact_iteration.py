"""Contact settles on the linearised bulk: the same answers in fewer Newton iterations, however fine the mesh."""

import ironing
import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import beams, tip

from dolfinx_mortar_al import Body, ContactProblem, NewtonSolver, contact_iteration, materials, quasistatic
from dolfinx_mortar_al.contact_iteration import ContactIteration


def bent(friction):
    """Deflection of the tip (m) and Newton iterations of two beams, 3 steps from the unloaded state to 3 N."""
    problem, P = beams(friction=friction, mesh={"along": (40, 40), "across": 4})
    steps = list(quasistatic.march(problem, P, to=3.0, increments=3))
    return tip(problem), sum(step.iterations for step in steps)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_the_equilibrium_is_that_of_plain_newton_steps(friction, monkeypatch):
    """To Newton's tolerance, 1e-9 of the forces; seen with friction: 25 iterations, plain steps 41."""
    improved, iterations = bent(friction)
    monkeypatch.setattr(ContactIteration, "improve", lambda *_: None)
    plain, more = bent(friction)
    assert np.allclose(improved, plain, rtol=1e-7)
    assert iterations < more


def test_old_factors_bring_the_bulk_into_balance_where_contact_stays(monkeypatch):
    """A bent pair of beams whose points keep their state: steps with the factors at hand take the place of iterations (seen:
    2 for 3), and what is assembled at an improved state is not assembled again."""
    assembled, taken = 0, []
    assemble = ContactProblem.assemble_bulk

    def counted(problem):
        nonlocal assembled
        assembled += 1
        assemble(problem)

    monkeypatch.setattr(ContactProblem, "assemble_bulk", counted)
    for chord in 0.0, contact_iteration.CHORD:
        monkeypatch.setattr(contact_iteration, "CHORD", chord)
        problem, P = beams(friction=0.3)
        list(quasistatic.march(problem, P, to=10.0, increments=4))
        before, P.value, assembled = problem.pairs[0].state.status.copy(), 10.02, 0
        result = NewtonSolver(problem).solve()
        assert result.converged
        assert np.array_equal(before, problem.pairs[0].state.status)
        taken.append(result.iterations)
        if not chord:
            assert assembled == result.iterations + 1
    assert taken[1] < taken[0]


@pytest.mark.one_rank
def test_a_step_that_is_undone_leaves_nothing_behind_although_segments_have_moved(monkeypatch):
    """Decisions belong to points, and segments bring others: here every improved step is taken back. The forces agree to how
    closely segments follow, 3e-5 of a facet (seen: 7e-6)."""
    answers = []
    for undone in False, True:
        if undone:
            monkeypatch.setattr(ContactProblem, "longest_motion", lambda *_: np.inf)
        scene = ironing.Scene(order=1, friction=0.0, steps=(2, 0))
        problem, top = ironing.build(scene, {"integration": "segments"})
        assert sum(step.rejected for _, step in ironing.iron(scene, problem, top)) == 0
        answers.append(problem.pairs[0].force())
    assert np.allclose(*answers, rtol=0, atol=3e-5 * np.abs(answers).max())


@pytest.mark.one_rank
@pytest.mark.parametrize("cells", [4, 7, 9])
def test_iterations_do_not_grow_with_the_mesh(cells):
    """A punch pressed into a slab in space in three steps: with twice as many facets to go Newton takes one iteration for
    each, too (5, 5 and 8 with 4, 7 and 10 cells while a correction with an old derivative was a single semi-smooth step)."""
    scene = ironing.Scene(dim=3, cells=cells, order=1, steps=(3, 0))
    steps = [step for _, step in ironing.iron(scene, *ironing.build(scene, {}))]
    assert sum(step.iterations for step in steps) <= 4
    assert sum(step.rejected for step in steps) == 0


@pytest.mark.one_rank
def test_a_first_step_over_many_facets_goes_through():
    """The punch moves on by 13 facets, half of the zone's width, with nothing to predict it from: the guard shortens Newton's
    steps, and contact settles on the share that is left (seen: 11 iterations; without that 23 and a rejected trial)."""
    scene = ironing.Scene(cells=24, friction=0.0, steps=(2, 5))
    for doing, step in ironing.iron(scene, *ironing.build(scene, {})):
        assert step.rejected == 0
        if doing == "dragging":
            assert step.iterations <= 15
            break


def test_an_old_derivative_that_makes_it_worse_is_not_used():
    """A nearly incompressible block, glued at top and bottom, crushed by .35 in ten steps: corrections that grow are undone
    (seen: 40 iterations with one rejected trial before, now 23 with none)."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [[-1, 0], [1, 1]], [8, 4], mesh.CellType.triangle)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    head = fem.Constant(domain, np.zeros(2))
    sides = [mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, 1.0)]
    held = (fem.Constant(domain, np.zeros(2)), head)
    bcs = [fem.dirichletbc(v, fem.locate_dofs_topological(V, 1, side), V) for v, side in zip(held, sides, strict=True)]
    problem = ContactProblem(Body(fem.Function(V), materials.neo_hookean(2.5, 0.495), bcs=bcs), contacts=[])
    steps = list(quasistatic.march(problem, head, to=(0.0, -0.35), increments=10))
    assert [step.rejected for step in steps] == [0] * 10
    assert sum(step.iterations for step in steps) <= 30


@pytest.mark.one_rank
def test_segments_follow_within_an_iteration():
    """Pressed and dragged in space with segments, which move with the bodies: no more iterations than with points that stay
    (12 and 12; 18 where they moved after each iteration, whose residual was another then)."""
    scene, counts = ironing.Scene(dim=3, cells=4, order=1, steps=(3, 3)), {}
    for integration in ("gauss", "segments"):
        problem, top = ironing.build(scene, {"integration": integration})
        counts[integration] = [step.iterations for _, step in ironing.iron(scene, problem, top)]
        assert np.allclose(problem.pairs[0].force(), [-3.71, -1.20, 12.4], rtol=0.02)
    assert sum(counts["segments"]) <= sum(counts["gauss"]) + 1
