"""Piecewise linear curves of data sheets: a quantity over current or gate
resistance at several temperatures.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

BoolArray = NDArray[np.bool_]


End = Literal["extend", "hold"]


@dataclass(frozen=True, slots=True)
class Lookup:
    """What a table says, arrays of the shape (...).

    Args:
        value: The quantity in SI units.
        outside: Where the table does not reach: the value is held or carried on from its edge.
    """

    value: FloatArray
    outside: BoolArray

    def times(self, factor: Lookup) -> Lookup:
        """Product of two look-ups, outside where either is."""
        return Lookup(self.value * factor.value, self.outside | factor.outside)

    def plus(self, other: Lookup) -> Lookup:
        """Sum of two look-ups, outside where either is."""
        return Lookup(self.value + other.value, self.outside | other.outside)


@dataclass(frozen=True, slots=True)
class Curve:
    """Points of a curve, straight in between.

    Args:
        x, y: Abscissas, strictly ascending and not negative, and ordinates, not negative; SI units,
            N >= 1 of each.

    Raises:
        InputError: A point breaks one of these rules; with its number.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.x or len(self.x) != len(self.y):
            raise InputError(
                f"the curve has {len(self.x)} abscissas and {len(self.y)} ordinates; write pairs"
            )
        for name, values in (("abscissa", self.x), ("ordinate", self.y)):
            for k, value in enumerate(values):
                if not 0.0 <= value < np.inf:
                    raise InputError(
                        f"{name} {k} is {value:g}; write a finite number that is not negative"
                    )
        for k, (left, right) in enumerate(pairwise(self.x), 1):
            if not right > left:
                raise InputError(
                    f"abscissa {k} is {right:g}, not above {left:g} before it; write ascending ones"
                )

    def at(self, x: FloatArray, end: End) -> FloatArray:
        """Ordinates at abscissas of any shape: held below the first point, extended or held beyond
        the last.
        """
        inside: FloatArray = np.interp(x, self.x, self.y)
        if end == "hold" or len(self.x) < 2:
            return inside
        slope = (self.y[-1] - self.y[-2]) / (self.x[-1] - self.x[-2])
        # A curve that falls at its end must not be carried on below zero.
        return np.maximum(inside + slope * np.maximum(x - self.x[-1], 0.0), 0.0)


@dataclass(frozen=True, slots=True)
class Family:
    """Curves at several parameters, mostly junction temperatures.

    Linear in the parameter, held outside its range.

    Args:
        parameters: Strictly ascending, K >= 1, one per curve; junction temperatures in degC.
        curves: The curves.
        end: Whether a curve is carried on along its last segment, or held.
    """

    parameters: tuple[float, ...]
    curves: tuple[Curve, ...]
    end: End = "extend"

    def __post_init__(self) -> None:
        if not self.parameters or len(self.parameters) != len(self.curves):
            raise InputError(
                f"{len(self.parameters)} temperatures for {len(self.curves)} curves; write one for "
                "each"
            )
        for left, right in pairwise(self.parameters):
            if not left < right:
                raise InputError(
                    f"temperature {right:g} stands behind {left:g}; write them ascending, each once"
                )
        if not np.all(np.isfinite(self.parameters)):
            raise InputError("a temperature is not finite; write degrees Celsius")

    @property
    def reach(self) -> float:
        """Largest abscissa that all curves have."""
        return min(curve.x[-1] for curve in self.curves)

    def at(self, x: ArrayLike, parameter: ArrayLike) -> Lookup:
        """Values at abscissas and parameters.

        Args:
            x, parameter: In the units of the curves, broadcastable to the shape (...).

        Returns:
            Outside where the parameter is out of range, or `x` beyond the last point of a curve
            that is used. Below the first point a curve is held, which is not marked: every
            alternating current passes there.
        """
        where, wanted = np.broadcast_arrays(
            np.asarray(x, np.float64), np.asarray(parameter, np.float64)
        )
        grid = np.asarray(self.parameters)
        held = np.clip(wanted, grid[0], grid[-1])
        value = np.zeros(where.shape)
        outside = np.asarray(held != wanted)
        for k, curve in enumerate(self.curves):
            # The weight of a curve falls from one at its own parameter to zero at its neighbours'.
            weight = np.interp(held, grid, np.eye(grid.size)[k])
            value = value + weight * curve.at(where, self.end)
            outside = outside | ((weight > 0.0) & (where > curve.x[-1]))
        return Lookup(value, np.asarray(outside))


def line(x_end: float, threshold: float, slope: float) -> Curve:
    """Straight line from (0, threshold) to x_end, as threshold voltage and
    resistance describe a device.
    """
    return Curve((0.0, x_end), (threshold, threshold + slope * x_end))
