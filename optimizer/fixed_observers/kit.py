"""What the position observers in integers are made of: codes of 32 bits with products of 64,
whatever the format of the control is.

An observer integrates: in 16 bits its filters and its loop would come to rest in dead bands, the
speed of a loop of 250 rad/s at 5 kHz in one of 0.16 degrees. So voltages, currents, angle and speed
enter from the codes of the control, 16 or 32 bits, and all that lies between is kept in 32 bits:
per unit with 2^31 codes of full scale, angles with 2^32 codes of a turn, small angles with 2^31
codes of a radian.

Every function takes its operations from an `Arithmetic`, as in `optimizer.fixed_control`: numbers
make it the model of the emitted C, ranges its proof.
"""

from __future__ import annotations

from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, magnitude, rounded
from dqforge.optimizer.fixed_control.gains import scaled
from dqforge.optimizer.loops.integer_gains import FixedGain

WIDTH = 32  # Bits of every code inside an observer.
ONE = 2 ** (WIDTH - 1)  # Codes of full scale, and of a radian.
TOP = ONE - 1  # The largest code.

# Names of quantities that must fit 32 bits begin so, because the C divides them there.
NARROW = "int32: "
_HALF_WORD = 16
_MOST_DIVISOR = 2**62
_SIZE_BITS = 15


def saturated(o: Arithmetic[N, Any], a: N) -> N:
    """The code nearest to a of those that lie as far below zero as above."""
    return o.clamp(a, -TOP, TOP)


def times(o: Arithmetic[N, Any], name: str, a: N, b: N) -> N:
    """Product of two codes as a code, rounded."""
    return rounded(o, name, o.product(name, a, b), WIDTH - 1)


def difference(o: Arithmetic[N, Any], name: str, a: Pair[N], b: Pair[N]) -> Pair[N]:
    """The vector a - b; one bit more than a code."""
    return Pair(o.total(name, a.x, o.negative(b.x)), o.total(name, a.y, o.negative(b.y)))


def scaled_pair(o: Arithmetic[N, Any], name: str, gain: FixedGain, a: Pair[N]) -> Pair[N]:
    """A vector times a gain."""
    return Pair(scaled(o, name, gain, a.x), scaled(o, name, gain, a.y))


def saturated_pair(o: Arithmetic[N, Any], a: Pair[N]) -> Pair[N]:
    """A vector whose components are codes."""
    return Pair(saturated(o, a.x), saturated(o, a.y))


def sine_of_angle(o: Arithmetic[N, Any], across: N, vector: Pair[N], floor: int) -> N:
    """The component ``across`` over the length of its vector, at least ``floor``: a sine, 2^31
    codes of 1.

    The length only scales a loop gain and needs few digits: it is the root of a word of 32 bits,
    in codes of 16 bits, as ``floor`` is. The quotient has all its digits: two divisions of
    32 bits, the second of what the first leaves.
    """
    x, y = o.shifted(vector.x, _HALF_WORD), o.shifted(vector.y, _HALF_WORD)
    # Changes no number: a sum of squares, which a range does not know.
    square = o.clamp(
        o.total("x^2 + y^2", o.product("x^2", x, x), o.product("y^2", y, y)), 0, 2 * 2**30
    )
    size = o.clamp(o.root(square), floor, 2**16)
    first = o.quotient(f"{NARROW}across / size", across, size)
    whole = o.product("whole part of across", first, size)
    # Changes no number: what a division leaves is less than its divisor.
    rest = o.within(o.total("rest of across", across, o.negative(whole)), size)
    fine = o.product(f"{NARROW}rest 2^15", rest, o.const(1 << _SIZE_BITS))
    second = o.quotient("rest / size", fine, size)
    coarse = o.product("across / size 2^15", first, o.const(1 << _SIZE_BITS))
    return saturated(o, o.total("sine of the angle", coarse, second))


def quotient(o: Arithmetic[N, Any], name: str, a: N, b: N, bits: int) -> N:
    """The code a over the code b with ``bits`` fractional bits, towards zero, saturated.

    A divisor below one code counts as one.
    """
    fine = o.product(f"{name}: numerator", a, o.const(1 << bits))
    return saturated(o, o.quotient(name, fine, o.clamp(b, 1, _MOST_DIVISOR)))


@dataclass(frozen=True, slots=True)
class FixedPll:
    """Phase-locked loop in integers.

    ``advance`` makes the angle of a period of a speed, ``l_1`` an angle and ``l_2`` a speed of an
    angle error in codes of a radian.
    """

    advance: FixedGain
    l_1: FixedGain
    l_2: FixedGain


def predicted(o: Arithmetic[N, Any], advance: FixedGain, theta: N, omega: N) -> N:
    """Angle one period on, 2^32 codes of a turn."""
    turn = scaled(o, "angle of a period", advance, omega)
    return o.wrapped(o.total("angle foretold", theta, turn), WIDTH)


def turned_by(o: Arithmetic[N, Any], gain: FixedGain, theta: N, error: N) -> N:
    """An angle corrected by a share of an error in codes of a radian."""
    return o.wrapped(o.total("angle", theta, scaled(o, "l_1 error", gain, error)), WIDTH)


def corrected(o: Arithmetic[N, Any], pll: FixedPll, theta: N, omega: N, error: N) -> tuple[N, N]:
    """Angle and speed after an angle error in codes of a radian; the speed saturates."""
    speed = o.total("speed", omega, scaled(o, "l_2 error", pll.l_2, error))
    return turned_by(o, pll.l_1, theta, error), saturated(o, speed)


def with_sign_of(o: Arithmetic[N, Any], sign: N, a: N) -> N:
    """The number a, or -a where ``sign`` is below zero."""
    return o.choose(o.at_least(sign, o.const(0)), a, o.negative(a))


def speed_size(o: Arithmetic[N, Any], omega: N) -> N:
    """Magnitude of a speed, a code."""
    return o.clamp(magnitude(o, omega), 0, TOP)
