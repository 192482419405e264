"""The arithmetic over which steps are written, and its readings on numbers.

A step is a Python function over an `Arithmetic`: on numpy arrays it runs in double precision for
analysis and in single precision as the model of the C, and `dqforge.reports.steps` writes the C
from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import (
    Floats,
    Reals,
    Triple,
    clarke,
    clarke_inverse,
    leaves,
    park,
    park_inverse,
)

if TYPE_CHECKING:
    from dqforge.optimizer.steps.integer_arithmetic import Arithmetic as Codes

Pair = tuple[Reals, Reals]  # The alpha and beta (or d and q) components of a vector.


class Abc(NamedTuple):
    """Phase quantities a, b, c."""

    a: Reals
    b: Reals
    c: Reals


class AlphaBeta(NamedTuple):
    """Stationary coordinates: alpha along phase a, amplitude-invariant (peak of phase)."""

    alpha: Reals
    beta: Reals


class Dq(NamedTuple):
    """Rotor coordinates: d along the magnet flux, amplitude-invariant (peak of phase)."""

    d: Reals
    q: Reals


class Rotation(NamedTuple):
    """Cosine and sine of an angle."""

    cosine: Reals
    sine: Reals


@dataclass(frozen=True, slots=True)
class Member:
    """What a member of a record is: a phrase, and its SI unit (empty of a pure number).

    Args:
        meaning, unit: As said.
        suffix: The unit as it stands behind the name where names tell units, else nothing.
        whole: Whether it is a whole number from 0 on.
        kind: Its type in C where that is neither ``float`` nor, of whole ones, ``uint32_t``; an
            enumeration, whose type has the prefix of all names.
        pointed: Whether the firmware has the address of the record.
    """

    meaning: str
    unit: str = ""
    suffix: str = ""
    whole: bool = False
    kind: str | type[IntEnum] = ""
    pointed: bool = False

    @property
    def text(self) -> str:
        """Phrase and unit for a comment."""
        return f"{self.meaning}, {self.unit}" if self.unit else self.meaning


_Gains = TypeVar("_Gains")
_T = TypeVar("_T")
_N = TypeVar("_N")
_V = TypeVar("_V", bound=tuple[Any, ...])
_P = ParamSpec("_P")


@dataclass(frozen=True, slots=True)
class Arithmetic(Floats):
    """What steps are written over; the operators + - * / and comparisons are those of the numbers.

    ``wrap`` brings angles to -pi to pi, ``rotation`` gives cosine and sine, ``number`` is the type
    of all values. Comparisons are false for not-a-number.
    """

    wrap: Callable[[Reals], Reals]
    rotation: Callable[[Reals], Rotation]

    def let(self, name: str, value: _T, meaning: str = "") -> _T:  # noqa: ARG002
        """Give a value its name in the firmware.

        Whatever is used twice needs one.

        Args:
            name: Of a local variable.
            value: A number, a condition, a vector, a numpy array of numbers, which get a name each,
                or a tuple of a record, which gets a shorter one.
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

    def at(self, table: Sequence[Any], place: Any, *inner: Any) -> Reals:
        """The number (or vector) of an array at a place, which counts from 0, or is one place per
        drive; ``inner`` are the places in arrays of arrays, as columns of rows.
        """
        if inner:
            return np.asarray(np.asarray(table)[(place, *inner)])
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

    def repeated(
        self,
        state: Any,
        count: Any,
        of: Callable[[Any], None],
        until: Callable[[], Any] | None = None,
    ) -> None:
        """A loop that changes numbers.

        Args:
            state: A record of them, whose members can be set; in the firmware they are local
                variables with the names of the members. None where the loop only changes arrays of
                a state, by `with_item`.
            count: How often at most.
            of: Changes the state; its argument counts from 0 and has the name of what counts.
            until: Whether the loop ends, asked after each time; None where nothing ends it.
        """
        if until is None:
            for number in range(count):
                of(number)
            return
        places = [] if state is None else list(leaves(state))
        going: Any = np.ones((), dtype=np.bool_)
        for number in range(count):
            before = [getattr(record, member) for record, member in places]
            of(number)
            for (record, member), old in zip(places, before, strict=True):
                new = getattr(record, member)
                setattr(record, member, old if new is old else self._merged(going, new, old))
            going = going & ~until()
            if not np.any(going):
                break

    def interval(self, name: str, axis: Sequence[Any], value: Reals) -> Any:  # noqa: ARG002
        """The place of the interval of an ascending axis in which a value lies, or of the one next
        to it.
        """
        return sum((np.asarray(value > inner).astype(np.intp) for inner in axis[1:-1]), start=0)

    def local(self, name: str, record: _T) -> _T:  # noqa: ARG002
        """A record of the function, to which those that it calls give its numbers."""
        return record

    def placed(self, name: str, a: Reals, most: int) -> Any:  # noqa: ARG002
        """Places of an array: what numbers from 0 on are without what is behind the point, at most
        ``most``; any place for others.
        """
        return np.clip(np.asarray(a).astype(np.intp), 0, most)

    def with_item(self, array: tuple[_N, ...], place: Any, value: Any) -> tuple[_N, ...]:
        """An array of the state with another number at a place, which is given back to its member
        at once.
        """
        if np.ndim(place) == 0:
            at = int(place)
            return (*array[:at], value, *array[at + 1 :])
        numbers: Any = array
        chosen: Any = [self.choose(place == n, value, item) for n, item in enumerate(numbers)]
        return tuple(chosen)

    def table(self, name: str, values: Sequence[float]) -> Sequence[Any]:  # noqa: ARG002
        """Constant numbers, for `at`."""
        return np.asarray(values, dtype=self.number)  # type: ignore[return-value]

    def place(self, a: Reals) -> Any:
        """Numbers from 0 on without what is behind the point, as places of arrays."""
        return np.asarray(a).astype(np.int32)

    def constant(self, name: str, value: _T) -> _T:  # noqa: ARG002
        """A whole number that has a name of its own in the firmware: that of a macro or of an
        enumeration, in capitals and without the prefix.
        """
        return value

    def equal(self, a: Any, b: Any) -> Any:
        """Whether two whole numbers are the same."""
        return a == b

    def negated(self, condition: Any) -> Any:
        """That a condition does not hold."""
        return np.logical_not(condition)

    def switch(
        self,
        name: str | tuple[str, ...],
        value: Any,
        branches: Mapping[Any, Callable[[], _T]],
        otherwise: Callable[[], _T],
        changing: Sequence[Any] = (),
    ) -> _T:
        """As `cases`, by what a whole number is.

        Args:
            name, otherwise, changing: As of `cases`.
            value: The number.
            branches: What is computed, by the number; a tuple of keys has one branch.
        """
        found: list[tuple[Any, Callable[[], _T]]] = []
        for key, branch in branches.items():
            keys = key if isinstance(key, tuple) else (key,)
            found += [(value == one, branch) for one in keys]
        return self.cases(name, *found, otherwise=otherwise, changing=changing)

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

    def multiply_add(self, a: Reals | float, b: Reals | float, c: Reals | float) -> Reals:
        """The number a b + c, which a compiler may round once (``-ffp-contract``)."""
        return np.asarray(a * b + c)

    def whole(self, a: Reals) -> Reals:
        """Numbers without what is behind the point, as integers of the firmware (``long``)."""
        return np.asarray(a).astype(np.int32)

    def real(self, a: Reals) -> Reals:
        """Integers as numbers."""
        return np.asarray(a).astype(self.number)

    def differ(self, a: Any, b: Any) -> Any:
        """Whether one of two conditions holds without the other."""
        return a != b

    def is_number(self, a: Reals) -> Any:
        """Whether it is not not-a-number."""
        return a == a  # noqa: PLR0124

    def outside(
        self,
        kind: type[_V],
        name: str,  # noqa: ARG002
        function: Callable[..., Iterable[Any]],
        *args: Any,
        filled: str = "",  # noqa: ARG002
    ) -> _V:
        """A function of the firmware whose text stands elsewhere.

        Args:
            kind: The vector that it makes.
            name: In the firmware.
            function: What it computes, from the arguments to the numbers of the vector.
            args: Numbers and vectors.
            filled: The vector whose members it sets through pointers behind its arguments, empty
                where it returns one.
        """
        return kind(*function(*args))

    def has_bit(self, a: Reals, bit: int) -> Any:
        """Whether integers have a bit, given by its worth."""
        return (a & bit) != 0

    def write_state(self) -> None:
        """Let the firmware write what has changed of its state before what comes next."""

    def masked(self, a: Any, bits: Any) -> Any:
        """Whole numbers from 0 on without the bits that are not among ``bits``."""
        return a & bits

    def converted(self, a: Any, kind: str) -> Any:
        """Whole numbers as those of another type, by its name in numpy; what has no place in it
        loses its high bits.
        """
        return np.asarray(a).astype(kind)[()]

    def clarke(self, x: Abc) -> AlphaBeta:
        """Phases to stationary coordinates, factor 2/3; a part common to all phases falls out."""
        return AlphaBeta(*clarke(self, Triple(*x)))

    def clarke_inverse(self, x: Pair) -> Abc:
        """Stationary coordinates to phases whose sum is zero."""
        return Abc(*clarke_inverse(self, x))

    def park(self, x: Pair, turn: Pair) -> Dq:
        """Stationary coordinates to coordinates turned by an angle."""
        return Dq(*park(self, x, turn))

    def park_inverse(self, x: Pair, turn: Pair) -> AlphaBeta:
        """Coordinates turned by an angle to stationary coordinates."""
        return AlphaBeta(*park_inverse(self, x, turn))


def _wrap(theta: Reals) -> Reals:
    return np.asarray((theta + np.pi) % (2.0 * np.pi) - np.pi)


def _rotation(theta: Reals) -> Rotation:
    return Rotation(np.cos(theta), np.sin(theta))


EXACT = Arithmetic(np.float64, _wrap, _rotation)  # Double precision.


def cast(gains: _Gains, maths: Arithmetic) -> _Gains:
    """Gains (a dataclass of floats, tuples of floats and None) as numbers of an arithmetic."""
    assert is_dataclass(gains)
    values: dict[str, Any] = {}
    for field in fields(gains):
        value = getattr(gains, field.name)
        if is_dataclass(value):
            values[field.name] = cast(value, maths)
        elif isinstance(value, tuple):
            values[field.name] = tuple(maths.number(item) for item in value)
        elif value is not None:
            values[field.name] = maths.number(value)
    return replace(gains, **values)  # type: ignore[type-var]


def at_least(o: Arithmetic, value: Reals, floor: Any) -> Reals:
    """The larger of both; the floor for not-a-number."""
    return o.choose(value > floor, value, floor)


def limited(o: Arithmetic, value: Reals, limit: Any) -> Reals:
    """A value within -limit to limit."""
    return o.choose(value > limit, limit, o.choose(value < -limit, -limit, value))


def where(o: Arithmetic | Codes[Any, Any], condition: Any, change: Any, *changing: Any) -> None:
    """What is done where a condition holds.

    Args:
        condition, change: As of a branch of `Arithmetic.cases`.
        changing: What the change sets.
    """
    o.cases("", (condition, change), otherwise=lambda: None, changing=changing)
