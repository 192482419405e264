"""The position observers by name: every word of `dqforge.machines.names.ObserverMethodName`
but that of the speed observer and those of the trackers has its file, named like the method, with
its record ``METHOD``: here, or in the room that is named for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from types import MappingProxyType
from typing import get_args

from dqforge.machines.errors import InputError
from dqforge.machines.names import (
    LEARNED_OBSERVERS,
    OBSERVER_KEYS,
    SIX_STEP_METHODS,
    SPEED_OBSERVER,
    TRACKER_NAMES,
    ObserverMethodName,
)
from dqforge.optimizer.observers import methods
from dqforge.optimizer.observers.parts import ObserverMethod

# Rooms of the optimizer in which methods live that do not live here.
_ROOMS: dict[str, str] = dict.fromkeys(LEARNED_OBSERVERS, "learned_correction")


def _record(name: str) -> ObserverMethod:
    room = methods.__name__ if name not in _ROOMS else f"dqforge.optimizer.{_ROOMS[name]}"
    file = import_module(f"{room}.{name.replace('-', '_')}")
    record: ObserverMethod = file.METHOD
    return record


_RECORDS: dict[str, ObserverMethod] = {
    name: _record(name)
    for name in get_args(ObserverMethodName)
    if name not in (SPEED_OBSERVER, *TRACKER_NAMES, *SIX_STEP_METHODS)
}

METHODS: Mapping[str, ObserverMethod] = MappingProxyType(_RECORDS)  # The methods by name.


def method_named(name: str) -> ObserverMethod:
    """The method of that name.

    Raises:
        InputError: There is none.
    """
    if name not in METHODS:
        raise InputError(
            f"control.observer.method: {name} is no position observer; write one of "
            f"{', '.join(METHODS)}"
        )
    return METHODS[name]


@contextmanager
def registered(method: ObserverMethod, keys: tuple[str, ...]) -> Iterator[None]:
    """Let a further method count as one of the package, as long as the context lasts.

    Args:
        method: Its record, whose name is new.
        keys: The keys of ``control.observer`` that it takes, see
            `dqforge.machines.names.OBSERVER_KEYS`.

    Raises:
        ValueError: The name is taken.
    """
    if method.name in OBSERVER_KEYS:
        raise ValueError(f"there is an observer {method.name} already")
    try:
        _RECORDS[method.name] = method
        OBSERVER_KEYS[method.name] = keys
        yield
    finally:
        _RECORDS.pop(method.name)
        OBSERVER_KEYS.pop(method.name)
