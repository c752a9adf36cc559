"""What a problem is made of, in words and hashes: mesh, spaces, forms, conditions, contacts, motions.

A state belongs to the problem it was computed with. Two problems with the same fingerprint take the same steps from the same
state; where fingerprints differ, the labels say in what. Values that change during a run are left out: loads given as
Dirichlet values, poses of obstacles, and Constants, that of a friction too, after the problem was made.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.obstacles import Obstacle
from dolfinx_mortar_al.validation import constant_value
from dolfinx_mortar_al.versions import geometry_nodes

if TYPE_CHECKING:
    from dolfinx_mortar_al.bodies import BodyForms
    from dolfinx_mortar_al.contact_pair import ContactPair
    from dolfinx_mortar_al.problem import ContactProblem

__all__ = ["Fingerprint", "differences", "fingerprint"]

HASHED = "#"  # begins what has no words

#: what is compared, by a label that a message can show
Fingerprint = dict[str, str]


def fingerprint(problem: ContactProblem) -> Fingerprint:
    """The problem's fingerprint, the same on all ranks (collective)."""
    steps = [motion.time_step for motion in problem.motions]  # may be another when a run goes on
    mine: Fingerprint = {"ranks": str(problem.comm.size), "states": ", ".join(problem.members)}
    for k, body in enumerate(problem.bodies.bodies):
        mine |= {f"{what} of u[{k}]": said for what, said in _of_body(body, steps).items()}
    for pair in problem.pairs:
        mine |= {f"{what} of pair {pair.name}": said for what, said in _of_pair(pair).items()}
    for k, motion in enumerate(problem.motions):
        mine |= {
            f"density of motion {k}": str([constant_value(ρ) for ρ in motion.densities]),
            f"theta of motion {k}": repr(motion.theta),
        }
    everywhere = problem.comm.allgather(mine)
    return {
        label: said
        if all(other.get(label) == said for other in everywhere)
        else _hash([o.get(label) for o in everywhere])
        for label, said in mine.items()
    }


def differences(then: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """In what two fingerprints differ, in words."""
    labels = [*now, *(label for label in then if label not in now)]
    return [_in_words(label, then.get(label), now.get(label)) for label in labels if then.get(label) != now.get(label)]


def _in_words(label: str, then: str | None, now: str | None) -> str:
    if then and now and then.startswith(HASHED) and now.startswith(HASHED):
        return f"another {label}"
    return f"{label}: {then} then, {now} now"


def _of_body(body: BodyForms, steps: Sequence[Any]) -> Fingerprint:
    V, domain = body.space, body.mesh
    values = [v for c, v in zip(body.constants, body.constant_values, strict=True) if not any(c is s for s in steps)]
    return {
        "mesh": f"{domain.topology.cell_name()}s, {domain.topology.index_map(domain.topology.dim).size_global} of them",
        "geometry": _hash([domain.geometry.x, geometry_nodes(domain)]),
        "space": f"{V.ufl_element()}",
        "numbering": _hash([V.dofmap.list, V.tabulate_dof_coordinates()]),
        "form": HASHED + body.signature[:16],
        "constants": ", ".join(np.array2string(v, separator=" ") for v in values) or "none",
        "prescribed components": _hash([body.prescribed().x.array]),
    }


def _of_pair(pair: ContactPair) -> Fingerprint:
    contact, target = pair.contact, pair.contact.target
    given = f"{contact.epsilon_normal} and {contact.epsilon_tangential}"
    said = {
        "friction": repr(pair.friction_at_start),
        "epsilon": f"{given}, {pair.augmentation.at_start:.9g} by default",
        "multiplier": f"order {pair.multiplier.shape.order}, {pair.multiplier.components} components",
        "projection": contact.projection,
        "thickness": repr(contact.thickness),
        "integration": f"{contact.integration}, degree {contact.quadrature_degree or 'by default'}",
        "contactor": _hash([pair.facets.X, pair.gauss.weight]),
    }
    if isinstance(target, Obstacle):
        return said | {"target": repr(target)}
    if target is None:
        return said | {"target": "itself"}
    return said | {"target": f"tag {target.tag}", "target's facets": _hash([target.owned_facets()])}


def _hash(parts: Sequence[NDArray[Any] | str | None]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(np.ascontiguousarray(part).tobytes() if isinstance(part, np.ndarray) else str(part).encode())
    return HASHED + digest.hexdigest()[:16]
