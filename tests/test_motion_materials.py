"""What can move: several materials, membranes, forms of one's own; and what the ledger says of their energy."""

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from dolfinx_mortar_al import Body, Contact, ContactProblem, Surface, dynamics, materials, membrane, obstacles
from dolfinx_mortar_al.internal_work import CONSISTENT, WORK
from dolfinx_mortar_al.versions import geometry_nodes

E, NU, DENSITY = 1e5, 0.3, 1e3


def square():
    """A unit square 0.5 m above the floor: displacement, measures of its halves, tags of its bottom facets."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.5), (1.0, 1.5)], (4, 4), mesh.CellType.quadrilateral)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    cells = np.arange(domain.topology.index_map(2).size_local + domain.topology.index_map(2).num_ghosts, dtype=np.int32)
    right = (mesh.compute_midpoints(domain, 2, cells)[:, 0] > 0.5).astype(np.int32)
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.5))
    facets = mesh.meshtags(domain, 1, np.sort(bottom), np.full(len(bottom), 1, dtype=np.int32))
    return u, ufl.Measure("dx", domain, subdomain_data=mesh.meshtags(domain, 2, cells, right)), facets


def stretching(x):
    return np.stack([2 * (x[0] - 0.3) - (x[1] - 1.0), -3.0 + 2 * (x[0] - 0.3)])


def fall(motion, facets, to, friction=0.3, thickness=1.0, side=None):
    """The ledgers of the flight and impact on the floor."""
    motion.velocity.interpolate(stretching)
    contactor = Surface(motion.u.function_space.mesh, facets, 1, side=side)
    contact = Contact(contactor, obstacles.RigidPlane([0, 0], [0, 1]), friction=friction, thickness=thickness)
    problem = ContactProblem(motion, contacts=[contact])
    return [step.ledger for step in dynamics.march(problem, to=to)]


def test_two_materials_keep_energy_and_momenta():
    """In flight: energy and both momenta to round-off; each part's energies are those of its measure."""
    u, dx, facets = square()
    laws = [(materials.neo_hookean(E, NU), dx(0)), (materials.saint_venant_kirchhoff(5 * E, NU), dx(1))]
    motion = dynamics.Motion(u, laws, density=[DENSITY, 3 * DENSITY], step=5e-3)
    assert motion.mass == pytest.approx(2 * DENSITY, rel=1e-12)
    motion.velocity.interpolate(stretching)
    energy, momenta = sum(motion.energies()), motion.momenta()
    last = fall(motion, facets, 0.05)[-1]
    assert last.known == CONSISTENT
    assert last.strain > 0.01 * energy
    assert last.total == pytest.approx(energy, rel=1e-9)
    assert np.allclose(motion.momenta(), momenta, rtol=0, atol=1e-9 * np.abs(momenta).max())
    parts = np.array([[motion.integral(form) for form in motion.energy_forms(dx(k))] for k in (0, 1)])
    assert np.allclose(parts.sum(axis=0), motion.energies(), rtol=1e-12)


def test_two_parts_of_one_material_are_one_body():
    u, dx, facets = square()
    law, ledgers = materials.neo_hookean(E, NU), []
    for parts in (law, [(law, dx(0)), (law, dx(1))]):
        u.x.array[:] = 0.0
        ledgers.append(fall(dynamics.Motion(u, parts, density=DENSITY, step=2e-2), facets, 0.3)[-1])
    one, two = ledgers
    assert one.impact_loss > 0
    for name in ("kinetic", "strain", "impact_loss", "friction_dissipation"):
        assert getattr(two, name) == pytest.approx(getattr(one, name), rel=1e-7), name


def test_a_form_of_ones_own():
    """A law written as a form, with gravity as external work: the ledger is kept by the work of internal forces, and says so;
    that work is the stored energy's change up to the trapezoidal rule's error, which falls with Δt²."""
    misses = []
    for step in (1e-2, 5e-3):
        u, dx, facets = square()
        law = materials.neo_hookean(E, NU)
        w = ufl.TestFunction(u.function_space)
        weight = DENSITY * ufl.inner(ufl.as_vector([0.0, -9.81]), w) * dx
        motion = dynamics.Motion(u, law.virtual_work(u, dx=dx), density=DENSITY, step=step, external=weight)
        ledgers = fall(motion, facets, 0.3)
        last = ledgers[-1]
        assert last.known == WORK
        assert last.impact_loss > 0
        assert last.external_work > 0
        assert abs(last.energy_defect) < 1e-8 * last.total
        stored = motion.integral(fem.form(law.energy(materials.deformation_gradient(u)) * materials.cell_measure(u)))
        misses.append(abs(stored - last.strain) / stored)
    assert misses == pytest.approx([0.0455, 0.0141], rel=0.1)  # docs/impact.md


def sheet(dim):
    """A flat membrane of unit side on y = 0.5, in the plane or in space: displacement and tags of all its cells."""
    if dim == 2:
        line = mesh.create_interval(MPI.COMM_SELF, 6, (0.0, 1.0))
        points = np.stack([line.geometry.x[:, 0], np.full(7, 0.5)], axis=1)
        cells, element = geometry_nodes(line), ("interval", 1)
    else:
        flat = mesh.create_unit_square(MPI.COMM_SELF, 3, 3, mesh.CellType.quadrilateral)
        points = np.stack([flat.geometry.x[:, 0], np.full(len(flat.geometry.x), 0.5), flat.geometry.x[:, 1]], axis=1)
        cells, element = geometry_nodes(flat), ("quadrilateral", 1)
    element = basix.ufl.element("Lagrange", *element, shape=(dim,))
    domain = mesh.create_mesh(MPI.COMM_SELF, cells=cells, x=points, e=element)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (dim,))))
    count = domain.topology.index_map(dim - 1).size_local
    return u, mesh.meshtags(domain, dim - 1, np.arange(count, dtype=np.int32), np.ones(count, dtype=np.int32))


@pytest.mark.one_rank
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("nu", [0.0, 0.45])
def test_membrane_stress_does_the_work_of_its_energy(dim, nu):
    """∫ P : (F₁ − F₀) is the change of energy, for changes of any size; and P = ∂w/∂F, by differences."""
    u, _ = sheet(dim)
    law, d = membrane.neo_hookean_membrane(1.0, nu, 1.0), dim - 1
    old, rng = u.copy(), np.random.default_rng(dim)
    old.x.array[:] = 0.2 * rng.standard_normal(len(old.x.array))
    F0, F1, dx = membrane.tangent_gradient(old), membrane.tangent_gradient(u), ufl.Measure("dx", u.function_space.mesh)
    dx = dx(degree=2)
    work = fem.form(ufl.inner(law.mean_first_piola(F0, F1, d), F1 - F0) * dx)
    energies = [fem.form(law.energy(F, d) * dx) for F in (F0, F1)]
    tangent = fem.form(ufl.inner(law.first_piola(F0, d), F1 - F0) * dx)
    way = rng.standard_normal(len(old.x.array))
    for size in (0.2, 1e-3, 1e-6):
        u.x.array[:] = old.x.array + size * way
        change = np.diff([fem.assemble_scalar(form) for form in energies])[0]
        assert fem.assemble_scalar(work) == pytest.approx(change, abs=1e-14)
    assert fem.assemble_scalar(tangent) == pytest.approx(change, rel=1e-4)
    exact = fem.assemble_scalar(work)
    u.x.array[:] = old.x.array + 1e-9 * way  # where the mean stress is the stress of the mean
    assert fem.assemble_scalar(work) == pytest.approx(1e-3 * exact, rel=1e-4)


@pytest.mark.one_rank
def test_a_membrane_bounces_and_keeps_its_energy():
    """A flat, slack sheet thrown at the floor: contact takes what the impact of nodes takes, and nothing else is lost."""
    u, cells = sheet(2)
    law = membrane.neo_hookean_membrane(E, NU, 1e-2)
    motion = dynamics.Motion(u, law, density=DENSITY, step=5e-3)
    assert motion.mass == pytest.approx(DENSITY * 1e-2, rel=1e-12)
    motion.velocity.interpolate(lambda x: np.stack([x[0] - 0.5, -3.0 - 2 * (x[0] - 0.3)]))
    energy = sum(motion.energies())
    contact = Contact(Surface(u.function_space.mesh, cells, 1, side=[0, -1]), obstacles.RigidPlane([0, 0], [0, 1]))
    problem = ContactProblem(motion, contacts=[contact])
    ledgers = [step.ledger for step in dynamics.march(problem, to=0.25)]
    assert ledgers[-1].impact_loss > 0
    assert ledgers[-1].known == CONSISTENT
    assert max(abs(ledger.energy_defect) for ledger in ledgers) < 1e-9 * energy


def test_what_cannot_move():
    u, dx, facets = square()
    law = materials.neo_hookean(E, NU)
    for material, density, words in [
        ([(law, dx(0))], DENSITY, "8 cells belong to no part and 0 to several"),
        ([(law, dx(0)), (law, dx)], DENSITY, "0 cells belong to no part and 8 to several"),
        ([(law, dx(0)), (law, dx(1))], [DENSITY], "density: 1 of them for 2"),
        ([law], DENSITY, r"material\[0\]: .* is no \(law or form, measure\)"),
        ("steel", DENSITY, "material: str is no material"),
        (membrane.neo_hookean_membrane(E, NU, 1.0), DENSITY, "is for a membrane"),
        ([], DENSITY, "material = \\[\\]: no part"),
        (law.energy(ufl.Identity(2)) * dx, DENSITY, "material has no test function"),
    ]:
        with pytest.raises(ValueError, match=words):
            dynamics.Motion(u, material, density=density, step=1e-3)
    with pytest.raises(ValueError, match=r"thickness = 0\.02: a membrane has its own"):
        sheet_law = membrane.neo_hookean_membrane(E, NU, 1e-2)
        dynamics.Motion(sheet(2)[0], sheet_law, density=DENSITY, step=1e-3, thickness=0.02)
    motion = dynamics.Motion(u, law, density=DENSITY, step=1e-3, thickness=0.02)
    with pytest.raises(ValueError, match=r"thickness = 0\.02 of the body of u\[0\], but 1 of the contact 'contact'"):
        fall(motion, facets, 1.0)


def test_parts_of_other_quadrature_lose_nothing():
    """Equal integrands on two parts with measures of other degrees: mass, momentum and energy of both."""
    u, dx, _ = square()
    law = materials.saint_venant_kirchhoff(E, NU)
    motion = dynamics.Motion(u, [(law, dx(0)), (law, dx(1, degree=4))], density=DENSITY, step=1e-3)
    motion.velocity.interpolate(lambda x: np.stack([2.0 + 0 * x[0], 0 * x[0]]))
    assert motion.mass == pytest.approx(DENSITY, rel=1e-12)
    assert motion.kinetic_energy() == pytest.approx(2 * DENSITY, rel=1e-12)
    assert motion.momenta()[0] == pytest.approx(2 * DENSITY, rel=1e-12)


VISCOSITY = 200.0  # Pa s


def viscous_bar(*, given, step=1e-3):
    """A free bar (Kelvin and Voigt's solid) of unit length in its first mode: motion, problem and the form's `old`."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0.0, 0.0), (1.0, 0.1)], (16, 1), mesh.CellType.quadrilateral)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, old, Δt, w = fem.Function(V), fem.Function(V), fem.Constant(domain, step), ufl.TestFunction(V)
    stress = E * strain(u) + VISCOSITY * strain(u - old) / Δt
    form = ufl.inner(stress, strain(w)) * ufl.dx
    motion = dynamics.Motion(u, form, density=DENSITY, step=Δt, old=old if given else None)
    motion.velocity.interpolate(lambda x: np.stack([1e-3 * np.cos(np.pi * x[0]), 0 * x[0]]))
    return motion, ContactProblem(motion), old


def strain(u):
    return ufl.sym(ufl.grad(u))


@pytest.mark.one_rank
@pytest.mark.parametrize("tolerance", [None, 5e-13])
def test_a_viscous_form_has_all_of_its_viscosity(tolerance):
    """The first mode decays at the rate ηω²/(2E), with steps of one length and of several; what is lost is in the books."""
    motion, problem, _ = viscous_bar(given=True)
    ω = np.pi * np.sqrt(E / DENSITY)
    rate = VISCOSITY * ω**2 / (2 * E)
    mode = ufl.cos(np.pi * ufl.SpatialCoordinate(motion.u.function_space.mesh)[0])
    forms = [fem.form(field[0] * mode * ufl.dx) for field in (motion.u, motion.velocity)]

    def amplitude():
        q, v = (motion.integral(form) for form in forms)
        return np.hypot(q, (v + rate * q) / np.sqrt(ω**2 - rate**2))

    start, energy, lengths = amplitude(), motion.kinetic_energy(), set()
    for step in dynamics.march(problem, to=0.3, tolerance=tolerance):
        assert step.findings == ()
        lengths.add(float(np.round(step.step, 9)))
    assert (len(lengths) > 1) == (tolerance is not None)
    assert np.log(start / amplitude()) / 0.3 == pytest.approx(rate, rel=0.01)
    assert motion.kinetic_energy() < 0.9 * energy
    assert step.ledger.total == pytest.approx(energy, rel=1e-9)


def test_a_copy_of_the_last_displacement_is_found():
    """A form's own Function that the loop sets to u after each step: half of the viscosity would be missing."""
    motion, problem, old = viscous_bar(given=False)
    found = []
    for step in dynamics.march(problem, to=3e-3):
        found.append([finding.meaning for finding in step.findings])
        old.x.array[:] = motion.u.x.array
    assert found[0] == []
    assert all("Motion(old=…)" in meanings[0] for meanings in found[1:])


def test_what_is_no_last_displacement():
    motion, _, _ = viscous_bar(given=True)
    u, other = motion.u, fem.Function(fem.functionspace(motion.u.function_space.mesh, ("Lagrange", 2, (2,))))
    law, body = materials.neo_hookean(E, NU), motion.body
    for old, material, words in [
        (u, body, "other than u"),
        (other, body, "the Function of u's space"),
        (motion.velocity, body, "no form of the body holds it"),
        (motion.old, law, "no form of the body holds it"),
    ]:
        with pytest.raises(ValueError, match=words):
            dynamics.Motion(material if material is body else Body(u, law, density=DENSITY), step=1e-3, old=old)
    whole = fem.Constant(u.function_space.mesh, np.float32(1))
    with pytest.raises(ValueError, match="step: a Constant of float32"):
        dynamics.Motion(body, step=whole)
    with pytest.raises(ValueError, match="step = 0"):
        dynamics.Motion(body, step=fem.Constant(u.function_space.mesh, 0.0))


@pytest.mark.one_rank
def test_sheets_with_friction_that_turn_fast_have_no_step_refused():
    """Two square sheets are thrown at each other. As they turn, part of what is stored along normals becomes stored friction
    from step to step: 38 steps were refused for energy, while contact as a whole takes some."""

    def thrown(y, towards):
        flat = mesh.create_unit_square(MPI.COMM_SELF, 8, 8)
        points = flat.geometry.x + np.array([0.0, 0.0, y])
        element = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,))
        domain = mesh.create_mesh(MPI.COMM_SELF, cells=geometry_nodes(flat), x=points, e=element)
        V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
        rim = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(np.abs(x[:2] - 0.5), 0.5).any(axis=0))
        held = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 1, rim), V)
        law = membrane.neo_hookean_membrane(2e6, 0.3, 1e-3)
        motion = dynamics.Motion(Body(fem.Function(V), law, density=1000.0, bcs=[held]), step=1e-3)
        speed = 3.0 * towards
        motion.velocity.interpolate(lambda x: np.outer([0, 0, speed], np.sin(np.pi * x[0]) * np.sin(np.pi * x[1])))
        count = domain.topology.index_map(2).size_local
        tags = mesh.meshtags(domain, 2, np.arange(count, dtype=np.int32), np.ones(count, dtype=np.int32))
        return motion, Surface(domain, tags, 1, side=[0.0, 0.0, towards])

    (upper, over), (lower, under) = thrown(0.05, -1.0), thrown(-0.05, 1.0)
    problem = ContactProblem([upper, lower], contacts=[Contact(over, under, friction=0.3)])
    steps = list(dynamics.march(problem, to=0.04))
    assert len(steps) == 40 and not any(step.rejected for step in steps)
    ledger = steps[-1].ledger
    assert (
        ledger.impact_loss > 0 and ledger.friction_dissipation > 0 and abs(ledger.energy_defect) < 1e-8 * ledger.total
    )
