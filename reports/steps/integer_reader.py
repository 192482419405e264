"""The arithmetic of integers that writes C: the reader of steps in fixed point.

A step is run twice: the first time it only finds what every function is given and returns, from
which its types follow, the second time it writes. Functions of the step are functions of the
firmware by `IntegerReader.call`; those that every header in fixed point has are called there.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Concatenate, ParamSpec, TypeVar, get_type_hints

from dqforge.machines.transforms import Pair
from dqforge.optimizer.fixed_control.codes import rotation
from dqforge.optimizer.fixed_observers.kit import WIDTH, FixedMethod, to_rotor, to_stator
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Range, Ranges, rounded, scaled
from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.steps import integers
from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.integers import CODES, INT32, INT64, UINT32, WORD, Number, holds, made
from dqforge.reports.steps.observer_text import gap
from dqforge.reports.steps.record_text import c_name, comment, said, sentence, struct
from dqforge.reports.steps.symbols import WIDTH as LINE_WIDTH
from dqforge.reports.steps.symbols import folded

_T = TypeVar("_T")
_P = ParamSpec("_P")

# Members of the vectors that every header in fixed point declares.
VECTORS = {"alphabeta": ("alpha", "beta"), "dq": ("d", "q"), "rotation": ("cosine", "sine")}


@dataclass(frozen=True, slots=True)
class _Given:
    """A function that every header in fixed point has: its name, types of its arguments (empty of
    those that it has not), and what it returns: a type of number or a vector.
    """

    name: str
    kinds: tuple[str, ...]
    result: str


_GIVEN: dict[Callable[..., Any], _Given] = {
    rounded: _Given("rounded", (INT64, UINT32), INT64),
    scaled: _Given("scaled", ("gain", INT64), INT64),
    rotation: _Given("rotation", ("", UINT32), "rotation"),
    to_rotor: _Given("park", ("alphabeta", "rotation"), "dq"),
    to_stator: _Given("park_inverse", ("dq", "rotation"), "alphabeta"),
}


@dataclass(slots=True)
class Functions:
    """What steps have needed so far: ``given`` and ``found`` are arguments and results of every
    function, with all their ranges; ``places`` where records lie, by their identity.
    """

    prefix: str
    form: str
    method: FixedMethod
    given: dict[str, list[Any]] = field(default_factory=dict)
    found: dict[str, Any] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    structs: dict[str, list[str]] = field(default_factory=dict)
    places: dict[int, tuple[Any, str]] = field(default_factory=dict)

    def core(self, name: str) -> str:
        """Type of a vector or gain of 32 bits."""
        return f"{self.prefix}_{name}_core_t"

    def own(self, name: str) -> str:
        """Type that only this header has."""
        return f"{self.prefix}_{name}_{self.form}_t"

    def record(self, kind: type[Any]) -> str:
        """Type of a record of gains."""
        if kind is self.method.gains:
            return self.own(f"{self.method.code}_gains")
        return self.own(c_name(kind).removeprefix("fixed_"))


@dataclass(slots=True)
class Lines(Block):
    """Statements whose arguments stand on lines of their own where a line does not hold them."""

    def add(self, begin: str, text: str, meaning: str = "") -> None:
        """A statement, with a comment behind or above it."""
        found = _opened(text) if len(f"{self.indent}{begin}{text};") > LINE_WIDTH else None
        if found is None:
            Block.add(self, begin, text, meaning)
            return
        head, parts, close = found
        if meaning:
            self.lines.append(f"{self.indent}/* {comment_text(meaning)} */")
        self.lines.append(f"{self.indent}{begin}{head}")
        further, end = f"{self.indent}    ", ");" if close == ")" else ""
        line = f"{further}{', '.join(parts)}{end}"
        if end and len(line) <= LINE_WIDTH:
            self.lines.append(line)
            return
        for part in parts[:-1]:
            self.lines += _within_lines(part, ",", further)
        self.lines += _within_lines(parts[-1], end, further)
        self.lines += [] if end else [f"{self.indent}}};"]


def _within_lines(text: str, end: str, indent: str) -> list[str]:
    """Lines of an argument, the further ones indented by more."""
    first, *rest = folded("", text, end, indent)
    return [rest[0][4:], *rest[1:]] if not first.strip() else [first, *rest]


def _opened(text: str) -> tuple[str, list[str], str] | None:
    """What stands before the arguments of the call or initialiser that a text is, these, and what
    closes it.
    """
    begun = re.match(r"\w+\(|\{ ", text)
    if not begun:
        return None
    inner, depth, parts = text[begun.end() :].rstrip(), 0, [""]
    for at, sign in enumerate(inner):
        depth += (sign in "({[") - (sign in ")}]")
        if depth < 0:
            close = sign
            done = at == len(inner) - 1 and len(parts) > 1
            return (begun[0].strip(), [part.strip() for part in parts], close) if done else None
        if sign == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += sign
    return None


# Trees of numbers: numbers, vectors and lists of them, and records.


def _hull(a: Any, b: Any) -> Any:
    """What both are part of."""
    if isinstance(a, Number):
        word = all(x.kind == UINT32 or (x.is_literal and x.range.low >= 0) for x in (a, b))
        kind = UINT32 if word and UINT32 in (a.kind, b.kind) else INT64
        text = "x" if a.is_literal else a.text
        return Number(text, kind, a.range.hull(b.range), whole=a.whole, free=True)
    if isinstance(a, tuple | list):
        parts = [_hull(x, y) for x, y in zip(a, b, strict=True)]
        return type(a)(*parts) if hasattr(a, "_fields") else type(a)(parts)
    if is_dataclass(a):
        names = [f.name for f in fields(a)]
        return replace(a, **{n: _hull(getattr(a, n), getattr(b, n)) for n in names})  # type: ignore[type-var]
    return a


def _kind(tree: Number) -> str:
    """The smallest type of a parameter, result or local."""
    if tree.kind == UINT32:
        return UINT32
    return INT32 if holds(CODES, tree.range) else INT64


class IntegerReader:
    """Writes what a step in integers computes into ``block``.

    Args:
        functions: Takes what `call` writes.
        block: Where the statements go.
        dry: Whether only ranges are wanted.
        noting: Whether arguments and results of functions count for their types.
    """

    def __init__(
        self, functions: Functions, block: Block, *, dry: bool, noting: bool = False
    ) -> None:
        self.functions, self.block, self.dry, self.noting = functions, block, dry, noting
        self.branches: tuple[str, list[tuple[Block, Any]]] | None = None
        self._ranges = Ranges(WIDTH)

    def _made(
        self, text: str, kind: str, range_: Range, parts: Sequence[Number], *, atom: bool = False
    ) -> Number:
        return self._kept(made(text, kind, range_, parts, atom=atom))

    def _kept(self, a: Number) -> Number:
        """Without text a number may be used as often as one likes."""
        if self.dry:
            a.free = True
        return a

    def const(self, value: Any) -> Number:
        """A constant, or a member of a record."""
        return integers.number(value)

    def product(self, _: str, a: Number, b: Number) -> Number:
        """The product a b."""
        return self._kept(integers.product(a, b))

    def total(self, _: str, *terms: Number) -> Number:
        """The sum."""
        return self._kept(integers.total(*terms))

    def negative(self, a: Number) -> Number:
        """The number -a."""
        return self._kept(integers.negated(a))

    def shifted(self, a: Number, bits: Any) -> Number:
        """An arithmetic right shift."""
        by = integers.number(bits)
        if by.is_literal and by.range.low == 0:
            return a
        corners = [
            x >> y for x in (a.range.low, a.range.high) for y in (by.range.low, by.range.high)
        ]
        text = f"{a.written(a.kind, operand=True)} >> {by.written(UINT32, operand=True)}"
        return self._made(text, a.kind, Range(min(corners), max(corners)), (a, by))

    def shifted_by(self, a: Number, bits: Number) -> Number:
        """A right shift by a number of bits that is computed."""
        return self.shifted(a, bits)

    def halvings(self, _: str, a: Number, most: int) -> Number:
        """How often a must be halved until it is at most ``most``."""
        found = self._ranges.halvings("", a.range, most)
        limit = integers.literal(most)
        text = f"{self._core('halvings')}({a.written(INT64)}, {limit.text})"
        return self._made(text, UINT32, found, (a,), atom=True)

    def known(self, a: Number, low: int, high: int) -> Number:
        """The number, which is known to lie there."""
        return self._kept(integers.narrowed(a, low, high))

    def clamp(self, a: Number, low: Any, high: Any) -> Number:
        """The number nearest to a from low to high, of which one may be open."""
        least = integers.number(a.range.low if low is None else low)
        most = integers.number(a.range.high if high is None else high)
        found = Range(
            min(max(a.range.low, least.range.low), most.range.low),
            min(max(a.range.high, least.range.high), most.range.high),
        )
        below, above = a.range.low < least.range.high, a.range.high > most.range.low
        if not (below or above):
            return a
        symmetric = least.inner is most or (
            least.is_literal and most.is_literal and least.range.low == -most.range.low
        )
        if below and above and symmetric:
            text = f"{self._core('within')}({a.written(INT64)}, {most.written(INT64)})"
            return self._made(text, INT64, found, (a, most), atom=True)
        if below and above:
            held = self.clamp(a, least, 2**63 - 1)
            condition = f"{self._side(a, most)} > {self._side(most, a)}"
            return self._chosen(condition, most, held, found, (most, a, held))
        limit, sign = (least, "<") if below else (most, ">")
        condition = f"{self._side(a, limit)} {sign} {self._side(limit, a)}"
        return self._chosen(condition, limit, a, found, (limit, a, a))

    def _side(self, a: Number, other: Number) -> str:
        """A number as it stands in a comparison with another one."""
        both = UINT32 if a.kind == other.kind == UINT32 else INT64
        return a.written(a.kind if UINT32 not in (a.kind, other.kind) else both, operand=True)

    def _chosen(
        self, condition: str, a: Number, b: Number, found: Range, used: Sequence[Number]
    ) -> Number:
        narrow = all(x.kind == INT32 or (x.is_literal and holds(CODES, x.range)) for x in (a, b))
        kind = INT32 if narrow else INT64
        texts = [x.written(kind) for x in (a, b)]
        parts = [
            t if x.atom or t[0] == "-" else f"({t})" for x, t in zip((a, b), texts, strict=True)
        ]
        return self._made(f"({condition}) ? {' : '.join(parts)}", kind, found, used)

    def within(self, a: Number, limit: Number) -> Number:
        """The number nearest to a from -limit to limit."""
        found = self._ranges.within(a.range, limit.range)
        text = f"{self._core('within')}({a.written(INT64)}, {limit.written(INT64)})"
        return self._made(text, INT64, found, (a, limit), atom=True)

    def quotient(self, _: str, a: Number, b: Number) -> Number:
        """Quotient towards zero."""
        found = self._ranges.quotient("", a.range, b.range)
        if holds(CODES, a.range) and holds(CODES, b.range):
            text = " / ".join(part.written(INT32, operand=True) for part in (a, b))
            return self._made(text, INT32, found, (a, b))
        return self._made(" / ".join(integers.wide_operands([a, b])), INT64, found, (a, b))

    def root(self, a: Number) -> Number:
        """Largest integer whose square is not above a, which fits uint32_t."""
        assert holds(WORD, a.range)
        text = f"{self._core('word_root')}({a.written(UINT32)})"
        return self._made(text, INT32, self._ranges.root(a.range), (a,), atom=True)

    def wrapped(self, a: Number, bits: Any) -> Number:
        """The remainder by 2^bits."""
        by = integers.number(bits)
        if by.range == Range(WIDTH, WIDTH):
            found = a.range if holds(WORD, a.range) else WORD
            atom = UINT32 not in a.others and (a.kind != UINT32 or a.atom)
            return self._made(a.written(UINT32), UINT32, found, (a,), atom=atom)
        top = (1 << by.range.high) - 1
        mask = str(top) if by.is_literal else f"(((int64_t)1 << {by.text}) - 1)"
        text = f"{a.written(a.kind, operand=True)} & {mask}"
        return self._made(text, a.kind, Range(0, top), (a,))

    def at_least(self, a: Number, b: Number) -> _Condition:
        """Condition that a >= b."""
        text = f"{self._side(a, b)} >= {self._side(b, a)}"
        if a.is_literal:
            text = f"{self._side(b, a)} <= {self._side(a, b)}"
        return _Condition(text, (a, b), self._ranges.at_least(a.range, b.range))

    def has_bit(self, a: Number, bit: int) -> _Condition:
        """Condition that a number has a bit."""
        text = f"({a.written(UINT32, operand=True)} & {bit}U) != 0U"
        return _Condition(text, (a,), self._ranges.has_bit(a.range, bit))

    def every(self, *conditions: _Condition) -> _Condition:
        """Condition that all hold."""
        decided = self._ranges.every(*(each.decided for each in conditions))
        open_ = [each for each in conditions if each.decided is None]
        text = " && ".join(f"({each.text})" for each in open_)
        return _Condition(text, tuple(part for each in open_ for part in each.parts), decided)

    def either(
        self, condition: _Condition, then: Callable[[], _T], otherwise: Callable[[], _T]
    ) -> _T:
        """An if at the end of the step, with its else."""
        outer, found = self.block, list[tuple[Block, Any]]()
        for part in condition.parts:
            part.bare()
        for branch in (then, otherwise):
            self.block = Lines(outer.indent + "    ", set(outer.names))
            found.append((self.block, branch()))
        self.block, self.branches = outer, (condition.text, found)
        result: _T = found[0][1]
        return result

    def cases(
        self,
        name: str | tuple[str, ...],  # noqa: ARG002
        *branches: tuple[_Condition, Callable[[], _T]],
        otherwise: Callable[[], _T],
    ) -> _T:
        """What all branches return; only in functions whose text every header has."""
        assert self.dry, "observers have no branch amid a step"
        found: Any = otherwise()
        for _, branch in reversed(branches):
            found = _hull(branch(), found)
        return found  # type: ignore[no-any-return]

    def choose(self, condition: _Condition, a: Number, b: Number) -> Number:
        """A conditional expression, where ranges do not decide it."""
        if condition.decided is not None:
            return a if condition.decided else b
        used = (*condition.parts, a, b)
        return self._chosen(condition.text, a, b, a.range.hull(b.range), used)

    def _core(self, name: str) -> str:
        return f"{self.functions.prefix}_{name}_core"

    def remark(self, text: str) -> None:
        """A comment on a line of its own."""
        self.block.lines.append(f"{self.block.indent}/* {comment_text(text)} */")

    def let(self, name: str, value: _T, meaning: str = "") -> _T:
        """A constant of the block, or one for every number of a list."""
        found: _T = value if self.dry else self._named(name, value, meaning)
        return found

    def _named(self, name: str, value: Any, meaning: str) -> Any:
        if isinstance(value, list):
            return [self._named(f"{name}_{n}", part, "") for n, part in enumerate(value)]
        if isinstance(value, Number):
            if value.is_literal:
                return value
            kind = _kind(value)
            self._declare(kind, name, value.written(kind), meaning, [value])
            return Number(name, kind, value.range, free=True)
        assert isinstance(value, tuple)
        kind, names = self._vector(value)
        whole = whole_of(value)
        if kind and whole:
            self._declare(kind, name, whole, meaning, value[:1])
        elif kind and all(holds(CODES, part.range) for part in value):
            text = ", ".join(part.written(INT32) for part in value)
            self._declare(kind, name, f"{{ {text} }}", meaning, value)
        else:
            parts = zip(names, value, strict=True)
            return type(value)(*(self._named(f"{name}_{n}", part, "") for n, part in parts))
        return self.members(type(value), name, names, value, whole=name)

    def _vector(self, value: Any) -> tuple[str, tuple[str, ...]]:
        """Type of a vector, and names of its members."""
        if whole_of(value):
            names = tuple(part.text.rsplit(".", 1)[1] for part in value)
            return self._struct(type(value), names, value), names
        if isinstance(value, Pair):
            name = "dq" if isinstance(value, Dq) else "alphabeta"
            return self.functions.core(name), VECTORS[name]
        return "", value._fields

    def _struct(self, kind: type[Any], names: tuple[str, ...], value: Sequence[Number]) -> str:
        if issubclass(kind, Pair):
            if any(_kind(part) == INT64 for part in value):
                return self.functions.own("wide")
            return self.functions.core(next(k for k, own in VECTORS.items() if own == names))
        return self.functions.own(c_name(kind))

    def members(
        self, kind: type[Any], place: str, names: Sequence[str], like: Any, *, whole: str
    ) -> Any:
        """The vector at a place."""
        return kind(
            *(
                Number(f"{place}.{n}", _kind(part), part.range, free=True, whole=whole)
                for n, part in zip(names, like, strict=True)
            )
        )

    def _declare(
        self, kind: str, name: str, text: str, meaning: str, parts: Sequence[Number]
    ) -> None:
        if name in self.block.names:
            raise ValueError(f"there is a {name} already")
        self.block.names.add(name)
        for part in parts:
            part.bare()
        self.block.add(f"const {kind} {name} = ", text, meaning)

    def call(
        self,
        function: Callable[Concatenate[Any, _P], _T],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _T:
        """A call; the first one writes the function."""
        assert not kwargs, "arguments of a function of the firmware have their places"
        noting = self.dry and self.noting
        inner = IntegerReader(self.functions, Block("", set()), dry=True, noting=noting)
        run: Callable[..., Any] = function
        result = run(inner, *map(_ranged, args))
        name = function.__name__.lstrip("_")
        if function in _GIVEN:
            return self._given(_GIVEN[function], args, result)  # type: ignore[no-any-return]
        numbers = [_tree(item) for item in args if not isinstance(item, str)]
        if noting:
            self._note(name, numbers, result)
        if self.dry:
            return result  # type: ignore[no-any-return]
        if name not in self.functions.texts:
            self._write(name, function)
        kinds = self.functions.given[name]
        texts, parts = self._arguments(numbers, kinds)
        text = f"{self.functions.prefix}_{name}_{self.functions.form}({', '.join(texts)})"
        return self._result(text, result, self.functions.found[name], parts)  # type: ignore[no-any-return]

    def _note(self, name: str, numbers: list[Any], result: Any) -> None:
        known = self.functions
        before = known.given.get(name)
        known.given[name] = numbers if before is None else _hull(before, numbers)
        known.found[name] = _hull(known.found.get(name, result), result)

    def _given(self, own: _Given, args: Sequence[Any], result: Any) -> Any:
        if self.dry:
            names = VECTORS.get(own.result)
            return (
                result if not names else self.members(type(result), "y", names, result, whole="y")
            )
        texts, parts = list[str](), list[Number]()
        numbers = [item for item in args if not isinstance(item, str)]
        for kind, item in zip(own.kinds, numbers, strict=True):
            if kind == "gain":
                texts.append(self.functions.places[id(item)][1])
            elif kind in VECTORS:
                texts.append(self._handed_on(item))
                parts += item[:1]
            elif kind:
                part = integers.number(item)
                texts.append(part.written(kind))
                parts.append(part)
        text = f"{self._core(own.name)}({', '.join(texts)})"
        if own.result in VECTORS:
            names = VECTORS[own.result]
            like = [Number("", INT32, part.range) for part in result]
            return self._parts(type(result), text, names, like, parts)
        return self._made(text, own.result, result.range, parts, atom=True)

    def _result(self, text: str, now: Any, ever: Any, parts: Sequence[Number]) -> Any:
        """What a call returns; ``now`` has its ranges, ``ever`` those of all calls."""
        if isinstance(now, Number):
            return self._made(text, _kind(ever), now.range, parts, atom=True)
        _, names = self._vector(_unplaced(ever))
        like = [Number("", _kind(b), a.range) for a, b in zip(now, ever, strict=True)]
        return self._parts(type(now), text, names, like, parts)

    def _parts(
        self,
        kind: type[Any],
        text: str,
        names: Sequence[str],
        like: Sequence[Number],
        used: Sequence[Number],
    ) -> Any:
        for part in used:
            part.bare()
        reads = frozenset[str]().union(*(part.reads for part in used))
        found = [
            Number(f"{text}.{n}", part.kind, part.range, reads=reads, whole=text)
            for n, part in zip(names, like, strict=True)
        ]
        for part in found:
            part.uses = found[0].uses
        return kind(*found)

    def _arguments(
        self, numbers: Sequence[Any], kinds: Sequence[Any]
    ) -> tuple[list[str], list[Number]]:
        texts, parts = list[str](), list[Number]()
        for item, like in zip(numbers, kinds, strict=True):
            if isinstance(item, Number):
                texts.append(item.written(_kind(like)))
                parts.append(item)
            elif is_dataclass(item):
                place = self.functions.places[id(item)][1]
                by_value = isinstance(item, FixedGain) or ("->" not in place and "." not in place)
                texts.append(place if by_value else f"&{place}")
            else:
                texts.append(self._handed_on(item))
                parts += item[:1]
        return texts, parts

    def _handed_on(self, value: Any) -> str:
        text = whole_of(value)
        if not text:
            raise ValueError("a vector is handed on by its name: name it by `let`")
        return text

    def _write(self, name: str, function: Callable[..., Any]) -> None:
        parameters = inspect.signature(function).parameters
        hints = [n for n, own in list(parameters.items())[1:] if own.annotation != "str"]
        inner = IntegerReader(self.functions, Lines("    ", set(hints)), dry=False)
        pairs = zip(hints, self.functions.given[name], strict=True)
        inside = [inner.parameter(n, like) for n, like in pairs]
        values = iter([value for _, value in inside])
        words = [
            "" if own.annotation == "str" else next(values) for own in list(parameters.values())[1:]
        ]
        result = function(inner, *words)
        ever, body, end = self.functions.found[name], inner.block.lines, Lines("    ", set())
        if isinstance(result, Number):
            kind = _kind(ever)
            end.add("return ", result.written(kind))
            result.bare()
        else:
            plain = _unplaced(ever)
            _, names = self._vector(plain)
            kind = self._struct(type(result), names, ever)
            self._declare_struct(type(result), kind, names, ever)
            whole = whole_of(result)
            if whole:
                result[0].bare()
                end.add("return ", whole)
            else:
                body.append(f"    {kind} result;")
                for n, part, like in zip(names, result, ever, strict=True):
                    end.add(f"result.{n} = ", part.written(_kind(like)))
                    part.bare()
                end.lines.append("    return result;")
        head = f"static inline {kind} {self.functions.prefix}_{name}_{self.functions.form}("
        lines = [
            *comment(sentence(function)),
            *folded(head, ", ".join(text for text, _ in inside), ")", ""),
            "{",
            *body,
            *gap(body),
            *end.lines,
            "}",
        ]
        self.functions.texts[name] = "\n".join(lines)

    def _declare_struct(
        self, kind: type[Any], name: str, names: Sequence[str], like: Sequence[Number]
    ) -> None:
        if name.endswith("_core_t") or name in self.functions.structs:
            return
        if issubclass(kind, Pair):
            text, says = "A vector before it is saturated.", [""] * len(names)
        else:
            text, says = sentence(kind), [said(kind, n) for n in names]
        own = [(f"{_kind(part)} {n}", s) for n, part, s in zip(names, like, says, strict=True)]
        if issubclass(kind, Pair):
            own = [(f"int64_t {n}", "") for n in names]
        self.functions.structs[name] = [*comment(text), *struct(name, own)]

    def parameter(self, name: str, like: Any) -> tuple[str, Any]:
        """Declaration of a parameter, and its value inside of the function."""
        if isinstance(like, Number):
            kind = _kind(like)
            return f"{kind} {name}", Number(name, kind, like.range, free=True)
        if isinstance(like, FixedGain):
            kind = self.functions.core("gain")
            return f"{kind} {name}", record(self.functions, like, name, f"{name}.")
        if is_dataclass(like):
            kind = self.functions.record(type(like))
            return f"const {kind} *{name}", record(self.functions, like, name, f"{name}->")
        if hasattr(like, "_fields"):
            _, names = self._vector(like)
            kind = self._struct(type(like), names, like)
            return f"{kind} {name}", self.members(type(like), name, names, like, whole=name)
        inside = tuple(
            Number(f"{name}[{n}]", INT32, part.range, free=True, whole=name)
            for n, part in enumerate(like)
        )
        return f"const int32_t {name}[{len(like)}]", inside


def _ranged(value: Any) -> Any:
    """An argument whose text does not matter."""
    if isinstance(value, Number):
        own = value
        return Number(own.text, own.kind, own.range, free=True, whole=own.whole, inner=own.inner)
    if isinstance(value, Pair):
        return type(value)(*map(_ranged, value))
    return value


def _unplaced(value: Any) -> Any:
    """A vector of numbers without text."""
    return type(value)(*(Number("", _kind(part), part.range) for part in value))


def _tree(value: Any) -> Any:
    """An argument: constants of Python count bits."""
    return integers.literal(value, UINT32) if isinstance(value, int) else value


@dataclass(frozen=True, slots=True)
class _Condition:
    """A comparison, and whether ranges decide it."""

    text: str
    parts: tuple[Number, ...]
    decided: bool | None


def whole_of(value: Any) -> str:
    """The vector or array whose parts these are, in their order; else nothing."""
    places = {part.whole for part in value if isinstance(part, Number)}
    if len(places) != 1 or places == {""}:
        return ""
    (place,) = places
    named: list[tuple[str, ...]]
    if isinstance(value, Dq):
        named = [VECTORS["dq"]]
    elif isinstance(value, Pair):
        named = [VECTORS["alphabeta"], VECTORS["rotation"]]
    else:
        named = [getattr(value, "_fields", ())]
    texts = [getattr(part, "text", "") for part in value]
    wanted = [[f"{place}.{n}" for n in names] for names in named]
    return place if texts in [*wanted, [f"{place}[{n}]" for n in range(len(value))]] else ""


# Records of gains.


def member_type(kind: type[Any], name: str) -> str:
    """Type of a member that is an integer."""
    hint = get_type_hints(kind, include_extras=True)[name]
    return next(
        (item for item in getattr(hint, "__metadata__", ()) if isinstance(item, str)), INT32
    )


def _member(kind: type[Any], name: str, text: str, value: Any) -> Number:
    if isinstance(value, Number):
        return Number(text, value.kind, value.range, free=True)
    own = UINT32 if kind is FixedGain and name == "shift" else member_type(kind, name)
    return Number(text, own, Range(value, value), free=True)


def record(functions: Functions, like: Any, place: str, begin: str) -> Any:
    """A record whose members are text; it and those in it are kept in ``functions``."""
    values: dict[str, Any] = {}
    for member in fields(like):
        name, value = f"{begin}{member.name}", getattr(like, member.name)
        if is_dataclass(value):
            values[member.name] = record(functions, value, name, f"{name}.")
        elif isinstance(value, tuple):
            values[member.name] = _array(name, value)
        elif isinstance(value, float):
            values[member.name] = value
        else:
            values[member.name] = _member(type(like), member.name, name, value)
    found = replace(like, **values)
    functions.places[id(found)] = (found, place)
    return found


def _array(name: str, values: tuple[Any, ...]) -> tuple[Any, ...]:
    if isinstance(values[0], tuple):
        return tuple(_array(f"{name}[{n}]", row) for n, row in enumerate(values))
    return tuple(
        Number(
            f"{name}[{n}]",
            INT32,
            getattr(item, "range", Range(item, item))
            if not isinstance(item, Number)
            else item.range,
            free=True,
            whole=name,
        )
        for n, item in enumerate(values)
    )
