"""What a surface yields to pressure, from a stiffness matrix alone: the part of a nodal stiffness that volume change owns.

A pressure on a surface meets the plane-strain modulus E' = E/(1 − ν²), the diagonal of the stiffness holds the modulus of
uniaxial strain M = λ + 2G, which has no bound as ν → 1/2. A linear displacement strains a body uniformly; the stiffness times
it is, at a node of the boundary, the traction times n = ∫ N n da, on any mesh. In d dimensions, with e_i X_j the displacement
of component i alone, the two vectors

    X:  p = (d λ + 2 G) n,        Σ_i component i of e_i X_j:  q_j = (λ + (d + 1) G) n_j,

give G and λ, and E' = 4 G (1 − G/M).
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.monitors import warn

__all__ = ["doubt_order", "softest", "yielding_share"]

Array = NDArray[np.float64]

LOCKS = 0.49  # Poisson's ratio: from there on cells of order 1 are too stiff by a quarter and more where a few bend or bulge
NOISE = 1e-10  # of a node's stiffness times the body's size: inside, where a uniform strain meets no force, is less
ELASTIC = 1e-6  # of a node's stiffness: what a translation meets must be less, else inertia or springs are in it


def softest(V: fem.FunctionSpace, A: PETSc.Mat, prescribed: fem.Function) -> Array:
    """(owned nodes,) the least stiffness (N/m) that a displacement of one node alone meets: on membranes, which resist in
    their own plane at first, in whatever direction, else along the axes. Infinite where all is `prescribed`.

    Args:
        V: the displacement's space.
        A: stiffness of the body, without Dirichlet conditions.
        prescribed: 1 in components that are, else 0.
    """
    d, (first, end) = V.mesh.geometry.dim, A.getOwnershipRange()
    free = prescribed.x.array[: end - first].reshape(-1, d) == 0
    if V.mesh.topology.dim == d:
        return np.where(free, A.getDiagonal().array_r.reshape(-1, d), np.inf).min(axis=1, initial=np.inf)
    rows, columns, values = A.getValuesCSR()
    row = np.repeat(np.arange(end - first), np.diff(rows))
    own = row // d == (columns - first) // d
    blocks = np.zeros((len(free), d, d))
    blocks[row[own] // d, row[own] % d, (columns[own] - first) % d] = values[own]
    blocks[~(free[:, :, None] & free[:, None])] = 0.0
    largest = np.abs(blocks).max(axis=(1, 2), initial=0.0)
    blocks[:, np.arange(d), np.arange(d)] += np.where(free, 0.0, largest[:, None])
    known = np.isfinite(largest)  # what is no number is not compared: a pair says so, or Newton
    least = np.full(len(free), np.inf)
    least[known] = np.linalg.eigvalsh((blocks[known] + np.swapaxes(blocks[known], 1, 2)) / 2)[:, 0]
    least[~free.any(axis=1)] = np.inf
    return least


def yielding_share(V: fem.FunctionSpace, A: PETSc.Mat) -> fem.Function:
    """E'/M near each node on the boundary of a body, the same in all components; 1 inside, on membranes and where a
    translation meets a force, for inertia or springs are in A then (collective).

    Args:
        V: the displacement's space.
        A: stiffness of the body in its start state, without Dirichlet conditions.
    """
    share, d = fem.Function(V), V.mesh.geometry.dim
    share.x.array[:] = 1.0
    if V.mesh.topology.dim < d:
        return share
    X, corner = V.tabulate_dof_coordinates()[:, :d], np.empty(d)
    V.mesh.comm.Allreduce(X.min(axis=0, initial=np.inf), corner, MPI.MIN)
    X = X - corner
    size = V.mesh.comm.allreduce(float(X.max(initial=0.0)), MPI.MAX)
    field, e = fem.Function(V), np.eye(d)
    result = A.createVecLeft()

    def times(values: Array) -> Array:
        """(owned nodes, d) A times a displacement given at this rank's nodes."""
        field.x.array[:] = values.ravel()
        A.mult(field.x.petsc_vec, result)
        return np.array(result.array_r).reshape(-1, d)

    p = times(X)
    q = np.stack([sum(times(np.outer(X[:, j], e[i]))[:, i] for i in range(d)) for j in range(d)], axis=1)
    stiffness = np.abs(A.getDiagonal().array_r.reshape(-1, d)).max(axis=1)
    held = np.abs(times(np.ones_like(X))).max(axis=1) > ELASTIC * stiffness
    p, q = (np.linalg.norm(v, axis=1) for v in (p, q))
    G = (d * q - p) / ((d + 2) * (d - 1))
    M = (p - 2 * G) / d + 2 * G
    # a vertex of a quadratic triangle has no ∫ N da: take nodes with those of their cells
    G, M = (_near(V, np.where(held, 0.0, v)) for v in (G, M))
    noise = NOISE * size * _near(V, stiffness)
    sound = (G > 0) & (M > G) & (noise < M)
    with np.errstate(divide="ignore", invalid="ignore"):
        r = np.where(sound, G / M, 0.5)
    share.x.array[:] = np.repeat(4 * r * (1 - r), d)
    return share


def doubt_order(share: fem.Function, name: str) -> None:
    """Warn of a nearly incompressible body of first order, whose cells lock (collective).

    Args:
        share: E'/M near each node on the boundary.
        name: of the displacement.
    """
    V = share.function_space
    if V.element.basix_element.degree > 1:
        return
    least = V.mesh.comm.allreduce(float(share.x.array.min(initial=1.0)), MPI.MIN)
    r = (1 - np.sqrt(1 - min(least, 1.0))) / 2  # G/M, ν = (1 − 2 r)/(2 − 2 r)
    ν = (1 - 2 * r) / (2 - 2 * r)
    if ν >= LOCKS and V.mesh.comm.rank == 0:
        warn(
            f"{name} is of order 1 in a nearly incompressible body (ν = {ν:.4g}): its cells lock, and are far too stiff "
            "but on very fine meshes; take a displacement of order 2"
        )


def _near(V: fem.FunctionSpace, values: Array) -> Array:
    """(nodes,) sums over the nodes of all cells at a node, of `values` (owned nodes,); ghosts are up to date."""
    d, f = V.dofmap.index_map_bs, fem.Function(V)
    f.x.array[: len(values) * d] = np.repeat(values, d)
    f.x.scatter_forward()
    owned = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    cells, nodes = V.dofmap.list[:owned], f.x.array[::d].copy()
    f.x.array[:] = 0.0
    sums = np.zeros(len(nodes))
    np.add.at(sums, cells, nodes[cells].sum(axis=1)[:, None])
    f.x.array[:] = np.repeat(sums, d)
    f.x.scatter_reverse(InsertMode.add)
    f.x.scatter_forward()
    return f.x.array[::d].copy()
