"""Headers and results that dqforge wrote, as gains on a machine."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import DriveValues, PiGains
from dqforge.optimizer.firmware.explained import OwnGains
from dqforge.reports.comparison.sources import Side
from dqforge.reports.firmware.text_file import TextFile
from dqforge.reports.firmware_files.plain import DRIVE_KEYS

# Macros of the main header by the field of `DriveValues`.
_MACROS = {
    "pole_pairs": "POLE_PAIRS",
    "r_s": "R_S_OHM",
    "l_d": "L_D_H",
    "l_q": "L_Q_H",
    "psi_pm": "PSI_PM_WB",
    "i_max": "CURRENT_MAX_A",
    "t_s": "T_S_S",
}

_LOOPS = {
    "current_d": ("ID_KP_V_PER_A", "ID_KI_V_PER_AS"),
    "current_q": ("IQ_KP_V_PER_A", "IQ_KI_V_PER_AS"),
    "speed": ("SPEED_KP_NMS_PER_RAD", "SPEED_KI_NM_PER_RAD"),
}


def is_own(file: TextFile) -> bool:
    """Whether a text is a header or a JSON of dqforge."""
    if file.source.lower().endswith(".json"):
        return '"dqforge"' in file.text[:200] and '"command"' in file.text[:400]
    return "controller coefficients for " in file.text[:400] and "#ifndef" in file.text


def own_gains(side: Side) -> OwnGains:
    """Gains and machine of what dqforge wrote.

    Args:
        side: As `dqforge.reports.comparison.sources.read_side` gives it.

    Raises:
        InputError: It holds none, or something that is no number.
    """
    found = _of_macros(side) if side.header_only else _of_result(side)
    if found.current_q is None and found.current_d is None:
        raise InputError(
            "holds no gains: the design it was made of has none; tune it, and run it again",
            source=side.source,
        )
    return found


def _of_result(side: Side) -> OwnGains:
    drive = {name: _number(side, "drive", key) for name, key in DRIVE_KEYS.items()}
    drive["t_speed"] = _number(side, "gains", "speed", "t_s")
    i_d, i_q, speed = (
        _pair(_number(side, "gains", name, "kp"), _number(side, "gains", name, "ki"))
        for name in ("i_d", "i_q", "speed")
    )
    observed = any(side.value("gains", key) is not None for key in ("observer", "position"))
    return OwnGains(_drive(drive), i_d, i_q, speed, observed=observed)


def _number(side: Side, *path: str) -> float | None:
    value: Any = side.value(*path)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(
            f"{'.'.join(path)}: expected a number, got {json.dumps(value)[:40]}; run the design "
            "again",
            source=side.source,
        )
    return float(value)


def _of_macros(side: Side) -> OwnGains:
    macros: Mapping[str, str] = side.macros or {}

    def value(name: str) -> float | None:
        text = macros.get(name)
        try:
            return None if text is None else float(text.removesuffix("F"))
        except ValueError:
            raise InputError(
                f"{name}: expected a number, got {text!r}; run the design again",
                source=side.source,
            ) from None

    drive = {name: value(macro) for name, macro in _MACROS.items()}
    ratio = value("SPEED_RATIO")
    if ratio is not None and drive["t_s"] is not None:
        drive["t_speed"] = ratio * drive["t_s"]
    i_d, i_q, speed = (_pair(value(kp), value(ki)) for kp, ki in _LOOPS.values())
    observed = any(name.startswith("OBSERVER_") for name in macros)
    return OwnGains(_drive(drive), i_d, i_q, speed, observed=observed)


def _pair(kp: float | None, ki: float | None) -> PiGains | None:
    return None if kp is None or ki is None else PiGains(kp, ki)


def _drive(values: Mapping[str, float | None]) -> DriveValues:
    pole_pairs = values.get("pole_pairs")
    rest = {name: value for name, value in values.items() if name != "pole_pairs"}
    return DriveValues(None if pole_pairs is None else int(pole_pairs), **rest)
