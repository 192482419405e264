"""Junction temperatures over time: exact response of Foster networks to losses that are
constant in each interval.

Each element obeys tau dx/dt = R P - x, so that over an interval of length h

    x(h) = x(0) a + R P (1 - a),   mean x = R P + (x(0) - R P) (1 - a) tau / h,   a = exp(-h / tau)

A whole mission is one chain of such affine maps. The chain is composed by doubling, log2 N steps
over whole arrays, and the state with which a repeated mission begins is the fixed point of all maps
together.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.devices.thermal_network import CauerNetwork, ThermalNetwork
from dqforge.machines.losses.bridge_heat import at_temperature
from dqforge.machines.losses.bridge_tables import BridgeTables
from dqforge.machines.records import dataclass

_SWEEPS = 300


_STILL = 1e-7


_HOTTEST = 1e6


@dataclass(frozen=True, slots=True)
class JunctionNetworks:
    """Foster elements of J junctions: resistances in K/W and time constants in s, shape (J, E);
    zeros fill up.

    ``shared`` in K/W lies behind all junctions of a position and has no capacity.
    """

    resistances: FloatArray
    time_constants: FloatArray
    shared: float


@dataclass(frozen=True, slots=True)
class JunctionHistory:
    """Temperatures of one position pair over N intervals, in degC.

    Args:
        start, mean, end: At the start of each interval (with its loss on), on the average and at
            its end, shape (2, J, N).
        steady: Whether the temperatures settled; if not, they ran away and are NaN.
    """

    start: FloatArray
    mean: FloatArray
    end: FloatArray
    steady: bool


def _elements(network: ThermalNetwork | None, total: float) -> tuple[list[float], list[float]]:
    """Elements of one junction whose resistances make `total` K/W.

    What the network leaves has no capacity; a network with more than the
    total is made smaller alike.
    """
    if network is None:
        return [total], [0.0]
    foster = network.foster() if isinstance(network, CauerNetwork) else network
    scale = min(1.0, total / foster.resistance)
    resistances = [scale * part for part in foster.resistances]
    rest = max(total - scale * foster.resistance, 0.0)
    return [*resistances, rest], [*foster.time_constants, 0.0]


def junction_networks(inverter: Inverter, tables: BridgeTables) -> JunctionNetworks:
    """Networks of the inverter's device; without data of its own each junction
    follows its loss at once.

    Args:
        inverter: Device and coolant.
        tables: Tables of the bridge, for devices without thermal data of their own.
    """
    model = inverter.device_model
    *own, shared = tables.resistances
    given = [None] * len(own) if model is None else [model.thermal, model.diode_thermal][: len(own)]
    parts = [_elements(network, total) for network, total in zip(given, own, strict=True)]
    size = max(len(resistances) for resistances, _ in parts)
    padded = [[side + [0.0] * (size - len(side)) for side in part] for part in parts]
    array = np.array(padded)
    return JunctionNetworks(array[:, 0], array[:, 1], shared)


def _states(decay: FloatArray, drive: FloatArray, *, repeated: bool) -> FloatArray:
    """States at the starts of all intervals for x -> decay x + drive, last axis N."""
    through, added, step = decay.copy(), drive.copy(), 1
    count = decay.shape[-1]
    while step < count:
        # Maps of 2 step intervals from those of step; each place takes what lies before it.
        added[..., step:] = through[..., step:] * added[..., :-step] + added[..., step:]
        through[..., step:] = through[..., step:] * through[..., :-step]
        step *= 2
    first = np.zeros(decay.shape[:-1])
    if repeated:
        first = added[..., -1] / (1.0 - through[..., -1])
    ends = through * first[..., None] + added
    return np.concatenate([first[..., None], ends[..., :-1]], axis=-1)


def junction_history(
    tables: BridgeTables,
    networks: JunctionNetworks,
    loss: FloatArray,
    length: FloatArray,
    *,
    repeated: bool = True,
) -> JunctionHistory:
    """Temperatures over a mission, with losses that follow the mean temperature of each interval.

    Args:
        tables, networks: The device.
        loss: Losses in W of the junctions at the temperatures of the tables, shape (2, J, K, N).
        length: Lengths of the intervals in s, shape (N,).
        repeated: Whether the mission follows itself without end, so that it ends as warm as it
            begins; else it begins at the coolant's temperature.
    """
    coolant = tables.coolant_temperature
    resistance, tau = networks.resistances[:, :, None], networks.time_constants[:, :, None]
    ratio = length / np.where(tau > 0.0, tau, 1.0)
    decay = np.where(tau > 0.0, np.exp(-ratio), 0.0)
    # Mean over the interval of what decays from one: (1 - a) tau / h.
    fading = np.where(tau > 0.0, -np.expm1(-ratio) / ratio, 0.0)
    shape = (*loss.shape[:2], loss.shape[-1])
    mean = np.full(shape, coolant)
    wide = (shape[0], *decay.shape)
    settled, start, end = False, mean, mean
    for _ in range(_SWEEPS):
        power = at_temperature(tables.temperatures, loss, mean)
        level = resistance * power[:, :, None]
        state = _states(np.broadcast_to(decay, wide), level * (1.0 - decay), repeated=repeated)
        base = coolant + networks.shared * np.sum(power, axis=1, keepdims=True)
        held = np.where(tau > 0.0, state, level)
        start = base + np.sum(held, axis=2)
        end = base + np.sum(level + (held - level) * decay, axis=2)
        found = base + np.sum(level + (held - level) * fading, axis=2)
        moved = float(np.max(np.abs(found - mean)))
        mean = found
        settled = moved <= _STILL
        if settled or not np.max(np.abs(mean)) < _HOTTEST:
            break
    if not settled:
        start, mean, end = (np.full(shape, np.nan) for _ in range(3))
    return JunctionHistory(start, mean, end, settled)
