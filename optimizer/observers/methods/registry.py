"""The position observers by name: every word of `dqforge.machines.names.ObserverMethodName`
but that of the speed observer has its file here, named like the method, with its record ``METHOD``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from types import MappingProxyType
from typing import get_args

from dqforge.machines.errors import InputError
from dqforge.machines.names import OBSERVER_KEYS, SPEED_OBSERVER, ObserverMethodName
from dqforge.optimizer.observers import methods
from dqforge.optimizer.observers.method import ObserverMethod


def _record(name: str) -> ObserverMethod:
    file = import_module(f"{methods.__name__}.{name.replace('-', '_')}")
    record: ObserverMethod = file.METHOD
    return record


_RECORDS: dict[str, ObserverMethod] = {
    name: _record(name) for name in get_args(ObserverMethodName) if name != SPEED_OBSERVER
}


METHODS: Mapping[str, ObserverMethod] = MappingProxyType(_RECORDS)

"""The methods by name."""


def method_named(name: str) -> ObserverMethod:
    """The method of that name.

    Raises
    ------
    InputError
        There is none.
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

    Its template ``observers/<code>.j2`` lies in a folder of
    `dqforge.reports.pages.templating.further_templates`.

    Parameters
    ----------
    method:
        Its record, whose name is new.
    keys:
        The keys of ``control.observer`` that it takes, see `dqforge.machines.names.OBSERVER_KEYS`.

    Raises
    ------
    ValueError
        The name is taken.
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
