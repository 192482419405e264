"""Losses of a bridge at the switching instants and currents that a regulator really had.

Conduction is averaged between the commutations; each commutation costs the energy of the device at
the current of that instant. What a leg does follows from the sign of its current: a leg that goes
up with the current out of it, or down with the current into it, turns a transistor on against a
diode that conducts; the other two turn one off.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.losses.bridge_tables import BridgeTables
from dqforge.machines.plants.current_trace import CurrentTrace
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class TraceLosses:
    """Powers of one switch position in W, mean of the three legs, shape (2, J, K, N).

    Upper and lower position; junction of the transistor and, where the diode has its own, of the
    diode; temperature of the tables.

    Args:
        conduction, switching: Powers in W.
        link_square: Mean square of the current from the DC link in A^2, shape (N,).
        ripple_square: Mean square of what a phase current has beside its reference in A^2, shape
            (N,).
    """

    conduction: FloatArray
    switching: FloatArray
    link_square: FloatArray
    ripple_square: FloatArray


def trace_losses(tables: BridgeTables, trace: CurrentTrace) -> TraceLosses:
    """Losses of all points of a trace.

    Args:
        tables: The device.
        trace: What the regulator did.
    """
    count = trace.plant.i_d.size
    found = [_one(tables, trace, point) for point in range(count)]
    stacked = [np.stack([part[k] for part in found], axis=-1) for k in range(4)]
    conduction, switching = (
        part if tables.separate_diode else np.sum(part, axis=1, keepdims=True)
        for part in stacked[:2]
    )
    return TraceLosses(conduction, switching, stacked[2], stacked[3])


def _one(
    tables: BridgeTables, trace: CurrentTrace, point: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Conduction and switching (2, 2, K), mean squares of link current and ripple, of a point."""
    weight, current, error = trace.samples_of(point)
    on = trace.legs[:, point]
    size = np.abs(current)
    channel = tables.channel.at(size) * size
    diode = channel if tables.synchronous or tables.diode is None else tables.diode.at(size) * size
    conduction = np.zeros((2, 2, tables.temperatures.size))
    for place, (own, out) in enumerate(((on, current > 0.0), (~on, current <= 0.0))):
        shares = weight[..., None] / 3.0
        ahead, back = shares * (own & out), shares * (own & ~out)
        conduction[place, 0] = np.sum(channel * ahead, axis=(1, 2, 3))
        part = np.sum(diode * back, axis=(1, 2, 3))
        conduction[place, 0 if tables.synchronous else 1] += part
    link = np.sum(weight * np.sum(np.where(on, current, 0.0), axis=-1) ** 2)
    ripple = np.sum(weight * np.mean(error**2, axis=-1))
    return conduction, _events(tables, trace, point), link, ripple


def _events(tables: BridgeTables, trace: CurrentTrace, point: int) -> FloatArray:
    """Switching power (2, 2, K) of the positions of a leg, mean of the three."""
    power = np.zeros((2, 2, tables.temperatures.size))
    duration = float(trace.duration[point])
    for leg in range(3):
        time, up = trace.instants(point, leg)
        if not time.size:
            continue
        current = trace.phase_currents(point, time)[:, leg]
        size, out = np.abs(current), current > 0.0
        turn_on, turn_off = tables.turn_on.at(size), tables.turn_off.at(size)
        recovery = tables.recovery.at(size)
        scale = 1.0 / (3.0 * duration)
        # With the current out of the leg its upper transistor switches, the lower diode recovers.
        for place, works in enumerate((out, ~out)):
            starts = works & (up == (place == 0))
            ends = works & (up != (place == 0))
            power[place, 0] += scale * (turn_on @ starts + turn_off @ ends)
            power[1 - place, 1] += scale * (recovery @ starts)
    return power
