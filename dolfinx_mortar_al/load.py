"""Loads: what a march moves along a straight line, and the value that each has reached.

A load is a UFL Constant, a number or a vector; a Function of prescribed values; or a function of one number that sets what
depends on it. Its value, an array of components, stays with it from one march to the next: a Constant and a Function hold
it themselves, that of a function is remembered here. Values are part of a problem's state, so that undoing a step and going
on from a checkpoint bring them back.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from dolfinx_mortar_al.ranks import together
from dolfinx_mortar_al.reductions import any_over, sum_over
from dolfinx_mortar_al.validation import check_callable, check_scalar, number, numbers

__all__ = ["Load", "Loads", "Movable", "pace"]

Array = NDArray[np.float64]

#: what can be a load
Movable = fem.Constant | fem.Function | Callable[[float], None]

MOVED, CALLED = "moved ", "called "  # before the label, in a snapshot
PARALLEL = 1e-12  # one minus the squared cosine between two ways that count as one line


def pace(comm: MPI.Comm, way: Array, last: Array | None) -> float:
    """How much longer `way` is than the `last` one (components,), where it goes on along its line, else 0 (collective)."""
    if last is None:
        return 0.0
    aa, ab, bb = sum_over(comm, np.array([last @ last, last @ way, way @ way]))
    return float(ab / aa) if ab > 0.0 and ab**2 >= (1.0 - PARALLEL) * aa * bb else 0.0


class Load(ABC):
    """A load of a problem.

    Attributes:
        source: the Constant, Function or function.
        label: its kind or name, without a dot; among a problem's loads with a number.
        moved: (components,) by how much the last step has moved it; None if it has not.
        moves_others: whether it is a function, which may set what is another load's.
    """

    source: Any
    label: str
    moved: Array | None = None
    moves_others = False

    @property
    @abstractmethod
    def value(self) -> Array:
        """(components,) a copy of the present value; of a Function those on this rank, ghosts included."""

    @abstractmethod
    def set(self, value: Array) -> None:
        """Let the problem have another value (components,)."""

    @abstractmethod
    def end(self, name: str, to: Any) -> Array:
        """(components,) of the value `to` that a user asks for under the argument `name`.

        Raises:
            ValueError: if it is no value of this load.
        """

    def is_of(self, source: Any) -> bool:
        """Whether this is the load of a Constant, Function or function."""
        return self.source is source

    @property
    def is_number(self) -> bool:
        """Whether the load is one number."""
        return True

    @property
    def number(self) -> float:
        """The value of a load that is one number."""
        return float(self.value[0])

    @number.setter
    def number(self, value: float) -> None:
        self.set(np.array([value]))


class _ConstantLoad(Load):
    """A Constant of any shape, which holds its value itself."""

    def __init__(self, source: fem.Constant) -> None:
        self.source, self.label = source, "constant"

    @property
    def value(self) -> Array:
        return np.array(self.source.value, dtype=np.float64).ravel()

    def set(self, value: Array) -> None:
        self.source.value = value.reshape(self.source.value.shape) if self.source.value.shape else float(value[0])

    @property
    def is_number(self) -> bool:
        return self.source.value.shape == ()

    def end(self, name: str, to: Any) -> Array:
        shape = self.source.value.shape
        if not shape:
            return np.array([number(name, to)])
        result = numbers(to)
        if result.shape != shape or not np.isfinite(result).all():
            raise ValueError(f"{name} = {to}: the load is a Constant of shape {shape}; pass as many finite numbers")
        return result.ravel()


class _FunctionLoad(Load):
    """A Function, such as the values of a Dirichlet condition, which holds its value itself."""

    def __init__(self, source: fem.Function) -> None:
        self.source, self.label = source, "function"

    @property
    def value(self) -> Array:
        return np.array(self.source.x.array, dtype=np.float64)

    def set(self, value: Array) -> None:
        self.source.x.array[:] = value

    @property
    def is_number(self) -> bool:
        return False

    def end(self, name: str, to: Any) -> Array:
        V, aim = self.source.function_space, to
        if not isinstance(to, fem.Function):
            if not callable(to):
                raise ValueError(
                    f"{name} = {to}: the load is a Function; pass a Function of its space, or what interpolate takes"
                )
            aim = fem.Function(V)
            try:
                together(V.mesh.comm, lambda: aim.interpolate(to))
            except (RuntimeError, TypeError, ValueError) as error:
                raise ValueError(
                    f"{name} = {to}: interpolate does not take it ({error}); it is called with X (3, n) and returns "
                    f"({V.dofmap.index_map_bs}, n) values"
                ) from error
            aim.x.scatter_forward()
        elif to.function_space != V:
            raise ValueError(f"{name}: a Function of another space than the load's")
        if any_over(V.mesh.comm, not np.isfinite(aim.x.array).all()):
            said = f"Function {to.name!r}" if isinstance(to, fem.Function) else to
            raise ValueError(f"{name} = {said}: some of its values are not finite; give it finite numbers")
        return np.array(aim.x.array, dtype=np.float64)


class _CalledLoad(Load):
    """A function of one number; 0 before it was called. `called`: such loads that were, the last one at the end."""

    moves_others = True

    def __init__(self, source: Callable[[float], None], called: list[_CalledLoad]) -> None:
        check_callable("load", source, "the load")
        self.source, self._value, self._called = source, 0.0, called
        self.label = str(getattr(source, "__name__", type(source).__name__)).replace(".", "_")

    def is_of(self, source: Any) -> bool:
        return bool(self.source == source)  # a bound method is made anew at each look

    @property
    def value(self) -> Array:
        return np.array([self._value])

    def set(self, value: Array) -> None:
        self.remember(value)
        if self in self._called:
            self._called.remove(self)
        self._called.append(self)
        self.source(self._value)

    def remember(self, value: Array) -> None:
        """Have a value (1,) that what depends on it has already."""
        self._value = float(value[0])

    def end(self, name: str, to: Any) -> Array:
        return np.array([number(name, to)])


class Loads:
    """All loads that marches have moved, in the order in which they came: a member of a problem's state.

    A function may set what another load is, too: a Function that is pressed along and then turned by a function. So where
    values are brought back functions are called in the order in which they were, and Constants and Functions come last; one
    that had not been called is not."""

    def __init__(self) -> None:
        self._loads: dict[str, Load] = {}  # by label, numbered among those of one
        self._count: Counter[str] = Counter()
        self._called: list[_CalledLoad] = []
        self._waiting: dict[str, Array] = {}  # restored before their loads came
        self._due: dict[_CalledLoad, float] = {}  # that have come since and are to be called, in this order

    def of(self, source: Any, name: str = "load") -> Load:
        """The load of a Constant, Function or function; one that is new has the value that a checkpoint had of it, and
        :meth:`settle` is to follow.

        Raises:
            ValueError: if it is none of them.
        """
        known = next((one for one in self._loads.values() if one.is_of(source)), None)
        return self._add(source, name) if known is None else known

    def _add(self, source: Any, name: str) -> Load:
        new: Load
        if isinstance(source, fem.Constant | fem.Function):
            check_scalar(name, source)
        if isinstance(source, fem.Constant):
            new = _ConstantLoad(source)
        elif isinstance(source, fem.Function):
            new = _FunctionLoad(source)
        elif callable(source):
            new = _CalledLoad(source, self._called)
        else:
            raise ValueError(
                f"{name}: {type(source).__name__} is no load; pass a Constant, a Function of prescribed values, or a "
                "function that is called with one number"
            )
        kind, new.label = new.label, f"{new.label}_{self._count[new.label]}"
        self._count[kind] += 1
        self._loads[new.label] = new
        new.moved = self._waiting.pop(MOVED + new.label, None)
        saved, turn = (self._waiting.pop(before + new.label, None) for before in ("", CALLED))
        if saved is not None and saved.shape == new.value.shape:
            if not isinstance(new, _CalledLoad):
                new.set(saved)
            elif turn is not None:
                new.remember(saved)
                self._due[new] = float(turn[0])
        return new

    def settle(self) -> None:
        """Let functions that have come with a value set what depends on it."""
        due, self._due = sorted(self._due, key=self._due.__getitem__), {}
        if due:
            self._set({label: load.value for label, load in self._loads.items()}, due)

    def note(self, load: Load | None, way: Array | None = None) -> None:
        """Note that the last step has moved this load by `way` (components,) and no other; None where it says nothing of the
        next one."""
        for one in self._loads.values():
            one.moved = way if one is load else None

    def snapshot(self) -> dict[str, Array]:
        """The value of each load on this rank, by how much it moved in the last step, and functions' turns."""
        values = {label: load.value for label, load in self._loads.items()}
        moved = {MOVED + label: load.moved for label, load in self._loads.items() if load.moved is not None}
        return values | moved | {CALLED + load.label: np.array([float(k)]) for k, load in enumerate(self._called)}

    def restore(self, saved: dict[str, Array]) -> None:
        """Back to a snapshot; the values of loads that no march has moved yet wait for them."""
        self._waiting |= {
            key: v for key, v in saved.items() if key.removeprefix(MOVED).removeprefix(CALLED) not in self._loads
        }
        for label, load in self._loads.items():
            load.moved = saved.get(MOVED + label)
        known = [one for one in self._loads.values() if isinstance(one, _CalledLoad) and one.label in saved]
        changed = [one for one in known if not np.array_equal(one.value, saved[one.label])]
        turn = {one: float(saved[CALLED + one.label][0]) for one in known if CALLED + one.label in saved}
        called = sorted(turn, key=turn.__getitem__)
        undone = [one for one in changed if one not in turn]  # called since for the first time
        self._set(saved, [*undone, *called] if changed else [])
        self._called[:] = called

    def _set(self, values: dict[str, Array], functions: Sequence[_CalledLoad]) -> None:
        """Call these in turn, then give Constants and Functions their values (components,), by label."""
        for one in functions:
            one.set(values[one.label])
        for label, load in self._loads.items():
            if not isinstance(load, _CalledLoad) and label in values and not np.array_equal(load.value, values[label]):
                load.set(values[label])
