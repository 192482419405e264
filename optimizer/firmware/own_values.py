"""Numbers among a firmware's own values: found, rounded as its file prints them, and asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, get_args

from dqforge.machines.errors import InputError
from dqforge.machines.names import Firmware, LoadedByName

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.firmware.configuration import Origin, OwnValue
    from dqforge.optimizer.firmware.firmware_method import FirmwareMethod


FLOAT32_DIGITS = 7  # Significant digits that are printed for firmware that computes in float32.
_LEAST, _MOST = 1e-30, 1e30


def number(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A value as a number; None where it is not there, or a word."""
    value = own.get(name)
    return None if value is None or isinstance(value, str) else float(value)


def rounded(value: float, digits: int) -> float:
    """A number as it comes back from a file that prints that many significant digits."""
    return float(f"{value:.{digits}g}")


def float32_value(value: float, asked_by: str, firmware: str) -> float:
    """A value as a file for float32 holds it.

    Args:
        value: In its unit.
        asked_by: Key of the design that asks for it, for the message.
        firmware: Whose it is, for the message.

    Raises:
        InputError: A float32 cannot hold it.
    """
    printed = rounded(value, FLOAT32_DIGITS)
    if printed != 0.0 and not _LEAST < abs(printed) < _MOST:
        raise InputError(
            f"{asked_by}: {firmware} computes in float32, which {value:g} does not fit"
        )
    return printed


def needed(
    value: float | None, key: str, firmware: str, what: str, otherwise: str = "give it"
) -> float:
    """A positive value of the design.

    Args:
        value: As the design says it.
        key: Key of the design that gives it, for the message.
        firmware, what: Who needs it, and what it is, for the message.
        otherwise: What to do without it, for the message.

    Raises:
        InputError: It is missing, or not above zero.
    """
    if value is None or not math.isfinite(value) or value <= 0.0:
        raise InputError(f"{key}: {firmware} needs {what}; {otherwise}")
    return float(value)


# What firmware needs of a design that it does not say: all of it in one refusal, with text to
# paste.

MAX_SPEED, INERTIA = "machine.max_speed", "machine.inertia"
CURRENT_SENSING = "inverter.current_sensing"
_HEADROOM = 1.25  # Full scale of a current measurement that is proposed, over the current limit.
_RUN_UP = 0.1  # Time in s in which a proposed inertia runs up to the largest speed.


def check_drivable(design: Design, methods: Sequence[FirmwareMethod]) -> None:
    """Refuse a machine of a kind that no firmware of others drives, and a design that lacks what
    they need.

    Raises:
        InputError: With everything that is missing, as keys with values that fit this drive.
    """
    names = " and ".join(method.name for method in methods)
    if methods and design.phase_machine is not None:
        raise InputError(
            f"export.firmware: {names} drives machines with a sinusoidal back-EMF, and this one "
            "has model: waveform; leave it out"
        )
    needed = {key for method in methods for key in method.needs}
    proposals = {
        MAX_SPEED: (design.machine.omega_m_max, _speed_text),
        INERTIA: (design.machine.inertia, _inertia_text),
        CURRENT_SENSING: (design.inverter.current_sensing, _sensing_text),
    }
    missing = {
        key: text(design)
        for key, (value, text) in proposals.items()
        if key in needed and value is None
    }
    if not missing:
        return
    who = " and ".join(method.name for method in methods if missing.keys() & set(method.needs))
    lines = [
        f"in {section} "
        + " and ".join(
            f"'{key.partition('.')[2]}: {text}'"
            for key, text in missing.items()
            if key.startswith(f"{section}.")
        )
        for section in dict.fromkeys(key.partition(".")[0] for key in missing)
    ]
    raise InputError(
        f"{next(iter(missing))}: {who} cannot do without {', '.join(missing)}; write "
        f"{', and '.join(lines)}, with your own values in place of these, which fit this drive"
    )


def _base_speed(design: Design) -> float:
    """Mechanical speed in rad/s at which flux linkage and link meet."""
    machine = design.machine
    flux = math.hypot(machine.psi_pm, machine.l_q * design.i_max)
    return design.inverter.v_dc / math.sqrt(3.0) / (flux * machine.pole_pairs)


def _speed_text(design: Design) -> str:
    return f"{float(f'{_base_speed(design) * 30.0 / math.pi:.2g}'):g} rpm"


def _inertia_text(design: Design) -> str:
    machine = design.machine
    flux = max(machine.psi_pm, abs(machine.l_q - machine.l_d) * design.i_max)
    torque = 1.5 * machine.pole_pairs * flux * design.i_max
    speed = machine.omega_m_max or _base_speed(design)
    return f"{torque * _RUN_UP / speed:.2g} kg m^2"


def _sensing_text(design: Design) -> str:
    gain, reference = 20.0, 3.3
    shunt = 0.5 * reference / gain / (_HEADROOM * design.i_max)
    milliohm = float(f"{1e3 * shunt:.2g}")
    return f"{{shunt: {milliohm:g} mOhm, gain: {gain:g}, reference: {reference:g} V}}"


# Where the fields of a configuration stand in a file, from where its own values stand.

# By the field of the configuration (``r_s``, ``current_d.kp``) the name in the file, or several of
# which the first one there counts, and how the value is converted.
Fields = Mapping[str, tuple[str | tuple[str, ...], str]]


def field_origins(found: Mapping[str, Origin], fields: Fields) -> dict[str, Origin]:
    """Origins by the field of the configuration, and by the file's own name.

    Args:
        found: By the file's own name.
        fields: What the fields are made of; those of which nothing is there are left out.
    """
    by_field = {}
    for field, (names, conversion) in fields.items():
        those = (names,) if isinstance(names, str) else names
        origin = next((found[name] for name in those if name in found), None)
        if origin is not None:
            by_field[field] = replace(origin, conversion=conversion)
    return by_field | dict(found)


# The methods of every firmware, by name.

METHODS: LoadedByName[Firmware, FirmwareMethod] = LoadedByName(
    {
        name: f"dqforge.optimizer.firmware.targets.{name}:{name.upper()}"
        for name in get_args(Firmware)
    }
)
