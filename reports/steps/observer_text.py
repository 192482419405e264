"""A position observer in C, from its step: types, start, step and gains."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from struct import pack
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar, get_type_hints

import numpy as np

from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import ObserverState
from dqforge.optimizer.steps.step_arithmetic import (
    AlphaBeta,
    Arithmetic,
    Dq,
    Member,
    Pair,
    Rotation,
)
from dqforge.reports.c_code.numbers import comment_text, float_literal
from dqforge.reports.steps.symbols import Expression, Origin, expression, folded, joined

if TYPE_CHECKING:
    from dqforge.optimizer.observers.parts import ObserverMethod, StateMembers


_ANGLE = ("float theta_e", "estimated electrical angle, rad, -pi to pi")


_SPEED = ("float omega_e", "estimated electrical speed, rad/s")


def observer_text(method: ObserverMethod, gains: Any, prefix: str, macro: str) -> str:
    """What stands in a header behind the types that control and observers share.

    Args:
        method: With ``members``.
        gains: Its gains.
        prefix, macro: Before the names of functions and types, and before that of the gains.
    """
    assert method.members is not None
    code, functions = method.code, Functions()
    if c_name(method.gains) != f"{code}_gains":
        raise ValueError(f"{method.gains.__name__} is not named like {code}")
    first, then = (_path(method, gains, prefix, functions, started) for started in (False, True))
    state, own = f"{prefix}_{code}_t", f"{prefix}_{code}_gains_t"
    parts = [
        *(vector_struct(kind, prefix) for kind in functions.vectors.values()),
        *record_structs(gains, prefix, functions.members),
        struct(state, _state_members(method.members, prefix)),
        _start(method, prefix, state),
        *([text] for text in functions.texts.values()),
        _step(f"{prefix}_{code}_step(", own, state, prefix, first, then),
        [
            f"static const {own} {macro}_{code.upper()}_GAINS = {{",
            *record_values(gains, functions.members),
            "};",
        ],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)


def gains_bytes(method: ObserverMethod, gains: Any) -> bytes:
    """Bytes of ``<prefix>_<code>_gains_t``, for runs that are given their own."""
    functions = Functions()
    for started in (False, True):
        _path(method, gains, "", functions, started)
    numbers = list(record_numbers(gains, functions.members))
    return pack(f"={len(numbers)}f", *numbers)


def _state_members(members: StateMembers, prefix: str) -> list[tuple[str, str]]:
    return [
        *((f"{prefix}_alphabeta_t {n}", own.text) for n, own in members.vectors),
        *((f"float {n}", own.text) for n, own in members.scalars),
        ("int started", "0 before the first step"),
        _ANGLE,
        _SPEED,
    ]


def _start(method: ObserverMethod, prefix: str, state: str) -> list[str]:
    """The first state, whose vectors and scalars depend on nothing."""
    assert method.members is not None
    first = method.start(np.ones(1), np.ones(1))
    targets = [f"{n}.{axis}" for n, _ in method.members.vectors for axis in AlphaBeta._fields]
    targets += [n for n, _ in method.members.scalars]
    values = [part for pair in first.vectors for part in pair] + list(first.scalars)
    head = f"static inline void {prefix}_{method.code}_start("
    return [
        *comment(
            "Start from an angle in rad and a speed in rad/s (electrical) at the instant of the "
            "first step."
        ),
        *folded(head, f"{state} *observer, float theta_e, float omega_e", ")", ""),
        "{",
        *(
            f"    observer->{target} = {float_literal(float(value[0]))};"
            for target, value in zip(targets, values, strict=True)
        ),
        "    observer->started = 0;",
        f"    observer->theta_e = {prefix}_wrap(theta_e);",
        "    observer->omega_e = omega_e;",
        "}",
    ]


@dataclass(frozen=True, slots=True)
class Path:
    """Statements of a step, and what it writes to the state at its end."""

    declared: list[str]
    written: list[str]


def _path(
    method: ObserverMethod, gains: Any, prefix: str, functions: Functions, started: bool
) -> Path:
    assert method.members is not None
    block = Block("        ", {"gains", "observer", "v", "i"})
    reader = StepReader(prefix, functions, block)
    _, own = reader.parameter("gains", gains)
    state = ObserverState(
        tuple(vector(AlphaBeta, f"observer->{n}", state=True) for n, _ in method.members.vectors),
        _member("theta_e"),
        _member("omega_e"),
        started,
        tuple(_member(n) for n, _ in method.members.scalars),
    )
    result = method.step(own, state, vector(AlphaBeta, "v"), vector(AlphaBeta, "i"), reader)
    if reader.branches is None:
        return Path(block.lines, _written(method.members, result, reader, block.indent))
    condition, branches = reader.branches
    lines = [*folded("if (", condition, ") {", block.indent)]
    for n, (inner, after) in enumerate(branches):
        written = _written(method.members, after, reader, inner.indent)
        between = [""] if inner.lines else []
        lines += [*([f"{block.indent}}} else {{"] if n else []), *inner.lines, *between, *written]
    return Path(block.lines, [*lines, f"{block.indent}}}"])


def _member(name: str) -> Any:
    return Expression(f"observer->{name}", reads=frozenset({f"observer->{name}"}))


def _written(
    members: StateMembers, after: ObserverState, reader: StepReader, indent: str
) -> list[str]:
    """Assignments to what changes, none before another one that reads the old value."""
    open_ = list[tuple[str, str, frozenset[str], set[str]]]()
    names = [*(n for n, _ in members.scalars), "theta_e", "omega_e"]
    for (n, _), pair in zip(members.vectors, after.vectors, strict=True):
        parts, place = [expression(part) for part in pair], f"observer->{n}"
        whole = {part.whole for part in parts}
        reader.take(parts)
        if (
            whole != {""}
            and len(whole) == 1
            and [p.text for p in parts]
            == [f"{parts[0].whole}.{axis}" for axis in AlphaBeta._fields]
        ):
            reads = parts[0].reads | parts[1].reads
            targets = {f"{place}.{axis}" for axis in AlphaBeta._fields}
            open_.append((place, parts[0].whole, reads, targets))
        else:
            open_ += [
                (f"{place}.{axis}", part.bare(), part.reads, {f"{place}.{axis}"})
                for axis, part in zip(AlphaBeta._fields, parts, strict=True)
            ]
    for n, value in zip(names, (*after.scalars, after.theta_e, after.omega_e), strict=True):
        part, place = expression(value), f"observer->{n}"
        reader.take([part])
        open_.append((place, part.bare(), part.reads, {place}))
    return in_order(open_, indent)


def in_order(writes: Sequence[tuple[str, str, frozenset[str], set[str]]], indent: str) -> list[str]:
    """Assignments to members of a state, none before another one that reads the old value.

    Args:
        writes: What is written, its value, what that reads, and which members it changes.
        indent: Of the lines.

    Raises:
        ValueError: There is no such order.
    """
    open_ = [item for item in writes if item[0] != item[1]]
    block = Block(indent, set())
    while open_:
        free = [
            item
            for item in open_
            if not any(item[3] & other[2] for other in open_ if other is not item)
        ]
        if not free:
            raise ValueError(f"{open_[0][0]} is needed after it changed: name it by `let`")
        block.add(f"{free[0][0]} = ", free[0][1])
        open_.remove(free[0])
    return block.lines


def _step(head: str, gains: str, state: str, prefix: str, first: Path, then: Path) -> list[str]:
    both, branches, after = merged(first, then)
    vector_kind = f"{prefix}_alphabeta_t"
    arguments = f"const {gains} *gains, {state} *observer, {vector_kind} v, {vector_kind} i"
    return [
        *comment(
            "One sample: v in V acted over the period that ends at the sampling instant of i in A."
        ),
        *folded(f"static inline void {head}", arguments, ")", ""),
        "{",
        *both,
        *gap(both),
        "    if (observer->started == 0) {",
        *branches[0],
        "        observer->started = 1;",
        "    } else {",
        *branches[1],
        "    }",
        *after,
        "}",
    ]


def merged(first: Path, then: Path) -> tuple[list[str], tuple[list[str], list[str]], list[str]]:
    """Both paths of a step: what they share before the branch, the branches, what they share
    behind them.
    """
    before = _shared(first.declared, then.declared)
    inside = _declared([*first.declared[before:], *then.declared[before:]])
    after = [
        statement
        for statement in statements(first.written)
        if statement in statements(then.written) and _stands_alone(statement, inside)
    ]

    def branch(path: Path) -> list[str]:
        own = path.declared[before:]
        written = [part for part in statements(path.written) if part not in after]
        return [*own, *gap(own), *(line for part in written for line in part)]

    both = [line[4:] for line in first.declared[:before]]
    return both, (branch(first), branch(then)), [line[4:] for part in after for line in part]


def statements(lines: Sequence[str]) -> list[list[str]]:
    """Lines of each statement, also of what opens or closes a block."""
    found: list[list[str]] = [[]]
    for line in lines:
        found[-1].append(line)
        if line.endswith((";", "{", "}")):
            found.append([])
    return [part for part in found if part]


def _declared(lines: Sequence[str]) -> set[str]:
    """Names of the constants that lines declare."""
    return {found[1] for line in lines if (found := re.match(r"\s*const [^=]*?(\w+) =", line))}


def _stands_alone(statement: Sequence[str], inside: set[str]) -> bool:
    """Whether an assignment may stand behind both branches: it reads neither the state, which they
    change, nor what they declare.
    """
    value = " ".join(statement).partition(" = ")[2]
    return "observer->" not in value and not inside & set(re.findall(r"\w+", value))


def gap(lines: Sequence[str]) -> list[str]:
    """The empty line behind declarations."""
    return [""] if lines else []


def _shared(a: Sequence[str], b: Sequence[str]) -> int:
    """How many lines two texts begin with alike."""
    pairs = zip(a, b, strict=False)
    return next((n for n, (x, y) in enumerate(pairs) if x != y), min(len(a), len(b)))


# C written from a step: the step is run once on expressions instead of numbers.
#
# Records become structs, `let` declares a local constant, `choose` is a conditional expression,
# `call` a call of a function that is written once, `either` an if with its else. What Python
# decides before numbers are known does not reach the C.

_T = TypeVar("_T")
_P = ParamSpec("_P")

# Vectors that ``control_types.j2`` declares.
_SHARED: dict[type[Any], str] = {AlphaBeta: "alphabeta", Dq: "dq", Rotation: "rotation"}
_LINE = 118


def c_name(kind: type[Any]) -> str:
    """Name of a record in C, without prefix and ``_t``."""
    return _SHARED.get(kind) or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind.__name__).lower()


def comment(text: str) -> list[str]:
    """Lines of a comment on a function or record."""
    first, *rest = wrap(comment_text(text), _LINE - 6, break_long_words=False)
    return [f"/* {first}", *(f" * {line}" for line in rest), " */"] if rest else [f"/* {first} */"]


@dataclass(slots=True)
class Block:
    """Statements of a function in the order of their text; ``names`` are taken in it."""

    indent: str
    names: set[str]
    lines: list[str] = field(default_factory=list)

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

    def park(self, vector: Pair, turn: Pair) -> Dq:
        """Stationary coordinates in a turned frame."""
        found: Dq = self._called("park", (vector, turn), Dq)
        return found

    def park_inverse(self, vector: Pair, turn: Pair) -> AlphaBeta:
        """Coordinates of a turned frame back."""
        found: AlphaBeta = self._called("park_inverse", (vector, turn), AlphaBeta)
        return found

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
        self._declare("float", name, number.bare(), meaning, (number,))
        return Expression(name)

    def _declare(
        self, kind: str, name: str, text: str, meaning: str, parts: Sequence[Expression]
    ) -> None:
        if name in self.block.names:
            raise ValueError(f"there is a {name} already")
        self.block.names.add(name)
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
            self._write(name, function, args)
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

    def _write(self, name: str, function: Callable[..., Any], arguments: Sequence[Any]) -> None:
        names = list(inspect.signature(function).parameters)[1:]
        inner = StepReader(self.prefix, self.functions, Block("    ", set(names)))
        inside = [inner.parameter(n, item) for n, item in zip(names, arguments, strict=True)]
        result = function(inner, *(value for _, value in inside))
        body, end = inner.block.lines, Block("    ", set())
        if isinstance(result, tuple):
            own = c_name(type(result))
            kind, whole = f"{self.prefix}_{own}_t", _whole(result)
            if type(result) not in _SHARED:
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
            *comment(sentence(function)),
            *head,
            "{",
            *body,
            *([""] if body else []),
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


def said(kind: type[Any], name: str) -> str:
    """Phrase and unit of a member of a record, or nothing."""
    hint = get_type_hints(kind, include_extras=True).get(name)
    found = [item for item in getattr(hint, "__metadata__", ()) if isinstance(item, Member)]
    return found[0].text if found else ""


def sentence(item: Any) -> str:
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
    members = [(f"float {n}", said(kind, n)) for n in kind._fields]
    return [*comment(sentence(kind)), *struct(f"{prefix}_{c_name(kind)}_t", members)]


def record_structs(like: Any, prefix: str, members: set[Origin]) -> Iterator[list[str]]:
    """Types of a record of numbers and of those in it, as far as their members are needed."""
    own, lines = c_name(type(like)), []
    for name, value in _needed(like, members):
        if is_dataclass(value):
            yield from record_structs(value, prefix, members)
            lines.append((f"{prefix}_{c_name(type(value))}_t {name}", ""))
        else:
            size = f"[{len(value)}]" if isinstance(value, tuple) else ""
            lines.append((f"float {name}{size}", said(type(like), name)))
    yield [*comment(sentence(type(like))), *struct(f"{prefix}_{own}_t", lines)]


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
