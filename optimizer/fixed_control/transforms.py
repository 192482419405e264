"""Angle functions, the numbers of Clarke and Park transforms, and duty cycles in integers,
as the emitted C has them.

Every function takes its operations from an `Arithmetic`: numbers make it the model, ranges its
proof. Codes of ``width`` bits are per unit, 2^(width - 1) of them are full scale; those of an angle
are a share of a turn, 2^width of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Generic

import numpy as np

from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.modulation.zero_sequence import zero_sequence_of
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import N, Pair, Triple, clarke_inverse
from dqforge.optimizer.fixed_control.arithmetic import (
    Arithmetic,
    Integers,
    larger,
    magnitude,
    rounded,
)

FIXED_MODULATORS: tuple[ModulationName, ...] = tuple(
    name for name, modulator in MODULATORS.items() if modulator.in_integers
)

"""Those of the package's modulators that there are in integers; GDPWM needs the angle of the
current and is not among them."""


_SINE_TERMS = {16: 4, 32: 6}
_SEED = 20_261_121


@dataclass(frozen=True, slots=True)
class SineSteps:
    """sin(pi/2 x) = x p(x^2) over a quarter turn, x = code / 2^(width - 2),
    by Horner's rule in integers.

    ``leading`` and every step's (constant, shift) as in `FixedSegment`; ``square`` is the shift
    that makes x^2 a code of 2^(width - 1), ``last`` the shift after the product with x.
    """

    width: int
    leading: int
    steps: tuple[tuple[int, int], ...]
    square: int
    last: int


@cache
def sine_steps(width: int) -> SineSteps:
    """Integers of the sine: a minimax-like fit at Chebyshev nodes, every coefficient at
    the finest scale that fits.

    With 4 terms the polynomial itself is within 1.1e-6 of the sine, with 6 within 2e-11,
    so that rounding decides.
    """
    terms = _SINE_TERMS[width]
    nodes = (
        np.cos((np.arange(8 * terms) + 0.5) * (math.pi / (8 * terms))) * 0.5 + 0.5
    )  # of x^2, 0 to 1
    root = np.sqrt(nodes)
    # Weighted by x: the error of the sine counts, not that of sin/x.
    matrix = np.polynomial.polynomial.polyvander(nodes, terms - 1) * root[:, None]
    found = np.linalg.lstsq(matrix, np.sin(0.5 * math.pi * root), rcond=None)[0].tolist()
    square = width - 1
    # The constant of a step stands at the scale of the product, which bounds the scale of
    # the value before the step.
    scales = [width if width == 16 else width - 2]
    scales += [width - math.ceil(math.log2(abs(value))) for value in found[:-1]]
    steps = []
    for k in range(terms - 2, -1, -1):
        shift = scales[k + 1] + square - scales[k]
        steps.append((round(found[k] * 2.0 ** (scales[k + 1] + square)) + (1 << shift >> 1), shift))
    leading = round(found[-1] * 2.0 ** scales[-1])
    return SineSteps(width, leading, tuple(steps), width - 3, scales[0] + width - 2 - (width - 1))


def quarter_sine(o: Arithmetic[N, Any], width: int, x: N) -> N:
    """Sine of codes of a quarter turn, 0 to 2^(width - 2), as codes of 2^(width - 1)."""
    made = sine_steps(width)
    square = rounded(o, "sine: x^2", o.product("sine: x^2", x, x), made.square)
    value = o.const(made.leading)
    for constant, shift in made.steps:
        value = o.shifted(
            o.total("sine: sum", o.product("sine: product", value, square), o.const(constant)),
            shift,
        )
    result = rounded(o, "sine: last product", o.product("sine: last product", value, x), made.last)
    return o.clamp(result, 0, 2 ** (width - 1) - 1)


def sine(o: Arithmetic[N, Any], width: int, angle: N) -> N:
    """Sine of an angle, 0 to 2^width - 1 codes; odd and symmetric to the last bit."""
    half_turn, quarter = o.const(2 ** (width - 1)), o.const(2 ** (width - 2))
    inside = o.wrapped(angle, width - 1)
    x = o.choose(
        o.at_least(inside, quarter), o.total("sine: fold", half_turn, o.negative(inside)), inside
    )
    x = o.clamp(x, 0, 2 ** (width - 2))  # changes no number; a range does not know that x is folded
    value = quarter_sine(o, width, x)
    return o.choose(o.at_least(angle, half_turn), o.negative(value), value)


def rotation(o: Arithmetic[N, Any], width: int, angle: N) -> Pair[N]:
    """Cosine and sine of an angle."""
    shifted = o.wrapped(o.total("rotation: quarter turn", angle, o.const(2 ** (width - 2))), width)
    return Pair(sine(o, width, shifted), sine(o, width, angle))


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
        return self.o.clamp(a, -full_scale(self.width), full_scale(self.width))

    def ratio(self, name: str, a: N, b: N) -> N:
        """Quotient towards zero of a product by a code that is not negative, saturated."""
        return self.saturated(self.o.quotient(name, a, larger(self.o, b, self.o.const(1))))

    def at_least(self, a: N, b: N) -> Any:
        """Condition that a >= b."""
        return self.o.at_least(a, b)

    def choose(self, condition: Any, a: N, b: N) -> N:
        """Number a where the condition holds, else b."""
        return self.o.choose(condition, a, b)


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

    The vector is divided by the dc link (towards zero) and saturated at it;
    ``v_dc`` must be positive.
    """
    codes, one = Codes(o, width), 2 ** (width - 1)
    factor = o.const(2 ** (width - 1 - scale))
    share = [
        codes.saturated(o.quotient("duties: v / v_dc", o.product("duties: v", value, factor), v_dc))
        for value in vector
    ]
    phase = clarke_inverse(codes, Pair(*share))
    zero = zero_sequence_of(codes, modulation, phase, i, o.const(one))
    return Triple(*(o.clamp(o.total("duties: sum", value, zero), 0, one) for value in phase))
