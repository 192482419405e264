"""What the samples of a capture lie over: a column of times or angles,
or an interval that the heading states.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.checks import Origin
from dqforge.machines.files.text_table import TextTable
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity, parse_quantity
from dqforge.machines.units.registry import COMPOUNDS, DIMENSIONS, SYMBOLS

AxisKind = Literal["time", "angle", "count", "none"]

_WORDS = {
    "v": "V",
    "volt": "V",
    "volts": "V",
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "degree": "deg",
} | {
    "degrees": "deg",
    "s": "s",
    "v*s": "Vs",
    "v s": "Vs",
}

UNIT_KINDS: dict[str, frozenset[str]] = {
    "time": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("second")),
    "angle": frozenset(
        symbol for symbol, name in SYMBOLS.items() if name.endswith(("radian", "degree"))
    ),
    "voltage": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("volt")),
    "flux": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("weber"))
    | frozenset(symbol for symbol, names in COMPOUNDS.items() if names[0].endswith("volt")),
}

# How the heading of a column without unit begins that is an angle instead of a time, or a flux
# linkage.
_NAMES_OF_SECOND_KIND = {"angle": "theta|angle|phi|winkel", "flux": "psi|flux|lambda"}

_TIME_NAME = re.compile(
    r"t|time\b.*|zeit\b.*|temps\b.*|tiempo\b.*|x[- ]?axis|seconds?|timestamp", re.IGNORECASE
)

_CHANNEL_NAME = re.compile(
    r"(ch|chan|channel|kanal|voie|canal|trace)[ _]?[0-9a-d]+v?", re.IGNORECASE
)

_COUNT_NAME = re.compile(r"sequence|samples?|index|point|nr\.?|no\.?|#", re.IGNORECASE)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"

_INTERVAL = re.compile(
    r"\W*(?:(?:x ?inc(?:rement)?|t ?inc(?:rement)?|increment|h ?resolution|resolution|dt|delta "
    r"?[tx]|t ?interval)\b|(?:sampl(?:e|ing) ?|time )(?:interval|period)\b)(.*)",
    re.IGNORECASE | re.DOTALL,
)

_RATE = re.compile(r"\W*(?:sampl(?:e|ing) ?(?:rate|frequency))\b(.*)", re.IGNORECASE | re.DOTALL)
_STATED = re.compile(rf"(?<![\w.+-])({_NUMBER})\s*(\w*)(?=$|[\s,;:\"'])")

_RATE_UNITS = {
    "": 1.0,
    "Hz": 1.0,
    "kHz": 1e3,
    "MHz": 1e6,
    "GHz": 1e9,
    "S": 1.0,
    "Sa": 1.0,
    "kSa": 1e3,
    "MSa": 1e6,
}

# Share of falling steps from which on a column is no time: a voltage falls in half of its steps.
_FALLS = 0.25


@dataclass(frozen=True, slots=True)
class Axis:
    """What the samples of a table lie over.

    Args:
        kind: ``time`` or ``angle``.
        values: In s or rad (as the column has it, of the electrical or mechanical angle), shape
            (N,).
        column: Place of the column among those of the table; None where times come from an
            interval.
        ignored: Place of a column that counts the samples, None where there is none.
    """

    kind: Literal["time", "angle"]
    values: FloatArray
    column: int | None
    ignored: int | None = None


def kind_and_unit(table: TextTable, column: int) -> tuple[str, str]:
    """Kind of a column by its unit, empty if unknown, and the unit's symbol."""
    unit = symbol(table.units[column])
    return next((kind for kind, symbols in UNIT_KINDS.items() if unit in symbols), ""), unit


def symbol(unit: str) -> str:
    """Symbol of a unit that may be written as a word, as some oscilloscopes do."""
    unit = unit.strip()
    return unit if unit in SYMBOLS or unit in COMPOUNDS else _WORDS.get(unit.casefold(), unit)


def factor(
    table: TextTable, column: int, given: str | None, wanted: tuple[str, str], origin: Origin
) -> tuple[str, float]:
    """Which of the wanted kinds a column is, and the factor to SI units."""
    kind, unit = kind_and_unit(table, column)
    if given is not None:
        unit = symbol(given)
        kind = next((name for name in wanted if unit in UNIT_KINDS[name]), "")
    if kind in wanted:
        return kind, 1.0 if unit == DIMENSIONS[kind].unit else parse_quantity(f"1 {unit}", kind)
    if unit:
        examples = " or ".join(DIMENSIONS[name].unit for name in wanted)
        raise origin.error(
            f"{table.names[column]} has the unit {unit!r}, expected e.g. {examples}", 0
        )
    named = re.match(_NAMES_OF_SECOND_KIND[wanted[1]], table.names[column], re.IGNORECASE)
    return wanted[1] if named else wanted[0], 1.0


def find_axis(
    table: TextTable,
    column: int | None,
    time_unit: str | None,
    interval: float | None,
    origin: Origin,
) -> Axis:
    """Times or angles of a table's samples.

    Args:
        table: The file.
        column: Place of the column that the user calls the axis, None where it is to be found: only
            the first can be one.
        time_unit: Unit of that column, where the user gave one.
        interval: Time between two samples in s that the user gave, or None.
        origin: Where the samples come from.

    Raises:
        InputError: Nothing tells the times, or two things tell them differently.
    """
    kind: AxisKind = "time"
    if column is None:
        column = 0
        kind = "time" if time_unit is not None else _kind_of_first(table)
    if kind in ("time", "angle"):
        if interval is not None:
            title = table.names[column]
            raise origin.error(
                f"the file has {kind}s of its own ('{title}'); leave the interval out", None
            )
        found, scale = factor(table, column, time_unit, ("time", "angle"), origin)
        return Axis(
            "angle" if found == "angle" else "time", table.values[:, column] * scale, column
        )
    stated = _stated_interval(table.preamble, origin)
    if interval is not None and stated is not None and abs(interval - stated) > 1e-3 * stated:
        given = format_quantity(interval, "s")
        raise origin.error(
            f"the interval is {given}, but the file states {format_quantity(stated, 's')}", None
        )
    step = interval if interval is not None else stated
    if step is None:
        raise origin.error(_without_time(table, kind), None)
    ignored = 0 if kind == "count" else None
    counts = table.values[:, 0] if kind == "count" else np.arange(float(table.values.shape[0]))
    return Axis("time", counts * step, None, ignored)


def _kind_of_first(table: TextTable) -> AxisKind:
    """What the first column is: by its heading, its unit, or how its numbers run."""
    name, values = table.names[0], table.values[:, 0]
    kind, unit = kind_and_unit(table, 0)
    if _CHANNEL_NAME.fullmatch(name) or kind in ("voltage", "flux"):
        return "none"
    if unit.casefold() == "sequence" or _COUNT_NAME.fullmatch(name):
        return "count"
    if kind == "angle" or (
        not unit and re.match(_NAMES_OF_SECOND_KIND["angle"], name, re.IGNORECASE)
    ):
        return "angle"
    steps = np.diff(values)
    if _TIME_NAME.fullmatch(name):
        return "time"
    if np.count_nonzero(steps < 0.0) > _FALLS * steps.size:
        return "none" if not unit or kind == "time" else "time"
    return "count" if not unit and np.all(steps == 1.0) else "time"


def _without_time(table: TextTable, kind: AxisKind) -> str:
    """What to say of a table without times."""
    first = table.names[0]
    what = f"'{first}' counts the samples" if kind == "count" else f"'{first}' looks like a channel"
    return (
        f"the file has no column of times and states no interval ({what}); write the time between "
        "two samples: --interval 2 us, in a design interval: 2 us"
    )


def _stated_interval(preamble: Sequence[str], origin: Origin) -> float | None:
    """Time between two samples in s by the lines above or beside the rows,
    None where they say nothing.
    """
    for pattern, is_rate in ((_INTERVAL, False), (_RATE, True)):
        found = {
            value for line in preamble if (value := _stated_in(line, pattern, is_rate)) is not None
        }
        if found:
            if max(found) > 1.001 * min(found):
                texts = " and ".join(format_quantity(value, "s") for value in sorted(found)[:2])
                raise origin.error(
                    f"the file states several sample intervals, {texts}; save the channels alone",
                    None,
                )
            return min(found)
    return None


def _stated_in(line: str, pattern: re.Pattern[str], is_rate: bool) -> float | None:
    """Interval in s that a line states, None where it states none."""
    named = pattern.match(line)
    if named is None:
        return None
    text = named[1]
    if "," in text and "." not in text and re.search(r"[;\t:=]\s*[-+]?\d+,\d", text):
        text = text.replace(",", ".")
    found = set()
    for match in _STATED.finditer(text):
        number, unit = float(match[1]), match[2]
        scale = _RATE_UNITS.get(unit) if is_rate else _time_scale(unit)
        if scale is not None and number > 0.0:
            found.add(1.0 / (number * scale) if is_rate else number * scale)
    return found.pop() if len(found) == 1 else None


def _time_scale(unit: str) -> float | None:
    """Seconds of a unit of time, 1 without one, None of another unit."""
    unit = symbol(unit)
    if not unit:
        return 1.0
    return parse_quantity(f"1 {unit}", "time") if unit in UNIT_KINDS["time"] else None
