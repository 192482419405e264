"""Axes whose ticks stand in another unit than their data, and maps that keep the grid they
were drawn from.
"""

from __future__ import annotations

import re
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


# Labels of axes and legends in plain words: what is meant, and its unit.

_LETTERS = {
    "\u00b5": "u",
    "\u03bc": "u",
    "\u00b0": " deg",
    "\u03b1": "alpha",
    "\u03b2": "beta",
    "\u03b8": "theta",
    "\u03c3": "sigma",
    "\u03c4": "tau",
    "\u03c6": "phi",
    "\u03c8": "psi",
    "\u03c9": "omega",
    "\u03a9": "Ohm",
    "\u2212": "-",
    "\u2013": "-",
    "\u00b7": " ",
    "\u00b2": "^2",
    "\u202f": " ",
    "\u00a0": " ",
}

_SIMPLE = r"[pnumkM]?(?:Ohm|Hz|Wh|Wb|VA|rad|kg|A|V|W|H|N|F|J|s|m|K)(?:\^?[23])?"
_UNIT = rf"(?:%|ppm|ppb|rpm|dB|deg(?: ?C)?|{_SIMPLE}(?:[ /]{_SIMPLE})*)(?!\w)"
_SHARE = rf"{_UNIT} of .*"
NO_UNIT = "1"  # Unit of what has none.


@dataclass(frozen=True, slots=True)
class Quantity:
    """What an axis shows.

    Attributes:
        name: Its name, empty where the label is a unit alone.
        unit: Its unit, "1" where it has none.
    """

    name: str
    unit: str


def plain(text: str) -> str:
    """Text of a figure in plain letters: subscripts after a low line, Greek letters by name.

    Args:
        text: As it is drawn, such as ``$L_{dd}$``.
    """
    text = text.replace("$", "").replace("{", "").replace("}", "").replace("\n", " ")
    for letter, word in _LETTERS.items():
        text = text.replace(letter, word)
    text = re.sub(r"\bdegrees\b", "deg", text)
    return " ".join(text.replace("deg C", "degC").split())


def quantity(label: str) -> Quantity:
    """Name and unit that a label of an axis holds.

    Args:
        label: Such as ``$i_d$ error in mA``, ``Turn (rad)``, ``machines [%]`` or ``A``.
    """
    text = plain(label)
    alone = re.fullmatch(rf"({_SHARE}|{_UNIT})(?: \(.*\))?", text)
    if alone is not None:
        return Quantity("", alone.group(1))
    found = re.search(rf"(?:^| )(?:in|by) ({_SHARE})$", text)
    found = found or re.search(rf"(?:^| )(?:in|by) ({_UNIT})", text)
    found = found or re.search(rf" ?[\[(]({_UNIT}[^\])]*)[\])]", text)
    if found is None:
        return Quantity(text, NO_UNIT)
    name = f"{text[: found.start()]}{text[found.end() :]}"
    return Quantity(" ".join(name.split()).strip(", "), found.group(1))
