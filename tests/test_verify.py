"""The verification suite on its quick meshes."""

import numpy as np
import pytest
from mpi4py import MPI

from dolfinx_mortar_al.verify import CASES
from dolfinx_mortar_al.verify.__main__ import ORDER, main
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case, rows
from dolfinx_mortar_al.verify.hertz import Ball, Cylinders
from dolfinx_mortar_al.verify.mindlin import MU, Partial
from dolfinx_mortar_al.verify.rings import contact_pressure


def test_every_case_is_on_the_command_line():
    assert sorted(ORDER) == sorted(CASES)
    assert all(case.description and case.quantities for case in CASES.values())


ON_RANKS = ("patch-2d", "patch-3d", "rings", "hertz-plane", "incline")  # flat and curved, in the plane and in space


def test_quick_suite_and_its_page(shared_path, capsys):
    """Every quantity within its tolerance; a page and a picture per case. On several ranks some of the cases: the time of all
    is that of a tenth of the suite."""
    names = ORDER if MPI.COMM_WORLD.size == 1 else ON_RANKS
    chosen = [] if names is ORDER else [word for name in names for word in ("--case", name)]
    lines = main(["--quick", *chosen, "--report", str(shared_path)])
    assert {line.case for line in lines} == {name for name in names if CASES[name].quick}
    assert [f"{line.case}, {line.quantity.name}" for line in lines if not line.hit] == []
    if MPI.COMM_WORLD.rank == 0:
        page = (shared_path / "verification.md").read_text()
        assert all(f"--case {line.case}" in page for line in lines)
        assert all((shared_path / "verification" / f"{line.case}.png").stat().st_size > 5000 for line in lines)
        assert f"of {len(lines)} quantities within tolerance" in capsys.readouterr().out


def test_references_are_consistent():
    """The formulae against the loads that they must balance, by quadrature, and the printed values."""
    assert contact_pressure(1e9, 1e9) == pytest.approx(925925.93, rel=1e-8)
    line = Cylinders(1 / (0.91 / 210e3 + 0.91 / 70e3), 50.0, 35e3)
    assert line.half_width == pytest.approx(6.21, abs=5e-3)
    assert line.peak == pytest.approx(3585.37, rel=1e-5)
    ball = Ball(1.40625e7 / (1 - 0.25**2), 1.0, 4 / 3 * 1.5e7 * 0.1**3)  # d = a²/R = 0.01
    assert ball.radius == pytest.approx(0.1, rel=1e-12)
    assert ball.peak == pytest.approx(9.55e5, rel=1e-3)
    x = np.linspace(-1, 1, 200001)
    for share in (0.3, 0.8):
        strip = Partial(1.0, 1.0, share, 2)
        ratio = np.trapezoid(strip.traction(x), x) / np.trapezoid(strip.pressure(x), x)
        assert ratio == pytest.approx(share * MU, rel=1e-4)
        disc = Partial(1.0, 1.0, share, 3)
        r = np.linspace(0, 1, 200001)
        ratio = np.trapezoid(r * disc.traction(r), r) / np.trapezoid(r * disc.pressure(r), r)
        assert ratio == pytest.approx(share * MU, rel=1e-4)


def test_a_missed_tolerance_shows():
    """Errors, orders, tolerances on coarse meshes, and misses of a made-up case."""
    quantities = [Quantity("first", "", 0.02), Quantity("exact", "", 1e-10, scale=1.0, order=0)]

    @case("made up", "Made up", quantities)
    def made_up(quick):
        """Nothing."""
        return Outcome([run(0.2), run(0.1)], coarse=2.0)

    def run(h):
        return Run(f"{h}", h, {"first": (2 + h**2, 2.0), "exact": (1e-3, 0.0)}, Effort(), 0)

    try:
        first, exact = rows(CASES["made up"], made_up(True))
    finally:
        del CASES["made up"]
    assert (first.order, first.tolerance) == (pytest.approx(2.0), 0.04)
    assert (first.hit, first.verdict, exact.hit, exact.verdict) == (True, "ok", False, "MISS")
    assert exact.tolerance == 1e-10
