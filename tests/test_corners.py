"""Corners, ends and vertices: a sharp block on a slab, past its end and back, and points that meet a target's corner."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import blocks
from test_projection import curved_surface

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from robustness_model import Model
from robustness_scenes import Body, Scene, Stage

from dolfinx_mortar_al import NewtonSolver, quasistatic
from dolfinx_mortar_al.closest_point import project
from dolfinx_mortar_al.search import CandidateSearch

E, DEPTH = 1e3, 0.01  # Pa, m
FORCE = 8.44  # N, that presses the block in by DEPTH: 24 and 96 facets, either side contactor, agree to 0.1 %


def block_on_slab(stages, *, swap, sides, friction, order=1, end=0.4, cells=(3, 12), simplices=False):
    """A block over x = −0.25 … 0.25 m on a slab that ends at x = `end`; with `sides`, the block's belong to its surface."""
    touched = ("bottom", "left", "right") if sides else ("bottom",)
    material = {"E": E, "nu": 0.3, "material": "neo_hookean"}
    upper = Body("block", (0.5, 0.4), (cells[0], 3), **material, contact=touched, held=("top",))
    lower = Body("block", (1.5, 0.4), (cells[1], 3), **material, contact=("top",), held=("bottom",), centre=end - 0.75)
    return Scene(0, 0, "blocks", 2, order, 1, simplices, lower, upper, 0.0, friction, swap, tuple(stages))


def march(scene):
    """The model after all stages, the force (N) on the block at each asked-for load, and how many trials were rejected. The
    scene is on each rank by itself."""
    model, forces, rejected = Model(scene), [], 0
    for k, stage in enumerate(scene.stages):
        steps = quasistatic.march(model.problem, model.set_load(k), to=1.0, increments=stage.increments, start=0.0)
        for step in steps:
            rejected += step.rejected
            if step.nominal:
                forces.append(model.pair.force() * (-1 if scene.swap else 1))
    return model, np.array(forces), rejected


PRESS = Stage("press", 2, (0.0, -DEPTH))
AWAY, BACK = Stage("away", 8, (0.8, -DEPTH)), Stage("back", 8, (0.0, -DEPTH))


@pytest.mark.parametrize("sides", [False, True], ids=["bottom", "sides too"])
@pytest.mark.parametrize("swap", [False, True], ids=["block", "slab"])
@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("order, simplices", [(1, False), (2, True)])
def test_past_the_end_and_back(order, simplices, friction, swap, sides):
    """The block clears the slab at x = 0.65, which is between the sixth and the seventh of the eight steps away."""
    scene = block_on_slab(
        [PRESS, AWAY, BACK], swap=swap, sides=sides, friction=friction, order=order, simplices=simplices
    )
    model, forces, rejected = march(scene)
    assert rejected <= 1
    off = slice(8, 11)
    assert np.all(forces[off] == 0.0)
    on, load = np.r_[2:8, 11:18], forces[:, 1].max()
    assert np.all(forces[on, 1] > 0.04 * load)
    assert model.penetration() < 0.05  # of a facet, at the end
    assert model.balance() < 1e-8
    if friction == 0.0:  # no history: the same answers on the way back, as far as they are converged
        assert np.allclose(forces[11:17], forces[7:1:-1], rtol=1e-6, atol=1e-6 * load)
        assert np.allclose(forces[17], forces[1], rtol=1e-6, atol=1e-6 * load)
    else:  # it slides all over, against the motion; the surface is tilted by 0.03 at the end
        ratio = forces[on, 0] / forces[on, 1] * np.r_[-np.ones(6), np.ones(7)]
        assert np.all(np.abs(ratio - friction) < 0.06)


@pytest.mark.parametrize("sides", [False, True], ids=["bottom", "sides too"])
@pytest.mark.parametrize("swap", [False, True], ids=["block", "slab"])
def test_corners_in_the_middle_of_a_facet(swap, sides):
    """Where on the slab's facets of 0.125 m the block's corners meet them changes the force by less than 3 %; facets of a
    third of the block's width are off by less than 10 % of it (seen: 2.8 % and 1 to 9.7 %, most with the sides)."""
    forces = []
    for shift in (0.0, 0.25, 0.5, 0.75):
        stages = [PRESS]
        scene = block_on_slab(stages, swap=swap, sides=sides, friction=0.0, end=0.65 + shift * 0.125)
        _, force, rejected = march(scene)
        assert rejected == 0
        forces.append(force[-1, 1])
    assert np.ptp(forces) < 0.03 * FORCE
    assert np.allclose(forces, FORCE, rtol=0.1)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "projection, friction",
    [
        ("rays", 0.0),
        ("rays", 0.3),
        ("closest", 0.3),
    ],
)
def test_points_on_vertices_of_flat_cells(projection, friction, order):
    """Cells of 1 : 1000, two target facets per contactor facet, whose middle point is on a vertex: a uniform pressure within
    6 %, the error of the points on facets that do not match."""
    problem, p = blocks(order=order, friction=friction, cells=(8, 4), height=5e-4, projection=projection)
    steps = list(quasistatic.march(problem, p, to=2e4, increments=1, smallest=0.25))
    assert sum(step.iterations for step in steps) <= 4 and sum(step.rejected for step in steps) == 0
    assert np.allclose(problem.pairs[0].state.p, 2e4, rtol=0.06)


@pytest.mark.parametrize("projection", ["rays", "closest"])
def test_matching_flat_cells(projection):
    problem, p = blocks(height=5e-4, projection=projection)
    solver = NewtonSolver(problem, rtol=1e-12)
    (step,) = quasistatic.march(problem, p, to=2e4, increments=1, solver=solver)
    assert step.iterations <= 5 and step.rejected == 0
    assert np.allclose(problem.pairs[0].state.p, 2e4, rtol=1e-8)


@pytest.mark.parametrize("cell", ["line", "triangle", "quadrilateral"])
def test_the_closest_points_normal_at_a_vertex_is_no_noise(cell):
    """Points on vertices but for round-off, which is much far from the origin: no normal in its direction."""
    surface, rng = curved_surface(cell, 1), np.random.default_rng(1)
    inner = np.flatnonzero(~surface.end_nodes)
    for far, noise in ((0.0, 0.0), (0.0, 1e-14), (0.0, 1e-9), (1e5, 1e-11), (1e5, 1e-10)):  # m; facets are 0.3 to 0.5
        X = surface.X + far
        x = np.repeat(X[inner], 20, axis=0)
        x += noise * rng.uniform(-1, 1, x.shape)
        at = project(surface, X, x, CandidateSearch(surface)(x, X))
        assert np.all(at.facing) and np.all(np.abs(at.g) <= 2 * noise + 1e-15 * max(far, 1.0))
        assert np.all(at.ν[:, -1] > 0.5)  # all facets point up
