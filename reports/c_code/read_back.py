"""Floats of a result read back from plain data: finite numbers alone,
and never a truth value for a number.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dqforge.optimizer.curves.single_precision import SingleArray


def single_from(value: Any) -> np.float32:
    """A float32 from a number.

    Raises:
        TypeError, ValueError: It is no number, or not finite in single precision.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    with np.errstate(over="ignore"):
        single = np.float32(value)
    if not math.isfinite(single):
        raise ValueError
    return single


def singles_from(values: Any, most: int) -> SingleArray:
    """Float32 values from a list of 1 to ``most`` numbers; raises as `single_from`."""
    array: SingleArray = np.array([single_from(value) for value in values], dtype=np.float32)
    if not 1 <= array.size <= most:
        raise ValueError
    return array
