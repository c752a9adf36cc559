"""What a problem is given from outside and a user may change between solves: numbers, the same on all ranks, and fields.

Constants of the forms and of Dirichlet conditions, friction and poses must be finite and the same on all ranks;
displacements, prescribed values and other Functions of the forms finite; meshes as they were when the problem was made. One
reduction says whether they are; what is wrong, and where, is looked for only if something is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.obstacles import Obstacle
from dolfinx_mortar_al.ranks import agreed
from dolfinx_mortar_al.reductions import any_over, max_over, sum_over
from dolfinx_mortar_al.targets import RigidTarget
from dolfinx_mortar_al.validation import constant_value

if TYPE_CHECKING:
    from dolfinx_mortar_al.bodies import BodyForms
    from dolfinx_mortar_al.contact_pair import ContactPair

__all__ = ["Given"]

Array = NDArray[np.float64]


class Given:
    """The numbers and fields of bodies and pairs.

    Args:
        comm: of the problem.
        bodies: the bodies.
        pairs: the contact pairs.
    """

    def __init__(self, comm: MPI.Comm, bodies: Sequence[BodyForms], pairs: Sequence[ContactPair] = ()) -> None:
        self._comm, self._bodies = comm, bodies
        self._positions = [body.mesh.geometry.x.copy() for body in bodies]
        #: numbers with what messages call them
        self._numbers: list[tuple[str, Callable[[], Any]]] = []
        for k, body in enumerate(bodies):
            name = f"a Constant in the form of u[{k}], such as a load,"
            self._numbers += [(name, partial(getattr, c, "value")) for c in body.constants]
            plain = [(j, bc.g) for j, bc in enumerate(body.bcs) if not _is_field(bc.g)]
            self._numbers += [
                (f"the Dirichlet condition {j} of u[{k}]", partial(getattr, g, "value")) for j, g in plain
            ]
        for pair in pairs:
            self._numbers.append((f"friction of {pair.name}", partial(constant_value, pair.contact.friction)))
            if isinstance(pair.target, RigidTarget):
                self._numbers.append((f"the pose of {pair.name}'s obstacle", partial(_pose, pair.target.obstacle)))

    def check(self) -> None:
        """Look at all of them (collective).

        Raises:
            ValueError: on every rank, with the name and the value or place of what is wrong.
        """
        values = np.concatenate([[0.0], *(np.ravel(number()) for _, number in self._numbers)])
        finite = np.isfinite(values)
        sound = bool(finite.all()) and all(_is_finite(body) for body in self._bodies) and not any(self._moved())
        values[~finite] = 0.0
        largest = max_over(self._comm, np.concatenate([[float(not sound)], values, -values]))
        n = len(values)
        if largest[0] > 0:
            self._say_what_is_wrong()
        if np.any(largest[1 : n + 1] != -largest[n + 1 :]):
            for name, number in self._numbers:
                agreed(self._comm, name, np.asarray(number()).tolist())

    def _moved(self) -> list[bool]:
        """Whether the nodes of each body's mesh are elsewhere on this rank than when the problem was made."""
        pairs = zip(self._bodies, self._positions, strict=True)
        return [not np.array_equal(body.mesh.geometry.x, x) for body, x in pairs]

    def _say_what_is_wrong(self) -> None:
        for k, moved in enumerate(self._moved()):
            if any_over(self._comm, moved):
                raise ValueError(
                    f"the mesh of u[{k}] has been changed since the problem was made: move bodies by their displacement, or "
                    "make the problem anew"
                )
        for name, number in self._numbers:
            value = np.ravel(number())
            if any_over(self._comm, not np.isfinite(value).all()):
                raise ValueError(f"{name} has the value {value}: give it finite numbers")
        for k, body in enumerate(self._bodies):
            self._check_field(f"u[{k}] (Function {body.u.name!r})", body, body.u.x.array)
            for j, bc in [(j, bc) for j, bc in enumerate(body.bcs) if _is_field(bc.g)]:
                prescribed = np.zeros_like(body.u.x.array)
                bc.set(prescribed)
                self._check_field(f"the Dirichlet condition {j} of u[{k}] (Function {bc.g.name!r})", body, prescribed)
            for field in body.fields:
                dofs = field.function_space.dofmap
                owned = field.x.array[: dofs.index_map.size_local * dofs.index_map_bs]
                bad = sum_over(self._comm, int(np.sum(~np.isfinite(owned))))
                if bad or any_over(self._comm, not np.isfinite(field.x.array).all()):
                    raise ValueError(
                        f"Function {field.name!r} in the form of u[{k}]: {bad:.0f} of its values are no finite numbers"
                    )

    def _check_field(self, name: str, body: BodyForms, values: Array) -> None:
        """Refuse nodal values that are no finite numbers (collective)."""
        bad, d, mine = np.flatnonzero(~np.isfinite(values)), body.mesh.geometry.dim, None
        if len(bad):
            X = body.space.tabulate_dof_coordinates()[bad[0] // d, :d]
            mine = float(values[bad[0]]), bad[0] % d, ", ".join(f"{x:.4g}" for x in X)
        found = next((one for one in self._comm.allgather(mine) if one is not None), None)
        if found is not None:
            value, component, place = found
            raise ValueError(
                f"{name}: component {component} has the value {value} at X = ({place}); give it finite numbers"
            )


def _pose(obstacle: Obstacle) -> Array:
    return np.concatenate([obstacle.pose.translation, np.ravel(obstacle.pose.rotation)])


def _is_field(g: Any) -> bool:
    """Whether a condition's values are a Function's."""
    return hasattr(g, "x")


def _is_finite(body: BodyForms) -> bool:
    """Whether displacements, prescribed values and the form's other Functions are on this rank."""
    prescribed = np.zeros(body.owned * body.space.dofmap.index_map_bs)
    body.set_bc_rows(prescribed)
    return all(np.isfinite(a).all() for a in (body.u.x.array, prescribed, *(f.x.array for f in body.fields)))
