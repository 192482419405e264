"""Numbers among a firmware's own values: found, rounded as its file prints them, and asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import OwnValue

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
