"""Round bodies that contact alone holds turn freely: what their facets resist that with is no load (docs/newton.md)."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, obstacles, quasistatic
from dolfinx_mortar_al.verify.model import space
from meshes.round_bodies import Round, RoundBodies

RADIUS, YOUNG = 0.5, 20.0  # m, Pa: weights of .8 N flatten the discs by a few per cent
AREA = np.pi * RADIUS**2


def pile(order, size, friction):
    """Three discs in a box, two and one on top, and their weight per area: the problem and the load."""
    centres = [(-RADIUS, RADIUS), (RADIUS, RADIUS), (0.0, (1 + np.sqrt(3)) * RADIUS)]
    discs = RoundBodies(tuple(Round(centre, RADIUS, size=size) for centre in centres), order)
    domain, _, tags = discs.create()
    _, u = space(domain, order)
    weight = fem.Constant(domain, 0.0)
    rims = [Surface(domain, tags, discs.rim(k)) for k in range(3)]
    floor = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0])
    left, right = (obstacles.RigidPlane([2 * side * RADIUS, 0.0], [-side, 0.0]) for side in (-1.0, 1.0))
    faces = {"floor0": (0, floor), "floor1": (1, floor), "left": (0, left), "right": (1, right)}
    faces |= {f"{i}{j}": (i, rims[j]) for i, j in ((0, 1), (0, 2), (1, 2))}
    body = Body(u, materials.neo_hookean(YOUNG, 0.3), external=[(ufl.as_vector([0.0, -weight]), ufl.dx)])
    contacts = [Contact(rims[i], target, friction=friction, name=name) for name, (i, target) in faces.items()]
    return ContactProblem(body, contacts=contacts), weight


@pytest.mark.one_rank
@pytest.mark.parametrize("order, size, friction", [(1, 0.16, 0.0), (2, 0.13, 0.0), (2, 0.12, 0.02)])
def test_discs_that_turn_freely_are_piled(order, size, friction):
    """The floor bears their weight, half of it each disc, and the walls push alike. Facets turned the discs to and fro: those
    of order 2 failed, or took over a thousand iterations."""
    problem, weight = pile(order, size, friction)
    steps = list(quasistatic.march(problem, weight, to=1.0, increments=2))
    assert not any(step.rejected for step in steps)
    assert sum(step.iterations for step in steps) < 80
    force = {pair.name: pair.force() / AREA for pair in problem.pairs}
    assert force["floor0"][1] + force["floor1"][1] == pytest.approx(3.0, rel=0.03)
    assert force["floor0"][1] == pytest.approx(1.5, rel=0.03)
    assert force["left"][0] == pytest.approx(-force["right"][0], rel=0.05)


@pytest.mark.one_rank
def test_a_weight_off_the_middle_turns_a_disc():
    """In a frictionless vee nothing but facets resists a turn. A weight through the middle pushes with nothing, wherever
    its nodes' middle is, one that is 12 mm off with .035 of itself: 12 mm over the root of the mean square distance."""
    disc = RoundBodies((Round((0.0, 0.0), RADIUS, size=0.1),), 2)
    domain, _, tags = disc.create()
    _, u = space(domain, 2)
    weight, rim, way = fem.Constant(domain, 0.0), Surface(domain, tags, disc.rim(0)), np.sqrt(0.5)
    planes = [obstacles.RigidPlane([s * way * RADIUS, -way * RADIUS], [-s * way, way]) for s in (-1.0, 1.0)]
    body = Body(u, materials.neo_hookean(YOUNG, 0.3), external=[(ufl.as_vector([0.0, -weight]), ufl.dx)])
    problem = ContactProblem(body, contacts=[Contact(rim, plane) for plane in planes])
    list(quasistatic.march(problem, weight, to=1.0, increments=1))
    bodies, ties = problem.bodies, problem.ties
    ties.engage()
    assert len(ties.motions) == 1
    x = bodies.owned_positions() + bodies.get().reshape(-1, 2)
    for off, share in ((0.0, 0.0), (0.2, 0.035)):
        weights = bodies.volumes() * (1.0 + off * x[:, 0])
        forces = np.column_stack([np.zeros_like(weights), -weights / weights.sum()]).ravel()
        pushed = ties.pushing(forces, problem._contact_motions.turns())[0]
        assert pushed == pytest.approx(share, abs=0.004)
