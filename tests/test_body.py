"""A body said once: its residual is the one written by hand, at rest and in motion; what cannot be meant is refused."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from test_motion_materials import sheet, square

from dolfinx_mortar_al import (
    Body,
    Contact,
    ContactProblem,
    Surface,
    dynamics,
    loads,
    materials,
    membrane,
    obstacles,
    quasistatic,
    reaction,
)
from dolfinx_mortar_al.internal_work import CONSISTENT, WORK

E, NU, DENSITY, THICKNESS = 1e5, 0.3, 1e3, 0.02
FLOOR = obstacles.RigidPlane([0, 0], [0, 1])


def somewhere(u, seed=1):
    """A displacement without inverted cells, the same on any number of ranks."""
    a, b = np.random.default_rng(seed).uniform(-0.2, 0.2, (2, u.function_space.mesh.geometry.dim))
    u.interpolate(lambda x: np.stack([a_k * x[0] + b_k * x[1] ** 2 for a_k, b_k in zip(a, b, strict=True)]))
    return u


def values(form):
    """The assembled residual of this rank."""
    return fem.assemble_vector(fem.form(form)).array


def largest(x):
    return MPI.COMM_WORLD.allreduce(float(np.abs(x).max(initial=0.0)), MPI.MAX)


def assert_equal_forms(one, other):
    """To round-off."""
    a, b = values(one), values(other)
    assert largest(b) > 0
    assert largest(a - b) < 1e-13 * largest(b)


def two_materials(u, dx):
    return [(materials.neo_hookean(E, NU), dx(0)), (materials.saint_venant_kirchhoff(5 * E, NU), dx(1))]


def test_two_materials_with_thickness_as_by_hand():
    """Dead and follower loads as forces per area and volume, times the thickness, which is said once."""
    u, dx, facets = square()
    ds = ufl.Measure("ds", u.function_space.mesh, subdomain_data=facets)
    p, weight = fem.Constant(u.function_space.mesh, 70.0), (3.0, -9.81 * DENSITY)
    laws = two_materials(u, dx)
    body = Body(
        u, laws, thickness=THICKNESS, external=[(-p * loads.area_normal(u), ds(1)), (weight, dx), ((2.0, 1.0), ds)]
    )
    v = ufl.TestFunction(u.function_space)
    F = sum(law.virtual_work(u, dx=part, thickness=THICKNESS) for law, part in laws)
    F -= loads.pressure(u, THICKNESS * p, ds(1)) + THICKNESS * ufl.inner(ufl.as_vector(weight), v) * dx(degree=2)
    F -= loads.dead_traction(u, THICKNESS * ufl.as_vector((2.0, 1.0)), ds)
    somewhere(u)
    assert_equal_forms(body.residual, F)
    form, pair = loads.pressure(u, THICKNESS * p, ds(1)), (-p * loads.area_normal(u), ds(1))
    for external in (form, pair, [form], [pair]):
        assert_equal_forms(Body(u, laws, thickness=THICKNESS, external=external).external, form)
    mixed = Body(u, laws, external=[((0.0, -p), ds(1))]).external
    assert_equal_forms(mixed, ufl.inner(ufl.as_vector((0.0, -p)), v) * ds(1))


@pytest.mark.parametrize("theta, force", [(0.5, "consistent"), (0.7, "trapezoidal")])
def test_motion_of_a_body_is_that_of_its_words(theta, force):
    u, dx, _ = square()
    weight = DENSITY * ufl.inner(ufl.as_vector([0.0, -9.81]), ufl.TestFunction(u.function_space)) * dx
    scheme = {"step": 1e-2, "theta": theta, "force": force}
    words = {"density": [DENSITY, 2 * DENSITY], "thickness": THICKNESS, "external": weight}
    one = dynamics.Motion(Body(u, two_materials(u, dx), **words), **scheme)
    other = dynamics.Motion(u, two_materials(u, dx), **words, **scheme)
    assert one.residual.signature() == other.residual.signature()
    assert one.mass == pytest.approx(1.5 * DENSITY * THICKNESS, rel=1e-12)


def test_a_step_at_rest_is_equilibrium():
    """From u to u with no velocity: the mid-step residual is the static one."""
    u, dx, _ = square()
    somewhere(u)
    body = Body(u, two_materials(u, dx), density=DENSITY, thickness=THICKNESS, external=((0.0, -9.81 * DENSITY), dx))
    assert_equal_forms(dynamics.Motion(body, step=1e-2).residual, body.residual)


def test_membrane_as_by_hand():
    """Its thickness is the law's; pressure and width are per unit length."""
    u, cells = sheet(2)
    domain = u.function_space.mesh
    dx = ufl.Measure("dx", domain, subdomain_data=cells)
    law, up = membrane.neo_hookean_membrane(E, NU, 1e-2), [0.0, 1.0]
    F = law.virtual_work(u, dx=dx) - loads.membrane_pressure(u, 30.0, up, dx(1))
    somewhere(u)
    for external in (loads.membrane_pressure(u, 30.0, up, dx(1)), (30.0 * membrane.area_vector(u, up), dx(1))):
        body = Body(u, law, density=DENSITY, external=external)
        assert_equal_forms(body.residual, F)
        assert body.width == 1.0
    assert dynamics.Motion(Body(u, law, density=DENSITY), step=1e-2).mass == pytest.approx(1e-2 * DENSITY, rel=1e-12)


def test_a_law_without_stored_energy():
    """A form of one's own, with its thickness: the residual as it is; in motion its work is booked."""
    u, dx, _ = square()
    work = THICKNESS * E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(ufl.TestFunction(u.function_space)))
    form = work * dx
    body = Body(u, form, density=DENSITY, thickness=THICKNESS)
    somewhere(u)
    assert_equal_forms(body.residual, form)
    motion = dynamics.Motion(body, step=1e-2)
    assert motion.known == WORK and motion.has_forms
    assert motion.mass == pytest.approx(DENSITY * THICKNESS, rel=1e-12)
    both = Body(u, [(work * dx(0), dx(0)), (materials.neo_hookean(E, NU), dx(1))], density=DENSITY, thickness=THICKNESS)
    assert dynamics.Motion(both, step=1e-2).known == f"{WORK}; {CONSISTENT}"
    for other in (form, work * dx((0, 1)), work * dx(1)):
        with pytest.raises(ValueError, match=r"material\[0\]: a form over .*write both with the same measure"):
            Body(u, [(other, dx(0)), (materials.neo_hookean(E, NU), dx(1))], thickness=THICKNESS)


def test_a_bolt_that_shrinks_draws_what_holds_it():
    """The right half would be shorter by 1e-3 without stress (docs/loading.md); held top and bottom, between sides that do
    not widen, it draws with E(1 − ν)/((1 + ν)(1 − 2ν)) 1e-3, to the share 1e-3 of large strains."""
    u, dx, facets = square()
    V, law, a = u.function_space, materials.neo_hookean(E, NU), fem.Constant(u.function_space.mesh, 0.0)
    F0 = ufl.diag(ufl.as_vector([1.0, 1.0 - a]))  # the stretch without stress
    P = ufl.det(F0) * law.first_piola(materials.deformation_gradient(u) * ufl.inv(F0)) * ufl.inv(F0).T
    bolt = ufl.inner(P, ufl.grad(ufl.TestFunction(V))) * dx(1)
    ends = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0.5) | np.isclose(x[1], 1.5))
    Vx, _ = V.sub(0).collapse()
    sides = fem.locate_dofs_geometrical((V.sub(0), Vx), lambda x: x[0] > -1.0)
    bcs = [fem.dirichletbc(np.zeros(2), ends, V), fem.dirichletbc(fem.Function(Vx), sides, V.sub(0))]
    problem = ContactProblem(Body(u, [(law, dx(0)), (bolt, dx(1))], bcs=bcs))
    list(quasistatic.march(problem, a, to=1e-3, increments=1))
    drawn = -reaction(problem, Surface(V.mesh, facets, 1)).force[1]  # on half a metre
    assert drawn == pytest.approx(E * (1 - NU) / ((1 + NU) * (1 - 2 * NU)) * 1e-3 / 2, rel=2e-3)


def test_problem_takes_conditions_and_thickness_from_the_body():
    """The same problem as from a residual, with its conditions once wherever they are said."""
    u, dx, facets = square()
    V, contactor = u.function_space, Surface(u.function_space.mesh, facets, 1)
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 1.5))
    clamp = fem.dirichletbc(np.zeros(2), top, V)
    body = Body(u, two_materials(u, dx), thickness=THICKNESS, bcs=clamp)
    problem = ContactProblem(body, bcs=[clamp], contacts=[Contact(contactor, FLOOR)])
    other = ContactProblem(body.residual, u, bcs=[clamp], contacts=[Contact(contactor, FLOOR, thickness=THICKNESS)])
    assert problem.u is u and len(problem.bodies.bodies[0].bcs) == 1
    assert problem.pairs[0].contact.thickness == THICKNESS
    assert problem.pairs[0].area == pytest.approx(THICKNESS, rel=1e-12)
    assert problem.pairs[0].augmentation.stiffness == pytest.approx(other.pairs[0].augmentation.stiffness, rel=1e-12)
    assert ContactProblem(body.residual, u, contacts=[Contact(contactor, FLOOR)]).pairs[0].contact.thickness == 1.0


def test_motion_makes_the_problem():
    """A thrown square of two materials: said once, it bounces as with what a Motion and a Contact take in place of a Body."""
    last = []
    for once in (True, False):
        u, dx, facets = square()
        said = {"density": DENSITY, "thickness": THICKNESS}
        contactor = Surface(u.function_space.mesh, facets, 1)
        if once:
            motion = dynamics.Motion(Body(u, two_materials(u, dx), **said), step=2e-2)
            problem = ContactProblem(motion, contacts=[Contact(contactor, FLOOR)])
        else:
            motion = dynamics.Motion(u, two_materials(u, dx), **said, step=2e-2)
            contact = Contact(contactor, FLOOR, thickness=THICKNESS)
            problem = ContactProblem(motion, contacts=[contact])
        motion.velocity.interpolate(lambda x: np.stack([0 * x[0], -3.0 + 0 * x[0]]))
        last += [list(dynamics.march(problem, to=0.24))[-1].ledger]
    assert last[0].impact_loss > 0
    assert last[0].kinetic == pytest.approx(last[1].kinetic, rel=1e-9)
    assert last[0].impact_loss == pytest.approx(last[1].impact_loss, rel=1e-9)


def two_squares(thicknesses):
    """Two bodies on meshes of their own, one above the other, and their facing surfaces."""
    bodies, surfaces = [], []
    for k, thickness in enumerate(thicknesses):
        corners = [(0.0, float(k)), (1.0, k + 1.0)]
        domain = mesh.create_rectangle(MPI.COMM_WORLD, corners, (2 + k, 2), mesh.CellType.quadrilateral)
        u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
        side = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1.0))
        tags = mesh.meshtags(domain, 1, np.sort(side), np.full(len(side), 1, dtype=np.int32))
        bodies.append(Body(u, materials.neo_hookean(E, NU), thickness=thickness))
        surfaces.append(Surface(domain, tags, 1))
    return bodies, surfaces


def test_several_bodies_and_their_thicknesses():
    bodies, surfaces = two_squares([THICKNESS, THICKNESS])
    problem = ContactProblem(bodies, contacts=[Contact(*surfaces)])
    assert problem.u == [body.u for body in bodies]
    assert problem.pairs[0].thickness == THICKNESS
    for thicknesses, given, words in [
        ([0.02, 0.03], {}, r"thickness = 0\.03 of the body of u\[1\], but 0\.02 of the body of u\[0\]: .* leave"),
        ([0.02, 0.02], {"thickness": 1.0}, r"thickness = 0\.02 of the body of u\[0\], but 1 of the contact 'contact'"),
    ]:
        bodies, surfaces = two_squares(thicknesses)
        with pytest.raises(ValueError, match=words):
            ContactProblem(bodies, contacts=[Contact(*surfaces, **given)])
    domain = bodies[0].u.function_space.mesh
    varying = 0.01 * (1 + ufl.SpatialCoordinate(domain)[0])
    bodies = [Body(body.u, materials.neo_hookean(E, NU), thickness=varying) for body in bodies[:1]]
    with pytest.raises(ValueError, match=r"thickness of the body of u\[0\] is UFL: pass that of the contact 'contact'"):
        ContactProblem(bodies, contacts=[Contact(surfaces[0], FLOOR)])


def test_what_is_no_body():
    u, dx, facets = square()
    law, domain = materials.neo_hookean(E, NU), u.function_space.mesh
    ds = ufl.Measure("ds", domain, subdomain_data=facets)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    other, bc = fem.Function(V), fem.dirichletbc(np.zeros(2), fem.locate_dofs_geometrical(V, lambda x: x[1] > 1), V)
    v = ufl.TestFunction(u.function_space)
    for words, said in [
        (r"material: str is no material", {"material": "steel"}),
        (r"material\[0\]: a measure of exterior_facet integrals; pass dx", {"material": [(law, ds)]}),
        (r"8 cells belong to no part and 0 to several", {"material": [(law, dx(1))]}),
        (r"material does not depend on u", {"material": ufl.inner(other, v) * dx}),
        (r"thickness = -1", {"thickness": -1.0}),
        (r"density = 0", {"density": 0.0}),
        (r"density: 2 of them for 1 materials", {"density": [1.0, 2.0]}),
        (r"external: float is not a UFL form; .* a \(force, measure\), or a list", {"external": 3.0}),
        (r"external\[0\]: \(float, float\) is no \(force, measure\)", {"external": [(1.0, 0.0)]}),
        (r"external\[0\]: str is no \(force, measure\)", {"external": ["weight"]}),
        (r"external\[0\] = 1\.0: needs 2 components", {"external": (1.0, ds)}),
        (r"external\[1\]: a force of shape \(3,\); needs 2", {"external": [(v, ds), (ufl.as_vector([v[0]] * 3), ds)]}),
        (r"external\[0\]: a measure of interior_facet integrals; pass dx or ds", {"external": (v, ufl.dS)}),
        (r"external: there is no test function in it", {"external": ufl.inner(u, u) * dx}),
        (r"external: there is no test function in it, as .* of a force that is 0", {"external": ((0.0, 0.0), ds)}),
        (r"external: must be linear in the test function", {"external": ufl.TestFunction(V)[0] * dx}),
        (r"external: its exterior_facet integrals have different", {"external": [((1, 0), ds), ((1, 0), ufl.ds)]}),
        (r"bcs\[0\]: a Dirichlet condition on another space", {"bcs": bc}),
        (r"bcs: 'clamp' is not a Dirichlet condition", {"bcs": ["clamp"]}),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=words):
            Body(u, **({"material": law} | said))
    with pytest.raises(ValueError, match=r"u: FunctionSpace is not a Function"):
        Body(u.function_space, law)
    with pytest.raises(ValueError, match=r"thickness = 0\.02: a membrane has its own"):
        Body(sheet(2)[0], membrane.neo_hookean_membrane(E, NU, 1e-2), thickness=0.02)


def test_what_is_said_twice_or_not_at_all():
    u, _, facets = square()
    law = materials.neo_hookean(E, NU)
    body = Body(u, law, density=DENSITY)
    ds = ufl.Measure("ds", u.function_space.mesh, subdomain_data=facets)
    for words, make in [
        (r"u = None: pass the displacement of a residual", lambda: ContactProblem(body.residual)),
        (r"u: a Body says it", lambda: ContactProblem(body, u)),
        (r"F\[1\]: Form beside a Body; .* Body\(u, form\)", lambda: ContactProblem([body, body.residual])),
        (r"F\[1\]: a Body of the same displacement", lambda: ContactProblem([body, Body(u, law)])),
        (r"density = None: a body in motion has a mass", lambda: dynamics.Motion(Body(u, law), step=1e-3)),
        (r"density: the Body says it", lambda: dynamics.Motion(body, density=1.0, step=1e-3)),
        (r"material: the Body says it", lambda: dynamics.Motion(body, law, step=1e-3)),
        (r"material: NoneType is no material", lambda: dynamics.Motion(u, density=1.0, step=1e-3)),
        (
            r"external depends on u: only dead loads",
            lambda: dynamics.Motion(Body(u, law, density=DENSITY, external=(loads.area_normal(u), ds(1))), step=1e-3),
        ),
    ]:
        with pytest.raises(ValueError, match=words):
            make()


@pytest.mark.parametrize("name", ["place", "step", "component"])
def test_graded_moduli(name):
    """Functions of the place, and a component of a Constant: cells in series, pulled, each with its mean stiffness."""
    n = 8
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 1)], (n, 1), mesh.CellType.quadrilateral)
    x, pair = ufl.SpatialCoordinate(domain), fem.Constant(domain, np.array([1e6, 2e6]))
    middle = (np.arange(n) + 0.5) / n
    E, stiffness = {
        "place": (1e6 * (1.0 + x[0]), 1.0 + middle),
        "step": (ufl.conditional(ufl.lt(x[0], 0.5), 1e6, 2e6), np.where(middle < 0.5, 1.0, 2.0)),
        "component": (pair[1], np.full(n, 2.0)),
    }[name]
    V, way = fem.functionspace(domain, ("Lagrange", 1, (2,))), fem.Constant(domain, 0.0)

    def held(value, component, where):
        nodes = fem.locate_dofs_geometrical((V.sub(component), V.sub(component).collapse()[0]), where)[0]
        return fem.dirichletbc(value, nodes, V.sub(component))

    bcs = [held(0.0, 0, lambda x: np.isclose(x[0], 0.0)), held(0.0, 1, lambda x: np.isclose(x[1], 0.0))]
    bcs.append(held(way, 0, lambda x: np.isclose(x[0], 1.0)))
    problem = ContactProblem(Body(fem.Function(V), materials.neo_hookean(E, 0.0), bcs=bcs))
    list(quasistatic.march(problem, way, to=1e-5, increments=1))
    expected = 1e-5 * 1e6 * n / np.sum(1.0 / stiffness)
    assert reaction(problem, bcs[2]).force[0] == pytest.approx(expected, rel=1e-3)
