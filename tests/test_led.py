"""Bodies that supports lead begin a step where these take them along the surfaces they touch."""

import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from robustness import march
from robustness_scenes import draw

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, quasistatic
from meshes.boxes import Box, create_boxes

BASE, FACE, SOLE, HEAD, SIDE = 1, 2, 3, 4, 5
PRESSED = np.array([0.0, -0.05])  # m


def block_on_slab(held=(HEAD,), moves=1.0):
    """A block pressed into a slab, of two cells' height each; `moves`: of the way that further held faces are led."""
    block = Box((0.5, 1.0), (0.5, 0.5), (4, 2), 1, {(1, 0): SOLE, (1, 1): HEAD, (0, 0): SIDE})
    slab = Box((0.0, 0.0), (2.0, 1.0), (8, 2), 2, {(1, 0): BASE, (1, 1): FACE})
    domain, _, tags = create_boxes(MPI.COMM_WORLD, [block, slab], simplices=False)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, way = fem.Function(V), fem.Constant(domain, np.zeros(2))
    others = fem.Constant(domain, np.zeros(2))
    values = {HEAD: way, SIDE: others, BASE: np.zeros(2)}
    bcs = [fem.dirichletbc(values[t], fem.locate_dofs_topological(V, 1, tags.find(t)), V) for t in (BASE, *held)]
    contact = Contact(Surface(domain, tags, SOLE), Surface(domain, tags, FACE), friction=0.3)
    problem = ContactProblem(materials.neo_hookean(1e3, 0.3).virtual_work(u), u, bcs=bcs, contacts=[contact])

    def load(t):
        way.value[:] = t * PRESSED
        others.value[:] = moves * t * PRESSED

    list(quasistatic.march(problem, load, to=1.0, increments=2))
    return problem, way, others


def moved(problem):
    """By how much `lead` moves the upper and the lower body's nodes (n, 2) on this rank."""
    before, piece = problem.u.x.array.copy(), problem.bodies.bodies[0].piece
    problem.lead()
    high = problem.u.function_space.tabulate_dof_coordinates()[:, 1] > 1.25
    upper = MPI.COMM_WORLD.allreduce(int(piece[high].max(initial=-1)), MPI.MAX)
    change = (problem.u.x.array - before).reshape(-1, 2)
    return change[piece == upper], change[piece != upper]


def test_a_block_goes_along_the_slab():
    """By the part of its support's way that pressure does not oppose, which is along the slab but for what the pressed slab
    is bent: to .02 of it; the slab stays."""
    problem, way, _ = block_on_slab()
    way.value[:] = PRESSED + np.array([0.3, -0.1])
    block, slab = moved(problem)
    assert np.abs(slab).max(initial=0.0) == 0.0
    assert np.abs(block - [0.3, 0.0]).max(initial=0.0) < 0.02 * 0.3


def test_what_is_pressed_stays():
    problem, way, _ = block_on_slab()
    way.value[:] = PRESSED + np.array([0.0, -0.1])
    block, _ = moved(problem)
    assert np.abs(block).max(initial=0.0) < 0.02 * 0.1


def test_what_two_supports_lead_to_different_places_stays():
    problem, way, others = block_on_slab(held=(HEAD, SIDE))
    way.value[:] = PRESSED + np.array([0.3, 0.0])
    others.value[:] = PRESSED + np.array([0.2, 0.0])
    assert all(np.abs(part).max(initial=0.0) == 0.0 for part in moved(problem))


def test_a_way_of_less_than_a_facet_is_newtons():
    problem, way, _ = block_on_slab()
    way.value[:] = PRESSED + np.array([0.2, 0.0])  # facets are .25 m long
    assert all(np.abs(part).max(initial=0.0) == 0.0 for part in moved(problem))


def test_what_is_not_in_contact_stays():
    problem, way, _ = block_on_slab()
    list(quasistatic.march(problem, way, to=(0.0, 0.2), increments=2))
    way.value[:] = [0.3, 0.2]
    assert all(np.abs(part).max(initial=0.0) == 0.0 for part in moved(problem))


def test_a_way_in_other_units_than_the_mesh_is_doubted():
    """A march that fails on the way to 30 or 300 m, of a body of .7 m, asks for the unit; one to 3 m does not. Loads stay. On
    the way to 300 m it has asked before."""
    problem, way, _ = block_on_slab()
    asks = "times its size: is it in the units of the mesh?"
    for end, says, before in ((-300.0, True, True), (-30.0, True, False), (-3.0, False, False)):
        with warnings.catch_warnings(record=True) as said, pytest.raises(quasistatic.StepFailure) as failed:
            warnings.simplefilter("always")
            list(quasistatic.march(problem, way, to=(0.0, end), increments=1, smallest=1.0))
        assert (asks in str(failed.value)) == says
        assert any(asks in str(w.message) and w.filename == __file__ for w in said) == (
            before and not MPI.COMM_WORLD.rank
        )
        assert np.array_equal(way.value, PRESSED)


def test_loads_in_other_units_than_the_moduli_are_doubted():
    """A march that fails on the way to a weight of 10 000 or 300 times the modulus asks for the units, the first one before
    it begins, too; one to 30 times fails without."""
    block = Box((0.0, 0.0), (1.0, 1.0), (2, 2), 1, {(1, 0): BASE})
    domain, _, tags = create_boxes(MPI.COMM_WORLD, [block], simplices=False)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    asks = "are they in the units of its moduli"
    for times, says, before in ((1e4, True, True), (300.0, True, False), (30.0, False, False)):
        u, weight = fem.Function(V), fem.Constant(domain, (0.0, 0.0))
        held = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(BASE)), V)
        body = Body(u, materials.neo_hookean(1e3, 0.3), external=[(weight, ufl.dx(domain))], bcs=[held])
        with warnings.catch_warnings(record=True) as said, pytest.raises(quasistatic.StepFailure) as failed:
            warnings.simplefilter("always")
            steps = quasistatic.march(ContactProblem(body), weight, to=(0.0, -1e3 * times), increments=1, smallest=1.0)
            list(steps)
        assert (asks in str(failed.value)) == says, str(failed.value)
        told = any(asks in str(w.message) and w.filename == __file__ for w in said)
        assert told == (before and not MPI.COMM_WORLD.rank)


@pytest.mark.one_rank
def test_drags_need_no_second_trial():
    """A coarse die dragged by 4.8 facets in an increment: no trial is rejected and 14 iterations are taken (from the last
    state one and 33)."""
    run = march(draw(151001, 34))
    assert run["error"] is None and sum(rejected for _, rejected, _ in run["steps"]) == 0
    assert sum(iterations for iterations, _, _ in run["steps"]) <= 20
