"""Mass taken off the contactor's nodes and given to the rest of its body (Khenous, Laborde and Renard 2008).

Nodes without mass stop at impact without losing kinetic energy. The consistent mass m_ij of the body is replaced by
m_ij f_i f_j (1 + Σ_cd μ_cd p_c(X_i) p_d(X_j)), f = 0 on the contactor and 1 elsewhere, p = 1, X, Y(, Z); the symmetric μ_cd
are such that total mass, centre and inertia stay what they were. DOI 10.1016/j.euromechsol.2008.01.001.

Meant for bodies that touch without much sliding: with θ = 1/2 the end-of-step velocity of a node without mass swings about
its mean, and on the disc of section 4.4 that stops Newton.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfinx_mortar_al.bodies import Bodies
from dolfinx_mortar_al.contact import ContactPair
from dolfinx_mortar_al.motion import Motion

__all__ = ["AddedMass"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class AddedMass:
    """The difference ΔM (kg) between the redistributed and the consistent mass, in the common numbering of all bodies.

    Args:
        bodies: of the problem.
        motions: one per body, in the same order.
        pairs: whose contactors lose their mass.
    """

    def __init__(self, bodies: Bodies, motions: Sequence[Motion], pairs: Sequence[ContactPair]) -> None:
        self._motions, self._comm, d = motions, bodies.comm, bodies.gdim
        mass = bodies.assemble([_mass(motion) for motion in motions])
        indptr, columns, values = mass.getValuesCSR()
        row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr)) + mass.getOwnershipRange()[0]
        scalar = (row % d == 0) & (columns % d == 0)  # the same for every component
        i, j, m = row[scalar] // d, columns[scalar] // d, values[scalar]
        X = bodies.reference_positions()
        flags = np.zeros(len(X))
        for pair in pairs:
            flags[pair.contactor_blocks] = 1.0
        off: NDArray[np.bool_] = self._everywhere(flags) > 0
        part = self._connected(off, i, j)
        Δm = self._difference(i, j, m, X, ~off, part)
        self.matrix = mass.duplicate()
        self.matrix.zeroEntries()
        for c in range(d):
            rows, cols = (i * d + c).astype(np.int32), (j * d + c).astype(np.int32)
            self.matrix.setValuesRCV(rows[:, None], cols[:, None], Δm[:, None, None], PETSc.InsertMode.ADD)
        self.matrix.assemble()
        self._rate, self._force = bodies.layout.vector(), bodies.layout.vector()
        self._gdim, start = d, self.matrix.getOwnershipRange()[0] // d
        self._X = X[start : start + bodies.layout.local]

    def _everywhere(self, flags: Array) -> Array:
        return np.asarray(self._comm.allreduce(flags, MPI.SUM))

    def _connected(self, start: NDArray[np.bool_], i: Index, j: Index) -> NDArray[np.bool_]:
        """(nodes,) the nodes of the bodies that `start` belongs to."""
        reached, count = start.copy(), -1
        while int(reached.sum()) != count:
            count = int(reached.sum())
            new = np.zeros(len(reached))
            new[i[reached[j]]] = 1.0
            reached |= self._everywhere(new) > 0
        return reached

    def _difference(
        self, i: Index, j: Index, m: Array, X: Array, free: NDArray[np.bool_], part: NDArray[np.bool_]
    ) -> Array:
        """Δm for each entry (i, j), zero off `part`."""
        size = np.ptp(X[part], axis=0).max()
        p = np.concatenate([np.ones((len(X), 1)), (X - X[part].mean(axis=0)) / size], axis=1)  # (nodes, d + 1)
        pairs = [(a, b) for a in range(p.shape[1]) for b in range(a, p.shape[1])]
        shape = np.stack([(p[i, a] * p[j, b] + p[i, b] * p[j, a]) / 2 for a, b in pairs])  # (pairs, entries)
        inside = m * part[i]
        kept = inside * free[i] * free[j]
        wanted = self._everywhere(shape @ (inside - kept))
        matrix = self._everywhere((shape * kept) @ shape.T)
        μ = np.linalg.lstsq(matrix, wanted, rcond=1e-12)[0]  # a body one cell wide does not determine all of them
        return kept * (1 + μ @ shape) - inside

    def add_force(self, b: PETSc.Vec) -> None:
        """b ← b + ΔM (𝐯_{n+1} − 𝐯_n)/Δt."""
        u, old, v = (self._owned([getattr(m, name) for m in self._motions]) for name in ("u", "old", "velocity"))
        θ, Δt = self._motions[0].θ, float(self._motions[0].Δt.value)
        self._rate.array[:] = ((u - old) / Δt - v) / (θ * Δt)
        self.matrix.mult(self._rate, self._force)
        b.axpy(1.0, self._force)

    def add_jacobian(self, A: PETSc.Mat) -> None:
        """A ← A + ΔM/(θ Δt²)."""
        motion = self._motions[0]
        A.axpy(
            1.0 / (motion.θ * float(motion.Δt.value) ** 2),
            self.matrix,
            structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN,
        )

    def _momentum_of_nodes(self) -> Array:
        """(owned nodes, gdim) ΔM 𝐯 (N s)."""
        self._rate.array[:] = self._owned([motion.velocity for motion in self._motions])
        self.matrix.mult(self._rate, self._force)
        return np.asarray(self._force.array_r.reshape(-1, self._gdim))

    def _owned(self, fields: Sequence[fem.Function]) -> Array:
        """(owned dofs,) values of one Function per body."""
        sizes = [f.function_space.dofmap.index_map.size_local * self._gdim for f in fields]
        return np.concatenate([f.x.array[:n] for f, n in zip(fields, sizes, strict=True)])

    def kinetic_energy(self) -> float:
        """½ 𝐯ᵀ ΔM 𝐯 (J), what the redistribution adds to the consistent kinetic energy (collective)."""
        p = self._momentum_of_nodes()
        return 0.5 * self._comm.allreduce(float(p.ravel() @ self._rate.array_r))

    def momenta(self) -> Array:
        """What it adds to momentum and angular momentum, as :meth:`Motion.momenta` (collective)."""
        p = self._momentum_of_nodes()
        x = self._X + self._owned([motion.old for motion in self._motions]).reshape(p.shape)
        spin = np.cross(x, p).sum(axis=0) if self._gdim == 3 else (x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0]).sum()
        return np.asarray(self._comm.allreduce(np.r_[p.sum(axis=0), spin], MPI.SUM))


def _mass(motion: Motion) -> fem.Form:
    V = motion.u.function_space
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    return fem.form(motion.thickness * motion.density * ufl.inner(u, v) * motion.dx)
