"""Control functions in fixed point read back from ``result.json``, and
proven again not to overflow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, get_args

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.optimizer.fixed_control.ranges import control_ranges
from dqforge.optimizer.fixed_control.step import (
    FixedControl,
    FixedDecoupling,
    FixedObserver,
    FixedPi,
    PiForm,
)
from dqforge.optimizer.fixed_control.transforms import full_scale
from dqforge.optimizer.loops.integer_gains import FixedGain

_FAULT = InputError(
    "control_q15_header or control_q31_header is not what dqforge writes; run the design again"
)


def fixed_control_from(plain: Mapping[str, Any], width: int) -> FixedControl:
    """Read control functions in words of ``width`` bits back, and prove again that nothing
    overflows.

    Raises
    ------
    InputError
        The data are not what `plain_fixed_control` makes.
    """
    try:
        found = FixedControl(
            width=_one_of(plain["width"], (width,)),
            bases=_bases(plain["bases"]),
            modulation=_one_of(
                plain["modulation"],
                tuple(name for name in MODULATORS if MODULATORS[name].in_integers),
            ),
            dc_scale=_whole(plain["dc_scale"], 0, 8),
            dc_least=_whole(plain["dc_least"], 1, full_scale(width)),
            limit=_gain(plain["limit"], width),
            advance=_gain(plain["advance"], width),
            i_d=_forms(plain["i_d"], width),
            i_q=_forms(plain["i_q"], width),
            speed=None if plain["speed"] is None else _forms(plain["speed"], width),
            decoupling=FixedDecoupling(
                **{k: _gain(v, width) for k, v in plain["decoupling"].items()}
            ),
            observer=None if plain["observer"] is None else _observer(plain["observer"], width),
        )
        control_ranges(found)
    except (KeyError, TypeError, ValueError, AttributeError, NoSolutionError):
        raise _FAULT from None
    return found


def _one_of(value: Any, choices: tuple[Any, ...]) -> Any:
    if isinstance(value, bool) or value not in choices:
        raise ValueError(value)
    return value


def _whole(value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(value)
    return value


def _real(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


def _bases(value: Any) -> tuple[float, float, float, float]:
    current, voltage, speed, torque = (_real(entry) for entry in value)
    if not min(current, voltage, speed, torque) > 0.0:
        raise ValueError(value)
    return current, voltage, speed, torque


def _gain(plain: Mapping[str, Any], width: int) -> FixedGain:
    top = full_scale(width)
    return FixedGain(
        _whole(plain["mantissa"], -top, top),
        _whole(plain["shift"], 0, 2 * width - 2),
        _real(plain["value"]),
    )


def _forms(plain: Mapping[str, Any], width: int) -> dict[PiForm, FixedPi]:
    return {
        form: FixedPi(
            **{name: _gain(plain[form][name], width) for name in ("kp", "ki", "tracking")},
            fraction=_whole(plain[form]["fraction"], 0, width - 1),
        )
        for form in get_args(PiForm)
    }


def _observer(plain: Mapping[str, Any], width: int) -> FixedObserver:
    gains = {name: _gain(plain[name], width) for name in ("decay", "b_u", "b_i", "c", "x_d")}
    return FixedObserver(
        **gains,
        fraction=_whole(plain["fraction"], 0, width - 1),
        reach=_whole(plain["reach"], 1, 2 ** (width - 1)),
    )
