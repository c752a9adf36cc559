"""The multiplier field Λ on a contactor's facets: its space, and the nodes where it is redundant.

Continuous Lagrange elements of order 1, or of the displacement's order as in the paper: equal orders oscillate where the
contactor is the stiffer side, and order 1 sees of a facet's middle no more than a mean (``docs/theory.md``).

Where the displacement is prescribed on both sides (the common clamp of section 4.1, a symmetry plane) the gap is given and
the multiplier's node has nothing to enforce: kept, it would make the system singular. There the field is extrapolated
from the facet's other nodes (one order lower across the facet), component by component. Bodies that slide may come to such
places, or leave them: which nodes these are is chosen before each solve.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from numpy.typing import NDArray

from dolfinx_mortar_al.obstacles import Obstacle
from dolfinx_mortar_al.reductions import any_over
from dolfinx_mortar_al.surface import Facets, GatheredFacets, ShapeFunctions, Surface
from dolfinx_mortar_al.versions import submesh

__all__ = ["MultiplierSpace", "default_order", "extrapolation"]

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

TURN = 0.5  # rad: of radii of two facets and more either order is right to 1 or 2 % (docs/theory.md)


def default_order(contactor: GatheredFacets, target: Surface | Obstacle | None) -> int:
    """1; against a rigid obstacle, which is never the softer side, the displacement's where they turn away from each other by
    more than TURN over a facet: a zone of contact in the middle of so few facets is not seen by their corners."""
    if not isinstance(target, Obstacle):
        return 1
    turn = np.abs(contactor.smooth_turns + contactor.diameters * target.curvature)
    return contactor.shape.order if (turn > TURN).any() else 1


def extrapolation(shape: ShapeFunctions, kept: Bool) -> Array:
    """(nodes, nodes) matrix T: nodal values T Λ with the values off `kept` (nodes,) extrapolated from those on it.

    The extrapolation is the polynomial of highest total degree that the kept nodes determine; with none it is zero.
    """
    n = shape.nodes.shape[0]
    if kept.all():
        return np.eye(n)
    if not kept.any():
        return np.zeros((n, n))
    for degree in range(shape.order, -1, -1):
        powers = [p for p in np.ndindex(*(shape.dim * [degree + 1])) if sum(p) <= degree]
        monomials = np.stack([np.prod(shape.nodes**p, axis=1) for p in powers], axis=1)
        if np.linalg.matrix_rank(monomials[kept]) == len(powers):
            break
    T = np.zeros((n, n))
    T[np.ix_(~kept, kept)] = monomials[~kept] @ np.linalg.pinv(monomials[kept])
    T[kept, kept] = 1.0
    return T


class MultiplierSpace:
    """Lagrange multipliers on the contactor's facets.

    Args:
        facets: of the contactor.
        order: 1, or that of the displacement.
        components: 1 or gdim.
        redundant: (nf, displacement's nodes, components) whether the displacement leaves a node nothing to enforce.

    Attributes:
        field: the multiplier, a Function on the facets' own mesh: λ_N (Pa), or Λ in global axes (Pa) with friction.
        shape: its shape functions on a facet.
        own: (nodes,) which of the displacement's nodes on a facet they are.
        dofs: (nf, nodes) local block dofs, in the order of `shape`'s nodes; blocks: the same, global.
        components: 1 (λ_N) or gdim (Λ).
        redundant: (nf, nodes, components) nodes whose value is extrapolated.
        idle: global dofs (not blocks) owned by this rank whose value is extrapolated, whatever the system holds there.
        T: (nf, components, nodes, nodes) extrapolation of each facet.
    """

    def __init__(self, facets: Facets, order: int, components: int, redundant: Bool) -> None:
        domain = facets.space.mesh
        self.components, self.shape = components, ShapeFunctions(facets.shape.cell, order)
        self._facets = facets
        self.submesh, self._entities = submesh(domain, facets.shape.dim, facets.entities)
        V, self.dofs = self.lagrange(order, components)
        self.field = fem.Function(V, name="multiplier")
        self.own = _own_nodes(self.shape, facets.shape)
        self.blocks = V.dofmap.index_map.local_to_global(self.dofs.ravel()).reshape(self.dofs.shape)
        self._flags: Bool = np.zeros((0, components), dtype=bool)
        self.leave_out(redundant)

    def lagrange(self, order: int, components: int) -> tuple[fem.FunctionSpace, NDArray[np.int32]]:
        """A Lagrange space on the facets' own mesh, of order 1 or that of the displacement, and its (nf, nodes) local
        block dofs in the order of the nodes of a facet's element."""
        V = fem.functionspace(self.submesh, ("Lagrange", order, (components,) if components > 1 else ()))
        own = _own_nodes(ShapeFunctions(self._facets.shape.cell, order), self._facets.shape)
        return V, _match(V, self._facets, own, self._entities)

    def leave_out(self, redundant: Bool) -> bool:
        """Extrapolate nodes that are redundant (nf, displacement's nodes, components), and no others: one is on every rank
        and facet that has it, or on none. Whether that is a change (collective)."""
        V = self.field.function_space
        flag = fem.Function(V)
        values = flag.x.array.reshape(-1, self.components)
        np.maximum.at(values, self.dofs, redundant[:, self.own].astype(float))
        flag.x.scatter_reverse(InsertMode.add)
        flag.x.scatter_forward()
        flags = flag.x.array.reshape(-1, self.components) > 0
        if not any_over(self.submesh.comm, not np.array_equal(flags, self._flags)):
            return False
        self._flags = flags
        self.redundant = flags[self.dofs]
        owned = V.dofmap.index_map.size_local
        start = V.dofmap.index_map.local_range[0] * self.components
        self.idle = (np.flatnonzero(flags[:owned].ravel()) + start).astype(np.int32)
        self._extrapolates = any_over(self.submesh.comm, flags.any())
        self.T = self._extrapolations(self.shape)
        return True

    def extend(self) -> None:
        """Give redundant nodes the mean of what their facets have there, should they be others in the next solve
        (collective)."""
        if not self._extrapolates:
            return
        total, count = (self._sums(values) for values in (self.nodal(), np.ones(self.redundant.shape)))
        field = self.field.x.array.reshape(-1, self.components)
        field[self._flags] = total[self._flags] / count[self._flags]

    def touched(self, facets: Bool) -> Bool:
        """(nf, nodes) whether some of the given facets (nf,), on any rank, has the node (collective)."""
        flag = fem.Function(self.field.function_space)
        values = flag.x.array.reshape(-1, self.components)
        values[self.dofs[facets].ravel()] = 1.0
        flag.x.scatter_reverse(InsertMode.add)
        flag.x.scatter_forward()
        touched: Bool = values[self.dofs, 0] > 0
        return touched

    def _extrapolations(self, shape: ShapeFunctions) -> Array:
        n = shape.nodes.shape[0]
        T = np.broadcast_to(np.eye(n), (len(self.dofs), self.components, n, n)).copy()
        facet, component = np.nonzero(self.redundant.any(axis=1))
        patterns, which = np.unique(self.redundant[facet, :, component], axis=0, return_inverse=True)
        if len(patterns):
            T[facet, component] = np.stack([extrapolation(shape, ~pattern) for pattern in patterns])[which.ravel()]
        return T

    def at(self, facet: NDArray[np.int64], η: Array) -> Array:
        """(n, nodes, components) shape functions at η (n, dim) of facets (n,), redundant nodes eliminated."""
        return np.einsum("na,niab->nbi", self.shape.tabulate(η)[0], self.T[facet])

    def sum_over_facets(self, values: Array) -> Array:
        """(nf, nodes, components) sums of element vectors over all facets that share a node, on all ranks (collective)."""
        return self._sums(values)[self.dofs]

    def _sums(self, values: Array) -> Array:
        """(local block dofs, components) the same."""
        total = fem.Function(self.field.function_space)
        np.add.at(total.x.array.reshape(-1, self.components), self.dofs, values)
        total.x.scatter_reverse(InsertMode.add)
        total.x.scatter_forward()
        return np.asarray(total.x.array.reshape(-1, self.components))

    @property
    def size(self) -> int:
        """Unknowns on all ranks."""
        return self.field.function_space.dofmap.index_map.size_global * self.components

    def own_nodal(self) -> Array:
        """(nf, nodes, components) the unknowns of each facet, as they stand; what redundant nodes have does not count."""
        return self.field.x.array.reshape(-1, self.components)[self.dofs]

    def nodal(self) -> Array:
        """(nf, nodes, components) nodal values on each facet, extrapolated ones included."""
        return np.einsum("fiab,fbi->fai", self.T, self.own_nodal())


def _own_nodes(shape: ShapeFunctions, facet: ShapeFunctions) -> NDArray[np.int64]:
    """Which of a facet's nodes are nodes of `shape`."""
    distance = np.linalg.norm(shape.nodes[:, None] - facet.nodes, axis=2)
    return np.argmin(distance, axis=1)


def _match(
    V: fem.FunctionSpace, facets: Facets, own: NDArray[np.int64], entities: NDArray[np.int32]
) -> NDArray[np.int32]:
    """(nf, nodes) dofs of V on each facet, brought to the order of the facets' nodes `own` by position."""
    position = np.full(int(max(entities.max(initial=-1), facets.entities.max(initial=-1))) + 1, -1)
    position[entities] = np.arange(len(entities))
    dofs = V.dofmap.list[position[facets.entities]]  # (nf, nodes) in the submesh's own order
    x = V.tabulate_dof_coordinates()[:, : facets.X.shape[-1]][dofs]
    distance = np.linalg.norm(facets.X[:, own, None] - x[:, None], axis=3)
    order = np.argmin(distance, axis=2) if len(dofs) else np.empty(dofs.shape, dtype=np.int64)
    return np.take_along_axis(dofs, order, axis=1)
