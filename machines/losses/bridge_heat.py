"""Balance of heat of a switch position: junction temperatures at which its losses leave it,
and runaway.

Losses are straight between the temperatures of the device tables and carried on beyond them, so
that the balance of one junction is solved exactly, piece by piece, from the cold side. Where
transistor and diode have junctions of their own behind a common path, the two are solved in turn
until both stand still.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.losses.bridge_tables import BridgeTables
from dqforge.machines.records import dataclass

_SWEEPS = 200
_STILL = 1e-10  # Largest change in K of a last sweep.
_HOTTEST = 1e9  # Temperature in degC beyond which a junction is said to run away.


@dataclass(frozen=True, slots=True)
class JunctionBalance:
    """Steady junctions of upper and lower position, J junctions each, at points of the shape (...).

    Args:
        temperature: In degC, shape (2, J, ...); NaN where a junction runs away.
        residual: Temperature minus the one that its losses lead to, in K, shape (2, J, ...).
        steady: False where a junction runs away, shape (...).
    """

    temperature: FloatArray
    residual: FloatArray
    steady: BoolArray


def at_temperature(knots: FloatArray, values: FloatArray, temperature: FloatArray) -> FloatArray:
    """Values (..., K, *points) between the K temperatures, carried on beyond them,
    at temperatures (..., *points).

    Args:
        knots: Temperatures in degC, shape (K,), ascending.
        values: With the axis of temperatures third, shape (2, J, K, *points).
        temperature: In degC, shape (2, J, *points).
    """
    if knots.size == 1:
        return np.asarray(np.broadcast_to(values[:, :, 0], temperature.shape))
    found = np.array(np.broadcast_to(values[:, :, 0], temperature.shape))
    steps = np.diff(values, axis=2)
    for k, width in enumerate(np.diff(knots)):
        low = -np.inf if k == 0 else knots[k]
        high = np.inf if k == knots.size - 2 else knots[k + 1]
        # NaN temperatures stay NaN.
        share = (np.minimum(np.maximum(temperature, low), high) - knots[k]) / width
        found += share * steps[:, :, k]
    return found


def _root(
    knots: FloatArray, loss: FloatArray, base: FloatArray, resistance: float
) -> tuple[FloatArray, BoolArray]:
    """Least T with T = base + R P(T), and whether there is one.

    Loss (2, K, *points) in W, base (2, *points).
    """
    if knots.size == 1:
        found = base + resistance * loss[:, 0]
        return found, np.ones(found.shape, dtype=np.bool_)
    above = base[:, None] + resistance * loss - knots.reshape(1, -1, *[1] * (base.ndim - 1))
    met = above[:, 1:] <= 0.0
    last = knots.size - 2
    piece = np.where(np.any(met, axis=1), np.argmax(met, axis=1), last)[:, None]
    start, end = (np.take_along_axis(above, piece + k, axis=1)[:, 0] for k in (0, 1))
    low, width = knots[piece[:, 0]], np.diff(knots)[piece[:, 0]]
    # h(T) falls from `start` to `end` over the piece; 1 - R dP/dT is its slope.
    slope = (start - end) / width
    steady = np.asarray(slope > 0.0)
    return low + start / np.where(steady, slope, 1.0), steady


def junction_balance(tables: BridgeTables, loss: FloatArray) -> JunctionBalance:
    """Junction temperatures of losses that depend on them.

    Args:
        tables: The device, with its thermal resistances.
        loss: Losses in W of the junctions of one position at the temperatures of the tables, shape
            (2, J, K, *points).

    Returns:
        The steady state that a junction reaches when it warms up from the coolant: the coldest one.
    """
    knots, coolant = tables.temperatures, tables.coolant_temperature
    *own, shared = tables.resistances
    shape = (*loss.shape[:2], *loss.shape[3:])
    temperature = np.full(shape, coolant)
    steady = np.ones(shape[2:], dtype=np.bool_)
    power = np.zeros(shape)
    for _ in range(_SWEEPS if len(own) > 1 else 1):
        before = temperature.copy()
        for j, resistance in enumerate(own):
            others = sum(
                (power[:, k] for k in range(len(own)) if k != j), np.zeros_like(power[:, j])
            )
            found, held = _root(knots, loss[:, j], coolant + shared * others, resistance + shared)
            steady &= np.all(held & (np.abs(found) < _HOTTEST), axis=0)
            temperature[:, j] = np.where(steady, found, coolant)
            power[:, j] = at_temperature(knots, loss[:, j : j + 1], temperature[:, j : j + 1])[:, 0]
        moved = np.max(np.abs(temperature - before), axis=(0, 1))
        if np.all(moved <= _STILL):
            break
    else:
        # What still moves after so many sweeps does not settle.
        steady &= (moved <= 1e6 * _STILL) if len(own) > 1 else True
    total = shared * np.sum(power, axis=1, keepdims=True)
    residual = (
        temperature
        - coolant
        - total
        - power * np.array(own).reshape(1, -1, *[1] * (power.ndim - 2))
    )
    return JunctionBalance(
        np.where(steady, temperature, np.nan),
        np.where(steady, residual, np.nan),
        np.asarray(steady),
    )
