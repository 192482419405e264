"""Zero sequence of all modulators, written once for every kind of number
(`dqforge.machines.transforms.Numbers`).

::

    SPWM           V0 = v_dc / 2
    THIPWM6        V0 = v_dc / 2 - V cos(3 alpha) / 6
    THIPWM4        V0 = v_dc / 2 - V cos(3 alpha) / 4
    SVPWM          V0 = (v_dc - V_max - V_min) / 2
    discontinuous  V0 = v_dc - V_max where the highest phase rests, -V_min where the lowest does

with alpha the angle of the voltage vector from phase a. Paper 000 (14) prints -V_max in the last
case, which would clamp no phase. Which of the two phases rests:

::

    DPWMMAX, DPWMMIN    always the highest, always the lowest
    DPWM1, DPWM3        that with the larger, the smaller reference
    DPWM0, DPWM2        that with the larger reference 30 degrees ahead, behind
    GDPWM               that with the larger reference at the load angle, up to 30 degrees
    DDT-GDPWM           that with the larger current

Of equal references the first is the highest and the last is the lowest, so that the two are never
the same phase; where both might rest equally well it is the highest.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import N, Numbers, Pair, Reals, Triple, clarke_inverse, park


def zero_sequence_of(
    o: Numbers[N, Any],
    name: ModulationName,
    v: Triple[N],
    i: Triple[N],
    v_dc: N,
    vector: Pair[N] | None = None,
    turn: Pair[N] | None = None,
) -> N:
    """Zero sequence from the negative rail, in the unit of the references.

    Args:
        o: The arithmetic.
        name: The modulator.
        v, i: References of the phases from the star point, and phase currents, of which DDT-GDPWM
            compares the magnitudes.
        v_dc: DC-link voltage in the unit of the references.
        vector, turn: As of `compared`; with ``vector`` the third harmonic takes its square from
            there too.
    """
    rule = MODULATORS[name]
    if rule.kind == "sine":
        return o.halved(v_dc)
    if rule.kind == "third-harmonic":
        third = third_harmonic(o, v, rule.share, vector)
        return o.total(f"{name}: zero sequence", o.halved(v_dc), o.negative(third))
    if rule.kind != "compared":
        (high,), (low,) = extremes(o, v)
        upper = o.total(f"{name}: zero sequence", v_dc, o.negative(high))
        lower = o.negative(low)
        if rule.kind == "centred":
            return o.halved(o.total(f"{name}: zero sequence", upper, lower))
        return upper if rule.kind == "highest" else lower
    (high, of_high), (low, of_low) = extremes(o, v, compared(o, name, v, i, vector, turn))
    upper = o.total(f"{name}: zero sequence", v_dc, o.negative(high))
    return o.choose(highest_rests(o, name, of_high, of_low), upper, o.negative(low))


def third_harmonic(
    o: Numbers[N, Any], v: Triple[N], share: float, vector: Pair[N] | None = None
) -> N:
    """The third harmonic V cos(3 alpha) times a share, from cos(3 alpha) V^3 = 4 a b
    c of balanced references.

    Args:
        o: The arithmetic.
        v: References of the phases in any unit.
        share: Share of the harmonic, 1/4 at the most.
        vector: Alpha and beta of the references, if V^2 is to be theirs; else it is 2/3 of the sum
            of the phases' squares.
    """
    if vector is None:
        squares = [o.product("third harmonic: square", phase, phase) for phase in v]
        total = o.total("third harmonic: V^2", *(o.lowered(square) for square in squares))
        length = o.lowered(o.part("third harmonic: V^2", total, 2.0 / 3.0))
    else:
        name = "third harmonic: V^2"
        length = o.total(
            name, o.product(name, vector.x, vector.x), o.product(name, vector.y, vector.y)
        )
    cube = o.product(
        "third harmonic: a b c", o.lowered(o.product("third harmonic: a b", v.a, v.b)), v.c
    )
    quarter = o.ratio("third harmonic: ratio", cube, length)
    if share == 0.25:
        return quarter
    return o.settled("third harmonic", o.part("third harmonic", quarter, 4.0 * share))


def extremes(
    o: Numbers[N, Any], v: Triple[N], *views: Triple[N]
) -> tuple[tuple[N, ...], tuple[N, ...]]:
    """The highest and the lowest of three phases: its value, then what each view has of that phase.

    Args:
        o: The arithmetic.
        v: References of the phases.
        views: Other values of the phases, that of the found phase is returned for each.
    """
    high = low = (v.a, *(view.a for view in views))
    for k in (1, 2):
        other = (v[k], *(view[k] for view in views))
        keeps, falls = o.at_least(high[0], other[0]), o.at_least(low[0], other[0])
        high = tuple(o.choose(keeps, x, y) for x, y in zip(high, other, strict=True))
        low = tuple(o.choose(falls, y, x) for x, y in zip(low, other, strict=True))
    return high, low


def compared(
    o: Numbers[N, Any],
    name: ModulationName,
    v: Triple[N],
    i: Triple[N],
    vector: Pair[N] | None = None,
    turn: Pair[N] | None = None,
) -> Triple[N]:
    """What a discontinuous modulator looks at to choose between the highest and the lowest phase.

    References delayed by 30 degrees are differences of two references, but for a factor that does
    not matter. So DPWM0 and DPWM2 compare these where there is no ``turn``, exactly in integers;
    the emitted floating-point code turns the vector for them as GDPWM must, for which the load
    angle is any.

    Args:
        o: The arithmetic.
        name: A discontinuous modulator that uses both rails.
        v, i: References and currents of the phases.
        vector, turn: Alpha and beta of the references and the delay at which they are compared,
            that of the modulator or `load_turn`, as cosine and sine; GDPWM needs both, DPWM0 and
            DPWM2 take them where they are given, the others have no use for them.
    """
    rule = MODULATORS[name]
    if rule.compared == "currents":
        return i
    if rule.compared == "voltages":
        return v
    if vector is not None and turn is not None:
        return clarke_inverse(o, park(o, vector, turn))
    assert rule.delay is not None, f"{name} needs the vectors of voltage and current"
    other = Triple(v.b, v.c, v.a) if rule.delay.y < 0.0 else Triple(v.c, v.a, v.b)
    return Triple(
        *(o.total(f"{name}: difference", x, o.negative(y)) for x, y in zip(v, other, strict=True))
    )


def highest_rests(o: Numbers[N, Any], name: ModulationName, of_high: N, of_low: N) -> Any:
    """Condition that of the highest and the lowest phase the highest rests.

    Args:
        o: The arithmetic.
        name: A discontinuous modulator that uses both rails.
        of_high, of_low: What `compared` has of the two phases.
    """
    of_high, of_low = o.magnitude(of_high), o.magnitude(of_low)
    if MODULATORS[name].smaller:
        return o.at_least(of_low, of_high)
    return o.at_least(of_high, of_low)


def load_turn(voltage: Pair[Reals], current: Pair[Reals], reactive: float = 0.0) -> Pair[Reals]:
    """Cosine and sine of the angle by which the current lags the voltage, held within 30 degrees;
    0 without current.

    Loss depends on the magnitude of the current alone, so that generating counts as motoring
    with the current reversed.

    Args:
        voltage, current: Alpha and beta in any units, numpy arrays of one type and any shapes that
            fit together.
        reactive: Loads whose power is above this share of the apparent power, taken negative, count
            as motoring, so that rounding does not turn the angle to and fro.
    """
    number = np.result_type(voltage.x, current.x).type
    zero, half, one = number(0.0), number(0.5), number(1.0)
    along = (voltage.x * current.x) + (voltage.y * current.y)
    across = (voltage.y * current.x) - (voltage.x * current.y)
    length = np.sqrt((along * along) + (across * across))
    generating = along < (-number(reactive) * length if reactive else zero)
    across, along = np.where(generating, -across, across), np.abs(along)
    known, wide = length > zero, np.abs(across) > number(1.0 / math.sqrt(3.0)) * along
    divisor = np.where(known, length, one)
    cosine = np.where(wide, number(math.sqrt(0.75)), along / divisor)
    sine = np.where(wide, np.where(across < zero, -half, half), across / divisor)
    return Pair(np.where(known, cosine, one), np.where(known, sine, zero))
