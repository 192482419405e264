"""What the trackers of the saliency share in the firmware: samples that are no numbers, and tables
over the load that say what a demodulated current means.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Arithmetic, limited

POINTS = 9  # Of the tables.
_UNKNOWN = 1.0e15  # A sample of so much in A or V is none.
_LARGEST = 0.5  # Largest error in rad that a sample may claim.


class LoadTables(Protocol):
    """Gains with tables over the load."""

    @property
    def per_ampere(self) -> float:
        """Points per A of |i_q|."""
        ...

    @property
    def scale(self) -> tuple[float, ...]:
        """Angle error per demodulated current, in rad/A."""
        ...

    @property
    def shift(self) -> tuple[float, ...]:
        """What the load adds to it, in rad."""
        ...


def is_known(o: Arithmetic, x: AlphaBeta) -> Any:
    """Whether a sample in A or V is a number."""
    return (o.magnitude(x.alpha) < _UNKNOWN) & (o.magnitude(x.beta) < _UNKNOWN)


def at_load(o: Arithmetic, gains: LoadTables, table: Sequence[Any], i_q: Reals) -> Reals:
    """A table over the load at i_q in A, by lines."""
    place = o.let("place", o.magnitude(i_q) * gains.per_ampere)
    last = len(table) - 1.001
    inside = o.let("inside", o.choose(place < last, place, o.full(last, place)))
    index = o.let("index", o.place(inside))
    part = o.let("part", inside - o.real(index))
    low = o.let("low", o.at(table, index))
    found: Reals = low + part * (o.at(table, index + 1) - low)
    return found


def error_at_load(o: Arithmetic, gains: LoadTables, found: Reals, i_q: Reals) -> Reals:
    """The angle error in rad that a demodulated current in A means at a load i_q in A."""
    shift = o.let("shift", o.call(at_load, gains, gains.shift, i_q))
    scale = o.call(at_load, gains, gains.scale, i_q)
    error = o.let("error", scale * found - o.choose(i_q < 0.0, -shift, shift))
    return limited(o, error, o.full(_LARGEST, error))
