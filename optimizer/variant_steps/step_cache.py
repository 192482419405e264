"""Steps of a study that are computed once for all rows with the same inputs, and how many were.

A step is given a design from which everything has been taken that it does not look at, so that the
key of what it found is exactly what it was made of. What is kept never changes a number: a row that
finds its step here gets what it would have computed.
"""

from __future__ import annotations

import hashlib
import pickle
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from dqforge.machines.errors import DqforgeError

Result = TypeVar("Result")
_MOST_KEPT = 512  # Results of one kind of step that are kept, the latest used ones.


@dataclass(slots=True)
class Work:
    """How often each step was computed.

    Args:
        designs: Designs that were read and checked.
        limits: Largest torques, one machine at a time.
        fits: Current references, one machine at a time.
        gain_sets: Sets of gains, one design at a time.
        budget_calls: Loss budgets: calls, whatever the number of points, modulators and frequencies
            of each.
        batches: Calls of the formulas for many machines at once.
    """

    designs: int = 0
    limits: int = 0
    fits: int = 0
    gain_sets: int = 0
    budget_calls: int = 0
    batches: int = 0


def key_of(inputs: object) -> Hashable:
    """What two equal inputs share: themselves where they can be hashed, else a digest.

    Args:
        inputs: Frozen dataclasses and tuples; a flux map in them is known by its numbers.
    """
    return hashlib.sha256(pickle.dumps(inputs, protocol=5)).digest()


@dataclass(slots=True)
class StepCache(Generic[Result]):
    """Results by their inputs; of a refused step the error, without a place in any file."""

    _kept: OrderedDict[Hashable, Result | DqforgeError] = field(default_factory=OrderedDict)

    def of(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        """What ``compute`` gives, computed where nothing is kept for the key.

        Raises:
            DqforgeError: As ``compute``; a new one each time, for its place to be found.
        """
        if key not in self._kept:
            self._kept[key] = _outcome(compute)
            if len(self._kept) > _MOST_KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        found = self._kept[key]
        if isinstance(found, DqforgeError):
            raise _again(found)
        return found


def _outcome(compute: Callable[[], Result]) -> Result | DqforgeError:
    try:
        return compute()
    except DqforgeError as error:
        return error.with_traceback(None)


def _again(error: DqforgeError) -> DqforgeError:
    """The same refusal, to be given a place of its own."""
    again = type(error)(error.message, source=error.source, line=error.line, column=error.column)
    again.section = error.section
    return again
