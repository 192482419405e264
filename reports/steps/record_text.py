"""Records and vectors of steps in C: their types, what is said of their members, and values."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import IntEnum
from textwrap import wrap
from typing import Any, get_type_hints

from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Dq, Member, Rotation
from dqforge.reports.c_code.numbers import comment_text, float_literal
from dqforge.reports.steps.symbols import Expression, Origin, expression, folded

# Vectors that `dqforge.reports.steps.control_types` declares.
SHARED: dict[type[Any], str] = {
    Abc: "abc",
    AlphaBeta: "alphabeta",
    Dq: "dq",
    Rotation: "rotation",
}
LINE = 118  # Of lines with comments.


def c_name(kind: type[Any]) -> str:
    """Name of a record in C, without prefix and ``_t``."""
    return SHARED.get(kind) or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind.__name__).lower()


def comment(text: str) -> list[str]:
    """Lines of a comment on a function or record."""
    first, *rest = wrap(comment_text(text), LINE - 6, break_long_words=False)
    return [f"/* {first}", *(f" * {line}" for line in rest), " */"] if rest else [f"/* {first} */"]


def kind_fields(value: Any) -> tuple[str, ...]:
    """Names of the parts of a vector."""
    names: tuple[str, ...] = getattr(type(value), "AXES", type(value)._fields)
    return names


def whole_of(value: Any) -> str:
    """The vector or array whose parts these are, in their order; else nothing."""
    places = {part.whole for part in value if isinstance(part, Expression)}
    if len(places) != 1 or getattr(value[0], "size", 0) not in (0, len(value)):
        return ""
    (place,) = places
    names = (
        [f"{place}.{n}" for n in kind_fields(value)]
        if hasattr(value, "_fields")
        else [f"{place}[{n}]" for n in range(len(value))]
    )
    return place if [getattr(part, "text", "") for part in value] == names else ""


# Each function that a step calls needs the members of the same few records.
_MEMBERS: dict[type[Any], dict[str, Member]] = {}


def _member(kind: type[Any], name: str) -> Member | None:
    if kind not in _MEMBERS:
        _MEMBERS[kind] = {
            place: item
            for place, hint in get_type_hints(kind, include_extras=True).items()
            for item in getattr(hint, "__metadata__", ())
            if isinstance(item, Member)
        }
    return _MEMBERS[kind].get(name)


def said(kind: type[Any], name: str) -> str:
    """What is said of a member of a record."""
    member = _member(kind, name)
    return "" if member is None else member.text


def member_name(kind: type[Any], name: str) -> str:
    """Name of a member of a record in C."""
    member = _member(kind, name)
    return name if member is None or not member.suffix else f"{name}_{member.suffix}"


def kind_of(kind: type[Any], name: str, prefix: str = "") -> str:
    """Type in C of a member of a record that is a number; ``prefix`` is that of enumerations."""
    member = _member(kind, name)
    if member is None or not member.kind:
        return "uint32_t" if member is not None and member.whole else "float"
    return member.kind if isinstance(member.kind, str) else f"{prefix}_{c_name(member.kind)}_t"


def is_pointed(kind: type[Any], name: str) -> bool:
    """Whether a record has the address of another one."""
    member = _member(kind, name)
    return member is not None and member.pointed


def enumeration(kind: type[IntEnum], texts: Mapping[Any, str], prefix: str) -> list[str]:
    """A type whose constants have the name of what has the states: STARTUP of StartupState."""
    name = c_name(kind)
    before = f"{prefix}_{name.rpartition('_')[0]}".upper()
    names = [f"{before}_{one.name}" for one in kind]
    names[0] += " = 0"
    names = [f"{one}," for one in names[:-1]] + names[-1:]
    most = max(map(len, names))
    lines = [
        f"    {one:{most}} /* {text} */" if text else f"    {one}"
        for one, text in zip(names, texts.values(), strict=True)
    ]
    return [*comment(sentence(kind)), "typedef enum {", *lines, f"}} {prefix}_{name}_t;"]


def sentence(item: Any) -> str:
    """The first paragraph of what is said of a function or record."""
    return (inspect.getdoc(item) or "").split("\n\n")[0].replace("`", "").replace("\n", " ")


def struct(name: str, members: Sequence[tuple[str, str]]) -> list[str]:
    """A type of members, each with what stands behind it, or above it where the line is full."""
    most, lines = max(len(text) for text, _ in members), list[str]()
    for text, says in members:
        behind = f" /* {comment_text(says)} */" if says else ""
        whole = f"    {text};{' ' * (most - len(text)) if behind else ''}{behind}"
        if len(whole) <= LINE:
            lines.append(whole)
        else:
            lines += [f"   {behind}", f"    {text};"]
    return ["typedef struct {", *lines, f"}} {name};"]


def vector_struct(kind: type[Any], prefix: str) -> list[str]:
    """The type of a vector that no header declares."""
    members = [(f"{kind_of(kind, n, prefix)} {n}", said(kind, n)) for n in kind._fields]
    return [*comment(sentence(kind)), *struct(f"{prefix}_{c_name(kind)}_t", members)]


def record_structs(
    like: Any, prefix: str, members: set[Origin] | None = None, known: set[str] | None = None
) -> Iterator[list[str]]:
    """Types of a record of numbers and of those in it that are not ``known``, which grows;
    ``members`` are those that are needed, None for all that are not None.
    """
    kind, lines = type(like), list[tuple[str, str]]()
    known = set() if known is None else known
    for name, value in _needed(like, members):
        own, text = member_name(kind, name), said(kind, name)
        if is_dataclass(value):
            yield from record_structs(value, prefix, members, known)
            lines.append((f"{prefix}_{c_name(type(value))}_t {own}", text))
        else:
            size = ""
            if isinstance(value, tuple) and not hasattr(value, "_fields"):
                value, size = value[0], f"[{len(value)}]"  # noqa: PLW2901
            if hasattr(value, "_fields"):
                lines.append((f"{prefix}_{c_name(type(value))}_t {own}{size}", text))
            else:
                lines.append((f"{kind_of(kind, name, prefix)} {own}{size}", text))
    if c_name(kind) not in known:
        known.add(c_name(kind))
        yield [*comment(sentence(kind)), *struct(f"{prefix}_{c_name(kind)}_t", lines)]


def record_values(like: Any, members: set[Origin] | None) -> list[str]:
    """Lines of an initialiser, without the outermost braces; ``members`` as of `record_structs`."""
    found, indent = list[str](), "    "
    for name, value in _needed(like, members):
        kind = kind_of(type(like), name)
        if is_dataclass(value):
            inner = [line.strip() for line in record_values(value, members)]
            found.append("\n".join(folded("{ ", " ".join(inner), " }", indent)))
        elif isinstance(value, tuple):
            numbers = ", ".join(map(float_literal, value))
            found.append("\n".join(folded("{ ", numbers, " }", indent)))
        elif kind == "float":
            found.append(indent + float_literal(value))
        else:
            found.append(indent + expression(value, kind).text)
    return ",\n".join(found).split("\n")


def _needed(like: Any, members: set[Origin] | None) -> Iterator[tuple[str, Any]]:
    for member in fields(like):
        value = getattr(like, member.name)
        if value is not None and (members is None or (c_name(type(like)), member.name) in members):
            yield member.name, value


def record_numbers(like: Any, members: set[Origin]) -> Iterator[float]:
    """Numbers of a record in the order of its type."""
    for _, value in _needed(like, members):
        if is_dataclass(value):
            yield from record_numbers(value, members)
        else:
            yield from value if isinstance(value, tuple) else (value,)
