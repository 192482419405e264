"""North from south as the firmware does it: written once, in the order of operations of the emitted
C (``observers/polarity.j2``).

Equal volt-seconds along the assumed d axis, positive then negative, each taken back by its
opposite: iron that the magnet has saturated answers the pulse that saturates it further with the
larger current. The sum of both peaks decides; after an odd number of wrong ones it is still the
mean that counts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import Arithmetic

# Samples from the one at which a voltage is asked for to the one at which the answer to its first
# period is seen.
DELAY = 2


@dataclass(frozen=True, slots=True)
class PolarityGains:
    """What the firmware needs.

    ``voltage`` in V of a pulse of ``periods`` samples, followed by its opposite and a pause of
    ``pause`` samples; ``pulses`` pairs in all. ``sign`` is 1 where the peak along the magnet is the
    larger, -1 where it is the smaller.
    """

    voltage: float
    periods: float
    pause: float
    pulses: float
    sign: float


@dataclass(frozen=True, slots=True, eq=False)
class PolarityState:
    """``place`` counts the samples of a half pair, ``half`` the half pairs that are over; ``total``
    is the sum of the peaks in A, shape (N,). ``turned`` is 1 where d points to the south pole.
    """

    place: int
    half: int
    total: Reals
    voltage: Reals
    done: bool
    turned: Reals


def polarity_start(count: int, maths: Arithmetic) -> PolarityState:
    """Before the first step, of ``count`` drives."""
    zero = np.zeros(count, dtype=maths.number)
    return PolarityState(0, 0, zero, zero, False, zero)


def polarity_step(
    gains: PolarityGains, state: PolarityState, i_d: Reals, maths: Arithmetic
) -> PolarityState:
    """Next state; ``i_d`` in A along the assumed d axis, ``voltage`` of the state in V is to act
    along it from the next sampling instant on.
    """
    zero = np.zeros_like(state.total)
    if state.done:
        return replace(state, voltage=zero)
    periods, total = int(gains.periods), state.total
    if state.place == periods + DELAY - 1:
        # a sample that is no number takes no side
        known = np.abs(i_d) < maths.number(1.0e15)
        total = total + np.where(known, i_d, zero)
    size = maths.number(gains.voltage if state.half % 2 == 0 else -gains.voltage)
    voltage = zero
    if state.place < periods:
        voltage = zero + size
    elif state.place < 2 * periods:
        voltage = zero - size
    place, half = state.place + 1, state.half
    if place == 2 * periods + int(gains.pause):
        place, half = 0, half + 1
    done = half == 2 * int(gains.pulses)
    turned = np.where(gains.sign * total < maths.number(0.0), maths.number(1.0), zero)
    return PolarityState(place, half, total, voltage, done, turned)
