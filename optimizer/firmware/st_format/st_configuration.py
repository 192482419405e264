"""What the macros of ST's MCSDK amount to in SI units: one way for those read and those chosen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.st_format.st_contradictions import contradictions
from dqforge.optimizer.firmware.st_format.st_gains import current_gains, speed_gains
from dqforge.optimizer.firmware.st_format.st_keys import COUNTED, VERSION
from dqforge.optimizer.firmware.st_format.st_observer import flux_of
from dqforge.optimizer.firmware.st_format.st_scales import FULL, control_rate, current_scale, scales

CONVENTIONS = (
    "currents are peak values of a phase, 32768 counts are reference/2 over shunt and gain",
    "32768 counts of voltage are v_dc/sqrt(3), where Workbench counts v_dc/2: 1.155 times as fast",
    "MOTOR_VOLTAGE_CONSTANT is in V r.m.s. line to line per 1000 rpm (mechanical)",
    "LS is the inductance of a phase along q",
)


def st_configuration(
    name: str,
    own: Mapping[str, OwnValue],
    *,
    version: str = VERSION,
    origins: Mapping[str, Origin] | None = None,
    conventions: tuple[str, ...] = CONVENTIONS,
) -> Configuration:
    """Macros with what they amount to.

    Args:
        name: Name of the drive.
        own: Macros by their names of version 6, and what else the motor file says.
        version: ``5`` or ``6``.
        origins, conventions: As in `Configuration`.
    """
    scale, rate = scales(own), _positive(own, "SPEED_LOOP_FREQUENCY_HZ")
    full = current_scale(own)
    gains: tuple[PiGains | None, PiGains | None] = (None, None)
    if scale is not None:
        gains = current_gains(own, "FLUX", scale), current_gains(own, "TORQUE", scale)
    return Configuration(
        firmware="st",
        version=version,
        name=name,
        drive=_drive(own),
        current_d=gains[0],
        current_q=gains[1],
        speed=None if full is None or rate is None else speed_gains(own, full, rate),
        own=own,
        origins=origins or {},
        conventions=conventions,
        contradictions=contradictions(own),
    )


def joined(parts: Iterable[Configuration]) -> Configuration:
    """Several files of one drive as one configuration; where two say the same, the first counts."""
    whole = tuple(parts)
    own: dict[str, OwnValue] = {}
    origins: dict[str, Origin] = {}
    for part in reversed(whole):
        own |= part.own
        origins |= part.origins
    names = [part.name for part in whole if part.name]
    version = "5" if any(part.version == "5" for part in whole) else VERSION
    said = tuple(dict.fromkeys(words for part in whole for words in part.conventions))
    return st_configuration(
        names[0] if names else "", own, version=version, origins=origins, conventions=said
    )


def amperes(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A current in A that a macro holds in A, or another in counts; None where not said."""
    value = number(own, name)
    if value is not None:
        return value
    counts, full = number(own, COUNTED[name]), current_scale(own)
    return None if counts is None or full is None else counts * full / FULL


def _drive(own: Mapping[str, OwnValue]) -> DriveValues:
    pairs, inductance = number(own, "POLE_PAIR_NUM"), number(own, "LS")
    emf, rate = number(own, "MOTOR_VOLTAGE_CONSTANT"), control_rate(own)
    speed_rate = _positive(own, "SPEED_LOOP_FREQUENCY_HZ")
    ratio, dead_time = number(own, "ld_lq_ratio"), number(own, "SW_DEADTIME_NS")
    rpm = number(own, "MAX_APPLICATION_SPEED_RPM") or number(own, "MOTOR_MAX_SPEED_RPM")
    return DriveValues(
        pole_pairs=None if not pairs else int(pairs),
        r_s=number(own, "RS"),
        l_d=None if inductance is None else inductance * (1.0 if ratio is None else ratio),
        l_q=inductance,
        psi_pm=None if emf is None or not pairs else flux_of(emf, int(pairs)),
        inertia=_millionths(own, "inertia"),
        viscous=_millionths(own, "friction"),
        i_max=amperes(own, "NOMINAL_CURRENT_A"),
        omega_m_max=None if not rpm else rpm * math.pi / 30.0,
        v_dc=_positive(own, "NOMINAL_BUS_VOLTAGE_V"),
        f_sw=_positive(own, "PWM_FREQUENCY"),
        dead_time=None if dead_time is None else dead_time / 1e9,
        t_s=None if rate is None else 1.0 / rate,
        t_speed=None if speed_rate is None else 1.0 / speed_rate,
        shunt=_positive(own, "RSHUNT"),
        sense_gain=_positive(own, "AMPLIFICATION_GAIN"),
        sense_reference=_positive(own, "ADC_REFERENCE_VOLTAGE"),
    )


def _positive(own: Mapping[str, OwnValue], name: str) -> float | None:
    return number(own, name) or None


def _millionths(own: Mapping[str, OwnValue], name: str) -> float | None:
    value = number(own, name)
    return None if value is None else value / 1e6
