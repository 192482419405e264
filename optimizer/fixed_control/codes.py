"""Codes as numbers of the transforms, and their sine and cosine, in integers.

Every function takes its operations from an `Arithmetic`: numbers make it the model, ranges its
proof, expressions its text in C. Codes of ``width`` bits are per unit, 2^(width - 1) of them are
full scale; those of an angle are a share of a turn, 2^width of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar, Generic

import numpy as np

from dqforge.machines import transforms
from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N
from dqforge.optimizer.steps.code_vectors import Abc, AlphaBeta, Dq, Rotation, Turned
from dqforge.optimizer.steps.integer_arithmetic import (
    Arithmetic,
    Integers,
    larger,
    magnitude,
    rounded,
    saturated,
)

# Those of the package's modulators that there are in integers: all.
FIXED_MODULATORS: tuple[ModulationName, ...] = tuple(MODULATORS)
_TERMS = 5
_INTERVALS = 128  # of the table of a quarter turn
_SEED = 20_261_121


@dataclass(frozen=True, slots=True)
class TurnSteps:
    """Sine and cosine in integers.

    In 16 bits they are straight lines between the entries of ``table``, sines of a quarter turn in
    codes; that takes half of the instructions of a polynomial on the least cores. In 32 bits
    ``table`` is empty: with u = x / 2^(width - 3), x the angle from the nearest quarter turn, they
    are u p(u^2) and 1 + u^2 q(u^2) by Horner's rule; u^2 is a code of 2^(width - 1), after a shift
    by ``square``, ``sine`` and ``cosine`` are the coefficients of p and q in codes of 2^width, the
    highest first.
    """

    width: int
    square: int = 0
    sine: tuple[int, ...] = ()
    cosine: tuple[int, ...] = ()
    table: tuple[int, ...] = ()

    @property
    def addends(self) -> tuple[int, ...]:
        """Coefficients of p but the first at the scale of a product, with half of what the shift
        leaves.
        """
        return tuple(_addend(self.width, c) for c in self.sine[1:])

    @property
    def cosine_addends(self) -> tuple[int, ...]:
        """Those of q in the same way."""
        return tuple(_addend(self.width, c) for c in self.cosine[1:])


def _addend(width: int, coefficient: int) -> int:
    return (coefficient << (width - 1)) + (1 << (width - 2))


def _sine_table(width: int) -> tuple[int, ...]:
    """Sines of a quarter turn, longer by half of what a chord lies below its arc."""
    step = 0.5 * math.pi / _INTERVALS
    one = 2.0 ** (width - 1) * (1.0 + step**2 / 16.0)
    sines = (one * math.sin(k * step) for k in range(_INTERVALS + 1))
    return tuple(min(round(value), 2 ** (width - 1) - 1) for value in sines)


@cache
def turn_steps(width: int) -> TurnSteps:
    """Integers of sine and cosine; the polynomials are least squares at Chebyshev nodes of u^2,
    nearly minimax and within 0.1 codes of the functions.
    """
    if width == 16:
        return TurnSteps(width, table=_sine_table(width))
    nodes = np.cos((np.arange(64) + 0.5) * (math.pi / 64)) * 0.5 + 0.5  # of u^2, 0 to 1
    u = np.sqrt(nodes)
    angle = 0.25 * math.pi * u

    def fitted(values: FloatArray, weight: FloatArray, terms: int) -> tuple[int, ...]:
        # Weighted by what the polynomial is multiplied with: the error of the result counts.
        matrix = np.polynomial.polynomial.polyvander(nodes, terms - 1) * weight[:, None]
        found = np.linalg.lstsq(matrix, values, rcond=None)[0].tolist()
        return tuple(round(c * 2.0**width) for c in reversed(found))

    return TurnSteps(
        width,
        width - 5,
        fitted(np.sin(angle), u, _TERMS),
        fitted(np.cos(angle) - 1.0, nodes, _TERMS - 1),
    )


def _eighth(o: Arithmetic[N, Any], width: int, x: N) -> tuple[N, N]:
    """Cosine and sine of an angle from the nearest quarter turn, as codes of 2^(width - 1)."""
    made = turn_steps(width)
    found_2 = o.call(rounded, "turn: u^2", o.product("turn: u^2", x, x), made.square)
    square = o.let("square", found_2)
    found = []
    for name, coefficients, addends in (
        ("c", made.cosine, made.cosine_addends),
        ("s", made.sine, made.addends),
    ):
        value = o.const(coefficients[0])
        for n, addend in enumerate(addends, 1):
            product = o.product("turn: product", value, square)
            value = o.shifted(o.total("turn: sum", product, o.const(addend)), width - 1)
            value = o.let(f"{name}_{n}", value)
        found.append(value)
    fall = o.call(rounded, "turn: fall", o.product("turn: fall", found[0], square), width)
    cosine = o.let("nearly", o.total("turn: cosine", o.const(2 ** (width - 1)), fall))
    # 1 has no code; it is never below 0.
    cosine = o.known(o.clamp(cosine, None, full_scale(width)), 0, full_scale(width))
    sine = o.call(rounded, "turn: sine", o.product("turn: sine", found[1], x), width - 2)
    return cosine, sine


def _quarter(o: Arithmetic[N, Any], width: int, x: N) -> tuple[N, N]:
    """Cosine and sine of an angle within a quarter turn from the table.

    The cosine is the sine of what is left of the quarter, to the last bit: it rounds the other way.
    """
    table = turn_steps(width).table
    bits = width - 2 - int(math.log2(_INTERVALS))
    index, rest = o.let("index", o.shifted(x, bits)), o.let("rest", o.wrapped(x, bits))
    back = o.total("turn: index", o.const(_INTERVALS - 1), o.negative(index))
    back, half = o.let("back", back), 1 << (bits - 1)

    def between(name: str, at: N, addend: int) -> tuple[N, N, N]:
        low, high = o.neighbours(table, at, ("quarter", name))
        change = o.total(f"turn: {name}", high, o.negative(low))
        moved = o.total(f"turn: {name}", o.product(f"turn: {name}", change, rest), o.const(addend))
        return low, high, o.shifted(moved, bits)

    low, _, rise = between("rising", index, half)
    _, above, fall = between("falling", back, half - 1)
    # A range does not know that both lie between two entries of the table.
    top = full_scale(width)
    cosine = o.known(o.total("turn: cosine", above, o.negative(fall)), 0, top)
    return cosine, o.known(o.total("turn: sine", low, rise), 0, top)


def rotation(o: Arithmetic[N, Any], width: int, theta: Turned[N]) -> Rotation[N]:
    """Cosine and sine of an angle, 0 to 2^width - 1 codes of a turn."""
    if turn_steps(width).table:
        moved = theta
        x = o.let("x", o.wrapped(theta, width - 2), "within its quarter turn")
        cosine, sine = _quarter(o, width, x)
    else:
        half_way = o.const(2 ** (width - 3))
        moved = o.wrapped(o.total("turn: quarter", theta, half_way), width)
        moved = o.let("moved", moved)
        rest = o.let("rest", o.wrapped(moved, width - 2))
        x = o.total("turn: from the quarter", rest, o.negative(half_way))
        cosine, sine = _eighth(o, width, o.let("x", x, "from the nearest quarter turn"))
    sine, cosine = o.let("across", sine), o.let("along", cosine)
    cosine, sine = o.cases(
        ("cosine", "sine"),
        (o.has_bit(moved, 2 ** (width - 2)), lambda: (o.negative(sine), cosine)),
        otherwise=lambda: (cosine, sine),
    )
    back = o.at_least(moved, o.const(2 ** (width - 1)))
    return Rotation(*(o.choose(back, o.negative(value), value) for value in (cosine, sine)))


@cache
def sine_error(width: int) -> float:
    """Largest error of sine and cosine in codes: of all angles in 16 bits,
    of 200,000 in 32 bits.
    """
    angle = (
        np.arange(65_536)
        if width == 16
        else np.random.default_rng(_SEED).integers(0, 2**32, 200_000)
    )
    turn, one = rotation(Integers(), width, angle), 2.0 ** (width - 1)
    exact = angle * (2.0 * math.pi / 2.0**width)
    return float(
        max(
            np.max(np.abs(turn.x - one * np.cos(exact))),
            np.max(np.abs(turn.y - one * np.sin(exact))),
        )
    )


def full_scale(width: int) -> int:
    """The largest code, 2^(width - 1) - 1."""
    return int(2 ** (width - 1) - 1)


@dataclass(frozen=True, slots=True)
class Codes(Generic[N]):
    """Codes of ``width`` bits as the `Numbers` of the transforms: products have twice as many bits,
    ends saturate.
    """

    halves: ClassVar[bool] = False

    o: Arithmetic[N, Any]
    width: int

    @property
    def bits(self) -> int:
        """Bits of a code without its sign."""
        return self.width - 1

    def product(self, name: str, a: N, b: N) -> N:
        """The product a b."""
        return self.o.product(name, a, b)

    def total(self, name: str, *terms: N) -> N:
        """Sum of terms, added from the left."""
        return self.o.total(name, *terms)

    def negative(self, a: N) -> N:
        """The number -a."""
        return self.o.negative(a)

    def magnitude(self, a: N) -> N:
        """The magnitude of a."""
        return magnitude(self.o, a)

    def twice(self, name: str, a: N) -> N:
        """The number 2 a."""
        return self.o.product(name, self.o.const(2), a)

    def halved(self, a: N) -> N:
        """Half of a, downwards."""
        return self.o.shifted(a, 1)

    def part(self, name: str, a: N, share: float) -> N:
        """The product with a constant, which is rounded to a code."""
        return self.o.product(name, a, self.o.const(round(2**self.bits * share)))

    def lowered(self, a: N) -> N:
        """A product with the bits of a code, downwards."""
        return self.o.shifted(a, self.bits)

    def settled(self, name: str, a: N) -> N:
        """A product or sum of products with the bits of a code, to nearest and saturated."""
        return self.saturated(self.o.call(rounded, name, a, self.bits))

    def saturated(self, a: N) -> N:
        """The code nearest to a."""
        return self.o.call(saturated, self.width, a)

    def ratio(self, name: str, a: N, b: N) -> N:
        """Quotient towards zero of a product by a code that is not negative, saturated."""
        return self.saturated(self.o.quotient(name, a, larger(self.o, b, self.o.const(1))))

    def at_least(self, a: N, b: N) -> Any:
        """Condition that a >= b."""
        return self.o.at_least(a, b)

    def choose(self, condition: Any, a: N, b: N) -> N:
        """Number a where the condition holds, else b."""
        return self.o.choose(condition, a, b)

    def where_above(
        self,
        names: Sequence[str],
        a: N,
        b: N,
        x: Sequence[N],
        y: Sequence[N],
    ) -> list[N]:
        """Numbers x where a > b, else y."""
        if len(names) == 1:
            found = self.o.choose(self.o.above(a, b), x[0], y[0])
            return [self.o.let(names[0], found)]
        return list(
            self.o.cases(
                tuple(names), (self.o.above(a, b), lambda: tuple(x)), otherwise=lambda: tuple(y)
            )
        )

    def let(self, name: str, value: N, meaning: str = "") -> N:
        """Give what is used twice its name in the firmware."""
        return self.o.let(name, value, meaning)


@dataclass(frozen=True, slots=True)
class WideCodes(Codes[N]):
    """Codes that keep what is beyond full scale."""

    def saturated(self, a: N) -> N:
        """As it is."""
        return a


# Transforms of the firmware, where their names have no `code_`.


def code_clarke(o: Arithmetic[N, Any], width: int, x: Abc[N]) -> AlphaBeta[N]:
    """Amplitude-invariant; results beyond full scale are saturated."""
    return AlphaBeta(*transforms.clarke(Codes(o, width), x))


def code_clarke_inverse(o: Arithmetic[N, Any], width: int, x: AlphaBeta[N]) -> Abc[N]:
    """Phases whose sum is zero."""
    return Abc(*transforms.clarke_inverse(Codes(o, width), x))


def code_park(o: Arithmetic[N, Any], width: int, x: AlphaBeta[N], turn: Rotation[N]) -> Dq[N]:
    """Stationary coordinates in a turned frame."""
    return Dq(*transforms.park(Codes(o, width), x, turn))


def code_park_inverse(
    o: Arithmetic[N, Any], width: int, x: Dq[N], turn: Rotation[N]
) -> AlphaBeta[N]:
    """Coordinates of a turned frame back."""
    return AlphaBeta(*transforms.park_inverse(Codes(o, width), x, turn))
