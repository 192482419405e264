"""Numbers as integers with fractional bits, as fixed-point firmware holds them."""

from __future__ import annotations

from typing import Literal

import numpy as np

from dqforge.machines.errors import InputError, NoSolutionError


def to_q(value: float, bits: int, width: Literal[16, 32] = 16) -> int:
    """Round value 2^bits to the nearest integer, halves away from zero.

    Parameters
    ----------
    value:
        The number, dimensionless.
    bits:
        Fractional bits, 0 to ``width`` - 1.
    width:
        Size of the signed integer that must hold the result, 16 (default) or 32 bits.

    Raises
    ------
    NoSolutionError
        If the integer does not fit, or if a value other than zero would become 0.
    """
    if not 0 <= bits < width:
        raise InputError(
            f"a Q format of int{width}_t has 0 to {width - 1} fractional bits, got {bits}"
        )
    if not np.isfinite(value):
        raise NoSolutionError(f"{value} cannot be written as an integer in Q{bits}")
    magnitude = int(np.floor(abs(value) * 2.0**bits + 0.5))
    result = -magnitude if value < 0.0 else magnitude
    if not -(2 ** (width - 1)) <= result < 2 ** (width - 1):
        raise NoSolutionError(
            f"{value:.6g} is {result} in Q{bits}, which int{width}_t cannot hold: use fewer "
            "fractional bits"
        )
    if result == 0 and value != 0.0:
        raise NoSolutionError(f"{value:.6g} rounds to 0 in Q{bits}: use more fractional bits")
    return result
