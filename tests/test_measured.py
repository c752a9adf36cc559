"""What the pages say is what the files of the runs behind them say."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import parts, work_precision
from demos import report_kept

pytestmark = pytest.mark.one_rank

ROOT = Path(__file__).resolve().parents[1]
FULL_RUN = ROOT / "docs" / "full_run"


def rows(name):
    return work_precision.load(name)


def test_the_pages_are_those_of_the_files():
    assert (ROOT / "docs" / "work_precision.md").read_text() == work_precision.page()
    with (work_precision.FOLDER / "parts.csv").open() as file:
        assert (ROOT / "docs" / "parts.md").read_text() == parts.page(list(csv.DictReader(file)))
    assert (ROOT / "docs" / "full_run.md").read_text() == report_kept.page(FULL_RUN)


@pytest.mark.parametrize("name", work_precision.SCENES)
def test_every_row_of_the_sweeps_is_there(name):
    wanted = {(f, float(m)) for f, s in work_precision.SCENES[name].families.items() for m in s["meshes"]}
    assert {(row["family"], row["mesh"]) for row in rows(name)} == wanted


def test_errors_fall_with_the_mesh():
    """Each family of the beams and bars gets better with the mesh, at the elements' order or the wave's."""
    for name, least in (("beams", 1.3), ("bars", 0.5)):
        found = rows(name)
        error, _ = work_precision.errors(work_precision.SCENES[name], found)
        for family in work_precision.SCENES[name].families:
            e = np.array([x for x, row in zip(error, found, strict=True) if row["family"] == family])
            h = np.array([1 / row["mesh"] for row in found if row["family"] == family])
            assert np.polyfit(np.log(h), np.log(e), 1)[0] > least


def test_readme_quotes_the_measured_ratio():
    """Processor time of GetFEM's beams over ours on the same mesh, and that the error is no larger."""
    found = rows("beams")
    error, _ = work_precision.errors(work_precision.SCENES["beams"], found)
    at = {(row["family"], row["mesh"]): (row["seconds"], e) for row, e in zip(found, error, strict=True)}
    ours, peer = next(iter(work_precision.SCENES["beams"].families)), f"{work_precision.GETFEM}1"
    ratios = []
    for mesh in (4.0, 8.0):
        (mine, my_error), (its, its_error) = at[ours, mesh], at[peer, mesh]
        assert my_error < 1.1 * its_error
        ratios.append(f"{its / mine:.1f}")
    assert f"processor time of whole processes | {ratios[0]}, {ratios[1]} |" in (ROOT / "README.md").read_text()


def table(name, **where):
    """Rows of the full run's tables of a command, those whose columns have these texts."""
    found = []
    for path in sorted(FULL_RUN.glob(f"{name}.[0-9]*.csv")):
        head, *lines = report_kept.read(path)
        found += [dict(zip(head, line, strict=True)) for line in lines if len(line) == len(head)]
    return [row for row in found if all(row.get(column) == text for column, text in where.items())]


def quoted(start):
    """The second cell of README's line of measured results that begins with this."""
    (line,) = re.findall(rf"^\| {re.escape(start)}.*$", (ROOT / "README.md").read_text(), flags=re.M)
    return line.split("|")[2].strip()


def test_readme_quotes_the_full_run():
    (midpoint,) = table("membranes", **{"μ": "0", "p (Pa)": "4023", "element": "P2", "cells": "160"})
    assert float(quoted("two membranes")) == float(midpoint["midpoint"])
    losses = {row["cells per bar"]: row["impact loss"].split()[0] for row in table("bars") if "v₁ (m/s)" in row}
    assert quoted("two bars") == f"{losses['20']}, {losses['40']}, {losses['80']} %"
    above, spin = map(float, quoted("two discs").split(","))
    discs = table("discs")
    assert len(discs) == 30
    assert max(float(row["E/E₀ − 1, largest"]) for row in discs) == above
    assert max(float(row["angular momentum"]) for row in discs) == spin
    assert max(float(row["deepest"].rstrip("%")) for row in discs) < 1.0
    patches = [row["segments (points)"].split()[0] for row in table("patch") if "segments (points)" in row]
    assert max(map(float, patches)) == float(quoted("patch test"))
    (reversals,) = [row for row in table("extremes") if "load reversals" in row["case"]]
    assert f"the same to {float(quoted('stuck blocks')):.1e} " in reversals[""]


def test_the_full_run_has_nothing_wrong():
    """Every command ended well: no case of the verification misses its tolerance, no extreme one is wrong or fails."""
    commands = report_kept.read(FULL_RUN / "commands.csv")[1:]
    assert [name for name, *_, status, _ in commands if status != "0"] == []
    assert {row["verdict"] for row in table("extremes")} <= {"right", "right with rejections", "refused", "warned"}
    assert {row[""] for row in table("verify")} == {"ok"}


def test_extrapolation_of_a_known_limit():
    """A quantity 1 + h² on meshes 1 and 2: the limit is found, and the coarse run's error is 1."""
    scene = work_precision.Scene("", "", {"a": {"meshes": (1, 2)}}, lambda n, s: ([], {}), reference=("a", 1, 2))
    made = [{"family": "a", "mesh": n, "value": json.dumps([1 + n**-2.0])} for n in (1.0, 2.0)]
    error, uncertain = work_precision.errors(scene, made)
    assert error == pytest.approx([1.0, 0.25], rel=1e-12)
    assert uncertain == pytest.approx(0.25, rel=1e-12)
