"""C written from a step: the step is run once on expressions instead of numbers.

Records become structs, `let` declares a local constant, `choose` is a conditional expression,
`call` a call of a function that is written once, `cases` and `either` are an if with its else. What
Python decides before numbers are known does not reach the C.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import IntEnum
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import numpy as np

from dqforge.machines.transforms import leaves
from dqforge.optimizer.steps.step_arithmetic import (
    Abc,
    AlphaBeta,
    Arithmetic,
    Dq,
    Pair,
    Rotation,
)
from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.steps.blocks import Arm, Block, Functions
from dqforge.reports.steps.counted_loops import (
    Index,
    Table,
    constants,
    filled,
    interval,
    item,
    listed,
    place,
    placed,
    put_item,
    reached,
    repeated,
    summed,
    tables_of,
)
from dqforge.reports.steps.record_text import (
    SHARED,
    c_name,
    comment,
    is_pointed,
    kind_fields,
    kind_of,
    member_name,
    sentence,
    whole_of,
)
from dqforge.reports.steps.state_text import (
    Assignment,
    Kept,
    assignments,
    handed_on,
    members_at,
    numbers_of,
    ordered,
    state_vector,
    vector,
)
from dqforge.reports.steps.symbols import (
    WIDTH,
    Condition,
    Expression,
    Origin,
    equal,
    expression,
    folded,
    joined,
    name_of,
    whole_kind,
)

_T = TypeVar("_T")
_V = TypeVar("_V", bound=tuple[Any, ...])
_P = ParamSpec("_P")


class StepReader(Arithmetic):
    """Writes what a step computes into ``block``.

    Args:
        prefix: Before every name of a function or record.
        functions: Takes what `call` writes.
        block: Where the statements go.
    """

    __setattr__ = object.__setattr__  # its parents are frozen, it writes
    pointed = "float"  # what results through pointers are

    def __init__(self, prefix: str, functions: Functions, block: Block) -> None:
        super().__init__(np.float32, self._wrapped, self._rotated)
        self.prefix, self.functions, self.block = prefix, functions, block
        self.branches: tuple[str, list[tuple[Block, Any]]] | None = None
        self._records: list[tuple[Any, str, frozenset[Origin]]] = []
        self._kept: list[Kept] = []
        self._dead: set[str] = set()
        self._changed: set[str] = set()
        self._open: Expression | None = None  # a call that changes the state, till it is written

    # What a reader of other numbers says otherwise.

    def type_name(self, name: str) -> str:
        """Name of a type in C."""
        return f"{self.prefix}_{name}_t"

    def function_name(self, name: str) -> str:
        """Name of a function in C."""
        return f"{self.prefix}_{name}"

    def vector(self, kind: type[Any], name: str, *, state: bool = False) -> Any:
        """A vector by its name in C."""
        return vector(kind, name, state=state)

    def inside(self, function: Callable[..., Any], names: Sequence[str]) -> StepReader:  # noqa: ARG002
        """The reader of a function with parameters of these names."""
        return StepReader(self.prefix, self.functions, Block("    ", set(names)))

    def member_kind(self, kind: type[Any], name: str) -> str:
        """Type in C of a member of a record that is a number."""
        return kind_of(kind, name, self.prefix)

    def number_of(self, name: str, kind: str, **more: Any) -> Expression:
        """A number by its name and type in C; a condition where that is ``bool``."""
        return Expression(name, kind=kind, **more) if more else name_of(name, kind)

    def result_kind(self, value: Expression) -> str:
        """Type in C of a number that the function returns."""
        return value.kind

    def axis_kinds(self, kind: type[Any]) -> Sequence[str]:
        """Types in C of the parts of a vector."""
        return [kind_of(kind, axis) for axis in cast("Any", kind)._fields]

    def _axes(self, value: Any) -> tuple[Expression, ...]:
        """Parts of a vector as they are written into one."""
        kinds = self.axis_kinds(type(value))
        return tuple(expression(part, own).to(own) for part, own in zip(value, kinds, strict=True))

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

    def multiply_add(self, a: Any, b: Any, c: Any) -> Any:
        """A product and a sum; a negative is subtracted."""
        product = self.product("", a, b)
        if product.minus is not None:
            return c - product.minus
        less = not isinstance(c, Expression) and np.signbit(c)
        return self.total("", product, expression(-c).negative() if less else c)

    def negative(self, a: Any) -> Any:
        """The number with the other sign."""
        return expression(a).negative()

    def halved(self, a: Any) -> Any:
        """Half of a number."""
        return 0.5 * expression(a)

    def ratio(self, name: str, a: Any, b: Any) -> Any:  # noqa: ARG002
        """A quotient, 0 where its divisor is not positive."""
        return self.choose(b > 0.0, a / b, 0.0)

    def where_above(
        self, names: Sequence[str], a: Any, b: Any, x: Sequence[Any], y: Sequence[Any]
    ) -> list[Any]:
        """A conditional expression, or an if of several variables."""
        if len(names) == 1:
            return [self.let(names[0], self.choose(a > b, x[0], y[0]))]
        return list(self.cases(tuple(names), (a > b, lambda: tuple(x)), otherwise=lambda: tuple(y)))

    def part(self, name: str, a: Any, share: float) -> Any:  # noqa: ARG002
        """The product with a constant."""
        return expression(a).scaled(share)

    def whole(self, a: Any) -> Any:
        """A number as an integer."""
        return joined(f"(long){a.operand()}", a, kind="long")

    def real(self, a: Any) -> Any:
        """An integer as a number."""
        return joined(f"(float){a.operand()}", a, kind="float")

    def differ(self, a: Any, b: Any) -> Any:
        """Whether conditions differ."""
        text = f"({a.text()}) != ({b.text()})"
        return Condition((joined(text, *a.terms, *b.terms),))

    def is_number(self, a: Any) -> Any:
        """Whether it equals itself."""
        text = a.bare()
        return Condition((joined(f"{text} == {text}", a),))

    def outside(
        self,
        kind: type[_V],
        name: str,
        function: Callable[..., Iterable[Any]],  # noqa: ARG002
        *args: Any,
        filled: str = "",
    ) -> _V:
        """A call of a function whose text stands elsewhere."""
        if not filled:
            return cast("_V", self._called(name, args, kind))
        self.block.take(filled)
        parts = [expression(part) for part in args]
        self.take(parts)
        into = [f"&{filled}.{axis}" for axis in cast("Any", kind)._fields]
        texts = ", ".join([*(part.bare() for part in parts), *into])
        self.block.variable(self.type_name(c_name(kind)), filled)
        self.block.work(folded(f"{self.function_name(name)}(", texts, ");", self.block.indent))
        return cast("_V", self.vector(kind, filled))

    def has_bit(self, a: Any, bit: int) -> Any:
        """Whether an integer has a bit."""
        return Condition((joined(f"({a.operand()} & {bit}) != 0", a),))

    def root(self, a: Any) -> Any:
        """Square root."""
        return joined(f"sqrtf({a.bare()})", a, atom=True)

    def magnitude(self, a: Any) -> Any:
        """Magnitude."""
        return joined(f"fabsf({a.bare()})", a, atom=True)

    def full(self, value: Any, like: Any) -> Any:
        """A constant."""
        return expression(value, like.kind if isinstance(like, Expression) else "float")

    def choose(self, condition: Any, a: Any, b: Any) -> Any:
        """A conditional expression."""
        kind = next((part.kind for part in (a, b) if isinstance(part, Expression)), "")
        kind = kind or whole_kind(a)
        parts = expression(a, kind), expression(b, kind)
        text = " : ".join(part.operand(signed=True) for part in parts)
        head = condition.operand() if condition.is_name else f"({condition.text()})"
        found = joined(f"{head} ? {text}", *condition.terms, *parts, kind=kind)
        return place(found.text, atom=False) if isinstance(parts[0], Index) else found

    def at(self, table: Sequence[Any], place: Any, *inner: Any) -> Any:
        """A number or a vector of an array."""
        return item(table, place, *inner)

    def with_item(self, array: tuple[Any, ...], place: Any, value: Any) -> Any:
        """Statements that set a number or a vector of an array of the state."""
        self.write_state()
        return put_item(self, self._kept, self._renew, array, place, value)

    def interval(self, name: str, axis: Sequence[Any], value: Any) -> Any:
        """A variable that counts up to the interval."""
        return interval(self, name, axis, value)

    def local(self, name: str, record: _T) -> _T:
        """A variable that is a record."""
        self.block.take(name)
        self.block.variable(self.type_name(c_name(type(record))), name)
        return cast("_T", self._record(record, f"&{name}", f"{name}.", frozenset()))

    def table(self, name: str, values: Sequence[float]) -> Any:
        """A constant array."""
        return constants(self, name, values)

    def place(self, a: Any) -> Any:
        """A number as a place."""
        return place(f"(unsigned int){a.operand()}", reads=a.reads, members=a.members, atom=False)

    def constant(self, name: str, value: Any) -> Any:
        """A name in capitals."""
        kind, text = "int32_t", f"{self.prefix.upper()}_{name}"
        if isinstance(value, tuple):
            each = (f"{text}[{n}]" for n in range(len(value)))
            return tuple(Expression(one, whole=text, kind=kind) for one in each)
        if isinstance(value, IntEnum):
            kind = f"{self.prefix}_{c_name(type(value))}_t"
        return Expression(text, kind=kind)

    def equal(self, a: Any, b: Any) -> Any:
        """A comparison of whole numbers."""
        return equal(a, b)

    def negated(self, condition: Any) -> Any:
        """What holds where a condition does not."""
        return condition.negated()

    def each(self, name: str, count: int, of: Callable[[Any], Any]) -> tuple[Any, ...]:
        """An array that a counted loop fills."""
        return filled(self, name, count, of)

    def repeated(
        self,
        state: Any,
        count: Any,
        of: Callable[[Any], None],
        until: Callable[[], Any] | None = None,
    ) -> None:
        """A counted loop over variables that it changes, with a break where it ends before."""
        repeated(self, self._kept, state, count, of, until)

    def summed(self, name: str, first: Any, count: int, of: Callable[[Any], Any]) -> Any:
        """A variable to which a counted loop adds."""
        return summed(self, name, first, count, of)

    def placed(self, name: str, a: Any, most: int) -> Any:
        """A variable that takes a number as a place."""
        return placed(self, name, a, most)

    def reached(self, name: str, conditions: Sequence[Any]) -> Any:
        """A variable that is raised by one condition after the other."""
        return reached(self, name, conditions)

    def remark(self, text: str) -> None:
        """A comment on a line of its own."""
        self.block.remarks.append(f"{self.block.indent}/* {comment_text(text)} */")

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
        if isinstance(value, Table):
            self._declare("float *const", name, value.text, meaning, ())
            return Table(name, value.shape)
        if isinstance(value, tuple):
            parts = numbers_of(value)
            if not hasattr(value, "_fields"):
                if text := whole_of(value):
                    self._declare("float *const", name, text, meaning, parts)
                else:
                    begin = f"const float {name}[{len(parts)}] = {{"
                    listed(self, begin, name, parts, meaning)
                return tuple(Expression(f"{name}[{n}]", whole=name) for n in range(len(value)))
            text, parts = whole_of(value), self._axes(value)
            kind = self.type_name(c_name(type(value)))
            if text or not self._listed(kind, name, parts, meaning):
                text = text or f"{{ {', '.join(part.bare() for part in parts)} }}"
                self._declare(kind, name, text, meaning, parts)
            return self.vector(type(value), name)
        number = expression(value)
        self._declare(number.kind, name, number.bare(), meaning, (number,))
        if type(number) is Expression:
            return name_of(name, number.kind)
        return type(number)(name, kind=number.kind)

    def cases(
        self,
        name: str | tuple[str, ...],
        *branches: tuple[Any, Callable[[], _T]],
        otherwise: Callable[[], _T],
        changing: Sequence[Any] = (),
    ) -> _T:
        """A variable that an if, its else ifs and its else give their values, and a state that
        they change.
        """
        self.write_state()
        heads, begin = list[Arm[_T]](), "if ("
        for condition, branch in branches:
            self.take(condition.terms)
            lines = folded(begin, condition.text(), ") {", self.block.indent)
            heads.append(Arm(lines, branch))
            begin = "} else if ("
        otherwise_ = Arm([f"{self.block.indent}}} else {{"], otherwise, dropped=True)
        return self._chosen(name, [*heads, otherwise_], changing)

    def switch(
        self,
        name: str | tuple[str, ...],
        value: Any,
        branches: Mapping[Any, Callable[[], _T]],
        otherwise: Callable[[], _T],
        changing: Sequence[Any] = (),
    ) -> _T:
        """A switch, whose branches end with a break."""
        self.write_state()
        number, indent = expression(value), self.block.indent
        self.take((number,))
        opened = [f"{indent}switch ({number.bare()}) {{"]
        arms = list[Arm[_T]]()
        for key, branch in branches.items():
            keys = key if isinstance(key, tuple) else (key,)
            labels = [f"{indent}case {expression(one, number.kind).text}:" for one in keys]
            arms.append(Arm([*opened, *labels], branch, breaks=True))
            opened = []
        arms.append(Arm([*opened, f"{indent}default:"], otherwise, breaks=True))
        return self._chosen(name, arms, changing)

    def _chosen(
        self, name: str | tuple[str, ...], arms: Sequence[Arm[_T]], changing: Sequence[Any]
    ) -> _T:
        names = name if isinstance(name, tuple) else (name,) if name else ()
        outer, lines = self.block, list[str]()
        dead, before = set(self._dead), [kept.value for kept in self._kept]
        versions, changed = [kept.version for kept in self._kept], set[int]()
        given: Any = ()
        for arm in arms:
            self.block = Block(outer.indent + "    ", outer.names | set(names))
            value: Any = arm.branch()
            given = value if isinstance(name, tuple) else (value,)
            for own, part in zip(names, given, strict=False):
                self._assign(own, part)
            self.write_state()
            lines += arm.text(self.block)
            for n, kept in enumerate(self._kept):
                if kept.version != versions[n]:
                    changed.add(n)
                kept.value, kept.version = before[n], versions[n]
                kept.put()
            self._dead = set(dead)
        self.block = outer
        for own, part in zip(names, given, strict=False):
            self.block.take(own)
            outer.variable(self._kind(part), own)
        outer.work([*lines, f"{outer.indent}}}"])
        told = {id(record) for owner in changing for record, _ in leaves(owner)}
        for n in changed:
            if id(self._kept[n].record) not in told:
                raise ValueError(f"{self._kept[n].place} changes, which `cases` is not told")
            self._renew(self._kept[n])
        found = tuple(
            self.vector(type(part), own)
            if isinstance(part, tuple)
            else self.number_of(own, self._kind(part))
            for own, part in zip(names, given, strict=False)
        )
        return cast("_T", found if isinstance(name, tuple) else found[0] if found else None)

    def _renew(self, kept: Kept) -> None:
        self._dead |= kept.targets()
        self._changed.add(kept.place)
        kept.renewed()

    def write_state(self) -> None:
        """Write what the step has made of its state since it was last written."""
        changed = [kept for kept in self._kept if kept.set_to is not kept.value]
        if changed and self._open is not None and not self._open.uses[0]:
            raise ValueError(f"{self._open.text} changes the state: name it by `let`")
        open_: list[Assignment] = []
        for kept in changed:
            value = kept.set_to
            parts = value if isinstance(value, tuple) else (value,)
            numbers = tuple(expression(part, kept.kind) for part in parts)
            self.take(numbers)
            open_ += assignments(kept.place, value, numbers, kept.value)
        block = Block(self.block.indent, set())
        ordered(open_, block)
        if block.lines:
            self.block.work(block.lines)
        for kept in changed:
            self._renew(kept)

    def _listed(self, kind: str, name: str, parts: Sequence[Expression], meaning: str) -> bool:
        """Whether a vector is too long for a line and has one for each of its parts."""
        begin = f"const {kind} {name} = {{"
        texts = [part.text for part in parts]
        if len(f"{self.block.indent}{begin} {', '.join(texts)} }};") <= WIDTH:
            return False
        listed(self, begin, name, parts, meaning)
        return True

    def _kind(self, value: Any) -> str:
        if isinstance(value, tuple):
            return self.type_name(c_name(type(value)))
        if isinstance(value, Condition):
            return "bool"
        return expression(value, whole_kind(value)).kind

    def _assign(self, name: str, value: Any) -> None:
        """Give a variable its value at the end of a block."""
        single = () if isinstance(value, tuple) else (expression(value, whole_kind(value)),)
        parts = single or numbers_of(value)
        self.take(parts)
        self.block.work([])
        if not isinstance(value, tuple):
            self.block.add(f"{name} = ", parts[0].bare())
        elif text := whole_of(value):
            self.block.add(f"{name} = ", text)
        else:
            for axis, part in zip(kind_fields(value), self._axes(value), strict=True):
                self.block.add(f"{name}.{axis} = ", part.bare())

    def _declare(
        self, kind: str, name: str, text: str, meaning: str, parts: Sequence[Expression]
    ) -> None:
        self.block.take(name)
        self.take(parts)
        self.block.add(f"const {kind} {name} = ", text, meaning)

    def take(self, parts: Sequence[Expression]) -> None:
        """Count the members of records in them as needed.

        Raises:
            ValueError: One of them has been written since it was read.
        """
        for part in parts:
            if part.reads & self._dead:
                raise ValueError(f"{part.text} has changed since it was read: name it by `let`")
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
        name = self.functions.names.get(name, name)
        if name not in self.functions.results:
            self.write(name, function, args)
        changes = self.functions.changes.get(name, [])
        if name in self.functions.filled:
            return cast("_T", self._filling(name, args))
        if not any(changes):
            return cast("_T", self._called(name, args, self.functions.results[name]))
        self.write_state()
        result: Any = self._called(name, args, self.functions.results[name])
        places = {
            members_at(place[0]) + member
            for argument, members in zip(args, changes, strict=True)
            if (place := self._place(argument)) is not None
            for member in members
        }
        for kept in self._kept:
            if kept.place in places:
                self._renew(kept)
        self._open = result[0] if isinstance(result, tuple) else expression(result)
        if self.functions.results[name] is type(None):
            self.block.work(folded("", self._open.bare(), ";", self.block.indent))
            return cast("_T", None)
        return cast("_T", result)

    def _filling(self, name: str, arguments: Sequence[Any]) -> Any:
        """A call that gives variables their values through pointers."""
        kind: Any = self.functions.filled[name]
        parts = [expression(part) for part in arguments]
        self.take(parts)
        for own in kind._fields:
            self.block.take(own)
            self.block.variable("float", own)
        texts = [*(part.bare() for part in parts), *(f"&{own}" for own in kind._fields)]
        self.block.work(folded(f"{self.prefix}_{name}(", ", ".join(texts), ");", self.block.indent))
        return kind(*map(Expression, kind._fields))

    def _called(self, name: str, arguments: Sequence[Any], kind: type[Any] | None) -> Any:
        texts, parts = [], list[Expression]()
        for argument in arguments:
            place = self._place(argument)
            if place is not None:
                texts.append(place[0])
                self.functions.members |= place[1]
                if not any(self.functions.changes.get(name, [])):
                    parts.append(Expression(place[0], reads=self._state_of(place[0])))
            elif isinstance(argument, tuple):
                texts.append(handed_on(argument))
                parts += [expression(part) for part in argument]
            else:
                parts.append(expression(argument, whole_kind(argument)))
                texts.append(parts[-1].bare())
        return self._called_as(name, f"{self.function_name(name)}({', '.join(texts)})", parts, kind)

    def _called_as(
        self,
        name: str,
        text: str,
        parts: Sequence[Expression],
        kind: type[Any] | None,
    ) -> Any:
        """What a call returns."""
        if kind is None or kind is type(None):
            own = self.functions.kinds.get(name, "float")
            result = joined(text, *parts, atom=True, kind=own)
            return Condition((result,)) if own == "bool" else result
        names: tuple[str, ...] = cast("Any", kind)._fields
        found = [joined(f"{text}.{n}", *parts, atom=True, whole=text) for n in names]
        for part in found:
            part.uses, part.size = found[0].uses, len(names)
        return kind(*found)

    def _state_of(self, address: str) -> frozenset[str]:
        """What is read through the address of a record."""
        inside = members_at(address)
        kept = [kept for kept in self._kept if kept.place.startswith(inside)]
        return frozenset[str]().union(*(item.targets() for item in kept))

    def _place(self, value: Any) -> tuple[str, frozenset[Origin]] | None:
        """Address of a record, and the members through which it is reached; None of others."""
        known = [*self._records, *self.functions.constants]
        return next(((text, outer) for own, text, outer in known if own is value), None)

    def write(
        self,
        name: str,
        function: Callable[..., Any],
        arguments: Sequence[Any],
        text: str = "",
        into: Sequence[str] = (),
        names: Sequence[str] = (),
    ) -> None:
        """Write a function.

        Args:
            name: In C, behind the prefix.
            function: Of an arithmetic and the arguments.
            arguments: As of `parameter`.
            text: What is said of it, empty for its own sentence.
            into: Pointers that take the numbers of the result, behind the arguments; none where it
                is returned.
            names: Of the parameters, none where they are those of the function.
        """
        names = names or list(inspect.signature(function).parameters)[1 : len(arguments) + 1]
        inner = self.inside(function, [*names, *into])
        inside = [inner.parameter(n, item) for n, item in zip(names, arguments, strict=True)]
        result = function(inner, *(value for _, value in inside))
        inner.write_state()
        kind, end = inner.returned(result, into)
        changes = [
            frozenset(place[len(n) + 2 :] for place in inner._changed if place.startswith(f"{n}->"))
            for n in names
        ]
        parameters = ", ".join(
            text.removeprefix("const ") if changed else text
            for (text, _), changed in zip(inside, changes, strict=True)
        )
        parameters = ", ".join([parameters, *(f"{inner.pointed} *{pointer}" for pointer in into)])
        said = text or sentence(function)
        body = inner.block.lines
        used = set(re.findall(r"\w+", " ".join([*body, *end])))
        inner.block.first([f"    (void){n};" for n in names if n not in used])
        lines = [
            *(comment(said) if said else []),
            *folded(f"static inline {kind} {self.function_name(name)}(", parameters, ")", ""),
            "{",
            *body,
            *([""] if body and end and (into or inner.block.declared is None) else []),
            *end,
            "}",
        ]
        self.functions.texts[name] = "\n".join(lines)
        none = type(None) if result is None else None
        self.functions.results[name] = type(result) if isinstance(result, tuple) else none
        self.functions.changes[name] = changes
        if into:
            self.functions.filled[name] = type(result)
        if kind not in ("void", "float"):
            self.functions.kinds[name] = kind

    def returned(self, result: Any, into: Sequence[str] = ()) -> tuple[str, list[str]]:
        """Type of what a function returns, and the statements that return it, or put it through
        pointers.
        """
        end = Block(self.block.indent, set())
        if result is None:
            return "void", []
        parts = numbers_of(result) if isinstance(result, tuple) else (expression(result),)
        self.take(parts)
        if into:
            for pointer, part in zip(into, parts, strict=True):
                end.add(f"*{pointer} = ", part.bare())
            return "void", end.lines
        if not isinstance(result, tuple):
            kind = self.result_kind(parts[0])
            end.add("return ", parts[0].to(kind).bare())
            return kind, end.lines
        own = c_name(type(result))
        kind, whole = self.type_name(own), whole_of(result)
        if type(result) not in SHARED:
            self.functions.vectors[own] = type(result)
        if whole:
            end.add("return ", whole)
        else:
            self.block.lines.insert(0, f"{self.block.indent}{kind} result;")
            for n, part in zip(kind_fields(result), self._axes(result), strict=True):
                end.add(f"result.{n} = ", part.bare())
            end.lines.append(f"{self.block.indent}return result;")
        return kind, end.lines

    def parameter(self, name: str, like: Any) -> tuple[str, Any]:
        """Declaration of a parameter, and its value inside of the function.

        Args:
            name: Of the parameter.
            like: An argument: a record, a vector, an array or a number.
        """
        if is_dataclass(like):
            kind = self.type_name(c_name(type(like)))
            return f"const {kind} *{name}", self._record(like, name, f"{name}->", frozenset())
        if isinstance(like, Index):
            return f"{like.kind} {name}", Index(name, kind=like.kind)
        if not isinstance(like, tuple):
            kind = expression(like, whole_kind(like)).kind
            return f"{kind} {name}", name_of(name, kind)
        if hasattr(like, "_fields"):
            kind = self.type_name(c_name(type(like)))
            return f"{kind} {name}", self.vector(type(like), name)
        inside = tuple(Expression(f"{name}[{n}]", whole=name) for n in range(len(like)))
        return f"const float {name}[{len(like)}]", inside

    def _record(self, like: Any, address: str, place: str, outer: frozenset[Origin]) -> Any:
        values, kept = dict[str, Any](), list[tuple[str, str, str]]()
        frozen = like.__dataclass_params__.frozen
        for member in fields(like):
            value = getattr(like, member.name)
            name = f"{place}{member_name(type(like), member.name)}"
            own = outer | {(c_name(type(like)), member.name)}
            kind = self.member_kind(type(like), member.name)
            if is_dataclass(value):
                at = name if is_pointed(type(like), member.name) else f"&{name}"
                values[member.name] = self._record(value, at, members_at(at), own)
            elif frozen and (tables := tables_of(value, name)) is not None:
                values[member.name] = tables
            elif hasattr(value, "_fields"):
                values[member.name] = self.vector(type(value), name, state=True)
            elif isinstance(value, tuple) and hasattr(next(iter(value), 0.0), "_fields"):
                values[member.name] = tuple(
                    state_vector(item, f"{name}[{n}]") for n, item in enumerate(value)
                )
            elif isinstance(value, tuple) and frozen:
                values[member.name] = tuple(
                    Expression(f"{name}[{n}]", members=own, whole=name) for n in range(len(value))
                )
            elif isinstance(value, tuple):
                values[member.name] = state_vector(value, name)
            elif value is not None:
                reads = frozenset({name})
                values[member.name] = self.number_of(name, kind, members=own, reads=reads)
            if not is_dataclass(value) and value is not None:
                kept.append((member.name, name, kind))
        found = replace(like, **values)
        self._records.append((found, address, outer))
        for member_, place_, kind in () if frozen else kept:
            value = values[member_]
            if isinstance(value, tuple) and isinstance(next(iter(value), None), tuple):
                self._kept += [
                    Kept(found, member_, f"{place_}[{n}]", part, at=n)
                    for n, part in enumerate(value)
                ]
            else:
                self._kept.append(Kept(found, member_, place_, value, kind))
        return found

    def either(self, condition: Any, then: Callable[[], _T], otherwise: Callable[[], _T]) -> _T:
        """An if at the end of the step, with its else."""
        outer, found = self.block, []
        text = condition.text()
        for branch in (then, otherwise):
            self.block = outer.inner()
            found.append((self.block, branch()))
        self.block, self.branches = outer, (text, found)
        return found[0][1]
