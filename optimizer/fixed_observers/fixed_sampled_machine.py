"""The machine from one sample to the next in integers (`optimizer.observers.sampled_gains`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded
from dqforge.optimizer.fixed_observers.kit import ONE, saturated, times
from dqforge.optimizer.fixed_observers.polynomials import (
    FixedPolynomials,
    common_scale,
    odd_value_of,
    value_of,
)
from dqforge.optimizer.fixed_observers.scales import Scales, speed_limit
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.sampled_gains import EVEN, SampledGains

_ENTRY_BITS = 29
_VOLTS, _AMPERES = (2, 3, 7, 8), (4, 9)


@dataclass(frozen=True, slots=True)
class FixedSampled:
    """Entries of the sampled machine between codes, the even ones first; largest speed; gain that
    makes the angle of a period.
    """

    entries: FixedPolynomials
    most: int
    advance: FixedGain


def fixed_sampled(model: SampledGains, scales: Scales) -> FixedSampled:
    """The sampled machine in integers.

    Args:
        model: In double precision.
        scales: Full scales of the control.
    """
    return FixedSampled(
        common_scale("sampled machine", entry_rows(model, scales), _ENTRY_BITS),
        speed_limit(model.x_max / model.t_s, scales),
        scales.advance,
    )


def entry_rows(model: SampledGains, scales: Scales) -> list[list[float]]:
    """Coefficients of the ten entries, per unit, of rising powers of the square of the speed."""
    rows = np.reshape(model.table, (2 * EVEN, 4)) * scales.turn ** (2.0 * np.arange(4))
    rows[EVEN:] *= scales.turn
    rows[list(_VOLTS)] *= scales.voltage / scales.current
    rows[list(_AMPERES)] /= scales.current
    found: list[list[float]] = rows.tolist()
    return found


def limited_speed(o: Arithmetic[N, Any], model: FixedSampled, omega: N) -> N:
    """The speed at which the entries are taken."""
    return o.clamp(omega, -model.most, model.most)


def entries_at(o: Arithmetic[N, Any], entries: FixedPolynomials, x: N) -> list[N]:
    """Mantissas of the ten entries at a speed."""
    square = times(o, "square of the speed", x, x)
    even = [value_of(o, row, square) for row in entries.rows[:EVEN]]
    return even + [odd_value_of(o, row, square, x) for row in entries.rows[EVEN:]]


def combined_currents(o: Arithmetic[N, Any], e: list[N], i: Pair[N], v: Pair[N]) -> Pair[N]:
    """Phi i + Gamma v + h of ten mantissas: codes times their scale."""
    one = o.const(ONE)

    def row(along: N, across: N, own: N, other: N, rest: N) -> N:
        return o.total(
            "next current",
            o.product("entry i", along, i.x),
            o.product("entry i", across, i.y),
            o.product("entry v", own, v.x),
            o.product("entry v", other, v.y),
            o.product("entry", rest, one),
        )

    return Pair(row(e[0], e[5], e[2], e[7], e[4]), row(e[6], e[1], e[8], e[3], e[9]))


def next_currents(o: Arithmetic[N, Any], shift: int, e: list[N], i: Pair[N], v: Pair[N]) -> Pair[N]:
    """Currents one sample after ``i`` under the voltage ``v``, saturated; ``e`` are mantissas."""
    found = combined_currents(o, e, i, v)
    return Pair(
        saturated(o, rounded(o, "next current", found.x, shift)),
        saturated(o, rounded(o, "next current", found.y, shift)),
    )
