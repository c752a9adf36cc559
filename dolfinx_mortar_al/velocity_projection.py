"""Velocities at the end of a step that persistent contact allows.

The positions of a step say nothing of the velocity with which a point in contact leaves it: with the mid-point rule that
of a node at rest on its target would swing from step to step and make the pressure swing with it. So the relative velocity
𝐆𝐯 of closed points is brought to zero, the normal part and, where they stick, the tangential one, weakly with the
multiplier's shape functions, by impulses 𝐈:

    𝐌(𝐯 − 𝐯*) = 𝐇ᵀ𝐈,   𝐆𝐯 = −𝐃𝐈,

𝐃 ≥ 0 from the open points of a multiplier's support. Where points stick, or there is no friction, 𝐇 = 𝐆: 𝐯 is the closest
such velocity in the norm of the mass and kinetic energy can only fall, by what the impact of nodes takes. Where they slip
impulses act along the step's traction; where a sticking point's impulse would leave Coulomb's cone it is let slip. 𝐆 and
𝐇 are zero for rigid motions: momentum and angular momentum stay. Prescribed velocities are in 𝐯 and stay what they are:
supports bear the impulses on them, and their columns of 𝐇 are zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.blocks import apply_columns
from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.law import Coulomb
from dolfinx_mortar_al.petsc_blocks import Layout, empty_matrix, insert, insert_vector
from dolfinx_mortar_al.problem import ContactProblem
from dolfinx_mortar_al.reductions import all_over, any_over, sum_over
from dolfinx_mortar_al.step_level import StepLevel
from dolfinx_mortar_al.stepping import StepFailure
from dolfinx_mortar_al.supports import Supports

__all__ = ["Settled", "VelocityProjection"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bool = NDArray[np.bool_]

_ADD = PETSc.InsertMode.ADD

CONE = 1e-10  # share of the bound by which round-off may leave Coulomb's cone
UNDETERMINED = (
    "what persistent contact leaves of the velocities after a step is not determined: contacts that stick hold the same "
    "nodes more than once; leave the facets at which their contactors meet out of one of them"
)
PASSES = 4  # rounds in which sticking points are let slip; after them all are


@dataclass(frozen=True)
class Settled:
    """What a projection did.

    Attributes:
        lost: energy that −𝐈 takes as conjugate to 𝐆𝐯 (J): that of the impact of nodes.
        friction: the rest (J), what impulses along the traction add where points slip. It corrects what the step's own
            tractions dissipate, and has either sign.
        by_obstacles, by_supports: work of obstacles and of supports that move, which bear impulses of the bodies' mass (J).
        impulses: (gdim,) on each contactor (N s).
    """

    lost: float
    friction: float
    by_obstacles: float
    by_supports: float
    impulses: list[Array]


@dataclass(frozen=True)
class _Change:
    """A solution: δ𝐯 (owned dofs,), each pair's impulses at its points (n, components) (N s/m²), the energy that impulses
    take as conjugate to 𝐆𝐯, the kinetic energy gained, and the work of supports against impulses on them (J)."""

    δv: Array
    impulses: list[Array]
    lost: float
    gain: float
    by_supports: float


class VelocityProjection:
    """The projection for the bodies and pairs of a problem.

    Args:
        problem: made of motions; its pairs have step kinematics.
        supports: its prescribed components.

    Raises:
        ValueError: on every rank, at a body that has no mass and of which nothing is prescribed.
    """

    def __init__(self, problem: ContactProblem, supports: Supports) -> None:
        self._problem, self._motions = problem, problem.motions
        self._mass, diagonals = problem.masses([motion.mass_form for motion in problem.motions])
        _check_masses(problem.bodies, diagonals)
        #: (kg/m²) of each pair's surface
        self._density = [pair.surface_stiffness(diagonals) for pair in problem.pairs]
        self._layouts = [problem.bodies.layout]
        self._layouts += [Layout.of(pair.multiplier.field.function_space) for pair in problem.pairs]
        self._couples = [np.empty((2, 0), dtype=np.int64) for _ in problem.pairs]
        self._supports = supports
        self._nest: Any = None
        self._solver: Any = None

    def apply(self, Δt: float, dissipated: float) -> Settled:
        """Change the motions' velocities at the end of a step of length Δt in which friction `dissipated` energy (J)
        (collective). Impulses act along the step's traction unless the step's friction would give energy with them: where
        slip has turned back within the step they act along the normal."""
        problem = self._problem
        closed = [any_over(problem.comm, pair.active.closed.any()) for pair in problem.pairs]
        if not any(closed):
            return Settled(0.0, 0.0, 0.0, 0.0, [np.zeros(problem.gdim) for _ in problem.pairs])
        hold: list[Bool] = [np.ones(pair.integration.size, dtype=bool) for pair in problem.pairs]
        for round_ in range(PASSES + 1):
            parts = self._parts(hold, drag=True)
            change = self._solve(parts, Δt)
            loose = [part.leaves_cone(i, Δt) for part, i in zip(parts, change.impulses, strict=True)]
            if round_ == PASSES or not any_over(problem.comm, any(bool(some.any()) for some in loose)):
                break
            last = round_ == PASSES - 1
            hold = [still & ~(some | last) for still, some in zip(hold, loose, strict=True)]
        found, work = self._impulses(parts, change.impulses, Δt)
        friction = work + change.by_supports - change.gain - change.lost
        if friction + dissipated < 0.0 and any(pair.friction for pair in problem.pairs):
            parts = self._parts(hold, drag=False)
            change = self._solve(parts, Δt)
            found, work = self._impulses(parts, change.impulses, Δt)
            friction = work + change.by_supports - change.gain - change.lost
        fields = [motion.velocity for motion in self._motions]
        by_supports = change.by_supports + self._supports.work_in_projection(change.δv)
        problem.bodies.spread(problem.bodies.owned(fields) + change.δv, fields)
        return Settled(change.lost, friction, work, by_supports, found)

    def _parts(self, hold: list[Bool], drag: bool) -> list[_Part]:
        pairs = zip(self._problem.pairs, self._density, hold, strict=True)
        return [_Part(pair, density, still, drag) for pair, density, still in pairs]

    def _impulses(self, parts: list[_Part], impulses: list[Array], Δt: float) -> tuple[list[Array], float]:
        """Impulse on each contactor (gdim,) (N s), and the work of obstacles (J); collective."""
        found = [part.impulse(i, Δt) for part, i in zip(parts, impulses, strict=True)]
        return [impulse for impulse, _ in found], sum(done for _, done in found)

    def _solve(self, parts: list[_Part], Δt: float) -> _Change:
        if not self._fits(parts):
            self._make_system()
        problem = self._problem
        vectors = [layout.vector() for layout in self._layouts]
        now = vectors[0].duplicate()
        now.array[:] = problem.bodies.owned([motion.velocity for motion in self._motions])
        free, led, on_supports = now.duplicate(), now.duplicate(), [v.duplicate() for v in vectors[1:]]
        free.array[:] = ~self._supports.held
        led.array[:] = np.where(self._supports.held, now.array_r, 0.0)
        for k, (pair, part) in enumerate(zip(problem.pairs, parts, strict=True), start=1):
            G, H, D = self._blocks[k - 1]
            for A, elements in ((G, part.G), (H, part.H), (D, part.D)):
                A.zeroEntries()
                insert(A, *elements)
            idle = pair.multiplier.idle
            D.setValuesRCV(idle[:, None], idle[:, None], np.full((len(idle), 1, 1), pair.area), _ADD)
            for A in (G, H, D):
                A.assemble()
            H.mult(led, on_supports[k - 1])
            H.diagonalScale(None, free)
            H.scale(-1.0)
            H.transpose(self._nest.getNestSubMatrix(0, k))
            insert_vector(vectors[k], *part.carried(Δt))
            vectors[k].assemble()
            G.mult(now, swept := vectors[k].duplicate())
            vectors[k].axpy(-1.0, swept)
        self._nest.assemble()
        right = PETSc.Vec().createNest(vectors, comm=problem.comm)
        self._solver.setOperators(self._nest)
        self._solver.solve(right, solution := right.duplicate())
        if not np.isfinite(solution.norm()):
            raise StepFailure(UNDETERMINED)
        δv, *multipliers = solution.getNestSubVecs()
        # −𝐈·𝐆(𝐯 + 𝐯*)/2, relative to obstacles, is 𝐈·(𝐫 + 𝐃𝐈)/2 with the right-hand side 𝐫 = −𝐆𝐯*
        lost = 0.0
        for (_, _, D), I, r in zip(self._blocks, multipliers, vectors[1:], strict=True):
            D.mult(I, held := r.duplicate())
            lost += (I.dot(r) + I.dot(held)) / 2
        now.axpy(0.5, δv)
        gain = now.dot(self._mass * δv)
        impulses = [part.at_points(v) for part, v in zip(parts, multipliers, strict=True)]
        against = -sum(I.dot(v) for I, v in zip(multipliers, on_supports, strict=True))
        return _Change(δv.array_r.copy(), impulses, lost, gain, against)

    def _fits(self, parts: list[_Part]) -> bool:
        """Whether the matrices have room for these parts on all ranks, as for all couples of facets seen before: they and
        their symbolic factorisation are kept then."""
        before, fits = self._couples, self._nest is not None
        self._couples = [
            np.unique(np.concatenate([seen, part.couples], axis=1), axis=1)
            for seen, part in zip(before, parts, strict=True)
        ]
        fits &= all(seen.shape == now.shape for seen, now in zip(before, self._couples, strict=True))
        return all_over(self._problem.comm, fits)

    def _make_system(self) -> None:
        comm, n = self._problem.comm, len(self._layouts)
        blocks: list[list[Any]] = [[None] * n for _ in range(n)]
        blocks[0][0], self._blocks = self._mass, []
        for k, (pair, couples) in enumerate(zip(self._problem.pairs, self._couples, strict=True), start=1):
            G, H, D = (empty_matrix(self._layouts[k], self._layouts[column]) for column in (0, 0, k))
            on, m, d = pair.multiplier.blocks, pair.multiplier.components, pair.gdim
            rows, nodes = on[couples[0]], _nodes(pair, *couples)
            for A in (G, H):
                insert(A, rows, nodes, np.zeros((len(rows), rows.shape[1], m, nodes.shape[1], d)))
            insert(D, on, on, np.zeros((len(on), on.shape[1], m, on.shape[1], m)))
            idle = pair.multiplier.idle
            D.setValuesRCV(idle[:, None], idle[:, None], np.zeros((len(idle), 1, 1)), _ADD)
            for A in (G, H, D):
                A.assemble()
            blocks[k][0], blocks[k][k], blocks[0][k] = G, D, H.transpose(PETSc.Mat())
            self._blocks.append((G, H, D))
        self._nest = PETSc.Mat().createNest(blocks, comm=comm)
        self._nest.assemble()
        self._solver = PETSc.KSP().create(comm)
        self._solver.setType("preonly")
        self._solver.getPC().setType("lu")
        self._solver.getPC().setFactorSolverType("mumps")


def _nodes(pair: ContactPair, facet: Index, target: Index) -> Index:
    """(n, nodes) global blocks of the nodes of contactor and target facets (n,)."""
    return np.concatenate([pair.blocks.contactor[facet], pair.target.blocks[pair.target.facets[target]]], axis=1)


class _Part:
    """A pair's share of the system.

    Attributes:
        G, H, D: element matrices with global blocks, H not transposed.
    """

    def __init__(self, pair: ContactPair, density: float, hold: Bool, drag: bool) -> None:
        level, blocks, points = pair.kinematics, pair.blocks, pair.integration
        assert isinstance(level, StepLevel)
        m = pair.multiplier.components
        self._rates = rates = level.rates(pair.state, hold, drag)
        N = blocks.interpolation(rates.normals)
        self._pair, self._N, self._j = pair, N[rates.act], pair.j[rates.act]
        self._facet = points.facet[rates.act]
        self._rows: Index = pair.multiplier.blocks[self._facet]
        nodes = _nodes(pair, self._facet, rates.facet)
        #: (2, n) contactor and target facet of each closed point
        self.couples = np.stack([self._facet, rates.facet])
        self.G, self.H = ((self._rows, nodes, self._of_nodes(rate)) for rate in (rates.G, rates.H))
        weight = np.broadcast_to(np.eye(m), (points.size, m, m)).copy()
        weight[rates.act] = rates.free
        weight *= pair.j[:, None, None] / density
        on, D = pair.multiplier.blocks, points.sum_by_facet(np.swapaxes(N, 1, 2) @ weight @ N)
        self.D = on, on, D.reshape(*on.shape, m, on.shape[1], m)

    def _of_nodes(self, rate: Array) -> Array:
        """(n, multiplier nodes, m, nodes, gdim) of a rate (n, m, z) in the slots."""
        nodal = apply_columns(rate * self._j[:, None, None], self._rates.B, self._pair.gdim)  # (n, m, nodes, gdim)
        n, m, k, d = nodal.shape
        return (np.swapaxes(self._N, 1, 2) @ nodal.reshape(n, m, k * d)).reshape(n, self._rows.shape[1], m, k, d)

    def carried(self, Δt: float) -> tuple[Index, Array]:
        """∫ N × (an obstacle's share of the relative velocity) as global blocks and element vectors."""
        values = ((self._j[:, None] * self._rates.carried / Δt)[:, None] @ self._N)[:, 0]
        return self._rows, values.reshape(*self._rows.shape, self._pair.multiplier.components)

    def at_points(self, multiplier: PETSc.Vec) -> Array:
        """(n, components) impulses per area at the closed points (N s/m²); ghosts are fetched (collective)."""
        field = self._pair.multiplier.field.copy()
        field.x.array[: multiplier.getLocalSize()] = multiplier.array_r
        field.x.scatter_forward()
        nodal = field.x.array.reshape(-1, self._pair.multiplier.components)[self._pair.multiplier.dofs[self._facet]]
        return np.asarray((self._N @ nodal.reshape(*self._N[:, 0].shape, 1))[:, :, 0])

    def _on_contactor(self, impulses: Array) -> Array:
        """(n, gdim) impulses per area as vectors."""
        return np.einsum("nmi,nm->ni", self._rates.H[:, :, : self._pair.gdim], impulses)

    def leaves_cone(self, impulses: Array, Δt: float) -> Bool:
        """(all points,) the sticking ones at which traction and impulse together break Coulomb's law."""
        pair, act = self._pair, self._rates.act
        leaves = np.zeros(pair.integration.size, dtype=bool)
        if isinstance(pair.law, Coulomb):
            ν = pair.at.ν[act]
            total = pair.kinematics.traction(pair.state)[act] * Δt + self._on_contactor(impulses)
            normal = np.einsum("ni,ni->n", ν, total)
            tangential = np.linalg.norm(total - normal[:, None] * ν, axis=1)
            scale = pair.law.μ * pair.state.p[act] * Δt
            held = self._rates.free.trace(axis1=1, axis2=2) < 0.5
            leaves[act] = held & (tangential > pair.law.μ * normal + CONE * scale)
        return leaves

    def impulse(self, impulses: Array, Δt: float) -> tuple[Array, float]:
        """Impulse on the contactor (gdim,) (N s), and the work of an obstacle that moves (J); collective."""
        vectors, comm = self._on_contactor(impulses) * self._j[:, None], self._pair.comm
        return np.asarray(sum_over(comm, vectors.sum(axis=0))), sum_over(
            comm, float((vectors * self._rates.swept).sum()) / Δt
        )


def _check_masses(bodies: Bodies, diagonals: Sequence[fem.Function]) -> None:
    """Refuse connected bodies that have nothing on the diagonals of their mass matrix: prescribed rows have a unit there."""
    for piece in np.flatnonzero(bodies.stiffest(diagonals) <= 0.0)[:1]:
        X = np.array2string(bodies.centre(int(piece)), precision=3)
        raise ValueError(
            f"density: the body around X = {X} has no mass, and nothing says how it moves; give it a density"
        )
