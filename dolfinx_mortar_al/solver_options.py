"""PETSc's options of a solver: the user's, and defaults of ours beside them.

PETSc's data base is one for the program. Defaults are in it during solves only: another solver of the same prefix does not
take them for the user's, and PETSc does not complain at its end of options that the user has never set.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Mapping
from types import TracebackType

from petsc4py import PETSc

from dolfinx_mortar_al.monitors import warn

__all__ = ["SolverOptions"]

Option = str | float


class SolverOptions:
    """The options of a prefix. Use it as a context around what reads them.

    Args:
        prefix: without a dash, such as ``contact_``; the user's options are read from the command line, too.

    Raises:
        ValueError: if it is no text, or has one.
    """

    def __init__(self, prefix: str) -> None:
        if not isinstance(prefix, str) or prefix.startswith("-"):
            raise ValueError(f"prefix = {prefix!r}: of PETSc's options without their dash, such as contact_")
        self.prefix = prefix
        self._defaults: dict[str, Option] = {}
        self._set: list[str] = []  # those that are in PETSc's data base
        self._depth = 0  # of contexts
        self._said = False
        _read_command_line(prefix)

    def default(self, part: str, values: Mapping[str, Option]) -> None:
        """What options, called `part` and their names, are unless the user has set them."""
        self._defaults |= {part + name: value for name, value in values.items()}
        if self._depth:
            self._put_in()

    def __enter__(self) -> SolverOptions:
        self._depth += 1
        self._put_in()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._depth -= 1
        if not self._depth:
            for name in self._set:
                PETSc.Options(self.prefix).delValue(name)
            self._set = []

    def _put_in(self) -> None:
        options = PETSc.Options(self.prefix)
        for name, value in self._defaults.items():
            if name in self._set:
                options[name] = value
            elif not options.hasName(name):
                options[name] = value
                self._set.append(name)

    def say_unread(self, later: tuple[str, ...], rank: int) -> None:
        """Once a solve is done and the context left, warn once on rank 0 of options of the user that nothing has read, but
        for those that begin as one of `later`, which may be yet."""
        if self._said or rank != 0:
            return
        self._said = True
        asked = PETSc.Options(self.prefix).getAll()
        unread = [name for name in asked if not name.startswith(later) and not self._is_read(name)]
        if unread:
            listed = ", ".join(f"-{self.prefix}{name} {asked[name]}".rstrip() for name in unread)
            warn(
                f"PETSc options that no part of this solver reads: {listed}; are they misspelt, or of a solver that is not "
                "in use here?",
            )

    def _is_read(self, name: str) -> bool:
        """Whether PETSc has looked for an option, which petsc4py does not say; also where PETSc's library cannot be asked."""
        read = ctypes.c_int(0)
        try:
            ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, f"{self.prefix}{name}".encode(), ctypes.byref(read))
        except (AttributeError, OSError):
            return True
        return bool(read.value)


def _read_command_line(prefix: str) -> None:
    """Hand PETSc this prefix's options from the command line: DOLFINx starts PETSc without it."""
    mine = []
    for word, following in zip(sys.argv[1:], [*sys.argv[2:], "-"], strict=False):
        if word.startswith(f"-{prefix}"):
            is_value = not following.startswith("-") or following.lstrip("-")[:1].isdigit()
            mine += [word, following] if is_value else [word]
    PETSc.Options().insertString(" ".join(mine))
