"""Newton's steps are shortened lest cells be inverted; half of one that leaves no way on is taken back."""

from types import SimpleNamespace

import numpy as np
import pytest
from scenes import beams

from dolfinx_mortar_al import NewtonSolver
from dolfinx_mortar_al.newton import TRAPPED


def solved(monkeypatch, trapped):
    """The result, the displacements that iterations start from and those at the end, as beams are bent by 3 N at once, and
    in the iterations `trapped` steps longer than a sixteenth are taken to invert a cell."""
    problem, P = beams(friction=0.3)
    P.value = 3.0
    starts, checks, guard = [], 0, NewtonSolver._guard

    def noted(self, x, y):
        nonlocal checks
        starts.append(x.getNestSubVecs()[0].array_r.copy())
        checks = 0
        return guard(self, x, y)

    def inverted():
        nonlocal checks
        checks += 1
        return 1.0 if len(starts) in trapped and checks <= TRAPPED else 0.0

    with monkeypatch.context() as patch:
        patch.setattr(NewtonSolver, "_guard", noted)
        patch.setattr(problem, "inverted_volume", inverted)
        result = NewtonSolver(problem).solve()
    return result, starts, problem.bodies.get()


def test_half_of_a_step_into_a_trap_is_taken_back(monkeypatch):
    """The next iteration starts half way, and the equilibrium is the one that would have been found (1e-9 of the forces)."""
    result, starts, u = solved(monkeypatch, trapped=(2,))
    assert result.converged
    assert np.allclose(starts[2], (starts[0] + starts[1]) / 2, rtol=0.0, atol=1e-12)
    undisturbed, _, other = solved(monkeypatch, trapped=())
    assert undisturbed.converged
    assert np.allclose(u, other, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("again", [3, 4])
def test_a_second_trap_ends_the_solve(monkeypatch, again):
    """At once, as steps that are cut to less and less have seldom led on; what is said is why."""
    result, starts, _ = solved(monkeypatch, trapped=(2, again))
    assert not result.converged and len(starts) == again
    assert "would leave an inverted cell" in result.message


@pytest.mark.one_rank
@pytest.mark.parametrize(
    "pressures, violations, obeys",
    [((0.0, 1e4), (3e-5, 0.0), True), ((0.0, 0.0), (3e-5, 0.0), False), ((1.0, 1e4), (3e-5, 0.0), False)],
)
def test_a_last_point_that_round_off_pulls(monkeypatch, pressures, violations, obeys):
    """In a pair in which nothing presses it is judged by the other's pressures: as a share of none it kept a solve, of four
    rollers at their first contact, that had converged to 9e-12 going for 30 iterations."""
    solver = NewtonSolver(beams()[0])
    pairs = [
        SimpleNamespace(largest_pressure=lambda p=p: p, violation=lambda v=v: v)
        for p, v in zip(pressures, violations, strict=True)
    ]
    monkeypatch.setattr(solver.problem, "pairs", pairs)
    assert solver._obeys_law() == obeys
