"""What the cases share: a small-strain material, contacts, conditions, and a march that counts its effort."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al import Contact, ContactProblem, Surface, quasistatic
from dolfinx_mortar_al.contact_fields import ContactFields
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.materials import lame
from dolfinx_mortar_al.newton import NewtonSolver
from dolfinx_mortar_al.obstacles import Obstacle
from dolfinx_mortar_al.verify.case import Effort

__all__ = [
    "elastic_stress",
    "elastic_work",
    "hold",
    "integral",
    "make_contact",
    "march",
    "mean",
    "measures",
    "profile",
    "space",
    "unknowns",
]

Array = NDArray[np.float64]


def make_contact(contactor: Surface, target: Surface | Obstacle, **options: Any) -> Contact:
    """Every contact of the suite comes from here: the package's defaults, but for what a case says."""
    return Contact(contactor, target, **options)


def space(domain: Any, order: int) -> tuple[fem.FunctionSpace, fem.Function]:
    """A displacement of Lagrange elements of an order, and its space."""
    V = fem.functionspace(domain, ("Lagrange", order, (domain.geometry.dim,)))
    return V, fem.Function(V)


def measures(domain: Any, cells: Any, facets: Any) -> tuple[ufl.Measure, ufl.Measure]:
    """dx and ds with tags."""
    return ufl.Measure("dx", domain, subdomain_data=cells), ufl.Measure("ds", domain, subdomain_data=facets)


def elastic_stress(u: fem.Function, E: float, nu: float, plane_stress: bool = False) -> Any:
    """Hooke's stress (Pa) of the small strain of u; in two dimensions plane strain or plane stress."""
    G, Λ = lame(E, nu)
    if plane_stress:
        Λ = 2 * G * Λ / (Λ + 2 * G)
    strain = ufl.sym(ufl.grad(u))
    return 2 * G * strain + Λ * ufl.tr(strain) * ufl.Identity(len(u))


def elastic_work(u: fem.Function, E: float, nu: float, dx: ufl.Measure, plane_stress: bool = False) -> Any:
    """Internal virtual work of small-strain elasticity, the theory that the references are of."""
    v = ufl.TestFunction(u.function_space)
    degree = 2 * u.function_space.ufl_element().embedded_subdegree
    return ufl.inner(elastic_stress(u, E, nu, plane_stress), ufl.grad(v)) * dx(degree=degree)


def hold(
    V: fem.FunctionSpace, facets: Any, tag: int, axis: int | None = None, value: fem.Function | None = None
) -> fem.DirichletBC:
    """A condition on the facets with a tag: component `axis` (all, if None) is zero, or that of `value`."""
    dim = V.mesh.topology.dim - 1
    V.mesh.topology.create_connectivity(dim, dim + 1)
    if axis is None:
        held = fem.Function(V) if value is None else value
        return fem.dirichletbc(held, fem.locate_dofs_topological(V, dim, facets.find(tag)))
    W = V.sub(axis).collapse()[0]
    dofs = fem.locate_dofs_topological((V.sub(axis), W), dim, facets.find(tag))
    return fem.dirichletbc(fem.Function(W) if value is None else value, dofs, V.sub(axis))


def march(
    problem: ContactProblem,
    load: Any,
    *,
    to: float,
    increments: int,
    effort: Effort,
    start: float | None = None,
    each: Callable[[float], None] | None = None,
    until: Callable[[], bool] | None = None,
    rtol: float = 1e-9,
) -> float:
    """`quasistatic.march` to its end, its effort added to `effort`; the last load. `each` sees each converged load."""
    begin, last = perf_counter(), np.nan
    solver = NewtonSolver(problem, rtol=rtol)
    for step in quasistatic.march(problem, load, to=to, increments=increments, start=start, until=until, solver=solver):
        effort.iterations += step.iterations
        effort.rejected += step.rejected
        last = step.load
        if each is not None:
            each(step.load)
    effort.seconds += perf_counter() - begin
    return last


def unknowns(u: fem.Function) -> int:
    """Global number of displacements."""
    V = u.function_space
    return int(V.dofmap.index_map.size_global * V.dofmap.index_map_bs)


def integral(pair: ContactPair, values: NDArray[Any]) -> float:
    """∫ values dS₀ over the contactor, of (n,) values at this rank's points (collective)."""
    return float(pair.comm.allreduce(float(pair.j @ values), MPI.SUM))


def mean(u: fem.Function, axis: int, dx: ufl.Measure) -> float:
    """Mean of a component of u over the cells of a measure (collective)."""
    comm = u.function_space.mesh.comm
    one = fem.Constant(u.function_space.mesh, 1.0)
    total, size = (comm.allreduce(fem.assemble_scalar(fem.form(f * dx)), MPI.SUM) for f in (u[axis], one))
    return float(total / size)


def profile(problem: ContactProblem) -> ContactFields:
    """The first pair's contact state along its contactor, on every rank."""
    found = problem.comm.bcast(problem.pairs[0].fields_on_root())
    assert found is not None
    return found
