"""Arrays in the C of steps in codes: tables, arrays of a state, and those that a function fills."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, TypeVar, cast, get_args, get_origin

from dqforge.optimizer.steps.code_vectors import CODE, WIDE, WORDS_OF_GAIN, Filling, Gain
from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.counted_loops import Table
from dqforge.reports.steps.record_text import kind_fields, whole_of
from dqforge.reports.steps.state_text import Kept
from dqforge.reports.steps.symbols import Expression, folded


class Reader(Protocol):
    """What writes a step in codes, as far as arrays go."""

    block: Block
    counted: str

    def take(self, parts: Sequence[Expression]) -> None:
        """Count the members of records in expressions as needed."""

    def number_of(self, name: str, kind: str, **more: Any) -> Any:
        """A number by its name."""

    def vector(self, kind: type[Any], name: str) -> Any:
        """A vector by its name."""

    def type_of(self, kind: type[Any]) -> str:
        """Type in C of a vector."""


def is_array(value: Any) -> bool:
    """Whether it is an array, of numbers, vectors or arrays."""
    return isinstance(value, tuple) and not hasattr(value, "_fields")


def sizes(value: Any) -> str:
    """What stands behind the name of an array, nothing behind others."""
    if is_record(value):
        return f"[{len(fields(value))}]"
    return f"[{len(value)}]{sizes(value[0])}" if is_array(value) else ""


class Entries(tuple[int, ...]):
    """The numbers of a constant array of the header.

    Args:
        numbers: The numbers.
        array, kind: Name and type in C; the type of a number, also where the items are structs.
        item, member: Type of such items, and the name of the number in them.
    """

    array: str
    kind: str
    item: str
    member: str

    def __new__(
        cls, numbers: Sequence[int], array: str, kind: str, item: str = "", member: str = ""
    ) -> Entries:
        """The numbers with their names."""
        found = super().__new__(cls, numbers)
        found.array, found.kind, found.item, found.member = array, kind, item, member
        return found

    def at(self, index: Expression) -> str:
        """Text of an entry."""
        return f"{self.array}[{index.bare()}]{self.member and f'.{self.member}'}"


def tables(value: Any, text: str, kind: str) -> Any:
    """The rows of an array of numbers."""
    if is_array(value[0]):
        return tuple(tables(item, f"{text}[{n}]", kind) for n, item in enumerate(value))
    return Table(text, (len(value),), kind)


# Arrays of a state: of numbers, and records that are arrays in C.


def numbers_at(reader: Reader, count: int, text: str, kind: str) -> tuple[Any, ...]:
    """The numbers of an array of a state by their names."""
    places = (f"{text}[{n}]" for n in range(count))
    return tuple(reader.number_of(own, kind, reads=frozenset({own}), whole=text) for own in places)


def elements(record: Any, member: str, numbers: Sequence[Any]) -> Iterator[Kept]:
    """What is followed of an array of numbers of a state."""
    for n, number in enumerate(numbers):
        yield Kept(record, member, number.text, number, number.kind, at=n)


def is_record(like: Any) -> bool:
    """Whether it is a record whose members are the numbers of an array in C."""
    return getattr(like, "ARRAY", False)


def record_at(reader: Reader, like: Any, text: str) -> tuple[Any, list[Kept]]:
    """Such a record at a place, and what is followed of it."""
    names = [member.name for member in fields(like)]
    numbers = numbers_at(reader, len(names), text, reader.counted)
    own = dict(zip(names, numbers, strict=True))
    found = replace(like, **own)
    return found, [Kept(found, n, part.text, part, part.kind) for n, part in own.items()]


# Arrays that a function fills.


@dataclass(frozen=True, slots=True)
class Filled:
    """An array: its name in the function that fills it, how many items it has, and the vector that
    they are, None of numbers.
    """

    name: str
    count: int
    kind: type[Any] | None


def filled_by(hint: Any) -> Filled | None:
    """The array that the annotation of a result says to be filled; None of others."""
    said = [item for item in getattr(hint, "__metadata__", ()) if isinstance(item, Filling)]
    if not said:
        return None
    items = get_args(hint.__origin__)
    kind = None if isinstance(items[0], TypeVar) else get_origin(items[0]) or items[0]
    return Filled(said[0].name, len(items), kind)


def taking(function: Callable[..., Any], array: Filled) -> Callable[..., Any]:
    """The function with the array that it fills as its last parameter."""

    def run(o: Any, *values: Any) -> Any:
        return function(o, *values[:-1])

    own = inspect.signature(function)
    last = inspect.Parameter(array.name, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    run.__name__, run.__doc__ = function.__name__, function.__doc__
    run.__signature__ = own.replace(  # type: ignore[attr-defined]
        parameters=[*own.parameters.values(), last]
    )
    run.text = getattr(function, "text", function)  # type: ignore[attr-defined]
    return run


@dataclass(frozen=True, slots=True)
class Call:
    """A call that fills an array, which has no name yet."""

    text: str
    array: Filled
    parts: tuple[Expression, ...]

    def into(self, reader: Reader, name: str) -> Any:
        """Declare the array, fill it, and its items."""
        kind, block = self.array.kind, reader.block
        own = reader.counted if kind is None else reader.type_of(kind)
        block.take(name)
        block.variable(own, f"{name}[{self.array.count}]")
        reader.take(self.parts)
        block.work(folded("", f"{self.text[:-1]}, {name})", ";", block.indent))
        return items_of(reader, name, self.array)


def items_of(reader: Reader, name: str, array: Filled) -> tuple[Any, ...]:
    """The items of an array by its name."""
    texts = [f"{name}[{n}]" for n in range(array.count)]
    if array.kind is None:
        return tuple(reader.number_of(text, reader.counted, whole=name) for text in texts)
    return tuple(reader.vector(array.kind, text) for text in texts)


def put_into(array: Filled, result: Sequence[Any], end: Block) -> list[Expression]:
    """Write the items of a result into an array; the numbers that are written."""
    if array.kind is None and whole_of(result) == array.name:
        return []
    found = list[Expression]()
    for n, item in enumerate(result):
        place = f"{array.name}[{n}]"
        if array.kind is None:
            end.add(f"{place} = ", item.bare())
            found.append(item)
        elif whole := whole_of(item):
            end.add(f"{place} = ", whole)
            found += item
        else:
            for axis, part in zip(kind_fields(item), item, strict=True):
                end.add(f"{place}.{axis} = ", part.bare())
                found.append(part)
    return found


# Types of numbers and of the parts of vectors.


def word_of(hint: Any) -> str:
    """What a number is by its annotation; a wide word without one."""
    found = [item for item in getattr(hint, "__metadata__", ()) if isinstance(item, str)]
    return found[0] if found else WIDE


def axes_of(kind: type[Any]) -> tuple[str, ...]:
    """Names of the parts of a vector in C."""
    found: tuple[str, ...] = getattr(kind, "AXES", None) or cast("Any", kind)._fields
    return found


def words_of(kind: type[Any]) -> tuple[str, ...]:
    """What the parts of a vector are."""
    own = WORDS_OF_GAIN if kind is Gain else getattr(kind, "WORDS", CODE)
    return (own,) * len(axes_of(kind)) if isinstance(own, str) else own
