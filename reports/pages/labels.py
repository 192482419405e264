"""Names for people of what the settings call by short words."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.settings import LoadPoint
from dqforge.machines.errors import InputError
from dqforge.machines.names import Core, NumberFormat
from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:
    from dqforge.optimizer.losses.drive_budget import DriveBudget
    from dqforge.optimizer.losses.phase_comparison import LossComparison
    from dqforge.optimizer.operating_points.current_choice import SpeedPoint


_SPACE = "\u00a0"  # does not break
_PHASES = {"dq": "dq", "dqx": "dqx", "dqy": "dqy", "limited": "limited"}
STRATEGY_LABELS = {"mtpa": "MTPA", "id0": "$i_d$ = 0", "least-loss": "least loss"} | _PHASES


def modulation_label(name: str) -> str:
    """A modulator as titles and tables write it."""
    return name.upper()


def point_text(point: LoadPoint) -> str:
    """An operating point with its speed in the unit of data sheets."""
    return f"{point.torque:.4g}{_SPACE}N{_SPACE}m, {point.omega_m * 30.0 / math.pi:.4g}{_SPACE}rpm"


def watts(value: float) -> str:
    """A loss: to the watt from 100 W on, with three digits below, prefixed below 0.1 W."""
    if value == 0.0 or value >= 0.1:
        return f"{value:.0f}{_SPACE}W" if value >= 99.95 else f"{value:.3g}{_SPACE}W"
    return format_quantity(value, "W", 3).replace(" ", _SPACE).replace("u", "\u00b5")


_SHORT = {
    "ripple_copper": "ripple",
    "ripple_iron": "ripple iron",
    "dead_time": "dead time",
    "capacitor": "dc link",
}

_ALWAYS = ("copper", "conduction", "switching")
_VISIBLE = 1e-4


def part_label(part: str) -> str:
    """A kind of loss as it stands in a heading."""
    return _SHORT.get(part, part)


def shown_parts(budget: DriveBudget) -> tuple[str, ...]:
    """Kinds of loss to show: copper, those of a known switch, and of the others what is
    more than 0.01 % somewhere.
    """
    total = np.nan_to_num(budget.total)
    always = _ALWAYS if np.any(np.isfinite(budget.junction_temperature)) else _ALWAYS[:1]

    def visible(part: str) -> bool:
        return bool(np.any(np.nan_to_num(getattr(budget, part)) > _VISIBLE * total))

    from dqforge.optimizer.losses.drive_budget import PARTS

    return tuple(part for part in PARTS if part in always or visible(part))


def obstacle(comparison: LossComparison, index: tuple[int, int, int]) -> str:
    """Why an alternative cannot be used, or nothing."""
    budget, wanted = comparison.budget, comparison.points[index[2]].torque
    if not comparison.reached[index]:
        most = float(comparison.most[index])
        if math.isfinite(most) and most * wanted > 0.0:
            return f"torque out of reach, at most {abs(most):.4g} N m"
        return "torque out of reach"
    if not budget.steady[index]:
        return (
            "junction temperature runs away"
            if comparison.scope == "drive"
            else "winding temperature runs away"
        )
    if not budget.linear[index]:
        return "voltage beyond the linear range"
    return "" if budget.cool_enough[index] else "junction too hot"


# What is said where the switch is unknown.
WITHOUT_BRIDGE = (
    "the design has no inverter.device: the total is without the bridge, of which conduction, "
    "switching and junctions are unknown"
)


def friction_text(comparison: LossComparison, point: int) -> str:
    """Friction loss at a point, which no alternative changes, or an empty text
    where the machine has none.
    """
    friction = comparison.budget.friction[..., point]
    known = friction[np.isfinite(friction)]
    if not known.size or known[0] == 0.0:
        return ""
    return (
        f"friction takes another {watts(float(known[0]))} of the shaft power with every alternative"
    )


def operation_text(speed: SpeedPoint | None) -> str:
    """Where currents hold: the speed and the voltage limit, or an empty text where
    the voltage limits nothing.
    """
    if speed is None:
        return ""
    return (
        f"{format_quantity(speed.omega_m, 'rpm', 4)} within {format_quantity(speed.v_max, 'V', 4)} "
        "(phase peak)"
    )


FORMAT_TEXT: dict[NumberFormat, str] = {"float32": "single precision", "q15": "Q15", "q31": "Q31"}

_CORES: dict[Core, str] = {
    "cortex-m0plus": "a Cortex-M0+",
    "cortex-m3": "a Cortex-M3",
    "cortex-m4": "a Cortex-M4F",
    "cortex-m7": "a Cortex-M7",
    "cortex-m33": "a Cortex-M33",
}


def core_name(core: Core) -> str:
    """A core with its article, as ARM writes it."""
    return _CORES[core]


def letter(index: int) -> str:
    """A, B, ... Z, a, ... z, then numbers."""
    letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
    return letters[index] if index < len(letters) else str(index + 1)


STRATEGY_TEXT = {"mtpa": "MTPA", "id0": "i_d = 0", "least-loss": "least loss"} | _PHASES
NEGLIGIBLE = 1e-9  # Relative speed error that is nothing but rounding.


def significant(value: float, digits: int = 4) -> str:
    """A number with a few digits; "none" where it is not finite."""
    # Adding zero turns -0 into 0.
    return f"{value + 0.0:.{digits}g}" if math.isfinite(value) else "none"


def three_decimals(value: float) -> str:
    """A number with one decimal, or three digits where those are more; a
    dash where there is none.
    """
    if not math.isfinite(value):
        return "-"
    return f"{value:.3g}" if 0.0 < abs(value) < 10.0 else f"{value + 0.0:.1f}"


# Options of commands that are written as text.

_MOST_CELLS = 2000


def map_size(text: str) -> tuple[int, int]:
    """Numbers of torques and speeds of the option --map.

    An `InputError` where it is not understood.
    """
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text.strip(), re.IGNORECASE)
    sizes = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(2 <= size <= _MOST_CELLS for size in sizes):
        raise InputError(
            f"--map: expected NxM with 2 to {_MOST_CELLS} torques and speeds such as 40x60, got "
            f"'{text}'"
        )
    return sizes
