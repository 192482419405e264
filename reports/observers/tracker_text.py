"""What is said of a tracker of the position, for tables, the report, the header and JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dqforge.optimizer.estimators.solve import TunedTracker
    from dqforge.reports.observers.text import TextTable
    from dqforge.reports.plain_data import PlainData

_SIGNALS = {
    "sum-voltage": "the mean of v_a + v_b + v_c against the star point over it",
    "voltage-a": "the mean of v_a against the star point over it",
    "voltage-b": "that of v_b",
    "voltage-c": "that of v_c",
}


def _hertz(omega: float) -> str:
    return f"{omega / (2.0 * math.pi):.4g} Hz"


def tuned_text(found: TunedTracker) -> str:
    """By what numbers it is tuned."""
    return found.tracker.in_words(found.gains)


def speed_text(found: TunedTracker) -> str:
    """At what speeds it holds, and what of the drive's own that is."""
    low = "standstill" if found.omega_low == 0.0 else _hertz(found.omega_low)
    return (
        f"from {low} to {_hertz(found.omega_high)} (electrical); the drive turns with up to "
        f"{_hertz(found.omega_max)}"
    )


def heard_text(found: TunedTracker) -> str:
    """What the firmware hands over besides; empty where that is nothing."""
    signals = [_SIGNALS[name] for name in found.tracker.hears]
    return f", the current and {', '.join(signals)}" if signals else " and the current"


def added_text(found: TunedTracker, prefix: str) -> str:
    """What the firmware does with the voltage that it asks for; empty where it asks for none."""
    if not found.tracker.injects:
        return ""
    code = found.tracker.code
    return (
        f"Then copy the member added of {prefix}_{code}_t to that of {prefix}_control_t, whose "
        "duty cycles make it besides their own voltage, and give the control the currents of "
        f"{prefix}_clarke_inverse() of the member current."
    )


def tracker_part(found: TunedTracker) -> TextTable:
    """Tuning and range as a text table."""
    rows = [("tuning", tuned_text(found)), ("speeds", speed_text(found))]
    if found.tracker.hears:
        rows.append(("told besides", ", ".join(found.tracker.hears)))
    return (
        f"Position tracker: {found.tracker.title}",
        ("", "value"),
        tuple(rows),
        (),
    )


def plain_tracker(found: TunedTracker) -> PlainData:
    """Method, gains and range, in SI units."""
    gains: dict[str, Any] = asdict(found.gains)
    return {
        "method": found.tracker.name,
        "t_s": found.t_s,
        "tuning": tuned_text(found),
        "gains": gains,
        "omega_low_rad_per_s": found.omega_low,
        "omega_high_rad_per_s": found.omega_high,
        "omega_max_rad_per_s": found.omega_max,
        "hears": list(found.tracker.hears),
        "injects": found.tracker.injects,
    }
