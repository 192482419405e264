"""Angle functions, the numbers of Clarke and Park transforms, and duty cycles in integers,
as the emitted C has them.

Every function takes its operations from an `Arithmetic`: numbers make it the model, ranges its
proof. Codes of ``width`` bits are per unit, 2^(width - 1) of them are full scale; those of an angle
are a share of a turn, 2^width of them.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, ClassVar, Generic

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.modulation.zero_sequence import zero_sequence_of
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, Triple, clarke, clarke_inverse
from dqforge.optimizer.fixed_control.arithmetic import (
    Arithmetic,
    Integers,
    larger,
    magnitude,
    rounded,
)
from dqforge.optimizer.fixed_control.shortening import reciprocal

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


def _eighth(o: Arithmetic[N, Any], width: int, x: N) -> Pair[N]:
    """Cosine and sine of an angle from the nearest quarter turn, as codes of 2^(width - 1)."""
    made = turn_steps(width)
    square = rounded(o, "turn: u^2", o.product("turn: u^2", x, x), made.square)
    found = []
    for coefficients, addends in (
        (made.cosine, made.cosine_addends),
        (made.sine, made.addends),
    ):
        value = o.const(coefficients[0])
        for addend in addends:
            product = o.product("turn: product", value, square)
            value = o.shifted(o.total("turn: sum", product, o.const(addend)), width - 1)
        found.append(value)
    fall = rounded(o, "turn: fall", o.product("turn: fall", found[0], square), width)
    cosine = o.total("turn: cosine", o.const(2 ** (width - 1)), fall)
    cosine = o.clamp(cosine, 0, 2 ** (width - 1) - 1)  # 1 has no code; it is never below 0
    sine = rounded(o, "turn: sine", o.product("turn: sine", found[1], x), width - 2)
    return Pair(cosine, sine)


def _quarter(o: Arithmetic[N, Any], width: int, x: N) -> Pair[N]:
    """Cosine and sine of an angle within a quarter turn from the table.

    The cosine is the sine of what is left of the quarter, to the last bit: it rounds the other way.
    """
    table = turn_steps(width).table
    bits = width - 2 - int(math.log2(_INTERVALS))
    index, share, half = o.shifted(x, bits), o.wrapped(x, bits), 1 << (bits - 1)
    back = o.total("turn: index", o.const(_INTERVALS - 1), o.negative(index))
    low, high = o.entry(table, index), o.entry(table[1:], index)
    rise = o.product("turn: rise", o.total("turn: rise", high, o.negative(low)), share)
    rise = o.shifted(o.total("turn: rise", rise, o.const(half)), bits)
    below, above = o.entry(table, back), o.entry(table[1:], back)
    fall = o.product("turn: fall", o.total("turn: fall", above, o.negative(below)), share)
    fall = o.shifted(o.total("turn: fall", fall, o.const(half - 1)), bits)
    cosine = o.total("turn: cosine", above, o.negative(fall))
    sine = o.total("turn: sine", low, rise)
    # Change no number: between two entries of the table.
    top = 2 ** (width - 1) - 1
    return Pair(o.clamp(cosine, 0, top), o.clamp(sine, 0, top))


def rotation(o: Arithmetic[N, Any], width: int, angle: N) -> Pair[N]:
    """Cosine and sine of an angle, 0 to 2^width - 1 codes."""
    quarter = o.const(2 ** (width - 2))
    if turn_steps(width).table:
        moved = angle
        cosine, sine = _quarter(o, width, o.wrapped(angle, width - 2))
    else:
        half_way = o.const(2 ** (width - 3))
        moved = o.wrapped(o.total("turn: quarter", angle, half_way), width)
        x = o.total("turn: from the quarter", o.wrapped(moved, width - 2), o.negative(half_way))
        cosine, sine = _eighth(o, width, x)
    odd = o.at_least(o.wrapped(moved, width - 1), quarter)
    turned = Pair(o.choose(odd, o.negative(sine), cosine), o.choose(odd, cosine, sine))
    back = o.at_least(moved, o.const(2 ** (width - 1)))
    return Pair(*(o.choose(back, o.negative(value), value) for value in turned))


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
        return self.saturated(rounded(self.o, name, a, self.bits))

    def saturated(self, a: N) -> N:
        """The code nearest to a."""
        return self.o.clamp(a, -full_scale(self.width) - 1, full_scale(self.width))

    def ratio(self, name: str, a: N, b: N) -> N:
        """Quotient towards zero of a product by a code that is not negative, saturated."""
        return self.saturated(self.o.quotient(name, a, larger(self.o, b, self.o.const(1))))

    def at_least(self, a: N, b: N) -> Any:
        """Condition that a >= b."""
        return self.o.at_least(a, b)

    def choose(self, condition: Any, a: N, b: N) -> N:
        """Number a where the condition holds, else b."""
        return self.o.choose(condition, a, b)


@dataclass(frozen=True, slots=True)
class WideCodes(Codes[N]):
    """Codes that keep what is beyond full scale."""

    def saturated(self, a: N) -> N:
        """As it is."""
        return a


def duties(
    o: Arithmetic[N, Any],
    width: int,
    modulation: ModulationName,
    scale: int,
    vector: Pair[N],
    v_dc: N,
    i: Triple[N],
) -> Triple[N]:
    """Duty cycles, 0 to 2^(width - 1), for a voltage vector and the dc link,
    whose full scale is 2^scale times larger.

    The vector is divided by the dc link (to nearest) and saturated at it;
    ``v_dc`` must be positive.
    """
    codes, one = Codes(o, width), 2 ** (width - 1)
    share = shares(o, width, scale, vector, v_dc)
    saturating = MODULATORS[modulation].kind == "third-harmonic"
    phase = clarke_inverse(codes if saturating else WideCodes(o, width), share)
    turn = None
    if MODULATORS[modulation].compared == "load angle":
        turn = integer_load_turn(o, width, vector, clarke(codes, i))
    seen = None if turn is None else share
    zero = zero_sequence_of(codes, modulation, phase, i, o.const(one), seen, turn)
    return Triple(*(o.clamp(o.total("duties: sum", value, zero), 0, one) for value in phase))


def shares(o: Arithmetic[N, Any], width: int, scale: int, vector: Pair[N], v_dc: N) -> Pair[N]:
    """A vector over the dc link, whose full scale is 2^scale times larger, to nearest and
    saturated.
    """
    codes, top = Codes(o, width), full_scale(width)
    m, doubled = o.normalised(o.clamp(v_dc, 1, top), 1 << (width - 2), 1)
    inverse = reciprocal(o, width, m)
    places = o.total("duties: places", o.const(width - 2 + scale), o.negative(doubled))
    alpha, beta = (
        codes.saturated(
            o.rounded_by("duties: v / v_dc", o.product("duties: v", x, inverse), places)
        )
        for x in vector
    )
    return Pair(alpha, beta)


def integer_load_turn(
    o: Arithmetic[N, Any], width: int, voltage: Pair[N], current: Pair[N]
) -> Pair[N]:
    """As `load_turn`, but for a common factor: the longer of both is at least half of full scale.

    No angle where voltage times current is below that.
    """
    top, name = full_scale(width), "load angle"

    def half(a: N, b: N) -> N:
        return o.shifted(o.product(name, a, b), 1)

    along = o.total(name, half(voltage.x, current.x), half(voltage.y, current.y))
    across = o.total(name, half(voltage.y, current.x), o.negative(half(voltage.x, current.y)))
    across = o.choose(o.at_least(along, o.const(0)), across, o.negative(across))
    along = magnitude(o, along)
    size = larger(o, magnitude(o, across), along)
    known = o.at_least(size, o.const(1 << (width - 2)))
    places = o.halvings(name, size, top - 1)
    # Change no number: a range does not know that the larger of both is a code now.
    along = o.clamp(o.rounded_by(name, along, places), 0, top)
    across = o.clamp(o.rounded_by(name, across, places), -top, top)
    part = o.product(name, along, o.const(round(2 ** (width - 1) / math.sqrt(3.0))))
    most = rounded(o, name, part, width - 1)
    one = 2 ** (width - 1)
    side, end = o.const(round(one * math.sqrt(0.75))), o.const(one >> 1)
    ahead = o.at_least(across, o.total(name, most, o.const(1)))
    behind = o.at_least(o.negative(across), o.total(name, most, o.const(1)))
    cosine = o.choose(ahead, side, o.choose(behind, side, along))
    sine = o.choose(ahead, end, o.choose(behind, o.negative(end), across))
    return Pair(o.choose(known, cosine, o.const(top)), o.choose(known, sine, o.const(0)))
