"""A program's own options beside those of PETSc."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from itertools import pairwise

__all__ = ["parse", "split"]

_PETSC = re.compile(r"-[A-Za-z]")  # one dash; -1 is a value


def parse(parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """What `parser` makes of the command line, or of `arguments`; what it does not know is left to PETSc if it has one dash,
    such as ``-contact_snes_monitor`` or ``-contact_ksp_rtol 1e-8``.

    Raises:
        SystemExit: on anything else, such as a misspelt ``--quik`` or a value too many, as the parser itself does.
    """
    return split(parser, arguments)[0]


def split(
    parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None
) -> tuple[argparse.Namespace, list[str]]:
    """As :func:`parse`, and the words that are left to PETSc."""
    args, rest = parser.parse_known_args(arguments)
    unknown = [
        word
        for before, word in pairwise(["", *rest])
        if not _PETSC.match(word) and (word.startswith("--") or not _PETSC.match(before))
    ]
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}; --help lists the options, those of PETSc have one dash")
    return args, rest
