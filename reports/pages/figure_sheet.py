"""The data of a whole figure: one table with a column for everything that is drawn, and where
each panel lies.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.reports.pages.scaled import NO_UNIT, Quantity, factor_of, grid_of, plain, quantity

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.container import BarContainer, Container, ErrorbarContainer
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle


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


# What the artists of one panel stand for: columns of numbers with names and units.
#
# Whoever draws names a curve by its label; a label that begins with ``_`` names it here and keeps
# it out of the legend, and the label ``_`` says that a curve is decoration. Bands, spans, cells and
# lines across a panel are data where they have a name, and decoration where they have none. A bar
# is named by its ``gid``, else by the tick beside it.

_DIGITS, _STEPS = 1e-5, 1e-4
Keys = Mapping[tuple[str, str], str]  # Entries of the legends of a figure by colour and dashes.


@dataclass(frozen=True, slots=True)
class Column:
    """One column of the data.

    Attributes:
        quantity: What it holds; the unit is empty where it holds names.
        series: Whose values these are, empty where it needs no name.
        of: The values for which this is the argument; None for values themselves.
        cells: As they are printed.
    """

    quantity: Quantity
    series: str
    of: Quantity | None
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Drawn:
    """One thing that is drawn.

    Attributes:
        kind: ``line``, ``step``, ``path``, ``points``, ``band``, ``span``, ``level``, ``stairs``,
            ``bars``, ``cells``, ``named-cells`` or ``grid``.
        columns: Its data.
        colours: As ``#rrggbb``: one, or of bars one for each column of values; empty where they
            tell nothing apart.
        places: Where bars stand, in data coordinates.
        along: Axis along which bars stand, or which a span or a level marks: ``x`` or ``y``.
    """

    kind: str
    columns: tuple[Column, ...]
    colours: tuple[str, ...] = ()
    places: tuple[float, ...] = ()
    along: str = "x"


@dataclass(frozen=True, slots=True)
class Direction:
    """An axis as its data need it.

    Attributes:
        quantity: Name and unit of its label.
        factor: From data to the unit of the label.
        names: Places of ticks that have names in place of numbers.
        log: Whether its scale is logarithmic.
    """

    quantity: Quantity
    factor: float
    names: tuple[tuple[float, str], ...]
    log: bool

    def texts(self, values: Any) -> tuple[str, ...]:
        """Values as they are printed; names where each of them lies on a named tick."""
        numbers = np.asarray(values, dtype=np.float64)
        named = dict(self.names)
        if named and all(float(value) in named for value in numbers.tolist()):
            return tuple(named[float(value)] for value in numbers.tolist())
        return number_texts(numbers * self.factor, log=self.log)


def number_texts(values: FloatArray, *, log: bool = False) -> tuple[str, ...]:
    """Numbers with six digits of the largest, or as many as part the values; six of each on a
    logarithmic scale. What is no number is empty.

    Args:
        values: Shape (N,).
        log: Whether small ones count as much as large ones.
    """
    known = values[np.isfinite(values)]
    largest = float(np.max(np.abs(known), initial=0.0))
    decimals = -1
    if not log and 1e-9 < largest < 1e9:
        span = float(np.max(known) - np.min(known))
        step = min(largest * _DIGITS, span * _STEPS if span > 0.0 else math.inf)
        decimals = max(math.ceil(-math.log10(step)), 0)
    return tuple(_number(value, decimals) for value in values.tolist())


def _number(value: float, decimals: int) -> str:
    if not math.isfinite(value):
        return ""
    text = f"{value:.6g}" if not 0 <= decimals <= 14 else f"{value:.{decimals}f}"
    if "." in text and "e" not in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _label(axes: Axes, along: str) -> str:
    """Label of an axis, or of one that shares its scale, or of the whole figure."""
    grouper = getattr(axes, f"get_shared_{along}_axes")()
    for one in (axes, *axes.figure.axes):
        if one is axes or grouper.joined(axes, one):
            text = getattr(one, f"get_{along}label")()
            if text:
                return str(text)
    return str(getattr(axes.figure, f"get_sup{along}label")())


def _title(axes: Axes) -> str:
    return " ".join(str(axes.get_title(loc)) for loc in ("left", "center") if axes.get_title(loc))


def _names(axis: Axis) -> tuple[tuple[float, str], ...]:
    """Ticks that were set one by one with a text each."""
    from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter

    formatter, locator = axis.get_major_formatter(), axis.get_major_locator()
    if not isinstance(formatter, (FixedFormatter, FuncFormatter)) or factor_of(axis) != 1.0:
        return ()
    if not isinstance(locator, FixedLocator):
        return ()
    places = [float(place) for place in locator()]
    names = [plain(str(formatter(place, k))) for k, place in enumerate(places)]
    return tuple(zip(places, names, strict=True)) if any(names) else ()


def direction(axes: Axes, along: str) -> Direction:
    """How one axis of a panel is to be read.

    Args:
        axes: The panel.
        along: ``x`` or ``y``.
    """
    axis: Axis = getattr(axes, f"{along}axis")
    found = quantity(_label(axes, along))
    if not found.name:
        title = quantity(_title(axes))
        unit = found.unit if _label(axes, along) else title.unit
        found = Quantity(title.name or f"{along}", unit)
    return Direction(found, factor_of(axis), _names(axis), axis.get_scale() == "log")


def _hex(colour: Any) -> str:
    from matplotlib.colors import to_hex

    return str(to_hex(colour))


def _face(artist: Any) -> str:
    face = np.atleast_2d(artist.get_facecolor())
    return _hex(face[0]) if len(face) else ""


class PanelReader:
    """Reads the artists of one panel.

    Args:
        axes: The panel.
        keys: What the legends of its figure say.
    """

    def __init__(self, axes: Axes, keys: Keys) -> None:
        self.axes, self.keys = axes, keys
        self.x, self.y = direction(axes, "x"), direction(axes, "y")
        self.title = plain(_title(axes))
        self._read: set[int] = set()

    def drawn(self) -> Iterator[Drawn]:
        """Everything in the panel that stands for data."""
        from matplotlib.container import BarContainer, ErrorbarContainer

        bars = []
        for container in self.axes.containers:
            self._read |= {id(artist) for artist in container.get_children()}
            if isinstance(container, BarContainer):
                bars.append(container)
            elif isinstance(container, ErrorbarContainer):
                yield self._errors(container)
        if bars:
            yield self._bars(bars)
        yield from self._grids()
        for line in self.axes.lines:
            if id(line) not in self._read and line.get_visible():
                yield from self._line(line)
        yield from self._collections()
        yield from self._patches()
        yield from self._marks()

    def _series(self, artist: Artist | Container, colour: str, dashes: str = "") -> str:
        """Name of an artist, by its label or by the legend."""
        label = str(artist.get_label())
        if label.startswith(("_child", "_container", "_nolegend")) or label in {"", "None", "_"}:
            return self.keys.get((colour, dashes), self.keys.get((colour, ""), ""))
        return plain(label.removeprefix("_"))

    def _named(self, artist: Artist) -> str:
        """Name of an artist by its own label alone."""
        label = str(artist.get_label())
        return "" if label.startswith("_child") else plain(label.removeprefix("_"))

    def _on(self, artist: Artist) -> tuple[bool, bool]:
        """Whether the coordinates of an artist are data, in x and in y."""
        x, y = artist.get_transform().contains_branch_seperately(self.axes.transData)
        return bool(x), bool(y)

    def _argument(self, values: Any, series: str, at: Direction | None = None) -> Column:
        at = self.x if at is None else at
        other = self.y if at is self.x else self.x
        return Column(at.quantity, series, other.quantity, at.texts(values))

    def _values(self, values: Any, series: str, at: Direction | None = None) -> Column:
        at = self.y if at is None else at
        return Column(at.quantity, series, None, at.texts(values))

    def _line(self, line: Line2D) -> Iterator[Drawn]:
        if self._on(line) != (True, True) or line.get_label() == "_":
            return
        x = np.asarray(line.get_xdata(orig=False), dtype=np.float64)
        y = np.ma.filled(np.ma.asarray(line.get_ydata(orig=False), dtype=np.float64), np.nan)
        kept = np.isfinite(x)
        x, y = x[kept], y[kept]
        if not np.any(np.isfinite(y)):
            return
        dashes = str(line.get_linestyle())
        shown = line.get_markeredgecolor() if dashes == "None" else line.get_color()
        colour = _hex(shown)
        series, step = self._series(line, colour, dashes), np.diff(x)
        kind = "line" if np.all(step >= 0.0) or np.all(step <= 0.0) else "path"
        if line.get_drawstyle().startswith("steps"):
            kind = "step"
        elif dashes == "None" and kind == "path":
            kind = "points"
        yield Drawn(kind, (self._argument(x, series), self._values(y, series)), (colour,))

    def _errors(self, container: ErrorbarContainer) -> Drawn:
        line = container.lines[0]
        x, y = (np.asarray(v, dtype=np.float64) for v in line.get_data(orig=False))
        colour = _hex(line.get_markeredgecolor())
        series = self._series(container, colour)
        columns = [self._argument(x, series), self._values(y, series)]
        for bar in container.lines[2]:
            segments = np.array(bar.get_segments())
            half = 0.5 * np.ptp(segments[:, :, 1], axis=1)
            columns.append(self._values(half, f"{series} uncertainty".strip()))
        return Drawn("points", tuple(columns), (colour,))

    def _bars(self, containers: list[BarContainer]) -> Drawn:
        """Rows by the places of the bars, a column for each name or colour."""
        upright = containers[0].orientation != "horizontal"
        at, value = (self.x, self.y) if upright else (self.y, self.x)
        rows: dict[str, float] = {}
        columns: dict[str, dict[str, float]] = {}
        colours: dict[str, str] = {}
        for container in containers:
            for bar in container.patches:
                place, size = _bar(bar, upright=upright)
                name = plain(str(bar.get_gid() or "")) or self._row(at, place)
                rows.setdefault(name, place)
                series = self._series(container, _face(bar))
                columns.setdefault(series, {})[name] = size
                if colours.setdefault(series, _face(bar)) != _face(bar):
                    colours[series] = ""
        numeric = all(_is_number(name) for name in rows)
        of = at.quantity if numeric else Quantity(_heading(at.quantity.name), "")
        found = [Column(of, "", value.quantity, tuple(rows))]
        for series, sizes in columns.items():
            heights = np.array([sizes.get(name, np.nan) for name in rows])
            found.append(self._values(heights, series, value))
        along = "x" if upright else "y"
        return Drawn("bars", tuple(found), tuple(colours.values()), tuple(rows.values()), along)

    def _row(self, at: Direction, place: float) -> str:
        for tick, name in at.names:
            if abs(tick - place) < 0.5 * _least_gap(at.names):
                return name
        return number_texts(np.array([place * at.factor]))[0]

    def _grids(self) -> Iterator[Drawn]:
        from matplotlib.collections import QuadMesh
        from matplotlib.contour import ContourSet

        for found in self.axes.collections:
            if isinstance(found, ContourSet) and found.filled:
                grid = grid_of(found)
                yield self._grid(grid.x, grid.y, grid.z, quantity(grid.name))
            elif isinstance(found, QuadMesh):
                middle = np.asarray(found.get_coordinates(), dtype=np.float64)
                middle = 0.25 * (
                    middle[1:, 1:] + middle[:-1, 1:] + middle[1:, :-1] + middle[:-1, :-1]
                )
                shape = middle.shape[:2]
                shown: Any = found.get_array()
                values = np.asarray(np.ma.filled(shown.astype(float), np.nan))
                name = quantity(str(found.get_label()).removeprefix("_"))
                yield self._grid(middle[0, :, 0], middle[:, 0, 1], values.reshape(shape), name)

    def _grid(self, x: FloatArray, y: FloatArray, z: FloatArray, name: Quantity) -> Drawn:
        across, up = (x, y) if x.ndim == 2 else np.meshgrid(x, y)
        columns = (
            self._argument(across.ravel(), ""),
            self._argument(up.ravel(), "", self.y),
            Column(name, "", None, number_texts(z.ravel())),
        )
        return Drawn("grid", columns)

    def _collections(self) -> Iterator[Drawn]:
        from matplotlib.collections import LineCollection, PathCollection, PolyCollection
        from matplotlib.contour import ContourSet

        for found in self.axes.collections:
            if id(found) in self._read or isinstance(found, ContourSet):
                continue
            if isinstance(found, PathCollection):
                yield self._scatter(found)
            elif isinstance(found, LineCollection):
                yield from self._strokes(found)
            elif isinstance(found, PolyCollection) and self._named(found):
                yield from self._band(found)

    def _scatter(self, found: Any) -> Drawn:
        places, colour = np.asarray(found.get_offsets(), dtype=np.float64), _face(found)
        series = self._series(found, colour)
        columns = self._argument(places[:, 0], series), self._values(places[:, 1], series)
        return Drawn("points", columns, (colour,))

    def _strokes(self, found: Any) -> Iterator[Drawn]:
        """Upright strokes are lines of a spectrum."""
        ends = [segment for segment in found.get_segments() if len(segment) == 2]
        strokes = np.array(ends).reshape(-1, 2, 2)
        if not len(strokes) or np.any(strokes[:, 0, 0] != strokes[:, 1, 0]):
            return
        colour = _hex(found.get_color()[0])
        series, values = self._series(found, colour), strokes[:, 1]
        columns = self._argument(values[:, 0], series), self._values(values[:, 1], series)
        yield Drawn("line", columns, (colour,))

    def _band(self, found: Any) -> Iterator[Drawn]:
        name, colour = self._named(found), _face(found)
        corners = [np.asarray(path.vertices, dtype=np.float64) for path in found.get_paths()]
        if self._on(found) == (True, False):
            ends = np.array([(np.min(c[:, 0]), np.max(c[:, 0])) for c in corners])
            yield self._span(ends.reshape(-1, 2), name, self.x)
        elif corners:
            all_corners = np.concatenate(corners)
            x = np.unique(all_corners[:, 0])
            sides = [all_corners[all_corners[:, 0] == value, 1] for value in x]
            low = self._values(np.array([np.min(side) for side in sides]), f"{name} from")
            high = self._values(np.array([np.max(side) for side in sides]), f"{name} to")
            yield Drawn("band", (self._argument(x, name), low, high), (colour,))

    def _span(self, ends: FloatArray, name: str, at: Direction) -> Drawn:
        along = "x" if at is self.x else "y"
        columns = (
            self._values(ends[:, 0], f"{name} from", at),
            self._values(ends[:, 1], f"{name} to", at),
        )
        return Drawn("span", columns, along=along)

    def _patches(self) -> Iterator[Drawn]:
        from matplotlib.patches import Rectangle, StepPatch

        cells: dict[bool, list[tuple[Rectangle, str]]] = {True: [], False: []}
        spans: dict[tuple[str, str], list[tuple[float, float]]] = {}
        for patch in self.axes.patches:
            if id(patch) in self._read:
                continue
            if isinstance(patch, StepPatch):
                yield self._stairs(patch)
            elif isinstance(patch, Rectangle):
                on = self._on(patch)
                name = self._named(patch) if on != (True, True) else self._series(
                    patch, _face(patch)
                )  # fmt: skip
                if not name:
                    continue
                if on == (True, True):
                    cells[bool(patch.get_fill())].append((patch, name))
                elif any(on):
                    low, size = (
                        (patch.get_x(), patch.get_width())
                        if on[0]
                        else (patch.get_y(), patch.get_height())
                    )
                    spans.setdefault((name, "xy"[not on[0]]), []).append((low, low + size))
        for filled, found in cells.items():
            if found:
                yield self._cells(found, self.title, "" if filled else "part")
        for (name, along), ends in spans.items():
            yield self._span(np.array(ends), name, self.x if along == "x" else self.y)

    def _stairs(self, patch: Any) -> Drawn:
        data, colour = patch.get_data(), _hex(patch.get_edgecolor())
        series = self._series(patch, colour)
        values = np.asarray(data.values, dtype=np.float64)
        edges = self.x.texts(np.asarray(data.edges, dtype=np.float64))
        of = self.y.quantity
        columns = (
            Column(self.x.quantity, f"{series} from".strip(), of, edges[:-1]),
            Column(self.x.quantity, f"{series} to".strip(), of, edges[1:]),
            self._values(values, series),
        )
        return Drawn("stairs", columns, (colour,))

    def _cells(self, found: list[tuple[Rectangle, str]], heading: str, series: str) -> Drawn:
        """Rectangles with a name each; on axes whose ticks have names, a row for each tick."""
        boxes = np.array([p.get_bbox().get_points().T.ravel() for p, _ in found])
        names = tuple(name for _, name in found)
        what = Quantity(quantity(heading).name or "cell", "")
        if self.x.names and self.y.names:
            rows = [
                (across, up, name)
                for (left, right, low, high), name in zip(boxes.tolist(), names, strict=True)
                for place, across in self.x.names
                if left < place < right
                for level, up in self.y.names
                if low < level < high
            ]
            x, y, told = (tuple(column) for column in zip(*rows, strict=True))
            columns = (
                Column(self.x.quantity, "", what, x),
                Column(self.y.quantity, "", what, y),
                Column(what, "", None, told),
            )
            return Drawn("named-cells", columns)
        sides = (("from", self.x), ("to", self.x), ("from", self.y), ("to", self.y))
        ends = [
            Column(
                Quantity(f"{at.quantity.name} {word}", at.quantity.unit),
                series,
                None,
                at.texts(boxes[:, k]),
            )
            for k, (word, at) in enumerate(sides)
        ]
        return Drawn("cells", (*ends, Column(what, series, None, names)))

    def _marks(self) -> Iterator[Drawn]:
        """Lines across the panel that have a name."""
        found: dict[tuple[str, str], list[float]] = {}
        for line in self.axes.lines:
            on, name = self._on(line), self._named(line)
            if name and on in {(True, False), (False, True)}:
                values = line.get_xdata() if on[0] else line.get_ydata()
                found.setdefault((name, "xy"[not on[0]]), []).append(float(np.ravel(values)[0]))
        for (name, along), places in found.items():
            at = self.x if along == "x" else self.y
            yield Drawn("level", (self._values(np.array(places), name, at),), along=along)


def _bar(bar: Rectangle, *, upright: bool) -> tuple[float, float]:
    """Middle and size of a bar."""
    if upright:
        return bar.get_x() + 0.5 * bar.get_width(), bar.get_height()
    return bar.get_y() + 0.5 * bar.get_height(), bar.get_width()


def _least_gap(names: tuple[tuple[float, str], ...]) -> float:
    places = sorted(place for place, _ in names)
    return min((b - a for a, b in pairwise(places)), default=1.0)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _heading(name: str) -> str:
    return name if name not in {"x", "y"} else "alternative"
