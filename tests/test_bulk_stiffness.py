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
    """A block of 10 facets on a slab of 12, pressed and dragged by its top, with friction; E is `factor` times 100 Pa,
    a Constant, or a Function, which is 10⁸ Pa in the lowest cells if these are a `plate`."""

    def __init__(self, factor=1.0, *, field=False, plate=False):
        boxes = [
            Box([0.0, 0.0], [3.0, 1.0], [12, 3], SLAB, {(1, 0): BED, (1, 1): FACE}),
            Box([1.0, 1.0], [1.0, 0.5], [10, 5], BLOCK, {(1, 0): FOOT, (1, 1): TOP}),
        ]
        domain, cells, facets = create_boxes(MPI.COMM_WORLD, boxes, False)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        dx = ufl.Measure("dx", domain, subdomain_data=cells)
        self.E = fem.Function(fem.functionspace(domain, ("DG", 0))) if field else fem.Constant(domain, 0.0)
        self.lead = fem.Constant(domain, np.zeros(2))
        self.plate = plate
        self.stiffen(factor)
        bed, top = (fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (BED, TOP))
        bcs = [fem.dirichletbc(np.zeros(2), bed, V), fem.dirichletbc(self.lead, top, V)]
        laws = [(materials.neo_hookean(k * self.E, 0.3), dx(tag)) for k, tag in ((1.0, SLAB), (2.0, BLOCK))]
        pair = Contact(Surface(domain, facets, FOOT), Surface(domain, facets, FACE), friction=0.3)
        self.problem = ContactProblem(Body(fem.Function(V), laws, bcs=bcs), contacts=[pair])

    def stiffen(self, factor):
        """Set E to so many times 100 Pa."""
        if isinstance(self.E, fem.Function):
            self.E.interpolate(lambda x: np.where((x[1] < 1 / 3) & self.plate, 1e8, 100.0 * factor))
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


def test_a_part_may_change_beside_a_stiffer_one():
    """Whatever is larger in the same field and stays."""
    early, late = (Pressed(factor, field=True, plate=True) for factor in (100.0, 1.0))
    late.stiffen(100.0)
    assert np.allclose(late.go(PRESSED), early.go(PRESSED), rtol=1e-8, atol=1e-8)
    assert late.problem.pairs[0].epsilon.normal == pytest.approx(early.problem.pairs[0].epsilon.normal, rel=1e-9)


def test_what_bears_nothing_any_more_is_no_error():
    """A body that loses its stiffness keeps its ε."""
    scene = Pressed()
    scene.go(PRESSED)
    ε = scene.problem.pairs[0].epsilon
    scene.stiffen(0.0)
    scene.problem.stiffness.follow()
    assert scene.problem.pairs[0].epsilon == ε


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
