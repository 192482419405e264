"""Arrays and counted loops in the C of a step, and whole numbers that count places of arrays."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, Protocol

from dqforge.reports.c_code.numbers import float_literal
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


def item(table: Sequence[Any], place: Any, column: int | None = None) -> Any:
    """The number of an array at a place, of an array of rows in a column."""
    if not isinstance(place, Expression):
        return table[place]
    parts, behind = (expression(table[0]), place), "" if column is None else f"[{column}]"
    text = f"{parts[0].whole}[{place.bare()}]{behind}"
    return joined(text, *parts, atom=True, kind=parts[0].kind)


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
    outer, (name,) = reader.block, inspect.signature(of).parameters
    if f"{outer.indent}unsigned int {name};" not in outer.lines:
        outer.take(name)
        outer.variable("unsigned int", name)
    reader.block = inner = outer.inner()
    value = expression(of(place(name)))
    reader.take([value])
    inner.work(folded(*assigned(name, value), ";", inner.indent))
    reader.block = outer
    outer.inside |= inner.names - outer.names
    head = f"{outer.indent}for ({name} = 0U; {name} < {count}U; {name}++) {{"
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
    """A counted loop over variables that it changes, with a break where it ends before; ``known``
    are the members of states that the reader follows.
    """
    outer, (name,) = reader.block, inspect.signature(of).parameters
    own = [
        Kept(state, member.name, member.name, expression(getattr(state, member.name)))
        for member in fields(state)
    ]
    for kept in own:
        reader.take([kept.value])
        outer.take(kept.place)
        outer.variable(_counted(reader), kept.place)
    for kept in own:
        outer.work(folded(f"{kept.place} = ", kept.value.bare(), ";", outer.indent))
        kept.value = reader.number_of(kept.place, _counted(reader))
        kept.renewed()
    known += own
    if f"{outer.indent}unsigned int {name};" not in outer.lines:
        outer.take(name)
        outer.variable("unsigned int", name)
    reader.block = inner = outer.inner()
    of(place(name))
    reader.write_state()
    if until is not None:
        ends = until()
        reader.take(ends.terms)
        head = folded("if (", ends.text(), ") {", inner.indent)
        inner.work([*head, f"{inner.indent}    break;", f"{inner.indent}}}"])
    reader.block = outer
    outer.inside |= inner.names - outer.names
    end = count.operand() if isinstance(count, Index) else f"{count}U"
    head = [f"{outer.indent}for ({name} = 0U; {name} < {end}; {name}++) {{"]
    outer.work([*head, *inner.lines, f"{outer.indent}}}"])
    del known[-len(own) :]
    for kept in own:
        setattr(state, kept.member, reader.number_of(kept.place, _counted(reader)))
