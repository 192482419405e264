"""What losses need to know of a switching device."""

from __future__ import annotations

from typing import Literal

from dqforge.machines.records import dataclass

DeviceKind = Literal["mosfet", "igbt"]


@dataclass(frozen=True, slots=True)
class SwitchDevice:
    """One switch position of a half bridge: the transistor together with its antiparallel diode.

    Args:
        kind: ``mosfet`` conducts both ways through its channel; ``igbt`` hands negative current to
            its diode.
        on_resistance: R_DS(on) or r_CE in Ohm at 25 degC junction temperature.
        on_resistance_temperature_coefficient: Relative change of the on resistance per kelvin, in
            1/K, linear around 25 degC.
        on_voltage: V_CE0 in V (0 for a MOSFET).
        diode_voltage, diode_resistance: V_F0 in V and r_F in Ohm of the diode.
        turn_on_energy, turn_off_energy, reverse_recovery_energy: E_on, E_off and E_rr in J at
            `reference_current` (A) and `reference_voltage` (V); proportional to both.
        thermal_resistance: Junction to coolant, per switch position, in K/W.
        max_junction_temperature: Largest permitted junction temperature in degC.
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
        """Energy of one turn-on and one turn-off (with the recovery it causes) at
        the reference point, in J.
        """
        return self.turn_on_energy + self.turn_off_energy + self.reverse_recovery_energy
