"""Which phase voltages a topology makes without overmodulation, as linear inequalities.

::

    three-wire, diode-neutral   v_j - v_k <= V_dc
    four-leg                    max - min of {v_a, v_b, v_c, 0} <= V_dc
    six-leg                     |v_k| <= V_dc
    six-leg-isolated            v_j - v_k <= 2 V_dc     (two links of V_dc each)
    split-capacitor             -v_m <= v_k <= V_dc - v_m

v_m is the voltage of the midpoint from the negative rail, V_dc / 2 where nothing moves it. Source:
paper 002, chapter 5. These are all voltages that the switching states span, not only those of one
modulator (tests hold them against the convex hulls of all states).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import Topology
from dqforge.machines.topologies.topology import TOPOLOGIES

# Rows on the three phase voltages: each of them, and the differences between them.
VOLTAGE_ROWS = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, -1.0, 0.0],
        [0.0, 1.0, -1.0],
        [-1.0, 0.0, 1.0],
    ]
)


def largest_phase_voltage(topology: Topology, v_dc: float) -> float:
    """Largest voltage of a phase in V that a voltage vector of the topology makes.

    Two thirds of the largest difference where the neutral is not driven; a split link is taken
    with its midpoint anywhere, as far as three legs without it reach.

    Args:
        topology: The topology.
        v_dc: DC-link voltage in V.
    """
    rule = TOPOLOGIES[topology]
    if rule.neutral and not rule.midpoint:
        return v_dc
    return 2.0 / 3.0 * (rule.between or 1.0) * v_dc


def voltage_bounds(
    topology: Topology, v_dc: ArrayLike = 1.0, v_m: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """Bounds low <= VOLTAGE_ROWS v <= high in V, each of shape (..., 6); infinite where there are
    none.

    Args:
        topology: The topology.
        v_dc: DC-link voltage in V, shape (...).
        v_m: Midpoint of a split link from the negative rail in V, broadcastable; half the link
            where it is not given. Others have none.
    """
    rule, link = TOPOLOGIES[topology], np.asarray(v_dc, dtype=np.float64)[..., np.newaxis]
    shares = [math.inf if share is None else share for share in (rule.phase, rule.between)]
    high = np.concatenate([link * shares[0] * np.ones(3), link * shares[1] * np.ones(3)], axis=-1)
    low = -high
    if rule.midpoint and v_m is not None:
        below = np.asarray(v_m, dtype=np.float64)[..., np.newaxis]
        low, high, below, link = np.broadcast_arrays(low, high, below, link)
        phases = np.arange(6) < 3
        low, high = np.where(phases, -below, low), np.where(phases, link - below, high)
    return low, high


def link_demand(voltages: FloatArray, topology: Topology) -> FloatArray:
    """Least dc-link voltage in V, shape (...), that phase voltages over a period need.

    Args:
        voltages: Phase voltages in V, shape (..., 3, N).
        topology: The topology. A split link counts in halves; of two isolated links it is each
            one's.
    """
    rule, demands = TOPOLOGIES[topology], []
    if rule.phase is not None:
        demands.append(np.max(np.abs(voltages), axis=(-2, -1)) / rule.phase)
    if rule.between is not None:
        between = np.max(voltages, axis=-2) - np.min(voltages, axis=-2)
        demands.append(np.max(between, axis=-1) / rule.between)
    return np.asarray(np.max(demands, axis=0))


def voltage_reach(
    voltages: FloatArray, topology: Topology, v_dc: ArrayLike, v_m: ArrayLike | None = None
) -> FloatArray:
    """Largest multiple of phase voltages that is within the region, shape (...); infinite for
    those that make no difference.

    Args:
        voltages: Phase voltages in V, shape (..., 3).
        topology, v_dc, v_m: As of `voltage_bounds`.
    """
    rows = voltages @ VOLTAGE_ROWS.T
    low, high = voltage_bounds(topology, v_dc, v_m)
    bound = np.where(rows > 0.0, high, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        multiples = np.where(rows == 0.0, math.inf, bound / rows)
    return np.asarray(np.min(multiples, axis=-1))


def sine_share(topology: Topology) -> float:
    """Largest amplitude of sinusoidal phase voltages over the link's voltage.

    Args:
        topology: The topology.
    """
    rule = TOPOLOGIES[topology]
    single = math.inf if rule.phase is None else rule.phase
    return min(single, math.inf if rule.between is None else rule.between / math.sqrt(3.0))
