"""The data of a whole figure: one table with a column for everything that is drawn, and where
each panel lies.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from dqforge.machines.records import dataclass
from dqforge.reports.figure_data.axis_words import NO_UNIT, plain
from dqforge.reports.figure_data.drawn_artists import (
    Column,
    Direction,
    Drawn,
    Keys,
    PanelReader,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

_POINTS = 72.0
_LEVELS = 4


@dataclass(frozen=True, slots=True)
class Panel:
    """One panel and what is in it.

    Attributes:
        axes: The panel as it is drawn.
        x, y: Its axes.
        title: In plain letters.
        drawn: What it shows.
    """

    axes: Axes
    x: Direction
    y: Direction
    title: str
    drawn: tuple[Drawn, ...]


@dataclass(frozen=True, slots=True)
class FigureSheet:
    """The data of a figure.

    Attributes:
        headers: Of the columns: what, whose, and the unit in brackets; names have none.
        columns: Their cells as they are printed; shorter ones end earlier.
        panels: Those that show data.
        places: For each panel, for each thing in it, the indices of its columns.
    """

    headers: tuple[str, ...]
    columns: tuple[tuple[str, ...], ...]
    panels: tuple[Panel, ...]
    places: tuple[tuple[tuple[int, ...], ...], ...]

    def csv(self) -> str:
        """The table, comma-separated; short columns are filled up with empty cells."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.headers)
        writer.writerows(zip_longest(*self.columns, fillvalue=""))
        return text.getvalue()

    def frames(self) -> list[dict[str, Any]]:
        """Where each panel lies in the drawing, in points from its upper left corner, how its axes
        run, and which columns each thing in it has.

        Holds for a figure that has been drawn.
        """
        frames: list[dict[str, Any]] = []
        for panel, places in zip(self.panels, self.places, strict=True):
            whole = panel.axes.get_figure(root=True)
            assert whole is not None
            width, height = whole.get_size_inches() * _POINTS
            box = panel.axes.get_position()
            frames.append(
                {
                    "box": [
                        round(box.x0 * width, 2),
                        round((1.0 - box.y1) * height, 2),
                        round(box.x1 * width, 2),
                        round((1.0 - box.y0) * height, 2),
                    ],
                    "x": _run(panel.axes.get_xlim(), panel.x),
                    "y": _run(panel.axes.get_ylim(), panel.y),
                    "row": self._shared(panel),
                    "drawn": [
                        _thing(drawn, at) for drawn, at in zip(panel.drawn, places, strict=True)
                    ],
                }
            )
        return frames

    def _shared(self, panel: Panel) -> int:
        """The first panel with which this one shares its horizontal axis."""
        grouper = panel.axes.get_shared_x_axes()
        return next(
            k
            for k, other in enumerate(self.panels)
            if other.axes is panel.axes or grouper.joined(other.axes, panel.axes)
        )


def _run(limits: tuple[float, float], at: Direction) -> dict[str, Any]:
    unit = at.quantity.unit
    found: dict[str, Any] = {
        "name": at.quantity.name,
        "unit": "" if unit == NO_UNIT else unit,
        "from": float(f"{limits[0] * at.factor:.9g}"),
        "to": float(f"{limits[1] * at.factor:.9g}"),
    }
    if at.log:
        found["log"] = 1
    if at.names:
        found["names"] = [[float(f"{place:.6g}"), name] for place, name in at.names]
    return found


def _thing(drawn: Drawn, at: tuple[int, ...]) -> dict[str, Any]:
    found: dict[str, Any] = {"kind": drawn.kind, "at": list(at)}
    if any(drawn.colours):
        found["colours"] = list(drawn.colours)
    if drawn.places:
        found["places"] = [float(f"{place:.6g}") for place in drawn.places]
    if drawn.along != "x":
        found["along"] = drawn.along
    return found


def _legends(axes: Axes) -> Iterator[Legend]:
    yield from axes.figure.legends
    legend = axes.get_legend()
    if legend is not None:
        yield legend


def _keys(axes: Axes) -> Keys:
    """What the legends of a panel and of its figure say of colours and dashes, where they say one
    thing only.
    """
    from matplotlib.colors import to_hex
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    said: dict[tuple[str, str], set[str]] = {}
    for legend in _legends(axes):
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
            name = plain(text.get_text())
            if isinstance(handle, Line2D):
                colour = str(to_hex(handle.get_color()))
                said.setdefault((colour, str(handle.get_linestyle())), set()).add(name)
                said.setdefault((colour, ""), set()).add(name)
            elif isinstance(handle, Patch):
                said.setdefault((str(to_hex(handle.get_facecolor())), ""), set()).add(name)
    return {key: next(iter(names)) for key, names in said.items() if len(names) == 1}


def _header(column: Column, title: str, level: int, number: int) -> str:
    """What a column is called; higher levels say more."""
    name = column.quantity.name
    whose = column.series if column.series.lower() != name.lower() else ""
    if column.of is not None:
        of = column.of.name
        full = " ".join(part for part in (of, f"in {column.of.unit}", whose) if part)
        whose = ("", whose or of, full)[min(level, 2)]
    text = f"{name}: {whose}" if whose else name
    if level > 1 and title and title != name:
        text = f"{title}, {text}"
    if level > _LEVELS - 2:
        text += f" ({number})"
    return f"{text} [{column.quantity.unit}]" if column.quantity.unit else text


def _headers(columns: Sequence[tuple[Column, str]]) -> tuple[str, ...]:
    """The shortest names that part the columns."""
    levels = [0] * len(columns)
    for _ in range(_LEVELS):
        seen: Counter[str] = Counter()
        found = []
        for (column, title), level in zip(columns, levels, strict=True):
            plain_name = _header(column, title, min(level, _LEVELS - 2), 0)
            seen[plain_name] += 1
            found.append(_header(column, title, level, seen[plain_name]))
        often = Counter(found)
        if max(often.values(), default=1) == 1:
            break
        levels = [
            level + 1 if often[header] > 1 else level
            for header, level in zip(found, levels, strict=True)
        ]
    return tuple(found)


def read_figure(figure: Figure) -> FigureSheet:
    """The data of everything that is drawn in a figure.

    Args:
        figure: Any.
    """
    panels = []
    for axes in figure.axes:
        ticks = len(axes.get_xticks()) + len(axes.get_yticks())
        if axes.get_label() == "<colorbar>" or not ticks:
            continue  # a scale of colours, or a diagram
        reader = PanelReader(axes, _keys(axes))
        drawn = tuple(reader.drawn())
        if drawn:
            panels.append(Panel(axes, reader.x, reader.y, reader.title, drawn))
    table = _Table()
    places = tuple(
        tuple(
            tuple(table.place(column, panel.title) for column in thing.columns)
            for thing in panel.drawn
        )
        for panel in panels
    )
    columns = table.named()
    cells = tuple(column.cells for column, _ in columns)
    return FigureSheet(_headers(columns), cells, tuple(panels), places)


class _Table:
    """Columns in the order in which they come; arguments that are the same to the last digit are
    one.
    """

    def __init__(self) -> None:
        self._columns: list[tuple[Column, str]] = []
        self._known: dict[tuple[Any, ...], int] = {}
        self._series: dict[int, dict[str, None]] = {}

    def place(self, column: Column, title: str) -> int:
        """Index of a column."""
        key: tuple[Any, ...] = (column.quantity, column.cells)
        if column.of is None:
            key = (column.quantity, column.series, title, column.cells)
        at = self._known.setdefault(key, len(self._columns))
        if at == len(self._columns):
            self._columns.append((column, title))
        self._series.setdefault(at, {})[column.series] = None
        return at

    def named(self) -> list[tuple[Column, str]]:
        """The columns; one of several series has the names of them all."""
        return [
            (replace(column, series=_together(list(self._series[at]))), title)
            for at, (column, title) in enumerate(self._columns)
        ]


def _together(names: list[str]) -> str:
    named = [name for name in names if name]
    return ", ".join(named) if len(named) < 4 else f"{named[0]} to {named[-1]}"
