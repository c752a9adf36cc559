"""What motion must not pass over: obstacles and surfaces that a step goes through, energy that comes from nowhere or goes in
one step, loads that change within a step."""

import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, dynamics, materials, obstacles
from dolfinx_mortar_al.monitors import ModelWarning
from meshes.boxes import Box, create_boxes

LOWER, UPPER, SIDE, BASE = 11, 12, 13, 14
DENSITY = 1000.0


def block(low, size, cells, E=1e7, *, step, speed=(0.0, 0.0), density=DENSITY, external=None, sides=None, **scheme):
    """A block in flight whose surface is LOWER, or what `sides` say: (motion, tags)."""
    faces = {(len(low) - 1, 0): LOWER} if sides is None else sides
    domain, _, tags = create_boxes(MPI.COMM_WORLD, [Box(low, size, cells, 1, faces)], simplices=True)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (len(low),))))
    body = Body(u, materials.neo_hookean(E, 0.3), density=density, external=external and external(domain))
    motion = dynamics.Motion(body, step=step, **scheme)
    motion.velocity.interpolate(lambda x: np.outer(speed, np.ones(x.shape[1])))
    return motion, tags


def run(problem, **options):
    """All steps of a march, its warnings aside."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return list(dynamics.march(problem, **options))


def named(steps, words):
    return [f for step in steps for f in step.findings if words in f.name]


# ---------------------------------------------------------------- obstacles


def on_a_pin():
    """10 m/s onto a pin of 3 mm radius: a step carries the block by 1 cm."""
    motion, tags = block([-0.05, 0.012], [0.1, 0.1], [10, 10], step=1e-3, speed=(0.0, -10.0))
    return motion, tags, obstacles.RigidSphere([0.0012, 0.0], 0.003), {"to": 0.004}


def swept_by_a_roller():
    """A roller of .1 m diameter goes through a block at rest of its size in a step of .5 m."""
    sides = {(axis, end): LOWER for axis in (0, 1) for end in (0, 1)}
    motion, tags = block([0.0, -0.05], [0.1, 0.1], [5, 5], 1e8, step=5e-3, sides=sides)
    roller = obstacles.RigidSphere([-0.06, 0.0], 0.05)
    return motion, tags, roller, {"to": 5e-3, "move": lambda t: roller.move([100 * t, 0.0])}


def on_a_cylinder():
    """A flat block in space falls by .1 m a step onto a cylinder of 4 cm diameter."""
    motion, tags = block([0.0, 0.0, 0.06], [0.05, 0.05, 0.02], [2, 2, 1], 1e8, step=5e-3, speed=(0.0, 0.0, -20.0))
    return motion, tags, obstacles.RigidCylinder([0.025, 0.0, 0.03], [0, 1, 0], 0.02), {"to": 5e-3}


@pytest.mark.parametrize("scene", [on_a_pin, swept_by_a_roller, on_a_cylinder])
def test_no_step_goes_through_an_obstacle(scene):
    """What would have flown on is met: by its momentum along the obstacle's relative way, less than half of the incoming
    one is left in that direction (all was, of each of them)."""
    motion, tags, obstacle, options = scene()
    problem = ContactProblem(motion, contacts=[Contact(Surface(motion.u.function_space.mesh, tags, LOWER), obstacle)])
    *_, last = run(problem, **options)
    v = np.array(last.ledger.momentum) / motion.mass
    relative = v[0] - 100.0 if scene is swept_by_a_roller else v[-1]
    assert relative > -5.0


# ---------------------------------------------------------------- surfaces


def falling(name, gap=0.01):
    """A block in free fall onto a slab, whose top or side is named, without friction."""
    block_ = Box([-0.05, gap], [0.1, 0.1], [4, 4], 1, {(1, 0): LOWER})
    slab = Box([-0.3, -0.1], [0.6, 0.1], [10, 2], 2, {(1, 1): UPPER, (1, 0): BASE, (0, 1): SIDE})
    domain, cells, tags = create_boxes(MPI.COMM_WORLD, [block_, slab], simplices=False)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    held = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(BASE)), V)
    weight = (ufl.as_vector((0.0, -9.81 * DENSITY)), ufl.Measure("dx", domain, subdomain_data=cells)(1))
    body = Body(fem.Function(V), materials.neo_hookean(1e6, 0.3), density=DENSITY, external=weight, bcs=[held])
    contact = Contact(Surface(domain, tags, LOWER), Surface(domain, tags, name))
    return ContactProblem(dynamics.Motion(body, step=2e-3), contacts=[contact])


@pytest.mark.parametrize("name", [UPPER, SIDE])
def test_the_wrong_surface_is_said(name):
    """From .01 m it falls in .045 s; in .08 s it would have fallen by .031 m, nearly a facet into the slab."""
    steps = run(falling(name), to=0.08)
    assert (len(named(steps, "nodes in the other body")) > 0) == (name == SIDE)
    assert not any(f.fatal for step in steps for f in step.findings)


@pytest.mark.parametrize("depth", [0.0, 0.01])
def test_the_energy_of_an_overlap_is_said(depth):
    """Blocks that overlap by .01 m are moved apart before the first step, which says what that has stored: all the energy
    there is. Those that touch have none."""
    steps = run(falling(UPPER, gap=-depth), to=4e-3)
    found = named(steps, "energy of an overlap")
    assert len(found) == (depth > 0)
    if found:
        assert found[0] in steps[0].findings
        assert found[0].value == pytest.approx(steps[0].ledger.total, rel=0.05)


# ---------------------------------------------------------------- loads and losses


def test_loads_that_change_act_with_their_mean():
    """P = 1000 t N/m² on a free block of 1 m² and 1000 kg: momentum 500 t² and work p²/2m to round-off, whatever the step.
    They were 1000 t/(2 n) off with the value at each step's end."""

    def load(domain):
        P.append(fem.Constant(domain, 0.0))
        return (P[0] * ufl.as_vector((1.0, 0.0)), ufl.Measure("dx", domain))

    P: list[fem.Constant] = []
    motion, _ = block([0.0, 0.0], [1.0, 1.0], [2, 2], step=1e-2, external=load)

    def move(t):
        P[0].value = 1000.0 * t

    *_, last = dynamics.march(ContactProblem(motion), to=0.1, move=move)
    assert last.ledger.momentum[0] == pytest.approx(5.0, rel=1e-9)
    assert last.ledger.external_work == pytest.approx(5.0**2 / 2 / DENSITY, rel=1e-9)


@pytest.mark.parametrize("cells, said", [(1, True), (12, False)])
def test_a_large_loss_in_one_step_is_said(cells, said):
    """A block of one cell's height lands flat: half of its mass comes to rest; of twelve cells' height a twenty-fourth."""
    motion, tags = block([0.0, 0.001], [0.1, 0.1], [cells, cells], step=2e-4, speed=(0.0, -1.0))
    floor = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0])
    problem = ContactProblem(motion, contacts=[Contact(Surface(motion.u.function_space.mesh, tags, LOWER), floor)])
    steps = run(problem, to=2e-3)
    assert steps[-1].ledger.impact_loss > 0.01
    assert (len(named(steps, "impact loss")) > 0) == said


@pytest.mark.parametrize("step", [2e-4, 5e-5])
def test_what_a_moving_wall_loses_as_it_meets_a_block_is_not_said(step):
    """The wall puts in twice what the first nodes lose, whatever the step: that is 1 % of what the block has in the end, and
    was 24 to 60 % of what it had after that step."""
    motion, tags = block([0.0, 0.0], [0.1, 0.1], [6, 6], step=step)
    wall = obstacles.RigidPlane([0.0, -0.001], [0.0, 1.0])
    problem = ContactProblem(motion, contacts=[Contact(Surface(motion.u.function_space.mesh, tags, LOWER), wall)])
    steps = list(dynamics.march(problem, to=1.5e-3, move=lambda t: wall.move([0.0, 2.0 * t])))
    assert steps[-1].ledger.impact_loss > 0.1
    assert not named(steps, "impact loss")


@pytest.mark.parametrize("force", ["consistent", "trapezoidal"])
@pytest.mark.parametrize("θ, least, most", [(0.5, 0.9, 1.1), (0.7, 0.0, 1e-4), (1.0, 0.0, 1e-6)])
def test_stiff_vibrations_are_damped_beyond_one_half(force, θ, least, most):
    """A free block that is stretched by 1e-4 and let go, in steps of a hundred transits of its wave: θ > 1/2 takes what it
    stores in a few steps, 1/2 keeps it. The stress of the ends' mean alone, weighed by no θ, kept all of it with θ = 1."""
    motion, _ = block([0.0, 0.0], [0.1, 0.05], [4, 2], 1e9, step=1e-2, theta=θ, force=force)
    motion.u.interpolate(lambda x: np.array([1e-4 * x[0], 0.0 * x[1]]))
    motion.take_up()
    start = motion.energies()[1]
    steps = run(ContactProblem(motion), to=0.1)
    assert least <= steps[-1].ledger.strain / start <= most
    assert steps[-1].ledger.energy_defect <= 1e-6 * start


@pytest.mark.parametrize("density, said", [(7800.0, False), (7.8e-9, True)])
def test_inertia_that_drowns_in_round_off_is_said(density, said):
    """A steel square of 10 mm that flies at 1 m/s and spins at 20 rad/s. With 7.8e-9, of t/mm³, for a density in kg/m³ its
    energy is made of round-off after twenty steps of .1 ms; that of steel is kept to 1e-9 (4e-11 seen)."""
    motion, _ = block([-0.005, -0.005], [0.01, 0.01], [4, 4], 2.1e11, step=1e-4, density=density)
    motion.velocity.interpolate(lambda x: np.array([1.0 - 20.0 * x[1], 20.0 * x[0]]))
    start = motion.kinetic_energy()
    steps = run(ContactProblem(motion), to=2e-3)
    found = named(steps, "round-off")
    assert len(found) == said and found == [f for f in steps[0].findings if "round-off" in f.name]
    off = abs(steps[-1].ledger.total / start - 1.0)
    assert off > 1.0 if said else off < 1e-9


@pytest.mark.parametrize("gap", [0.0, 2e-3])
def test_a_weight_within_a_form(gap):
    """A body's form may hold its weight: what it has done since the start is less than nothing then. A block that lies, or
    falls 2 mm, is not refused for 1e-19 J that contact "would give", and loses no more than all."""
    low, high = [0.0, gap], [0.1, 0.05]
    domain, _, tags = create_boxes(MPI.COMM_WORLD, [Box(low, high, [4, 2], 1, {(1, 0): LOWER})], simplices=False)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    w, law = ufl.TestFunction(u.function_space), materials.neo_hookean(1e6, 0.3)
    form = law.virtual_work(u) + DENSITY * 9.81 * w[1] * ufl.dx
    motion = dynamics.Motion(Body(u, form, density=DENSITY), step=1e-3)
    floor = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0])
    problem = ContactProblem(motion, contacts=[Contact(Surface(domain, tags, LOWER), floor, friction=0.3)])
    steps = run(problem, to=0.05)
    assert sum(step.rejected for step in steps) == 0
    assert all(f.value < 1.0 for f in named(steps, "impact loss"))


@pytest.mark.parametrize("rate, said", [(8.0, "energy gained"), (-8.0, "energy lost")])
def test_moduli_that_change_are_said(rate, said):
    """A block under its weight grows stiffer, or softer, by .8 times in .1 s: energy comes, or goes, that nothing books."""
    domain, _, tags = create_boxes(
        MPI.COMM_WORLD, [Box([0, 0], [0.1, 0.05], [4, 2], 1, {(1, 0): LOWER})], simplices=False
    )
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    E = fem.Constant(domain, 1e6)
    weight = (ufl.as_vector((0.0, -9.81 * DENSITY)), ufl.dx(domain))
    motion = dynamics.Motion(Body(u, materials.neo_hookean(E, 0.3), density=DENSITY, external=weight), step=1e-3)
    floor = obstacles.RigidPlane([0.0, 0.0], [0.0, 1.0])
    problem = ContactProblem(motion, contacts=[Contact(Surface(domain, tags, LOWER), floor)])
    steps = run(problem, to=0.02, move=lambda t: setattr(E, "value", 1e6 * (1 + rate * t)))
    found = {f.name for step in steps for f in step.findings if "energy" in f.name and "loss" not in f.name}
    assert found == {f"{said} (J)"}


def test_a_body_without_mass_is_refused():
    """One of two in a mesh, whose density is a field that is nothing there: nothing would say how it moves."""
    boxes = [Box([0.0, y], [0.1, 0.05], [2, 2], k, {}) for k, y in ((1, 0.0), (2, 0.06))]
    domain, cells, _ = create_boxes(MPI.COMM_WORLD, boxes, simplices=False)
    density = fem.Function(fem.functionspace(domain, ("DG", 0)))
    density.x.array[:] = DENSITY
    density.x.array[cells.find(2)] = 0.0
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    motion = dynamics.Motion(Body(u, materials.neo_hookean(1e6, 0.3), density=density), step=1e-3)
    with pytest.raises(ValueError, match=r"density: the body around X = \[0.05\s+0.085\] has no mass"):
        next(iter(dynamics.march(ContactProblem(motion), to=1e-2)))


def test_a_march_that_goes_on_from_its_end_is_empty():
    """As one of a run that is read back from files may, with its ledger; without one the end is a mistake."""
    motion, _ = block([0.0, 0.0], [1.0, 1.0], [2, 2], step=1e-2)
    problem = ContactProblem(motion)
    *_, last = dynamics.march(problem, to=0.05)
    assert list(dynamics.march(problem, start=last.time, to=0.05, ledger=last.ledger)) == []
    with pytest.raises(ValueError, match=r"to = 0\.05: the end of the march must be a number > 0\.05"):
        dynamics.march(problem, start=last.time, to=0.05)
    one = fem.Constant(motion.u.function_space.mesh, 1.0)
    assert motion.integral(one * ufl.dx) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("pushes_askew", [False, True])
def test_a_stiff_block_with_finer_facets_is_told_only_where_pressures_alternate(pushes_askew):
    """On a soft block of the same width, both without Poisson's effect, it presses evenly, whatever the meshes; not so where
    its right half is pressed three times as much."""
    motions, sides = [], []
    for low, cells, E, face in ((0.1, 12, 1e9, 0), (0.0, 4, 1e6, 1)):
        box = Box([-0.05, low], [0.1, 0.1], [cells, 2], 1, {(1, face): LOWER, (1, 1 - face): BASE})
        domain, _, tags = create_boxes(MPI.COMM_WORLD, [box], simplices=False)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        right = ufl.conditional(ufl.SpatialCoordinate(domain)[0] > 0.0, 3.0 if pushes_askew else 1.0, 1.0)
        load = (right * ufl.as_vector((0.0, -1e4)), ufl.Measure("ds", domain, subdomain_data=tags)(BASE))
        held = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, tags.find(BASE)), V)
        how = {"external": [load]} if face == 0 else {"bcs": [held]}
        body = Body(fem.Function(V), materials.neo_hookean(E, 0.0), density=DENSITY, **how)
        motions.append(dynamics.Motion(body, step=2e-4))
        sides.append(Surface(domain, tags, LOWER))
    steps = run(ContactProblem(motions, contacts=[Contact(*sides)]), to=4e-3)
    assert any("pressures oscillate" in f.meaning for step in steps for f in step.findings) == pushes_askew
