"""What one file of MCAT amounts to: machine, gains and limits in SI units.

Inputs stand by MCAT's keys, constants by their macros, all in one mapping. A constant of a
fixed-point build counts as the integer that the compiler makes of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware import own_values
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.nxp_mcat.mcat_constants import (
    SPEED_I,
    SPEED_P,
    constants,
    numbers,
    torque_constant,
)
from dqforge.optimizer.firmware.nxp_mcat.mcat_edition import Edition
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import held

TURN = 2.0 * math.pi

ROOT_3 = math.sqrt(3.0)


def kind_of(macro: str, edition: Edition) -> str:
    """How a constant is written: ``plain``, ``float``, ``FRAC16``, ``FRAC32`` or ``ACC32``."""
    name = macro.removeprefix("M1_")
    if name in ("MOTOR_PP", "E_BLOCK_PER") or name.endswith(("_DURATION", "_SHIFT")):
        return "plain"
    if name == "SCALAR_INTEG_GAIN":
        return "ACC32"
    if name == "MERG_COEFF":
        return "FRAC16"
    if not edition.fixed or name in ("N_MAX", "FREQ_MAX", "I_MAX", "U_MAX", "E_MAX", "U_DCB_MAX"):
        return "float"
    return _fixed_kind(name)


def _fixed_kind(name: str) -> str:
    if "_IIR_" in name or "_RAMP_" in name:
        return "FRAC32"
    if name.startswith(("TO_", "SCALAR_VHZ")):
        return "FRAC16"
    if name.endswith(("_KP_GAIN", "_KI_GAIN", "_PROP_GAIN", "_INTEG_GAIN")):
        return "ACC32"
    return "ACC32" if name in ("I_SCALE", "U_SCALE", "E_SCALE", "WI_SCALE") else "FRAC16"


@dataclass(frozen=True, slots=True)
class McatSheet:
    """Inputs and constants of one motor.

    Args:
        edition: The age of the format, and its arithmetic.
        own: Inputs by MCAT's keys, constants by their macros (as of the first motor).
    """

    edition: Edition
    own: Mapping[str, OwnValue] = field(default_factory=dict)

    def number(self, key: str) -> float | None:
        """A value as it stands there, None where it is missing or no number."""
        return own_values.number(self.own, key)

    def constant(self, macro: str) -> float | None:
        """A constant as the firmware computes with it: in fixed point what its integer holds."""
        value = self.number(macro)
        kind = kind_of(macro, self.edition)
        if value is None or kind in ("plain", "float"):
            return value
        return held(value, kind)

    def shifted(self, name: str) -> float | None:
        """A constant with the power of two that stands beside it in fixed point."""
        value, shift = self.constant(f"{name}_GAIN"), self.number(f"{name}_SHIFT")
        return value if value is None or shift is None else math.ldexp(value, int(shift))

    @property
    def pole_pairs(self) -> int | None:
        """Number of pole pairs."""
        value = self.number("M1_MOTOR_PP") or self.number("parametersPP")
        return None if value is None else round(value)

    @property
    def amperes(self) -> float | None:
        """Scale of the currents in A: 1 of a float build."""
        return (
            (self.number("M1_I_MAX") or self.number("parametersImax"))
            if (self.edition.fixed)
            else 1.0
        )

    @property
    def volts(self) -> float | None:
        """Scale of the phase voltages in V: 1 of a float build, else U_DCB_MAX/sqrt(3)."""
        if not self.edition.fixed:
            return 1.0
        full = self.number("M1_U_DCB_MAX") or self.number("parametersUdcbMax")
        return None if full is None else full / ROOT_3

    @property
    def full_speed(self) -> float | None:
        """Scale of the electrical speeds in rad/s: 1 of a float build."""
        if not self.edition.fixed:
            return 1.0
        rpm = self.number("M1_N_MAX") or self.number("parametersNmax")
        pairs = self.pole_pairs
        return None if rpm is None or pairs is None else TURN * pairs * rpm / 60.0

    @property
    def t_s(self) -> float | None:
        """Period of the current loop in s, from the tracking observer where no input says it."""
        given = self.number("currentLoopSampleTime")
        theta, full = self.shifted("M1_TO_THETA"), self.full_speed
        if given is not None or theta is None or not full:
            return given
        return math.pi * theta / full

    @property
    def t_speed(self) -> float | None:
        """Period of the speed loop in s; without an input from both ramps, which have one slope.

        The files of 2018 print the same number for both: they do not say.
        """
        given = self.number("speedLoopSampleTime")
        fast, slow = self.constant("M1_SCALAR_RAMP_UP"), self.constant("M1_SPEED_RAMP_UP")
        if given is not None or not fast or not slow or self.t_s is None or fast == slow:
            return given
        return self.t_s * slow / fast / (1.0 if self.edition.fixed else TURN)

    def current(self, axis: str) -> PiGains | None:
        """Gains of a current controller (``D`` or ``Q``) in V/A and V/(A s)."""
        k_p, k_i = self.constant(f"M1_{axis}_KP_GAIN"), self.constant(f"M1_{axis}_KI_GAIN")
        t_s, volts, amperes = self.t_s, self.volts, self.amperes
        if k_p is None or k_i is None or not t_s or not volts or not amperes:
            return None
        scale = volts / amperes
        return PiGains(k_p * scale, k_i * scale / (self.edition.current_share * t_s))

    def speed(self) -> PiGains | None:
        """Gains of the speed controller in A s/rad and A/rad, per mechanical speed."""
        k_p, k_i = self.constant(SPEED_P), self.constant(SPEED_I)
        amperes, full, pairs = self.amperes, self.full_speed, self.pole_pairs
        if k_p is None or k_i is None or not self.t_speed or not amperes or not full or not pairs:
            return None
        scale = amperes * pairs / full
        return PiGains(k_p * scale, k_i * scale / (self.edition.speed_share * self.t_speed))

    def meant(self, macro: str) -> bool:
        """Whether a constant is what MCAT makes of the inputs beside it, which say it unrounded."""
        made = constants(self.edition, self.own).get(macro)
        return made is not None and made == self.number(macro)

    def current_limit(self) -> float | None:
        """Largest q current that the speed controller asks for, in A."""
        if self.meant("M1_SPEED_LOOP_HIGH_LIMIT"):
            return self.number("speedLoopUpperLimit")
        value, amperes = self.constant("M1_SPEED_LOOP_HIGH_LIMIT"), self.amperes
        return None if value is None or amperes is None else value * amperes

    def torque(self) -> float | None:
        """Torque constant in N m/A (peak of phase) that the rule of the speed loop takes."""
        return torque_constant(self.edition, numbers(self.edition, self.own))

    def psi_pm(self) -> float | None:
        """Flux linkage in Wb that this torque constant is that of."""
        torque, pairs = self.torque(), self.pole_pairs
        return None if torque is None or not pairs else torque / (1.5 * pairs)

    def largest_speed(self) -> float | None:
        """Nominal speed in rad/s (mechanical), beyond which no speed is asked for."""
        rpm = self.number("parametersNnom") if self.meant("M1_N_NOM") else None
        if rpm is not None:
            return TURN * rpm / 60.0
        value, full, pairs = self.constant("M1_N_NOM"), self.full_speed, self.pole_pairs
        return None if value is None or full is None or not pairs else value * full / pairs

    def link_voltage(self) -> float | None:
        """DC-link voltage in V whose linear range ends at the nominal phase voltage; None where
        the firmware takes this voltage for a fault.
        """
        phase = self.number("parametersUphNom")
        if phase is None:
            return None
        lowest = self.number("parametersUdcbUnder") or 0.0
        largest = self.number("parametersUdcbOver") or math.inf
        return ROOT_3 * phase if lowest <= ROOT_3 * phase <= largest else None

    def drive(self) -> DriveValues:
        """Machine and timing as the file tells them; without inputs what its constants imply."""
        implied = self.implied()
        return DriveValues(
            pole_pairs=self.pole_pairs,
            r_s=_first(self.number("parametersRs"), implied.get("r_s")),
            l_d=_first(self.number("parametersLd"), implied.get("l_d")),
            l_q=_first(self.number("parametersLq"), implied.get("l_q")),
            psi_pm=self.psi_pm(),
            inertia=self.number("parametersJ"),
            i_max=self.current_limit(),
            omega_m_max=self.largest_speed(),
            v_dc=self.link_voltage(),
            t_s=self.t_s,
            t_speed=self.t_speed,
        )

    def implied(self) -> dict[str, float]:
        """Resistance in Ohm and inductances in H that the constants of the observer are made of."""
        part, rate = self.number("M1_I_SCALE"), self.number("M1_U_SCALE")
        cross, t_s, full = self.number("M1_WI_SCALE"), self.t_s, self.full_speed
        if not part or not rate or not cross or not t_s or not full:
            return {}
        if not self.volts or not self.amperes:
            return {}
        rate *= self.amperes / self.volts
        return {
            "r_s": (1.0 - part) / rate,
            "l_d": part * t_s / rate,
            "l_q": cross / (full * rate),
        }

    def configuration(
        self,
        name: str,
        origins: Mapping[str, Origin],
        conventions: tuple[str, ...],
        contradictions: tuple[str, ...],
    ) -> Configuration:
        """All of it as a configuration."""
        return Configuration(
            firmware="nxp",
            version=self.edition.version,
            name=name,
            drive=self.drive(),
            current_d=self.current("D"),
            current_q=self.current("Q"),
            speed=self.speed(),
            own=dict(self.own),
            origins=dict(origins),
            conventions=conventions,
            contradictions=contradictions,
        )


def _first(given: float | None, implied: float | None) -> float | None:
    return implied if given is None else given
