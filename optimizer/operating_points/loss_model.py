"""Total loss of a drive: as coefficients that the batched solver minimises,
and as a budget at given currents.

The solver needs the loss as P = a |i|^2 + b |i| + c |psi|^2 with coefficients that depend on the
speed alone. Copper, iron, the channels of MOSFETs and the switching loss of continuous modulators
have exactly this form; what an IGBT bridge and discontinuous modulators add to it is said at
`loss_coefficients`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine, copper_loss
from dqforge.machines.losses.constant_device import (
    REFERENCE_TEMPERATURE,
    bridge_load,
    required_device,
    resistance_factor,
    thermal_balance,
)
from dqforge.machines.losses.machine_loss import NO_EXTRA_LOSS, MachineLoss
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.linear_range import amplitude_fits
from dqforge.optimizer.operating_points.local_terms import LossCoefficients

_MEAN_OF_RECTIFIED_SINE = 2.0 / math.pi


@dataclass(frozen=True, slots=True)
class DriveLosses:
    """Losses of machine and inverter in W at operating points, arrays of one shape.

    Without device data ``conduction`` and ``switching`` are zero and ``with_inverter`` is False.
    Where the junction runs away ``conduction``, ``junction_temperature`` (degC) and ``total`` are
    NaN.
    """

    copper: FloatArray
    iron: FloatArray
    conduction: FloatArray
    switching: FloatArray
    junction_temperature: FloatArray
    total: FloatArray
    with_inverter: bool


def loss_coefficients(
    machine: Machine,
    omega_m: ArrayLike,
    inverter: Inverter | None = None,
    *,
    extra: MachineLoss = NO_EXTRA_LOSS,
    modulation: ModulationName = "svpwm",
    junction_temperature: float = REFERENCE_TEMPERATURE,
) -> LossCoefficients:
    """Total loss of the drive as the batched solver minimises it.

    ::

        square  3/2 R (1 + k_ac omega_e^2)  +  3/2 R_on (MOSFET)  or  3/4 (r_CE + r_F) (IGBT)
        linear  6/pi f_sw (E_on + E_off + E_rr) v_dc / (I_ref V_ref)  +  3/pi (V_CE0 + V_F0) (IGBT)
        iron    k_h |omega_e| + k_c omega_e^2

    Args:
        machine: Any machine.
        omega_m: Mechanical speed in rad/s of each point, shape (N,) or broadcastable to the points
            that are solved.
        inverter: None, or an inverter without device, leaves the inverter out.
        extra: AC copper and iron loss.
        modulation: The modulator; only its share of switched current matters.
        junction_temperature: In degC, at which the on resistance of the transistors is taken.

    Returns:
        Arrays of the shape of ``omega_m``.

    Notes:
        Exact for MOSFETs with continuous modulators, and for IGBTs whose diode has the transistor's
        parameters. Transistor and diode of an IGBT bridge share the current evenly here; what the
        duty cycle shifts between them is in truth 3/2 |v| |i| cos(phi) (V_CE0 - V_F0) / v_dc, and
        likewise for the resistances. GDPWM and DDT-GDPWM switch half of the rectified current where
        the load angle is within 30 degrees of 0 or 180, and more beyond. The other discontinuous
        modulators count with two thirds, the mean over all load angles; in truth their share
        depends on the load angle (`dqforge.machines.modulation.clamping.switching_loss_factor`).
    """
    omega_e = machine.pole_pairs * np.asarray(omega_m, dtype=np.float64)
    square = 1.5 * machine.r_s * extra.copper_factor(omega_e)
    linear = np.zeros_like(omega_e)
    if inverter is not None and inverter.device is not None:
        on, threshold = _conduction(inverter, junction_temperature)
        square = square + on
        linear = linear + threshold + _switching(inverter, modulation)
    return LossCoefficients(
        np.asarray(square), np.asarray(linear), np.asarray(extra.iron_factor(omega_e))
    )


def _conduction(inverter: Inverter, junction_temperature: float) -> tuple[float, float]:
    """Conduction loss over |i|^2 in W/A^2 and over |i| in W/A."""
    device = required_device(inverter)
    channel = device.on_resistance * float(
        resistance_factor(device, np.asarray(junction_temperature))
    )
    if device.kind == "mosfet":
        return 1.5 * channel, 0.0
    threshold = 0.5 * (device.on_voltage + device.diode_voltage)
    return 0.75 * (channel + device.diode_resistance), 3.0 * _MEAN_OF_RECTIFIED_SINE * threshold


def _switching(inverter: Inverter, modulation: ModulationName) -> float:
    """Switching loss over |i| in W/A."""
    device = required_device(inverter)
    energy = (
        device.switching_energy
        / (device.reference_current * device.reference_voltage)
        * inverter.v_dc
    )
    return (
        3.0
        * inverter.f_sw
        * energy
        * _MEAN_OF_RECTIFIED_SINE
        * MODULATORS[modulation].mean_loss_factor
    )


def drive_losses(
    machine: Machine,
    inverter: Inverter,
    i_d: FloatArray,
    i_q: FloatArray,
    omega_m: FloatArray,
    *,
    modulation: ModulationName = "svpwm",
    extra: MachineLoss = NO_EXTRA_LOSS,
) -> DriveLosses:
    """Losses at operating points of any machine, the junction temperature in balance.

    Args:
        machine, inverter: The drive.
        i_d, i_q, omega_m: Currents in A (peak) and mechanical speed in rad/s, arrays of one shape.
        modulation: The modulator.
        extra: AC copper and iron loss of the machine.

    Notes:
        Beyond the modulator's linear range the conduction loss of an IGBT bridge is NaN: it has no
        meaning there.
    """
    omega_e = machine.pole_pairs * omega_m
    psi_d, psi_q = machine.flux(i_d, i_q)
    copper = copper_loss(machine.r_s, i_d, i_q) * extra.copper_factor(omega_e)
    iron = extra.iron_factor(omega_e) * (psi_d * psi_d + psi_q * psi_q)
    if inverter.device is None:
        zero, unknown = np.zeros_like(copper), np.full_like(copper, np.nan)
        return DriveLosses(copper, iron, zero, zero, unknown, copper + iron, with_inverter=False)
    v_d, v_q = machine.r_s * i_d - omega_e * psi_q, machine.r_s * i_q + omega_e * psi_d
    bridge = thermal_balance(inverter, bridge_load(inverter, modulation, v_d, v_q, i_d, i_q))
    known = amplitude_fits(inverter, modulation, np.hypot(v_d, v_q) * (1.0 - 1e-9))
    known |= inverter.device.kind == "mosfet"
    conduction = np.where(known, bridge.conduction, np.nan)
    total = copper + iron + conduction + bridge.switching
    return DriveLosses(
        copper,
        iron,
        conduction,
        bridge.switching,
        bridge.junction_temperature,
        total,
        with_inverter=True,
    )
