"""Switching energies of a device from the total loss that was measured at one point.

Source: paper 000, section 3 and Table 4, with the corrections on docs/methods/loss-budget.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.devices.switch import SwitchDevice
from dqforge.machines.dq_machines.synchronous import Machine, copper_loss
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.constant_device import (
    bridge_load,
    junction_temperature,
    required_device,
    resistance_factor,
    thermal_gain,
)
from dqforge.machines.names import ModulationName
from dqforge.machines.topologies.linear_range import amplitude_fits, amplitude_limit


def calibrate_switching(
    total_loss: float,
    machine: Machine,
    inverter: Inverter,
    i_d: float,
    i_q: float,
    omega_m: float,
    modulation: ModulationName,
) -> SwitchDevice:
    """Scale the switching energies of a device so that the total loss at one measured point is met.

    Args:
        total_loss: Measured copper plus inverter loss in W at the point.
        machine, inverter: The drive; the inverter with the data of its device.
        i_d, i_q, omega_m, modulation: The measured point: currents in A (peak), mechanical speed in
            rad/s, and its modulator.

    Returns:
        The device with all three switching energies multiplied by one factor.

    Raises:
        InputError: Where the measurement contradicts the other data.
        NoSolutionError: At thermal runaway, whatever the switching energies.
    """
    device = required_device(inverter)
    currents = np.array([i_d], dtype=np.float64), np.array([i_q], dtype=np.float64)
    omega = np.array([omega_m], dtype=np.float64)
    voltage = machine.voltage(*currents, machine.pole_pairs * omega)
    _check_measured_voltage(inverter, float(np.hypot(*voltage)[0]), modulation)
    load = bridge_load(inverter, modulation, *voltage, *currents)
    _refuse_runaway(machine, omega, *currents, thermal_gain(inverter, load))
    copper = copper_loss(machine.r_s, *currents)
    temperature = junction_temperature(inverter, total_loss - copper)
    conduction = load.threshold + load.resistive * resistance_factor(device, temperature)
    return _scaled_device(
        device, total_loss, float(copper[0]), float(conduction[0]), float(load.switching[0])
    )


def _check_measured_voltage(
    inverter: Inverter, amplitude: float, modulation: ModulationName
) -> None:
    if not amplitude_fits(inverter, modulation, amplitude):
        raise InputError(
            f"calibration: the measured point needs a phase voltage of {amplitude:.4g} V (peak), "
            f"but {modulation} makes at most {amplitude_limit(inverter, modulation):.4g} V from "
            f"{inverter.v_dc:.4g} V"
        )


def _scaled_device(
    device: SwitchDevice, total_loss: float, copper: float, conduction: float, switching: float
) -> SwitchDevice:
    """Scale the energies of the device so that its switching loss, now `switching`,
    makes up the total; all in W.
    """
    remainder = total_loss - copper - conduction
    if remainder < 0.0:
        raise InputError(
            f"calibration: the measured total loss of {total_loss:.4g} W is below the copper loss "
            f"of {copper:.4g} W plus the conduction loss of {conduction:.4g} W; check R_s, "
            "R_DS(on) and the currents"
        )
    if switching <= 0.0:
        raise InputError(
            "calibration: the device has no switching loss at the measured point, so that its "
            "energies cannot be scaled; give switching energies above zero, and a point with "
            "current"
        )
    factor = remainder / switching
    return replace(
        device,
        turn_on_energy=device.turn_on_energy * factor,
        turn_off_energy=device.turn_off_energy * factor,
        reverse_recovery_energy=device.reverse_recovery_energy * factor,
    )


def _refuse_runaway(
    machine: Machine, omega_m: FloatArray, i_d: FloatArray, i_q: FloatArray, gain: FloatArray
) -> None:
    if not np.all(np.isfinite(gain) & np.isfinite(omega_m)):
        raise InputError("calibration: currents and speeds must be finite numbers")
    if np.all(gain < 1.0):
        return
    worst = np.unravel_index(np.argmax(gain), gain.shape)
    raise NoSolutionError(
        f"thermal runaway at {machine.torque(i_d, i_q)[worst]:.4g} N m and {omega_m[worst]:.4g} "
        f"rad/s ({np.hypot(i_d, i_q)[worst]:.4g} A): each kelvin at the junction adds losses that "
        f"heat it by {gain[worst]:.3g} K more, so that no temperature is steady "
        f"({np.count_nonzero(gain >= 1.0)} of {gain.size} points); lower the current, the thermal "
        "resistance or the on resistance"
    )
