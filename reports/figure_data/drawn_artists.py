"""What the artists of one panel stand for: columns of numbers with names and units.

Whoever draws names a curve by its label; a label that begins with ``_`` names it here and keeps
it out of the legend, and the label ``_`` says that a curve is decoration. Bands, spans, cells and
lines across a panel are data where they have a name, and decoration where they have none. A bar is
named by its ``gid``, else by the tick beside it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.reports.figure_data.axis_words import Quantity, plain, quantity
from dqforge.reports.figure_data.scaled import factor_of, grid_of

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.container import BarContainer, Container, ErrorbarContainer
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

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
