"""Numbers and symbols as the HTML report writes them: units, raised exponents,
subscripts and true minus signs.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.reports.c_code.numbers import rounded_up

if TYPE_CHECKING:
    from markupsafe import Markup


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
    r"(?<![\w.])(i|k|B|L|M|R|T|t|u|v|\u03c8|\u03c9)_(d|q|s|p|i|e|m|PM|dc|sw|u)(?!\w)"
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
        share(ceiling(errors.torque_relative), 3),
        quantity(ceiling(errors.i_d), "A", 3),
        quantity(ceiling(errors.i_q), "A", 3),
        quantity(ceiling(errors.loss), "W", 3),
        share(ceiling(errors.loss_relative), 3),
        quantity(ceiling(errors.step_at_zero), "A", 3),
    )
