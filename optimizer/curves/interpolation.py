"""Straight lines between the places of a table over a turn, as steps of the firmware."""

from __future__ import annotations

from typing import Any

from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Arithmetic


def within_turn(o: Arithmetic, turn: Reals) -> Reals:
    """A turn from 0 to below 1; 0 of others and of not-a-number."""
    return o.choose((turn >= 0.0) & (turn < 1.0), turn, 0.0)


def interval(o: Arithmetic, x: Reals, size: int) -> tuple[Any, Reals]:
    """The interval that a place lies in, and the place counted in intervals.

    Args:
        o: The arithmetic.
        x: Places from 0 to below 1, shape (M,).
        size: Number of intervals.
    """
    place = o.let("x", x * float(size))
    k = o.placed("k", place, size - 1)
    return k, place


def rest(o: Arithmetic, k: Any, place: Reals) -> Reals:
    """Where a place is in its interval, from 0 to 1."""
    return o.let("f", place - o.real(k))


def between(o: Arithmetic, f: Reals, low: Reals, high: Reals) -> Reals:
    """The number at a place from 0 to 1 between two."""
    return o.multiply_add(f, high - low, low)
