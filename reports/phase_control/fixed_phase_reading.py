"""The control of phases in fixed point read back from ``result.json``, and proven again not to
overflow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, get_args

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedAxis,
    FixedHarmonic,
    FixedMidpoint,
    FixedPhaseControl,
)
from dqforge.optimizer.fixed_phase_control.phase_ranges import phase_ranges
from dqforge.optimizer.loops.integer_gains import FixedGain

_FAULT = InputError(
    "control_q15_header or control_q31_header is not what dqforge writes; run the design again"
)


def _whole(value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(value)
    return value


def _one_of(value: Any, words: Any) -> Any:
    if value not in get_args(words):
        raise ValueError(value)
    return value


def _gain(plain: Mapping[str, Any], width: int) -> FixedGain:
    top, value = 2 ** (width - 1) - 1, plain["value"]
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(value)
    shift = _whole(plain["shift"], 0, 2 * width - 2)
    return FixedGain(_whole(plain["mantissa"], -top, top), shift, float(value))


def _axis(plain: Mapping[str, Any], width: int) -> FixedAxis:
    names = ("kp", "ki", "resistance", "inductance", "reactance")
    return FixedAxis(
        **{name: _gain(plain[name], width) for name in names},
        fraction=_whole(plain["fraction"], 0, width - 1),
    )


def _harmonic(plain: Mapping[str, Any], width: int) -> FixedHarmonic:
    return FixedHarmonic(
        order=_whole(plain["order"], -99, 99),
        zero=bool(plain["zero"]),
        reactance=_gain(plain["reactance"], width),
        fade=_gain(plain["fade"], width),
        end=_whole(plain["end"], 1, 2 << width),
    )


def _shape(plain: Any, width: int) -> tuple[tuple[int, ...], ...]:
    top = 2 ** (width - 1) - 1
    rows = tuple(tuple(_whole(value, -top, top) for value in row) for row in plain)
    sizes = {len(row) for row in rows}
    if len(rows) not in (1, 3) or len(sizes) != 1 or not 25 <= sizes.pop() <= 2**14:
        raise ValueError(len(rows))
    return rows


def _bases(plain: Any) -> tuple[float, float, float, float, float]:
    current, voltage, speed, torque, flux = (float(value) for value in plain)
    if not all(0.0 < value < math.inf for value in (current, voltage, speed, torque, flux)):
        raise ValueError(plain)
    return current, voltage, speed, torque, flux


def phase_integers_from(plain: Mapping[str, Any], width: int) -> FixedPhaseControl:
    """Read the control in words of ``width`` bits back, and prove again that nothing overflows.

    Raises
    ------
    InputError
        The data are not what `plain_phase_integers` makes.
    """
    code = 2 ** (width - 1)
    gains = ("fade", "unit", "sample", "electrical", "rate")
    middle = plain.get("midpoint")
    try:
        found = FixedPhaseControl(
            **{name: _gain(plain[name], width) for name in gains},
            width=_whole(plain["width"], width, width),
            bases=_bases(plain["bases"]),
            frame=_one_of(plain["frame"], CurrentFrame),
            feedforward=_one_of(plain["feedforward"], Feedforward),
            topology=_one_of(plain["topology"], Topology),
            shape=_shape(plain["shape"], width),
            turns=_whole(plain["turns"], 1, 200),
            fundamental=_whole(plain["fundamental"], -code + 1, code - 1),
            fade_end=_whole(plain["fade_end"], 0, 4 * code),
            unit_bits=_whole(plain["unit_bits"], 0, width - 1),
            least_square=_whole(plain["least_square"], 1, 4 * code),
            d=_axis(plain["d"], width),
            q=_axis(plain["q"], width),
            zero=None if plain["zero"] is None else _axis(plain["zero"], width),
            harmonic_fraction=_whole(plain["harmonic_fraction"], 0, width - 1),
            error_max=_whole(plain["error_max"], 0, 16 * code),
            harmonics=tuple(_harmonic(part, width) for part in plain["harmonics"]),
            midpoint=None
            if middle is None
            else FixedMidpoint(_gain(middle["balance"], width), _gain(middle["fade"], width)),
            dc_scale=_whole(plain["dc_scale"], 0, 8),
            dc_least=_whole(plain["dc_least"], 1, code - 1),
        )
        phase_ranges(found)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, NoSolutionError):
        raise _FAULT from None
    return found
