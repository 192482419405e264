"""Vectors and members of a state in C: how they are read, and how they are written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.record_text import kind_fields, kind_of, whole_of
from dqforge.reports.steps.symbols import Expression, expression


def vector(kind: type[Any], name: str, *, state: bool = False, mark: str = "") -> Any:
    """A vector by its name in C; ``state`` of a member of the state, ``mark`` tells when it is
    read.
    """
    texts = [f"{name}.{n}" for n in kind._fields]
    reads = [frozenset({text + mark} if state else ()) for text in texts]
    kinds = [kind_of(kind, n) for n in kind._fields]
    parts, size = zip(texts, reads, kinds, strict=True), len(texts)
    return kind(
        *(Expression(text, reads=own, whole=name, kind=n, size=size) for text, own, n in parts)
    )


def numbers_of(value: Any) -> tuple[Expression, ...]:
    """The numbers of a vector, of the types of its members, or of an array."""
    if not hasattr(value, "_fields"):
        return tuple(map(expression, value))
    kinds = (kind_of(type(value), axis) for axis in value._fields)
    return tuple(expression(part, kind) for part, kind in zip(value, kinds, strict=True))


def state_vector(like: Any, place: str, mark: str = "") -> Any:
    """A vector or an array of numbers of the state; arguments as of `vector`."""
    if hasattr(like, "_fields"):
        return vector(type(like), place, state=True, mark=mark)
    reads = frozenset({place + mark})
    return tuple(Expression(f"{place}[{n}]", reads=reads, whole=place) for n in range(len(like)))


def members_at(address: str) -> str:
    """What the members of a record begin with."""
    return f"{address[1:]}." if address.startswith("&") else f"{address}->"


@dataclass(frozen=True, slots=True)
class Assignment:
    """A statement ``place = text``, what it reads, and whose reading it ends."""

    place: str
    text: str
    reads: frozenset[str]
    targets: set[str]


def assignments(
    place: str, value: Any, parts: Sequence[Expression], before: Any
) -> list[Assignment]:
    """Statements that give a number or vector of the state its value, without what it has.

    Args:
        place: In C.
        value, before: What it is to be, and what it is.
        parts: The numbers of the value.
    """
    old = tuple(before) if isinstance(before, tuple) else (before,)
    array = isinstance(value, tuple) and not hasattr(value, "_fields")
    whole = whole_of(value) if isinstance(value, tuple) and not array else ""
    if whole:
        reads = frozenset[str]().union(*(part.reads for part in parts))
        targets = {name for part in old for name in part.reads}
        return [] if whole == place else [Assignment(place, whole, reads, targets)]
    places = [place]
    if array:
        places = [f"{place}[{n}]" for n in range(len(old))]
    elif len(old) > 1:
        places = [f"{place}.{axis}" for axis in kind_fields(value)]
    return [
        Assignment(own, part.to(last.kind).bare(), part.reads, set(last.reads))
        for own, part, last in zip(places, parts, old, strict=True)
        if part.text != own
    ]


def ordered(open_: list[Assignment], block: Block) -> None:
    """Write assignments to what changes, none before another one that reads the old value."""
    while open_:
        free = [
            item
            for item in open_
            if not any(item.targets & other.reads for other in open_ if other is not item)
        ]
        if not free:
            raise ValueError(f"{open_[0].place} is needed after it changed: name it by `let`")
        block.add(f"{free[0].place} = ", free[0].text)
        open_.remove(free[0])


def handed_on(value: Any) -> str:
    """The name by which a vector or array is an argument.

    Raises:
        ValueError: It has none.
    """
    text = whole_of(value)
    if not text:
        raise ValueError("a vector is handed on by its name: name it by `let`")
    return text


@dataclass(slots=True)
class Kept:
    """A member of a state: where it stands in C, and its value there; ``at`` is the place of one
    vector of an array.
    """

    record: Any
    member: str
    place: str
    value: Any
    kind: str = "float"
    version: int = 0
    at: int | None = None

    @property
    def set_to(self) -> Any:
        """What the step has made of it."""
        found = getattr(self.record, self.member)
        return found if self.at is None else found[self.at]

    def put(self) -> None:
        """Let the step have the value."""
        value = self.value
        if self.at is not None:
            found = getattr(self.record, self.member)
            value = (*found[: self.at], value, *found[self.at + 1 :])
        setattr(self.record, self.member, value)

    def targets(self) -> set[str]:
        """What is no longer to be read when it changes."""
        parts = self.value if isinstance(self.value, tuple) else (self.value,)
        return {name for part in parts for name in part.reads}

    def renewed(self) -> None:
        """Let it be read as it is from now on."""
        self.version += 1
        mark = f"#{self.version}"
        if hasattr(self.value, "_fields"):
            parts = [part.marked(mark, whole=self.place) for part in self.value]
            self.value = type(self.value)(*parts)
        elif isinstance(self.value, tuple):
            self.value = state_vector(self.value, self.place, mark)
        else:
            self.value = self.value.marked(mark)
        self.put()
