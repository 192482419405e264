"""Words, numbers and symbols as the HTML report and the tables write them: names for people,
units, raised exponents, subscripts and true minus signs.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.settings import LoadPoint
from dqforge.machines.errors import InputError
from dqforge.machines.names import Core, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.reports.c_code.numbers import rounded_up

if TYPE_CHECKING:
    from markupsafe import Markup

    from dqforge.optimizer.losses.drive_budget import DriveBudget
    from dqforge.optimizer.losses.phase_comparison import LossComparison
    from dqforge.optimizer.operating_points.current_choice import SpeedPoint


NARROW = "\u202f"  # Narrow space that does not break, between a number and its unit.

_RAISED = str.maketrans(
    "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)

_UNITS = (
    ("Ohm", "\u03a9"),
    ("degC", "\u00b0C"),
    ("deg", "\u00b0"),
    ("^2", "\u00b2"),
    ("^3", "\u00b3"),
)

_SYMBOL = re.compile(
    r"(?<![\w.])(i|k|B|L|M|R|T|t|u|v|\u03c8|\u03c9)_(d|q|0|a|b|c|n|s|p|i|e|m|PM|dc|sw|u)(?!\w)"
)

_SHARES = ((1e-4, 1e2, "%"), (1e-6, 1e6, "ppm"), (0.0, 1e9, "ppb"))
_SMALLEST_SHARE = 1e-11


def raised(exponent: int) -> str:
    """An exponent in superior figures."""
    return str(exponent).translate(_RAISED)


def number(value: float, digits: int = 4) -> str:
    """A number with ``digits`` significant digits, powers of ten written out."""
    if math.isnan(value):
        return "\u2013"
    if math.isinf(value):
        return "\u221e" if value > 0.0 else "\u2212\u221e"
    text = f"{value + 0.0:.{digits}g}"
    if "e+" in text and abs(value) < 1e7:
        text = f"{value:.0f}"
    mantissa, has_exponent, exponent = text.partition("e")
    text = f"{mantissa}\u00b710{raised(int(exponent))}" if has_exponent else text
    return re.sub(r"^-", "\u2212", text)


def unit_text(unit: str) -> str:
    """A unit with its signs: Ohm, degrees and powers."""
    for plain, sign in _UNITS:
        unit = unit.replace(plain, sign)
    return unit.replace(" ", "\u00a0")


def quantity(value: float, unit: str, digits: int = 4) -> str:
    """A number with its unit, prefixed where that is customary."""
    if not math.isfinite(value):
        return number(value)
    figure, _, rest = format_quantity(value, unit, digits).partition(" ")
    rest = unit_text(re.sub(r"^u(?=[A-Z])", "\u00b5", re.sub(r"^us$", "\u00b5s", rest)))
    return f"{number(float(figure), digits)}{NARROW}{rest}".rstrip()


def share(value: float, digits: int = 2) -> str:
    """A share of one in percent, or in parts per million or billion where
    percent would be a row of zeros.
    """
    if value == 0.0 or not math.isfinite(value):
        return f"0{NARROW}%" if value == 0.0 else number(value)
    if abs(value) < _SMALLEST_SHARE:
        return f"below 0.01{NARROW}ppb"
    factor, unit = next((factor, unit) for least, factor, unit in _SHARES if abs(value) >= least)
    return f"{number(value * factor, digits)}{NARROW}{unit}"


def percent(value: float, digits: int = 3) -> str:
    """A share of one in percent whatever its size, as the tables of the terminal have errors."""
    return f"{number(100.0 * value, digits)}{NARROW}%"


def decibel(factor: float) -> str:
    """A factor in dB."""
    if not (math.isfinite(factor) and factor > 0.0):
        return "none"
    return f"{20.0 * math.log10(factor):.1f}{NARROW}dB"


def degrees(angle: float) -> str:
    """An angle in rad as degrees."""
    return f"{math.degrees(angle):.1f}\u00b0".replace("-", "\u2212")


def count(value: int) -> str:
    """A count with its thousands set apart."""
    return f"{value:,}".replace(",", NARROW)


def symbols(text: str) -> Markup:
    """The program's own words as HTML: escaped, with i_d and its like set as
    letters with a subscript.
    """
    from markupsafe import Markup, escape

    return Markup(_SYMBOL.sub(r"<i>\1</i><sub>\2</sub>", str(escape(text))))


def ceiling(error: float, digits: int = 3) -> float:
    """A largest error with ``digits`` significant digits, rounded up."""
    return float(rounded_up(error, digits))


def known_texts(*values: tuple[float, str]) -> list[str]:
    """Values with their units, a dash for those that are not known."""
    return [
        (f"{number(value, 3)}{NARROW}{unit}" if unit == "\u00b0C" else quantity(value, unit, 3))
        if math.isfinite(value)
        else "\u2013"
        for value, unit in values
    ]


# Tables of the HTML report: results become cells of text here; the template only lays them out.

MOST_OPEN_ROWS = 24  # A table with more rows is folded, so that the page stays readable.


@dataclass(frozen=True, slots=True)
class Row:
    """Cells of one row; ``mark`` is ``best``, ``chosen`` or ``muted``, or empty."""

    cells: tuple[str | Markup, ...]
    mark: str = ""


@dataclass(frozen=True, slots=True)
class HtmlTable:
    """A table with a caption.

    The first ``text_columns`` columns are text, the others are set as numbers; ``notes`` stand
    below it, one line each. A table that is ``folded``, or has more than `MOST_OPEN_ROWS` rows, is
    closed at first; its summary line then has the number of rows, and ``key``, its key number.
    """

    caption: str | Markup
    columns: tuple[str | Markup, ...]
    rows: tuple[Row, ...]
    text_columns: int = 1
    notes: tuple[str | Markup, ...] = ()
    folded: bool = False
    key: str | Markup = ""

    @property
    def folds(self) -> bool:
        """Whether it is closed at first."""
        return bool(self.rows) and (self.folded or len(self.rows) > MOST_OPEN_ROWS)

    @property
    def told(self) -> str | Markup:
        """What the summary line says besides the caption."""
        return counted(len(self.rows), "row") + (self.key and "; " + self.key)


def counted(many: int, what: str) -> str:
    """How many there are of something, in words that agree."""
    return f"{count(many)} {what}{'' if many == 1 else 's'}"


def heading_cells(*texts: str) -> tuple[Markup, ...]:
    """Headings of a table, with their symbols set."""
    return tuple(symbols(text) for text in texts)


def error_cells(errors: ReferenceErrors) -> tuple[str, ...]:
    """Errors of a current reference as cells."""
    return (
        quantity(ceiling(errors.torque), "N m", 3),
        percent(ceiling(errors.torque_relative)),
        quantity(ceiling(errors.i_d), "A", 3),
        quantity(ceiling(errors.i_q), "A", 3),
        quantity(ceiling(errors.loss), "W", 3),
        percent(ceiling(errors.loss_relative)),
        quantity(ceiling(errors.step_at_zero), "A", 3),
    )


# Names for people of what the settings call by short words.

_SPACE = "\u00a0"  # does not break
_PHASES = {"dq": "dq", "dqx": "dqx", "dqy": "dqy", "limited": "limited"}
STRATEGY_LABELS = {"mtpa": "MTPA", "id0": "$i_d$ = 0", "least-loss": "least loss"} | _PHASES


def modulation_label(name: str) -> str:
    """A modulator as titles and tables write it."""
    return name.upper()


def point_text(point: LoadPoint) -> str:
    """An operating point with its speed in the unit of data sheets."""
    return f"{point.torque:.4g}{_SPACE}N{_SPACE}m, {in_rpm(point.omega_m):.4g}{_SPACE}rpm"


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


# What is said in place of a winner there.
NOT_COMPARED = "inverter.device is unknown: modulators are not compared"


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
