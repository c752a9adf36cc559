"""Contact at the integration points of a contactor, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

__all__ = ["ContactFields", "gathered"]

Array = NDArray[np.float64]

SAME_PLACE = 1e-12  # of the largest coordinate: points that near each other differ by round-off


@dataclass(frozen=True)
class ContactFields:
    """Contact at n integration points of a contactor, in the state last solved for.

    In a time step the gap is that at its end, tractions are means over it. Tractions are nominal, per reference area of the
    contactor, and act on the contactor; pressure, tractions, slip and status are 0 where it is open.

    Attributes:
        X: (n, gdim) reference positions (m); x: (n, gdim) present ones (m).
        area: (n,) the reference area that a point stands for (m²; length × thickness in the plane): weights of integrals.
        gap: (n,) distance to the target along the normal (m), negative in penetration; not a number where nothing is faced.
        pressure: (n,) contact pressure (Pa).
        traction: (n, gdim) contact traction (Pa), whose integral is :meth:`~dolfinx_mortar_al.ContactPair.force`.
        tangential_traction: (n, gdim) friction (Pa), at most μ times the pressure.
        slip: (n, gdim) sliding over the target in the last step (m), as the law has it: against the friction, 0 where
            it sticks, in the mean over shape functions that of the bodies. Without friction none is kept, and it is 0.
        status: (n,) 0 open, 1 slip, 2 stick; closed points slip without friction.
    """

    X: Array
    x: Array
    area: Array
    gap: Array
    pressure: Array
    traction: Array
    tangential_traction: Array
    slip: Array
    status: NDArray[np.int8]


def gathered(mine: ContactFields, comm: MPI.Intracomm) -> ContactFields | None:
    """The points of all ranks in order of X on rank 0, None on the others (collective)."""
    every = comm.gather(mine, root=0)
    if every is None:
        return None
    columns: dict[str, Any] = {
        field.name: np.concatenate([getattr(part, field.name) for part in every]) for field in fields(ContactFields)
    }
    X = columns["X"]
    grain = SAME_PLACE * max(np.abs(X).max(initial=0.0), np.finfo(float).tiny)
    order = np.lexsort(np.round(X / grain).T[::-1])
    return ContactFields(**{name: column[order] for name, column in columns.items()})
