"""Duty cycles of the legs for phase voltages, and the phase voltages that duty cycles make.

Written once for every kind of number, as the zero sequence of the modulators is. Potentials of the
legs are those from the negative rail (of isolated ends: each from its own link's)::

    three-wire, diode-neutral   v_k + V0                                  V0 of the modulator
    four-leg                    v_k + V0, V0   V0 = (V_dc - max - min) / 2 of {v_a, v_b, v_c, 0}
    six-leg                     (V_dc + v_k) / 2, (V_dc - v_k) / 2
    six-leg-isolated            the same of v_k - (max + min) / 2
    split-capacitor             v_k + v_m

and a duty cycle is the potential over V_dc. Each reaches all voltages of its topology's region
(`dqforge.machines.topologies.regions`). Source: paper 002, chapter 5.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.registry import extremes
from dqforge.machines.names import Topology
from dqforge.machines.topologies.topology import TOPOLOGIES, leg_signs
from dqforge.machines.transforms import Floats, N, Numbers, Triple


def leg_potentials(
    o: Numbers[N, Any],
    topology: Topology,
    v: Triple[N],
    v_dc: N,
    *,
    nothing: N,
    v_m: N | None = None,
    zero_sequence: N | None = None,
) -> tuple[N, ...]:
    """Potentials of the legs from the negative rail, in the order of their duty cycles.

    Args:
        o: The arithmetic.
        topology: The topology.
        v: Phase voltages, within the region; nothing is clipped.
        v_dc: DC-link voltage in the unit of the phase voltages.
        nothing: The number 0.
        v_m: Midpoint of a split link from the negative rail; half the link where it is not given.
        zero_sequence: V0 of the design's modulator, which three legs without a neutral take; the
            mean of the extremes is centred where it is not given.
    """
    rule = TOPOLOGIES[topology]
    if rule.midpoint:
        middle = o.halved(v_dc) if v_m is None else v_m
        return tuple(o.total("leg: v + v_m", phase, middle) for phase in v)
    if rule.modulated:
        zero = _centred(o, v, v_dc) if zero_sequence is None else zero_sequence
        return tuple(o.total("leg: v + V0", phase, zero) for phase in v)
    if "n" in rule.legs:
        zero = _centred(o, v, v_dc, nothing)
        return (*(o.total("leg: v + V0", phase, zero) for phase in v), zero)
    if not rule.neutral:
        (high,), (low,) = extremes(o, v)
        shift = o.negative(o.halved(o.total("leg: max + min", high, low)))
        v = Triple(*(o.total("leg: v less the mean of extremes", phase, shift) for phase in v))
    upper = tuple(o.halved(o.total("leg: V_dc + v", v_dc, phase)) for phase in v)
    lower = tuple(o.halved(o.total("leg: V_dc - v", v_dc, o.negative(phase))) for phase in v)
    return upper + lower


def _centred(o: Numbers[N, Any], v: Triple[N], v_dc: N, *others: N) -> N:
    """What centres the highest and lowest of the phases, and of other potentials, in the link."""
    (high,), (low,) = extremes(o, v)
    for other in others:
        high = o.choose(o.at_least(high, other), high, other)
        low = o.choose(o.at_least(low, other), other, low)
    return o.halved(o.total("leg: V0", v_dc, o.negative(high), o.negative(low)))


def shortened(
    o: Numbers[N, Any],
    topology: Topology,
    v: Triple[N],
    v_dc: N,
    *,
    nothing: N,
    v_m: N | None = None,
) -> tuple[Triple[N], Any]:
    """Phase voltages shortened along their direction into the region, and the condition that they
    had to be.

    Args:
        o, topology, v_dc, nothing, v_m: As of `leg_potentials`.
        v: Phase voltages wanted.
    """
    rule = TOPOLOGIES[topology]
    (high,), (low,) = extremes(o, v)
    if rule.midpoint:
        middle = o.halved(v_dc) if v_m is None else v_m
        above = o.total("region: V_dc - v_m", v_dc, o.negative(middle))
        v, upwards = _within(o, v, high, above)
        _, (low,) = extremes(o, v)  # what brought down the highest brought up the lowest
        v, downwards = _within(o, v, o.negative(low), middle)
        return v, upwards | downwards
    if rule.between is None:
        up, down = o.magnitude(high), o.magnitude(low)
        return _within(o, v, o.choose(o.at_least(up, down), up, down), v_dc)
    if rule.neutral:
        high = o.choose(o.at_least(high, nothing), high, nothing)
        low = o.choose(o.at_least(low, nothing), nothing, low)
    span = o.total("region: max - min", high, o.negative(low))
    most = v_dc if rule.between == 1.0 else o.twice("region: both links", v_dc)
    return _within(o, v, span, most)


def _within(o: Numbers[N, Any], v: Triple[N], size: N, most: N) -> tuple[Triple[N], Any]:
    """Phase voltages times ``most / size`` where the size is larger, and where it is."""
    fits = o.at_least(most, size)
    scaled = (o.ratio("region", o.product("region: v times limit", x, most), size) for x in v)
    return Triple(*(o.choose(fits, x, y) for x, y in zip(v, scaled, strict=True))), ~fits


def duty_cycles(
    topology: Topology,
    voltages: ArrayLike,
    v_dc: ArrayLike,
    *,
    v_m: ArrayLike | None = None,
    zero_sequence: ArrayLike | None = None,
    number: type[np.floating[Any]] = np.float64,
) -> FloatArray:
    """Duty cycles of the upper switches, shape (..., legs), from 0 to 1; 1/2 without a link.

    Args:
        topology: The topology.
        voltages: Phase voltages in V, shape (..., 3).
        v_dc: DC-link voltage in V, broadcastable to (...).
        v_m, zero_sequence: As of `leg_potentials`, in V, broadcastable to (...).
        number: The floating-point type of the arithmetic.
    """
    phases = Triple(*np.moveaxis(np.asarray(voltages, dtype=number), -1, 0))
    link = np.asarray(v_dc, dtype=number)
    potentials = leg_potentials(
        Floats(number),
        topology,
        phases,
        link,
        nothing=np.zeros_like(phases.a),
        v_m=None if v_m is None else np.asarray(v_m, dtype=number),
        zero_sequence=None if zero_sequence is None else np.asarray(zero_sequence, dtype=number),
    )
    powered = link > 0.0
    scale = np.where(powered, number(1.0) / np.where(powered, link, number(1.0)), number(0.0))
    legs = np.stack(np.broadcast_arrays(*potentials), axis=-1) * scale[..., np.newaxis]
    return np.asarray(
        np.clip(np.where(powered[..., np.newaxis], legs, number(0.5)), number(0.0), number(1.0))
    )


def phase_voltages(
    topology: Topology, duty: FloatArray, v_dc: ArrayLike, v_m: ArrayLike | None = None
) -> FloatArray:
    """Phase voltages in V, shape (..., 3), of duty cycles or switching states.

    Without a neutral they are those whose mean is zero; only their differences act.

    Args:
        topology: The topology.
        duty: Duty cycles of the upper switches, shape (..., legs).
        v_dc, v_m: Link, and midpoint of a split one (half of it where it is not given), in V, shape
            (...).
    """
    rule, link = TOPOLOGIES[topology], np.asarray(v_dc, dtype=np.float64)
    voltages = duty @ leg_signs(topology).T * link[..., np.newaxis]
    if rule.midpoint:
        middle = 0.5 * link if v_m is None else np.asarray(v_m, dtype=np.float64)
        return np.asarray(voltages - middle[..., np.newaxis])
    if not rule.neutral:
        voltages = voltages - np.mean(voltages, axis=-1, keepdims=True)
    return np.asarray(voltages)
