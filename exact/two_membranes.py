"""Two membranes inflated against each other (section 4.2): exact equilibrium apart and in contact, without and with friction.

The lower membrane lies flat on 0 ≤ x ≤ L, y = 0, the upper one on s ≤ x ≤ L + s, y = H. Their ends are fixed and a follower
pressure p, growing from 0, drives them towards each other. They are curves in the plane: plane strain along z, no stress
through the thickness h, w = G/2 (I₁ − 3) − G/2 ln I₃ + Λ/8 (ln I₃)². The upper membrane is the lower one reflected at the
centre M = ((L + s)/2, H/2), so that the lower one says all.

Apart, a membrane is a circular arc of radius N/p with the tension N = hG(l − x/l), l the stretch and x the square of the
thickness stretch. In contact, the two pressures cancel along the contact line: it is straight, has the traction p and passes
through M, and arcs join it tangentially. The tension N₁ of the first arc, from (0, 0), holds along the line if μ = 0. With
friction the whole line slips: the first, longer arc draws material out of it, friction μp holds this back, and the tension
falls linearly to N₂ = N₁ − μpc over the contact length c, so the second arc, to (L, 0), has a radius smaller by μc.

With m = M and q = M − (L, 0), t = (cos φ, sin φ) along the line and n = (sin φ, −cos φ), an arc that passes through its fixed
end has the radius R₁ = −|m − ct/2|²/(2n·m), R₂ = −|q + ct/2|²/(2n·q). R₁ − R₂ = μc is one equation for φ, whatever the
material. ∫ dr/l(N) = L over the deformed length r is then one for p. So the states are a curve in c, from c = 0 at the first
contact to c = 2|q|, the lock: there the line has reached the fixed edges, and beyond it cannot grow. Every root is
bracketed, none needs a guess.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import atan2, cos, hypot, pi, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import wrightomega

__all__ = ["MembraneState", "TwoMembranes", "thickness_stretch_squared"]

Array = NDArray[np.float64]

# Gauss points on 0 … 1 along the contact line; the integrand 1/l is smooth: round-off
_NODES, _WEIGHTS = (np.polynomial.legendre.leggauss(24) + np.array([[1.0], [0.0]])) / 2
_STEPS = 128  # of c from the first contact to the lock, to bracket a pressure and to check that the whole line slips


def thickness_stretch_squared(J: ArrayLike, G: float, Λ: float) -> Array:
    """x of G(x − 1) + (Λ/2) ln x + Λ ln J = 0 at the area stretch J: no stress through the thickness; G > 0, Λ ≥ 0 in Pa.

    With a = 2G/Λ this is ax + ln ax = a + ln a − 2 ln J, so that ax is Wright's ω of the right-hand side.
    """
    J = np.asarray(J, dtype=float)
    if Λ == 0:
        return np.ones_like(J)
    a = 2 * G / Λ
    return np.asarray(wrightomega(a + np.log(a) - 2 * np.log(J)) / a)


def _arc(σ: Array, angle: float, κ: float) -> Array:
    """Points (…, 2) at the arc lengths σ from the origin, along a curve that starts at `angle` and turns right by κσ."""
    half = κ * σ / 2
    chord = σ * np.sinc(half / pi)
    return np.stack([chord * np.cos(angle - half), chord * np.sin(angle - half)], axis=-1)


@dataclass(frozen=True)
class MembraneState:
    """The lower membrane in equilibrium, from (0, 0) to (L, 0): first arc, contact line, second arc.

    Material coordinates X and arc lengths σ of the deformed curve are in metres, arrays of any shape, and count from (0, 0).

    Attributes:
        membranes: what is in equilibrium.
        pressure: p in Pa.
        angle: of the contact line against x, where it leaves the first arc, in radians; 0, at the top, while apart.
        lengths: deformed lengths of the three pieces in m.
        tensions: N₁ and N₂ in the two arcs in N/m.
    """

    membranes: TwoMembranes
    pressure: float
    angle: float
    lengths: tuple[float, float, float]
    tensions: tuple[float, float]

    @property
    def radii(self) -> tuple[float, float]:
        """Radii of the two arcs in m, infinite at p = 0."""
        first, second = (N / self.pressure if self.pressure > 0 else np.inf for N in self.tensions)
        return first, second

    @property
    def contact_length(self) -> float:
        """Length of the contact line in m, 0 while apart."""
        return self.lengths[1]

    @property
    def contact_line(self) -> Array:
        """Ends (2, 2) of the contact line in m, in the order of the material."""
        return self._points(np.cumsum(self.lengths)[:2])

    @property
    def contact_material(self) -> tuple[float, float]:
        """Material coordinates of the ends of the contact line in m."""
        first, second = self.material(np.cumsum(self.lengths)[:2])
        return float(first), float(second)

    @property
    def stretch_max(self) -> float:
        """Stretch of the first arc."""
        return float(self.membranes.stretch(self.tensions[0]))

    @property
    def stretch_min(self) -> float:
        """Stretch of the second arc."""
        return float(self.membranes.stretch(self.tensions[1]))

    @property
    def multiplier(self) -> tuple[float, float]:
        """Smallest and largest nominal normal traction p·l in Pa, at the ends of the contact line; (0, 0) while apart."""
        if self.contact_length == 0:
            return 0.0, 0.0
        return self.pressure * self.stretch_min, self.pressure * self.stretch_max

    @property
    def midpoint_displacement(self) -> Array:
        """Displacement (u_x, u_y) in m of the material point X = L/2."""
        X = self.membranes.length / 2
        return self.points(X) - np.array([X, 0.0])

    @property
    def max_height(self) -> float:
        """Largest y of the membrane in m: the top of the first arc, on which the tangent turns from up to down."""
        before = self.angle * self.radii[0] if self.angle < 0 else 0.0
        return float(self._points(np.array(self.lengths[0] + before))[1])

    def material(self, σ: ArrayLike) -> Array:
        """Material coordinates at arc lengths σ."""
        first, r, second = self._pieces(σ, *self.lengths[:2])
        return first / self.stretch_max + self._line_material(r) + second / self.stretch_min

    def arc_length(self, X: ArrayLike) -> Array:
        """Arc lengths of the material points X."""
        first, r, second = self._reference_pieces(X)
        return first * self.stretch_max + self._line_length(r) + second * self.stretch_min

    def stretch(self, X: ArrayLike) -> Array:
        """Stretch of the material points X."""
        return self._line_stretch(self._line_length(self._reference_pieces(X)[1]))

    def points(self, X: ArrayLike) -> Array:
        """Deformed positions (…, 2) of the material points X in m."""
        return self._points(self.arc_length(X))

    def shape(self, n: int) -> tuple[Array, Array]:
        """n material coordinates, equally spaced from 0 to L, and their deformed positions (n, 2)."""
        X = np.linspace(0.0, self.membranes.length, n, dtype=np.float64)
        return X, self.points(X)

    @staticmethod
    def _pieces(s: ArrayLike, first: float, line: float) -> tuple[Array, Array, Array]:
        """How much of the three pieces, the first two of the given lengths, lies before s."""
        s = np.asarray(s, dtype=float)
        return np.minimum(s, first), np.clip(s - first, 0.0, line), np.maximum(s - first - line, 0.0)

    def _reference_pieces(self, X: ArrayLike) -> tuple[Array, Array, Array]:
        return self._pieces(
            X, self.lengths[0] / self.stretch_max, float(self._line_material(np.array(self.lengths[1])))
        )

    def _points(self, σ: Array) -> Array:
        first, r, second = self._pieces(σ, *self.lengths[:2])
        κ1, κ2 = (1 / R for R in self.radii)
        start = self.angle + κ1 * self.lengths[0]
        return _arc(first, start, κ1) + _arc(r, self.angle, 0.0) + _arc(second, self.angle, κ2)

    def _line_stretch(self, r: Array) -> Array:
        """Stretch at the distances r along the contact line."""
        return self.membranes.stretch(self.tensions[0] - self.membranes.friction * self.pressure * r)

    def _line_material(self, r: Array) -> Array:
        """∫ dr/l(N) from the start of the contact line."""
        return r * ((1 / self._line_stretch(r[..., None] * _NODES)) @ _WEIGHTS)

    def _line_length(self, Y: Array) -> Array:
        """Distances r along the contact line that hold the material lengths Y: Newton from above on a convex function."""
        r = np.minimum(Y * self.stretch_max, self.contact_length)
        for _ in range(50):
            δ = (self._line_material(r) - Y) * self._line_stretch(r)
            r = r - δ
            if np.all(np.abs(δ) <= 1e-15 * self.membranes.length):
                break
        return r


@dataclass(frozen=True)
class TwoMembranes:
    """Young's modulus `E` in Pa, Poisson's ratio `nu`, `thickness`, `length` L, `shift` s > 0 and `height` H in m, Coulomb's
    coefficient `friction`.

    With friction the states in contact are those under growing pressure while the whole contact line slips. Above
    `largest_friction` a core sticks from the first contact on, and these states do not exist. Below, the line slips up to the
    lock for L = H and s ≤ 2L; on membranes far apart or close to each other it may stick again before, at a pressure that the
    error message states.
    """

    E: float = 2e6
    nu: float = 0.3
    thickness: float = 1e-3
    length: float = 1.0
    shift: float = 1.0
    height: float = 1.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        for label in ("E", "thickness", "length", "shift", "height"):
            value = getattr(self, label)
            if not 0 < value < np.inf:
                raise ValueError(f"{label} = {value}: must be positive")
        if not 0 <= self.nu < 0.5:
            raise ValueError(f"nu = {self.nu}: must lie in 0 ≤ ν < 0.5")
        if not 0 <= self.friction < np.inf:
            raise ValueError(f"friction = {self.friction}: Coulomb's coefficient must be a number ≥ 0")

    @property
    def G(self) -> float:
        """Shear modulus in Pa."""
        return self.E / (2 * (1 + self.nu))

    @property
    def lame(self) -> float:
        """Lamé's first parameter in Pa."""
        return self.E * self.nu / ((1 + self.nu) * (1 - 2 * self.nu))

    @property
    def centre(self) -> Array:
        """M in m: the membranes are reflections of each other at this point."""
        return np.array([self.length + self.shift, self.height]) / 2

    @property
    def longest_contact(self) -> float:
        """Length 2|q| in m of the contact line that reaches from fixed edge to fixed edge."""
        return hypot(self.length - self.shift, self.height)

    def tension(self, l: ArrayLike) -> Array:
        """N = hG(l − x/l) in N/m at the stretch l."""
        l = np.asarray(l, dtype=float)
        return self.thickness * self.G * (l - thickness_stretch_squared(l, self.G, self.lame) / l)

    def stretch(self, N: ArrayLike) -> Array:
        """Stretch l ≥ 1 at the tension N ≥ 0 in N/m: Newton on a concave function, from below after a first step."""
        N = np.asarray(N, dtype=float)
        if not np.all(N >= 0):
            raise ValueError(f"tension = {np.min(N)}: must be ≥ 0, a membrane carries no compression")
        G, Λ, n = self.G, self.lame, N / (self.thickness * self.G)
        l = (n + np.sqrt(n**2 + 4)) / 2
        for _ in range(50):
            x = thickness_stretch_squared(l, G, Λ)
            δ = (l - x / l - n) / (1 + x / l**2 * (1 + 2 * Λ / (2 * G * x + Λ)))
            l = l - δ
            if np.all(np.abs(δ) <= 4e-16 * l):
                break
        return np.maximum(l, 1.0)

    def first_contact_angle(self) -> float:
        """Half opening angle θ in radians of the arc that passes through M with its centre in line with the other arc's."""
        L, s, H = self.length, self.shift, self.height
        return atan2(L / 2, -(s**2 + H**2 - L**2) / (4 * H))

    def first_contact_pressure(self) -> float:
        """Pressure in Pa at which the membranes touch, at M."""
        return self._apart(self.first_contact_angle()).pressure

    def lock_pressure(self) -> float:
        """Pressure in Pa at which the contact line reaches the fixed edges."""
        last = self._branch[-1].pressure
        if not self._locks:
            raise ValueError(
                f"friction = {self.friction}: the contact line slips everywhere up to {last:.6f} Pa only, "
                f"not to the lock; admissible at shift = {self.shift}: from 0 to at most {self.largest_friction():.4f}"
            )
        return last

    def largest_friction(self) -> float:
        """Largest coefficient with which the whole line slips from the first contact on, to about 1e-6.

        It does if the first arc draws material over M as c grows from 0. How much it draws is linear in μ in this limit.
        """
        c = 1e-6 * self.longest_contact

        def drawn(friction: float) -> float:
            state = replace(self, friction=friction)._at(c)
            return float(state.material(state.lengths[0] + c / 2)) - start

        state = self._at(0.0)
        start = float(state.material(state.lengths[0]))
        without = drawn(0.0)
        return without / (without - drawn(1.0))

    def state(self, pressure: float) -> MembraneState:
        """The state at a pressure in Pa from 0 to `lock_pressure`, or to where the line stops slipping everywhere."""
        if pressure > self.first_contact_pressure():
            return self.in_contact(pressure)
        return self.apart(pressure)

    def apart(self, pressure: float) -> MembraneState:
        """The state at a pressure in Pa from 0 to `first_contact_pressure`: an arc of half opening angle θ, l = θ/sin θ."""
        θ = self.first_contact_angle()
        highest = self._apart(θ).pressure
        if not 0 <= pressure <= highest:
            raise ValueError(f"pressure = {pressure}: the membranes are apart from 0 to {highest:.6f} Pa")
        return self._apart(brentq(lambda θ: self._apart(θ).pressure - pressure, 0.0, θ, xtol=1e-15, rtol=1e-15))

    def in_contact(self, pressure: float) -> MembraneState:
        """The state in contact, at a pressure in Pa from `first_contact_pressure` on."""
        pressures = [state.pressure for state in self._branch]
        if not pressures[0] <= pressure <= pressures[-1]:
            end = "lock at" if self._locks else "slip everywhere up to"
            raise ValueError(
                f"pressure = {pressure}: the membranes touch from {pressures[0]:.6f} Pa and {end} {pressures[-1]:.6f} Pa "
                f"(shift = {self.shift}, friction = {self.friction})"
            )
        k = int(np.searchsorted(pressures, pressure))
        if pressures[k] == pressure:
            return self._branch[k]
        a, b = self._branch[k - 1].contact_length, self._branch[k].contact_length
        return self._at(brentq(lambda c: self._at(c).pressure - pressure, a, b, xtol=1e-15, rtol=1e-15))

    def _apart(self, θ: float) -> MembraneState:
        """The arc of half opening angle θ; it has only one pressure, which grows with θ from 0 towards 2πGh/L."""
        l = 1 / float(np.sinc(θ / pi))
        N, half = float(self.tension(l)), l * self.length / 2
        return MembraneState(self, 2 * N * sin(θ) / self.length, 0.0, (half, 0.0, half), (N, N))

    def _angle(self, c: float) -> float:
        """φ for a contact length c: R₁ − R₂ = μc, times 2(n·m)(n·q) > 0.

        Of several roots, the smallest is the one on the way to the lock, where φ takes its smallest value.
        """
        m, q = self.centre, self.centre - np.array([self.length, 0.0])

        def excess(φ: float | Array) -> Array:
            t, n = np.array([np.cos(φ), np.sin(φ)]), np.array([np.sin(φ), -np.cos(φ)])
            first, second = m @ m - c * (m @ t) + c**2 / 4, q @ q + c * (q @ t) + c**2 / 4
            return (n.T @ m) * second - (n.T @ q) * first - 2 * self.friction * c * (n.T @ m) * (n.T @ q)

        # n·m < 0 and n·q < 0
        φ = np.linspace(atan2(q[1], q[0]) - pi, atan2(m[1], m[0]), 181, dtype=np.float64)
        k = int(np.argmax(excess(φ) > 0))
        if k == 0 or c >= self.longest_contact:
            return float(φ[0])
        return float(brentq(excess, φ[k - 1], φ[k], xtol=1e-15, rtol=1e-15))

    def _at(self, c: float) -> MembraneState:
        """The state of contact length c."""
        φ = self._angle(c)
        t, n = np.array([cos(φ), sin(φ)]), np.array([sin(φ), -cos(φ)])
        first = self.centre - c / 2 * t  # chords of the two arcs
        second = np.array([self.length, 0.0]) - self.centre - c / 2 * t
        α1, α2 = 2 * atan2(-first @ n, first @ t), 2 * atan2(second @ n, second @ t)
        s1 = hypot(*first) / float(np.sinc(α1 / (2 * pi)))
        s2 = hypot(*second) / float(np.sinc(α2 / (2 * pi))) if c < self.longest_contact else 0.0
        R1 = s1 / α1
        R2 = R1 - self.friction * c
        if R2 <= 0:
            raise ValueError(f"friction = {self.friction}: no tension would be left after a contact length of {c} m")

        def state(p: float) -> MembraneState:
            return MembraneState(self, p, φ, (s1, c, s2), (p * R1, p * R2))

        total = s1 + c + s2
        N = float(self.tension(total / self.length))  # the tension at a uniform stretch lies between N₁ and N₂
        if R1 == R2:
            return state(N / R1)
        bracket = (N / R1 * (1 - 1e-9), N / R2 * (1 + 1e-9))
        return state(brentq(lambda p: float(state(p).material(total)) - self.length, *bracket, xtol=1e-12, rtol=1e-15))

    @cached_property
    def _branch(self) -> list[MembraneState]:
        """States from the first contact to the lock, as long as pressure grows and the line turns on and slips."""
        states = [self._at(0.0)]
        for c in np.linspace(0.0, self.longest_contact, _STEPS + 1)[1:]:
            try:
                a, b = states[-1], self._at(float(c))
            except ValueError:
                break
            smooth = a.pressure < b.pressure and 0 < a.angle - b.angle < 0.3
            if not smooth or (self.friction > 0 and not _slips(a, b)):
                break
            states.append(b)
        return states

    @property
    def _locks(self) -> bool:
        return len(self._branch) == _STEPS + 1


def _slips(a: MembraneState, b: MembraneState) -> bool:
    """Whether, from a to b, the lower membrane slips towards its first arc at the ends and the middle of the line of a.

    At the distance ρ from M its material moves by −l(ρ)δX(ρ) along t and the upper one's, reflected, by l(−ρ)δX(−ρ).
    """
    ρ = np.array([-0.5, 0.0, 0.5]) * a.contact_length
    X, Y = (state.material(state.lengths[0] + state.contact_length / 2 + ρ) for state in (a, b))
    moved = a.stretch(X) * (Y - X)
    return bool(np.all(moved + moved[::-1] > 0))
