"""Moduli that change after a problem was made: ε, and what depends on it, goes along."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_mortar_al import Body, Checkpoint, Contact, ContactProblem, Surface, materials, quasistatic
from meshes.boxes import Box, create_boxes

SLAB, BLOCK, BED, FOOT, FACE, TOP = 1, 2, 11, 12, 13, 14


class Pressed:
    """A block of 10 facets on a slab of 12 below it, pressed and dragged by its top, with friction; E is a Constant, or a
    Function, of 100 Pa."""

    def __init__(self, *, field=False):
        boxes = [
            Box([0.0, 0.0], [3.0, 1.0], [12, 3], SLAB, {(1, 0): BED, (1, 1): FACE}),
            Box([1.0, 1.0], [1.0, 0.5], [10, 5], BLOCK, {(1, 0): FOOT, (1, 1): TOP}),
        ]
        domain, cells, facets = create_boxes(MPI.COMM_WORLD, boxes, False)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        dx = ufl.Measure("dx", domain, subdomain_data=cells)
        self.E = fem.Function(fem.functionspace(domain, ("DG", 0))) if field else fem.Constant(domain, 0.0)
        self.lead = fem.Constant(domain, np.zeros(2))
        self.stiffen(1.0)
        bed, top = (fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (BED, TOP))
        bcs = [fem.dirichletbc(np.zeros(2), bed, V), fem.dirichletbc(self.lead, top, V)]
        laws = [(materials.neo_hookean(k * self.E, 0.3), dx(tag)) for k, tag in ((1.0, SLAB), (2.0, BLOCK))]
        pair = Contact(Surface(domain, facets, FOOT), Surface(domain, facets, FACE), friction=0.3)
        self.problem = ContactProblem(Body(fem.Function(V), laws, bcs=bcs), contacts=[pair])

    def stiffen(self, factor):
        """Set E to so many times 100 Pa."""
        if isinstance(self.E, fem.Function):
            self.E.x.array[:] = 100.0 * factor
        else:
            self.E.value = 100.0 * factor

    def go(self, to):
        """Lead the top there; the force (N)."""
        for step in quasistatic.march(self.problem, self.lead, to=to, increments=2):
            assert step.rejected == 0 and step.iterations <= 4
        return self.problem.pairs[0].force()


PRESSED, DRAGGED = (0.0, -0.05), (0.2, -0.05)


@pytest.mark.parametrize("field", [False, True], ids=["Constant", "Function"])
def test_moduli_may_change_after_the_problem_was_made(field):
    """Forces over E are those of a problem made with that E; they were 2.7 % too small at a hundred times E."""
    soft, late = Pressed(), Pressed(field=field)
    late.stiffen(100.0)
    for to in (PRESSED, DRAGGED):
        assert np.allclose(late.go(to) / 100.0, soft.go(to), rtol=1e-8, atol=1e-10)


def test_moduli_may_change_in_contact():
    """A block that is held pressed while all becomes stiffer bears what it would at that E, but for the part of closed
    facets that ε decides; it was 2.7 % less."""
    scene = Pressed()
    before = scene.go(PRESSED)[1]
    list(quasistatic.march(scene.problem, scene.stiffen, start=1.0, to=100.0, increments=4))
    assert scene.problem.pairs[0].force()[1] == pytest.approx(100.0 * before, rel=4e-3)


def test_a_resumed_march_has_the_same_stiffness(shared_path):
    """ε is part of a state: from a checkpoint on it goes as it would have."""
    scene = Pressed()
    scene.go((0.0, -0.025))
    scene.stiffen(100.0)
    scene.go(PRESSED)
    Checkpoint(shared_path, scene.problem).save(1.0)
    again = Pressed()
    again.stiffen(100.0)
    again.lead.value = PRESSED
    Checkpoint(shared_path, again.problem).load()
    assert again.problem.pairs[0].epsilon == scene.problem.pairs[0].epsilon
    assert np.allclose(again.go(DRAGGED), scene.go(DRAGGED), rtol=1e-9, atol=1e-9)
