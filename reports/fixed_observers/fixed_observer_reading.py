"""A position observer in fixed point read back from ``result.json``, and proven again not to
overflow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_type_hints

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FIXED_METHODS,
    FixedPositionObserver,
    observer_reaches,
)
from dqforge.optimizer.fixed_observers.kit import WIDTH
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.reports.control.fixed_reading import gain_from, one_of, positive, whole

NOT_OURS = InputError(
    "observer_q15_header or observer_q31_header is not what dqforge writes; run the design again"
)

_SHIFTS = ("shift", "bits")


def fixed_observer_from(plain: Mapping[str, Any], width: int) -> FixedPositionObserver:
    """Read an observer back behind a control of ``width`` bits, and prove again that nothing
    overflows.

    Raises:
        InputError: The data are not what `plain_fixed_observer` makes.
    """
    try:
        method = FIXED_METHODS[plain["method"]]
        current, voltage, speed = positive(plain["bases"], 3)
        (turn,) = positive((plain["turn"],), 1)
        found = FixedPositionObserver(
            method,
            _record_from(method.gains, plain["gains"]),
            one_of(plain["width"], (width,)),
            (current, voltage, speed),
            turn,
        )
        observer_reaches(method, found.gains, width)
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError, NoSolutionError):
        raise NOT_OURS from None
    return found


def _record_from(kind: type[Any], plain: Mapping[str, Any]) -> Any:
    if kind is FixedGain:
        return gain_from(plain, WIDTH)
    hints = get_type_hints(kind)
    return kind(**{f.name: _value_from(f.name, hints[f.name], plain[f.name]) for f in fields(kind)})


def _value_from(name: str, hint: Any, value: Any) -> Any:
    if hint is int:
        return whole(value, 0, 2 * WIDTH - 2) if name in _SHIFTS else whole(value, -(2**63), 2**63)
    if is_dataclass(hint):
        return _record_from(hint, value)  # type: ignore[arg-type]
    inner = get_args(hint)[0]
    if not isinstance(value, list | tuple):
        raise TypeError(name)
    return tuple(_value_from(name, inner, item) for item in value)
