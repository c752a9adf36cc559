"""Monitors: what the user wants watched at the Gauss points, such as tension of a membrane or det 𝐅.

A monitor is a UFL scalar with a lower bound. Where a converged state falls below it the run says so, with the value and the
place, and goes on or stops.
"""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from basix import make_quadrature
from dolfinx import fem
from numpy.typing import NDArray

from dolfinx_mortar_al.compiling import compiled_expression
from dolfinx_mortar_al.materials import Hyperelastic, deformation_gradient
from dolfinx_mortar_al.membrane import NeoHookeanMembrane
from dolfinx_mortar_al.validation import check_law, number

__all__ = [
    "Finding",
    "ModelWarning",
    "Monitor",
    "Reporter",
    "ellipticity",
    "inversion",
    "show_warnings",
    "warn",
    "wrinkling",
]


HERE = os.path.join(os.path.dirname(__file__), "")
AGAIN = 2.0  # times what has been said of a finding: it is said again, as many are shares, of .03 to 1
ROUND_OFF = 1e-9  # strain: of a sheet that lies flat without tension
NAMED = 3  # findings that mean the same


@dataclass(frozen=True)
class Finding:
    """The least value of a monitored quantity, below its bound; where (reference position, m; empty where there is no place);
    what it means."""

    name: str
    value: float
    X: tuple[float, ...]
    meaning: str
    fatal: bool

    @property
    def figure(self) -> str:
        """The value, and where, in words."""
        place = f" at X = ({', '.join(f'{x:.4g}' for x in self.X)})" if self.X else ""
        return f"{self.name} = {self.value:.4g}{place}"

    def __str__(self) -> str:
        return f"{self.figure}: {self.meaning}"


class ModelWarning(UserWarning):
    """A converged state is outside of what the model can show."""


def warn(message: str, category: type[UserWarning] = ModelWarning) -> None:
    """Warn at the line outside of this package that has led here."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(HERE):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def show_warnings() -> None:
    """Let Python print warnings: ffcx hands them to a logger without handlers, where nobody sees them. Where the program has
    set up logging of its own, they go there."""
    loggers = (logging.getLogger("py.warnings"), logging.getLogger())
    handlers = [handler for logger in loggers for handler in logger.handlers]
    if all(isinstance(handler, logging.NullHandler) for handler in handlers):
        logging.captureWarnings(False)


class Reporter:
    """Warns of each monitor's first finding of a run, and of one that has doubled since, on rank 0, of those that mean
    the same at once; the steps have them all."""

    def __init__(self, rank: int) -> None:
        self._rank, self._reported = rank, {}  # type: int, dict[str, float]

    def report(self, findings: Iterable[Finding], when: str) -> None:
        """Findings of the step at `when` (a load or time, in words)."""
        new: dict[str, list[str]] = {}  # what they mean: their figures
        for finding in findings:
            said = self._reported.get(finding.name)
            if said is not None and not abs(finding.value) > AGAIN * abs(said):
                continue
            self._reported[finding.name] = finding.value
            new.setdefault(finding.meaning, []).append(finding.figure)
        for meaning, figures in new.items() if self._rank == 0 else ():
            more = f"; {len(figures) - NAMED} more" if len(figures) > NAMED else ""
            warn(f"at {when}: {'; '.join(figures[:NAMED])}{more}: {meaning}")


class Monitor:
    """Watches a UFL scalar of the displacement u at the cells' Gauss points.

    Args:
        name: of the quantity, with its unit.
        quantity: UFL scalar.
        u: the displacement that gives mesh and order.
        bound: the quantity should stay above it.
        meaning: what it means when it does not, in words.
        fatal: whether the run must stop there.

    Raises:
        ValueError: on a quantity that is no scalar, or a bound that is no number.
    """

    def __init__(
        self, name: str, quantity: Any, u: fem.Function, *, bound: float, meaning: str, fatal: bool = False
    ) -> None:
        mesh = u.function_space.mesh
        if not isinstance(quantity, ufl.core.expr.Expr) or quantity.ufl_shape != ():
            raise ValueError(
                f"quantity of the monitor {name!r}: must be a UFL scalar; take a component or an invariant"
            )
        bound = number(f"bound of the monitor {name!r}", bound)
        self.name, self.bound, self.meaning, self.fatal = name, bound, meaning, fatal
        self.comm = mesh.comm
        points = make_quadrature(mesh.basix_cell(), 2 * u.function_space.element.basix_element.degree)[0]
        self._quantity = compiled_expression(quantity, points, mesh)
        self._X = fem.Expression(ufl.SpatialCoordinate(mesh), points, comm=mesh.comm)
        self._mesh = mesh
        self._cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)

    def values(self) -> NDArray[np.float64]:
        """(points,) the quantity at this rank's Gauss points."""
        return np.asarray(self._quantity.eval(self._mesh, self._cells)).ravel()

    def range(self) -> tuple[float, float]:
        """Least and largest value (collective)."""
        v = self.values()
        low = min(self.comm.allgather(float(v.min(initial=np.inf))))
        return low, max(self.comm.allgather(float(v.max(initial=-np.inf))))

    def look(self) -> Finding | None:
        """The least value, if it is below its bound (collective); not a number counts as less than anything."""
        v = self.values()
        v = np.where(np.isnan(v), -np.inf, v)
        k = int(np.argmin(v)) if len(v) else -1
        X = np.asarray(self._X.eval(self._mesh, self._cells)).reshape(len(v), -1)
        mine = (float(v[k]), tuple(map(float, X[k]))) if len(v) else (np.inf, ())
        value, place = min(self.comm.allgather(mine))
        return None if value > self.bound else Finding(self.name, value, place, self.meaning, self.fatal)


def wrinkling(membrane: NeoHookeanMembrane, u: fem.Function) -> Monitor:
    """Least tension of a membrane (N/m): where it is negative a real membrane wrinkles, which the model does not."""
    check_law(u, membrane=True, what="wrinkling")
    meaning = "the membrane is in compression and would wrinkle, which this model does not show"
    N, round_off = membrane.smallest_tension(u), ROUND_OFF * membrane.thickness * membrane.G
    return Monitor("tension (N/m)", ufl.conditional(abs(N) < round_off, round_off, N), u, bound=0.0, meaning=meaning)


def inversion(u: fem.Function) -> Monitor:
    """Least det 𝐅 of a body; at or below zero matter is turned inside out."""
    check_law(u, membrane=False, what="inversion")
    meaning = "a cell is inverted"
    return Monitor("det F", ufl.det(deformation_gradient(u)), u, bound=0.0, meaning=meaning, fatal=True)


def ellipticity(material: Hyperelastic, u: fem.Function, directions: int = 16) -> Monitor:
    """Least eigenvalue (Pa) of the acoustic tensor A_ik = ∂P_iJ/∂F_kL N_J N_L of a plane body over some directions N.

    At or below zero the law has lost ellipticity: no wave goes through, and the deformation localises in a cell's width.

    Raises:
        ValueError: on a displacement that is not plane.
    """
    if len(u) != 2:
        raise ValueError(f"u has {len(u)} components: ellipticity is watched in the plane only")
    check_law(u, membrane=False, what="ellipticity")
    F = ufl.variable(deformation_gradient(u))
    C = ufl.diff(material.first_piola(F), F)  # ∂P_iJ/∂F_kL
    least: Any = None
    for φ in np.arange(directions) * np.pi / directions:
        N = ufl.as_vector([float(np.cos(φ)), float(np.sin(φ))])
        i, J, k, L = ufl.indices(4)
        A = ufl.as_tensor(C[i, J, k, L] * N[J] * N[L], (i, k))
        value = (A[0, 0] + A[1, 1]) / 2 - ufl.sqrt(((A[0, 0] - A[1, 1]) / 2) ** 2 + A[0, 1] ** 2)
        least = value if least is None else ufl.min_value(least, value)
    meaning = f"{type(material).__name__} loses ellipticity"
    return Monitor("acoustic tensor (Pa)", least, u, bound=0.0, meaning=meaning, fatal=True)
