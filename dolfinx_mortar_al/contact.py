"""What the user says of a contact pair: two surfaces, a law, and how it is integrated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_mortar_al.obstacles import Obstacle
from dolfinx_mortar_al.reductions import sum_over
from dolfinx_mortar_al.surface import Surface
from dolfinx_mortar_al.validation import constant_value, number, varies, whole

__all__ = ["Contact", "check_surfaces", "coefficient"]


@dataclass(frozen=True)
class Contact:
    """Two surfaces that may touch, or one that may touch itself.

    Args:
        contactor: carries the multiplier and the integration points; better the softer side, of equally stiff ones the
            finer, and of a corner and a flat side the corner (where a sharp one slides, with ``projection="closest"``). One
            that is stiffer and finer is held smooth (docs/theory.md).
        target: the surface that contactor points are projected onto, or a rigid obstacle. Left out, the contactor is its own
            target (``docs/self_contact.md``).
        friction: Coulomb's coefficient μ ≥ 0; the number 0 builds the problem with a scalar multiplier and no slip history.
            A UFL Constant may be changed between steps.
        epsilon_normal, epsilon_tangential: augmentation parameters ε_N, ε_T (Pa/m). By default both come from the bulk
            stiffness at the surfaces; the answer depends on them only where a facet is partly closed. Pressures near the
            bodies' moduli add to either.
        multiplier_order: of the multiplier's Lagrange element, 1 or, as in the paper, the displacement's; by default 1, and
            the displacement's against a rigid obstacle with a radius of few facets, or of facets that round (docs/theory.md).
        projection: "rays" along the contactor's normals, or "closest", the paper's closest points. A rigid obstacle always
            has the closest points.
        integration: "segments", between the ends of the target's facets as the contactor's rays see them, which follow the
            bodies, or "gauss", the default, the same points on each facet, in statics as far as the target goes: where it
            ends inside a facet, points follow its end.
        quadrature_degree: of the Gauss points on each facet, at least twice the multiplier's order; default 4 × the
            displacement's order (10 of order 1 in the plane, on a curved membrane there 6 × order + 1), more where the
            target's facets are finer, and in space on surfaces of few facets. With segments of the points on each segment;
            default exact on flat facets.
        thickness: out of the plane (m), for two-dimensional bodies; the same as in the bulk's forms. Left out, that of the
            :class:`~dolfinx_mortar_al.body.Body` of the surfaces, or 1 with residuals of one's own.
        name: for messages and files; default "contact", with a number where there are several.

    Raises:
        ValueError: on a friction that is negative or not finite, an ε that is not positive, an unknown projection, equal
            surfaces, closest points of a surface with itself, or what is no surface, number or name at all.
    """

    contactor: Surface
    target: Surface | Obstacle | None = None
    friction: float | fem.Constant = 0.0
    epsilon_normal: float | None = None
    epsilon_tangential: float | None = None
    multiplier_order: int | None = None
    projection: str = "rays"
    integration: str = "gauss"
    quadrature_degree: int | None = None
    thickness: float | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        def keep(label: str, value: Any) -> None:
            object.__setattr__(self, label, value)  # frozen for the user

        if isinstance(self.friction, fem.Constant):
            coefficient(constant_value(self.friction, "friction"))
        else:
            keep("friction", coefficient(self.friction))
        must = "leave it out for the default, or pass"
        for label in ("epsilon_normal", "epsilon_tangential", "thickness"):
            value = constant_value(getattr(self, label), label)
            if value is not None:
                keep(label, number(label, value, above=0.0, must=must))
        if self.quadrature_degree is not None:
            keep("quadrature_degree", whole("quadrature_degree", self.quadrature_degree, least=0, most=30))
        if self.multiplier_order is not None:
            keep("multiplier_order", whole("multiplier_order", self.multiplier_order, least=1, most=2))
        if not isinstance(self.projection, str) or self.projection not in ("rays", "closest"):
            raise ValueError(f'projection = "{self.projection}": "rays" or "closest"')
        if self.name is not None and (not isinstance(self.name, str) or not self.name or set(self.name) & set("/\0")):
            raise ValueError(f"name = {self.name!r}: files are called after it; pass a text without /")
        if self.integration not in ("segments", "gauss"):
            raise ValueError(f'integration = "{self.integration}": "segments" or "gauss"')
        if self.integration == "segments" and self.projection != "rays":
            raise ValueError(
                f'integration = "segments" with projection = "{self.projection}": segments are cut by rays; take '
                'projection = "rays" or integration = "gauss"'
            )
        a, b = self.contactor, self.target
        if not isinstance(a, Surface):
            raise ValueError(f"contactor: {type(a).__name__} is not a Surface; an obstacle can be the target only")
        if b is None and self.projection != "rays":
            raise ValueError(
                f'projection = "{self.projection}" with no target: the closest point of a surface to itself is the point '
                'itself; take projection = "rays", or name a target'
            )
        if not isinstance(b, Surface | Obstacle | None):
            raise ValueError(
                f"target: {type(b).__name__} is neither a Surface nor an obstacle of the module obstacles; leave it out for "
                "the contact of a surface with itself"
            )
        if isinstance(b, Surface) and a.mesh is b.mesh and a.tags is b.tags and a.tag == b.tag:
            raise ValueError(
                f"contactor and target are the same surface (tag {a.tag}): leave the target out for contact with itself"
            )

    @property
    def said(self) -> dict[str, Any]:
        """What is to be the same on all ranks, by the name of the argument."""
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        target = self.target if isinstance(self.target, Obstacle) else self.target_name
        return plain | {"friction": constant_value(self.friction), "contactor": self.contactor.tag, "target": target}

    @property
    def target_name(self) -> str:
        """The target in a message."""
        if self.target is None:
            return "itself"
        return f"tag {self.target.tag}" if isinstance(self.target, Surface) else type(self.target).__name__


def coefficient(μ: Any) -> float:
    """A friction coefficient, checked."""
    if varies(μ):
        raise ValueError(
            f"friction = {μ}: Coulomb's coefficient is one number on a contactor; give each of its parts a tag and a Contact"
        )
    return number("friction", μ, least=0.0, must="Coulomb's coefficient must be")


def check_surfaces(contacts: Sequence[Contact]) -> None:
    """No facet may be contactor and target of itself, nor in contact with another twice, in one direction or both: the
    multipliers of such a pair are not unique (collective).

    Raises:
        ValueError: on every rank.
    """
    own = [(c.contactor.owned_facets(), _owned(_other(c))) for c in contacts]

    def share(a: Surface, b: Any, of_a: Any, of_b: Any) -> bool:
        if not isinstance(b, Surface):
            return False
        return a.mesh is b.mesh and sum_over(a.mesh.comm, len(np.intersect1d(of_a, of_b))) > 0

    for i, (first, (contactor, target)) in enumerate(zip(contacts, own, strict=True)):
        a, b = first.contactor, _other(first)
        if first.target is not None and share(a, b, contactor, target):
            raise ValueError(
                f"contactor (tag {a.tag}) and target ({first.target_name}) have facets in common: a pair needs two surfaces"
            )
        for second, (contactor2, target2) in zip(contacts[:i], own, strict=False):
            c, d = second.contactor, _other(second)
            same_target = (
                b is d if not isinstance(d, Surface) else isinstance(b, Surface) and share(d, b, target2, target)
            )
            if share(a, c, contactor, contactor2) and same_target:
                raise ValueError(
                    f"contacts: the pair of contactor tag {a.tag} and target {first.target_name} is there twice, at least in "
                    "part: drop one"
                )
            if isinstance(b, Surface) and share(a, d, contactor, target2) and share(b, c, target, contactor2):
                raise ValueError(
                    f"contacts: the surfaces of tags {a.tag} and {b.tag} are paired in both directions: drop one of the two; "
                    "either side can be the contactor"
                )


def _other(contact: Contact) -> Any:
    """What the contactor may touch."""
    return contact.contactor if contact.target is None else contact.target


def _owned(target: Any) -> Any:
    return target.owned_facets() if isinstance(target, Surface) else None
