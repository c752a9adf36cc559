"""Patch tests that code_aster prints: on either side of the interface a mesh, cells and an order of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.la import InsertMode
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al import ContactProblem, Surface
from dolfinx_mortar_al.contact_fields import ContactFields
from dolfinx_mortar_al.verify.case import Effort, Outcome, Quantity, Run, case
from dolfinx_mortar_al.verify.meshes import build, grid
from dolfinx_mortar_al.verify.model import (
    elastic_stress,
    elastic_work,
    hold,
    make_contact,
    march,
    measures,
    profile,
    space,
    unknowns,
)

__all__: list[str] = []

Array = NDArray[np.float64]
FAR, INTERFACE, SIDE = 1, 2, 10
EXACT, TIGHT = 1e-10, 1e-13  # of the answer and of Newton's residual, which is less than the error at a point


@dataclass(frozen=True)
class Cells:
    """Of a block: `n` along each of its sides, boxes or simplices, elements of an `order`."""

    n: int
    order: int
    simplices: bool = False


class Block:
    """The lower or the `upper` one of two cubes (squares) of a `side`, in a mesh of its own, of Hooke's material."""

    def __init__(self, dim: int, cells: Cells, side: float, upper: bool, E: float, nu: float) -> None:
        line = np.linspace(0.0, side, cells.n + 1)
        faces = {(dim - 1, 0): (FAR, INTERFACE)[upper], (dim - 1, -1): (INTERFACE, FAR)[upper]}
        faces |= {(axis, 0): SIDE + axis for axis in range(dim - 1)}
        body = grid([line] * (dim - 1) + [line + side * upper], faces, order=1, simplices=cells.simplices)
        self.mesh, tags, self.facets = build([body])
        self.V, self.u = space(self.mesh, cells.order)
        dx, self.ds = measures(self.mesh, tags, self.facets)
        self.work = elastic_work(self.u, E, nu, dx)
        self.stress = elastic_stress(self.u, E, nu)[dim - 1, dim - 1]
        self.surface = Surface(self.mesh, self.facets, INTERFACE)

    def largest(self, values: NDArray[np.floating[Any]]) -> float:
        """Largest size of values over ranks (collective)."""
        return float(self.mesh.comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX))

    def stress_defect(self, exact: float) -> float:
        """Largest |σ/exact − 1| of the stress across the interface, at Gauss points of all cells (collective)."""
        owned = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        points = basix.make_quadrature(self.mesh.basix_cell(), 2)[0]
        found = fem.Expression(self.stress, points).eval(self.mesh, np.arange(owned, dtype=np.int32))
        return self.largest(np.asarray(found) / exact - 1)

    def on_interface(self, f: fem.Function) -> Array:
        """(n,) last components of a field at this rank's nodes of the interface."""
        d = self.mesh.geometry.dim
        dofs = fem.locate_dofs_topological(self.V, d - 1, self.facets.find(INTERFACE))
        return np.asarray(f.x.array.reshape(-1, d)[dofs[dofs < self.V.dofmap.index_map.size_local], -1])

    def nodal_forces(self) -> fem.Function:
        """Of the stresses (N), in equilibrium with contact's on the interface."""
        f = fem.Function(self.V)
        fem.assemble_vector(f.x.array, fem.form(self.work))
        f.x.scatter_reverse(InsertMode.add)
        return f


@dataclass
class Solved:
    """Two blocks in equilibrium, the contact along the contactor, and the largest defect of its pressure."""

    blocks: tuple[Block, Block]
    contact: ContactFields
    defect: float

    @property
    def unknowns(self) -> int:
        return sum(unknowns(block.u) for block in self.blocks)


def solve(
    blocks: tuple[Block, Block],
    load: Callable[[float], None],
    pressure: float,
    effort: Effort,
    *,
    bcs: Sequence[fem.DirichletBC],
    extra: Any = 0,
    lower_is_contactor: bool = False,
) -> Solved:
    """Blocks (lower, upper) in one step to load(1) with segments; `extra`: virtual work of loads on the upper one."""
    lower, upper = blocks
    sides = [block.surface for block in (blocks if lower_is_contactor else blocks[::-1])]
    contact = make_contact(*sides, integration="segments")
    F = [lower.work, upper.work + extra]
    problem = ContactProblem(F, [lower.u, upper.u], bcs=bcs, contacts=[contact])
    march(problem, load, to=1.0, increments=1, start=0.0, effort=effort, rtol=TIGHT)
    defect = upper.largest(problem.pairs[0].state.p / pressure - 1)
    return Solved(blocks, profile(problem), defect)


def pushed_down(blocks: tuple[Block, Block], by: float, pressure: float, effort: Effort, **options: Any) -> Solved:
    """The far faces clamped, and the upper one's moved down."""
    lower, upper = blocks
    top = fem.Function(upper.V)

    def push(share: float) -> None:
        top.x.array.reshape(-1, upper.mesh.geometry.dim)[:, -1] = -share * by

    bcs = [hold(lower.V, lower.facets, FAR), hold(upper.V, upper.facets, FAR, value=top)]
    return solve(blocks, push, pressure, effort, bcs=bcs, **options)


def drawing(contact: ContactFields, pressure: float, title: str) -> Callable[[Any], None]:
    def draw(axes: Any) -> None:
        axes.plot(contact.X[:, 0], contact.pressure / pressure, ".", markersize=3)
        axes.set(xlabel="x", ylabel="pressure / exact", title=title)

    return draw


# ---------------------------------------------------------------- SSNP170

PRESSURE, HOOKE = 25.0, (2000.0, 0.3)
SSNP170 = (
    "SSNP170 (code_aster V6.03.170), exact: a uniform stress is in every finite-element space; tested there to 0.1 %"
)


def under_pressure(cells: tuple[Cells, Cells], lower_is_contactor: bool, effort: Effort) -> Solved:
    """Squares on rollers under 25 MPa, of (lower, upper) cells."""
    lower, upper = blocks = Block(2, cells[0], 1.0, False, *HOOKE), Block(2, cells[1], 1.0, True, *HOOKE)
    p = fem.Constant(upper.mesh, 0.0)
    bcs = [hold(block.V, block.facets, SIDE, 0) for block in blocks] + [hold(lower.V, lower.facets, FAR, 1)]

    def press(share: float) -> None:
        p.value = share * PRESSURE

    extra = p * ufl.TestFunction(upper.V)[1] * upper.ds(FAR)
    return solve(blocks, press, PRESSURE, effort, bcs=bcs, extra=extra, lower_is_contactor=lower_is_contactor)


@case(
    "patch-ssnp170",
    "Patch test SSNP170",
    [Quantity(name, SSNP170, EXACT, scale=1.0, order=0) for name in ("pressure", "stress")],
)
def ssnp170(quick: bool) -> Outcome:
    """Two squares of 1 mm, E = 2000 MPa, ν = 0.3, plane strain, small strains, on rollers, under 25 MPa; n facets of the
    lower one against m. Largest deviation at a point as a share of 25 MPa, over quadrilaterals and triangles of
    orders 1 and 2 on either side in all sixteen combinations, either side contactor. code_aster's cells of order 2
    are QUAD8 and TRIA6; quadrilaterals here have the node in the middle, too.
    """
    runs, kinds = [], list(product((1, 2), (False, True)))
    sides = list(product(kinds, kinds, (False, True)))
    if quick:
        sides = [(a, b, side) for a, b, side in sides if a[0] < b[0] and a[1] != b[1]]
    for n, m in ((4, 7),) if quick else ((4, 7), (8, 14)):
        effort, pressures, stresses = Effort(), [], []
        for a, b, side in sides:
            done = under_pressure((Cells(n, *a), Cells(m, *b)), side, effort)
            pressures.append(done.defect)
            stresses.append(max(block.stress_defect(-PRESSURE) for block in done.blocks))
        values = {"pressure": (max(pressures), 0.0), "stress": (max(stresses), 0.0)}
        picture = drawing(done.contact, PRESSURE, "triangles of order 2, the lower side contactor")
        runs.append(Run(f"{n}:{m}", 1 / n, values, effort, done.unknowns, picture))
    return Outcome(runs)


# ---------------------------------------------------------------- SSNP121

SOFT, DOWN = (2e6, 0.0), 0.1
SHORTENED = 0.5 * SOFT[0] * DOWN  # Pa
SSNP121 = (
    "SSNP121 (code_aster V6.03.121), exact; tested there to 0.1 %, of methods without mortar integration to 2 … 7.5 %"
)
MIXED = {
    "quadrilaterals on triangles": ((2, False), (2, True)),
    "triangles on quadrilaterals": ((2, True), (2, False)),
    "order 2 on order 1": ((2, False), (1, False)),
    "order 1 on order 2": ((1, True), (2, False)),
}  # facets in space, (order, simplices) of the contactor and of the target


@case(
    "patch-ssnp121",
    "Patch test SSNP121: cells and orders that differ across the interface",
    [
        Quantity(f"{dim}D, {what}", SSNP121, EXACT, scale=1.0, order=0)
        for dim in (2, 3)
        for what in ("pressure", "displacement")
    ],
)
def ssnp121(quick: bool) -> Outcome:
    """Two cubes (squares) of 1 m, E = 2 MPa, ν = 0, small strains, far faces clamped, the upper one's moved down by 0.1 m:
    a pressure of 1e5 Pa and a displacement of −0.05 m all over the interface. Facets of order 2 of hexahedra on those of
    tetrahedra (QUAD9 on TRIA6) and the other way round, order 2 on order 1 and the other way round (code_aster's models
    F, H and I); in the plane the same with quadrilaterals and triangles. Each block has a mesh and a displacement of its
    own. Largest deviation at a point, n facets along the contactor's side on m.
    """
    runs = []
    for sizes in (((5, 3), (3, 2)),) if quick else (((5, 3), (3, 2)), ((10, 6), (5, 3))):
        effort, values, count = Effort(), dict[str, tuple[float, float]](), 0
        for dim, (n, m) in zip((2, 3), sizes, strict=True):
            pressures, displacements = [], []
            for contactor, target in MIXED.values():
                blocks = (
                    Block(dim, Cells(m, *target), 1.0, False, *SOFT),
                    Block(dim, Cells(n, *contactor), 1.0, True, *SOFT),
                )
                done = pushed_down(blocks, DOWN, SHORTENED, effort)
                pressures.append(done.defect)
                displacements += [b.largest(b.on_interface(b.u) / (-DOWN / 2) - 1) for b in blocks]
                count = max(count, done.unknowns)
            values |= {f"{dim}D, pressure": (max(pressures), 0.0), f"{dim}D, displacement": (max(displacements), 0.0)}
        picture = drawing(done.contact, SHORTENED, "in space, tetrahedra of order 1 on hexahedra of order 2")
        runs.append(Run(f"{sizes[0][0]}:{sizes[0][1]}, {n}:{m}", 1 / n, values, effort, count, picture))
    return Outcome(runs)


# ---------------------------------------------------------------- SSNV167

EDGE, STEEL, LOWERED = 2.0, (2e5, 0.0), 0.2  # mm, MPa
FORCE = STEEL[0] * LOWERED / (2 * EDGE) * EDGE**2  # N
SHARES = {1: np.full(4, 1 / 4), 2: np.array([1] * 4 + [4] * 4 + [16]) / 36}  # of the nodes of a facet, ∫N dA / A
SSNV167 = "SSNV167 (code_aster V6.04.167), exact"


@case(
    "cubes-ssnv167",
    "Cubes SSNV167: displacements and nodal forces",
    [
        Quantity("uz, order 1", SSNV167, EXACT, "mm", order=0),
        Quantity("force at a node, order 1", SSNV167, EXACT, "N", order=0),
        Quantity("uz, order 2", SSNV167, EXACT, "mm", order=0),
        Quantity("force at a corner, order 2", SSNV167 + ", for its facets of 9 nodes", EXACT, "N", order=0),
        Quantity("all nodes' forces, order 2", SSNV167 + ": shares of 1, 4 and 16 in 36", EXACT, scale=1.0, order=0),
    ],
)
def ssnv167(quick: bool) -> Outcome:
    """Two cubes of 2 mm, one hexahedron each, E = 200 GPa, ν = 0, small strains, the upper one's far face lowered by 0.2 mm:
    the interface sinks by 0.1 mm under 40 kN, 10 kN at each node of order 1, and 1/36, 4/36 and 16/36 of it at corners,
    edges and the middle with order 2. Values are those furthest off.
    """
    effort, values, count = Effort(), dict[str, tuple[float, float]](), 0
    for order in (1, 2):
        blocks = Block(3, Cells(1, order), EDGE, False, *STEEL), Block(3, Cells(1, order), EDGE, True, *STEEL)
        done = pushed_down(blocks, LOWERED, FORCE / EDGE**2, effort)
        count = max(count, done.unknowns)
        depths, forces = (
            np.concatenate([gathered(b, b.on_interface(f)) for b, f in zip(blocks, fields, strict=True)])
            for fields in ([b.u for b in blocks], [b.nodal_forces() for b in blocks])
        )
        values[f"uz, order {order}"] = furthest(depths, -LOWERED / 2)
        exact = np.sort(FORCE * SHARES[order])
        found = np.sort(np.abs(forces.reshape(2, -1)), axis=1)
        name = "force at a node, order 1" if order == 1 else "force at a corner, order 2"
        values[name] = furthest(found[:, :4], exact[0])
        if order == 2:
            values["all nodes' forces, order 2"] = (float(np.abs(found / exact - 1).max()), 0.0)
    picture = drawing(done.contact, FORCE / EDGE**2, "order 2")
    return Outcome([Run("1:1", 1.0, values, effort, count, picture)])


def gathered(block: Block, values: Array) -> Array:
    """Values of all ranks on each (collective)."""
    return np.concatenate(block.mesh.comm.allgather(values))


def furthest(values: Array, exact: float) -> tuple[float, float]:
    """The value that is furthest from the exact one, and that."""
    flat = values.ravel()
    return float(flat[np.argmax(np.abs(flat - exact))]), exact
