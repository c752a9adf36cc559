"""What a user passes, checked once, where it enters: numbers, lists, forms, meshes, motions (``docs/errors.md``).

Every message names the argument and its value and says what to pass instead. Values that are the same on all ranks are judged
alike on all ranks; what a rank sees of a mesh is reduced over them before anyone raises.
"""

from __future__ import annotations

import inspect
import itertools
import math
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import basix
import numpy as np
import ufl
from dolfinx import fem, mesh
from numpy.typing import NDArray
from ufl.algorithms import extract_coefficients

from dolfinx_mortar_al.reductions import any_over, min_over
from dolfinx_mortar_al.versions import geometry_degree, geometry_nodes

__all__ = [
    "are_tags_of",
    "check_callable",
    "check_cells",
    "check_columns",
    "check_dead",
    "check_external",
    "check_kinetic",
    "check_law",
    "check_linear",
    "check_measures",
    "check_motions",
    "check_names",
    "check_not_negative",
    "check_residual",
    "check_scalar",
    "check_scalars",
    "check_space",
    "constant_value",
    "is_ufl",
    "joint_thickness",
    "listed",
    "make_folder",
    "number",
    "numbers",
    "path_of",
    "positive_or_ufl",
    "takes",
    "varies",
    "vector",
    "whole",
]

Item = TypeVar("Item")


def varies(value: Any) -> bool:
    """Whether a value is made of Functions, or holds one: UFL tries for ever to make a number of those."""
    if isinstance(value, list | tuple):
        return any(map(varies, value))
    return isinstance(value, ufl.core.expr.Expr) and bool(extract_coefficients(value))


def numbers(value: Any) -> NDArray[np.float64]:
    """The numbers that a value is, as a new array; none where it is something else."""
    try:
        return np.zeros(0) if varies(value) else np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return np.zeros(0)


def number(
    name: str,
    value: Any,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    most: float = math.inf,
    must: str = "must be",
) -> float:
    """A finite number with above < value < below and least ≤ value ≤ most.

    Raises:
        ValueError: if it is none.
    """
    bounds = [f"> {above:g}"] * (above > -math.inf) + [f"≥ {least:g}"] * (least > -math.inf)
    bounds += [f"< {below:g}"] * (below < math.inf) + [f"≤ {most:g}"] * (most < math.inf)
    wanted = f"{must} a number {' and '.join(bounds)}".rstrip()
    try:
        result = math.nan if isinstance(value, str | bytes | bool | np.bool_) or varies(value) else float(value)
    except (TypeError, ValueError):
        result = math.nan
    if not (math.isfinite(result) and above < result < below and least <= result <= most):
        raise ValueError(f"{name} = {value!r}: {wanted}" if isinstance(value, str) else f"{name} = {value}: {wanted}")
    return result


def whole(name: str, value: Any, *, least: int, most: int | None = None) -> int:
    """An integer from `least` to `most`; 3.0 counts as 3.

    Raises:
        ValueError: if it is none.
    """
    span = f"≥ {least}" if most is None else f"in {least} … {most}"
    try:
        result = number(name, value, least=least, most=math.inf if most is None else most)
    except ValueError:
        result = math.nan
    if result != np.floor(result):
        said = f"{value!r}" if isinstance(value, str) else f"{value}"
        raise ValueError(f"{name} = {said}: must be a whole number {span}")
    return int(result)


def vector(name: str, value: Any, components: int) -> NDArray[np.float64]:
    """`components` finite numbers.

    Raises:
        ValueError: if it is something else.
    """
    result = numbers(value)
    if result.shape != (components,) or not np.isfinite(result).all():
        raise ValueError(f"{name} = {value}: needs {components} components, finite numbers")
    return result


def check_scalar(name: str, field: fem.Constant | fem.Function) -> None:
    """Constants and Functions must be in float64: DOLFINx compiles no form of several kinds of numbers.

    Raises:
        ValueError: if one is not.
    """
    if field.dtype != np.float64:
        kind = type(field).__name__
        way = f"fem.{kind}(mesh, default_scalar_type(…))" if kind == "Constant" else f"fem.{kind}(V)"
        raise ValueError(f"{name}: a {kind} of {field.dtype}; make it one of float64, as {way} does")


def constant_value(value: Any, name: str = "a number") -> Any:
    """The number in a UFL Constant; anything else as it is.

    Raises:
        ValueError: if the Constant is not of float64, or no scalar.
    """
    if not isinstance(value, fem.Constant):
        return value
    check_scalar(name, value)
    if value.value.shape:
        raise ValueError(f"{name}: a Constant of shape {value.value.shape}; must be one number")
    return float(value.value)


def is_ufl(name: str, value: Any) -> bool:
    """Whether a value is UFL, to be taken as it is.

    Raises:
        ValueError: if it is UFL, but no scalar.
    """
    if not isinstance(value, ufl.core.expr.Expr):
        return False
    if value.ufl_shape:
        raise ValueError(f"{name}: UFL of shape {value.ufl_shape}; must be a scalar")
    return True


def positive_or_ufl(name: str, value: Any) -> Any:
    """A positive number, or UFL to be taken as it is.

    Raises:
        ValueError: if it is neither, or a Constant that is not positive.
    """
    said = constant_value(value, name)
    if is_ufl(name, said):
        return value
    checked = number(name, said, above=0.0)
    return checked if said is value else value


def check_not_negative(name: str, value: Any, domain: mesh.Mesh, cells: NDArray[np.int32]) -> None:
    """A Function that has its least value where it is stored, being constant or linear in each cell, is nowhere negative in
    `cells` (collective). Of other UFL, and of what is no number, nothing is said.

    Raises:
        ValueError: on every rank, with the least value.
    """
    if not isinstance(value, fem.Function) or value.function_space.mesh is not domain:
        return
    element = value.function_space.ufl_element()
    if element.element_family != basix.ElementFamily.P or element.degree > 1:
        return
    found = value.x.array[value.function_space.dofmap.list[cells]]
    least = min_over(domain.comm, float(np.fmin.reduce(found, axis=None, initial=np.inf)))
    if least < 0.0:
        raise ValueError(f"{name}: Function {value.name!r} has the value {least:.6g}; none may be negative")


def listed(name: str, value: Any, kind: type[Item], article: str) -> list[Item]:
    """A list of `kind` from one of them, several, or None.

    Raises:
        ValueError: if something else is among them; `article` is what to call one.
    """
    if value is None:
        return []
    items = [value] if isinstance(value, kind) else list(value) if isinstance(value, Sequence) else [value]
    for item in items:
        if not isinstance(item, kind):
            raise ValueError(f"{name}: {item!r} is not {article}; pass one or a list of them")
    return items


def check_callable(name: str, function: Any, argument: str) -> None:
    """A function of one argument.

    Raises:
        ValueError: if it takes another number.
    """
    if not callable(function) or not takes(function, 0.0):
        raise ValueError(f"{name}: {function!r} cannot be called with one argument, {argument}")


def takes(function: Callable[..., Any], *arguments: Any) -> bool:
    """Whether a function can be called with these arguments, as far as its signature is known."""
    try:
        inspect.signature(function).bind(*arguments)
    except ValueError:  # no signature to look at
        return True
    except TypeError:
        return False
    return True


def path_of(name: str, value: Any) -> Path:
    """A path from a text or path.

    Raises:
        ValueError: if it is neither.
    """
    if not isinstance(value, str | os.PathLike):
        raise ValueError(f"{name}: {type(value).__name__} is no path; pass a text or a Path")
    return Path(value)


def make_folder(name: str, folder: Path) -> None:
    """Make the folder that an argument names, if it is missing.

    Raises:
        OSError: if it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(
            error.errno, f"{name} = {folder}: no such folder can be made ({error.strerror}); pass one to write in"
        ) from error


def check_columns(columns: Any) -> list[str]:
    """Names of a table's columns: texts, none twice.

    Raises:
        ValueError: if they are something else.
    """
    names = [] if isinstance(columns, str) or not isinstance(columns, Iterable) else list(columns)
    if not names or any(not isinstance(name, str) or not name for name in names) or len(set(names)) < len(names):
        raise ValueError(f"columns = {columns!r}: pass a list of names, such as ['load', 'force'], none of them twice")
    return names


def check_names(names: Sequence[str | None]) -> list[str]:
    """Names of pairs, no two alike; those left out become "contact", numbered where there are several.

    Raises:
        ValueError: if two are given alike.
    """
    given = [name for name in names if name is not None]
    twice = sorted({name for name in given if given.count(name) > 1})
    if twice:
        raise ValueError(
            f"name = {twice[0]!r} of several contacts: files and results are kept by name, give each its own"
        )
    if len(names) == 1:
        return [names[0] or "contact"]
    free = (name for name in (f"contact_{k}" for k in itertools.count(1)) if name not in given)
    return [next(free) if name is None else name for name in names]


# ---------------------------------------------------------------- forms


def check_residual(F: Any, u: fem.Function, name: str = "F") -> None:
    """F must be a UFL form, linear in the test function of u's space, and depend on u.

    Raises:
        ValueError: if it is something else.
    """
    if not isinstance(F, ufl.Form):
        raise ValueError(f"{name}: {type(F).__name__} is not a UFL form; pass internal minus external virtual work")
    arguments = F.arguments()
    if len(arguments) != 1:
        found = {0: "no test function", 2: "a trial function, too"}.get(len(arguments), f"{len(arguments)} arguments")
        raise ValueError(f"{name} has {found}: pass a residual, linear in the test function of u's space")
    if arguments[0].ufl_function_space() != u.function_space:
        raise ValueError(
            f"{name}: its test function is of another space than u: use ufl.TestFunction(u.function_space)"
        )
    check_measures(F, name)
    check_scalars(F, name)
    if u not in F.coefficients():
        raise ValueError(f"{name} does not depend on u: is it written with another Function?")


def check_scalars(form: ufl.Form, name: str) -> None:
    """A form's Constants and Functions must be in float64.

    Raises:
        ValueError: if one is not.
    """
    for field in (*form.constants(), *form.coefficients()):
        if isinstance(field, fem.Constant | fem.Function):
            check_scalar(name, field)


def check_measures(F: ufl.Form, name: str) -> None:
    """Integrals must be over the mesh of the test function, those of one kind over measures of the same tags, each of which
    marks something (collective).

    Raises:
        ValueError: on every rank, if they are not.
    """
    domain = F.arguments()[0].ufl_function_space().ufl_domain()
    fields = [f for f in F.coefficients() if f.ufl_function_space().ufl_domain() != domain]
    if fields:
        raise ValueError(
            f"{name}: {fields[0]} is a Function on another mesh than the displacement's; make it on the same"
        )
    if any(integral.ufl_domain() != domain for integral in F.integrals()):
        raise ValueError(
            f"{name}: an integral over another mesh than the displacement's; make its measure of the same, "
            'ufl.Measure("dx", u.function_space.mesh, …)'
        )
    for kind, data in next(iter(F.subdomain_data().values()), {}).items():
        if any(other is not data[0] for other in data):
            raise ValueError(
                f"{name}: its {kind} integrals have different subdomain_data: write all with measures of the same tags (pass "
                "dx= to virtual_work and loads)"
            )
    comm = F.arguments()[0].ufl_function_space().mesh.comm
    for integral in F.integrals():
        tag, tags = integral.subdomain_id(), integral.subdomain_data()
        if isinstance(tag, str) or not (tags is None or isinstance(tags, mesh.MeshTags)):
            continue  # everywhere, or where lists of entities say
        if not any_over(comm, tags is not None and bool(np.isin(tags.values, tag).any())):
            raise ValueError(
                f"{name}: its {integral.integral_type()} integral is over the tag {tag}, which marks nothing; write it with "
                "a measure of subdomain_data that have this tag, or leave it out"
            )


def check_external(external: Any, u: fem.Function) -> None:
    """The virtual work of loads, if any: a UFL form, linear in the test function of u's space.

    Raises:
        ValueError: if it is something else.
    """
    if external is None:
        return
    if not isinstance(external, ufl.Form):
        raise ValueError(
            f"external: {type(external).__name__} is not a UFL form; pass a virtual work such as ρ g·w dx, a (force, "
            "measure), or a list of them"
        )
    arguments = external.arguments()
    if not arguments:
        raise ValueError(
            "external: there is no test function in it, as in the work of a force that is 0 for good, such as a Constant's "
            "value 0.0 in place of the Constant; write the Constant itself, for a march to move, or leave it out"
        )
    if len(arguments) != 1 or arguments[0].ufl_function_space() != u.function_space:
        raise ValueError("external: must be linear in the test function of u's space")
    check_scalars(external, "external")
    check_linear("external", external)


def check_dead(external: Any, u: fem.Function) -> None:
    """Loads in motion do not depend on u.

    Raises:
        ValueError: if they do.
    """
    if external is not None and u in external.coefficients():
        raise ValueError(
            "external depends on u: only dead loads have a work that the ledger can keep; what depends on u belongs into the "
            "material or into F"
        )


def check_linear(name: str, form: ufl.Form) -> None:
    """As far as UFL can tell, a form is linear in its test function.

    Raises:
        ValueError: if it is not.
    """
    arities = ufl.algorithms.check_arities
    try:
        arities.check_form_arity(form, form.arguments())  # as it is written, which is quick
    except (arities.ArityMismatch, Exception):  # there are derivatives in it, or it is not
        _check_written_out(name, form)


def _check_written_out(name: str, form: ufl.Form) -> None:
    try:
        ufl.algorithms.compute_form_data(form)
    except ufl.algorithms.check_arities.ArityMismatch as error:
        raise ValueError(f"{name} is not linear in the test function: {error}") from None
    except Exception:  # the form compiler says more
        return


def check_motions(motions: Sequence[Any], bodies: int) -> None:
    """All bodies of a problem are motions.

    Raises:
        ValueError: if one is not.
    """
    if len(motions) < bodies:
        raise ValueError(
            f"problem: {len(motions)} of its {bodies} displacements move: make it of one motion for each, "
            "ContactProblem(dynamics.Motion(body, step=…), contacts=…)"
        )


def check_still(motions: Sequence[Any]) -> None:
    """No body of a problem is a motion.

    Raises:
        ValueError: if one is.
    """
    if motions:
        raise ValueError(
            f"problem: {len(motions)} of its displacements move; march it in time with dynamics.march(problem, to=…), or "
            "pass ContactProblem the Body itself instead of dynamics.Motion(body, step=…)"
        )


def joint_thickness(contact: Any, name: str, bodies: Sequence[Any]) -> float:
    """Thickness out of the plane (m) of a contact: its own, or that of the bodies it joins, or 1 where neither is said.

    Raises:
        ValueError: where they differ, or where nothing but UFL says it.
    """
    said = {} if contact.thickness is None else {f"the contact {name!r}": contact.thickness}
    widths = {f"the body of u[{k}]": width for k, width in _widths(contact, bodies).items()}
    said |= {whose: width for whose, width in widths.items() if not isinstance(width, ufl.core.expr.Expr)}
    if widths and not said:
        raise ValueError(
            f"thickness of {next(iter(widths))} is UFL: pass that of the contact {name!r} as a number. Bodies of revolution "
            "(2 π r) have hoop strains, which plane laws do not: mesh a sector in space"
        )
    check_plane(contact.thickness, contact.contactor.mesh.geometry.dim)
    first, thickness = next(iter(said.items()), ("", 1.0))
    for whose, width in said.items():
        if not math.isclose(thickness, width, rel_tol=1e-9):
            raise ValueError(
                f"thickness = {width:g} of {whose}, but {thickness:g} of {first}: a contact and the bodies that it joins "
                "have one; leave the contact's out to take theirs"
            )
    return float(thickness)


def check_plane(thickness: Any, dim: int) -> None:
    """A thickness out of the plane is one of plane problems.

    Raises:
        ValueError: if it is said, and not 1, where `dim` is 3.
    """
    said = constant_value(thickness)
    if dim == 3 and said is not None and (isinstance(said, ufl.core.expr.Expr) or said != 1.0):
        raise ValueError(f"thickness = {said}: out of the plane, and this body is in space; leave it out")


def _widths(contact: Any, bodies: Sequence[Any]) -> dict[int, Any]:
    """Thickness of those bodies, by number, that a contact joins."""
    meshes = [surface.mesh for surface in (contact.contactor, contact.target) if hasattr(surface, "mesh")]
    mine = [
        (k, body) for k, body in enumerate(bodies) if any(body.u.function_space.mesh is domain for domain in meshes)
    ]
    return {k: constant_value(body.width) for k, body in mine}


def check_kinetic(energy: float) -> None:
    """A march starts from a finite kinetic energy (J).

    Raises:
        ValueError: if it is not a number.
    """
    if not math.isfinite(energy):
        raise ValueError(f"kinetic energy = {energy} J: a velocity or density is not a number")


def check_law(u: fem.Function, membrane: bool, what: str) -> None:
    """A body's law needs cells of the space's dimension, a membrane's one less.

    Raises:
        ValueError: on the other kind of mesh.
    """
    domain = u.function_space.mesh
    d, tdim = domain.geometry.dim, domain.topology.dim
    if tdim != d - int(membrane):
        kind, other = ("membrane", "body") if membrane else ("body", "membrane")
        raise ValueError(
            f"{what} is for a {kind}, whose cells have dimension {d - int(membrane)} in space of dimension {d}; those of "
            f"this mesh have {tdim}: " + (f"it is a {other}" if tdim == d - 1 + int(membrane) else "check gdim")
        )


# ---------------------------------------------------------------- meshes


def check_space(u: fem.Function) -> None:
    """A displacement is Lagrange of order 1 or 2 with as many components as space has dimensions, two or three.

    Raises:
        ValueError: if it is another Function.
    """
    V = u.function_space
    if u.dtype != np.float64 or V.mesh.geometry.x.dtype != np.float64:
        raise ValueError(f"u: {u.dtype} on a mesh of {V.mesh.geometry.x.dtype}; contact needs both in float64")
    if V.num_sub_spaces and not V.dofmap.index_map_bs > 1:
        raise ValueError("u: a mixed element; pass the displacement as a Function of a space of its own")
    domain, element = V.mesh, V.element.basix_element
    d, tdim = domain.geometry.dim, domain.topology.dim
    if d == 1:
        raise ValueError("u: a mesh of intervals in space of dimension 1; bodies are in the plane or in space")
    if tdim not in (d, d - 1):
        raise ValueError(f"a mesh of dimension {tdim} in space of dimension {d}: neither a body nor a membrane")
    if V.dofmap.index_map_bs != d:
        raise ValueError(
            f"u has {V.dofmap.index_map_bs} components on a mesh in space of dimension {d}: take it from "
            f'fem.functionspace(mesh, ("Lagrange", 2, ({d},)))'
        )
    if element.family.name != "P" or element.degree not in (1, 2) or element.discontinuous:
        raise ValueError(f"u: {V.ufl_element()} is not a continuous Lagrange element of order 1 or 2")
    if geometry_degree(domain) > 2:
        raise ValueError(
            f"u: on a mesh of order {geometry_degree(domain)}, and u has order 1 or 2; mesh with order 2 at most"
        )
    if geometry_degree(domain) > element.degree:
        raise ValueError(
            f"u has order {element.degree} on a mesh of order {geometry_degree(domain)}: "
            "take u at least of the mesh's order"
        )


def are_tags_of(tags: Any, domain: mesh.Mesh) -> bool:
    """Whether mesh tags are of this mesh."""
    return bool(tags.topology is domain._cpp_object.topology)


def check_cells(domain: mesh.Mesh) -> None:
    """Every cell's map from its reference cell must be one to one: det J of one sign and not zero (collective).

    Raises:
        ValueError: on every rank, with the place of a cell that is folded or has no volume.
    """
    geometry, tdim = domain.geometry, domain.topology.dim
    element = basix.create_element(
        basix.ElementFamily.P, domain.basix_cell(), geometry_degree(domain), basix.LagrangeVariant.equispaced
    )
    points = np.vstack([basix.make_quadrature(domain.basix_cell(), 2 * geometry_degree(domain))[0]])
    table = element.tabulate(1, points)[1 : tdim + 1, :, :, 0]  # (tdim, points, nodes)
    cells = geometry_nodes(domain)[: domain.topology.index_map(tdim).size_local]
    X = geometry.x[cells, : geometry.dim].astype(np.float64)  # (cells, nodes, gdim)
    J = np.einsum("tqn,cni->cqit", table, X)
    if tdim == geometry.dim:
        volume = np.linalg.det(J)
    else:
        volume = np.sqrt(np.maximum(np.linalg.det(np.swapaxes(J, -1, -2) @ J), 0.0))
    size = np.max(np.ptp(X, axis=1), axis=1, initial=0.0)[:, None] ** tdim
    flat = 1e-10 * size  # thinner cells than this have no stiffness in double precision
    bad = np.flatnonzero(~((volume > flat).all(axis=1) | (volume < -flat).all(axis=1)))
    mine = tuple(X[bad[0]].mean(axis=0).tolist()) if len(bad) else None
    found = [place for place in domain.comm.allgather((len(bad), mine)) if place[0]]
    if found:
        X0 = ", ".join(f"{x:.4g}" for x in found[0][1])
        raise ValueError(
            f"mesh: {sum(count for count, _ in found)} cells are folded or without volume (det J ≤ 0), one around "
            f"X = ({X0}): order the nodes of these cells as the element asks for, or mesh again"
        )
