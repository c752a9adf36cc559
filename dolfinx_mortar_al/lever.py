"""The operator 𝐀^α = (𝐚^α·𝐫) 𝐈 − (𝐧·𝐫) 𝐚^α⊗𝐧: how a distance 𝐫 from a surface changes when it moves with the surface.

𝐚_α are tangents of the surface, 𝐚^α their duals, 𝐧 its unit normal: 𝐀^α Δ𝐚_α = Δ𝐫 for every rigid motion, finite ones
included if 𝐚_α and 𝐫 are the means of both ends (``docs/impact.md``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dolfinx_mortar_al.projection import dot, dual

__all__ = ["Lever"]

Array = NDArray[np.float64]
Parts = tuple[Array, Array, Array, Array]


@dataclass
class Lever:
    """The operator 𝐀^α at n points, in the middle of a step or at its end.

    Attributes:
        dual: (n, dim, gdim) 𝐚^α; n: (n, gdim) unit normal; r: (n, gdim) 𝐱 − 𝐲.
    """

    dual: Array
    n: Array
    r: Array

    @classmethod
    def of(cls, a: Array, normal: Array, r: Array) -> Lever:
        """From tangents, a normal of any length, and the distance."""
        return cls(dual(a), normal / np.sqrt(dot(normal, normal))[:, None], r)

    @property
    def along(self) -> Array:
        """(n, dim) 𝐚^α·𝐫."""
        return np.asarray((self.dual @ self.r[:, :, None])[:, :, 0])

    @property
    def height(self) -> Array:
        """(n,) 𝐧·𝐫."""
        return dot(self.n, self.r)

    def carry(self, Δa: Array) -> Array:
        """(n, gdim) 𝐀^α Δ𝐚_α: how 𝐫 would change with the contactor's facet; Δa (n, dim, gdim)."""
        tilt, moved = Δa @ self.n[:, :, None], (self.along[:, None] @ Δa)[:, 0]
        return np.asarray(moved - self.height[:, None] * (np.swapaxes(tilt, 1, 2) @ self.dual)[:, 0])

    def carry_map(self, δa: Array) -> Array:
        """(n, gdim, z) 𝐀^α δ𝐚_α of maps δ𝐚_α (dim, gdim, z), or (n, dim, gdim, z)."""
        δa = np.broadcast_to(δa, (len(self.r), *δa.shape[-3:]))
        tilt, moved = np.einsum("ni,naiz->naz", self.n, δa), np.einsum("na,naiz->niz", self.along, δa)
        return np.asarray(moved - self.height[:, None, None] * np.einsum("naz,nai->niz", tilt, self.dual))

    def transposed(self, F: Array) -> Array:
        """(n, dim, gdim) (𝐀^α)ᵀ 𝐅, the forces on the tangents."""
        lifted = (self.dual @ F[:, :, None]) * self.height[:, None, None]
        return np.asarray(self.along[:, :, None] * F[:, None] - lifted * self.n[:, None])

    def transposed_map(self, δF: Array) -> Array:
        """(n, dim, gdim, z) (𝐀^α)ᵀ δ𝐅 of a map δ𝐅 (n, gdim, z)."""
        lifted = (self.dual @ δF) * self.height[:, None, None]
        return np.asarray(self.along[:, :, None, None] * δF[:, None] - lifted[:, :, None] * self.n[:, None, :, None])

    def vary(self, δa: Array, δr: Array) -> Parts:
        """δ𝐚^α (n, dim, gdim, z), δ𝐧 (n, gdim, z), δ(𝐚^α·𝐫) (n, dim, z) and δ(𝐧·𝐫) (n, z), of δ𝐚_α (dim, gdim, z) and
        δ𝐫 (gdim, z)."""
        tilt = np.einsum("ni,biz->nbz", self.n, δa)  # 𝐧·δ𝐚_β
        shear = np.einsum("nai,biz->nabz", self.dual, δa)  # 𝐚^α·δ𝐚_β
        metric = self.dual @ np.swapaxes(self.dual, 1, 2)
        δdual = -np.einsum("nabz,nbi->naiz", shear, self.dual) + np.einsum("nab,nbz,ni->naiz", metric, tilt, self.n)
        δn = -np.einsum("nbz,nbi->niz", tilt, self.dual)
        δalong = np.einsum("naiz,ni->naz", δdual, self.r) + self.dual @ δr
        return δdual, δn, δalong, np.einsum("niz,ni->nz", δn, self.r) + self.n @ δr

    def vary_carry(self, Δa: Array, varied: Parts) -> Array:
        """(n, gdim, z) δ𝐀^α Δ𝐚_α, of what :meth:`vary` gives."""
        δdual, δn, δalong, δheight = varied
        lift = (Δa @ self.n[:, :, None])[:, :, 0]  # 𝐧·Δ𝐚_α
        turned = np.einsum("na,nai->ni", lift, self.dual)
        δlift = np.einsum("nai,niz->naz", Δa, δn)
        δturned = np.einsum("na,naiz->niz", lift, δdual) + np.einsum("naz,nai->niz", δlift, self.dual)
        moved = np.einsum("naz,nai->niz", δalong, Δa)
        return np.asarray(moved - turned[:, :, None] * δheight[:, None] - self.height[:, None, None] * δturned)

    def vary_transposed(self, F: Array, varied: Parts) -> Array:
        """(n, dim, gdim, z) (δ𝐀^α)ᵀ 𝐅, of what :meth:`vary` gives."""
        δdual, δn, δalong, δheight = varied
        lifted = (self.dual @ F[:, :, None])[:, :, 0]  # 𝐚^α·𝐅
        δlifted = np.einsum("naiz,ni->naz", δdual, F)
        height = self.height[:, None, None]
        factor = lifted[:, :, None] * δheight[:, None] + height * δlifted
        moved = δalong[:, :, None] * F[:, None, :, None] - factor[:, :, None] * self.n[:, None, :, None]
        return np.asarray(moved - (height * lifted[:, :, None])[..., None] * δn[:, None])
