"""Gains per unit, in double and as integers: a mantissa that uses its word, and a right shift.

A gain g between per-unit codes is mantissa / 2^shift. Plain Qn formats have shifts below the width
of the word; with power-of-two dividers the shift may be larger, so that small gains keep all their
digits.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from dqforge.machines.design.settings import PerUnitBases
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import QFormats
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.loop_gains import LoopGains, loop_bases, per_unit

GainStyle = Literal["power-of-two", "q"]


@dataclass(frozen=True, slots=True)
class FixedGain:
    """A gain in integers, mantissa / 2^shift.

    ``value`` is the real gain that it stands for, dimensionless (between per-unit codes).
    """

    mantissa: int
    shift: int
    value: float

    @property
    def realised(self) -> float:
        """The gain that the integers make."""
        return float(self.mantissa * 2.0**-self.shift)

    @property
    def error(self) -> float:
        """Relative error of the gain, 0 where the gain is 0."""
        return self.realised / self.value - 1.0 if self.value else 0.0

    @property
    def half(self) -> int:
        """Half of what the shift leaves, added before it to round to nearest."""
        return (1 << self.shift) >> 1

    def text(self) -> str:
        """Integers as they are written: ``20000 / 2^10``."""
        return f"{self.mantissa} / 2^{self.shift}"


def to_q(value: float, bits: int, width: Literal[16, 32] = 16) -> int:
    """Round value 2^bits to the nearest integer, halves away from zero.

    Args:
        value: The number, dimensionless.
        bits: Fractional bits, 0 to ``width`` - 1.
        width: Size of the signed integer that must hold the result, 16 (default) or 32 bits.

    Raises:
        NoSolutionError: If the integer does not fit, or if a value other than zero would become 0.
    """
    if not 0 <= bits < width:
        raise InputError(
            f"a Q format of int{width}_t has 0 to {width - 1} fractional bits, got {bits}"
        )
    if not np.isfinite(value):
        raise NoSolutionError(f"{value} cannot be written as an integer in Q{bits}")
    magnitude = int(np.floor(abs(value) * 2.0**bits + 0.5))
    result = -magnitude if value < 0.0 else magnitude
    if not -(2 ** (width - 1)) <= result < 2 ** (width - 1):
        raise NoSolutionError(
            f"{value:.6g} is {result} in Q{bits}, which int{width}_t cannot hold: use fewer "
            "fractional bits"
        )
    if result == 0 and value != 0.0:
        raise NoSolutionError(f"{value:.6g} rounds to 0 in Q{bits}: use more fractional bits")
    return result


def quantise(
    value: float, width: int, argument: int, style: GainStyle = "power-of-two"
) -> FixedGain:
    """Largest mantissa that a word of ``width`` bits holds and whose product with the
    argument twice the width holds.

    Args:
        value: The gain, dimensionless.
        width: Bits of the mantissa, 16 or 32; the product with half of what the shift leaves has
            twice as many.
        argument: Largest magnitude of what the gain is multiplied with.
        style: ``power-of-two``: any shift up to 2 width - 2; ``q``: below the width, as Qn formats
            have it.

    Raises:
        NoSolutionError: The gain is too large for the mantissa even without a shift, or so small
            that it becomes 0.
    """
    largest = width - 1 if style == "q" else 2 * width - 2
    if value == 0.0:
        return FixedGain(0, 0, 0.0)
    for shift in range(largest, -1, -1):
        mantissa = rounded_mantissa(value, shift)
        if abs(mantissa) < 2 ** (width - 1) and abs(mantissa) * argument + (
            (1 << shift) >> 1
        ) < 2 ** (2 * width - 1):
            if mantissa == 0:
                raise NoSolutionError(
                    f"{value:.4g} is 0 in {width} bits with a shift of {shift}; use other bases"
                )
            return FixedGain(mantissa, shift, value)
    raise NoSolutionError(
        f"{value:.4g} is more than int{width}_t holds; use larger bases of what it multiplies"
    )


def given(value: float, bits: int, width: Literal[16, 32] = 16) -> FixedGain:
    """A gain in a format that was asked for; errors as `to_q`.

    Args:
        value: The gain as a real number.
        bits: Fractional bits of the format.
        width: Bits of the integer.
    """
    return FixedGain(to_q(value, bits, width), bits, value)


def rounded_mantissa(value: float, bits: int) -> int:
    """Value 2^bits rounded to the nearest integer, halves away from zero.

    ``value`` is dimensionless.
    """
    magnitude = int(abs(value) * 2.0**bits + 0.5)
    return -magnitude if value < 0.0 else magnitude


def pi_integers(
    kp: float, ki_ts: float, q_formats: QFormats | None
) -> tuple[FixedGain, FixedGain] | None:
    """Integers of 16 bits of kp and ki t_s per unit in the formats of the settings,
    None where none are asked for.

    ``auto`` gives each gain the plain Qn format, n up to 30, with the most digits.

    Args:
        kp, ki_ts: Gain and integral gain times the sampling period, per unit.
        q_formats: Fractional bits of both, ``auto``, or None.

    Raises:
        NoSolutionError: An integer does not fit its format, or becomes 0.
    """
    if q_formats is None:
        return None
    if q_formats == "auto":
        argument = 2**16 - 1  # an error of two full scales
        return quantise(kp, 16, argument), quantise(ki_ts, 16, argument)
    return given(kp, q_formats[0]), given(ki_ts, q_formats[1])


@dataclass(frozen=True, slots=True)
class PerUnitGains:
    """Gains of one loop between per-unit quantities: ``kp`` and ``ki_ts`` = ki t_s, dimensionless.

    ``integers`` are those of 16 bits in the formats that the design asks for, (kp, ki t_s); None
    where it asks for none.
    """

    kp: float
    ki_ts: float
    integers: tuple[FixedGain, FixedGain] | None


def per_unit_gains(
    gains: LoopGains, bases: PerUnitBases, q_formats: QFormats | None
) -> PerUnitGains:
    """Gains of a loop per unit of the bases, as real numbers and as integers.

    Errors as `pi_integers`.

    Args:
        gains: The loop, gains in SI units.
        bases: Per-unit bases in SI units.
        q_formats: Fractional bits of both gains, ``auto``, or None.
    """
    kp, ki_ts = per_unit(gains, *loop_bases(bases, gains.loop))
    return PerUnitGains(kp, ki_ts, pi_integers(kp, ki_ts, q_formats))
