"""Voltages that the legs of a topology can make, and their duty cycles, in integers."""

from __future__ import annotations

import math
from typing import Any

from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.machines.transforms import N
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, larger, rounded
from dqforge.optimizer.fixed_control.transforms import Codes
from dqforge.optimizer.fixed_phase_control.integers import FixedPhaseControl, Vector

_COARSE = 3  # bits that a voltage beyond full scale is lowered by before it is shortened


def smaller(o: Arithmetic[N, Any], a: N, b: N) -> N:
    """The smaller of two numbers."""
    return o.choose(o.at_least(a, b), b, a)


def phase_voltages(
    o: Arithmetic[N, Any], control: FixedPhaseControl, alpha: N, beta: N, zero: N
) -> tuple[N, N, N]:
    """Phases of a vector in codes of one word; sums of two have a bit more."""
    bits = control.width - 1
    half = o.product("phases: alpha / 2", alpha, o.const(1 << (bits - 1)))
    side = o.product("phases: beta", beta, o.const(round(2**bits * math.sqrt(0.75))))
    b = rounded(o, "phases: b", o.total("phases: b", side, o.negative(half)), bits)
    c = rounded(o, "phases: c", o.total("phases: c", o.negative(side), o.negative(half)), bits)
    return (
        o.total("phases: a", alpha, zero),
        o.total("phases: b", b, zero),
        o.total("phases: c", c, zero),
    )


def ends(o: Arithmetic[N, Any], values: tuple[N, ...]) -> tuple[N, N]:
    """Largest and least of some numbers."""
    high = low = values[0]
    for value in values[1:]:
        high, low = larger(o, high, value), smaller(o, low, value)
    return high, low


def link_demand(o: Arithmetic[N, Any], control: FixedPhaseControl, phases: tuple[N, N, N]) -> N:
    """What phase voltages ask of the link (of half of it where it is split), as their codes."""
    high, low = ends(o, phases)
    rule = TOPOLOGIES[control.topology]
    if rule.between is None:
        return larger(o, high, o.negative(low))
    if rule.neutral:
        high, low = larger(o, high, o.const(0)), smaller(o, low, o.const(0))
    spread = o.total("demand: spread", high, o.negative(low))
    return spread if rule.between == 1.0 else o.shifted(spread, 1)


def link_voltage(o: Arithmetic[N, Any], control: FixedPhaseControl, v_dc: N, v_m: N) -> N:
    """What there is of it, in codes of the voltage."""
    there = v_dc
    if control.midpoint is not None:
        above = o.total("link: above the midpoint", v_dc, o.negative(v_m))
        there = o.clamp(smaller(o, v_m, above), 1, control.top)
    return o.product("link", there, o.const(1 << control.dc_scale))


def within_region(
    o: Arithmetic[N, Any], control: FixedPhaseControl, asked: Vector[N], v_dc: N, v_m: N
) -> tuple[Vector[N], Any]:
    """A voltage shortened along its direction into what the legs can make, and whether it was."""
    codes, bits = Codes(o, control.width), control.width - 1
    coarse = [codes.saturated(o.shifted(x, _COARSE)) for x in asked]
    # A range does not know that the larger of two is positive; 8 full scales are never passed.
    demand = o.clamp(link_demand(o, control, phase_voltages(o, control, *coarse)), 1, 8 << bits)
    most = o.clamp(o.shifted(link_voltage(o, control, v_dc, v_m), _COARSE), 0, (1 << bits) - 1)
    limited = o.at_least(demand, most)
    share = o.quotient("region: share", o.product("region: link", most, o.const(1 << bits)), demand)
    share = o.clamp(share, 0, control.top)
    found = []
    for whole, part in zip(asked, coarse, strict=True):
        short = rounded(
            o, "region: shortened", o.product("region: shortened", part, share), bits - _COARSE
        )
        found.append(codes.saturated(o.choose(limited, short, whole)))
    return asked._replace(alpha=found[0], beta=found[1], zero=found[2]), limited


def centred(o: Arithmetic[N, Any], phases: tuple[N, N, N], middle: N) -> tuple[N, N, N]:
    """Phases less what is common to them."""
    back = o.negative(middle)
    a, b, c = (o.total("duties: centred", x, back) for x in phases)
    return a, b, c


def leg_duties(
    o: Arithmetic[N, Any], control: FixedPhaseControl, voltage: Vector[N], v_dc: N, v_m: N
) -> tuple[N, ...]:
    """Duty cycles of the legs, 0 to 2^(width - 1), in the order of the topology."""
    codes, one = Codes(o, control.width), 1 << (control.width - 1)
    factor = o.const(one >> control.dc_scale)
    phases = phase_voltages(o, control, voltage.alpha, voltage.beta, voltage.zero)
    rule = TOPOLOGIES[control.topology]
    bridges = len(rule.legs) == 6
    if bridges and not rule.neutral:
        high, low = ends(o, phases)
        middle = o.shifted(o.total("duties: ends", high, low), 1)
        phases = centred(o, phases, middle)
    share = tuple(
        codes.saturated(
            o.quotient("duties: v / v_dc", o.product("duties: v", codes.saturated(x), factor), v_dc)
        )
        for x in phases
    )
    half = o.const(one >> 1)

    def limited(*terms: N) -> N:
        return o.clamp(o.total("duties: sum", *terms), 0, one)

    if bridges:
        halves = [o.shifted(x, 1) for x in share]
        first = [limited(half, x) for x in halves]
        return (*first, *(limited(half, o.negative(x)) for x in halves))
    if rule.midpoint:
        wide = o.product("duties: v_m", v_m, o.const(one))
        zero = o.clamp(o.quotient("duties: v_m / v_dc", wide, v_dc), 0, one)
        return tuple(limited(x, zero) for x in share)
    high, low = ends(o, (*share, o.const(0)) if rule.neutral else share)
    zero = o.shifted(o.total("duties: offset", o.const(one), o.negative(high), o.negative(low)), 1)
    legs = tuple(limited(x, zero) for x in share)
    return (*legs, limited(zero)) if rule.neutral else legs
