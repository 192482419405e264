"""C of steps in codes of one word, 16 or 32 bits: every operator computes in words of twice as
many, so that a text needs no ranges.

Vectors and members of records are codes; what a function is given and returns is a wide word unless
its annotation says otherwise (`dqforge.optimizer.steps.code_vectors`).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Concatenate, ParamSpec, TypeVar, cast, get_type_hints

from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import (
    CODE,
    COUNT,
    FEW,
    TURN,
    WIDE,
    Gain,
)
from dqforge.optimizer.steps.integer_arithmetic import rounded, saturated
from dqforge.reports.c_code.numbers import int32_literal, int64_literal
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.code_arrays import (
    Call,
    Entries,
    Filled,
    axes_of,
    elements,
    filled_by,
    is_array,
    is_record,
    items_of,
    numbers_at,
    put_into,
    record_at,
    sizes,
    tables,
    taking,
    word_of,
    words_of,
)
from dqforge.reports.steps.counted_loops import Table, filled
from dqforge.reports.steps.integers import CODES
from dqforge.reports.steps.record_text import c_name
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Condition, Expression, Origin, folded

_T = TypeVar("_T")
_P = ParamSpec("_P")

# Operations of the arithmetic that C has no operator for: functions of the header. The conversion
# of a code keeps its low bits, on every compiler for these cores.
_OPERATIONS = {
    "saturated": CODE,
    "within": WIDE,
    "root": WIDE,
}


_COLUMNS = 12  # Of a table.
_WORD = "int32_t"

# Types whose names are not those of their classes.
_NAMES = {"alpha_beta": "alphabeta", "fixed_decoupling": "decoupling_gains"}


@dataclass(frozen=True, slots=True)
class Words:
    """Types in C of codes of so many bits."""

    width: int

    def of(self, word: str) -> str:
        """Type of a code, a wide word, an angle or a count."""
        types = {
            CODE: f"int{self.width}_t",
            WIDE: f"int{2 * self.width}_t",
            TURN: f"uint{self.width}_t",
            COUNT: "uint32_t",
            FEW: "uint8_t",
            "mantissa": "int32_t",
        }
        return types[word]

    @property
    def wide(self) -> str:
        """Type in which operators compute."""
        return self.of(WIDE)


@dataclass(slots=True)
class CodeFunctions(Functions):
    """Functions and their types: ``argument_kinds``, and ``returned``; ``arrays`` are those that
    functions fill.
    """

    argument_kinds: dict[str, list[str]] = field(default_factory=dict)
    returned: dict[str, str] = field(default_factory=dict)
    arrays: dict[str, Filled] = field(default_factory=dict)

    def take(self, known: CodeFunctions) -> None:
        """Take functions over whose texts stand before."""
        for part in ("results", "changes", "kinds", "argument_kinds", "returned", "arrays"):
            getattr(self, part).update(getattr(known, part))


class Code(Expression):
    """A number in codes, as text; ``value`` of a constant, else None, ``free`` if it may be
    written twice, as a comparison of names, and ``narrow`` its text in words of 32 bits, empty
    where that is another number.
    """

    __slots__ = ("free", "narrow", "value")

    def __init__(
        self, text: str, *, value: int | None = None, free: bool = False, **more: Any
    ) -> None:
        super().__init__(text, **more)
        self.value, self.free, self.narrow = value, free, ""

    @property
    def is_name(self) -> bool:
        """Whether it may be written twice."""
        return self.value is not None or self.free or super().is_name

    def to(self, kind: str) -> Expression:
        """With the conversion to a narrower type, or to another sign."""
        if self.kind == kind or (kind.startswith("int") and _bits(kind) > _bits(self.kind)):
            return self
        if self.value is not None:
            return Code(f"{self.value}U" if kind[0] == "u" else self.text, value=self.value)
        return _made(f"({kind}){self.text if self.atom else f'({self.text})'}", kind, self)

    def negative(self) -> Expression:
        """The negative of a wide number."""
        if self.value is not None:
            return constant(-self.value, self.kind)
        if self.minus is not None:
            return self.minus
        found = _made(f"-{self.text if self.atom else f'({self.text})'}", self.kind, self)
        found.minus = self
        if not self.is_name:
            found.uses = self.uses
        return found

    def __rlshift__(self, factor: int) -> Code:
        """A number times a power of two, as wide as an operator computes."""
        return _Power(factor, self)


class Word(Code):
    """A number in a word of 32 bits."""

    __slots__ = ()


class _Power(Code):
    """factor 2^bits or half of it, whose type is that of what it is added to."""

    __slots__ = ("bits", "factor", "lowered")

    def __init__(self, factor: int, bits: Code, lowered: int = 0) -> None:
        super().__init__(bits.text, kind=bits.kind, reads=bits.reads)
        self.factor, self.bits, self.lowered, self.uses = factor, bits, lowered, bits.uses

    def __rshift__(self, bits: int) -> Code:
        """A smaller number; 0 where it is below 1."""
        return _Power(self.factor, self.bits, self.lowered + bits)


def gain_text(gain: FixedGain) -> str:
    """An initialiser of a gain."""
    half = int64_literal(gain.half) if gain.shift > 31 else int32_literal(gain.half)
    return f"{{ {int32_literal(gain.mantissa)}, {gain.shift}U, {half} }}"


def _bits(kind: str) -> int:
    return int(kind.strip("uint_"))


def _made(text: str, kind: str, *parts: Expression, atom: bool = False) -> Code:
    """A number made of others."""
    return Code(
        text,
        kind=kind,
        atom=atom,
        reads=frozenset[str]().union(*(part.reads for part in parts)),
        members=frozenset[Origin]().union(*(part.members for part in parts)),
    )


def constant(value: int, kind: str) -> Code:
    """A constant, no wider than it needs."""
    if kind[:1] == "u":
        return Code(f"{value}U", value=int(value), kind=kind)
    narrow = CODES.low <= value <= CODES.high
    text = int32_literal(value) if narrow else int64_literal(value)
    return Code(text, value=int(value), kind=kind)


class CodeReader(StepReader):
    """Writes what a step in codes computes into ``block``.

    Args:
        prefix, form: Before and behind every name of a function or record.
        words: Types of the numbers.
        functions: Takes what `call` writes.
        block: Where the statements go.
        hints: Annotations of parameters and result, by name.
    """

    def __init__(
        self,
        prefix: str,
        form: str,
        words: Words,
        functions: CodeFunctions,
        block: Block,
        hints: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(prefix, functions, block)
        self.form, self.words, self.hints = form, words, hints or {}
        self.known_functions, self.counted, self.pointed = functions, words.wide, words.of(CODE)
        self.array = filled_by(self.hints.get("return"))  # that the function fills
        self.inner = self  # of the function that was written last

    # Names and types.

    def type_name(self, name: str) -> str:
        """Name of a type with its format."""
        return f"{self.prefix}_{_NAMES.get(name, name)}_{self.form}_t"

    def function_name(self, name: str) -> str:
        """Name of a function with its format."""
        return f"{self.prefix}_{name}_{self.form}"

    def axis_kinds(self, kind: type[Any]) -> list[str]:
        """Types of the parts of a vector."""
        return [self.words.of(word) for word in words_of(kind)]

    def vector(self, kind: type[Any], name: str, *, state: bool = False) -> Any:
        """A vector by its name in C."""
        return self._parts_of(kind, name, state=state)

    def _parts_of(self, kind: type[Any], place: str, *, state: bool = False) -> Any:
        texts = [f"{place}.{axis}" for axis in axes_of(kind)]
        return kind(
            *(
                Code(text, kind=own, reads=frozenset({text} if state else ()), whole=place)
                for text, own in zip(texts, self.axis_kinds(kind), strict=True)
            )
        )

    def type_of(self, kind: type[Any]) -> str:
        """Name of the type of a record or vector."""
        return self.type_name(c_name(kind))

    def inside(self, function: Callable[..., Any], names: Sequence[str]) -> CodeReader:
        """The reader of a function."""
        hints = get_type_hints(getattr(function, "text", function), include_extras=True)
        block, functions = Block("    ", set(names)), self.known_functions
        self.inner = CodeReader(self.prefix, self.form, self.words, functions, block, hints)
        return self.inner

    def member_kind(self, kind: type[Any], name: str) -> str:
        """Type of a member of a record."""
        return self.words.of(word_of(get_type_hints(kind, include_extras=True)[name]))

    def number_of(self, name: str, kind: str, **more: Any) -> Expression:
        """A number by its name."""
        return Code(name, kind=kind, **more)

    def _named(self, name: str, value: Any, meaning: str) -> Any:
        """A constant of the block; a gain is an initialiser, an array what a call fills."""
        if isinstance(value, Call):
            return value.into(self, name)
        if isinstance(value, FixedGain):
            self.block.take(name)
            self.block.add(f"const {self.type_of(Gain)} {name} = ", gain_text(value), meaning)
            return self.vector(Gain, name)
        if is_array(value):
            self.block.take(name)
            self.take(value)
            text = ", ".join(part.bare() for part in value)
            begin = f"const {self.words.wide} {name}[{len(value)}] = "
            self.block.add(begin, f"{{ {text} }}", meaning)
            return items_of(self, name, Filled(name, len(value), None))
        return super()._named(name, value, meaning)

    def result_kind(self, value: Expression) -> str:  # noqa: ARG002
        """Type that the function says it returns."""
        return self.words.of(word_of(self.hints.get("return")))

    def parameter(self, name: str, like: Any) -> tuple[str, Any]:
        """Declaration of a parameter, and its value inside of the function."""
        if isinstance(like, FixedGain | Gain):
            return f"{self.type_name('gain')} {name}", self.vector(Gain, name)
        if isinstance(like, Filled):
            own = self.counted if like.kind is None else self.type_of(like.kind)
            return f"{own} {name}[{like.count}]", None
        if is_record(like):
            return f"const {self.counted} {name}{sizes(like)}", self._record_at(like, name)
        if is_array(like):
            inside = items_of(self, name, Filled(name, len(like), None))
            return f"const {self.counted} {name}[{len(like)}]", inside
        if isinstance(like, tuple) or hasattr(like, "__dataclass_fields__"):
            return super().parameter(name, like)
        kind = self.words.of(word_of(self.hints.get(name)))
        return f"{kind} {name}", Code(name, kind=kind)

    def _record(self, like: Any, address: str, place: str, outer: frozenset[Origin]) -> Any:
        """A record; its gains are vectors, which are given by value, numbers of its arrays are
        followed one by one; of some records others have the address.
        """
        if getattr(like, "POINTED", False) and address[0] == "&":
            address, place = address[1:], f"{address[1:]}->"
        gains = [m.name for m in fields(like) if isinstance(getattr(like, m.name), FixedGain)]
        arrays = {m.name: getattr(like, m.name) for m in fields(like)}
        arrays = {name: value for name, value in arrays.items() if is_array(value)}
        found = super()._record(replace(like, **dict.fromkeys(arrays)), address, place, outer)
        for name in gains:
            object.__setattr__(found, name, self.vector(Gain, f"{place}{name}"))
        for name, value in arrays.items():
            text, kind = f"{place}{name}", self.member_kind(type(like), name)
            if like.__dataclass_params__.frozen:
                object.__setattr__(found, name, tables(value, text, kind))
            elif any(map(is_record, value)):
                items = (self._record_at(item, f"{text}[{n}]") for n, item in enumerate(value))
                object.__setattr__(found, name, tuple(items))
            else:
                numbers = numbers_at(self, len(value), text, kind)
                object.__setattr__(found, name, numbers)
                self._kept += elements(found, name, numbers)
        return found

    def _record_at(self, like: Any, text: str) -> Any:
        """A record that is an array in C."""
        found, kept = record_at(self, like, text)
        self._records.append((found, text, frozenset()))
        self._kept += kept
        return found

    def _kind(self, value: Any) -> str:
        """A variable that branches give its value is wide, or a count, or a word of 32 bits."""
        if isinstance(value, tuple):
            return super()._kind(value)
        if isinstance(value, Word):
            return _WORD
        return self.words.wide if value.kind[0] != "u" else cast("str", value.kind)

    # Calls.

    def call(
        self,
        function: Callable[Concatenate[Any, _P], _T],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _T:
        """A call; names of quantities and the bits of a code are no arguments of the firmware."""
        assert not kwargs, "arguments of a function of the firmware have their places"
        own, left = self.fixed(function, args)
        if function is saturated:
            if left[0].kind == self.words.of(CODE):
                return cast("_T", left[0])
            return cast("_T", self._called("saturated", left, None))
        found = super().call(own, *left)
        for item, changes in zip(left, self.functions.changes[own.__name__], strict=False):
            for kept in self._kept if changes and is_record(item) else ():
                if kept.record is item:
                    self._renew(kept)
        return cast("_T", found)

    def write(
        self,
        name: str,
        function: Callable[..., Any],
        arguments: Sequence[Any],
        text: str = "",
        into: Sequence[str] = (),
        names: Sequence[str] = (),
    ) -> None:
        """Write a function, with what its annotations say of types."""
        hints = get_type_hints(getattr(function, "text", function), include_extras=True)
        own = list(inspect.signature(function).parameters)[1:]
        functions = self.known_functions
        functions.argument_kinds[name] = [self.words.of(word_of(hints.get(n))) for n in own]
        functions.returned[name] = self.words.of(word_of(hints.get("return")))
        array = filled_by(hints.get("return"))
        if array is not None:
            functions.arrays[name] = array
            function, arguments = taking(function, array), [*arguments, array]
        super().write(name, function, arguments, text, into, names)
        for n, (own_name, item) in enumerate(zip(own, arguments, strict=False)):
            if is_record(item) and any(x.startswith(f"{own_name}[") for x in self.inner._changed):
                functions.changes[name][n] = frozenset({own_name})
                given, found = f"{self.counted} {own_name}[", functions.texts[name]
                functions.texts[name] = found.replace(f"const {given}", given, 1)

    def returned(self, result: Any, into: Sequence[str] = ()) -> tuple[str, list[str]]:
        """Type of what a function returns, and the statements that return it or fill an array."""
        if into:
            result = type(result)(*(part.to(self.pointed) for part in result))
        if self.array is None:
            return super().returned(result, into)
        end = Block(self.block.indent, set())
        self.take(put_into(self.array, result, end))
        return "void", end.lines

    def _called(self, name: str, arguments: Sequence[Any], kind: type[Any] | None) -> Any:
        kinds = self.known_functions.argument_kinds.get(name, [self.words.wide] * len(arguments))
        given = [
            (constant(item, own) if isinstance(item, int) else item).to(own)
            if isinstance(item, int | Code)
            else item
            for item, own in zip(arguments, kinds, strict=True)
        ]
        return super()._called(name, given, kind)

    def _called_as(
        self, name: str, text: str, parts: Sequence[Expression], kind: type[Any] | None
    ) -> Any:
        if name in self.known_functions.arrays:
            return Call(text, self.known_functions.arrays[name], tuple(parts))
        if kind is None or kind is type(None):
            own = self.known_functions.returned.get(name)
            kind_of_it = own or self.words.of(_OPERATIONS[name])
            return _made(text, kind_of_it, *parts, atom=True)
        found = self._parts_of(kind, text)
        for part in found:
            part.uses = found[0].uses
            part.reads = frozenset[str]().union(*(own.reads for own in parts))
        return found

    def fixed(
        self, function: Callable[..., Any], args: Sequence[Any]
    ) -> tuple[Callable[..., Any], list[Any]]:
        """A function of the firmware without what is known when it is written; its arguments."""
        parameters = list(inspect.signature(function).parameters.values())
        absent = parameters[1 + len(args) :]  # has defaults
        known = {own.name: own.default for own in absent} | {
            own.name: item
            for own, item in zip(parameters[1:], args, strict=False)
            if own.name == "width" or own.annotation in ("str", str)
        }
        given = zip(parameters[1:], args, strict=False)
        left = [item for own, item in given if own.name not in known]

        def run(o: Any, *values: Any) -> Any:
            given = iter(values)
            every = [known[p.name] if p.name in known else next(given) for p in parameters[1:]]
            return function(o, *every)

        run.__name__ = function.__name__.removeprefix("code_")
        run.__doc__ = function.__doc__
        kept = [own for own in parameters if own.name not in known]
        run.__signature__ = inspect.Signature(kept)  # type: ignore[attr-defined]
        run.text = function  # type: ignore[attr-defined]
        return run, left

    def outside(
        self,
        kind: type[Any],
        name: str,
        function: Callable[..., Any],  # noqa: ARG002
        *args: Any,
        filled: str = "",  # noqa: ARG002
    ) -> Any:
        """A call of a function whose text stands elsewhere."""
        return self._called(name, args, kind)

    # Operators.

    def _wide(self, parts: Sequence[Expression]) -> list[str]:
        """Operands of which one of the first two is a wide word; what has no sign is converted."""
        texts = [part.operand() for part in parts]
        wide = [part.kind == self.words.wide and _value(part) is None for part in parts]
        for n, part in enumerate(parts):
            if part.kind[0] == "u" or (not any(wide[:2]) and n < 2 and _value(part) is None):
                texts[n], wide[n] = f"({self.words.wide}){texts[n]}", True
        return texts

    def const(self, value: Any) -> Any:
        """A constant, or a number that is there already."""
        if isinstance(value, _Power):
            factor = constant(value.factor, self.words.wide).text
            shifted = f"(({self.words.wide}){factor} << {value.bits.bare()})"
            return _made(
                f"{shifted} >> {value.lowered}" if value.lowered else shifted[1:-1],
                self.words.wide,
                value.bits,
            )
        return value if isinstance(value, Code) else constant(int(value), self.words.wide)

    def product(self, name: str, a: Any, b: Any) -> Any:  # noqa: ARG002
        """A product, constants behind what they are multiplied with."""
        if a.value is not None:
            a, b = b, a
        if b.value == 1:
            return a
        x, y = a.minus or a, b.minus or b
        found = _made(" * ".join(self._wide((x, y))), self.words.wide, x, y)
        return found if (a.minus is None) == (b.minus is None) else found.negative()

    def multiple(self, name: str, count: Any, times: int) -> Any:  # noqa: ARG002
        """A count so many times: in Q31 a product of the same types is one of an angle."""
        if count.value is not None or times == 1:
            return count if times == 1 else constant(count.value * times, count.kind)
        return _made(f"{count.operand()} * {times}U", count.kind, count)

    def total(self, name: str, *terms: Any) -> Any:  # noqa: ARG002
        """A sum, from the left; a negative is subtracted."""
        left = [term for term in terms if term.value != 0]
        if len(left) < 2:
            return left[0] if left else terms[0]
        whole = self.words.of(COUNT)
        if all(
            term.value > 0 if term.value is not None else term.kind == whole and term.minus is None
            for term in left
        ):
            texts = [t.operand() if t.value is None else f"{t.value}U" for t in left]
            return _made(" + ".join(texts), whole, *left)
        parts, signs = [left[0]], [""]
        for term in left[1:]:
            negative = term.minus is not None or (term.value is not None and term.value < 0)
            parts.append((term.minus or term.negative()) if negative else term)
            signs.append(" - " if negative else " + ")
        texts = self._wide(parts)
        text = "".join(sign + own for sign, own in zip(signs, texts, strict=True))
        found = _made(text, self.words.wide, *parts)
        if all(part.is_name and (part.kind == _WORD or part.value is not None) for part in parts):
            found.narrow = "".join(
                f"{sign}{own.text}" for sign, own in zip(signs, parts, strict=True)
            )
        return found

    def negative(self, a: Any) -> Any:
        """The number with the other sign."""
        if a.kind == self.words.wide:
            return a.negative()
        text = a.text if a.atom else f"({a.text})"
        found = _made(f"-({self.words.wide}){text}", self.words.wide, a)
        found.minus, found.narrow = a, f"-{text}" if a.is_name and a.kind == _WORD else ""
        if not a.is_name:
            found.uses = a.uses
        return found

    def halved(self, a: Any) -> Any:
        """Half of a number."""
        return self.shifted(a, 1)

    def widened(self, a: Any) -> Any:
        """A wide word of the same number."""
        return _made(a.text, self.words.wide, a, atom=a.atom)

    def narrowed(self, name: str, a: Any) -> Any:  # noqa: ARG002
        """A word of 32 bits: of a sum or negative of such words without others."""
        if a.value is not None:
            return a
        text, atom = a.narrow or a.text, a.atom
        if a.kind == self.words.wide != _WORD and not a.narrow:
            text, atom = a.to(_WORD).text, False
        return Word(text, kind=_WORD, atom=atom, reads=a.reads, members=a.members)

    def shifted(self, a: Any, bits: Any) -> Any:
        """A right shift."""
        if a.value is not None and not isinstance(bits, Code):
            return constant(a.value >> bits, self.words.wide)
        by = bits.operand() if isinstance(bits, Code) else f"{bits}U"
        parts = (a, bits) if isinstance(bits, Code) else (a,)
        if a.kind[0] == "u":
            return self._unsigned(f"{a.operand()} >> {by}", a)
        return _made(f"{self._wide((a,))[0]} >> {by}", self.words.wide, *parts)

    def shifted_by(self, a: Any, bits: Any) -> Any:
        """A right shift by a number of bits that is computed."""
        return self.shifted(a, bits)

    def _unsigned(self, text: str, a: Any) -> Code:
        """A number without a sign, whose type an operator would widen."""
        if _bits(a.kind) < 32:
            return _made(f"({a.kind})({text})", a.kind, a)
        return _made(text, a.kind, a)

    def wrapped(self, a: Any, bits: int) -> Any:
        """A remainder by a power of two: of a whole word by its conversion."""
        if bits == self.words.width:
            kind = self.words.of(TURN)
            return a if a.kind == kind else _made(f"({kind}){a.operand()}", kind, a)
        mask = (1 << bits) - 1
        if a.kind[0] == "u":
            return self._unsigned(f"{a.operand()} & {mask}U", a)
        return _made(f"{self._wide((a,))[0]} & {constant(mask, '').text}", self.words.wide, a)

    def rounded_by(self, name: str, a: Any, bits: Any) -> Any:
        """A right shift to nearest by a number of bits that is computed."""
        return self.call(rounded, name, a, bits)

    def known(self, a: Any, low: int, high: int) -> Any:  # noqa: ARG002
        """The number, which lies there."""
        return a

    def clamp(self, a: Any, low: Any, high: Any) -> Any:
        """The number nearest to a within limits, None where there is none."""
        found = a
        if high is not None:
            found = self._bound(a, ">", self.const(high), a)
        if low is not None:
            found = self._bound(a, "<", self.const(low), found)
        return found

    def _bound(self, a: Any, sign: str, limit: Any, otherwise: Any) -> Any:
        return self.choose(self._compared(a, sign, limit), limit, otherwise)

    def within(self, a: Any, limit: Any) -> Any:
        """The number nearest to a from -limit to limit."""
        return self._called("within", (a, limit), None)

    def root(self, a: Any) -> Any:
        """Root, downwards."""
        return self._called("root", (a,), None)

    def quotient(self, name: str, a: Any, b: Any) -> Any:  # noqa: ARG002
        """A quotient towards zero."""
        return _made(" / ".join(self._wide((a, b))), self.words.wide, a, b)

    def magnitude(self, a: Any) -> Any:
        """The magnitude of a number that has a name."""
        return self.choose(self.at_least(a, self.const(0)), a, self.negative(a))

    # Conditions.

    def _compared(self, a: Any, sign: str, b: Any) -> Condition:
        kinds = {part.kind for part in (a, b) if part.value is None}
        texts = [part.operand(signed=True) for part in (a, b)]
        if any(kind[0] == "u" for kind in kinds):
            for n, part in enumerate((a, b)):
                if part.value is not None:
                    texts[n] = f"{part.value}U"
                elif part.kind[0] != "u":
                    texts[n] = f"({next(k for k in kinds if k[0] == 'u')}){texts[n]}"
        found = _made(f"{texts[0]} {sign} {texts[1]}", self.words.wide, a, b)
        found.free = a.is_name and b.is_name
        return Condition((found,))

    def at_least(self, a: Any, b: Any) -> Condition:
        """Whether a >= b."""
        return self._compared(b, "<=", a) if a.value is not None else self._compared(a, ">=", b)

    def above(self, a: Any, b: Any) -> Condition:
        """Whether a > b."""
        return self._compared(b, "<", a) if a.value is not None else self._compared(a, ">", b)

    def equal(self, a: Any, b: Any) -> Condition:
        """Whether a = b."""
        return self._compared(a, "==", b)

    def has_bit(self, a: Any, bit: int) -> Condition:
        """Whether a number without sign has a bit."""
        found = _made(f"({a.operand()} & {bit}U) != 0U", a.kind, a)
        found.free = a.is_name
        return Condition((found,))

    def every(self, *conditions: Condition) -> Condition:
        """Whether all hold."""
        return Condition(tuple(term for each in conditions for term in each.terms))

    def some(self, *conditions: Condition) -> Condition:
        """Whether one holds."""
        text = " || ".join(f"({each.text()})" for each in conditions)
        terms = [term for each in conditions for term in each.terms]
        return Condition((_made(text, self.words.wide, *terms),))

    def choose(self, condition: Any, a: Any, b: Any) -> Any:
        """A conditional expression."""
        kinds = {part.kind for part in (a, b) if part.value is None}
        kind = kinds.pop() if len(kinds) == 1 else self.words.wide
        texts = [part.operand(signed=True) for part in (a, b)]
        texts = [
            f"{p.value}U" if p.value is not None and kind[0] == "u" else t
            for p, t in zip((a, b), texts, strict=True)
        ]
        return _made(f"({condition.text()}) ? {' : '.join(texts)}", kind, *condition.terms, a, b)

    # Loops and tables.

    def each(self, name: str, count: int, of: Callable[[Any], Any]) -> tuple[Any, ...]:
        """An array that a counted loop fills; that of the function is declared."""
        declared = self.array is not None and self.array.name == name
        return filled(self, name, count, of, declared=declared)

    def at(self, table: Sequence[Any], place: Any, *inner: Any) -> Any:
        """An item of an array; there are no arrays of arrays."""
        assert not inner
        first = table[0]
        if hasattr(first, "_fields"):
            array = first[0].whole.rpartition("[")[0]
            return self.vector(type(first), f"{array}[{place.bare()}]")
        return _made(f"{first.whole}[{place.bare()}]", first.kind, *table, atom=True)

    def entry(self, table: Any, index: Any) -> Any:
        """An entry of a table of a record."""
        assert isinstance(table, Table | Entries)
        return _made(table.at(index), table.kind, index, atom=True)

    def entries(
        self, names: Sequence[str], tables: Sequence[Any], index: Any, steps: Sequence[int]
    ) -> list[tuple[Any, ...]]:
        """Members of items of an array of structs, to which pointers are declared."""
        first, place = tables[0], f"&{tables[0].array}[{index.bare()}]"
        self.take((index,))
        for name, step in zip(names, steps, strict=True):
            self.block.take(name)
            text = f"{names[0]} + {step}" if step else place
            self.block.add(f"const {first.item} *{name} = ", text)
        return [
            tuple(Code(f"{name}->{table.member}", kind=table.kind) for table in tables)
            for name in names
        ]

    def search(self, name: str, cells: int, holds: Callable[[Any], Condition]) -> Any:
        """A loop that halves a step, and a place to which it is added."""
        if cells == 1:
            return self.const(0)
        block, kind = self.block, self.words.of(COUNT)
        block.take(name)
        block.add(f"{kind} {name} = ", "0U")
        if "step" not in block.names:
            block.take("step")
            block.variable(kind, "step")
        self.block = inner = block.inner()
        condition = holds(Code(f"{name} + step", kind=kind, atom=False, free=True))
        self.take(condition.terms)
        head = folded("if (", condition.text(), ") {", inner.indent)
        self.block = block
        begin = f"{block.indent}for (step = {cells >> 1}U; step != 0U; step >>= 1) {{"
        end = [f"{inner.indent}    {name} += step;", f"{inner.indent}}}", f"{block.indent}}}"]
        block.work([begin, *inner.lines, *head, *end])
        return Code(name, kind=kind)

    def halvings(self, name: str, a: Any, most: int, into: tuple[str, str]) -> Any:  # noqa: ARG002
        """A loop that halves a copy of a number and counts."""
        return self._loop(a, into, "0U", f"> {constant(most, '').text}", ">>= 1U", "++")[1]

    def normalised(
        self, a: Any, least: int, step: int, places: int, into: tuple[str, str]
    ) -> tuple[Any, Any]:
        """A loop that doubles a copy of a number and counts down."""
        below = f"< {constant(least, '').text}"
        return self._loop(a, into, f"{places}U", below, f"*= {1 << step}", "--")

    def _loop(
        self, a: Any, into: tuple[str, str], first: str, while_: str, change: str, count: str
    ) -> tuple[Any, Any]:
        copy, counter = into
        block, wide = self.block, self.words.wide
        self.take([a])
        for kind, own, text in ((wide, copy, a.bare()), ("uint32_t", counter, first)):
            block.take(own)
            block.add(f"{kind} {own} = ", text)
        block.work(
            [
                f"{block.indent}while ({copy} {while_}) {{",
                f"{block.indent}    {copy} {change};",
                f"{block.indent}    {count}{counter};",
                f"{block.indent}}}",
            ]
        )
        return Code(copy, kind=wide), Code(counter, kind="uint32_t")

    def neighbours(
        self, table: tuple[int, ...], index: Any, names: tuple[str, str]
    ) -> tuple[Any, Any]:
        """A pointer into a table, which is declared before all else."""
        own, place = names
        kind = self.words.of(TURN if min(table) >= 0 else CODE)
        if own not in self.block.names:
            self.block.take(own)
            mark = "U" if kind[0] == "u" else ""
            rows = (table[n : n + _COLUMNS] for n in range(0, len(table), _COLUMNS))
            text = ",\n        ".join(", ".join(f"{x}{mark}" for x in row) for row in rows)
            head = f"    static const {kind} {own}[{len(table)}] = {{"
            self.block.lines[:0] = [head, f"        {text}", "    };"]
        self.block.take(place)
        self.take([index])
        self.block.add(f"const {kind} *{place} = ", f"&{own}[{index.bare()}]")
        low, high = (Code(f"{place}[{n}]", kind=kind) for n in range(2))
        return low, high


def _value(part: Expression) -> int | None:
    return cast("int | None", getattr(part, "value", None))
