"""Data sheets of four motors, as far as a design needs them, and what follows by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

_SQRT2, _SQRT3 = math.sqrt(2.0), math.sqrt(3.0)


@dataclass(frozen=True)
class DataSheet:
    """What a data sheet says, by the dotted key, and the machine that it means: resistance (Ohm)
    and inductance (H) of a phase, flux linkage (Wb, peak of phase), current (A, peak).
    """

    values: dict[str, str]
    r_s: float
    l_s: float
    psi_pm: float
    i_max: float

    @property
    def flags(self) -> list[str]:
        """The same as words of the command line, written out."""
        names = {"machine.back_emf_constant": "back-emf"}
        words = []
        for key, text in self.values.items():
            short = key.removeprefix("machine.").removeprefix("inverter.")
            words += [f"--{names.get(key, short.replace('_', '-').replace('.', '-'))}", text]
        return words


SCOOTER = DataSheet(
    {
        "machine.kv": "60 rpm/V",
        "machine.resistance": "100 mOhm line-to-line",
        "machine.inductance": "200 uH line-to-line",
        "machine.pole_pairs": "15",
        "machine.max_current": "40 A rms",
        "inverter.v_dc": "48 V",
    },
    r_s=0.05,
    l_s=100e-6,
    # at 60 rpm the terminals have 1 V peak: sqrt(3) p psi 60 rpm = 1 V
    psi_pm=1.0 / (_SQRT3 * 15 * 2.0 * math.pi),
    i_max=40.0 * _SQRT2,
)

DRONE = DataSheet(
    {
        "machine.kv": "920KV",
        "machine.resistance": "90 mOhm ll",
        "machine.inductance": "15 uH phase",
        "machine.poles": "14",
        "machine.max_current": "20 A peak",
        "inverter.v_dc": "14.8 V",
    },
    r_s=0.045,
    l_s=15e-6,
    psi_pm=60.0 / (920.0 * _SQRT3 * 7 * 2.0 * math.pi),
    i_max=20.0,
)

SERVO = DataSheet(
    {
        "machine.back_emf_constant": "60 Vrms/krpm line-to-line",
        "machine.torque_constant": "0.95 Nm/Arms",
        "machine.resistance": "1.2 Ohm phase-to-phase",
        "machine.inductance": "5 mH phase-to-phase",
        "machine.pole_pairs": "4",
        "machine.max_current": "20 Arms",
        "inverter.v_dc": "540 V",
        "machine.max_speed": "4500 rpm",
        "machine.rated.torque": "2.4 Nm",
        "machine.rated.current": "2.6 Arms",
        "machine.rated.speed": "3000 rpm",
        "machine.inertia": "2.9 kg cm^2",
    },
    r_s=0.6,
    l_s=2.5e-3,
    # the back-EMF is trusted first; the torque constant says 1 % less
    psi_pm=60.0 * _SQRT2 / _SQRT3 / (4 * 1000.0 * 2.0 * math.pi / 60.0),
    i_max=20.0 * _SQRT2,
)

_OUNCE_INCH = 0.028349523125 * 9.80665 * 0.0254

INDUSTRIAL = DataSheet(
    {
        "machine.torque_constant": "60 oz-in/A rms",
        "machine.resistance": "2 Ohm terminal",
        "machine.inductance": "6 mH terminal",
        "machine.poles": "8",
        "machine.max_current": "10 A rms",
        "inverter.v_dc": "160 V",
    },
    r_s=1.0,
    l_s=3e-3,
    psi_pm=60.0 * _OUNCE_INCH / _SQRT2 / (1.5 * 4),
    i_max=10.0 * _SQRT2,
)

MOTORS = {"scooter": SCOOTER, "drone": DRONE, "servo": SERVO, "industrial": INDUSTRIAL}
