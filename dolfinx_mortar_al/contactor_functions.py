"""Contact on a contactor as Functions on the mesh of its facets, for files and pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from numpy.typing import NDArray

from dolfinx_mortar_al.contact_pair import ContactPair
from dolfinx_mortar_al.law import OPEN, SLIP, STICK
from dolfinx_mortar_al.surface import ShapeFunctions

__all__ = ["ContactorFunctions"]

Array = NDArray[np.float64]


class ContactorFunctions:
    """The fields of a pair as Functions on the mesh of its contactor's facets, for files and pictures.

    Values at a vertex are means over the facets around it, weighted with the hat functions N: ∫ N q dS₀ / ∫ N dS₀. So
    pressures stay positive, friction within μ times the pressure, and the integral of a field is kept. The
    displacement is that of the body, the multiplier the unknown itself. Functions are of the displacement's order, all
    on one mesh.

    Args:
        pair: of which.

    Attributes:
        functions: by name: displacement (m), gap (m), pressure (Pa), tangential_traction (Pa), slip (m), status (of
            most of the area around a node: 0 open, 1 slip, 2 stick), multiplier (Pa).
    """

    def __init__(self, pair: ContactPair) -> None:
        self.pair = pair
        shape, d, m = pair.facets.shape, pair.gdim, pair.multiplier.components
        self._hat = ShapeFunctions(shape.cell, 1)
        #: (nodes, vertices) hat functions at the displacement's nodes
        self._at_nodes = self._hat.tabulate(shape.nodes)[0]
        self._vertices = _Nodes(*pair.multiplier.lagrange(1, 1))
        nodes = {size: _Nodes(*pair.multiplier.lagrange(shape.order, size)) for size in {1, d, m}}
        sizes = {"displacement": d, "gap": 1, "pressure": 1, "tangential_traction": d, "slip": d, "status": 1}
        self._nodes = {name: nodes[size] for name, size in (sizes | {"multiplier": m}).items()}
        self.functions = {name: fem.Function(part.space, name=name) for name, part in self._nodes.items()}
        self.update()

    def update(self) -> None:
        """Take the pair's present state (collective)."""
        pair, now = self.pair, self.pair.fields()
        facing = np.isfinite(now.gap)
        own = pair.multiplier.shape.tabulate(pair.facets.shape.nodes)[0]
        closed, stick = (self._means(now.status >= least, now.area) for least in (SLIP, STICK))
        values = {
            "displacement": pair.kinematics.nodes() - pair.facets.X,
            "gap": self._means(np.where(facing, now.gap, 0.0), now.area * facing, np.nan),
            "pressure": self._means(now.pressure, now.area),
            "tangential_traction": self._means(now.tangential_traction, now.area),
            "slip": self._means(now.slip, now.area),
            "status": np.where(closed > 0.5, np.where(stick > 0.5 * closed, STICK, SLIP), OPEN).astype(np.float64),
            "multiplier": own @ pair.multiplier.nodal(),
        }
        for name, nodal in values.items():
            self.functions[name].x.array[:] = self._nodes[name].mean(nodal)

    def nodal(self, name: str) -> Array:
        """(nf, nodes, components) values of a function at the nodes of this rank's facets."""
        nodes, x = self._nodes[name], self.functions[name].x.array
        return np.asarray(x.reshape(-1, nodes.space.dofmap.index_map_bs)[nodes.dofs])

    def _means(self, values: NDArray[Any], weight: Array, otherwise: float = 0.0) -> Array:
        """(nf, nodes, c) of (n,) or (n, c) values at the points, of these weights (n,); `otherwise` where there are none
        (collective)."""
        N = self._hat.tabulate(self.pair.integration.η)[0] * weight[:, None]
        total = self._vertex_sums(N)
        some = total > 0
        columns = [
            np.where(some, self._vertex_sums(N * column[:, None]) / np.where(some, total, 1.0), 0.0)
            for column in values.reshape(len(N), values.shape[1] if values.ndim > 1 else 1).T
        ]
        means, known = self._at_nodes @ np.stack(columns, axis=2), (some @ self._at_nodes.T)[:, :, None]
        return np.where(known > 0, means / np.where(known > 0, known, 1.0), otherwise)

    def _vertex_sums(self, values: Array) -> Array:
        """(nf, vertices) sums of (n, vertices) over the points of all facets at a vertex, on all ranks (collective)."""
        return self._vertices.sum(self.pair.integration.sum_by_facet(values)[:, :, None])[self._vertices.dofs]


class _Nodes:
    """Nodes of a Lagrange space on the contactor's facets, whose block dofs are (nf, nodes)."""

    def __init__(self, space: fem.FunctionSpace, dofs: NDArray[np.int32]) -> None:
        self.space, self.dofs = space, dofs
        self._field = fem.Function(space)
        size = space.dofmap.index_map_bs
        #: (local dofs,) how many facets, on any rank, have the node; 1 where none does
        self._count = np.maximum(self.sum(np.ones((*dofs.shape, size))), 1.0)

    def sum(self, values: Array) -> Array:
        """(local dofs,) sums of (nf, nodes, components) over the facets of all ranks at each node (collective)."""
        x = self._field.x
        x.array[:] = 0.0
        np.add.at(x.array.reshape(-1, values.shape[2]), self.dofs, values)
        x.scatter_reverse(InsertMode.add)
        x.scatter_forward()
        return np.array(x.array)

    def mean(self, values: Array) -> Array:
        """(local dofs,) of (nf, nodes, components) which agree wherever facets share a node: an owner may have none of them
        (collective)."""
        return self.sum(values) / self._count
