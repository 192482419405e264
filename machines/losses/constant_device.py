"""Losses and junction temperature of the inverter bridge.

Averages over an electrical period at each operating point; the ripple of the currents, the dead
time, the losses of the gate drivers and the rise and fall of the junction temperature within the
period are left out.

Sources: paper 000 (10) and (11), written with the peak current; A. M. Hava, R. J. Kerkman, T. A.
Lipo, "Simple analytical and graphical methods for carrier-based PWM-VSI drives", IEEE Transactions
on Power Electronics 14(1), 1999, doi:10.1109/63.737592 (switching loss of discontinuous
modulators).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.modulators import PhaseWaveforms, sector_waveforms
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.linear_range import overmodulation_of

# Junction temperature in degC at which `SwitchDevice.on_resistance` is given.
REFERENCE_TEMPERATURE = 25.0
SWITCH_POSITIONS = 6  # Switch positions of the bridge, which share its losses equally.

# Points evaluated at once: some ten arrays of 4096 x 24 angles x 3 phases are 24 MB.
_CHUNK = 4096


@dataclass(frozen=True, slots=True)
class BridgeLoad:
    """Losses of the bridge in W before its temperature is known, arrays of the shape (...).

    Args:
        threshold: Conduction loss that does not depend on temperature: threshold voltages, and the
            resistance of the diodes.
        resistive: Conduction loss in the on resistance of the transistors at 25 degC.
        switching: Switching loss.
    """

    threshold: FloatArray
    resistive: FloatArray
    switching: FloatArray


@dataclass(frozen=True, slots=True)
class BridgeLosses:
    """Losses of the bridge at its junction temperature, arrays of the shape (...).

    Args:
        conduction, switching: Losses of all six switch positions in W.
        junction_temperature: Average junction temperature of a switch position in degC.
        thermal_residual: Junction temperature minus the temperature that its losses lead to, in K.
        thermally_stable: False where there is no steady state (thermal runaway); conduction loss
            and temperature are NaN there.
    """

    conduction: FloatArray
    switching: FloatArray
    junction_temperature: FloatArray
    thermal_residual: FloatArray
    thermally_stable: BoolArray


def required_device(inverter: Inverter) -> SwitchDevice:
    """Device of the inverter; an `InputError` if the inverter has none."""
    if inverter.device is None:
        raise InputError(
            "inverter: losses need the data of the switches, but no device is given; add the "
            "device data"
        )
    return inverter.device


def resistance_factor(device: SwitchDevice, junction_temperature: FloatArray) -> FloatArray:
    """On resistance at a junction temperature in degC, any shape, relative to that at 25 degC:
    1 + alpha (T - 25).

    Args:
        device: The switch, with its temperature coefficient alpha in 1/K.
        junction_temperature: Temperature T in degC, any shape.
    """
    return 1.0 + device.on_resistance_temperature_coefficient * (
        junction_temperature - REFERENCE_TEMPERATURE
    )


def _mosfet_conduction(device: SwitchDevice, wave: PhaseWaveforms) -> tuple[FloatArray, FloatArray]:
    """Threshold and resistive conduction loss in W: one of the two channels of a phase
    always carries its current.
    """
    resistive = device.on_resistance * wave.phase_sum(wave.current**2)
    return np.zeros_like(resistive), resistive


def _igbt_conduction(device: SwitchDevice, wave: PhaseWaveforms) -> tuple[FloatArray, FloatArray]:
    """Threshold and resistive conduction loss in W: the transistor of one rail,
    the diode of the other.
    """
    duty = wave.modulation.duty
    share = np.where(wave.current > 0.0, duty, 1.0 - duty)
    magnitude, square = np.abs(wave.current), wave.current**2
    diode = device.diode_voltage * magnitude + device.diode_resistance * square
    threshold = wave.phase_sum(share * device.on_voltage * magnitude + (1.0 - share) * diode)
    return threshold, device.on_resistance * wave.phase_sum(share * square)


def _switching_loss(inverter: Inverter, device: SwitchDevice, wave: PhaseWaveforms) -> FloatArray:
    """Switching loss in W: one turn-on and one turn-off per carrier period and phase,
    while it is not clamped.
    """
    energy = (
        device.switching_energy
        / (device.reference_current * device.reference_voltage)
        * inverter.v_dc
    )
    return (
        inverter.f_sw
        * energy
        * wave.phase_sum(np.where(wave.modulation.clamped, 0.0, np.abs(wave.current)))
    )


def _chunk_load(inverter: Inverter, device: SwitchDevice, wave: PhaseWaveforms) -> FloatArray:
    """Threshold, resistive and switching loss in W as rows, shape (3, n) for n points."""
    conduction = _mosfet_conduction if device.kind == "mosfet" else _igbt_conduction
    return np.stack([*conduction(device, wave), _switching_loss(inverter, device, wave)])


def bridge_load(
    inverter: Inverter,
    modulation: ModulationName,
    v_d: ArrayLike,
    v_q: ArrayLike,
    i_d: ArrayLike,
    i_q: ArrayLike,
) -> BridgeLoad:
    """Conduction and switching losses of the bridge at 25 degC.

    ::

        MOSFET     P_cond = 3 R <i^2> = 3/2 R |i|^2
                   (synchronous rectification)
        IGBT       P_cond = 3 < s (V_CE0 |i| + r_CE i^2) + (1 - s) (V_F0 |i| + r_F i^2) >
                   with s = u where i > 0, and s = 1 - u elsewhere; u the duty cycle of the upper
                   switch
        switching  P_sw
                   = 3 f_sw (E_on + E_off + E_rr) / (I_ref V_ref) v_dc < |i|, 0 where clamped >

    where < > is the average over an electrical period, to rounding (`sector_waveforms`).

    Args:
        inverter: With the data of its device.
        modulation: The modulator.
        v_d, v_q, i_d, i_q: Phase voltages in V and currents in A in rotor coordinates (peak),
            broadcastable to the shape (...). Beyond the linear range of the modulator the
            conduction loss of an IGBT bridge has no meaning.

    Returns:
        Arrays of the shape (...).
    """
    device = required_device(inverter)
    points = np.broadcast_arrays(
        *(np.asarray(value, dtype=np.float64) for value in (v_d, v_q, i_d, i_q))
    )
    flat = np.stack([value.ravel() for value in points])
    method = overmodulation_of(inverter, modulation)
    chunks = []
    for start in range(0, max(flat.shape[1], 1), _CHUNK):
        part = flat[:, start : start + _CHUNK]
        wave = sector_waveforms(
            modulation, part[0], part[1], part[2], part[3], inverter.v_dc, method
        )
        chunks.append(_chunk_load(inverter, device, wave))
    load = np.concatenate(chunks, axis=-1).reshape(3, *points[0].shape)
    return BridgeLoad(threshold=load[0, ...], resistive=load[1, ...], switching=load[2, ...])


def junction_temperature(inverter: Inverter, loss: FloatArray) -> FloatArray:
    """Junction temperature in degC for inverter losses in W, any shape: T_coolant + R_th P / 6.

    Args:
        inverter: Temperature of the coolant and thermal resistance of a switch.
        loss: Losses P of the whole inverter in W, any shape.
    """
    device = required_device(inverter)
    return inverter.coolant_temperature + device.thermal_resistance / SWITCH_POSITIONS * loss


def thermal_gain(inverter: Inverter, load: BridgeLoad) -> FloatArray:
    """Rise of the junction temperature per kelvin of its rise, R_th / 6 alpha P_resistive,
    shape (...).

    Each kelvin raises the losses, which raise the temperature by this many kelvins again:
    from 1 on it runs away.

    Args:
        inverter: Thermal resistance R_th in K/W and temperature coefficient alpha in 1/K.
        load: Loss of the resistances in W among the losses of the bridge, shape (...).
    """
    device = required_device(inverter)
    alpha = device.on_resistance_temperature_coefficient
    return device.thermal_resistance / SWITCH_POSITIONS * alpha * load.resistive


def thermal_balance(inverter: Inverter, load: BridgeLoad) -> BridgeLosses:
    """Losses at the junction temperature that they lead to.

    The on resistance is linear in the temperature, so that the fixed point of

        T = T_coolant + R_th / 6 (P_threshold + P_switching + P_resistive (1 + alpha (T - 25)))

    is found in one step. Each of the six positions is given a sixth of the losses and its
    own `thermal_resistance`.

    Args:
        inverter: With the data of its device.
        load: Losses at 25 degC from `bridge_load`, arrays of the shape (...).

    Returns:
        Arrays of the shape (...).
    """
    device = required_device(inverter)
    at_reference = junction_temperature(inverter, load.threshold + load.resistive + load.switching)
    gain = thermal_gain(inverter, load)
    stable = np.asarray(gain < 1.0)
    rise = (at_reference - REFERENCE_TEMPERATURE) / np.where(stable, 1.0 - gain, 1.0)
    temperature = np.where(stable, REFERENCE_TEMPERATURE + rise, np.nan)
    conduction = load.threshold + load.resistive * resistance_factor(device, temperature)
    return BridgeLosses(
        conduction=np.asarray(conduction),
        switching=load.switching,
        junction_temperature=temperature,
        thermal_residual=temperature - junction_temperature(inverter, conduction + load.switching),
        thermally_stable=stable,
    )
