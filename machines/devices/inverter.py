"""The inverter and its devices: what is bolted to the heat sink, in SI units."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.devices.current_sensing import CurrentSensing
from dqforge.machines.devices.switch import SwitchDevice
from dqforge.machines.names import OvermodulationName, Topology
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.devices.device import DeviceModel


@dataclass(frozen=True, slots=True)
class Inverter:
    """A two-level voltage-source inverter.

    Args:
        v_dc: DC-link voltage in V.
        f_sw: Switching (carrier) frequency in Hz.
        device: The switch position, six of which make the bridge; None when no loss data are given.
        coolant_temperature: Temperature in degC that `SwitchDevice.thermal_resistance` refers to.
        dead_time: Dead time in s.
        i_max: Largest permitted current in A (peak), or None when only the machine limits it.
        device_model: The tables that `device` was made from, where the design names some.
        topology: How the phases are fed; `TOPOLOGIES` has the rules.
        capacitor_esr: Series resistance of the DC-link capacitor in Ohm at the carrier frequency.
        neutral_inductance: Inductance in H of a choke in the neutral conductor; 0 without one.
        neutral_resistance: Resistance in Ohm of the neutral's conductor and choke; 0 leaves its
            loss out.
        midpoint_capacitance: Both halves of a split link together, C_1 + C_2 in F; None for a link
            that is not split.
        overmodulation: What the control makes of voltages beyond the circle in the hexagon.
        overmodulation_limit: Largest fundamental then, as a share of that of six-step operation.
        current_sensing: How the phase currents are measured, None where that is not said.
    """

    v_dc: float
    f_sw: float
    device: SwitchDevice | None = None
    coolant_temperature: float = 25.0
    dead_time: float = 0.0
    i_max: float | None = None
    topology: Topology = "three-wire"
    device_model: DeviceModel | None = None
    capacitor_esr: float = 0.0
    neutral_inductance: float = 0.0
    neutral_resistance: float = 0.0
    midpoint_capacitance: float | None = None
    overmodulation: OvermodulationName = "none"
    overmodulation_limit: float = 1.0
    current_sensing: CurrentSensing | None = None
