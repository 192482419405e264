"""C written from a step: the step is run once on expressions instead of numbers.

Records become structs, `let` declares a local constant, `choose` is a conditional expression,
`call` a call of a function that is written once, `cases` and `either` are an if with its else. What
Python decides before numbers are known does not reach the C.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from textwrap import wrap
from typing import Any, Concatenate, ParamSpec, TypeVar, cast, get_type_hints

import numpy as np

from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import (
    Abc,
    AlphaBeta,
    Arithmetic,
    Dq,
    Member,
    Pair,
    Rotation,
)
from dqforge.reports.c_code.numbers import comment_text, float_literal
from dqforge.reports.steps.symbols import Condition, Expression, Origin, expression, folded, joined

_T = TypeVar("_T")
_P = ParamSpec("_P")

# Vectors that `dqforge.reports.steps.control_types` declares.
SHARED: dict[type[Any], str] = {
    Abc: "abc",
    AlphaBeta: "alphabeta",
    Dq: "dq",
    Rotation: "rotation",
}
_LINE = 118


def c_name(kind: type[Any]) -> str:
    """Name of a record in C, without prefix and ``_t``."""
    return SHARED.get(kind) or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind.__name__).lower()


def comment(text: str) -> list[str]:
    """Lines of a comment on a function or record."""
    first, *rest = wrap(comment_text(text), _LINE - 6, break_long_words=False)
    return [f"/* {first}", *(f" * {line}" for line in rest), " */"] if rest else [f"/* {first} */"]


@dataclass(slots=True)
class Block:
    """Statements of a function in the order of their text; ``names`` are taken in it, and
    ``declared`` lines stand before the first statement that is no declaration, None without one.
    """

    indent: str
    names: set[str]
    lines: list[str] = field(default_factory=list)
    declared: int | None = None

    def add(self, begin: str, text: str, meaning: str = "") -> None:
        """A statement, with a comment behind or above it."""
        found = folded(begin, text, ";", self.indent)
        if meaning:
            said = f"/* {comment_text(meaning)} */"
            if len(found) == 1 and len(found[0]) + len(said) < _LINE:
                found[0] += f" {said}"
            else:
                found.insert(0, f"{self.indent}{said}")
        self.lines += found

    def variable(self, kind: str, name: str) -> None:
        """Declare what statements will give its value, before all of them."""
        if self.declared is None:
            self.lines.append(f"{self.indent}{kind} {name};")
        else:
            self.lines.insert(self.declared, f"{self.indent}{kind} {name};")
            self.declared += 1

    def work(self, lines: Sequence[str]) -> None:
        """Statements that are no declarations."""
        if self.declared is None:
            self.declared = len(self.lines)
            self.lines += [""] if self.lines else []
        self.lines += lines


@dataclass(slots=True)
class Functions:
    """What steps have needed so far: ``texts`` and ``results`` of functions, by name, ``members``
    of records, and ``vectors`` that are declared nowhere else.
    """

    texts: dict[str, str] = field(default_factory=dict)
    results: dict[str, type[Any] | None] = field(default_factory=dict)
    members: set[Origin] = field(default_factory=set)
    vectors: dict[str, type[Any]] = field(default_factory=dict)


class StepReader(Arithmetic):
    """Writes what a step computes into ``block``.

    Args:
        prefix: Before every name of a function or record.
        functions: Takes what `call` writes.
        block: Where the statements go.
    """

    __setattr__ = object.__setattr__  # its parents are frozen, it writes

    def __init__(self, prefix: str, functions: Functions, block: Block) -> None:
        super().__init__(np.float32, self._wrapped, self._rotated)
        self.prefix, self.functions, self.block = prefix, functions, block
        self.branches: tuple[str, list[tuple[Block, Any]]] | None = None
        self._records: list[tuple[Any, str, frozenset[Origin]]] = []

    def _wrapped(self, theta: Any) -> Any:
        return self._called("wrap", (theta,), None)

    def _rotated(self, theta: Any) -> Any:
        return self._called("rotation", (theta,), Rotation)

    def clarke(self, x: Abc) -> AlphaBeta:
        """Phases to stationary coordinates."""
        found: AlphaBeta = self._called("clarke", (x,), AlphaBeta)
        return found

    def clarke_inverse(self, x: Pair) -> Abc:
        """Stationary coordinates to phases."""
        found: Abc = self._called("clarke_inverse", (x,), Abc)
        return found

    def park(self, x: Pair, turn: Pair) -> Dq:
        """Stationary coordinates in a turned frame."""
        found: Dq = self._called("park", (x, turn), Dq)
        return found

    def park_inverse(self, x: Pair, turn: Pair) -> AlphaBeta:
        """Coordinates of a turned frame back."""
        found: AlphaBeta = self._called("park_inverse", (x, turn), AlphaBeta)
        return found

    def product(self, name: str, a: Any, b: Any) -> Any:  # noqa: ARG002
        """A product, whose sign stands before it."""
        x, y = expression(a), expression(b)
        found = (x.minus or x) * (y.minus or y)
        return found if (x.minus is None) == (y.minus is None) else found.negative()

    def total(self, name: str, *terms: Any) -> Any:  # noqa: ARG002
        """A sum, from the left; a negative is subtracted."""
        found, *rest = map(expression, terms)
        for term in rest:
            found = found + term if term.minus is None else found - term.minus
        return found

    def negative(self, a: Any) -> Any:
        """The number with the other sign."""
        return expression(a).negative()

    def part(self, name: str, a: Any, share: float) -> Any:  # noqa: ARG002
        """The product with a constant."""
        return share * expression(a)

    def whole(self, a: Any) -> Any:
        """A number as an integer."""
        return joined(f"(long){a.operand()}", a, kind="long")

    def real(self, a: Any) -> Any:
        """An integer as a number."""
        return joined(f"(float){a.operand()}", a, kind="float")

    def has_bit(self, a: Any, bit: int) -> Any:
        """Whether an integer has a bit."""
        return Condition((joined(f"({a.operand()} & {bit}) != 0", a),))

    def root(self, a: Any) -> Any:
        """Square root."""
        return joined(f"sqrtf({a.bare()})", a, atom=True)

    def magnitude(self, a: Any) -> Any:
        """Magnitude."""
        return joined(f"fabsf({a.bare()})", a, atom=True)

    def full(self, value: Any, like: Reals) -> Any:  # noqa: ARG002
        """A constant."""
        return expression(value)

    def choose(self, condition: Any, a: Any, b: Any) -> Any:
        """A conditional expression."""
        parts = expression(a), expression(b)
        text = " : ".join(part.operand(signed=True) for part in parts)
        return joined(f"({condition.text()}) ? {text}", *condition.terms, *parts)

    def remark(self, text: str) -> None:
        """A comment on a line of its own."""
        self.block.lines.append(f"{self.block.indent}/* {comment_text(text)} */")

    def let(self, name: str, value: _T, meaning: str = "") -> _T:
        """A constant of the block, or as many as an array has numbers to be computed."""
        result: _T = self._named(name, value, meaning)
        return result

    def _named(self, name: str, value: Any, meaning: str) -> Any:
        if isinstance(value, np.ndarray):
            found, named = value.copy(), dict[int, Any]()
            for at in np.ndindex(value.shape):
                item, own = expression(value[at]), f"{name}_{''.join(map(str, at))}"
                if not item.is_name and id(item) not in named:
                    named[id(item)] = self._named(own, item, "" if named else meaning)
                found[at] = named.get(id(item), item)
            return found
        if isinstance(value, tuple):
            parts = tuple(map(expression, value))
            if not hasattr(value, "_fields"):
                self._declare("float *const", name, _handed_on(value), meaning, parts)
                return tuple(Expression(f"{name}[{n}]", whole=name) for n in range(len(value)))
            text = _whole(value) or f"{{ {', '.join(part.bare() for part in parts)} }}"
            self._declare(f"{self.prefix}_{c_name(type(value))}_t", name, text, meaning, parts)
            return vector(type(value), name)
        number = expression(value)
        self._declare(number.kind, name, number.bare(), meaning, (number,))
        return Expression(name, kind=number.kind)

    def cases(
        self,
        name: str,
        *branches: tuple[Any, Callable[[], _T]],
        otherwise: Callable[[], _T],
    ) -> _T:
        """A variable that an if, its else ifs and its else give their values."""
        outer, lines, value = self.block, list[str](), None
        begin = "if ("
        for condition, branch in (*branches, (None, otherwise)):
            if condition is None:
                lines.append(f"{outer.indent}}} else {{")
            else:
                self.take(condition.terms)
                lines += folded(begin, condition.text(), ") {", outer.indent)
            self.block = Block(outer.indent + "    ", outer.names | {name})
            value = branch()
            self._assign(name, value)
            lines += self.block.lines
            begin = "} else if ("
        self.block = outer
        self._new(name)
        outer.variable(self._kind(value), name)
        outer.work([*lines, f"{outer.indent}}}"])
        found: Any = vector(type(value), name) if isinstance(value, tuple) else Expression(name)
        return cast("_T", found)

    def _kind(self, value: Any) -> str:
        if isinstance(value, tuple):
            return f"{self.prefix}_{c_name(type(value))}_t"
        return expression(value).kind

    def _assign(self, name: str, value: Any) -> None:
        """Give a variable its value at the end of a block."""
        parts = tuple(map(expression, value if isinstance(value, tuple) else (value,)))
        self.take(parts)
        self.block.work([])
        if not isinstance(value, tuple):
            self.block.add(f"{name} = ", parts[0].bare())
        elif text := _whole(value):
            self.block.add(f"{name} = ", text)
        else:
            for axis, part in zip(kind_fields(value), parts, strict=True):
                self.block.add(f"{name}.{axis} = ", part.bare())

    def _new(self, name: str) -> None:
        if name in self.block.names:
            raise ValueError(f"there is a {name} already")
        self.block.names.add(name)

    def _declare(
        self, kind: str, name: str, text: str, meaning: str, parts: Sequence[Expression]
    ) -> None:
        self._new(name)
        self.take(parts)
        self.block.add(f"const {kind} {name} = ", text, meaning)

    def take(self, parts: Sequence[Expression]) -> None:
        """Count the members of records in them as needed."""
        self.functions.members.update(*(part.members for part in parts))

    def call(
        self,
        function: Callable[Concatenate[Arithmetic, _P], _T],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _T:
        """A call; the first one writes the function."""
        assert not kwargs, "arguments of a function of the firmware have their places"
        name = function.__name__.lstrip("_")
        if name not in self.functions.texts:
            self.write(name, function, args)
        result: _T = self._called(name, args, self.functions.results[name])
        return result

    def _called(self, name: str, arguments: Sequence[Any], kind: type[Any] | None) -> Any:
        texts, parts = [], list[Expression]()
        for argument in arguments:
            place = self._place(argument)
            if place is not None:
                texts.append(place[0])
                self.functions.members |= place[1]
            elif isinstance(argument, tuple):
                texts.append(_handed_on(argument))
                parts += [expression(part) for part in argument]
            else:
                parts.append(expression(argument))
                texts.append(parts[-1].bare())
        text = f"{self.prefix}_{name}({', '.join(texts)})"
        if kind is None:
            return joined(text, *parts, atom=True)
        names: tuple[str, ...] = kind._fields
        found = [joined(f"{text}.{n}", *parts, atom=True, whole=text) for n in names]
        for part in found:
            part.uses = found[0].uses
        return kind(*found)

    def _place(self, value: Any) -> tuple[str, frozenset[Origin]] | None:
        """Address of a record, and the members through which it is reached; None of others."""
        return next(((text, outer) for own, text, outer in self._records if own is value), None)

    def write(self, name: str, function: Callable[..., Any], arguments: Sequence[Any]) -> None:
        """Write a function.

        Args:
            name: In C, behind the prefix.
            function: Of an arithmetic and the arguments.
            arguments: As of `parameter`.
        """
        names = list(inspect.signature(function).parameters)[1:]
        inner = StepReader(self.prefix, self.functions, Block("    ", set(names)))
        inside = [inner.parameter(n, item) for n, item in zip(names, arguments, strict=True)]
        result = function(inner, *(value for _, value in inside))
        body, end = inner.block.lines, Block("    ", set())
        if isinstance(result, tuple):
            own = c_name(type(result))
            kind, whole = f"{self.prefix}_{own}_t", _whole(result)
            if type(result) not in SHARED:
                self.functions.vectors[own] = type(result)
            if whole:
                end.add("return ", whole)
            else:
                body.insert(0, f"    {kind} result;")
                for n, part in zip(kind_fields(result), result, strict=True):
                    end.add(f"result.{n} = ", expression(part).bare())
                end.lines.append("    return result;")
            inner.take([expression(part) for part in result])
        else:
            kind, number = "float", expression(result)
            end.add("return ", number.bare())
            inner.take([number])
        parameters = ", ".join(text for text, _ in inside)
        head = folded(f"static inline {kind} {self.prefix}_{name}(", parameters, ")", "")
        lines = [
            *comment(_sentence(function)),
            *head,
            "{",
            *body,
            *([""] if body and inner.block.declared is None else []),
            *end.lines,
            "}",
        ]
        self.functions.texts[name] = "\n".join(lines)
        self.functions.results[name] = type(result) if isinstance(result, tuple) else None

    def parameter(self, name: str, like: Any) -> tuple[str, Any]:
        """Declaration of a parameter, and its value inside of the function.

        Args:
            name: Of the parameter.
            like: An argument: a record, a vector, an array or a number.
        """
        if is_dataclass(like):
            kind = f"{self.prefix}_{c_name(type(like))}_t"
            return f"const {kind} *{name}", self._record(like, name, f"{name}->", frozenset())
        if not isinstance(like, tuple):
            return f"float {name}", Expression(name)
        if hasattr(like, "_fields"):
            kind = f"{self.prefix}_{c_name(type(like))}_t"
            return f"{kind} {name}", vector(type(like), name)
        inside = tuple(Expression(f"{name}[{n}]", whole=name) for n in range(len(like)))
        return f"const float {name}[{len(like)}]", inside

    def _record(self, like: Any, address: str, place: str, outer: frozenset[Origin]) -> Any:
        values: dict[str, Any] = {}
        for member in fields(like):
            name, value = f"{place}{member.name}", getattr(like, member.name)
            own = outer | {(c_name(type(like)), member.name)}
            if is_dataclass(value):
                values[member.name] = self._record(value, f"&{name}", f"{name}.", own)
            elif isinstance(value, tuple):
                values[member.name] = tuple(
                    Expression(f"{name}[{n}]", members=own, whole=name) for n in range(len(value))
                )
            else:
                values[member.name] = Expression(name, members=own)
        found = replace(like, **values)
        self._records.append((found, address, outer))
        return found

    def either(self, condition: Any, then: Callable[[], _T], otherwise: Callable[[], _T]) -> _T:
        """An if at the end of the step, with its else."""
        outer, found = self.block, []
        text = condition.text()
        for branch in (then, otherwise):
            self.block = Block(outer.indent + "    ", set(outer.names))
            found.append((self.block, branch()))
        self.block, self.branches = outer, (text, found)
        return found[0][1]


def kind_fields(value: Any) -> tuple[str, ...]:
    """Names of the parts of a vector."""
    names: tuple[str, ...] = type(value)._fields
    return names


def vector(kind: type[Any], name: str, *, state: bool = False) -> Any:
    """A vector by its name in C; ``state`` of a member of the state."""
    texts = [f"{name}.{n}" for n in kind._fields]
    return kind(
        *(Expression(text, reads=frozenset({text} if state else ()), whole=name) for text in texts)
    )


def _whole(value: Any) -> str:
    """The vector or array whose parts these are, in their order; else nothing."""
    places = {part.whole for part in value if isinstance(part, Expression)}
    if len(places) != 1:
        return ""
    (place,) = places
    names = (
        [f"{place}.{n}" for n in kind_fields(value)]
        if hasattr(value, "_fields")
        else [f"{place}[{n}]" for n in range(len(value))]
    )
    return place if [getattr(part, "text", "") for part in value] == names else ""


def _handed_on(value: Any) -> str:
    text = _whole(value)
    if not text:
        raise ValueError("a vector is handed on by its name: name it by `let`")
    return text


def _said(kind: type[Any], name: str) -> str:
    hint = get_type_hints(kind, include_extras=True).get(name)
    said = [item for item in getattr(hint, "__metadata__", ()) if isinstance(item, Member)]
    return said[0].text if said else ""


def _sentence(item: Any) -> str:
    """The first paragraph of what is said of a function or record."""
    return (inspect.getdoc(item) or "").split("\n\n")[0].replace("`", "").replace("\n", " ")


def struct(name: str, members: Sequence[tuple[str, str]]) -> list[str]:
    """A type of members, each with what stands behind it, or above it where the line is full."""
    most, lines = max(len(text) for text, _ in members), list[str]()
    for text, says in members:
        said = f" /* {comment_text(says)} */" if says else ""
        whole = f"    {text};{' ' * (most - len(text)) if said else ''}{said}"
        if len(whole) <= _LINE:
            lines.append(whole)
        else:
            lines += [f"   {said}", f"    {text};"]
    return ["typedef struct {", *lines, f"}} {name};"]


def vector_struct(kind: type[Any], prefix: str) -> list[str]:
    """The type of a vector that no header declares."""
    members = [(f"float {n}", _said(kind, n)) for n in kind._fields]
    return [*comment(_sentence(kind)), *struct(f"{prefix}_{c_name(kind)}_t", members)]


def record_structs(like: Any, prefix: str, members: set[Origin]) -> Iterator[list[str]]:
    """Types of a record of numbers and of those in it, as far as their members are needed."""
    own, lines = c_name(type(like)), []
    for name, value in _needed(like, members):
        if is_dataclass(value):
            yield from record_structs(value, prefix, members)
            lines.append((f"{prefix}_{c_name(type(value))}_t {name}", ""))
        else:
            size = f"[{len(value)}]" if isinstance(value, tuple) else ""
            lines.append((f"float {name}{size}", _said(type(like), name)))
    yield [*comment(_sentence(type(like))), *struct(f"{prefix}_{own}_t", lines)]


def record_values(like: Any, members: set[Origin]) -> list[str]:
    """Lines of an initialiser, without the outermost braces."""
    found, indent = list[str](), "    "
    for _, value in _needed(like, members):
        if is_dataclass(value):
            inner = [line.strip() for line in record_values(value, members)]
            found.append("\n".join(folded("{ ", " ".join(inner), " }", indent)))
        elif isinstance(value, tuple):
            numbers = ", ".join(map(float_literal, value))
            found.append("\n".join(folded("{ ", numbers, " }", indent)))
        else:
            found.append(indent + float_literal(value))
    return ",\n".join(found).split("\n")


def _needed(like: Any, members: set[Origin]) -> Iterator[tuple[str, Any]]:
    for member in fields(like):
        if (c_name(type(like)), member.name) in members:
            yield member.name, getattr(like, member.name)


def record_numbers(like: Any, members: set[Origin]) -> Iterator[float]:
    """Numbers of a record in the order of its type."""
    for _, value in _needed(like, members):
        if is_dataclass(value):
            yield from record_numbers(value, members)
        else:
            yield from value if isinstance(value, tuple) else (value,)
