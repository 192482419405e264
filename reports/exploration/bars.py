"""Bars and histograms of a study as places on a drawing, for the template that draws them."""

from __future__ import annotations

import math
from itertools import zip_longest
from typing import Any

from dqforge.machines.records import dataclass
from dqforge.reports.pages.figures_style import BLUE, RED, SKY

WIDTH = 420.0  # Width of every drawing in its own units.
_LEFT, _RIGHT, _ROW, _HEIGHT, _FOOT = 170.0, 46.0, 30.0, 150.0, 34.0


def _figure(value: float | None) -> str:
    return f"{value:.6g}" if value is not None and math.isfinite(value) else ""


@dataclass(frozen=True, slots=True)
class Bar:
    """Sensitivity to one input: of first order, and total where that is known."""

    name: str
    first: float
    total: float | None


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle with what is told of it under the pointer."""

    x: float
    y: float
    width: float
    height: float
    told: str
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Words:
    """Text at a place; ``anchor`` as of SVG."""

    x: float
    y: float
    text: str
    anchor: str = "start"


@dataclass(frozen=True, slots=True)
class BarChart:
    """Bars of one output's sensitivities, from 0 to 1."""

    title: str
    bars: tuple[Bar, ...]
    width: float = WIDTH

    @property
    def height(self) -> float:
        """Height of the drawing."""
        return _ROW * len(self.bars) + _FOOT

    @property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """Total sensitivities behind those of first order."""
        found = []
        for place, bar in enumerate(self.bars):
            y = _ROW * place + 6.0
            told = f"{bar.name}: first order {bar.first:.3f}"
            if bar.total is not None and math.isfinite(bar.total):
                told += f", total {bar.total:.3f}"
                found.append(Rectangle(_LEFT, y, self._long(bar.total), 18.0, told, "total"))
            if math.isfinite(bar.first):
                found.append(Rectangle(_LEFT, y + 3.0, self._long(bar.first), 12.0, told, "first"))
        return tuple(found)

    @property
    def words(self) -> tuple[Words, ...]:
        """Names on the left, figures behind the bars, the axis below."""
        found = []
        for place, bar in enumerate(self.bars):
            y = _ROW * place + 19.0
            found.append(Words(_LEFT - 8.0, y, bar.name, "end"))
            longest = max(bar.first, bar.total or 0.0)
            text = f"{round(bar.first, 2) + 0.0:.2f}" if math.isfinite(bar.first) else "unknown"
            found.append(Words(_LEFT + self._long(longest) + 6.0, y, text))
        y = self.height - 8.0
        found += [Words(_LEFT + self._long(tick), y, f"{tick:g}", "middle") for tick in self.ticks]
        return tuple(found)

    @property
    def table(self) -> list[list[str]]:
        """Heads, and a row for each bar; what is unknown is empty."""
        rows = [
            [bar.name, *(_figure(value) for value in (bar.first, bar.total))] for bar in self.bars
        ]
        return [["input", "first order [1]", "total [1]"], *rows]

    @property
    def panels(self) -> list[dict[str, Any]]:
        """Where the bars lie, as `dqforge.reports.figure_data` says it of figures."""
        count = len(self.bars)
        drawn = {
            "kind": "bars",
            "at": [0, 1, 2],
            "along": "y",
            "places": [place + 0.5 for place in range(count)],
            "colours": [BLUE, SKY],
        }
        return [
            {
                "box": [_LEFT, 0.0, _LEFT + self._long(1.0), _ROW * count],
                "x": {"name": "share", "unit": "", "from": 0.0, "to": 1.0},
                "y": {"name": "", "unit": "", "from": count, "to": 0},
                "row": 0,
                "drawn": [drawn],
            }
        ]

    @property
    def ticks(self) -> tuple[float, ...]:
        """Marks of the axis."""
        return (0.0, 0.25, 0.5, 0.75, 1.0)

    @property
    def lines(self) -> tuple[float, ...]:
        """Places of the marks."""
        return tuple(_LEFT + self._long(tick) for tick in self.ticks)

    def _long(self, value: float) -> float:
        known = value if math.isfinite(value) else 0.0
        return round(min(max(known, 0.0), 1.05) * (WIDTH - _LEFT - _RIGHT), 2)


@dataclass(frozen=True, slots=True)
class HistogramChart:
    """Counts of an output with the bounds of what is accepted, in the unit that is shown."""

    title: str
    unit: str
    edges: tuple[float, ...]
    counts: tuple[int, ...]
    bounds: tuple[float, ...]
    accepted: str
    width: float = WIDTH
    floor: float = _HEIGHT

    @property
    def height(self) -> float:
        """Height of the drawing."""
        return _HEIGHT + _FOOT

    @property
    def _ends(self) -> tuple[float, float]:
        """Values at the ends of the axis: those of the rows, and bounds that lie near them."""
        low, high = self.edges[0], self.edges[-1]
        span = (high - low) or abs(high) or 1.0
        near = [b for b in self.bounds if low - span <= b <= high + span]
        low, high = min([low, *near]), max([high, *near])
        pad = 0.02 * ((high - low) or abs(high) or 1.0)
        return low - pad, high + pad

    def _x(self, value: float) -> float:
        low, high = self._ends
        return round(10.0 + (value - low) / (high - low) * (WIDTH - 20.0), 2)

    @property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """A bar for each bin."""
        largest = max(self.counts)
        found = []
        for place, rows in enumerate(self.counts):
            x, end = self._x(self.edges[place]), self._x(self.edges[place + 1])
            tall = round(rows / largest * (_HEIGHT - 12.0), 2)
            told = f"{self.edges[place]:.5g} to {self.edges[place + 1]:.5g} {self.unit}".rstrip()
            wide = max(round(end - x - 0.6, 2), 1.0)
            found.append(Rectangle(x, round(_HEIGHT - tall, 2), wide, tall, f"{told}: {rows} rows"))
        return tuple(found)

    @property
    def lines(self) -> tuple[tuple[float, str], ...]:
        """Places of the bounds within the drawing, with what they are."""
        low, high = self._ends
        return tuple(
            (self._x(bound), f"{bound:.5g} {self.unit}".rstrip())
            for bound in self.bounds
            if low <= bound <= high
        )

    @property
    def table(self) -> list[list[str]]:
        """Heads, a row for each bin, and the bounds beside the first of them."""
        unit = f" [{self.unit}]" if self.unit else " [1]"
        heads = [f"{self.title}: from{unit}", f"{self.title}: to{unit}", "rows [1]"]
        heads.append(f"{self.title}: bound{unit}")
        ends = zip(self.edges[:-1], self.edges[1:], self.counts, strict=True)
        cells = [[_figure(low), _figure(high), str(rows)] for low, high, rows in ends]
        found = zip_longest(cells, [_figure(bound) for bound in self.bounds], fillvalue="")
        return [heads, *([*(row or ["", "", ""]), bound] for row, bound in found)]

    @property
    def panels(self) -> list[dict[str, Any]]:
        """Where the bins lie, as `dqforge.reports.figure_data` says it of figures."""
        low, high = self._ends
        most = max(self.counts)
        return [
            {
                "box": [10.0, 12.0, WIDTH - 10.0, _HEIGHT],
                "x": {"name": self.title, "unit": self.unit, "from": low, "to": high},
                "y": {"name": "rows", "unit": "", "from": 0, "to": most},
                "row": 0,
                "drawn": [
                    {"kind": "stairs", "at": [0, 1, 2], "colours": [BLUE]},
                    {"kind": "level", "at": [3], "colours": [RED]},
                ],
            }
        ]

    @property
    def words(self) -> tuple[Words, ...]:
        """Figures of the axis; one where all rows have the same value."""
        if f"{self.edges[0]:.4g}" == f"{self.edges[-1]:.4g}":
            text = f"{self.edges[0]:.4g} {self.unit}".rstrip()
            return (Words(self._x(self.edges[0]), _HEIGHT + 20.0, text, "middle"),)
        marks = [self.edges[0], 0.5 * (self.edges[0] + self.edges[-1]), self.edges[-1]]
        texts = [f"{mark:.4g} {self.unit}".rstrip() for mark in marks]
        anchors = ("start", "middle", "end")
        return tuple(
            Words(self._x(mark), _HEIGHT + 20.0, text, anchor)
            for mark, text, anchor in zip(marks, texts, anchors, strict=True)
        )
