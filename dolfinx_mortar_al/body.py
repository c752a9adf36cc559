"""A body, said once: its displacement, laws, thickness, density, loads and conditions, in equilibrium and in motion.

A law or a form of internal virtual work on a measure of cells is a part of the body; its residual, and that of a time step
(`motion`), are sums over the parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinx_mortar_al.compiling import compiled
from dolfinx_mortar_al.foreseen_pressure import ForeseenPressure
from dolfinx_mortar_al.materials import Hyperelastic, cell_measure, cells_of
from dolfinx_mortar_al.membrane import NeoHookeanMembrane
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.reductions import sum_over
from dolfinx_mortar_al.validation import (
    check_external,
    check_law,
    check_linear,
    check_measures,
    check_not_negative,
    check_plane,
    check_residual,
    check_space,
    listed,
    positive_or_ufl,
    vector,
)

__all__ = ["Body", "Material", "Part"]

#: what gives a part of a body its internal forces: a law with a stored energy, or a virtual work linear in the test function
Material: TypeAlias = Hyperelastic | NeoHookeanMembrane | ufl.Form


@dataclass(frozen=True)
class Part:
    """Cells of one material.

    Attributes:
        material: law or form.
        dx: measure of the cells.
        depth: thickness by which law and density count (m).
        density: ρ per reference volume (kg/m³), None where nothing moves.
    """

    material: Material
    dx: ufl.Measure
    depth: Any
    density: Any

    def virtual_work(self, u: fem.Function) -> Any:
        """The internal virtual work, linear in the test function."""
        if isinstance(self.material, NeoHookeanMembrane):
            return self.material.virtual_work(u, dx=self.dx)
        if isinstance(self.material, Hyperelastic):
            return self.material.virtual_work(u, dx=self.dx, thickness=self.depth)
        return self.material


class Body:
    """What a body is made of, held by and loaded with, for a :class:`~dolfinx_mortar_al.problem.ContactProblem` or a
    :class:`~dolfinx_mortar_al.motion.Motion`. Bodies of one mesh with one displacement are one Body.

    Args:
        u: displacement (m); holds the start state, which may be set until a march begins.
        material: what its internal forces come from, on all cells: a law, of a body or a membrane, or a UFL form of an
            internal virtual work G(u; w); or a list of (law or form, measure of its cells); a form is over these cells.
        density: ρ per reference volume (kg/m³), needed in motion; a list, if each part of a list of materials has its own.
        thickness: out of the plane (m), that of the contacts, too. A membrane's law has its own; a form has it written into
            it, and needs it here for its mass.
        external: dead or follower loads, one or a list of them: (force, measure) with a force per reference area (Pa) on
            `ds` or volume (N/m³) on `dx`, which the body's thickness multiplies: UFL with the space's number of components,
            such as ``-p * loads.area_normal(u)``, or a list of numbers and UFL; or a UFL form of the virtual work, such as
            the functions of :mod:`~dolfinx_mortar_al.loads` give it, with the thickness written into it.
        bcs: Dirichlet conditions on u.

    Attributes:
        residual: UFL form, internal minus external virtual work in equilibrium.
        parts: the materials with their measures.
        external: virtual work of the loads as a UFL form, None without any.
        foreseen: for the residual's derivative, of nearly incompressible parts; None without any.
        sheets: laws of membranes with their measures.

    Raises:
        ValueError: on every rank: a material for other cells, parts that leave cells out or have some in common, a density
            or thickness out of range, loads or conditions that are not of u's space.
    """

    def __init__(
        self,
        u: fem.Function,
        material: Material | Sequence[tuple[Material, ufl.Measure]],
        *,
        density: Any = None,
        thickness: Any = 1.0,
        external: ufl.Form | tuple[Any, ufl.Measure] | Sequence[ufl.Form | tuple[Any, ufl.Measure]] | None = None,
        bcs: Sequence[fem.DirichletBC] = (),
    ) -> None:
        if not isinstance(u, fem.Function):
            raise ValueError(f"u: {type(u).__name__} is not a Function; pass the displacement")
        check_space(u)
        self.u, self.thickness = u, positive_or_ufl("thickness", thickness)
        check_plane(thickness, u.function_space.mesh.topology.dim)
        self.bcs, self.density = _conditions(bcs, u), density
        self.external = _virtual_work(external, u, self.width)
        tags = _cell_tags([form for form in (material, self.external) if isinstance(form, ufl.Form)])
        #: measure of all cells
        self.dx = cell_measure(u, ufl.Measure("dx", u.function_space.mesh, subdomain_data=tags))
        self.parts = self._parts_of(material, density)
        self.check_densities()
        self.residual = sum(part.virtual_work(u) for part in self.parts)
        check_measures(self.residual, "material")
        if isinstance(material, list | tuple):
            self._check_cover()
        if self.external is not None:
            self.residual -= self.external
            check_measures(self.residual, "external")
        laws = [(p.material, p.dx, p.depth) for p in self.parts if isinstance(p.material, Hyperelastic)]
        self.foreseen = ForeseenPressure.of(u, laws)
        self.sheets = [(p.material, p.dx) for p in self.parts if isinstance(p.material, NeoHookeanMembrane)]

    @property
    def width(self) -> Any:
        """Out of the plane (m), as contact and loads count it: a membrane's own thickness is not that."""
        membrane = self.u.function_space.mesh.topology.dim < len(self.u)
        return 1.0 if membrane else self.thickness

    def check_densities(self) -> None:
        """A density that is a Function must not be negative in its part, as far as its values say (collective).

        Raises:
            ValueError: on every rank, with the least value.
        """
        domain = self.u.function_space.mesh
        for k, part in enumerate(self.parts):
            name = f"density[{k}]" if isinstance(self.density, list | tuple) else "density"
            check_not_negative(name, part.density, domain, cells_of(domain, part.dx))

    def _parts_of(self, material: Any, density: Any) -> list[Part]:
        several = isinstance(material, list | tuple)
        items: Any = material if several else [(material, self.dx)]
        if not items:
            raise ValueError("material = []: no part has a law or form")
        densities = list(density) if isinstance(density, list | tuple) else [density] * len(items)
        if len(densities) != len(items):
            raise ValueError(f"density: {len(densities)} of them for {len(items)} materials; pass one, or one each")
        densities = [None if ρ is None else positive_or_ufl("density", ρ) for ρ in densities]
        parts = []
        for k, (item, ρ) in enumerate(zip(items, densities, strict=True)):
            name = f"material[{k}]" if several else "material"
            law, dx = _on_measure(item, name, "law or form", ("cell",))
            if isinstance(law, ufl.Form) and several:
                _check_cells(name, law, dx)
            parts.append(Part(law, cell_measure(self.u, dx), self._depth_of(law, name), ρ))
        return parts

    def _depth_of(self, law: Any, name: str) -> Any:
        """The thickness of a law or form (m), which must be one of u."""
        if isinstance(law, ufl.Form):
            check_residual(law, self.u, name)
            check_linear(name, law)
            return self.thickness
        if not isinstance(law, Hyperelastic | NeoHookeanMembrane):
            raise ValueError(
                f"{name}: {type(law).__name__} is no material: pass a law with a stored energy, a UFL form of the internal "
                "virtual work, or a list of (law or form, measure)"
            )
        check_law(self.u, membrane=isinstance(law, NeoHookeanMembrane), what=f"{name} = {type(law).__name__}")
        if isinstance(law, Hyperelastic):
            return self.thickness
        if self.thickness != 1.0:
            raise ValueError(f"thickness = {self.thickness}: a membrane has its own; leave it out")
        return law.thickness

    def _check_cover(self) -> None:
        """Every cell must belong to one part: one of none would have neither stiffness nor mass, one of two parts both masses
        (collective)."""
        domain = self.u.function_space.mesh
        one = ufl.TestFunction(fem.functionspace(domain, ("DG", 0)))
        forms = [sum(one * part.dx for part in self.parts), one * self.dx]
        cells = domain.topology.index_map(domain.topology.dim).size_local
        share, whole = (fem.assemble_vector(compiled(form, domain)).array[:cells] for form in forms)
        times = np.round(share / whole).astype(int)
        none, twice = sum_over(domain.comm, np.array([np.sum(times == 0), np.sum(times > 1)])).astype(int)
        if none or twice:
            raise ValueError(
                f"material: {none} cells belong to no part and {twice} to several; give each cell to one of the measures"
            )


def _on_measure(item: Any, name: str, what: str, kinds: tuple[str, ...]) -> tuple[Any, ufl.Measure]:
    """A pair of something and a measure of the given kinds of integrals."""
    if not (isinstance(item, tuple) and len(item) == 2 and isinstance(item[1], ufl.Measure)):
        said = (
            f"({', '.join(type(part).__name__ for part in item)})" if isinstance(item, tuple) else type(item).__name__
        )
        raise ValueError(f"{name}: {said} is no ({what}, measure)")
    if item[1].integral_type() not in kinds:
        names = " or ".join({"cell": "dx", "exterior_facet": "ds"}[kind] for kind in kinds)
        raise ValueError(f"{name}: a measure of {item[1].integral_type()} integrals; pass {names}")
    return item


def _check_cells(name: str, form: ufl.Form, dx: ufl.Measure) -> None:
    """The cell integrals of a form that is given for a measure must be over cells of that.

    Raises:
        ValueError: on every rank, with the tags of both.
    """
    mine = dx.subdomain_id()
    if mine == "everywhere":
        return
    for integral in form.integrals():
        over = integral.subdomain_id()
        if integral.integral_type() == "cell" and (over == "everywhere" or not np.isin(over, mine).all()):
            cells = "all cells" if over == "everywhere" else f"cells of tag {over}"
            raise ValueError(
                f"{name}: a form over {cells} for a measure of tag {mine}; write both with the same measure"
            )


def _virtual_work(external: Any, u: fem.Function, width: Any) -> Any:
    """The loads' virtual work as a form, None without any."""
    if isinstance(external, list | tuple):
        loads = [external] if len(external) == 2 and isinstance(external[1], ufl.Measure) else external
        terms = [_load(item, f"external[{k}]", u, width) for k, item in enumerate(loads)]
        external = sum(terms) if terms else None
    check_external(external, u)
    return external


def _load(item: Any, name: str, u: fem.Function, width: Any) -> Any:
    """∫ width 𝐟·w over a measure, or a form as it is."""
    if isinstance(item, ufl.Form):
        return item
    if isinstance(item, tuple) and any(isinstance(part, ufl.Form) for part in item):
        raise ValueError(f"{name}: a form beside a measure; a form has its own: pass it alone")
    force, measure = _on_measure(item, name, "force", ("cell", "exterior_facet"))
    d = len(u)
    if isinstance(force, list | tuple) and any(isinstance(part, Expr) for part in force):
        force = ufl.as_vector(list(force))
    if not isinstance(force, Expr):
        force = ufl.as_vector(vector(name, force, d).tolist())
    elif force.ufl_shape != (d,):
        raise ValueError(f"{name}: a force of shape {force.ufl_shape}; needs {d} components")
    if measure.integral_type() == "cell":
        measure = cell_measure(u, measure)
    return width * ufl.inner(force, ufl.TestFunction(u.function_space)) * measure


def _cell_tags(forms: Sequence[ufl.Form]) -> Any:
    """The tags of the forms' cell integrals, which all of one residual must have; None without any."""
    found = [tags for form in forms for data in form.subdomain_data().values() for tags in data.get("cell", [])]
    return next((tags for tags in found if tags is not None), None)


def _conditions(bcs: Any, u: fem.Function) -> list[fem.DirichletBC]:
    conditions = listed("bcs", bcs, fem.DirichletBC, "a Dirichlet condition")
    agreed(u.function_space.mesh.comm, "bcs: how many", len(conditions))  # on ranks without a node of it, too
    for k, bc in enumerate(conditions):
        if not u.function_space._cpp_object.contains(bc.function_space):
            raise ValueError(f"bcs[{k}]: a Dirichlet condition on another space than u's; pass it to its own body")
        if not sum_over(u.function_space.mesh.comm, len(bc.dof_indices()[0])):
            raise ValueError(f"bcs[{k}]: a Dirichlet condition on no node; look at what its dofs were located by")
    return conditions
