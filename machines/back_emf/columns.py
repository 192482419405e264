"""Captures of the back-EMF from the columns of one or several tables, in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.axis import Axis, factor, find_axis, kind_and_unit
from dqforge.machines.back_emf.checks import Origin
from dqforge.machines.files.text_table import TextTable
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

Connection = Literal["phase", "line-to-line"]
MOST_SAMPLES = 8_000_000  # Samples of a capture: what is computed of them takes less than 1 GiB.

# Share of a sample interval by which the times of two files may differ: that of their rounding.
_SAME_TIME = 0.05


@dataclass(frozen=True, slots=True)
class BemfCapture:
    """Samples of three voltages (or flux linkages) of a machine without current, as recorded.

    Args:
        source: File name for messages.
        time: Ascending times in s, shape (N,), need not be even; None when the angle is given.
        angle: Electrical angle in rad, any origin, shape (N,), may contain both ends of the period;
            None when time is given.
        voltages: In V, shape (3, N): phases a, b, c, or line-to-line ab, bc, ca.
        lines: Line of each sample in the file, shape (N,).
        connection: What the channels were connected to.
        quantity: ``flux`` if `voltages` holds flux linkages in Wb over the angle.
    """

    source: str
    time: FloatArray | None
    angle: FloatArray | None
    voltages: FloatArray
    lines: NDArray[np.intp]
    connection: Connection = "phase"
    quantity: Literal["voltage", "flux"] = "voltage"


@dataclass(frozen=True, slots=True)
class CaptureOptions:
    """What the user says about the columns of a capture.

    Args:
        connection: What the channels were connected to.
        time_unit, voltage_unit: Units of the first and the other columns where the file has none or
            wrong ones; s and V if it has none.
        columns: Headings (without unit) of the time (or angle) and the voltages to use instead, or
            their one-based numbers among the columns that hold numbers; of the voltages alone where
            there is an interval. The same in each file.
        scale: Factors of the channels, for probes whose setting the oscilloscope did not know.
        pole_pairs: Needed only for an angle that the heading calls mechanical.
        interval: Time between two samples in s, for files that do not say it.
    """

    connection: Connection = "phase"
    time_unit: str | None = None
    voltage_unit: str | None = None
    columns: Sequence[str | int] | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    pole_pairs: int | None = None
    interval: float | None = None


@dataclass(frozen=True, slots=True)
class _Part:
    """The samples of one table: their axis, and places of the channels with their
    kinds and factors to SI units.
    """

    table: TextTable
    origin: Origin
    axis: Axis
    channels: list[int]
    kinds: set[str]
    factors: list[float]


def capture_from_tables(tables: Sequence[TextTable], options: CaptureOptions) -> BemfCapture:
    """Samples in SI units from the columns of one file, or of several with
    some of the channels each.

    The first column of a file is the time or the angle (told by its heading, unit or numbers);
    where there is none the file or the user must say the interval. Of the others those in volts,
    else those in Wb, else all are the channels: three, or two line-to-line voltages (ab and bc).

    Raises:
        InputError: Nothing tells the times; columns that are missing or too many, a unit that does
            not fit, a scale that is zero or not finite, more than `MOST_SAMPLES` samples; several
            files that do not belong together.
    """
    source = tables[0].source
    origin = Origin(source, tables[0].lines)
    scale = options.scale
    if len(scale) != 3 or not (np.all(np.isfinite(scale)) and np.all(scale)):
        raise origin.error(
            f"scale must be three factors that are finite and not 0, got {scale}", None
        )
    if options.interval is not None and options.interval <= 0.0:
        raise origin.error(
            "the interval must be above 0; write the time between two samples, such as 2 us", None
        )
    parts = [_part(table, options) for table in tables]
    _check_count(
        [part.table.names[k] for part in parts for k in part.channels], options.connection, origin
    )
    for part in parts[1:]:
        _check_together(parts[0], part)
    kinds = set[str]().union(*(part.kinds for part in parts))
    axis = parts[0].axis
    if kinds == {"voltage", "flux"} or (axis.kind == "time" and "flux" in kinds):
        raise origin.error(
            "flux linkages are read over an angle, and not beside voltages; choose other columns", 0
        )
    time, angle = (
        (axis.values, None)
        if axis.kind == "time"
        else (None, _electrical(parts[0], options.pole_pairs))
    )
    quantity: Literal["voltage", "flux"] = "flux" if kinds == {"flux"} else "voltage"
    voltages = _voltages(parts, scale)
    return BemfCapture(source, time, angle, voltages, tables[0].lines, options.connection, quantity)


def _part(table: TextTable, options: CaptureOptions) -> _Part:
    """Axis and channels of one table."""
    origin = Origin(table.source, table.lines)
    if table.lines.size > MOST_SAMPLES:
        count = f"the capture has {table.lines.size / 1e6:.3g} million samples"
        advice = "give fewer periods, or sample more slowly"
        raise origin.error(
            f"{count}, at most {MOST_SAMPLES / 1e6:g} million can be read; {advice}", None
        )
    named = _named(table, options.columns, origin) if options.columns else None
    if named is None or options.interval is not None:
        axis = find_axis(table, None, options.time_unit, options.interval, origin)
    else:
        axis = find_axis(table, named[0], options.time_unit, None, origin)
        named = named[1:]
    if axis.column is None and axis.ignored is None and kind_and_unit(table, 0)[0] == "time":
        # What the heading calls the horizontal unit was laid upon the first channel.
        table = replace(table, units=(table.units[-1], *table.units[1:]))
    channels = named if named is not None else _guessed(table, axis)
    scaled = [
        factor(table, column, options.voltage_unit, ("voltage", "flux"), origin)
        for column in channels
    ]
    return _Part(
        table, origin, axis, channels, {kind for kind, _ in scaled}, [unit for _, unit in scaled]
    )


def _guessed(table: TextTable, axis: Axis) -> list[int]:
    """Places of the channels: of the columns beside the axis those in V, else those in Wb,
    else all.

    Columns that repeat the axis, as blocks side by side have them, are none.
    """
    others = [
        column
        for column in range(table.values.shape[1])
        if column not in (axis.column, axis.ignored)
    ]
    if axis.column is not None:
        first = table.values[:, axis.column]
        others = [column for column in others if not np.array_equal(table.values[:, column], first)]
    kinds = {column: kind_and_unit(table, column)[0] for column in others}
    by_kind = [
        [column for column in others if kinds[column] == kind] for kind in ("voltage", "flux")
    ]
    return next((found for found in by_kind if found), others)


def _named(table: TextTable, columns: Sequence[str | int], origin: Origin) -> list[int]:
    """Places of columns given by heading or one-based number."""
    places = []
    names = list(table.names)
    for column in columns:
        if isinstance(column, str) and column in names:
            places.append(names.index(column))
        elif isinstance(column, int) and 1 <= column <= table.values.shape[1]:
            places.append(column - 1)
        else:
            raise origin.error(
                f"there is no column {column!r}; the file has {', '.join(table.names)}", None
            )
    return places


def _check_count(names: list[str], connection: Connection, origin: Origin) -> None:
    """Refuse anything but three channels, or two line-to-line ones."""
    if len(names) == 3 or (len(names) == 2 and connection == "line-to-line"):
        return
    listed = ", ".join(names) or "none"
    if len(names) > 3:
        raise origin.error(
            f"there are {len(names)} columns of voltages ({listed}); name the time and three of "
            "them",
            0,
        )
    missing = "a third phase is needed" if len(names) == 2 else "three phases are needed"
    count = "is 1 channel" if len(names) == 1 else f"are {len(names)} channels"
    raise origin.error(
        f"there {count} ({listed}): {missing}; capture them together, name the files of all "
        "channels, or give line-to-line voltages",
        0,
    )


def _check_together(first: _Part, other: _Part) -> None:
    """Refuse two files whose samples do not lie over the same times or angles."""
    here, there = first.axis, other.axis
    name = first.table.source
    if here.kind != there.kind or (here.column is None) != (there.column is None):
        raise other.origin.error(
            f"one of this file and {name} has no times of its own; save both the same way", None
        )
    if here.values.size != there.values.size:
        count = f"{there.values.size} samples, {name} has {here.values.size}"
        raise other.origin.error(f"the file has {count}; save the channels of one capture", None)
    gap = float(np.max(np.abs(there.values - here.values)))
    if gap > _SAME_TIME * abs(float(here.values[-1] - here.values[0])) / (here.values.size - 1):
        unit = "s" if here.kind == "time" else "rad"
        message = f"its samples lie up to {format_quantity(gap, unit, 3)} beside those of {name}"
        raise other.origin.error(f"{message}; save the channels of one capture", None)


def _electrical(part: _Part, pole_pairs: int | None) -> FloatArray:
    """Electrical angle in rad, shape (N,)."""
    column = part.axis.column
    if column is None or "mech" not in part.table.names[column].casefold():
        return part.axis.values
    if pole_pairs is None:
        name = part.table.names[column]
        raise part.origin.error(
            f"{name} is a mechanical angle; give the number of pole pairs", None
        )
    return part.axis.values * pole_pairs


def _voltages(parts: Sequence[_Part], scale: tuple[float, float, float]) -> FloatArray:
    """Channels of all parts in SI units, shape (3, N).

    The third of two is what makes their sum zero.
    """
    columns = [
        (part.table.values[:, k], unit)
        for part in parts
        for k, unit in zip(part.channels, part.factors, strict=True)
    ]
    voltages = np.empty((3, parts[0].axis.values.size))
    for row, (values, unit), share in zip(voltages, columns, scale, strict=False):
        np.multiply(values, unit * share, out=row)
    if len(columns) == 2:
        np.negative(voltages[0] + voltages[1], out=voltages[2])
    return voltages
