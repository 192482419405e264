"""Axes whose ticks stand in another unit than their data, and maps that keep the grid they
were drawn from.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.contour import ContourSet


@dataclass(frozen=True, slots=True)
class DrawnGrid:
    """Values over two axes.

    Attributes:
        x, y: In the units of the axes, shape (X,) and (Y,), or both (Y, X) where the grid is bent.
        z: Shape (Y, X); NaN where there is none.
        name: What the values are, with their unit, as a label says it.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    name: str


_GRIDS: WeakKeyDictionary[ContourSet, DrawnGrid] = WeakKeyDictionary()


_FACTORS: WeakKeyDictionary[Any, float] = WeakKeyDictionary()


def draw_filled(axes: Axes, grid: DrawnGrid, drawn: FloatArray, **options: Any) -> ContourSet:
    """Filled contours that know the values they stand for.

    Args:
        axes: To draw into.
        grid: The values as they are told.
        drawn: The values as they are drawn, shape (Y, X): clipped, or carried on over gaps.
        options: Those of ``contourf``.
    """
    found = axes.contourf(grid.x, grid.y, drawn, **options)
    _GRIDS[found] = grid
    return found


def grid_of(contours: ContourSet) -> DrawnGrid:
    """The grid of filled contours.

    Raises:
        LookupError: They were not drawn by `draw_filled`, and their values are lost.
    """
    if contours not in _GRIDS:
        raise LookupError("filled contours have no data: draw them by draw_filled")
    return _GRIDS[contours]


def tick_in_unit(axis: Axis, factor: float) -> None:
    """Write ticks in a unit that is smaller by ``factor`` than that of the data.

    Args:
        axis: The axis; it keeps the factor.
        factor: Such as 1000 for mA.
    """
    from matplotlib.ticker import FuncFormatter

    formatter = FuncFormatter(lambda value, _: f"{value * factor:g}".replace("-", "\u2212"))
    _FACTORS[formatter] = factor
    axis.set_major_formatter(formatter)


def factor_of(axis: Axis) -> float:
    """By what the data of an axis are to be multiplied to stand in the unit of its label.

    Args:
        axis: Of any figure.
    """
    formatter: Any = axis.get_major_formatter()
    return float(_FACTORS.get(formatter, 1.0))
