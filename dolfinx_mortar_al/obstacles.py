"""Rigid obstacles: planes, spheres (circles) and cylinders as targets with a closed-form closest-point map.

An obstacle has no unknowns: its :class:`~dolfinx_mortar_al.closest_point.ClosestPoint` has no nodes, N and N,α are empty. Its
tangents 𝐚_α are the principal directions in arc length, so that A = 1 and κ is diagonal. A material point of it is named by
its initial position Y; at present it is at pivot + Q (Y − pivot) + translation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dolfinx_mortar_al.closest_point import ClosestPoint
from dolfinx_mortar_al.projection import TargetPoint
from dolfinx_mortar_al.validation import number, numbers

__all__ = ["Obstacle", "Pose", "RigidCylinder", "RigidPlane", "RigidSphere"]

Array = NDArray[np.float64]

ONE_ANGLE = "needs one finite angle in rad in two dimensions,"
NO_DIRECTION = 1e-12  # distance to a centre or axis, in radii, below which no closest point is defined


@dataclass(frozen=True)
class Pose:
    """Where a rigid obstacle is: translation (gdim,) in metres and rotation matrix Q (gdim, gdim); and by what angle, or
    rotation vector, it was said to have turned (rad), which tells whole turns, NaN where that is not known."""

    translation: Array
    rotation: Array
    turned: Array = field(default_factory=lambda: np.full(1, np.nan))

    @classmethod
    def initial(cls, gdim: int) -> Pose:
        """No motion."""
        return cls(np.zeros(gdim), np.eye(gdim), np.zeros(2 * gdim - 3))

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Pose)
            and np.array_equal(self.translation, other.translation)
            and np.array_equal(self.rotation, other.rotation)
        )

    def copy(self) -> Pose:
        return Pose(*(np.array(part, dtype=np.float64) for part in (self.translation, self.rotation, self.turned)))


@dataclass(frozen=True)
class _Nearest:
    """The closest-point map in the obstacle's own axes, origin in the pivot.

    Attributes:
        r: (n, gdim) closest point; ν: (n, gdim) outward unit normal; a: (n, dim, gdim) principal directions.
        κ: (n, dim) principal curvatures ν·𝐲,αα.
        defined: (n,) false where no point is the closest one.
    """

    r: Array
    ν: Array
    a: Array
    κ: Array
    defined: NDArray[np.bool_]


class Obstacle(ABC):
    """A rigid body of prescribed motion; bodies touch it, it is never deformed.

    Attributes:
        pivot: (gdim,) initial position of the point about which it turns (m).
    """

    def __init__(self, pivot: Array) -> None:
        self.pivot = pivot
        self._pose = Pose.initial(len(pivot))

    def __repr__(self) -> str:
        """Kind, pivot and shape, without the pose."""
        shape = {name: np.asarray(v).tolist() for name, v in sorted(vars(self).items()) if not name.startswith("_")}
        return f"{type(self).__name__} {shape}"

    @property
    def smallest_radius(self) -> float:
        """Of its surface where that bulges (m), infinite where it does not: what is smaller than the distance of integration
        points may get between them."""
        return np.inf

    @property
    def curvature(self) -> float:
        """The largest of its surface (1/m), negative where that is hollow."""
        return 0.0

    @property
    def reach(self) -> float:
        """The length that its surface is computed with (m): as a share of it distances from the obstacle have round-off."""
        return float(np.linalg.norm(self.pivot))

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return len(self.pivot)

    @property
    def pose(self) -> Pose:
        """The present pose, a copy; set it to go back to one.

        Raises:
            ValueError: if the pose set is of another dimension or its matrix is no rotation.
        """
        return self._pose.copy()

    @pose.setter
    def pose(self, pose: Pose) -> None:
        if not isinstance(pose, Pose):
            raise ValueError(f"pose: {type(pose).__name__} is not a Pose; move() makes one")
        Q, turned = (np.array(part, dtype=np.float64) for part in (pose.rotation, pose.turned))
        new = Pose(_vector("translation", pose.translation, self.gdim), Q, turned)
        eye = np.eye(self.gdim)
        if Q.shape != eye.shape or not np.allclose(Q.T @ Q, eye, atol=1e-9) or np.linalg.det(Q) < 0:
            raise ValueError(
                f"rotation = {Q.tolist()}: needs an orthogonal {self.gdim}×{self.gdim} matrix of determinant 1; "
                "move() makes one from an angle or a rotation vector"
            )
        self._pose = new

    def move(self, translation: ArrayLike, rotation: ArrayLike | None = None) -> None:
        """Bring the obstacle to the pose pivot + Q (Y − pivot) + translation, whatever its pose was before.

        Args:
            translation: (gdim,) from the initial position (m).
            rotation: from the initial position about the pivot: an angle (2D), a rotation vector (3D), in rad, or None. It
                goes on beyond whole turns, by less than half of one in a step where there is friction.

        Raises:
            ValueError: if one of them has another number of components or is not finite.
        """
        turned = numbers(np.zeros(2 * self.gdim - 3) if rotation is None else rotation)
        self.pose = Pose(
            _vector("translation", translation, self.gdim), _rotation_matrix(rotation, self.gdim), turned.ravel()
        )

    def positions(self, Y: Array, pose: Pose | None = None) -> Array:
        """Positions (n, gdim), at present or in another pose, of the material points with initial positions Y (n, gdim)."""
        pose = self._pose if pose is None else pose
        return np.asarray(self.pivot + pose.translation + (Y - self.pivot) @ pose.rotation.T)

    def swing(self, before: Pose) -> Array:
        """The rotation (gdim, gdim) of its surface since another pose; of what is round without turns in itself."""
        return self._pose.rotation @ before.rotation.T

    def carried(self, x: Array, before: Pose) -> Array:
        """Where points at 𝐱 (n, gdim) in another pose are now if they went with its surface."""
        return np.asarray(
            self.pivot + self._pose.translation + (x - self.pivot - before.translation) @ self.swing(before).T
        )

    def sweep(self, y: Array, before: Pose) -> Array:
        """(n, gdim) how far its material points at 𝐲 (n, gdim) would go on (m) in as much time as it took from another pose
        to the present one, at a constant rate and by less than half a turn: their velocities, not the chords of their ways,
        which leave the surface of what turns in itself."""
        S, d = self._pose.rotation @ before.rotation.T, self.gdim
        spin = (S - S.T) / 2  # the axis times the sine
        sine, cosine = np.linalg.norm(spin) / np.sqrt(2), (np.trace(S) - d + 2) / 2
        turn = spin * (np.arctan2(sine, cosine) / sine if sine > 0.0 else 1.0)
        present = self._pose.translation
        return np.asarray(present - before.translation + (y - self.pivot - present) @ turn.T)

    def project(self, x: Array) -> ClosestPoint:
        """The closest-point map of 𝐱 (n, gdim); its `point.η` (n, gdim) is the closest point's initial position Y."""
        Q, present = self._pose.rotation, self.pivot + self._pose.translation
        near = self._nearest((x - present) @ Q)
        n, dim = len(x), self.gdim - 1
        y, ν = present + near.r @ Q.T, near.ν @ Q.T
        g = -np.einsum("ni,ni->n", ν, x - y)
        eye = np.eye(dim)
        stretch = np.where(near.defined[:, None], 1.0 + g[:, None] * near.κ, 1.0)  # Ā = A + g κ
        return ClosestPoint(
            point=TargetPoint(np.zeros(n, dtype=np.int64), self.pivot + near.r),
            facing=near.defined,
            N=np.zeros((n, 0)),
            dN=np.zeros((n, dim, 0)),
            y=y,
            a=near.a @ Q.T,
            ν=ν,
            g=g,
            κ=near.κ[:, :, None] * eye,
            Ā_inv=eye / stretch[:, :, None],
            A_inv=np.repeat(eye[None], n, axis=0),
            inside=np.ones(n, dtype=bool),
        )

    @abstractmethod
    def _nearest(self, r: Array) -> _Nearest:
        """The map at points r (n, gdim) given in the obstacle's own axes, from the pivot."""


class RigidPlane(Obstacle):
    """A half-space (a half-plane in 2D) bounded by the plane through `point`.

    Args:
        point: (gdim,) a point of the plane (m); the pivot.
        normal: (gdim,) out of the obstacle, towards the bodies; of any length.

    Raises:
        ValueError: if the numbers of components are not both 2 or both 3, or the normal is zero.
    """

    def __init__(self, point: ArrayLike, normal: ArrayLike) -> None:
        super().__init__(_vector("point", point))
        self.normal = _unit("normal", normal, self.gdim)

    def _nearest(self, r: Array) -> _Nearest:
        ν = np.repeat(self.normal[None], len(r), axis=0)
        flat = r - (r @ self.normal)[:, None] * self.normal
        return _Nearest(flat, ν, _tangents(ν), np.zeros((len(r), self.gdim - 1)), np.ones(len(r), dtype=bool))


class _Round(Obstacle):
    """One with a radius (m), from outside or, `inside`, from the hollow."""

    def __init__(self, pivot: Array, radius: float, inside: bool) -> None:
        super().__init__(pivot)
        self.radius, self.inside = _radius(radius), inside

    @property
    def reach(self) -> float:
        return super().reach + self.radius

    @property
    def smallest_radius(self) -> float:
        return np.inf if self.inside else self.radius

    @property
    def curvature(self) -> float:
        return (-1.0 if self.inside else 1.0) / self.radius


class RigidSphere(_Round):
    """A ball (a disc in 2D), or with `inside` the matter around a spherical hollow that holds the bodies.

    Args:
        centre: (gdim,) in metres; the pivot.
        radius: in metres.
        inside: whether the bodies are in the hollow: ν then points to the centre.

    Raises:
        ValueError: if the centre has not 2 or 3 components or the radius is not positive and finite.
    """

    def __init__(self, centre: ArrayLike, radius: float, inside: bool = False) -> None:
        super().__init__(_vector("centre", centre), radius, inside)

    def swing(self, before: Pose) -> Array:
        return np.eye(self.gdim)

    def _nearest(self, r: Array) -> _Nearest:
        e, defined = _direction(r, np.eye(self.gdim)[0], self.radius)
        side = -1.0 if self.inside else 1.0
        κ = np.full((len(r), self.gdim - 1), -side / self.radius)
        return _Nearest(self.radius * e, side * e, _tangents(side * e), κ, defined)


class RigidCylinder(_Round):
    """An endless round cylinder in 3D, or with `inside` the matter around a bore that holds the bodies.

    Args:
        point: (3,) a point of the axis (m); the pivot.
        axis: (3,) its direction, of any length.
        radius: in metres.
        inside: whether the bodies are in the bore: ν then points to the axis.

    Raises:
        ValueError: if point or axis have not 3 components, the axis is zero or the radius is not positive and finite.
    """

    def __init__(self, point: ArrayLike, axis: ArrayLike, radius: float, inside: bool = False) -> None:
        super().__init__(_vector("point", point, 3), radius, inside)
        self.axis = _unit("axis", axis, 3)

    def swing(self, before: Pose) -> Array:
        axis, end = before.rotation @ self.axis, self._pose.rotation @ self.axis
        end *= np.copysign(1.0, axis @ end)  # either end of the axis is as good
        across = np.outer(end, axis) - np.outer(axis, end)  # times the angle's sine, about axis × end
        return np.asarray(np.eye(3) + across + across @ across / (1.0 + axis @ end))

    def _nearest(self, r: Array) -> _Nearest:
        along = (r @ self.axis)[:, None] * self.axis
        e, defined = _direction(r - along, _tangents(self.axis[None])[0, 0], self.radius)
        side = -1.0 if self.inside else 1.0
        a = np.stack([np.cross(self.axis, side * e), np.broadcast_to(self.axis, e.shape)], axis=1)
        κ = np.tile([-side / self.radius, 0.0], (len(r), 1))
        return _Nearest(along + self.radius * e, side * e, a, κ, defined)


def _direction(r: Array, otherwise: Array, radius: float) -> tuple[Array, NDArray[np.bool_]]:
    """Unit vectors (n, gdim) along r (n, gdim) and (n,) where r has a direction; `otherwise` (gdim,) elsewhere."""
    length = np.linalg.norm(r, axis=1)
    defined = length > NO_DIRECTION * radius
    e = r / np.where(defined, length, 1.0)[:, None]
    e[~defined] = otherwise
    return e, defined


def _tangents(ν: Array) -> Array:
    """Orthonormal tangents (n, dim, gdim) at unit normals ν (n, gdim), such that `surface_normal` gives ν."""
    if ν.shape[1] == 2:
        return np.stack([-ν[:, 1], ν[:, 0]], axis=1)[:, None]
    across = np.eye(3)[np.argmin(np.abs(ν), axis=1)]  # the axis farthest from ν
    first = np.cross(across, ν)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(ν, first)], axis=1)


def _rotation_matrix(rotation: ArrayLike | None, gdim: int) -> Array:
    """(gdim, gdim) of an angle (2D) or a rotation vector (3D)."""
    if rotation is None:
        return np.eye(gdim)
    if gdim == 3:
        from scipy.spatial.transform import Rotation  # slow to import

        return np.asarray(Rotation.from_rotvec(_vector("rotation", rotation, 3)).as_matrix(), dtype=np.float64)
    single: Any = rotation
    angle = number("rotation", single[0] if np.shape(single) == (1,) else single, must=ONE_ANGLE)
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _vector(name: str, value: Any, gdim: int | None = None) -> Array:
    """`value` as a copied array of gdim finite components, 2 or 3 where gdim is None."""
    vector = numbers(value)
    if vector.shape not in ([(2,), (3,)] if gdim is None else [(gdim,)]) or not np.isfinite(vector).all():
        raise ValueError(f"{name} = {value}: needs {'2 or 3' if gdim is None else gdim} finite components")
    return vector


def _unit(name: str, value: Any, gdim: int) -> Array:
    """`value` (gdim,) brought to length 1."""
    vector = _vector(name, value, gdim)
    largest = np.abs(vector).max()
    if largest == 0.0:
        raise ValueError(f"{name} = {value}: a zero vector has no direction, pass one of any other length")
    vector /= largest  # the squares of tiny components would vanish
    return vector / np.linalg.norm(vector)


def _radius(value: float) -> float:
    return number(
        "radius", value, above=0.0, must="needs a positive length in metres (inside=True puts the matter outside),"
    )
