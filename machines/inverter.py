"""The inverter and its devices: what is bolted to the heat sink, in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from dqforge.machines.device import DeviceModel

DeviceKind = Literal["mosfet", "igbt"]
Topology = Literal["three-wire", "four-leg", "split-capacitor", "diode-neutral", "six-leg"]


@dataclass(frozen=True, slots=True)
class SwitchDevice:
    """One switch position of a half bridge: the transistor together with its antiparallel diode.

    Parameters
    ----------
    kind:
        ``mosfet`` conducts both ways through its channel; ``igbt`` hands negative current to its diode.
    on_resistance:
        R_DS(on) or r_CE in Ohm at 25 degC junction temperature.
    on_resistance_temperature_coefficient:
        Relative change of the on resistance per kelvin, in 1/K, linear around 25 degC.
    on_voltage:
        V_CE0 in V (0 for a MOSFET).
    diode_voltage, diode_resistance:
        V_F0 in V and r_F in Ohm of the diode.
    turn_on_energy, turn_off_energy, reverse_recovery_energy:
        E_on, E_off and E_rr in J at `reference_current` (A) and `reference_voltage` (V); proportional to both.
    thermal_resistance:
        Junction to coolant, per switch position, in K/W.
    max_junction_temperature:
        Largest permitted junction temperature in degC.
    """

    kind: DeviceKind
    on_resistance: float
    turn_on_energy: float
    turn_off_energy: float
    reference_current: float
    reference_voltage: float
    thermal_resistance: float
    reverse_recovery_energy: float = 0.0
    on_resistance_temperature_coefficient: float = 0.0
    on_voltage: float = 0.0
    diode_voltage: float = 0.0
    diode_resistance: float = 0.0
    max_junction_temperature: float = 175.0

    @property
    def switching_energy(self) -> float:
        """Energy of one turn-on and one turn-off (with the recovery it causes) at the reference point, in J."""
        return self.turn_on_energy + self.turn_off_energy + self.reverse_recovery_energy


@dataclass(frozen=True, slots=True)
class Inverter:
    """A two-level voltage-source inverter.

    Parameters
    ----------
    v_dc:
        DC-link voltage in V.
    f_sw:
        Switching (carrier) frequency in Hz.
    device:
        The switch position, six of which make the bridge; None when no loss data are given.
    coolant_temperature:
        Temperature in degC that `SwitchDevice.thermal_resistance` refers to.
    dead_time:
        Dead time in s.
    i_max:
        Largest permitted current in A (peak), or None when only the machine limits it.
    device_model:
        The tables that `device` was made from, where the design names some.
    capacitor_esr:
        Series resistance of the DC-link capacitor in Ohm at the carrier frequency.
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
