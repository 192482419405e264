"""The arithmetic over which steps are written, and its readings on numbers.

A step is a Python function over an `Arithmetic`: on numpy arrays it runs in double precision for
analysis and in single precision as the model of the C, and `dqforge.reports.steps` writes the C
from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Floats, Reals, park, park_inverse

Pair = tuple[Reals, Reals]  # The alpha and beta (or d and q) components of a vector.


class AlphaBeta(NamedTuple):
    """A vector in stationary coordinates."""

    alpha: Reals
    beta: Reals


class Dq(NamedTuple):
    """A vector in rotor coordinates."""

    d: Reals
    q: Reals


class Rotation(NamedTuple):
    """A turn."""

    cosine: Reals
    sine: Reals


@dataclass(frozen=True, slots=True)
class Member:
    """What a member of a record is: a phrase, and its SI unit (empty of a pure number)."""

    meaning: str
    unit: str = ""

    @property
    def text(self) -> str:
        """Phrase and unit for a comment."""
        return f"{self.meaning}, {self.unit}" if self.unit else self.meaning


_Gains = TypeVar("_Gains")
_T = TypeVar("_T")
_P = ParamSpec("_P")


@dataclass(frozen=True, slots=True)
class Arithmetic(Floats):
    """What steps are written over; the operators + - * / and comparisons are those of the numbers.

    ``wrap`` brings angles to -pi to pi, ``rotation`` gives cosine and sine, ``number`` is the type
    of all values. Comparisons are false for not-a-number.
    """

    wrap: Callable[[Reals], Reals]
    rotation: Callable[[Reals], Pair]

    def let(self, name: str, value: _T, meaning: str = "") -> _T:  # noqa: ARG002
        """Give a value its name in the firmware.

        Whatever is used twice needs one.

        Args:
            name: Of a local variable.
            value: A number, a vector, a numpy array of numbers, which get a name each, or a tuple
                of a record, which gets a shorter one.
            meaning: What it is, with its unit.
        """
        return value

    def remark(self, text: str) -> None:
        """Say what comes next."""

    def call(
        self,
        function: Callable[Concatenate[Arithmetic, _P], _T],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _T:
        """Let a function be one of the firmware, too: ``function(self, ...)``.

        Its arguments are numbers, vectors, arrays and records; it returns a number or a vector.
        """
        return function(self, *args, **kwargs)

    def at(self, table: Sequence[Any], place: Any) -> Reals:
        """The number of an array at a place, which counts from 0, or is one place per drive."""
        if isinstance(place, int):
            found: Reals = table[place]
            return found
        values = np.asarray(table)
        if values.ndim == 1:
            return np.asarray(values[place])
        at = np.broadcast_to(place, np.broadcast_shapes(np.shape(place), values.shape[1:]))
        rows = np.take_along_axis(values, at.reshape(-1, values.shape[1]), axis=0)
        return rows.reshape(at.shape)

    def each(
        self,
        name: str,  # noqa: ARG002
        count: int,
        of: Callable[[Any], Reals],
    ) -> tuple[Reals, ...]:
        """The array of ``of(0)``, ``of(1)``, ...: in the firmware a loop that fills it.

        Args:
            name: Of the array.
            count: Of its numbers.
            of: Place -> number; its argument has the name of what counts. Places of arrays are
                products and sums of it and of whole numbers.
        """
        return tuple(of(np.arange(count)[:, None]))

    def summed(
        self,
        name: str,  # noqa: ARG002
        first: Reals | float,
        count: int,
        of: Callable[[Any], Reals],
    ) -> Reals:
        """``first`` and to it ``of(0)``, ``of(1)``, ..., one after the other: a loop as that of
        `each`.
        """
        found: Any = first
        for place in range(count):
            found = found + of(place)
        return np.asarray(found)

    def reached(self, name: str, conditions: Sequence[Any]) -> Any:  # noqa: ARG002
        """How many conditions hold, of which each one implies those before it: a place."""
        return sum(np.asarray(condition).astype(np.intp) for condition in conditions)

    def either(self, condition: Any, then: Callable[[], _T], otherwise: Callable[[], _T]) -> _T:
        """What ``then`` returns where the condition holds, else what ``otherwise`` returns: states
        of an observer, at the end of its step.

        The firmware computes one of them.
        """
        if np.all(condition):
            return then()
        found: _T = self._merged(condition, then(), otherwise())
        return found

    def _merged(self, condition: Any, a: Any, b: Any) -> Any:
        if isinstance(a, tuple):
            parts = [self._merged(condition, x, y) for x, y in zip(a, b, strict=True)]
            return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
        if is_dataclass(a):
            names = [field.name for field in fields(a)]
            parts = [self._merged(condition, getattr(a, n), getattr(b, n)) for n in names]
            return replace(a, **dict(zip(names, parts, strict=True)))  # type: ignore[type-var]
        return self.choose(condition, a, b) if isinstance(a, np.ndarray) else a

    def root(self, a: Reals) -> Reals:
        """Square roots."""
        return np.asarray(np.sqrt(a))

    def full(self, value: Any, like: Reals) -> Reals:
        """A constant for every drive of ``like``."""
        return np.full_like(like, value)

    def park(self, vector: Pair, turn: Pair) -> Dq:
        """Stationary coordinates in a frame turned by (cosine, sine)."""
        return Dq(*park(self, vector, turn))

    def park_inverse(self, vector: Pair, turn: Pair) -> AlphaBeta:
        """Coordinates of a turned frame back."""
        return AlphaBeta(*park_inverse(self, vector, turn))


def _wrap(theta: Reals) -> Reals:
    return np.asarray((theta + np.pi) % (2.0 * np.pi) - np.pi)


def _rotation(theta: Reals) -> Pair:
    return np.cos(theta), np.sin(theta)


EXACT = Arithmetic(np.float64, _wrap, _rotation)  # Double precision.


def cast(gains: _Gains, maths: Arithmetic) -> _Gains:
    """Gains (a dataclass of floats and tuples of floats) as numbers of an arithmetic."""
    assert is_dataclass(gains)
    values: dict[str, Any] = {}
    for field in fields(gains):
        value = getattr(gains, field.name)
        if is_dataclass(value):
            values[field.name] = cast(value, maths)
        elif isinstance(value, tuple):
            values[field.name] = tuple(maths.number(item) for item in value)
        else:
            values[field.name] = maths.number(value)
    return replace(gains, **values)  # type: ignore[type-var]


def at_least(o: Arithmetic, value: Reals, floor: Any) -> Reals:
    """The larger of both; the floor for not-a-number."""
    return o.choose(value > floor, value, floor)


def limited(o: Arithmetic, value: Reals, limit: Any) -> Reals:
    """A value within -limit to limit."""
    return o.choose(value > limit, limit, o.choose(value < -limit, -limit, value))
