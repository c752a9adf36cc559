"""A fixed dozen of the random scenes of benchmarks/robustness.py, at least one of each family, with its own checks."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from robustness import BALANCE, DEEPEST, UNFELT, march
from robustness_scenes import FAMILIES, draw

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, quasistatic
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.monitors import ModelWarning
from meshes.boxes import Box, create_boxes

pytestmark = pytest.mark.one_rank

#: seed, number: quick ones; E of the upper body to the lower's from 1/130 (punch 11/0) to 640 (die), μ from 0 to 0.99 (half
#: ring), up to 3.8 facets of sliding per increment; in four the lower body is the contactor; the
#: last two, a ball and a dome of four facets, overlap unfelt or stand on one point with 6 and 25 points on a facet
SCENES = [(11, k) for k in (0, 1, 2, 3, 6, 11, 18, 26, 30, 38)] + [(21, 31), (22, 65), (12011, 9), (12003, 10)]


@pytest.fixture(scope="module")
def runs():
    """What `march` says of each scene."""
    return {scene: march(draw(*scene)) for scene in SCENES}


def test_every_family_is_there():
    assert {draw(*scene).family for scene in SCENES} == set(FAMILIES)
    ratios = [np.log10(s.upper.E / s.lower.E) for s in (draw(*scene) for scene in SCENES)]
    assert min(ratios) < -2 and max(ratios) > 2


@pytest.mark.parametrize("seed, number", SCENES, ids=[draw(*scene).name for scene in SCENES])
def test_goes_through_and_passes_the_independent_checks(runs, seed, number):
    """No point deep in the target, bodies that overlap push, contact and internal forces balance (to 1e-5, seen: 1e-12)."""
    scene, run = draw(seed, number), runs[seed, number]
    assert run["error"] is None
    assert len(run["steps"]) == sum(stage.increments for stage in scene.stages)
    assert run["penetration"] < DEEPEST
    assert np.linalg.norm(run["forces"][-1]) > run["floor"] or run["penetration"] < UNFELT
    assert run["balance"] is None or run["balance"] < BALANCE


def test_next_to_no_step_is_rejected(runs):
    assert sum(rejected for run in runs.values() for _, rejected, _ in run["steps"]) <= 1


def test_a_step_does_not_leap_to_an_unstable_equilibrium():
    """Two membranes in two increments: the second, taken at once, ends where the Jacobian's determinant is negative, with
    forces 6 % off; in two halves it ends where four times as many increments do (to .02, as `judge` has it)."""
    scene = draw(9901, 73)
    run, finer = march(scene), march(scene, 4)
    assert run["findings"] == [] and sum(rejected for _, rejected, _ in run["steps"]) == 1
    ends = np.array(run["forces"][-1]), np.array(finer["forces"][-1])
    assert np.linalg.norm(ends[0] - ends[1]) < 0.02 * np.linalg.norm(ends[1])


def test_a_step_does_not_leap_out_of_contact():
    """A soft half ring, dragged by more than its radius in an increment: a quarter of it snaps the ring through, off the
    slab; an eighth drags it on, with the force of four times as many increments (to .02)."""
    scene = draw(41001, 24)
    run, finer = march(scene), march(scene, 4)
    ends = np.array(run["forces"][-1]), np.array(finer["forces"][-1])
    assert ends[1][0] > 0.1 and np.linalg.norm(ends[0] - ends[1]) < 0.02 * np.linalg.norm(ends[1])
    assert not any("leap" in name for name in run["findings"])


def test_a_ring_that_runs_over_nodes_has_not_passed_through_them():
    """A half ring dragged by 6.6 facets an increment over a soft slab, whose nodes it runs over: no trial is rejected (two
    were, as nodes' straight ways led through the ring)."""
    run = march(draw(151001, 68))
    assert run["error"] is None and sum(rejected for _, rejected, _ in run["steps"]) == 0


def test_a_corner_within_facets_in_contact_is_said_and_what_helps(monkeypatch):
    """A soft block's corner digs .27 of its facets into a stiff slab, the contactor, as contact holds on average where points
    that face nothing count in full, as in space: more points leave it there (.29), with the roles swapped it is .09."""
    scene = draw(81003, 19)
    monkeypatch.setattr(ContactPair, "_make_segments", lambda pair: None)
    with pytest.warns(ModelWarning, match="holds them apart on the average"):
        march(scene)
    assert march(replace(scene, swap=False))["penetration"] < 0.1


def test_a_law_that_gives_way_is_named():
    """A soft beam on one five hundred times stiffer has no answer beyond .41 of its way, in 3, 12 or 24 increments: cells of
    Saint Venant and Kirchhoff's law would be inverted. One of the neo-Hookean law goes on to more than .8 (seen: .92), in
    steps that are not halved."""
    scene = draw(51001, 39)
    run = march(scene, 4, smallest=1.0)
    assert "each step would leave an inverted cell" in run["error"] and len(run["steps"]) < 0.5 * 12
    other = march(replace(scene, upper=replace(scene.upper, material="neo_hookean")), 4, smallest=1.0)
    assert len(other["steps"]) > 0.8 * 12


def cantilever(above):
    """A beam of 1 m × .05 m, `above` a plane that its lower side may meet, with a load (Pa) on its upper side."""
    box = Box((0, 0), (1.0, 0.05), (20, 2), 1, {(0, 0): 1, (1, 0): 2, (1, 1): 3})
    domain, _, tags = create_boxes(MPI.COMM_WORLD, [box], False)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, q = fem.Function(V), fem.Constant(domain, 0.0)
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    held = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(1)), V)
    body = Body(u, materials.neo_hookean(1e6, 0.0), external=(ufl.as_vector([0, -q]), ds(3)), bcs=[held])
    plane = obstacles.RigidPlane([0, -above], [0, 1])
    return ContactProblem(body, contacts=[Contact(Surface(domain, tags, 2), plane)]), u, q


def test_to_lift_off_is_no_leap():
    """A cantilever, pressed onto a plane by a load along it and let go in increments that its force goes to nothing in: four
    trials were rejected and a leap was said, as the prediction is nearly exact and Newton's first correction is not."""
    problem, u, q = cantilever(0.05)
    stages = [quasistatic.Stage(q, to=16.0, increments=4), quasistatic.Stage(q, to=0.0, increments=5)]
    steps = list(quasistatic.march(problem, stages))
    assert sum(step.rejected for step in steps) == 0
    assert not any(finding for step in steps for finding in step.findings)
    assert np.abs(u.x.array).max() < 1e-9


def test_a_load_that_goes_faster_is_no_leap():
    """Sixty times as fast from the middle on: one trial tells it from a snap, by half of it that goes half as far."""
    problem, _, q = cantilever(0.5)

    def along(t):
        q.value = min(t, 0.5) + 60.0 * max(0.0, t - 0.5)

    steps = list(quasistatic.march(problem, along, to=1.0, increments=6))
    assert sum(step.rejected for step in steps) <= 1
    assert not any("leap" in finding.name for step in steps for finding in step.findings)
