"""What an installation puts into site-packages, and that it works from there."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

CLONE = Path(__file__).parents[1]

SCRIPT = """
import numpy as np, ufl
from dolfinx import fem, mesh
from mpi4py import MPI
import dolfinx_mortar_al
from dolfinx_mortar_al import Contact, ContactProblem, Surface, materials, obstacles, quasistatic
assert not dolfinx_mortar_al.__file__.startswith({clone!r})
block = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
V = fem.functionspace(block, ("Lagrange", 1, (2,)))
u = fem.Function(V)
sides = [mesh.locate_entities_boundary(block, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, 1.0)]
tags = mesh.meshtags(block, 1, np.sort(sides[0]), np.full(len(sides[0]), 1, dtype=np.int32))
press = fem.Constant(block, (0.0, 0.0))
bc = fem.dirichletbc(press, fem.locate_dofs_topological(V, 1, sides[1]), V)
F = materials.neo_hookean(E=1e3, nu=0.3).virtual_work(u)
floor = obstacles.RigidPlane(point=[0, 0], normal=[0, 1])
problem = ContactProblem(F, u, bcs=[bc], contacts=[Contact(Surface(block, tags, 1), floor, friction=0.3)])
def load(value):
    press.value = (0.0, -value)
for step in quasistatic.march(problem, load, to=0.1, increments=2):
    print(problem.pairs[0].closed_fraction())
"""


@pytest.mark.one_rank
def test_an_installed_copy_works_from_another_folder(tmp_path):
    """The wheel holds the package and nothing else; a scene runs from it, away from the clone."""
    build = f"from setuptools.build_meta import build_wheel; build_wheel({str(tmp_path)!r})"
    source = tmp_path / "source"  # setuptools builds into the folder it builds from
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "dolfinx_mortar_al", "meshes", "exact", "LICENSE"):
        os.symlink(CLONE / name, source / name)
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        tops = {name.split("/")[0] for name in archive.namelist()}
        archive.extractall(tmp_path / "site")
    assert {re.sub(r"-.*", "", top) for top in tops} == {"dolfinx_mortar_al"}
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site")}
    script = SCRIPT.format(clone=str(CLONE))
    run = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["1.0", "1.0"]
