"""Current references in fixed point read back from ``result.json``, and proven again not to
overflow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.fixed_reference.fit import mesh_ranges
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh, VoltageScale
from dqforge.optimizer.loops.integer_gains import FixedGain

_MOST_ENTRIES = 10_000


_FAULT = InputError(
    "reference_q15_header or reference_q31_header is not what dqforge writes; run the design again"
)


def mesh_from(plain: Mapping[str, Any], width: int) -> CurrentMesh:
    """Read a reference in words of ``width`` bits back.

    Raises:
        InputError: The data are not what `plain_mesh` makes.
    """
    try:
        found = _mesh(plain, width)
        mesh_ranges(found)
    except (KeyError, TypeError, ValueError, IndexError, NoSolutionError):
        raise _FAULT from None
    return found


def _mesh(plain: Mapping[str, Any], width: int) -> CurrentMesh:
    top = 2 ** (width - 1) - 1
    if plain["width"] != width:
        raise ValueError
    current, voltage, speed, torque = (_positive(value) for value in plain["bases"])
    scale = None if plain["voltage"] is None else _scale(plain["voltage"], width)
    rows = _codes(plain["torque"], 0, top)
    found = CurrentMesh(
        width,
        (current, voltage, speed, torque),
        rows,
        _codes(plain["d"], -top, top),
        _codes(plain["q"], -top, top),
        _codes(plain["flux"], 0, top),
        _codes(plain["heat"], 0, top),
        scale,
    )
    nodes = len(rows) * found.columns
    squares = 0 if scale is None else nodes
    sizes = len(found.d) == len(found.q) == nodes and len(found.flux) == len(found.heat) == squares
    rising = rows[0] == 0 and all(a < b for a, b in pairwise(rows))
    across = found.columns == 1 if scale is None else _is_power(found.columns - 1)
    if not (sizes and rising and across and _is_power(found.rows)):
        raise ValueError
    return found


def _is_power(number: int) -> bool:
    return number > 0 and number & (number - 1) == 0


def _whole(value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError
    return value


def _positive(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(value) or not value > 0.0:
        raise ValueError
    return float(value)


def _codes(values: Any, low: int, high: int) -> tuple[int, ...]:
    if len(values) > _MOST_ENTRIES:
        raise ValueError
    return tuple(_whole(value, low, high) for value in values)


def _scale(plain: Mapping[str, Any], width: int) -> VoltageScale:
    top = 2 ** (width - 1) - 1
    return VoltageScale(
        limit=_gain(plain["limit"], width),
        dc_least=_whole(plain["dc_least"], 1, top),
        shift=_whole(plain["shift"], 0, width),
        heat=_whole(plain["heat"], 0, width),
        drop=_gain(plain["drop"], width),
    )


def _gain(plain: Mapping[str, Any], width: int) -> FixedGain:
    value = plain["value"]
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError
    mantissa = _whole(plain["mantissa"], 0, 2 ** (width - 1) - 1)
    return FixedGain(mantissa, _whole(plain["shift"], 0, 2 * width - 2), float(value))
