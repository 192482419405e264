"""Macros of motor-ctrl-lib that its parameters are written with, and names of its structure."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

from dqforge.optimizer.firmware.infineon_format.infineon_keys import (
    KEYS,
    READ_ONLY,
    TABLE_KEYS,
    Kind,
)

# Members that are read, by name, with their kinds.
KINDS: Mapping[str, Kind] = {
    name: key.kind for keys in (KEYS, TABLE_KEYS, READ_ONLY) for name, key in keys.items()
}

_TWO_PI = 2.0 * math.pi

# Functions and conversions of General.h.
FUNCTIONS: Mapping[str, Callable[..., float]] = {
    "HZ_TO_RADSEC": lambda x: _TWO_PI * x,
    "RADSEC_TO_HZ": lambda x: x / _TWO_PI,
    "TAU_TO_RADSEC": lambda x: 1.0 / x,
    "RADSEC_TO_TAU": lambda x: 1.0 / x,
    "PERIOD_TO_RADSEC": lambda x: _TWO_PI / x,
    "MECH_TO_ELEC": lambda x, poles: 0.5 * x * poles,
    "ELEC_TO_MECH": lambda x, poles: 2.0 * x / poles,
    "RPM_TO_HZ": lambda x: x / 60.0,
    "HZ_TO_RPM": lambda x: x * 60.0,
    "DEG_TO_RAD": math.radians,
    "RAD_TO_DEG": math.degrees,
    "RMS_TO_PK": lambda x: x * math.sqrt(2.0),
    "PK_TO_RMS": lambda x: x / math.sqrt(2.0),
    "PHASE_TO_LINE": lambda x: x * math.sqrt(3.0),
    "LINE_TO_PHASE": lambda x: x / math.sqrt(3.0),
    "PERC_TO_NORM": lambda x: 0.01 * x,
    "POW_TWO": lambda x: x * x,
    "POW_THREE": lambda x: x**3,
    "MIN": min,
    "MAX": max,
    "ABS": abs,
    "sqrtf": math.sqrt,
}

CONSTANTS: Mapping[str, float] = {
    "TWO_PI": _TWO_PI,
    "PI": math.pi,
    "ONE_OVER_TWO_PI": 1.0 / _TWO_PI,
    "SQRT_TWO": math.sqrt(2.0),
    "SQRT_THREE": math.sqrt(3.0),
    "ONE_OVER_SQRT_TWO": math.sqrt(0.5),
    "ONE_OVER_SQRT_THREE": 1.0 / math.sqrt(3.0),
    "LUT_1D_WIDTH": 128.0,
}

# What leads to a member: params itself, or a pointer to it.
STRUCTURE = re.compile(r"(?:^|\.)params(?:_ptr)?\.", re.ASCII)


def member(assigned: str) -> str | None:
    """Name of a member as ``params.motor.r``, of what is assigned; None of anything else."""
    plain = assigned.replace("->", ".")
    found = STRUCTURE.search(plain)
    return None if found is None else f"params.{plain[found.end() :]}"
