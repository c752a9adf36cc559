"""What a case of the suite is: quantities with references and tolerances, and its results on a series of meshes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

__all__ = ["CASES", "Case", "Effort", "Outcome", "Quantity", "Row", "Run", "case", "is_root", "rows"]

ROUND_OFF = 1e-9  # relative errors below this have no order of convergence


@dataclass(frozen=True)
class Quantity:
    """What is compared.

    Args:
        name: of the quantity.
        source: where the reference comes from, and what its own accuracy is.
        tolerance: of the error, as a share of `scale`; from the accuracy of the reference, not from the result. On the
            coarser meshes of --quick it is larger by `order`.
        unit: of value and reference.
        scale: what errors are relative to, default the reference's size.
        order: of the error in the size of the cells: 1 next to the edge of contact, 0 where it is not the mesh that errs.
    """

    name: str
    source: str
    tolerance: float
    unit: str = ""
    scale: float | None = None
    order: float = 1.0

    def error(self, value: float, reference: float) -> float:
        """|value − reference| over the scale."""
        scale = abs(reference) if self.scale is None else self.scale
        return abs(value - reference) / scale if math.isfinite(value) else math.inf


@dataclass
class Effort:
    """What a run cost: Newton iterations (rejected trials included), rejected trials, wall time (s)."""

    iterations: int = 0
    rejected: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class Run:
    """A case on one mesh.

    Args:
        mesh: what it is called in tables.
        size: of the cells, in any unit: orders of convergence come from ratios.
        values: (computed, reference) by the name of the quantity; a run need not have all.
        effort: what it cost.
        unknowns: displacements.
        draw: draws the picture of this run on Matplotlib's axes.
    """

    mesh: str
    size: float
    values: Mapping[str, tuple[float, float]]
    effort: Effort
    unknowns: int
    draw: Callable[[Any], None] | None = None


@dataclass(frozen=True)
class Outcome:
    """What comes of a case: its runs from coarse to fine, remarks on what they show (Markdown), and for how many
    times coarser a mesh than that of the full suite its tolerances allow.
    """

    runs: Sequence[Run]
    remarks: Sequence[str] = ()
    coarse: float = 1.0


@dataclass(frozen=True)
class Case:
    """A case: its name on the command line, title, description (its module's or function's docstring), quantities, what
    runs it (on few, coarse meshes with `quick`), and whether it takes part in --quick."""

    name: str
    title: str
    description: str
    quantities: Sequence[Quantity]
    run: Callable[[bool], Outcome]
    quick: bool


@dataclass(frozen=True)
class Row:
    """A line of the table: a quantity on the finest mesh that has it."""

    case: str
    quantity: Quantity
    value: float
    reference: float
    error: float
    tolerance: float
    order: float
    run: Run

    @property
    def hit(self) -> bool:
        """Whether the error is within its tolerance."""
        return self.error <= self.tolerance

    @property
    def verdict(self) -> str:
        return "ok" if self.hit else "MISS"


CASES: dict[str, Case] = {}


def case(
    name: str, title: str, quantities: Sequence[Quantity], quick: bool = True
) -> Callable[[Callable[[bool], Outcome]], Callable[[bool], Outcome]]:
    """Register a function of `quick` as a case; its docstring is the description on the page."""

    def register(run: Callable[[bool], Outcome]) -> Callable[[bool], Outcome]:
        lines = [line.strip() for line in (run.__doc__ or "").strip().splitlines()]
        CASES[name] = Case(name, title, "\n".join(lines), quantities, run, quick)
        return run

    return register


def rows(done: Case, outcome: Outcome) -> list[Row]:
    """The lines of a case in the table."""
    result = []
    for quantity in done.quantities:
        having = [run for run in outcome.runs if quantity.name in run.values]
        if not having:
            raise LookupError(f"{done.name}: no run has the quantity {quantity.name!r}")
        errors = [quantity.error(*run.values[quantity.name]) for run in having]
        order = math.nan
        if len(having) > 1 and quantity.order > 0 and min(errors[-2:]) > ROUND_OFF:
            order = math.log(errors[-2] / errors[-1]) / math.log(having[-2].size / having[-1].size)
        value, reference = having[-1].values[quantity.name]
        tolerance = quantity.tolerance * outcome.coarse**quantity.order
        result.append(Row(done.name, quantity, value, reference, errors[-1], tolerance, order, having[-1]))
    return result


def is_root() -> bool:
    """Whether this rank prints and draws."""
    return bool(MPI.COMM_WORLD.rank == 0)
