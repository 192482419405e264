"""Records are what the standard library's dataclasses are, made later."""

import copy
import dataclasses
import inspect
import pickle
import sys
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any

import pytest

from dqforge.machines import records

DEFINITIONS = """
from __future__ import annotations
from dataclasses import field
from typing import ClassVar, Generic, TypeVar

T = TypeVar("T")

@dataclass(frozen=True, slots=True{eq})
class Base(Generic[T]):
    a: T
    b: float = 2.0
    c: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.c.append(self.b)

@dataclass(frozen=True, slots=True{eq})
class Derived(Base[int]):
    d: int = field(default=4, kw_only=True, repr=False, compare=False)
    b: float = 3.0

@dataclass(frozen=True, slots=True{eq})
class Own:
    a: int
    b: int = field(init=False, default=7)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Own)

    def __repr__(self) -> str:
        return f"Own of {{self.a}}"

@dataclass(frozen=True, slots=True{eq})
class Counted:
    a: int
    b: int = 0
    kinds: ClassVar[int] = 3

class Plain(Own):
    pass
"""


def _module(name: str, dataclass: object, eq: str) -> ModuleType:
    module = ModuleType(name)
    vars(module)["dataclass"] = dataclass
    sys.modules[name] = module
    exec(DEFINITIONS.format(eq=eq), vars(module))
    return module


def _said(act: Callable[[], object]) -> object:
    try:
        return act()
    except Exception as error:
        return type(error).__name__, str(error).replace("<lambda>", "__init__")


ACTS: dict[str, Callable[[Any], object]] = {
    "text": repr,
    "fields": lambda one: [(f.name, f.init, f.compare) for f in dataclasses.fields(one)],
    "parameters": lambda one: repr(type(one).__dataclass_params__),
    "equal": lambda one: (one == copy.copy(one), one == object(), one != copy.copy(one)),
    "hash": lambda one: (
        (hash(copy.copy(one)) == hash(one) if type(one).__name__ != "Base" else type(one).__hash__)
        is not None
    ),
    "assigned": lambda one: setattr(one, "a", 1),
    "deleted": lambda one: delattr(one, "a"),
    "new name": lambda one: setattr(one, "new", 1),
    "replaced": lambda one: repr(dataclasses.replace(one, a=9)),
    "plain": dataclasses.asdict,
    "pickled": lambda one: repr(pickle.loads(pickle.dumps(one))),
    "copied": lambda one: repr(copy.deepcopy(one)),
    "matched": lambda one: type(one).__match_args__,
    "signature": lambda one: str(inspect.signature(type(one))),
    "slots": lambda one: (type(one).__slots__, hasattr(one, "__dict__")),
    "wrong": lambda one: type(one)(1, 2, 3, 4, 5),
}


@pytest.mark.parametrize("eq", ["", ", eq=False"])
@pytest.mark.parametrize("name", ["Base", "Derived", "Own", "Counted", "Plain"])
def test_a_record_is_a_dataclass_whatever_is_done_with_it_first(name: str, eq: str) -> None:
    for first in ACTS:
        outcomes = []
        for decorator in (dataclasses.dataclass, records.dataclass):
            made = getattr(_module("records_example", decorator, eq), name)
            # Without __init__, so that what is tried is the first use of the class.
            one = object.__new__(made)
            for slot, value in (("a", 1), ("b", 2.5), ("c", [2.5]), ("d", 8)):
                if hasattr(made, slot):
                    object.__setattr__(one, slot, value)
            outcomes.append([_said(partial(ACTS[act], one)) for act in (first, *ACTS)])
        assert outcomes[0] == outcomes[1], first


def _counted(calls: list[object], real: Callable[..., object], *cls: object, **how: bool) -> object:
    calls.append(cls)
    return real(*cls, **how)


@pytest.mark.parametrize("name", ["Base", "Derived", "Own"])
def test_methods_of_a_record_are_made_once_and_when_needed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = getattr(_module("records_example", records.dataclass, ""), name)
    calls: list[object] = []
    real = dataclasses.dataclass
    monkeypatch.setattr(dataclasses, "dataclass", partial(_counted, calls, real))
    bases = sum("__dataclass_fields__" in vars(base) for base in made.__mro__)
    assert len({repr(made(1)), repr(made(1))}) == 1
    assert len(calls) == bases
