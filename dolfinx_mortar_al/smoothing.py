"""What holds a multiplier smooth on facets that are finer than the target (``docs/theory.md``).

The target's facets cannot follow from node to node what has more nodes than they: where the contactor is the stiffer side
some pressures act on nearly nothing, and on nothing where its motion is prescribed. A continuum would follow them, and yield
to a wave of pressure p of length 2π/q by about p/(E q). The gap condition of eq. (4) is given the compliance that the facets
lack, 𝐫 − ∇·κ∇Λ in place of 𝐫, on facets that are closed altogether: constant pressures have none of it, and it counts for
little where they vary over many facets; `zone_width` sees to it that it does in narrow zones, too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.integration import IntegrationPoints
from dolfinx_mortar_al.multiplier import MultiplierSpace
from dolfinx_mortar_al.targets import Target

__all__ = ["ALIKE", "lacking_compliance", "products_of_gradients"]

Array = NDArray[np.float64]

ALIKE = 0.99  # spacings that are the same but for the shape of facets


def lacking_compliance(
    multiplier: MultiplierSpace,
    target: Target,
    own: tuple[Array, Array],
    faced: tuple[Array, Array],
    moduli: tuple[float, float],
    prescribed: NDArray[np.bool_],
) -> Array:
    """(nf,) κ = ℓ² C of the multiplier on each facet of the contactor (m³/Pa), 0 on those whose nodes are as far apart as the
    target's.

    Args:
        own, faced: (nf,) extents and (nf,) widths of the facets and of those of the target that they face (m).
        moduli: (E_c, E_t) stiffness per area × length of a facet of the contactor and of the target (Pa).
        prescribed: (nf,) facets of the contactor that do not yield at all.

    C is what the target yields per area over the distance h of its nodes, times E_c/(E_c + E_t): less where the contactor
    yields by itself. ℓ = h/π is 1/q of the shortest wave that the target has, but no more than the multiplier's own spacing;
    across facets that are longer than wide, as of bodies of one layer, waves are shorter than along them.
    """
    is_finer = multiplier.shape.spacing * own[0] < ALIKE * target.spacing * faced[0]
    C = target.spacing**target.dim * faced[0] / moduli[1] * np.where(prescribed, 1.0, moduli[0] / sum(moduli))
    ℓ = np.minimum(target.spacing * faced[1] / np.pi, multiplier.shape.spacing * own[1])
    return np.where(is_finer, ℓ**2 * C, 0.0)


def products_of_gradients(points: IntegrationPoints, multiplier: MultiplierSpace) -> Array:
    """(nf, nodes × components, nodes × components) ∫ ∇N·∇N dS₀ on each facet, on the reference surface, from Gauss points."""
    a = points.tangents(points.facets.X)  # (n, dim, gdim)
    metric = a @ np.swapaxes(a, 1, 2)
    dN = multiplier.shape.tabulate(points.η, 1)[1]  # (n, dim, nodes)
    products = points.sum_by_facet(points.j[:, None, None] * (np.swapaxes(dN, 1, 2) @ np.linalg.solve(metric, dN)))
    T = multiplier.T  # (nf, components, nodes, nodes)
    each = np.swapaxes(T, 2, 3) @ products[:, None] @ T
    (count, m, nodes, _), same = T.shape, np.eye(T.shape[1])
    return np.einsum("fiab,ik->faibk", each, same).reshape(count, nodes * m, nodes * m)
