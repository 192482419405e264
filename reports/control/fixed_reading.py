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
from dqforge.optimizer.fixed_control.transforms import (
    FixedControl,
    FixedDecoupling,
    FixedObserver,
    FixedPi,
    FixedReferences,
    PiForm,
    full_scale,
)
from dqforge.optimizer.loops.integer_gains import FixedGain

NOT_OURS = InputError(
    "control_q15_header or control_q31_header is not what dqforge writes; run the design again"
)


def fixed_control_from(
    plain: Mapping[str, Any], width: int, reference: FixedReferences | None = None
) -> FixedControl:
    """Read control functions in words of ``width`` bits back, and prove again that nothing
    overflows.

    ``reference`` are the current references of their own header, where they have some.

    Raises:
        InputError: The data are not what `plain_fixed_control` makes.
    """
    try:
        current, voltage, speed, torque = positive(plain["bases"], 4)
        found = FixedControl(
            width=one_of(plain["width"], (width,)),
            bases=(current, voltage, speed, torque),
            modulation=one_of(
                plain["modulation"],
                tuple(MODULATORS),
            ),
            dc_scale=whole(plain["dc_scale"], 0, 8),
            dc_least=whole(plain["dc_least"], 1, full_scale(width)),
            limit=gain_from(plain["limit"], width),
            advance=gain_from(plain["advance"], width),
            i_d=forms_from(plain["i_d"], width),
            i_q=forms_from(plain["i_q"], width),
            speed=None if plain["speed"] is None else forms_from(plain["speed"], width),
            decoupling=FixedDecoupling(
                **{k: gain_from(v, width) for k, v in plain["decoupling"].items()}
            ),
            observer=None if plain["observer"] is None else _observer(plain["observer"], width),
            speed_filter=gain_from(plain["speed_filter"], width),
            torque_max=whole(plain["torque_max"], 0, full_scale(width)),
            ratio=whole(plain["ratio"], 1, 2**31 - 1),
            reference=reference,
        )
        one_of(int(plain["reference"]), (int(reference is not None),))
        control_ranges(found)
    except (KeyError, TypeError, ValueError, AttributeError, NoSolutionError):
        raise NOT_OURS from None
    return found


def one_of(value: Any, choices: tuple[Any, ...]) -> Any:
    """A value that is one of some choices; raises ValueError where it is none."""
    if isinstance(value, bool) or value not in choices:
        raise ValueError(value)
    return value


def whole(value: Any, low: int, high: int) -> int:
    """A whole number within limits; raises ValueError where it is none."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(value)
    return value


def _real(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


def positive(value: Any, count: int) -> tuple[float, ...]:
    """So many positive numbers; raises TypeError or ValueError where they are not."""
    found = tuple(_real(entry) for entry in value)
    if len(found) != count or not min(found) > 0.0:
        raise ValueError(value)
    return found


def gain_from(plain: Mapping[str, Any], width: int) -> FixedGain:
    """A gain in words of ``width`` bits; KeyError, TypeError or ValueError where it is none."""
    top = full_scale(width)
    return FixedGain(
        whole(plain["mantissa"], -top, top),
        whole(plain["shift"], 0, 2 * width - 2),
        _real(plain["value"]),
    )


def forms_from(plain: Mapping[str, Any], width: int) -> dict[PiForm, FixedPi]:
    """A controller in its forms; KeyError, TypeError or ValueError where it is none."""
    return {
        form: FixedPi(
            **{name: gain_from(plain[form][name], width) for name in ("kp", "ki", "tracking")},
            fraction=whole(plain[form]["fraction"], 0, width - 1),
        )
        for form in get_args(PiForm)
    }


def _observer(plain: Mapping[str, Any], width: int) -> FixedObserver:
    gains = {name: gain_from(plain[name], width) for name in ("decay", "b_u", "b_i", "c", "x_d")}
    return FixedObserver(
        **gains,
        fraction=whole(plain["fraction"], 0, width - 1),
        reach=whole(plain["reach"], 1, 2 ** (width - 1)),
    )
