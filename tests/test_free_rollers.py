"""Bodies that contact alone holds and that roll on each other: friction carries them along, ties bear nothing of it."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, quasistatic
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import space
from meshes.round_bodies import Round, RoundBodies

INNER, OUTER, GAP = 0.5, 0.8, 5e-4  # m: races of a bearing, clearance of its rollers
TURN, PRESS = 0.05, 0.004  # rad, m


def own_positions(u):
    """(nodes, 2) where the owned nodes of a displacement are, and their displacements."""
    V = u.function_space
    n = V.dofmap.index_map.size_local
    return V.tabulate_dof_coordinates()[:n, :2], u.x.array[: 2 * n].reshape(-1, 2)


def mean_around(u, centre, radius):
    """(2,) mean displacement of the nodes within a circle (m), collective."""
    x, moved = own_positions(u)
    inside = np.linalg.norm(x - centre, axis=1) <= 1.001 * radius
    total = u.function_space.mesh.comm.allreduce(np.r_[moved[inside].sum(axis=0), inside.sum()], MPI.SUM)
    return total[:2] / total[2]


@pytest.mark.one_rank
@pytest.mark.parametrize("order, size", [(1, 0.03), (2, 0.04)])
def test_the_rollers_of_a_bearing_roll(order, size):
    """A bearing's inner ring is pressed onto three loose rollers and turned: each goes round by INNER/(INNER + OUTER) of the
    turn, to a tenth of it (what pressing has left), no tie bears anything, and what presses a roller from both sides is in
    balance. Two of the three slid on the inner ring, held by ties that bore 8 % of the contact forces as of a slide that
    nothing resists."""
    middle, radius = (INNER + OUTER) / 2, (OUTER - INNER) / 2 - GAP
    angles = np.radians([-90.0, -45.0, -135.0])
    centres = middle * np.column_stack([np.cos(angles), np.sin(angles)])
    races = (Round(radius=0.95, bore=OUTER, size=size), Round(radius=INNER, bore=0.35, size=size))
    rounds = RoundBodies((*races, *(Round(tuple(c), radius, 0.0, 0.8 * size) for c in centres)), order=order)
    domain, _, facets = rounds.create()
    V = fem.functionspace(domain, ("Lagrange", order, (2,)))
    u, given = fem.Function(V), fem.Function(V)

    def drive(down, angle):
        c, s = np.cos(angle), np.sin(angle)
        given.interpolate(lambda x: np.stack([c * x[0] - s * x[1] - x[0], s * x[0] + c * x[1] - x[1] - down]))

    held = fem.locate_dofs_topological(V, 1, facets.find(rounds.rim(0)))
    driven = fem.locate_dofs_topological(V, 1, facets.find(rounds.bore(1)))
    bcs = [fem.dirichletbc(np.zeros(2), held, V), fem.dirichletbc(given, driven)]
    tracks = (rounds.rim(1), rounds.bore(0))
    contacts = [
        Contact(Surface(domain, facets, rounds.rim(2 + k)), Surface(domain, facets, track), friction=0.1)
        for k in range(3)
        for track in tracks
    ]
    problem = ContactProblem(Body(u, materials.neo_hookean(2e11, 0.3), bcs=bcs), contacts=contacts)
    pressed = list(quasistatic.march(problem, lambda t: drive(PRESS * t, 0.0), to=1.0, increments=4, start=0.0))
    before = [mean_around(u, c, radius) for c in centres]
    turned = list(quasistatic.march(problem, lambda t: drive(PRESS, TURN * t), to=1.0, increments=3, start=0.0))
    assert not any(step.rejected for step in pressed + turned)
    assert not [f for f in turned[-1].findings if f.name.startswith("slide")]
    for k, (c, was) in enumerate(zip(centres, before, strict=True)):
        along = np.array([-c[1], c[0]]) / middle**2
        went = (mean_around(u, c, radius) - was) @ along
        assert went == pytest.approx(TURN * INNER / (INNER + OUTER), rel=0.1)
        forces = [pair.force() for pair in problem.pairs[2 * k : 2 * k + 2]]
        assert np.linalg.norm(sum(forces)) < 1e-6 * np.linalg.norm(forces[0])


@pytest.mark.one_rank
@pytest.mark.parametrize("friction", [0.1, 0.2])
def test_a_beam_is_bent_on_four_free_rollers(friction):
    """Two rollers under a beam and two between it and a platen, none of them prescribed anything: all have one neutral motion
    in common. They bear equal halves of the load, to 1e-3 (their meshes are not symmetric), and in few iterations; with
    a tie for each of the five it failed or took a thousand."""
    r, length, thick, sunk = 0.1, 2.6, 0.2, 0.02
    beam = grid(
        [np.linspace(-length / 2, length / 2, 53), np.linspace(0.0, thick, 5)], {(1, 0): 1, (1, -1): 2}, order=2
    )
    beam_mesh, _, beam_facets = build([beam])
    _, ub = space(beam_mesh, 2)
    centres = [(-1.0, -r), (1.0, -r), (-0.4, thick + r), (0.4, thick + r)]
    rounds = RoundBodies(tuple(Round(c, r, 0.0, 0.025) for c in centres), order=2)
    domain, _, facets = rounds.create()
    ur = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,))))
    law = materials.neo_hookean(1e7, 0.3)
    ground = obstacles.RigidPlane([0.0, -2 * r], [0.0, 1.0])
    platen = obstacles.RigidPlane([0.0, thick + 2 * r], [0.0, -1.0])
    contacts = []
    for k in range(4):
        rim, side = Surface(domain, facets, rounds.rim(k)), Surface(beam_mesh, beam_facets, 1 if k < 2 else 2)
        contacts += [Contact(rim, ground if k < 2 else platen, friction=friction, name=f"outside {k}")]
        contacts += [Contact(rim, side, friction=friction, name=f"beam {k}")]
    problem = ContactProblem([Body(ub, law), Body(ur, law)], contacts=contacts)

    def press(share):
        platen.move([0.0, -sunk * share])

    steps = list(quasistatic.march(problem, press, to=1.0, increments=5, start=0.0))
    assert not any(step.rejected for step in steps) and sum(step.iterations for step in steps) <= 60
    forces = [abs(problem.pair(f"outside {k}").force()[1]) for k in range(4)]
    assert forces == pytest.approx([np.mean(forces)] * 4, rel=1e-3)
