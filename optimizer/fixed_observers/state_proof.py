"""What the integers of an observer can become: proof that nothing overflows, for any inputs and any
past.

The step runs on ranges in place of numbers, from every angle, every speed and all that the words
of the state are said to hold. What it leaves must lie within the same ranges: so they hold for
every number of samples.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.transforms import Pair
from dqforge.optimizer.fixed_control.arithmetic import Range, Ranges, Reach
from dqforge.optimizer.fixed_control.ranges import codes, require
from dqforge.optimizer.fixed_observers.fixed_method import FixedMethod, TrackedState, shown, widened
from dqforge.optimizer.fixed_observers.kit import NARROW, TOP, WIDTH


def observer_reaches(method: FixedMethod, gains: Any, width: int) -> tuple[Reach, ...]:
    """Range of every named product and sum of the emitted functions, in the order of evaluation.

    Args:
        method, gains: The observer.
        width: Bits of a code of the control.

    Raises:
        NoSolutionError: A quantity can leave its word, or a state its range; the message names it.
    """
    every, angle = codes(width), Range(0, 2**width - 1)
    found: dict[str, Reach] = {}
    speed = Range(-TOP - 1, TOP)
    for name, function in (("begin", method.begin), ("step", method.step)):
        o = Ranges(WIDTH, f"{name}: ")
        x = widened(o, "voltage or current", every, width)
        vector = Pair(x, x)
        before = TrackedState(Range(0, 2**WIDTH - 1), speed, method.limits(gains))
        after = function(o, gains, before, vector, vector)
        shown(o, after, width)
        widened(o, "angle or speed of the start", angle, width)
        widened(o, "angle or speed of the start", every, width)
        _require_closed(method, gains, after)
        o.reaches = {key: _in_its_word(reach) for key, reach in o.reaches.items()}
        require(o)
        found |= o.reaches
    return tuple(found.values())


def _in_its_word(reach: Reach) -> Reach:
    """What the C divides in 32 bits must fit these."""
    return replace(reach, bits=WIDTH) if NARROW in reach.name else reach


def _require_closed(method: FixedMethod, gains: Any, after: TrackedState[Range]) -> None:
    """Refuse a step that leaves the ranges from which it was taken."""
    limits = {
        "theta": (after.theta, Range(0, 2**WIDTH - 1)),
        "omega": (after.omega, Range(-TOP - 1, TOP)),
    }
    named = zip(method.words, after.words, method.limits(gains), strict=True)
    limits |= {word.name: (is_, may) for word, is_, may in named}
    for name, (is_, may) in limits.items():
        if is_.low < may.low or is_.high > may.high:
            raise NoSolutionError(
                f"fixed point: '{name}' of the observer can reach {is_.largest}, beyond "
                f"{may.largest}; use larger bases in control.per_unit"
            )
