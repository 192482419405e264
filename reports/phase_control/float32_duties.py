"""Voltage region and duty cycles of the topologies with a neutral of their own or with six legs,
on numpy arrays of float32: as ``duties.j2``, same operations, same bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.transforms import Pair, Triple, clarke_inverse
from dqforge.reports.c_code.float32_functions import SINGLE

if TYPE_CHECKING:
    from dqforge.machines.names import ModulationName, Topology
    from dqforge.optimizer.curves.single_precision import SingleArray

_HALF, _ZERO, _ONE = np.float32(0.5), np.float32(0.0), np.float32(1.0)


class Stationary(NamedTuple):
    """Alpha, beta and the zero sequence (mean of the phases), arrays of shape (N,)."""

    alpha: SingleArray
    beta: SingleArray
    zero: SingleArray


def phases(x: Stationary) -> Triple[SingleArray]:
    """Phase quantities of stationary coordinates."""
    y = clarke_inverse(SINGLE, Pair(x.alpha, x.beta))
    return Triple(y.a + x.zero, y.b + x.zero, y.c + x.zero)


def _larger(a: SingleArray, b: SingleArray) -> SingleArray:
    return np.where(a > b, a, b)


def _smaller(a: SingleArray, b: SingleArray) -> SingleArray:
    return np.where(a < b, a, b)


def _extremes(v: Triple[SingleArray], topology: Topology) -> tuple[SingleArray, SingleArray]:
    high, low = _larger(v.c, _larger(v.b, v.a)), _smaller(v.c, _smaller(v.b, v.a))
    if topology == "four-leg":
        high = np.where(high > _ZERO, high, _ZERO)
        low = np.where(low < _ZERO, low, _ZERO)
    return high, low


def _three_leg_need(voltage: Stationary, modulation: ModulationName) -> SingleArray:
    plane = Pair(voltage.alpha, voltage.beta)
    v = clarke_inverse(SINGLE, plane)
    high, low = _extremes(v, "three-wire")
    rule = MODULATORS[modulation]
    if rule.kind not in ("sine", "third-harmonic"):
        return high - low
    zero = np.zeros_like(v.a)
    if rule.kind == "third-harmonic":
        square = (plane.x * plane.x) + (plane.y * plane.y)
        there = square > _ZERO
        third = np.float32(4.0 * rule.share) * (((v.a * v.b) * v.c) / np.where(there, square, _ONE))
        zero = np.where(there, third, zero)
    high, low = high - zero, zero - low
    return np.float32(2.0) * _larger(high, low)


def _need(voltage: Stationary, topology: Topology, modulation: ModulationName) -> SingleArray:
    """DC-link voltage in V that phase voltages need."""
    if topology in ("three-wire", "diode-neutral"):
        return _three_leg_need(voltage, modulation)
    high, low = _extremes(phases(voltage), topology)
    if topology == "six-leg":
        return _larger(high, -low)
    return _HALF * (high - low) if topology == "six-leg-isolated" else high - low


def voltage_share(
    voltage: Stationary,
    part: SingleArray,
    v_dc: SingleArray,
    v_m: SingleArray | None,
    topology: Topology,
    modulation: ModulationName,
) -> SingleArray:
    """Share of a voltage that the DC link can make, up to 1; -1 where its samples make no sense.

    Args:
        voltage: In V.
        part: Share of the link that may be used.
        v_dc, v_m: DC-link voltage and midpoint above the negative rail in V, shape (N,).
        topology, modulation: How the phases are fed.
    """
    if v_m is None:
        most, need = part * v_dc, _need(voltage, topology, modulation)
        over = need > most
        share = np.where(over, most / np.where(over, need, _ONE), _ONE)
        return np.where(most >= _ZERO, share, -_ONE)
    above, below = part * (v_dc - v_m), part * v_m
    high, low = _extremes(phases(voltage), topology)
    over = high > above
    share = np.where(over, above / np.where(over, high, _ONE), _ONE)
    under = (-low * share) > below
    share = np.where(under, below / np.where(under, -low, _ONE), share)
    return np.where((above >= _ZERO) & (below >= _ZERO), share, -_ONE)


def _duty(x: SingleArray) -> SingleArray:
    within = np.where(x >= _ZERO, x, np.where(x < _ZERO, _ZERO, _HALF))
    return np.where(x > _ONE, _ONE, within)


def topology_duties(
    voltage: Stationary, v_dc: SingleArray, v_m: SingleArray | None, topology: Topology
) -> tuple[SingleArray, ...]:
    """Duty cycles of all legs in the order of their topology.

    Args:
        voltage: In V.
        v_dc, v_m: DC-link voltage and midpoint above the negative rail in V, shape (N,).
        topology: One with a neutral of its own, or with six legs.
    """
    v = phases(voltage)
    powered = v_dc > _ZERO
    scale = np.where(powered, _ONE / np.where(powered, v_dc, _ONE), _ZERO)
    if v_m is not None:
        return tuple(np.where(powered, _duty((phase + v_m) * scale), _HALF) for phase in v)
    half = _HALF * scale
    if topology == "six-leg":
        return (
            *(_duty(_HALF + (phase * half)) for phase in v),
            *(_duty(_HALF - (phase * half)) for phase in v),
        )
    high, low = _extremes(v, topology)
    offset = -_HALF * (high + low)
    if topology == "six-leg-isolated":
        return (
            *(_duty(_HALF + ((phase + offset) * half)) for phase in v),
            *(_duty(_HALF - ((phase + offset) * half)) for phase in v),
        )
    return (
        *(_duty(_HALF + ((phase + offset) * scale)) for phase in v),
        _duty(_HALF + (offset * scale)),
    )
