"""Dataclasses whose methods are made when they are needed first: of the hundreds that a command
loads it uses some, and making six methods takes longer than all the rest of a module.
"""

from __future__ import annotations

import dataclasses
import inspect
from threading import RLock
from typing import TYPE_CHECKING, Any

__all__ = ["dataclass"]

if TYPE_CHECKING:
    from collections.abc import Callable
    from dataclasses import dataclass
else:

    def dataclass(*, frozen: bool = False, slots: bool = False, **others: bool):
        """`dataclasses.dataclass`; the methods of a frozen one with slots, and complaints about its
        fields, come when it is used first.
        """

        def decorated(cls: type) -> type:
            if frozen and slots and others.keys() <= {"eq"} and _is_plain(cls):
                return _made_later(cls, **others)
            return dataclasses.dataclass(cls, frozen=frozen, slots=slots, **others)

        return decorated


@dataclasses.dataclass(frozen=True, slots=True)
class _Example:
    """Has what every frozen dataclass with slots has."""


_STATE = {name: vars(_Example)[name] for name in ("__getstate__", "__setstate__")}

_METHODS = tuple(
    name
    for name in ("__init__", "__repr__", "__setattr__", "__delattr__", "__replace__", "__eq__")
    if name in vars(_Example)
)

_ATTRIBUTES = ("__dataclass_fields__", "__dataclass_params__", "__match_args__")

_LOCK = RLock()


class _Later:
    """An attribute of a class that is there when the class is made."""

    def __init__(self, name: str, make: Callable[[], type]) -> None:
        self.name = name
        self.make = make

    def __get__(self, instance: object, owner: type) -> Any:
        return getattr(self.make(), self.name, None)


def _is_plain(cls: type) -> bool:
    """Whether each annotation is a field, as its text says, and bases have nothing but slots."""
    special = ("ClassVar", "InitVar", "KW_ONLY")
    return all(
        isinstance(text, str) and not any(word in text for word in special)
        for text in inspect.get_annotations(cls).values()
    ) and all(isinstance(vars(base).get("__slots__"), tuple) for base in cls.__mro__[1:-1])


def _made_later(cls: type, eq: bool = True) -> type:
    """The class with its slots; what else makes it a dataclass is made of ``cls``, later."""
    given, names = dict(vars(cls)), tuple(inspect.get_annotations(cls))
    inherited = {name for base in cls.__mro__[1:-1] for name in vars(base)["__slots__"]}

    def make() -> type:
        with _LOCK:
            # The last to go: who comes in between, in another thread, waits.
            if "__signature__" in vars(slotted):
                dataclasses.dataclass(frozen=True, eq=eq)(cls)
                for name, value in vars(cls).items():
                    if name not in names and given.get(name, make) is not value:
                        setattr(slotted, name, value)
                del slotted.__signature__  # type: ignore[attr-defined]
        return slotted

    def first(name: str) -> Callable[..., Any]:
        def called(*arguments: Any, **named: Any) -> Any:
            return getattr(make(), name)(*arguments, **named)

        return called

    left_out = {*names, "__dict__", "__weakref__"}
    body = {name: value for name, value in given.items() if name not in left_out}
    body["__slots__"] = tuple(name for name in names if name not in inherited)
    later = {name: first(name) for name in _METHODS if eq or name != "__eq__"}
    # A class with an __eq__ of its own has None, which is not its own.
    if eq and ("__hash__" not in given or (given["__hash__"] is None and "__eq__" in given)):
        body["__hash__"] = first("__hash__")
    attributes = {name: _Later(name, make) for name in _ATTRIBUTES}
    slotted = type(cls)(
        cls.__name__,
        cls.__bases__,
        _STATE | later | attributes | body | {"__signature__": _Later("__signature__", make)},
    )
    slotted.__qualname__ = cls.__qualname__
    return slotted
