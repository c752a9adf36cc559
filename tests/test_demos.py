"""Each demo runs, with a number to hold it to."""

import argparse
import importlib.util
import json
import sys

import flattened_ring
import numpy as np
import press_and_drag
import pytest
import tutorial
import two_beams
import two_membranes
import two_rings
import ufl
from dolfinx import fem
from mpi4py import MPI
from scenes import marked

from dolfinx_mortar_al import command_line, read_msh
from meshes.gmsh_session import distribute
from meshes.two_bars import TwoBars
from meshes.two_beams import TwoBeams


def run(monkeypatch, directory, *arguments):
    monkeypatch.setattr(sys, "argv", ["two_beams.py", "--output", str(directory), *arguments])
    args = two_beams.options()
    return two_beams.simulate(args, args.friction[0], directory)


def test_two_beams_reach_the_known_deflection(monkeypatch, shared_path):
    """Q2 40×4: scenes' −0.5854 at 10 N and −0.7796 at 20 N of the 80×8 mesh, within 4e-4."""
    history, cells, contact = run(monkeypatch, shared_path, "--friction", "0", "--increments", "2", "--paraview")
    assert history.column("tip_uy") == pytest.approx([-0.5854, -0.7796], abs=4e-4)
    assert (shared_path / "displacement.bp").exists()
    if MPI.COMM_WORLD.rank == 0:
        on_disk = np.genfromtxt(shared_path / "history.csv", delimiter=",", names=True)
        assert on_disk.dtype.names == tuple(two_beams.COLUMNS)
        assert on_disk["tip_uy"].tolist() == history.column("tip_uy").tolist()
        said = json.loads((shared_path / "summary.json").read_text())
        assert said["newton_iterations"] == history.column("newton_iterations").sum()
        assert said["unknowns"] == {"u": 2916, "multiplier of contact": 41}
        two_beams.draw({0.0: (history, cells, contact)}, shared_path)
        assert (shared_path / "figure1.png").stat().st_size > 10_000
        # without friction the tip carries the contact: 95 % of the force
        at_tip = contact.X[:, 0] > 0.9
        assert contact.pressure[at_tip].sum() > 0.9 * contact.pressure.sum()


def test_two_beams_with_friction(monkeypatch, shared_path):
    """μ = 0.3: sliding all over, less deflection than without friction (a regression; of 1 to 20 steps)."""
    history, *_ = run(monkeypatch, shared_path, "--friction", "0.3", "--increments", "2", "--load", "10")
    assert history.column("tip_uy")[-1] == pytest.approx(-0.5802, abs=4e-4)


def test_two_membranes_lock_and_say_so(monkeypatch, shared_path, capsys):
    """μ = 0.5 towards 5420 Pa with 40 cells: ends at the lock, 4670.9 Pa, within 0.5 %, and writes what it promises."""
    arguments = ["--friction", "0.5", "--pressure", "5420", "--cells", "40", "40", "--output", str(shared_path)]
    monkeypatch.setattr(sys, "argv", ["two_membranes.py", *arguments])
    case = (0.5, 1.0, 5420.0)
    history, curves, contact = two_membranes.simulate(two_membranes.options(), case, shared_path)
    assert history.column("pressure")[-1] == pytest.approx(4670.9, rel=5e-3)
    assert history.columns == two_membranes.COLUMNS
    assert np.all(np.diff(history.column("mid_uy")) > 0)
    if MPI.COMM_WORLD.rank == 0:
        said = json.loads((shared_path / "summary.json").read_text())
        assert "the membranes lock" in said["parameters"]["end"]
        assert "the membranes lock" in capsys.readouterr().out
        two_membranes.draw({case: (history, curves, contact)}, shared_path)
        assert (shared_path / "figure2.png").stat().st_size > 10_000


def test_flattened_ring_carries_what_presses_it(monkeypatch, shared_path):
    """Before the bore closes the ring is a soft spring; then the plates' force climbs tenfold in the last 2 % of the radius,
    and the bore carries it: its largest pressure is one to three times the force over the closed length."""
    arguments = ["--size", "0.015", "--increments", "10", "--order", "1", "--output", str(shared_path)]
    monkeypatch.setattr(sys, "argv", ["flattened_ring.py", *arguments])
    history, states = flattened_ring.simulate(flattened_ring.options(), shared_path)
    force, area = history.column("force"), history.column("bore_area")
    closed = area > 0
    assert closed[-1] and not closed[: len(closed) // 2].any()
    assert force[-1] > 10 * force[~closed].max()
    assert 1.0 < history.column("bore_pressure")[-1] * area[-1] / force[-1] < 3.0  # peak over mean
    assert len(states) == 4


def test_two_rings_keep_momenta_and_energy(monkeypatch, shared_path):
    """Coarse, until they part for a while: momenta of both together to 1e-10, energies and losses add up to 1e-10."""
    arguments = ["--size", "0.02", "--step", "1e-3", "--time", "0.03", "--output", str(shared_path), "--animate"]
    monkeypatch.setattr(sys, "argv", ["two_rings.py", *arguments])
    history, frames = two_rings.simulate(two_rings.options(), shared_path)
    total = sum(history.column(name) for name in [*two_rings.ENERGIES, "contact"]) - history.column("energy_defect")
    assert np.ptp(total) < 1e-10 * total[0]
    for name in ("momentum_x", "angular_momentum"):
        values = history.column(name)
        assert np.ptp(values) < 1e-10 * abs(values[0])
    both = history.column("spin_1") + history.column("spin_2")
    assert both == pytest.approx(history.column("angular_momentum"), rel=1e-10)
    assert history.column("spin_2")[-1] < -0.5  # N m s, from 0: the second ring was hit off-centre
    assert history.column("friction_dissipation")[-1] > 0.01 * total[0]
    assert history.column("penetration").max() < 0.1 * 0.02
    if MPI.COMM_WORLD.rank == 0:
        on_disk = np.genfromtxt(shared_path / "history.csv", delimiter=",", names=True)
        assert on_disk.dtype.names == tuple(two_rings.COLUMNS)
        assert len(frames) == 30
        two_rings.draw(history, shared_path)
        assert (shared_path / "figure5.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "unknown"),
    [
        (["-contact_snes_monitor", "--frictoin", "0.1"], "--frictoin, 0.1"),
        (["--cells", "40", "4", "4"], "4"),
        (["-contact_ksp_rtol", "1e-8", "2"], "2"),
    ],
)
def test_what_is_neither_an_option_nor_petscs_is_refused(monkeypatch, capsys, words, unknown):
    monkeypatch.setattr(sys, "argv", ["two_beams.py", *words])
    with pytest.raises(SystemExit):
        two_beams.options()
    assert f"unknown: {unknown};" in capsys.readouterr().err


def test_petscs_options_are_left_to_it():
    parser = argparse.ArgumentParser()
    parser.add_argument("--friction", type=float)
    words = ["-contact_snes_monitor", "--friction", "0.1", "-contact_ksp_rtol", "1e-8", "-contact_shift", "-1"]
    args, rest = command_line.split(parser, words)
    assert args.friction == 0.1
    assert rest == ["-contact_snes_monitor", "-contact_ksp_rtol", "1e-8", "-contact_shift", "-1"]
    assert command_line.split(parser, [])[1] == []


def test_a_mesh_file_of_ones_own(shared_path):
    """The builder's .msh, read back in parallel with its tags."""
    beams = TwoBeams(along=(4, 5), across=2)
    path = shared_path / "beams.msh"
    if MPI.COMM_WORLD.rank == 0:
        import gmsh

        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Verbosity", 1)
        beams.build(gmsh)
        gmsh.write(str(path))
        gmsh.finalize()
    MPI.COMM_WORLD.Barrier()
    mesh, cells, facets = read_msh(path)
    assert mesh.topology.index_map(2).size_global == 4 * 2 + 5 * 2
    owned = mesh.topology.index_map(1).size_local
    count = MPI.COMM_WORLD.allreduce(int(np.sum(facets.find(13) < owned)))
    assert count == 5
    assert (
        MPI.COMM_WORLD.allreduce(len(np.intersect1d(cells.find(1), np.arange(mesh.topology.index_map(2).size_local))))
        == 8
    )


@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("builder", [TwoBeams, TwoBars])
@pytest.mark.parametrize("dim", [2, 3])
def test_boxes_are_the_same_with_and_without_gmsh(builder, dim, simplices):
    """As many cells of each body, and of each group of facets the same area and centre, to round-off."""
    built = builder(dim=dim, triangles=simplices)
    comm, said = MPI.COMM_WORLD, []
    for mesh, cells, facets in (built.create(comm), distribute(built.build, comm, dim)):
        owned, x = mesh.topology.index_map(dim).size_local, ufl.SpatialCoordinate(mesh)
        count = [comm.allreduce(int(np.sum(cells.find(tag) < owned))) for tag in (1, 2)]
        tags, one = np.unique(np.concatenate(comm.allgather(facets.values))), fem.Constant(mesh, 1.0)
        groups = [marked("ds", mesh, facets, tag) for tag in tags]
        forms = [fem.form(f * ds) for ds in groups for f in (one, *(one * x[i] for i in range(dim)))]
        said.append((count, tags, [comm.allreduce(fem.assemble_scalar(form)) for form in forms]))
    (count, tags, moments), expected = said[0], said[1]
    assert count == expected[0] and np.array_equal(tags, expected[1])
    assert np.allclose(moments, expected[2], rtol=1e-12, atol=1e-12)


def test_solid_cells_say_the_dimension_of_space(shared_path):
    path = shared_path / "solid.msh"
    if MPI.COMM_WORLD.rank == 0:
        import gmsh

        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Verbosity", 1)
        TwoBeams(along=(2, 3), across=1, dim=3).build(gmsh)
        gmsh.write(str(path))
        gmsh.finalize()
    MPI.COMM_WORLD.Barrier()
    assert read_msh(path)[0].geometry.dim == 3
    with pytest.raises(ValueError, match="cells of dimension 3 in space of dimension gdim = 2"):
        read_msh(path, gdim=2)


def test_tutorial_ends_in_sliding(monkeypatch, shared_path):
    """On a coarse mesh: the whole sole slides at last, and the base is dragged by μ = 0.4 of what it bears, to a tenth, as
    pressure on the sole's inclined edge has a part along the drag. All files are there."""
    if importlib.util.find_spec("pyvista") is None:
        monkeypatch.setattr(tutorial.output, "picture", lambda problem, path, *_, **__: path.touch())
    drag, press = tutorial.main(shared_path, size=0.008)
    assert press > 80 and drag / press == pytest.approx(0.4, rel=0.1)
    wanted = {"pressed.png", "dragged.png", "pressure.png", "history.csv", "summary.json", "displacement.bp"}
    assert wanted | {"contactor_sole.bp"} <= {file.name for file in shared_path.iterdir()}
    rows = np.genfromtxt(shared_path / "history.csv", delimiter=",", names=True)
    assert rows["path"][-1] == 2.0 and rows["stick"][-1] < 0.05


def test_press_and_drag_slides_by_coulombs_law_and_goes_on_from_a_checkpoint(monkeypatch, shared_path):
    """At the end the zone slips, but for a point or two: the drag is μ = 0.3 times the normal force, but for the zone's slope
    (seen 0.3 %; 3 % with 600 unknowns). The dome that is pressed has no drag but from meshes that are not symmetric."""
    arguments = ["--size", "2000", "--increments", "1", "2", "--no-figure", "--checkpoint"]
    arguments += ["--output", str(shared_path)]
    monkeypatch.setattr(sys, "argv", ["press_and_drag.py", *arguments])
    first = press_and_drag.simulate(press_and_drag.options(), shared_path)
    assert first.column("stick")[-1] < 0.02
    drag, force = first.column("drag"), first.column("normal_force")
    assert drag[-1] == pytest.approx(0.3 * force[-1], rel=0.01)
    assert drag[0] < 0.05 * force[0]
    again = press_and_drag.simulate(press_and_drag.options(), shared_path)
    assert again.column("stage").tolist() == first.column("stage").tolist()
