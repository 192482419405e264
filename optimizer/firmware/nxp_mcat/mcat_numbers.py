"""How MCAT prints numbers, and what is left of them in the integers of a fixed-point build."""

from __future__ import annotations

import math
from decimal import ROUND_HALF_UP, Decimal

DIGITS = 6  # Significant digits of MCAT since 2021.
OLD_PLACES = 12  # Decimal places of MCAT before that.

# Bits behind the binary point, by the macro that makes the integer.
FRACTION_BITS = {"FRAC16": 15, "FRAC32": 31, "ACC32": 15}


def printed(value: float) -> float:
    """A number as MCAT prints it since 2021: as it is with fewer than six decimal places, else
    with six significant digits, halves upward.
    """
    if value == int(value) or _places(value) < DIGITS:
        return value
    exact = Decimal(value)
    step = Decimal(1).scaleb(exact.adjusted() - DIGITS + 1)
    return float(exact.quantize(step, rounding=ROUND_HALF_UP))


def old_printed(value: float) -> float:
    """A number as MCAT printed it before 2021: twelve decimal places, halves upward."""
    return math.floor(value * 1e12 + 0.5) / 1e12


def counts(value: float, kind: str) -> int:
    """The integer that a macro makes of a number, cut off toward zero and held in its range."""
    scale = 1 << FRACTION_BITS[kind]
    largest = (1 << 15) - 1 if kind == "FRAC16" else (1 << 31) - 1
    return int(max(-largest - 1, min(largest, value * scale)))


def held(value: float, kind: str) -> float:
    """What is left of a number in that integer."""
    return counts(value, kind) / (1 << FRACTION_BITS[kind])


def shift_of(value: float) -> int:
    """Power of two by which MCAT takes a positive number into the range of a fraction."""
    if value < 1.0:
        return -math.ceil(math.log2(1.0 / value) - 1.0)
    return math.ceil(math.log2(value))


def half_step(value: float, places: int | None = None) -> float:
    """Half of the last printed digit: how far the number before rounding may lie from it.

    Args:
        value: The printed number.
        places: Its decimal places where they are known, None for six significant digits.
    """
    if places is not None:
        return 0.5 * 10.0**-places
    if value == 0.0:
        return 0.5 * 10.0**-DIGITS
    return 0.5 * 10.0 ** (math.floor(math.log10(abs(value))) - DIGITS + 1)


def _places(value: float) -> int:
    """Decimal places of the shortest decimal that reads back to a number."""
    exponent = Decimal(repr(value)).as_tuple().exponent
    return max(0, -exponent) if isinstance(exponent, int) else 0
