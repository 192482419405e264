"""Clarke and Park transforms and their inverses, written once for every kind of number.

Phases to stationary and to rotor coordinates, amplitude-invariant: a balanced sine of peak 1 is a
vector of length 1. Each function takes its operations from `Numbers`. `Floats` evaluates it on
numpy arrays, in double precision or, in single, as the emitted C does to the last bit; codes of
fixed point (`dqforge.optimizer.fixed_control.transforms.Codes`) make it the model of the
emitted integers and, on ranges, the proof that no word overflows. With them stand the scales that
belong to no machine: rpm, the linear range of a bridge, the delay of a voltage.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass

N = TypeVar("N")
C = TypeVar("C")
_T = TypeVar("_T")
_TRUTHS = (bool, np.bool_)
Reals = NDArray[Any]  # float64 or float32, any shape.

# Electrical angles of the axes of the phases a, b, c in rad, shape (3,).
PHASE_AXES = np.array([0.0, 2.0, -2.0]) * (math.pi / 3.0)

# Power-invariant over amplitude-invariant quantity on the alpha, beta, d and q axes; sqrt 3 on the
# 0 axis.
POWER_INVARIANT = math.sqrt(1.5)
_HALF_ROOT_3 = math.sqrt(0.75)

# Sampling periods from a sample to the middle of the period in which its voltage acts: one of
# computation, half of one from the zero-order hold.
CURRENT_DELAY = 1.5
_Value = TypeVar("_Value", float, NDArray[np.float64])


def in_rpm(omega: _Value) -> _Value:
    """A speed in rpm, of ``omega`` in rad/s."""
    return omega * 30.0 / math.pi


def linear_voltage(v_dc: _Value) -> _Value:
    """Largest amplitude in V of the phase voltage without overmodulation: v_dc/sqrt(3)."""
    return v_dc / math.sqrt(3.0)


class Pair(NamedTuple, Generic[N]):
    """Values on two axes: alpha and beta, d and q, or the cosine and sine of a turn."""

    x: N
    y: N


class Triple(NamedTuple, Generic[N]):
    """Values of the phases a, b, c."""

    a: N
    b: N
    c: N


class Numbers(Protocol[N, C]):
    """Operations on numbers N with conditions C.

    ``name`` says what a result is that could overflow.

    In fixed point a product has more bits than its factors until `settled` or `lowered` takes them
    off; floating point has nothing to take off.
    """

    @property
    def halves(self) -> bool:
        """Whether half a number is a number."""

    def product(self, name: str, a: N, b: N) -> N:
        """The product a b."""

    def total(self, name: str, *terms: N) -> N:
        """Sum of terms, added from the left."""

    def negative(self, a: N) -> N:
        """The number -a."""

    def magnitude(self, a: N) -> N:
        """The magnitude of a."""

    def twice(self, name: str, a: N) -> N:
        """The number 2 a."""

    def halved(self, a: N) -> N:
        """Half of a; in fixed point downwards."""

    def part(self, name: str, a: N, share: float) -> N:
        """The product of a number and a constant from 0 to 1."""

    def lowered(self, a: N) -> N:
        """A product with the bits of a factor, downwards."""

    def settled(self, name: str, a: N) -> N:
        """A product or sum of products with the bits of a factor, to nearest
        and saturated at full scale.
        """

    def saturated(self, a: N) -> N:
        """The number nearest to a within full scale."""

    def ratio(self, name: str, a: N, b: N) -> N:
        """Quotient of a product a by a number b that is not negative; 0 where both vanish."""

    def at_least(self, a: N, b: N) -> C:
        """Condition that a >= b."""

    def choose(self, condition: C, a: N, b: N) -> N:
        """Number a where the condition holds, else b."""

    def where_above(
        self, names: Sequence[str], a: N, b: N, x: Sequence[N], y: Sequence[N]
    ) -> list[N]:
        """Numbers x where a > b, else y, under their names in the firmware."""

    def let(self, name: str, value: N, meaning: str = "") -> N:
        """Give what is used twice its name in the firmware."""


@dataclass(frozen=True, slots=True)
class Floats:
    """Arithmetic on numpy arrays of one floating-point type, any shapes that fit together."""

    halves: ClassVar[bool] = True

    number: type[np.floating[Any]]

    def product(self, name: str, a: Reals, b: Reals) -> Reals:  # noqa: ARG002
        """The product a b."""
        return np.asarray(a * b)

    def total(self, name: str, *terms: Reals) -> Reals:  # noqa: ARG002
        """Sum of terms, added from the left."""
        value = terms[0]
        for term in terms[1:]:
            value = value + term
        return np.asarray(value)

    def negative(self, a: Reals) -> Reals:
        """The numbers -a."""
        return np.asarray(-a)

    def magnitude(self, a: Reals) -> Reals:
        """Magnitudes."""
        return np.asarray(np.abs(a))

    def twice(self, name: str, a: Reals) -> Reals:  # noqa: ARG002
        """The numbers 2 a."""
        return np.asarray(self.number(2.0) * a)

    def halved(self, a: Reals) -> Reals:
        """Half of a."""
        return np.asarray(self.number(0.5) * a)

    def part(self, name: str, a: Reals, share: float) -> Reals:  # noqa: ARG002
        """The product with a constant, which is rounded to the type of the numbers."""
        return np.asarray(self.number(share) * a)

    def lowered(self, a: Reals) -> Reals:
        """As it is."""
        return a

    def settled(self, name: str, a: Reals) -> Reals:  # noqa: ARG002
        """As it is."""
        return a

    def saturated(self, a: Reals) -> Reals:
        """As it is."""
        return a

    def ratio(self, name: str, a: Reals, b: Reals) -> Reals:  # noqa: ARG002
        """Quotient a / b, 0 where b is not positive."""
        some = b > 0.0
        return np.where(some, a / np.where(some, b, self.number(1.0)), self.number(0.0))

    def at_least(self, a: Reals, b: Reals) -> Any:
        """Whether a >= b; false for not-a-number."""
        return a >= b

    def choose(self, condition: Any, a: Any, b: Any) -> Reals:
        """Numbers a where the condition holds, else b; Python floats get the type of numbers."""
        if isinstance(condition, _TRUTHS):
            one: Any = a if condition else b
            one = self.number(one) if type(one) is float else one
            return cast("Reals", one)
        a, b = (self.number(x) if isinstance(x, float) else x for x in (a, b))
        found: Reals = np.where(condition, a, b)
        return found

    def where_above(
        self,
        names: Sequence[str],  # noqa: ARG002
        a: Reals,
        b: Reals,
        x: Sequence[Reals],
        y: Sequence[Reals],
    ) -> list[Reals]:
        """Numbers x where a > b, else y."""
        return [self.choose(a > b, one, other) for one, other in zip(x, y, strict=True)]

    def let(self, name: str, value: _T, meaning: str = "") -> _T:  # noqa: ARG002
        """As it is."""
        return value

    def cases(
        self,
        name: str | tuple[str, ...],  # noqa: ARG002
        *branches: tuple[Any, Callable[[], _T]],
        otherwise: Callable[[], _T],
        changing: Sequence[Any] = (),
    ) -> _T:
        """What the first branch returns whose condition holds, else what ``otherwise`` returns.

        The firmware computes one of them; here all are computed that hold for one of the drives, so
        that what lies outside of a condition may be no number.

        Args:
            name: Of the local variable that takes the number or vector, or of one for each; where
                it is empty, nothing is returned.
            branches: Conditions, and what is computed where they hold.
            otherwise: What is computed where none holds.
            changing: Records of a state whose members the branches set.
        """
        for place, (condition, branch) in enumerate(branches):
            if not isinstance(condition, _TRUTHS):
                branches = branches[place:]
                break
            if condition:
                return branch()
        else:
            return otherwise()
        places = [place for record in changing for place in leaves(record)]
        before = [getattr(record, member) for record, member in places]

        def ran(branch: Callable[[], _T]) -> tuple[_T, list[Any]]:
            value = branch()
            after = [getattr(record, member) for record, member in places]
            put(before)
            return value, after

        def put(values: list[Any]) -> None:
            for (record, member), value in zip(places, values, strict=True):
                setattr(record, member, value)

        with np.errstate(all="ignore"):
            *above, (condition, branch) = _met(branches, otherwise)
            value, after = ran(branch)
            found: _T = self._merged(condition, value, value)
            kept = [
                x if x is y else self._merged(condition, x, x)
                for x, y in zip(after, before, strict=True)
            ]
            for condition, branch in reversed(above):
                value, after = ran(branch)
                found = self._merged(condition, value, found)
                kept = [
                    y if x is y else self._merged(condition, x, y)
                    for x, y in zip(after, kept, strict=True)
                ]
        put(kept)
        return found

    def _merged(self, condition: Any, a: Any, b: Any) -> Any:
        if a is b and isinstance(a, np.ndarray) and a.shape == np.shape(condition):
            return a
        if isinstance(a, tuple):
            parts = [self._merged(condition, x, y) for x, y in zip(a, b, strict=True)]
            return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
        if is_dataclass(a):
            names = [field.name for field in fields(a)]
            parts = [self._merged(condition, getattr(a, n), getattr(b, n)) for n in names]
            return replace(a, **dict(zip(names, parts, strict=True)))  # type: ignore[type-var]
        numbers = isinstance(a, int | float | np.ndarray | np.generic) and not isinstance(a, bool)
        return self.choose(condition, a, b) if numbers else a

    def root(self, a: Reals) -> Reals:
        """Square roots."""
        return np.asarray(np.sqrt(a))

    def full(self, value: Any, like: Reals) -> Reals:
        """A constant for every drive of ``like``."""
        if isinstance(like, np.generic):
            return cast("Reals", self.number(value))
        return np.asarray(np.full_like(like, value))


def leaves(record: Any) -> Iterator[tuple[Any, str]]:
    """Members of a state that are no records, those of records in it as well; None are left out.

    Args:
        record: A dataclass whose members can be set.
    """
    for member in fields(record):
        value = getattr(record, member.name)
        if is_dataclass(value):
            yield from leaves(value)
        elif value is not None:
            yield record, member.name


def _met(
    branches: Sequence[tuple[Any, Callable[[], _T]]], otherwise: Callable[[], _T]
) -> list[tuple[Any, Callable[[], _T]]]:
    """The branches that one of the drives takes, in their order: the last one takes the rest."""
    left: Any = True
    found = []
    for condition, branch in branches:
        if not isinstance(condition, bool | np.bool_ | np.ndarray):
            return [*branches, (branches[0][0], otherwise)]
        taken = np.any(left & condition)
        left = left & np.logical_not(condition)  # of the shape of all drives, taken or not
        if taken:
            found.append((condition, branch))
            if not np.any(left):
                return found
    return [*found, (left, otherwise)]


DOUBLES = Floats(np.float64)  # Double precision.


def clarke(o: Numbers[N, Any], phase: Triple[N]) -> Pair[N]:
    """Phases to stationary coordinates; a part common to all phases falls out.

    ::

        alpha = (2 a - b - c) / 3      beta = (b - c) / sqrt 3

    Args:
        o: The arithmetic.
        phase: Values of the phases in any unit, any shape.
    """
    if o.halves:
        rest = o.part("clarke: (b + c)/2", o.total("clarke: b + c", phase.b, phase.c), 0.5)
        sums, share = o.total("clarke: a - (b + c)/2", phase.a, o.negative(rest)), 2.0 / 3.0
    else:  # Of integers the double is exact, the half is not.
        double = o.twice("clarke: 2 a", phase.a)
        sums, share = (
            o.total("clarke: 2 a - b - c", double, o.negative(phase.b), o.negative(phase.c)),
            1.0 / 3.0,
        )
    alpha = o.settled("clarke: alpha", o.part("clarke: alpha", sums, share))
    gap = o.total("clarke: b - c", phase.b, o.negative(phase.c))
    return Pair(alpha, o.settled("clarke: beta", o.part("clarke: beta", gap, 1.0 / math.sqrt(3.0))))


def clarke_inverse(o: Numbers[N, Any], vector: tuple[N, N]) -> Triple[N]:
    """Stationary coordinates to phases whose sum is zero: a = alpha, b and c =
    -alpha/2 +- sqrt(3)/2 beta.

    Args:
        o: The arithmetic.
        vector: Alpha and beta in any unit, any shape.
    """
    half = o.let("half", o.negative(o.part("clarke inverse: alpha/2", vector[0], 0.5)))
    side = o.let("side", o.part("clarke inverse: beta", vector[1], _HALF_ROOT_3))
    b = o.settled("clarke inverse: b", o.total("clarke inverse: b", half, side))
    c = o.settled("clarke inverse: c", o.total("clarke inverse: c", half, o.negative(side)))
    return Triple(o.saturated(vector[0]), b, c)


def park(o: Numbers[N, Any], vector: tuple[N, N], turn: tuple[N, N]) -> Pair[N]:
    """Coordinates turned by an angle: d = alpha cos + beta sin, q = beta cos - alpha sin.

    Args:
        o: The arithmetic.
        vector: Alpha and beta in any unit, any shape.
        turn: Cosine and sine of the angle, any shape that fits.
    """
    cosine, sine = turn
    d = o.total(
        "park: d", o.product("park: d", vector[0], cosine), o.product("park: d", vector[1], sine)
    )
    across = o.product("park: q", vector[0], sine)
    q = o.total("park: q", o.product("park: q", vector[1], cosine), o.negative(across))
    return Pair(o.settled("park: d", d), o.settled("park: q", q))


def park_inverse(o: Numbers[N, Any], vector: tuple[N, N], turn: tuple[N, N]) -> Pair[N]:
    """Turned coordinates back: alpha = d cos - q sin, beta = d sin + q cos.

    Args:
        o: The arithmetic.
        vector: Coordinates d and q in any unit, any shape.
        turn: Cosine and sine of the angle, any shape that fits.
    """
    return park(o, vector, (turn[0], o.negative(turn[1])))


def dq_to_phases(x_d: Reals, x_q: Reals, theta_e: Reals) -> NDArray[np.float64]:
    """Phase values (..., 3) of rotor coordinates, in double precision: what the axis of each
    phase sees of the vector.

    Args:
        x_d, x_q: Amplitude-invariant values on the d and q axes in any unit, shape (...).
        theta_e: Electrical angle of the d axis from phase a in rad, shape (...).
    """
    angle = np.asarray(theta_e)[..., None] - PHASE_AXES
    vector = np.asarray(x_d)[..., None], np.asarray(x_q)[..., None]
    return np.asarray(
        park_inverse(DOUBLES, vector, (np.cos(angle), np.sin(angle))).x, dtype=np.float64
    )


def rotor_axes(theta_e: Reals) -> NDArray[np.float64]:
    """Matrices (..., 2, 3) from phases to rotor coordinates d and q, in double precision.

    Args:
        theta_e: Electrical angle of the d axis from phase a in rad, shape (...).
    """
    angle = np.asarray(theta_e)[..., None] - PHASE_AXES
    seen = park(DOUBLES, (np.ones(3), np.zeros(3)), (np.cos(angle), np.sin(angle)))
    return np.asarray(2.0 / 3.0 * np.stack(seen, axis=-2), dtype=np.float64)


def phases_to_dq(phases: Reals, theta_e: Reals) -> Pair[NDArray[np.float64]]:
    """Rotor coordinates (d, q), each of shape (...), of phase values.

    The inverse of `dq_to_phases`.

    Args:
        phases: Phase values in any unit, shape (..., 3).
        theta_e: Electrical angle of the d axis from phase a in rad, shape (...).
    """
    d, q = np.moveaxis(
        np.sum(rotor_axes(theta_e) * np.asarray(phases)[..., None, :], axis=-1), -1, 0
    )
    return Pair(d, q)


def clarke_matrix(*, power_invariant: bool = False) -> NDArray[np.float64]:
    """Matrix (3, 3) from phases to alpha, beta and 0, in double precision.

    Args:
        power_invariant: Whether the matrix is orthogonal, as in paper 002 (2.13). Else alpha and
            beta have the peak of a phase, 0 is the mean of the phases, and the inverse is not the
            transpose.
    """
    rows = np.stack([*clarke(DOUBLES, Triple(*np.eye(3))), np.full(3, 1.0 / 3.0)])
    return np.asarray(
        rows * np.array([[POWER_INVARIANT], [POWER_INVARIANT], [math.sqrt(3.0)]])
        if power_invariant
        else rows
    )
