"""Losses of a bridge from device tables, averaged over an electrical period,
whole arrays of points at once.

Averages depend on the waveforms and on the temperatures of the tables, not on the carrier
frequency: they are taken once per point and modulator, at every temperature of the tables, and the
balance of heat then interpolates in the temperature for any number of frequencies.

Sources: docs/methods/loss-budget.md; DC-link current: J. W. Kolar, S. D. Round, "Analytical
calculation of
the RMS current stress on the DC-link capacitor of voltage-PWM converter systems", IEE Proceedings -
Electric Power Applications 153(4), 2006, doi:10.1049/ip-epa:20050458 (of which this is the general
form, for any modulator).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.losses.bridge_tables import BridgeTables
from dqforge.machines.modulation.modulators import PhaseWaveforms, sector_waveforms
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.modulation.ripple import ripple_squares
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.records import dataclass

# Points at once: each array of 1024 x 24 angles x 3 phases is 0.6 MB,
# so that a handful stays in the cache.
_CHUNK = 1024


@dataclass(frozen=True, slots=True)
class BridgeAverages:
    """Averages over an electrical period at N points, for one modulator.

    The first three have the shape (2, J, K, N): upper and lower position; junction of the
    transistor and, where the diode has its own, of the diode; temperature of the tables. They are
    those of one switch position.

    Args:
        conduction: Conduction loss in W without dead time.
        switching: Energy in J of all events in a carrier period.
        dead: Loss in W that dead time adds, for the share of 1 of the carrier period in each gap.
        dc_current, dc_square: Mean in A and mean square in A^2 of the current from the DC link,
            shape (N,).
        switched: Sum over the phases of the mean magnitude of current in A while the phase
            switches, shape (N,).
        ripple: Mean square of the ripple of a phase current in A^2 for v_dc / f_sw = 1 V s, shape
            (N,).
    """

    conduction: FloatArray
    switching: FloatArray
    dead: FloatArray
    dc_current: FloatArray
    dc_square: FloatArray
    switched: FloatArray
    ripple: FloatArray


def _shares(wave: PhaseWaveforms, *, one_rail: bool) -> dict[str, FloatArray]:
    """Weights (S, n, angles, legs) of what flows or switches where, for S positions:
    one stands for two that are alike.

    ``own`` is the share of the carrier period in which a position carries its transistor's current,
    ``back`` in which it carries current backwards; ``events`` and ``recoveries`` are one where it
    switches, or its diode recovers.
    """
    weight = wave.weight[..., None] / wave.current.shape[-1]
    duty = np.clip(wave.modulation.duty, 0.0, 1.0)
    ahead = wave.current >= 0.0
    free = weight * ~wave.modulation.clamped
    upper = {"own": weight * duty * ahead, "back": weight * duty * ~ahead, "events": free * ahead}
    off = weight * (1.0 - duty)
    lower = {"own": off * ~ahead, "back": off * ahead, "events": free * ~ahead}
    upper["recoveries"], lower["recoveries"] = lower["events"], upper["events"]
    if one_rail:
        return {name: np.stack([upper[name], lower[name]]) for name in upper}
    return {name: 0.5 * (upper[name] + lower[name])[None] for name in upper}


def _mean(shares: FloatArray, values: FloatArray) -> FloatArray:
    """Weighted sums (S, K, n) of values (K, n, angles, legs) with shares (S, n, angles, legs)."""
    count = shares.shape[1]
    left = shares.reshape(shares.shape[0], 1, count, 1, -1)
    right = values.reshape(1, values.shape[0], count, -1, 1)
    return np.asarray((left @ right)[..., 0, 0])


def junction_losses(tables: BridgeTables, wave: PhaseWaveforms, *, one_rail: bool) -> FloatArray:
    """Conduction, switching and dead time (rows) of transistor and diode, shape (3, S, 2, K, n).

    The mean over the half bridges of the waveforms, three of them or any number: conduction in W,
    energies of all events of a carrier period in J, and W for the share of 1 in each gap, as in
    `BridgeAverages`.

    Args:
        tables: The device, K temperatures.
        wave: Duty cycles and currents of n points, the half bridges along the last axis.
        one_rail: Whether upper and lower positions differ (S = 2); else one stands for both (S =
            1).
    """
    share = _shares(wave, one_rail=one_rail)
    size = np.abs(wave.current)
    channel = tables.channel.at(size) * size
    diode = None if tables.diode is None else tables.diode.at(size) * size
    zero = np.zeros((share["own"].shape[0], channel.shape[0], size.shape[0]))
    switching, recovery = _mean(share["events"], tables.switching.at(size)), zero
    if np.any(tables.recovery.value):
        recovery = _mean(share["recoveries"], tables.recovery.at(size))
    if not tables.synchronous:
        assert diode is not None  # an IGBT has one
        own, back = _mean(share["own"], channel), _mean(share["back"], diode)
        # With the references as voltages that are made, dead time only says
        # which switch turns on later.
        return np.stack(
            [np.stack(part, axis=1) for part in ((own, back), (switching, recovery), (zero, zero))]
        )
    conduction = _mean(share["own"] + share["back"], channel)
    added, removed = zero, zero
    if diode is not None:
        # Both gaps of a carrier period fall to the position that carries the current backwards.
        added, removed = (
            2.0 * _mean(share["recoveries"], diode),
            2.0 * _mean(share["recoveries"], channel),
        )
    parts = ((conduction, zero), (switching, recovery), (-removed, added))
    return np.stack([np.stack(part, axis=1) for part in parts])


def _link(wave: PhaseWaveforms) -> FloatArray:
    """Mean, mean square of the DC-link current, and sum of the switched magnitudes, shape (3, n).

    Centred pulses overlap, so that two phases are on together for the smaller of their duty cycles.
    """
    duty, current = np.clip(wave.modulation.duty, 0.0, 1.0), wave.current
    mean = wave.phase_sum(duty * current)
    square = duty * current**2
    turned = np.roll(duty, -1, axis=-1), np.roll(current, -1, axis=-1)
    square = square + 2.0 * np.minimum(duty, turned[0]) * current * turned[1]
    switched = wave.phase_sum(np.where(wave.modulation.clamped, 0.0, np.abs(current)))
    return np.stack([mean, wave.phase_sum(square), switched])


def bridge_averages(
    tables: BridgeTables,
    modulation: ModulationName,
    voltage: FloatArray,
    current: FloatArray,
    v_dc: float,
    stiffness: FloatArray | None = None,
    overmodulation: OvermodulationName = "none",
    energy_factors: FloatArray | None = None,
) -> BridgeAverages:
    """Averages of losses, DC-link current and ripple over an electrical period.

    Args:
        tables: The device.
        modulation: The modulator.
        voltage, current: Phase voltages in V and currents in A in rotor coordinates (peak), shape
            (2, N) each. Duty cycles beyond the linear range are saturated: what is said there has
            no meaning.
        v_dc: DC-link voltage in V.
        stiffness: Inverse of the incremental inductances in 1/H, shape (N, 2, 2), for the ripple;
            None leaves it zero.
        overmodulation: What becomes of voltages beyond the circle in the hexagon, where duty cycles
            saturate else.
        energy_factors: Energies of the transistors' events and of the recoveries over those of the
            tables, shape (2, N); None for one.

    Returns:
        BridgeAverages
    """
    one_rail, count = MODULATORS[modulation].one_rail, voltage.shape[1]
    junctions = 2 if tables.separate_diode else 1
    losses = np.empty((3, 2, junctions, tables.temperatures.size, count))
    link, ripple = np.empty((3, count)), np.zeros(count)
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        v_d, v_q = voltage[:, part]
        i_d, i_q = current[:, part]
        wave = sector_waveforms(modulation, v_d, v_q, i_d, i_q, v_dc, overmodulation)
        found = junction_losses(tables, wave, one_rail=one_rail)
        if energy_factors is not None:
            found[1] *= energy_factors[:, None, part]
        losses[..., part] = found if tables.separate_diode else np.sum(found, axis=2, keepdims=True)
        link[:, part] = _link(wave)
        if stiffness is not None:
            ripple[part] = 0.5 * np.sum(ripple_squares(wave, stiffness[part]), axis=-1)
    return BridgeAverages(losses[0], losses[1], losses[2], link[0], link[1], link[2], ripple)
