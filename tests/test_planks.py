"""Loose bodies on loose bodies: they come down together before anything resists."""

import planks
import pytest
from planks import Scene

from dolfinx_mortar_al import quasistatic


@pytest.mark.parametrize("scene", [
    pytest.param(Scene(along=30, off=1.0, young=1e6), marks=pytest.mark.one_rank),
    pytest.param(
        Scene(order=2, cell="triangle", along=10, across=3, block=6, off=-1.75, young=7e7), marks=pytest.mark.one_rank
    ),
    Scene(along=34, block=2, off=1.11, young=6e7, friction=0.8, increments=2),
], ids=str)  # fmt: skip
def test_a_block_lies_on_a_plank_on_two_cylinders(scene):
    """Statics of a straight plank gives what the cylinders bear, to 1 % of the weight (seen: .05 % at most). Both bodies are
    thrown about by Newton's first trial, and let down instead; once they lie there no trial is rejected."""
    problem, steps = planks.march(scene)
    forces = [problem.pairs[k].force()[1] for k in (0, 1)]
    assert forces == pytest.approx(scene.expected, abs=planks.RIGHT * sum(scene.expected))
    assert problem.pairs[0].force()[0] + problem.pairs[1].force()[0] == pytest.approx(0.0, abs=1e-3 * sum(forces))
    assert all(step.rejected == 0 for step in steps[1:])
    assert sum(step.iterations for step in steps) < 150  # seen: 83 at most


def test_what_finds_no_first_equilibrium_has_no_friction_in_use():
    """There is no state in which it could be: the block's friction on a plank that nothing holds up."""
    problem, weights = planks.build(Scene(friction=0.3))
    for contact in problem.pairs[:2]:
        contact.target.obstacle.move([0.0, -50.0])

    def lay_on(share):
        for weight in weights:
            weight.value = 1e3 * share

    with pytest.raises(quasistatic.StepFailure) as failure:
        list(quasistatic.march(problem, lay_on, to=1.0, increments=1, smallest=0.5))
    assert "friction that its pressure allows" not in str(failure.value)
    assert "contact alone holds" in str(failure.value)
