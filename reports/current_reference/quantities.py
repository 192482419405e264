"""What a comparison sets side by side of current references."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from dqforge.reports.capability import Quantity, Value

_SECTION = "current reference"

# Key of the bytes of constants, which a side of a comparison adds to ``header``.
CONSTANTS = "constants_B"

_ERRORS = (
    ("i_d error", "i_d", "A"),
    ("i_q error", "i_q", "A"),
    ("torque error", "torque_relative", "%"),
    ("copper loss penalty", "loss_relative", "%"),
    ("voltage excess", "voltage_excess", "%"),
)

# Shares below this are rounding, which moves with every input.
_ROUNDING = 1e-14


def _share(value: Any) -> Value:
    """A share less what is only rounding."""
    return 0.0 if abs(float(value)) < _ROUNDING else float(value)


def _checksum(reference: Any) -> Value:
    text = json.dumps(reference, sort_keys=True)
    return hashlib.sha256(text.encode("ascii")).hexdigest()[:12]


def _errors(word: str, key: str) -> tuple[Quantity, ...]:
    return tuple(
        Quantity(
            _SECTION,
            f"{label}, {word}",
            unit,
            ("fit", key, name),
            _share if unit == "%" else None,
        )
        for label, name, unit in _ERRORS
    )


QUANTITIES = (
    Quantity(_SECTION, "strategy", "", ("drive", "strategy")),
    Quantity(_SECTION, "holds at", "rpm", ("drive", "reference_omega_m_rad_per_s")),
    Quantity(_SECTION, "form", "", ("fit", "form")),
    Quantity(_SECTION, "method", "", ("fit", "method")),
    Quantity(_SECTION, "number format", "", ("fit", "reference", "format")),
    Quantity(_SECTION, "degree", "", ("fit", "degree")),
    Quantity(_SECTION, "segments", "", ("fit", "segments")),
    Quantity(_SECTION, "largest torque", "N m", ("fit", "torque_max_Nm")),
    *_errors("found", "errors"),
    *_errors("proven", "certificate"),
    Quantity(_SECTION, "bytes of constants", "", ("header", CONSTANTS)),
    Quantity(_SECTION, "checksum of constants", "", ("header", "reference"), _checksum),
)
