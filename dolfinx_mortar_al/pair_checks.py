"""What is refused of two surfaces before a march: all of them raise ValueError on every rank, with the way out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.bodies import BodyForms
from dolfinx_mortar_al.closest_point import ClosestPoint
from dolfinx_mortar_al.contact import Contact
from dolfinx_mortar_al.kinematics import Kinematics
from dolfinx_mortar_al.pieces import seen_by_any
from dolfinx_mortar_al.reductions import max_over, min_over, sum_over
from dolfinx_mortar_al.surface import Facets, GatheredFacets, Surface
from dolfinx_mortar_al.targets import DeformableTarget, RigidTarget, Target

__all__ = ["check_apart", "check_behind", "check_sides", "check_single", "depth_behind"]

Array = NDArray[np.float64]


def check_single(name: str, contact: Contact, contactor: GatheredFacets, target: Target) -> None:
    """No facet lies on another one of its surface: what two of them carry counts twice.

    Raises:
        ValueError: on every rank.
    """
    sides = [("contactor", f"tag {contact.contactor.tag}", contactor)]
    if isinstance(target, DeformableTarget) and not target.is_contactor:
        sides.append(("target", contact.target_name, target.surface))
    for side, tag, surface in sides:
        if len(twice := surface.doubled()):
            raise ValueError(
                f"{name}: facets of the {side} ({tag}) lie on others of it and face the same way, {len(twice)} in all, the "
                f"first at X = ({_spelt(surface.X[surface.facets[twice[0]]].mean(axis=0))}): is a body drawn or imported "
                "twice? Leave one out"
            )


def check_apart(name: str, contact: Contact, contactor: GatheredFacets, target: Target, body: BodyForms) -> None:
    """Contactor and target share no node: the gap would vanish there whatever happens. `body` is the contactor's.

    Raises:
        ValueError: on every rank.
    """
    if target.is_contactor or not (isinstance(target, DeformableTarget) and target.is_of(body.u)):
        return
    shared = np.isin(contactor.blocks, target.surface.blocks)
    if shared.any():
        raise ValueError(
            f"{name}: contactor (tag {contact.contactor.tag}) and target ({contact.target_name}) share the node at "
            f"X = ({_spelt(contactor.X[shared][0])}): the bodies are joined there; give each its own nodes, or leave its "
            "facets out"
        )


def check_sides(name: str, contact: Contact, kinematics: Kinematics, target: Target, closest: ClosestPoint) -> None:
    """Contactor and target must face each other somewhere, if they are near each other at all: by the points `closest` to
    the contactor's.

    Raises:
        ValueError: on every rank.
    """
    if target.is_contactor:
        return
    comm = kinematics.points.facets.space.mesh.comm
    same_way = np.einsum("ni,ni->n", kinematics.contactor().normal, closest.ν) > 0.5
    facing = sum_over(comm, int(closest.facing.sum()))
    if facing and sum_over(comm, int((closest.facing & same_way).sum())) == facing:
        other = "pass the side of the body that faces it"
        if isinstance(target, RigidTarget):
            other = (
                "if it is around the body pass inside=True, or turn its normal round; of a body that will turn over, name "
                "the whole boundary, in one tag"
            )
        raise ValueError(
            f"{name}: the target ({contact.target_name}) faces away from the contactor (tag {contact.contactor.tag}) "
            f"everywhere: {other}"
        )


def check_behind(name: str, contact: Contact, facets: Facets, target: Target, body: BodyForms, touch: float) -> None:
    """Refuse a contactor whose `body` lies behind the target altogether: it has gone through, or the target's outward side is
    the other one. A membrane may lie up to a target facet behind, as an overlap to be resolved; others up to `touch` (m).

    Raises:
        ValueError: on every rank.
    """
    d, comm = body.space.mesh.geometry.dim, facets.space.mesh.comm
    mine = np.isin(body.piece, seen_by_any(comm, body.piece[facets.dofs]))
    x = body.space.tabulate_dof_coordinates()[:, :d] + body.u.x.array.reshape(-1, d)
    depth = depth_behind(target.closest(x[mine]))
    least = min_over(comm, float(depth.min(initial=np.inf)))
    deepest = max_over(comm, float(depth.max(initial=-np.inf)))
    if least >= -touch and deepest > (target.size if contact.contactor.is_membrane else touch):
        way = "move it to the other side, or turn the target's normal round"
        if isinstance(contact.target, Surface) and contact.target.mesh is contact.contactor.mesh:
            way += "; two sides of a body that touches itself are named as one surface, Contact(Surface(mesh, tags, [a, b]))"
        raise ValueError(
            f"{name}: the contactor (tag {contact.contactor.tag}) lies with its whole body behind the target "
            f"({contact.target_name}): {way}"
        )


def depth_behind(closest: ClosestPoint) -> Array:
    """(n,) how far positions lie behind the target's points `closest` to them (m), −∞ where they face none."""
    return np.where(closest.facing, closest.g, -np.inf)


def _spelt(X: Array) -> str:
    return ", ".join(f"{x:.4g}" for x in X)
