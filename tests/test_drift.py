"""The monitor of a drift: what it finds where the books do not close, and nothing where they do."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, dynamics, materials, monitors, obstacles
from dolfinx_mortar_al.drift import DEPTH, SHARE, DriftMonitor

SIDE, DENSITY, STEP = 0.1, 1000.0, 1e-3


def block(*, load=0.0, booked=False, obstacle=False, clamp=None, form=False, **scheme):
    """A square that turns and flies, with a load (N/m³) upwards that the Motion knows of if `booked`; with `clamp` its left
    side is prescribed: (problem, motion)."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [[0, 0.01], [SIDE, SIDE + 0.01]], [3, 3])
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    work = load * ufl.TestFunction(u.function_space)[1] * materials.cell_measure(u)
    external = work if booked else None
    law = materials.neo_hookean(1e6, 0.3)
    material = law.virtual_work(u) if form else law
    motion = dynamics.Motion(u, material, density=DENSITY, step=STEP, external=external, **scheme)
    motion.velocity.interpolate(lambda x: np.array([1.0 - 5 * x[1], 5 * x[0]]))
    if load and not booked:
        motion.residual -= work
    bcs, contacts = [], []
    if clamp is not None:
        left = mesh.locate_entities_boundary(domain, 1, lambda x: x[0] < 1e-9)
        dofs = fem.locate_dofs_topological(u.function_space, 1, left)
        bcs = [fem.dirichletbc(clamp, dofs, u.function_space)]
    if obstacle:
        low = mesh.locate_entities_boundary(domain, 1, lambda x: x[1] < 0.01 + 1e-9)
        tags = mesh.meshtags(domain, 1, low, np.full(len(low), 1, dtype=np.int32))
        contacts = [Contact(Surface(domain, tags, 1), obstacles.RigidPlane([0, 0], [0, 1]))]
    return ContactProblem(motion, bcs=bcs, contacts=contacts), motion


def found(problem, motion, steps=10, move=None):
    """Names of all that is found in a march, without units."""
    march = dynamics.march(problem, to=steps * STEP, move=move)
    return {finding.name.split(" gained")[0] for step in march for finding in step.findings}


def test_a_load_that_the_motion_does_not_know():
    """It gives energy and momentum that no book has: both are found, with a warning on rank 0; the run goes on."""
    problem, motion = block(load=3e3)
    if problem.comm.rank == 0:
        with pytest.warns(monitors.ModelWarning, match="energy gained .*external="):
            names = found(problem, motion)
    else:
        names = found(problem, motion)
    assert {"energy", "momentum"} <= names


@pytest.mark.parametrize(
    "options", [{}, {"load": 3e3, "booked": True}, {"obstacle": True, "load": -3e4, "booked": True}]
)
def test_nothing_where_books_close(options):
    """Free flight, a load that is known, a fall onto a plane."""
    assert found(*block(**options)) == set()


def test_a_driven_side_gives_energy():
    """The work of a support that moves is in the ledger: no drift."""
    clamp = fem.Constant(mesh.create_unit_square(MPI.COMM_SELF, 1, 1), np.zeros(2))
    problem, motion = block(clamp=clamp)
    assert found(problem, motion, move=lambda t: clamp.value.__setitem__(1, 2 * t)) == set()


@pytest.mark.parametrize(
    "way, said",
    [
        (lambda t: max(0.0, t - 3e-3), True),
        (lambda t: 0.05 * np.sin(300 * t), False),
        (lambda t: 1e-16 * max(0.0, t - 3e-3), False),
    ],
)
def test_supports_that_start_at_once_are_said_to_swing(way, said):
    """A clamp that stands until .003 s and then moves at 1 m/s has 0 and 2 m/s in turns; one that is shaken, a period in 21
    steps, has the velocity of its way; one that stands has round-off, beside bodies that move."""
    u = block()[1].u
    left = mesh.locate_entities_boundary(u.function_space.mesh, 1, lambda x: x[0] < 1e-9)
    dofs = fem.locate_dofs_topological(u.function_space, 1, left)
    clamp = fem.Constant(u.function_space.mesh, np.zeros(2))
    body = Body(
        u, materials.neo_hookean(1e6, 0.3), density=DENSITY, bcs=[fem.dirichletbc(clamp, dofs, u.function_space)]
    )
    motion = dynamics.Motion(body, step=STEP)
    motion.velocity.interpolate(lambda x: np.stack([0.0 * x[0], x[0]]))

    def move(t):
        clamp.value[1] = way(t)

    names = found(ContactProblem(motion), motion, move=move)
    assert ("prescribed velocity's swing (m/s)" in names) == said


def test_energy_that_comes_and_goes_leaves_its_round_off():
    """Put in by a support and taken out again, from rest: what is left beside it is none, and no momentum either."""
    problem, _ = block()
    rest = dynamics.Ledger(0.0, 0.0, momentum=(0.0, 0.0), angular_momentum=(0.0,))
    watch = DriftMonitor(problem, rest)
    assert watch.look(replace(rest, kinetic=20.0, external_work=20.0), []) == []
    left = replace(rest, energy_defect=1e-14, momentum=(1e-14, 0.0), angular_momentum=(1e-15,))
    assert watch.look(left, []) == []
    names = [finding.name for finding in watch.look(replace(rest, energy_defect=1e-4), [])]
    assert names == ["energy gained (J)"]


@pytest.mark.parametrize(
    "scheme, own",
    [
        ({}, False),
        ({"theta": 0.7}, False),  # which loses energy
        ({"force": "trapezoidal"}, True),
        ({"form": True}, False),
        ({"form": True, "theta": 0.7}, True),
    ],
)
def test_a_gain_may_be_the_schemes_own(scheme, own):
    """Where a step's forces do not do the work that is booked, the finding does not say that a load was forgotten."""
    problem, _ = block(**scheme)
    start = dynamics.Ledger(2.0, 1.0, momentum=(0.0, 0.0), angular_momentum=(0.0,))
    (finding,) = DriftMonitor(problem, start).look(replace(start, energy_defect=1e-2), [])
    assert ("trapezoidal" in finding.meaning) == own
    assert ("the ledger has no source of it" in finding.meaning) != own


def test_bounds():
    """Each quantity is found beyond its bound and not below; momenta not where an obstacle may change them."""
    for obstacle in (False, True):
        problem, motion = block(obstacle=obstacle)
        start = dynamics.Ledger(2.0, 1.0, momentum=(1.0, 0.0), angular_momentum=(0.1,))
        watch = DriftMonitor(problem, start)
        momentum = np.sqrt(2 * 3.0 * motion.mass)
        reach = SIDE + 0.01
        size = problem.pairs[0].target.size if obstacle else 0.0
        seen = {"energy", "penetration"} if obstacle else {"energy", "momentum", "angular momentum"}
        for factor in (0.9, 1.1):
            s = factor * SHARE
            drifts = {
                "energy": {"energy_defect": 3.0 * s},
                "momentum": {"momentum": (1.0, s * momentum)},
                "angular momentum": {"angular_momentum": (0.1 - s * momentum * reach,)},
                "penetration": {},
            }
            for name, drift in drifts.items():
                depth = factor * DEPTH * size * (not drift)
                names = [f.name for f in watch.look(replace(start, **drift), [depth] * obstacle)]
                assert len(names) == (factor > 1 and name in seen), (name, factor)
                assert all(name in text for text in names)


@pytest.mark.parametrize("spin", [20.0, pytest.param(1.0, marks=pytest.mark.one_rank)])
def test_a_stiff_bar_spins_on_above_a_plane(spin):
    """Steel, 0.1 m long, 5 m above a plane that it does not touch: round-off of positions there made much of what Newton left
    count as none, which added up (angular momentum 6e-7, energy 1e-6 in 100 steps, and a finding of a load); now 1e-8. The
    stored energy's own round-off, 1e-7 of what the slower bar has, is no finding either."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [[0, 0], [0.1, 0.04]], [4, 2])
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    motion = dynamics.Motion(u, materials.neo_hookean(2.1e11, 0.3), density=7800.0, step=STEP)
    motion.velocity.interpolate(lambda x: spin * np.array([0.02 - x[1], x[0] - 0.05]))
    low = mesh.locate_entities_boundary(domain, 1, lambda x: x[1] < 1e-9)
    surface = Surface(domain, mesh.meshtags(domain, 1, low, np.full(len(low), 1, dtype=np.int32)), 1)
    problem = ContactProblem(motion, contacts=[Contact(surface, obstacles.RigidPlane([0, -5], [0, 1]))])
    ledgers = []
    for step in dynamics.march(problem, to=100 * STEP):
        assert step.findings == ()
        ledgers.append(step.ledger)
    assert ledgers[-1].angular_momentum[-1] == pytest.approx(ledgers[0].angular_momentum[-1], rel=1e-7)
    if spin == 20.0:
        assert ledgers[-1].total == pytest.approx(ledgers[0].total, rel=2e-7)
