"""The table of the suite, and the page with a picture and an error-against-time diagram of each case."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dolfinx_mortar_al.verify.case import Case, Outcome, Row, rows

__all__ = ["table", "write"]

HEAD = (
    "case",
    "quantity",
    "reference",
    "computed",
    "error",
    "tolerance",
    "",
    "order",
    "iterations",
    "rejected",
    "s",
    "source",
)
SMALLEST = 1e-16  # of the diagrams

INTRODUCTION = """\
Cases with known answers, of `dolfinx_mortar_al/verify/`, where each reference is derived or its source named. This page is
written by the suite itself:

    ./run python3 -m dolfinx_mortar_al.verify --report docs

`--quick` runs fewer and coarser meshes, with tolerances that grow with the cells as the error does; it is in the tests.
`--case NAME` runs one case. Tolerances come from the accuracy of the references; the exit status is not 0 if one is missed.
Errors are relative to the reference, or to the size named in the case. The order is that of the last two meshes. Iterations
are Newton's, those of rejected trials included; seconds are wall time on a machine with other work.
"""


def table(lines: Sequence[Row]) -> str:
    """The table in Markdown: one line per quantity, of the finest mesh; iterations, rejected steps and seconds are
    that run's.
    """
    text = ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    for line in lines:
        effort, unit = line.run.effort, f" {line.quantity.unit}" if line.quantity.unit else ""
        text.append(
            f"| {line.case} | {line.quantity.name} | {line.reference:.6g}{unit} | {line.value:.6g} | {line.error:.1e} "
            f"| {line.tolerance:.1e} | {line.verdict} | {'–' if math.isnan(line.order) else f'{line.order:.1f}'} "
            f"| {effort.iterations} | {effort.rejected} | {effort.seconds:.1f} | {line.quantity.source} |"
        )
    return "\n".join(text)


def write(folder: Path, done: Mapping[str, tuple[Case, Outcome]]) -> Path:
    """Write `folder`/verification.md and a picture per case in `folder`/verification; returns the page."""
    pictures = folder / "verification"
    pictures.mkdir(parents=True, exist_ok=True)
    lines = [line for case, outcome in done.values() for line in rows(case, outcome)]
    page = [
        "# Verification",
        "",
        INTRODUCTION,
        table(lines),
        "",
    ]
    for case, outcome in done.values():
        page += [f"## {case.title}", f"`--case {case.name}`. {case.description}", ""]
        _figure(case, outcome, pictures / f"{case.name}.png")
        page += [f"![{case.title}: result and errors against time](verification/{case.name}.png)", ""]
        page += _series(case, outcome)
        page += [f"- {remark}" for remark in outcome.remarks] + [""] * bool(outcome.remarks)
    path = folder / "verification.md"
    path.write_text("\n".join(page))
    return path


def _series(case: Case, outcome: Outcome) -> list[str]:
    """Errors on all meshes."""
    names = [q for q in case.quantities if any(q.name in run.values for run in outcome.runs)]
    text = ["| mesh | unknowns | " + " | ".join(q.name for q in names) + " | iterations | rejected | s |"]
    text.append("|" + "---|" * (len(names) + 5))
    for run in outcome.runs:
        errors = [f"{q.error(*run.values[q.name]):.1e}" if q.name in run.values else "–" for q in names]
        effort = run.effort
        text.append(
            f"| {run.mesh} | {run.unknowns} | "
            + " | ".join(errors)
            + f" | {effort.iterations} | {effort.rejected} | {effort.seconds:.1f} |"
        )
    return [*text, ""]


def _figure(case: Case, outcome: Outcome, path: Path) -> None:
    """The picture of the finest run, and errors against time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    draw = outcome.runs[-1].draw
    if draw is not None:
        draw(axes[0])
    _errors(axes[1], case, outcome)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def _errors(axes: Any, case: Case, outcome: Outcome) -> None:
    for k, quantity in enumerate(case.quantities):
        having = [run for run in outcome.runs if quantity.name in run.values]
        errors = [max(quantity.error(*run.values[quantity.name]), SMALLEST) for run in having]
        style = "o-" if k < 10 else "s--"
        axes.loglog([run.effort.seconds for run in having], errors, style, markersize=3, label=quantity.name)
    axes.set(xlabel="seconds", ylabel="error")
    axes.legend(fontsize=6)
