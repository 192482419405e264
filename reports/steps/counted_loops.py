"""Arrays and counted loops in the C of a step, and whole numbers that count places of arrays."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, Protocol

import numpy as np

from dqforge.reports.c_code.numbers import comment_text, float_literal
from dqforge.reports.steps.record_text import kind_fields, kind_of
from dqforge.reports.steps.state_text import Kept
from dqforge.reports.steps.symbols import Condition, Expression, expression, folded, joined


class Writer(Protocol):
    """What writes a step: the block that its statements go to, and what notes their members."""

    block: Any

    def take(self, parts: Sequence[Expression]) -> None:
        """Count the members of records in expressions as needed."""

    def write_state(self) -> None:
        """Write what the step has changed of a state."""

    def number_of(self, name: str, kind: str, **more: Any) -> Expression:
        """A number by its name and type in C."""


def _counted(reader: Writer) -> str:
    """Type of the numbers that loops compute: ``float``, unless the reader has another one."""
    return getattr(reader, "counted", "float")


class Index(Expression):
    """A place of an array: a whole number that is not negative, as text."""

    __slots__ = ()

    def _with(self, sign: str, other: Any, *, swapped: bool = False) -> Expression:
        own = other if isinstance(other, Index) else place(f"{int(other)}U")
        parts = (own, self) if swapped else (self, own)
        return place(f" {sign} ".join(part.operand() for part in parts), atom=False)

    def _compared(self, sign: str, other: Any) -> Condition:
        parts = self, other if isinstance(other, Index) else place(f"{int(other)}U")
        return Condition((joined(f" {sign} ".join(part.operand() for part in parts), *parts),))


def place(text: str, **more: Any) -> Index:
    """A place by its text."""
    return Index(text, kind="unsigned int", **more)


class Table:
    """A constant array of numbers of a type ``kind``, or one of arrays, by its name in C and from
    one of its places on; ``shape`` is numpy's.
    """

    def __init__(
        self, text: str, shape: tuple[int, ...], kind: str = "float", first: int = 0
    ) -> None:
        self.text, self.shape, self.kind, self.first = text, shape, kind, first

    def __len__(self) -> int:
        """Numbers, or arrays in it."""
        return self.shape[0]

    def __getitem__(self, rest: slice) -> Table:
        """The same array from a later place on."""
        start = int(rest.start)
        shape = (self.shape[0] - start, *self.shape[1:])
        return Table(self.text, shape, self.kind, self.first + start)

    def at(self, index: Expression) -> str:
        """Text of a number."""
        behind = f" + {self.first}" if self.first else ""
        return f"{self.text}[{index.bare()}{behind}]"


def tables_of(value: Any, text: str) -> Any:
    """The tables that a member of a constant record is, or those of a tuple; None of others."""
    if isinstance(value, np.ndarray | Table):
        return Table(text, value.shape)
    if isinstance(value, tuple) and value and isinstance(value[0], np.ndarray | Table):
        return tuple(Table(f"{text}[{n}]", part.shape) for n, part in enumerate(value))
    return None


def item(table: Any, place: Any, *inner: Any) -> Any:
    """The number or vector of an array at a place, or at places in arrays of arrays."""
    if not isinstance(table, Table) and not isinstance(place, Expression):
        return table[place]
    places = [expression(at, "unsigned int") for at in (place, *inner)]
    behind = "".join(f"[{at.bare()}]" for at in places)
    if isinstance(table, Table):
        return joined(table.text + behind, *places, atom=True, kind="float")
    first = table[0]
    if not isinstance(first, tuple):
        own = expression(first)
        return joined(own.whole + behind, own, *places, atom=True, kind=own.kind)
    text = _array_of(table) + behind
    axes = zip(kind_fields(first), zip(*table, strict=True), strict=True)
    found = [
        joined(f"{text}.{axis}", *of, places[0], atom=True, whole=text, kind=of[0].kind)
        for axis, of in axes
    ]
    kind: Any = type(first)
    return kind(*found)


def _array_of(vectors: Sequence[Any]) -> str:
    """The array whose parts vectors are."""
    return str(vectors[0][0].whole).removesuffix("[0]")


def put_item(
    reader: Writer,
    known: list[Kept],
    renew: Callable[[Kept], None],
    array: tuple[Any, ...],
    place: Any,
    value: Any,
) -> tuple[Any, ...]:
    """Statements that set a number or a vector of an array of the state; ``known`` as of
    `repeated`, ``renew`` notes that a member has changed.

    Raises:
        ValueError: The second number of the vector is computed of the array, which the first one
            has changed.
    """
    changed = [kept for kept in known if getattr(kept.record, kept.member) is array]
    at, block = expression(place, "int"), reader.block
    parts = tuple(map(expression, value)) if isinstance(value, tuple) else (expression(value),)
    reader.take([at, *parts])
    begin, ends = f"{changed[0].place}[{at.bare()}]", [""]
    if isinstance(value, tuple):
        begin = f"{_array_of(array)}[{at.bare()}]"
        ends = [f".{axis}" for axis in kind_fields(value)]
        old = frozenset[str]().union(*(kept.targets() for kept in changed))
        if any(part.reads & old for part in parts[1:]):
            raise ValueError(f"{begin} changes while it is read: name it by `let`")
    for end, part in zip(ends, parts, strict=True):
        block.work(folded(f"{begin}{end} = ", part.bare(), ";", block.indent))
    for kept in changed:
        renew(kept)
    found: tuple[Any, ...] = getattr(changed[0].record, changed[0].member)
    return found


def listed(
    reader: Writer, begin: str, name: str, parts: Sequence[Expression], meaning: str
) -> None:
    """A declaration with a line for each of its numbers."""
    block = reader.block
    block.take(name)
    reader.take(parts)
    ends = [","] * (len(parts) - 1) + [""]
    block.lines.append(f"{block.indent}{begin}")
    if meaning:
        block.lines[-1] += f" /* {comment_text(meaning)} */"
    for part, end in zip(parts, ends, strict=True):
        found = folded("", part.bare(), end, block.indent + "    ")
        block.lines += [line for line in found if line.strip()]
    block.lines.append(f"{block.indent}}};")


def interval(reader: Writer, name: str, axis: Any, value: Any) -> Any:
    """A variable that counts up to the interval in which a value lies."""
    if len(axis) == 2:
        return 0
    block, found = reader.block, place(name)
    block.take(name)
    block.variable("unsigned int", name)
    above = value > item(axis, found + 1)
    reader.take(above.terms)
    head = f"while (({name} < {len(axis) - 2}U) && ({above.text()})) {{"
    lines = [f"{name} = 0U;", head, f"    {name}++;", "}"]
    block.work([block.indent + line for line in lines])
    return found


def placed(reader: Writer, name: str, value: Expression, most: int) -> Index:
    """A place that a number is, at most ``most``."""
    block = reader.block
    block.take(name)
    block.variable("unsigned int", name)
    reader.take([value])
    end = f"{block.indent}    {name} = {most}U;"
    begin = folded(f"{name} = (unsigned int)", value.operand(), ";", block.indent)
    block.work([*begin, f"{block.indent}if ({name} > {most}U) {{", end, f"{block.indent}}}"])
    return place(name)


def constants(reader: Writer, name: str, values: Sequence[float]) -> tuple[Expression, ...]:
    """Constant numbers of an array."""
    block = reader.block
    block.take(name)
    texts = ", ".join(map(float_literal, values))
    begin = f"static const float {name}[{len(values)}] = {{ "
    block.constants(folded(begin, texts, " };", block.indent))
    return tuple(Expression(f"{name}[{n}]", whole=name) for n in range(len(values)))


def filled(
    reader: Writer, name: str, count: int, of: Callable[[Any], Any], *, declared: bool = False
) -> tuple[Expression, ...]:
    """An array that a loop fills; ``of`` has the number of a place for its argument."""
    if not declared:
        reader.block.take(name)
        reader.block.variable(_counted(reader), f"{name}[{count}]")
    _loop(reader, count, of, lambda place, value: (f"{name}[{place}] = ", value.bare()))
    kind = _counted(reader)
    return tuple(reader.number_of(f"{name}[{n}]", kind, whole=name) for n in range(count))


def summed(
    reader: Writer, name: str, first: Any, count: int, of: Callable[[Any], Any]
) -> Expression:
    """A variable to which a loop adds, one number after the other."""
    begin = expression(first)
    reader.take([begin])
    reader.block.take(name)
    reader.block.variable("float", name)
    reader.block.work(folded(f"{name} = ", begin.bare(), ";", reader.block.indent))
    _loop(reader, count, of, lambda _, value: (f"{name} = ", f"{name} + {value.operand()}"))
    return Expression(name)


def _loop(
    reader: Writer,
    count: int,
    of: Callable[[Any], Any],
    assigned: Callable[[str, Expression], tuple[str, str]],
) -> None:
    def body(at: Index, inner: Any) -> None:
        value = expression(of(at))
        reader.take([value])
        inner.work(folded(*assigned(at.text, value), ";", inner.indent))

    _turns(reader, f"{count}U", of, body)


def _turns(
    reader: Writer, end: str, of: Callable[[Any], Any], body: Callable[[Index, Any], None]
) -> None:
    """A loop that counts by the name of the argument of ``of``; ``body`` writes into its block."""
    outer, (name,) = reader.block, inspect.signature(of).parameters
    if f"{outer.indent}unsigned int {name};" not in outer.lines:
        outer.take(name)
        outer.variable("unsigned int", name)
    reader.block = inner = outer.inner()
    body(place(name), inner)
    reader.block = outer
    outer.inside |= inner.names - outer.names
    head = f"{outer.indent}for ({name} = 0U; {name} < {end}; {name}++) {{"
    outer.work([head, *inner.lines, f"{outer.indent}}}"])


def reached(reader: Writer, name: str, conditions: Sequence[Condition]) -> Index:
    """How many conditions hold, of which each one implies those before it."""
    block = reader.block
    block.take(name)
    block.variable("unsigned int", name)
    block.work([f"{block.indent}{name} = 0U;"])
    for number, condition in enumerate(conditions, 1):
        reader.take(condition.terms)
        head = folded("if (", condition.text(), ") {", block.indent)
        block.work([*head, f"{block.indent}    {name} = {number}U;", f"{block.indent}}}"])
    return place(name)


def repeated(
    reader: Writer,
    known: list[Kept],
    state: Any,
    count: Any,
    of: Callable[[Any], None],
    until: Callable[[], Any] | None,
) -> None:
    """A counted loop over variables that it changes, None without, with a break where it ends
    before; ``known`` are the members of states that the reader follows.
    """
    reader.write_state()
    outer = reader.block
    own = list[Kept]()
    for member in () if state is None else fields(state):
        kind = kind_of(type(state), member.name)
        kind = _counted(reader) if kind == "float" else kind
        begin = expression(getattr(state, member.name), kind)
        own.append(Kept(state, member.name, member.name, begin, kind))
    for kept in own:
        reader.take([kept.value])
        outer.take(kept.place)
        outer.variable(kept.kind, kept.place)
    for kept in own:
        outer.work(folded(f"{kept.place} = ", kept.value.bare(), ";", outer.indent))
        kept.value = reader.number_of(kept.place, kept.kind)
        kept.renewed()
    known += own

    def body(at: Index, inner: Any) -> None:
        of(at)
        reader.write_state()
        if until is not None:
            ends = until()
            reader.take(ends.terms)
            head = folded("if (", ends.text(), ") {", inner.indent)
            inner.work([*head, f"{inner.indent}    break;", f"{inner.indent}}}"])

    _turns(reader, count.operand() if isinstance(count, Index) else f"{count}U", of, body)
    del known[len(known) - len(own) :]
    for kept in own:
        setattr(state, kept.member, reader.number_of(kept.place, kept.kind))
