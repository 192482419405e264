"""Block drawings in the style of the figures: blocks of text, and arrows from one to the next."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from matplotlib.patches import FancyArrowPatch, Rectangle

from dqforge.reports.pages.figures_style import BLUE, FAINT, INK, MUTED, PAPER, WIDTH, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Point = tuple[float, float]

_LINE = 0.2

"""Height of a line of text in inches."""


@dataclass(frozen=True, slots=True)
class Block:
    """A block of ``width`` inches with a title and lines below it; ``x``, ``y`` is its upper left
    corner in inches from the lower left one of the figure.
    """

    x: float
    y: float
    width: float
    title: str
    lines: tuple[str, ...] = ()
    colour: str = BLUE

    @property
    def height(self) -> float:
        """Room for the title and the lines, in inches."""
        return 0.15 + _LINE * (1 + len(self.lines))

    @property
    def left(self) -> Point:
        """Middle of the left side."""
        return self.x, self.y - 0.5 * self.height

    @property
    def right(self) -> Point:
        """Middle of the right side."""
        return self.x + self.width, self.y - 0.5 * self.height

    @property
    def top(self) -> Point:
        """Middle of the upper side."""
        return self.x + 0.5 * self.width, self.y

    @property
    def bottom(self) -> Point:
        """Middle of the lower side."""
        return self.x + 0.5 * self.width, self.y - self.height


def sheet(name: str, height: float, describe: str) -> tuple[Figure, Axes]:
    """An empty figure of ``height`` inches, and axes over all of it that count in inches."""
    figure = new_figure(name, height, describe)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, WIDTH), ylim=(0.0, height))
    axes.axis("off")
    return figure, axes


def draw(axes: Axes, *blocks: Block) -> None:
    """Blocks with a bar in their colour at the left side."""
    for block in blocks:
        low = block.y - block.height
        frame: dict[str, Any] = {"facecolor": PAPER, "edgecolor": FAINT, "linewidth": 0.8}
        axes.add_patch(Rectangle((block.x, low), block.width, block.height, **frame))
        axes.add_patch(
            Rectangle((block.x, low), 0.05, block.height, facecolor=block.colour, linewidth=0.0)
        )
        for row, text in enumerate((block.title, *block.lines)):
            write(axes, (block.x + 0.13, block.y - 0.175 - _LINE * row), text, bold=row == 0)


def label(axes: Axes, place: Point, text: str, align: str = "center") -> None:
    """What an arrow stands for."""
    write(axes, place, text, align=align, muted=True)


def write(
    axes: Axes,
    place: Point,
    text: str,
    *,
    bold: bool = False,
    align: str = "left",
    muted: bool = False,
) -> None:
    """A line of text, its middle at the height of ``place``."""
    # Large enough for the width of a telephone.
    look: dict[str, Any] = {"fontsize": 10.0, "fontweight": "bold", "color": INK}
    if not bold:
        look = {"fontsize": 9.5, "color": MUTED if muted else INK}
    axes.text(*place, text, ha=align, va="center", **look)


def arrow(axes: Axes, *points: Point, colour: str = MUTED, dashed: bool = False) -> None:
    """An arrow along straight pieces; its head is at the last point."""
    line: Any = (0, (3.0, 2.0)) if dashed else "-"
    for start, end in pairwise(points[:-1]):
        axes.plot(*zip(start, end, strict=True), color=colour, linewidth=1.1, linestyle=line)
    head: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 9.0, "shrinkA": 0, "shrinkB": 0}
    axes.add_patch(
        FancyArrowPatch(*points[-2:], **head, color=colour, linewidth=1.1, linestyle=line)
    )
