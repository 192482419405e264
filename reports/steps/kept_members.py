"""Vectors of a step by their names in C, and members of a state: what they are, and what is
assigned to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dqforge.reports.steps.record_text import kind_fields, whole_of
from dqforge.reports.steps.symbols import Expression


def vector(kind: type[Any], name: str, *, state: bool = False) -> Any:
    """A vector by its name in C; ``state`` of a member of the state."""
    texts = [f"{name}.{n}" for n in kind._fields]
    reads = [frozenset({text} if state else ()) for text in texts]
    return kind(
        *(Expression(text, reads=own, whole=name) for text, own in zip(texts, reads, strict=True))
    )


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
    whole = whole_of(value) if isinstance(value, tuple) else ""
    if whole:
        reads = frozenset[str]().union(*(part.reads for part in parts))
        targets = {name for part in old for name in part.reads}
        return [] if whole == place else [Assignment(place, whole, reads, targets)]
    places = [f"{place}.{axis}" for axis in kind_fields(value)] if len(old) > 1 else [place]
    return [
        Assignment(own, part.to(last.kind).bare(), part.reads, set(last.reads))
        for own, part, last in zip(places, parts, old, strict=True)
        if part.text != own
    ]


@dataclass(slots=True)
class Kept:
    """A member of a state: where it stands in C, and its value there."""

    record: Any
    member: str
    place: str
    value: Any
    kind: str = "float"
    version: int = 0

    @property
    def set_to(self) -> Any:
        """What the step has made of it."""
        return getattr(self.record, self.member)

    def targets(self) -> set[str]:
        """What is no longer to be read when it changes."""
        parts = self.value if isinstance(self.value, tuple) else (self.value,)
        return {name for part in parts for name in part.reads}

    def renewed(self) -> None:
        """Let it be read as it is from now on."""
        self.version += 1
        mark = f"#{self.version}"
        if isinstance(self.value, tuple):
            parts = [part.marked(mark, whole=self.place) for part in self.value]
            self.value = type(self.value)(*parts)
        else:
            self.value = self.value.marked(mark)
        setattr(self.record, self.member, self.value)


def handed_on(value: Any) -> str:
    """The name of a vector or array that is handed on.

    Raises:
        ValueError: It has none.
    """
    text = whole_of(value)
    if not text:
        raise ValueError("a vector is handed on by its name: name it by `let`")
    return text
