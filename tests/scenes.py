"""Small scenes the tests share."""

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints, exterior_facet_indices, locate_entities_boundary, meshtags
from mpi4py import MPI

from dolfinx_mortar_al import Contact, ContactProblem, NewtonSolver, Surface, loads, materials, membrane
from meshes.gmsh_session import distribute
from meshes.two_beams import CLAMP, LOWER_TOP, TIP, UPPER_BOTTOM, TwoBeams
from meshes.two_membranes import EDGE, LOWER, UPPER, TwoMembranes

E, NU = 2e6, 0.3


def contact_of(mesh, tags, *, friction=0.0, swap=False, **options):
    sides = [Surface(mesh, tags, UPPER_BOTTOM), Surface(mesh, tags, LOWER_TOP)]
    contactor, target = reversed(sides) if swap else sides
    return Contact(contactor, target, friction=friction, **options)


def beams(comm=MPI.COMM_WORLD, *, order=2, friction=0.0, young=E, swap=False, unit=1.0, mesh=None, parts=1, **options):
    """The two beams of section 4.1, coarse: (problem, force P in N).

    `unit` is the length unit per metre; `parts` cuts the contactor into as many pairs along its length.
    """
    shape = {"along": (10, 10), "across": 2} | (mesh or {})
    for name in ("gap",):
        shape[name] = shape.get(name, 0.0) * unit
    built = TwoBeams(length=unit, height=0.05 * unit, width=0.1 * unit, **shape)
    domain, _, tags = built.create(comm)
    d = domain.geometry.dim
    u = fem.Function(fem.functionspace(domain, ("Lagrange", order, (d,))))
    thickness = built.width if d == 2 else 1.0
    P = fem.Constant(domain, 0.0)
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    F = materials.saint_venant_kirchhoff(young, NU).virtual_work(u, thickness=thickness)
    F -= loads.follower_force(u, P * thickness / (built.height * built.width), ds(TIP))
    V = u.function_space
    bcs = [fem.dirichletbc(np.zeros(d), fem.locate_dofs_topological(V, d - 1, tags.find(CLAMP)), V)]
    options |= {"friction": friction, "thickness": thickness}
    if parts == 1:
        contacts = [contact_of(domain, tags, swap=swap, **options)]
    else:
        facets = tags.find(UPPER_BOTTOM)
        part = (compute_midpoints(domain, d - 1, facets)[:, 0] / unit * parts).astype(np.int32)
        cut = meshtags(domain, d - 1, facets, part)
        target = Surface(domain, tags, LOWER_TOP)
        contacts = [Contact(Surface(domain, cut, k), target, name=f"part {k}", **options) for k in range(parts)]
    return ContactProblem(F, u, bcs=bcs, contacts=contacts), P


def with_sides(domain, tags, height):
    """Tags of the interface with the upper block's sides in the surface of its bottom."""
    d = domain.topology.dim - 1
    domain.topology.create_connectivity(d, d + 1)
    outer = exterior_facet_indices(domain.topology)
    y = compute_midpoints(domain, d, outer)[:, 1]
    contactor = np.union1d(tags.find(UPPER_BOTTOM), outer[(y > 1e-9) & (y < height - 1e-9)])
    facets = np.concatenate([contactor, tags.find(LOWER_TOP)]).astype(np.int32)
    values = np.repeat([UPPER_BOTTOM, LOWER_TOP], [len(contactor), len(facets) - len(contactor)]).astype(np.int32)
    order = np.argsort(facets)
    return meshtags(domain, d, facets[order], values[order])


def blocks(comm=MPI.COMM_WORLD, *, order=2, friction=0.0, pressure=0.0, dim=2, triangles=False, cells=(4, 4), height=0.5,
           sides=False, **options):  # fmt: skip
    """Two stacked blocks on rollers under a dead pressure on top: (problem, pressure in Pa); with `sides` those of the upper
    one are in its surface."""
    built = TwoBeams(height=height, width=0.5, along=cells, across=2, through=2, dim=dim, triangles=triangles)
    domain, _, tags = built.create(comm)
    tags = with_sides(domain, tags, height) if sides else tags
    u = fem.Function(fem.functionspace(domain, ("Lagrange", order, (dim,))))
    V = u.function_space

    def dofs(axis, value):
        facets = locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[axis], value))
        return fem.locate_dofs_topological((V.sub(axis), V.sub(axis).collapse()[0]), dim - 1, facets)

    def roller(axis, value):
        zero = fem.Function(V.sub(axis).collapse()[0])
        return fem.dirichletbc(zero, dofs(axis, value), V.sub(axis))

    p = fem.Constant(domain, pressure)
    on_top = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(domain)[1], height * 0.999), 1.0, 0.0)
    down = ufl.as_vector([0.0, -1.0, 0.0][:dim])
    F = materials.saint_venant_kirchhoff(E, NU).virtual_work(u)
    F -= loads.dead_traction(u, p * on_top * down, ufl.Measure("ds", domain))
    bcs = [roller(0, 0.0), roller(1, -height)] + ([roller(2, 0.0)] if dim == 3 else [])
    return ContactProblem(F, u, bcs=bcs, contacts=[contact_of(domain, tags, friction=friction, **options)]), p


def marked(kind, domain, tags, tag):
    """The measure of what a tag marks, as tag 1, so that forms over all of them compile once."""
    found = tags.find(tag)
    one = meshtags(domain, tags.dim, found, np.ones(len(found), dtype=np.int32))
    return ufl.Measure(kind, domain, subdomain_data=one)(1)


def set_field(problem, displacement, multiplier=None, clamped=True):
    """u = displacement(X) with X (n, gdim), zero where prescribed if `clamped`, and Λ = multiplier(X)."""
    V = problem.u.function_space
    d = problem.gdim
    X = V.tabulate_dof_coordinates()[:, :d]
    problem.u.x.array[:] = displacement(X).ravel()
    for pair in problem.pairs:
        if clamped:
            problem.u.x.array[problem.bodies.bodies[0].prescribed().x.array > 0] = 0.0
        if multiplier is not None:
            Q = pair.multiplier.field
            values = multiplier(Q.function_space.tabulate_dof_coordinates()[:, :d])
            Q.x.array[:] = values[:, : pair.multiplier.components].ravel()
            start = Q.function_space.dofmap.index_map.local_range[0] * pair.multiplier.components
            Q.x.array[pair.multiplier.idle - start] = 0.0
            Q.x.scatter_forward()
    problem.u.x.scatter_forward()


def tip(problem, X=(1.0, 0.025)):
    """Displacement of the node nearest to X, its last coordinate zero unless given, on every rank."""
    x = problem.u.function_space.tabulate_dof_coordinates()
    distance = np.linalg.norm(x - np.pad(X, (0, 3 - len(X))), axis=1)
    k = int(np.argmin(distance)) if len(x) else 0
    mine = (distance[k], tuple(problem.u.x.array.reshape(-1, problem.gdim)[k])) if len(x) else (np.inf, ())
    return np.array(min(problem.comm.allgather(mine))[1])


def assert_tangent(problem, at, go, h=1e-8):
    """K d against (R(h) − R(−h))/2h for each block, below 1e-6. `at(h)` gives the residual's blocks at h times the direction
    d from the state the Jacobian is taken at (where the problem is now); `go()` makes d the problem's fields."""
    problem.assemble_jacobian()
    go()
    d, Kd = problem.x.duplicate(), problem.x.duplicate()
    problem.pack(d)
    problem.matrix.mult(d, Kd)
    plus, minus = at(h), at(-h)
    for k, part in enumerate(Kd.getNestSubVecs()):
        difference = (plus[k] - minus[k]) / (2 * h)
        error = np.sqrt(problem.comm.allreduce(float(np.sum((difference - part.array) ** 2))))
        assert error < 1e-6 * part.norm()


def rough(scale, seed):
    """A smooth vector field of X with no symmetry, of size `scale`."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(5, 20, (3, 3))
    phase = rng.uniform(0, 6, 3)
    return lambda X: scale * np.sin(X @ waves[: X.shape[1], : X.shape[1]] + phase[: X.shape[1]])


def membranes(comm=MPI.COMM_WORLD, *, order=2, friction=0.0, contact=True, swap=False, epsilon_normal=None,
              epsilon_tangential=None, integration="gauss", **shape):  # fmt: skip
    """The two membranes of section 4.2: (problem, pressure in Pa); `problem.lower` are the cells of the lower one."""
    built = TwoMembranes(**shape)
    domain, cells, edges = built.create(comm)
    d = built.dim
    V = fem.functionspace(domain, ("Lagrange", order, (d,)))
    u, p = fem.Function(V), fem.Constant(domain, 0.0)
    up = np.eye(d)[1]
    dx = ufl.Measure("dx", domain, subdomain_data=cells)
    sheet = membrane.neo_hookean_membrane(E, NU, 1e-3)
    F = sheet.virtual_work(u, dx=dx)
    F -= loads.membrane_pressure(u, p, up, dx(LOWER)) + loads.membrane_pressure(u, p, -up, dx(UPPER))
    bcs = [fem.dirichletbc(np.zeros(d), fem.locate_dofs_topological(V, d - 2, edges.find(EDGE)), V)]
    sides = [Surface(domain, cells, UPPER, side=-up), Surface(domain, cells, LOWER, side=up)]
    contactor, target = reversed(sides) if swap else sides
    options = {"epsilon_normal": epsilon_normal, "epsilon_tangential": epsilon_tangential, "multiplier_order": order}
    options |= {"integration": integration}
    contacts = [Contact(contactor, target, friction=friction, **options)] if contact else []
    problem = ContactProblem(F, u, bcs=bcs, contacts=contacts)
    problem.lower = cells.find(LOWER)
    return problem, p


def octant(comm=MPI.COMM_WORLD, size=0.5):
    """An octant of a spherical balloon of radius 1 m under inner pressure: (problem, pressure in Pa)."""

    def build(gmsh):
        ball = gmsh.model.occ.addSphere(0, 0, 0, 1, angle1=0, angle2=np.pi / 2, angle3=np.pi / 2)
        gmsh.model.occ.synchronize()
        skin = [
            t for d, t in gmsh.model.getBoundary([(3, ball)], oriented=False) if gmsh.model.getType(2, t) == "Sphere"
        ]
        others = [(d, t) for d, t in gmsh.model.getEntities(2) if t not in skin]
        gmsh.model.removeEntities([(3, ball), *others])  # DOLFINx from 0.10 on wants a group for each cell
        gmsh.model.addPhysicalGroup(2, skin, 1)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(2)

    domain = distribute(build, comm, 3)[0]
    V = fem.functionspace(domain, ("Lagrange", 2, (3,)))
    u, p = fem.Function(V), fem.Constant(domain, 0.0)
    sheet = membrane.neo_hookean_membrane(E, NU, 1e-3)
    F = sheet.virtual_work(u) - loads.membrane_pressure(u, p, ufl.SpatialCoordinate(domain), ufl.dx(domain))
    bcs = []
    for axis in range(3):
        W = V.sub(axis).collapse()[0]
        dofs = fem.locate_dofs_geometrical((V.sub(axis), W), lambda x, axis=axis: np.abs(x[axis]) < 1e-9)
        bcs.append(fem.dirichletbc(fem.Function(W), dofs, V.sub(axis)))
    return ContactProblem(F, u, bcs=bcs), p


class FailingSolver(NewtonSolver):
    """Says that some of its solves failed, after having moved everything."""

    def __init__(self, problem, failures):
        super().__init__(problem)
        self.calls, self.failures = 0, failures

    def solve(self, path=None):
        self.calls += 1
        result = super().solve(path)
        if self.calls in self.failures:
            for pair in self.problem.pairs:
                pair.commit()  # a wrong slip history, which the rollback must undo
            result.converged = False
        return result
