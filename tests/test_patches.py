"""Contact in patches: what straight facets of curved surfaces do to a press fit, and that it is said."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_blocks import pressed_blocks
from scenes import FailingSolver

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, materials, quasistatic
from dolfinx_mortar_al.surface import Facets
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import hold, space

RADII, E, NU = (0.5, 1.0, 1.5), 2e11, 0.3  # m, Pa
SIDES, FITTED, BORE = (10, 11), 3, 4


def lame(overlap: float) -> float:
    """Pressure (Pa) of a ring that is pressed into another one of the same matter, plane strain (Lamé)."""
    a, b, c = RADII
    return overlap * E / (1 - NU**2) / (b * ((c**2 + b**2) / (c**2 - b**2) + (b**2 + a**2) / (b**2 - a**2)))


def press_fit(order: int, facets: tuple[int, int], overlap: float = 1e-3) -> ContactProblem:
    """A quarter of two rings, meshes and displacements of this order, so many facets on either side."""
    inner, outer = (np.linspace(0, np.pi / 2, around + 1) for around in facets)
    return fitted(order, overlap, inner, outer, SIDES)


def fitted(order, overlap, inner, outer, outer_sides) -> ContactProblem:
    """Parts of two rings with nodes at these angles; the inner one's sides are planes of symmetry."""

    def turned(x):
        return x[:, :1] * np.column_stack([np.cos(x[:, 1]), np.sin(x[:, 1])])

    def ring(radii: tuple[float, float], angles, tags: tuple[int, int], sides: tuple[int, int]):
        faces = {(0, 0): tags[0], (0, -1): tags[1], (1, 0): sides[0], (1, -1): sides[1]}
        return grid([np.linspace(*radii, 5), angles], faces, order=order, place=turned)

    a, b, c = RADII
    rings = [ring((a, b), inner, (1, FITTED), SIDES), ring((b - overlap, c), outer, (BORE, 2), outer_sides)]
    domain, _, tags = build(rings)
    V, u = space(domain, order)
    bcs = [hold(V, tags, SIDES[0], 1), hold(V, tags, SIDES[1], 0)]
    if outer_sides != SIDES:
        bcs += [hold(V, tags, 2, 0), hold(V, tags, 2, 1)]
    body = Body(u, materials.saint_venant_kirchhoff(E, NU), bcs=bcs)
    return ContactProblem(body, contacts=[Contact(Surface(domain, tags, FITTED), Surface(domain, tags, BORE))])


def said(step: quasistatic.Step) -> bool:
    return any("amid the contact" in finding.name for finding in step.findings)


@pytest.mark.parametrize(
    ("order", "facets", "patchy"),
    [(1, (20, 16), True), (1, (80, 60), True), (1, (20, 20), False), (2, (20, 16), False)],
)
def test_gaps_between_straight_facets_are_said_where_they_matter(order, facets, patchy):
    """Straight facets of .1 m leave .8 and 1.2 mm of gaps beside 1 mm of overlap: contact in patches, some of which press
    more than twice as much as Lamé's. Where nodes meet nodes, and with curved facets, pressures are right to 1 %: an overlap
    of a thousandth in large deformation, and the mesh's error."""
    problem = press_fit(order, facets)
    assert said(quasistatic.equilibrate(problem)) == patchy
    pressure = problem.pairs[0].largest_pressure() / lame(1e-3)
    assert pressure > 2.0 if patchy else abs(pressure - 1) < 0.01


def test_curved_facets_are_not_to_be_curved():
    """Facets of order 2 that rise by half of what the surface they stand for does, in patches of a light touch: all that
    helps are finer ones."""
    for order, advised in ((1, True), (2, False)):
        problem = press_fit(order, (10, 7), overlap=1e-7)
        pair = problem.pairs[0]
        if order == 2:
            X = pair._contactor.X.copy()
            for first, last, middle in pair._contactor.facets:
                X[middle] += 0.5 * ((X[first] + X[last]) / 2 - X[middle])
            pair._contactor = replace(pair._contactor, X=X)
        step = quasistatic.equilibrate(problem)
        (meaning,) = [finding.meaning for finding in step.findings if "amid the contact" in finding.name]
        assert ("order 2" in meaning) == advised and "refine both surfaces" in meaning


def test_what_overhangs_is_not_open_amid_the_contact():
    """Facets meet facets, and the last ones of the contactor stand out beyond the target by nine tenths of their length."""
    angles = np.linspace(0, np.pi / 2, 13)
    shorter = np.r_[0.9 * angles[1], angles[1:-1], angles[-1] - 0.9 * angles[1]]
    problem = fitted(1, 1e-3, angles, shorter, (5, 6))
    step = quasistatic.equilibrate(problem)
    assert 0.8 < problem.pairs[0].closed_fraction() < 0.9
    assert not said(step)


def test_gaps_that_are_pressed_away_are_not_said():
    """With ten times the overlap facets of .1 m close all round: pressures ripple, and their mean is right to a tenth."""
    problem = press_fit(1, (20, 16), overlap=1e-2)
    pair = problem.pairs[0]
    assert not said(quasistatic.equilibrate(problem))
    assert pair.closed_fraction() == pytest.approx(1.0)
    assert np.linalg.norm(pair.force()) / lame(1e-2) == pytest.approx(np.sqrt(2.0), rel=0.1)


def test_a_state_before_any_load_that_is_not_found_leaves_no_trace():
    problem = press_fit(2, (10, 8))
    solver = FailingSolver(problem, {1})
    with pytest.raises(quasistatic.StepFailure, match="no convergence in the loads as they stand"):
        quasistatic.equilibrate(problem, solver=solver)
    assert not problem.bodies.get().any()
    quasistatic.equilibrate(problem, solver=solver)
    pressure = problem.pairs[0].largest_pressure()
    other = press_fit(2, (10, 8))
    quasistatic.equilibrate(other)
    assert pressure == pytest.approx(other.pairs[0].largest_pressure(), rel=1e-8)


def test_straight_flanks_beside_sharp_corners_are_not_curved():
    """All sides of a square: mean normals turn at its corners, but nothing stands for a curved surface."""
    domain, _, tags = build([grid([np.linspace(0, 1, 5)] * 2, {(axis, end): 1 for axis in (0, 1) for end in (0, -1)})])
    contactor = Facets.of(Surface(domain, tags, 1), space(domain, 1)[0]).gather()
    assert contactor.turns.max() > 0.7
    assert not contactor.sagittas.any()


@pytest.mark.parametrize("facets", [(20, 23), (40, 13), (18, 43)])
def test_surfaces_stay_flat_under_pressures_above_the_modulus(facets):
    """p = 3 E. P1 multipliers do not see how the nodes amid facets move; with the ε of small pressures marches of 8
    increments reject trials and fail from .7 to 1.8 E on. λ is uniform to a hundredth, the error of Gauss points on facets
    that do not match."""
    problem, load = pressed_blocks(facets, friction=0.3)
    steps = list(quasistatic.march(problem, load, to=3.0, increments=8))
    pair = problem.pairs[0]
    assert not sum(step.rejected for step in steps)
    assert np.mean([step.iterations for step in steps]) <= 3.0
    λ = pair.multiplier.field.x.array.reshape(-1, 2)[:, 1]
    pressures = np.abs(λ[λ != 0.0])
    assert max(pair.comm.allgather(float(np.abs(pressures / 3.0 - 1.0).max(initial=0.0)))) < 0.02


def test_the_default_ε_passed_on_changes_nothing():
    """A user's ε grows with pressures near the moduli as the default does."""
    found, options = [], {}
    for _ in range(2):
        problem, load = pressed_blocks((20, 23), friction=0.3, **options)
        pair = problem.pairs[0]
        options = {"epsilon_normal": pair.epsilon.normal, "epsilon_tangential": pair.epsilon.tangential}
        steps = list(quasistatic.march(problem, load, to=3.0, increments=8))
        found.append((pair.force(), [step.iterations for step in steps]))
    assert found[0][1] == found[1][1]
    assert np.allclose(found[0][0], found[1][0], rtol=1e-9)


@pytest.mark.parametrize("integration", ["gauss", "segments"])
def test_pressures_that_waver_are_said(integration):
    """p = 3 E between 18 and 43 facets: pressures at the points are off by a tenth and more, as ε g wavers, which is said.
    With segments they are uniform to 1e-6."""
    problem, load = pressed_blocks((18, 43), friction=0.3, integration=integration)
    steps = list(quasistatic.march(problem, load, to=3.0, increments=8))
    wavers = any("wavering share" in finding.name for finding in steps[-1].findings)
    off = problem.pairs[0].largest_pressure() / 3.0 - 1
    assert wavers == (integration == "gauss")
    assert off > 0.1 if wavers else abs(off) < 1e-6
