"""Wall time per part of a simulation, for summary.json and for the table in the README."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

__all__ = ["Stopwatch"]


class Stopwatch:
    """Adds up time (s) under names; a part measured inside another is taken out of the outer one.

    Attributes:
        clock: what tells the time, wall time unless set otherwise.
    """

    def __init__(self) -> None:
        self.clock: Callable[[], float] = perf_counter
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._inner = [0.0]

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        start = self.clock()
        self._inner.append(0.0)
        try:
            yield
        finally:
            total = self.clock() - start
            self.seconds[part] += total - self._inner.pop()
            self._inner[-1] += total

    def add(self, part: str, seconds: float) -> None:
        """Count a time measured elsewhere, inside the part that is running."""
        self.seconds[part] += seconds
        self._inner[-1] += seconds
