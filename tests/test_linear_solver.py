"""The iterative solver: the answers of the direct one in every state of contact, and what happens where it fails."""

import logging
import resource
from pathlib import Path

import numpy as np
import pytest
import scaling
from petsc4py import PETSc
from scenes import beams, blocks, rough, tip

from dolfinx_mortar_al import NewtonSolver, contact_iteration, linear_solver, quasistatic
from dolfinx_mortar_al.contact_patch import ContactPatch, patch_defaults
from dolfinx_mortar_al.linearised_bulk import LinearisedBulk
from dolfinx_mortar_al.multigrid import Multigrid
from dolfinx_mortar_al.p_multigrid import FirstOrder
from dolfinx_mortar_al.petsc_blocks import without_zeros


def solver(problem, kind, **options):
    """A solver of that kind, to 1e-12 of the forces; each call has options of its own."""
    solver.calls = getattr(solver, "calls", 0) + 1
    prefix = f"trial{solver.calls}_"
    for name, value in {"linear_solver": kind, **options}.items():
        PETSc.Options(prefix)[name] = value
    return NewtonSolver(problem, rtol=1e-12, prefix=prefix)


AT_END = 1e-6  # points follow the target's end to 3e-7 of a facet


def agree(one, other):
    """Displacements of two problems on the same mesh, to AT_END of the largest, and the states of contact."""
    scale = one.comm.allreduce(float(np.abs(one.bodies.get()).max(initial=0.0)), max)
    assert np.allclose(one.bodies.get(), other.bodies.get(), rtol=0.0, atol=AT_END * scale)
    for mine, theirs in zip(one.pairs, other.pairs, strict=True):
        assert mine.closed_fraction() == pytest.approx(theirs.closed_fraction(), abs=AT_END)
        assert np.allclose(mine.force(), theirs.force(), rtol=0.0, atol=AT_END * np.abs(theirs.force()).max())


@pytest.mark.parametrize(
    "order, tetrahedra, friction",
    [(1, False, 0.3), pytest.param(1, True, 0.0, marks=pytest.mark.one_rank), (2, False, 0.3)],
)
def test_pressed_and_dragged_as_with_factors(order, tetrahedra, friction):
    """Open, partly closed, sticking and slipping, all in one scene; FGMRES needs at most 24 iterations to 1e-8 (seen: 17)."""
    row = scaling.Row(400 if order == 1 else 700, order=order, tetrahedra=tetrahedra, friction=friction)
    marches = {}
    for kind in ("direct", "iterative"):
        problem, top = scaling.build(row)
        newton = solver(problem, kind, **({"ksp_rtol": 1e-8} if kind == "iterative" else {}))
        counts = [0]
        newton.snes.getKSP().setMonitor(lambda ksp, n, norm, counts=counts: counts.append(n))
        states = []
        for doing, _ in scaling.press_and_drag(problem, top, newton):
            states.append((doing, problem.pairs[0].closed_fraction(), problem.pairs[0].stick_fraction()))
        marches[kind] = problem, states, newton.linear, max(counts)
    (direct, states, *_), (iterative, same, linear, most) = marches["direct"], marches["iterative"]
    agree(iterative, direct)
    assert np.allclose([s[1:] for s in same], [s[1:] for s in states], atol=AT_END)
    assert any(0.0 < closed < 1.0 for _, closed, _ in states)
    if friction:
        assert any(stick > 0.05 for _, _, stick in states) and any(closed - stick > 0.05 for _, closed, stick in states)
    assert linear.iterative and linear.failures == 0
    assert 0 < most <= 24


def test_open_contact_and_several_pairs():
    """Beams apart; then in contact by two pairs, whose multipliers are one block for the preconditioner."""
    mesh = {"dim": 3, "along": (6, 6), "across": 1}
    for gap, load in ((0.05, 0.05), (0.0, 2.0)):
        problems = []
        for kind in ("direct", "iterative"):
            problem, P = beams(order=1, friction=0.3, mesh=mesh | {"gap": gap}, parts=2)
            for _ in quasistatic.march(problem, P, to=load, increments=1, solver=solver(problem, kind)):
                pass
            problems.append(problem)
        agree(*problems)
        closed = [pair.closed_fraction() for pair in problems[0].pairs]
        assert max(closed) == 0.0 if gap else max(closed) > 0.0


def test_a_block_that_contact_alone_holds():
    problems = []
    for kind in ("direct", "iterative"):
        problem, p = blocks(order=1, dim=3, cells=(3, 4), friction=0.5)
        list(quasistatic.march(problem, p, to=2e4, increments=1, solver=solver(problem, kind)))
        problems.append(problem)
    agree(*problems)


def test_mumps_takes_over_where_fgmres_fails(caplog):
    answers = []
    for kind, options in (("direct", {}), ("iterative", {"ksp_max_it": 1})):
        problem, P = beams(order=1, friction=0.3, mesh={"along": (8, 8), "across": 1})
        newton = solver(problem, kind, **options)
        with caplog.at_level(logging.WARNING, "dolfinx_mortar_al.linear_solver"):
            list(quasistatic.march(problem, P, to=2.0, increments=1, solver=newton))
        answers.append(tip(problem))
    assert np.allclose(*answers, rtol=1e-8)
    assert newton.linear.failures > 0
    if problem.comm.rank == 0:
        assert "MUMPS takes over" in caplog.text
    assert "failed" in str(newton.linear)


def test_no_memory_for_factors_is_said():
    """MUMPS may take 1 MB here and needs more: the trial fails, on all ranks."""
    problem, P = beams(order=2, friction=0.3, mesh={"along": (60, 60), "across": 4})
    P.value = 1.0
    result = solver(problem, "iterative", ksp_max_it=1, direct_mat_mumps_icntl_23=1).solve()
    assert not result.converged
    assert "FGMRES failed" in result.message and "do not fit into the memory" in result.message


def test_the_choice(monkeypatch):
    """By unknowns of bodies in space alone: in the plane fill is no matter."""
    for dim, iterates in ((2, False), (3, True)):
        problem, _ = beams(order=1, mesh={"dim": dim, "along": (4, 4), "across": 1})
        assert not NewtonSolver(problem, prefix="choice_").linear.iterative
        monkeypatch.setattr(linear_solver, "ITERATIVE_ABOVE", 10)
        assert NewtonSolver(problem, prefix="choice_").linear.iterative == iterates
        assert str(problem.linear_solver).startswith("iterative" if iterates else "direct: lu by mumps")
        monkeypatch.undo()
    for name in PETSc.Options("choice_").getAll():  # or PETSc would complain at its end that nothing has used them
        PETSc.Options("choice_").delValue(name)
    PETSc.Options()["wrong_linear_solver"] = "quick"
    with pytest.raises(ValueError, match="wrong_linear_solver quick: must be direct, iterative or auto"):
        NewtonSolver(problem, prefix="wrong_")


def test_order_one_below_order_two():
    """Linear displacements are interpolated exactly, but for prescribed nodes, which stand for themselves."""
    problem, _ = beams(order=2, mesh={"dim": 3, "along": (3, 4), "across": 1})
    first = FirstOrder(problem.bodies)
    problem.u.interpolate(lambda x: 0.1 * x[:3] + 0.05 * x[[1, 2, 0]])
    fine = problem.bodies.layout.vector()
    first.interpolation.mult(first.positions(), fine)
    exact = (problem.bodies.owned_positions() + problem.bodies.get().reshape(-1, 3)).ravel()
    owned = problem.bodies.bodies[0].owned * 3
    free = problem.bodies.bodies[0].prescribed().x.array[:owned] == 0
    near = np.abs(problem.bodies.owned_positions()[:, 0] - problem.bodies.owned_positions()[:, 0].min()) > 0.4
    inside = free & np.repeat(near, 3)
    assert np.allclose(fine.array_r[inside], exact[inside], atol=1e-12)
    problem.u.interpolate(lambda x: rough(1e-3, 1)(x[:3].T).T)
    problem.assemble_residual(problem.x, problem.residual)
    problem.assemble_jacobian()
    product = problem.blocks[0][0].ptap(first.interpolation).getDiagonal()
    assert product.min()[1] > 0


def test_zeros_are_not_stored():
    """Of the coupling of contact, whose pattern has room to spare: the same matrix, with its other entries alone."""
    problem, top = scaling.build(scaling.Row(400))
    newton = solver(problem, "iterative")
    for _ in scaling.press_and_drag(problem, top, newton, steps=(1, 0)):
        pass
    B = problem.blocks[0][1]
    less = without_zeros(B)
    values, kept = B.getValuesCSR()[2], less.getValuesCSR()[2]
    assert np.all(kept != 0.0)
    assert len(kept) == np.count_nonzero(values)
    assert problem.comm.allreduce(len(values) - len(kept)) > 0
    less.axpy(-1.0, B)
    assert less.norm() == 0.0


def test_sliding_asks_no_more_of_multigrid_than_sticking():
    """Contact's nodes are solved exactly, and aggregates hold nodes of one side of the surface alone, so that the coarse
    spaces know the sides' sliding: FGMRES to 1e-8 for a random right-hand side, in the states that the press and the drag
    end in (seen: 18 and 17). Contact settles, and the bulk follows, by 88 applications in two Newton iterations, each of
    which may take 200."""
    problem, top = scaling.build(scaling.Row(1e4))
    newton = solver(problem, "iterative", ksp_rtol=1e-8)
    b, x = problem.x.duplicate(), problem.x.duplicate()
    for part in b.getNestSubVecs():
        part.setRandom()
    counts = {}
    for doing, step in scaling.press_and_drag(problem, top, newton, (1, 1)):
        assert step.rejected == 0
        problem.pack(problem.x)
        problem.assemble_jacobian()
        fgmres = newton.snes.getKSP()
        fgmres.setOperators(problem.matrix)
        fgmres.solve(b, x)
        counts[doing] = fgmres.getIterationNumber()
    assert problem.pairs[0].stick_fraction() == 0.0
    assert counts["dragged"] <= counts["pressed"] <= 19
    assert newton.linear.failures == 0
    assert newton.contact_iteration.solves <= 120


def test_trescas_law_leads_on_where_coulombs_leads_astray():
    """A domed block ten times as stiff as the one below and with the finer mesh, of which pressures alternate, μ = 0.6: with
    Coulomb's law alone the first step of the drag took 82 Newton iterations and a rejected trial on one rank."""
    problem, top = scaling.build(scaling.Row(size=1e4, friction=0.6))
    newton = solver(problem, "iterative")
    for _, step in scaling.press_and_drag(problem, top, newton, (2, 1)):
        assert step.rejected == 0 and step.iterations <= 4
        assert problem.free_bounds == problem.pairs  # Coulomb's law is what has converged
    assert newton.contact_iteration.steps <= 90


def test_what_semi_smooth_steps_leave_is_freed_on_all_ranks():
    """On several ranks PETSc keeps what Python has let go of until all ask for it to be freed; without that thirty
    semi-smooth steps of this size keep 140 MB on two ranks, and a march of four steps at 1e5 unknowns 3 GB."""
    problem, top = scaling.build(scaling.Row(5e3))
    newton = solver(problem, "iterative")
    for _ in scaling.press_and_drag(problem, top, newton, steps=(1, 0)):
        pass
    bulk = LinearisedBulk(problem)

    def resident(renewals):
        for _ in range(renewals):
            newton.linear.renew_contact(bulk.renew())
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return problem.comm.allreduce(pages) * resource.getpagesize() / 2**20

    warm = resident(5)
    assert resident(30) - warm < 40.0


@pytest.mark.parametrize("friction", [0.3, 0.0])
def test_contacts_patch_leaves_no_residual_in_it(friction):
    """Its solution for any right-hand side fulfils the gaps' equations, and those of its nodes; what it leaves elsewhere is
    what it says, with contact as assembled and as the linearised bulk has it."""
    problem, top = scaling.build(scaling.Row(400, friction=friction))
    newton = solver(problem, "iterative")
    for _ in scaling.press_and_drag(problem, top, newton, steps=(1, 1)):
        pass
    problem.assemble_jacobian()
    for name, value in patch_defaults(problem).items():
        PETSc.Options(f"patch_{friction}_")[name] = value
    patch, bulk = ContactPatch(problem, f"patch_{friction}_"), LinearisedBulk(problem)
    for matrix in (problem.matrix, bulk.renew()):
        patch.renew(matrix.getNestSubMatrix(0, 0))
        b, x, r, left = *(problem.x.duplicate() for _ in range(3)), problem.bodies.layout.vector()
        for part in b.getNestSubVecs():
            part.setRandom()
        patch.solve(b, x, left)
        matrix.mult(x, r)
        r.aypx(-1.0, b)
        forces, gaps = r.getNestSubVecs()
        scale = b.norm()
        assert gaps.norm() < 1e-9 * scale
        forces.axpy(-1.0, left)
        assert forces.norm() < 1e-9 * scale
        in_patch = problem.comm.allreduce(int(np.sum(left.array_r == 0.0)))
        assert 0 < in_patch < left.getSize()


def test_factors_of_another_state_of_contact_serve_with_the_patch(monkeypatch):
    """Where contact has changed GMRES needs a third of the solves when the patch goes first (seen: 2 for 9)."""
    monkeypatch.setattr(linear_solver, "PATCHED_ABOVE", 0)
    problem, top = scaling.build(scaling.Row(2e3))
    newton = solver(problem, "direct")
    for _ in scaling.press_and_drag(problem, top, newton, steps=(1, 0)):
        pass
    problem.pack(problem.x)
    problem.assemble_jacobian()
    factors = newton.snes.getKSP()
    factors.setOperators(problem.matrix)
    factors.setUp()
    newton.linear.forget()
    bulk, before = LinearisedBulk(problem), problem.contact_pattern()
    problem.bodies.set(1.1 * problem.bodies.get())  # more points close
    problem.evaluate()
    problem.decide(problem.residual)
    assert problem.contact_pattern() != before
    matrix = bulk.renew()
    b, x = problem.x.duplicate(), problem.x.duplicate()
    b.set(0.0)
    b.getNestSubVecs()[1].setRandom()
    b.assemble()
    counts = []
    for is_patched in (False, True):
        if is_patched:
            newton.linear.renew_contact(matrix)
        gmres = PETSc.KSP().create(problem.comm)
        gmres.setType("gmres")
        gmres.setOperators(matrix)
        gmres.setTolerances(rtol=1e-3, max_it=100)
        gmres.setGMRESRestart(100)
        gmres.getPC().setType("python")
        gmres.getPC().setPythonContext(contact_iteration._Inverse(newton.linear))
        gmres.solve(b, x)
        assert gmres.getConvergedReason() > 0
        counts.append(gmres.getIterationNumber())
    plain, patched = counts
    assert 3 * patched <= plain


def test_coarse_spaces_follow_the_bodies_rotations(monkeypatch):
    """They are chosen at the start, and again when a body has moved by a tenth of its size; not for each Newton solve."""
    chosen, choose = [0], Multigrid._choose
    monkeypatch.setattr(Multigrid, "_choose", lambda self, A: (chosen.append(1), choose(self, A))[1])
    problem, top = scaling.build(scaling.Row(400))
    steps = list(scaling.press_and_drag(problem, top, solver(problem, "iterative")))
    assert len(steps) == 6
    assert sum(chosen) == 2
