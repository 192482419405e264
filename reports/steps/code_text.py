"""Types, constants and functions of codes that every header of one format has, in C."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

from dqforge.optimizer.fixed_control import codes
from dqforge.optimizer.fixed_control.shortening import inverse_root, reciprocal, shortened
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps import integer_arithmetic as arithmetic
from dqforge.optimizer.steps.code_vectors import (
    COUNT,
    FEW,
    TURN,
    Abc,
    AlphaBeta,
    Dq,
    Gain,
    Rotation,
)
from dqforge.reports.c_code.numbers import int32_literal, int64_literal
from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.code_arrays import axes_of, is_array, sizes, word_of
from dqforge.reports.steps.code_reader import (
    Code,
    CodeFunctions,
    CodeReader,
    Words,
    gain_text,
)
from dqforge.reports.steps.record_text import c_name, comment, said, sentence, struct
from dqforge.reports.steps.symbols import folded

_ANY: Any = Code("number", kind="wide")  # Stands for any number, where its type is asked for.
NO_GAIN = FixedGain(0, 0, 0.0)

SHIFTS_KEEP_SIGNS = """#if ((-1) >> 1) != (-1)
#error "fixed point needs arithmetic right shifts of negative numbers"
#endif"""


def code_reader(prefix: str, width: int, form: str = "", known: Any = None) -> CodeReader:
    """A reader of functions in codes of so many bits.

    Args:
        prefix: Before all names.
        width: Bits of a code.
        form: Behind all names, empty for the name of the format.
        known: Functions of another reader, whose texts stand before.
    """
    functions = CodeFunctions()
    if known is not None:
        functions.take(known)
    return CodeReader(prefix, form or f"q{width - 1}", Words(width), functions, Block("", set()))


def write(
    reader: CodeReader,
    function: Callable[..., Any],
    *arguments: Any,
    text: str = "",
) -> None:
    """Write a function, with arguments as of `CodeReader.parameter`; of numbers any."""
    own, left = reader.fixed(function, arguments)
    reader.write(own.__name__, own, left, text)


def texts(reader: CodeReader) -> str:
    """The functions written, in their order."""
    return "\n\n".join(reader.functions.texts.values())


# Types and constants.


def vector_type(reader: CodeReader, kind: type[Any], text: str = "") -> str:
    """The type of a vector."""
    own = zip(axes_of(kind), reader.axis_kinds(kind), strict=True)
    members = [(f"{word} {axis}", "") for axis, word in own]
    lines = struct(reader.type_name(c_name(kind)), members)
    return "\n".join([*(comment(text) if text else []), *lines])


def record_type(reader: CodeReader, like: Any, text: str = "") -> str:
    """The type of a record, without those in it."""
    members = []
    for member in fields(like):
        value, name = getattr(like, member.name), member.name
        if value is None or value == ():
            continue
        if isinstance(value, FixedGain):
            kind = reader.type_name("gain")
        elif is_dataclass(value) or hasattr(value, "_fields"):
            kind = reader.type_of(type(value))
            if getattr(value, "POINTED", False):
                kind, name = f"const {kind}", f"*{name}"
        else:
            kind = reader.member_kind(type(like), name)
        members.append((f"{kind} {name}{sizes(value)}", said(type(like), member.name)))
    lines = struct(reader.type_name(c_name(type(like))), members)
    return "\n".join([*comment(text or sentence(type(like))), *lines])


def initial(value: Any, width: int) -> str:
    """An initialiser of a record of integers."""
    if isinstance(value, FixedGain):
        return gain_text(value)
    return f"{{ {', '.join(_members(value, width, {}))} }}"


def _listed(value: Any) -> str:
    """An initialiser of an array of codes."""
    return f"{{ {', '.join(map(_listed, value))} }}" if is_array(value) else int32_literal(value)


def _members(record: Any, width: int, pointed: Mapping[str, str]) -> Iterator[str]:
    from typing import get_type_hints

    hints = get_type_hints(type(record), include_extras=True)
    for member in fields(record):
        value, word = getattr(record, member.name), word_of(hints[member.name])
        if value is None:
            continue
        if member.name in pointed:
            yield f"&{pointed[member.name]}"
        elif is_dataclass(value):
            yield initial(value, width)
        elif is_array(value):
            yield _listed(value)
        elif word in (COUNT, FEW, TURN):
            yield f"{value}U"
        else:
            wide = word == "wide" and width > 16
            yield int64_literal(value) if wide else int32_literal(value)


def constant_of(
    reader: CodeReader, name: str, record: Any, pointed: Mapping[str, str] | None = None
) -> str:
    """A constant with the values of a record; ``pointed`` are the names of constants to which
    members point.
    """
    kind = reader.type_name(c_name(type(record)))
    values = list(_members(record, reader.words.width, pointed or {}))
    head = f"static const {kind} {name} = {{"
    if len(f"{head} {', '.join(values)} }};") <= 118:
        return f"{head} {', '.join(values)} }};"
    lines = [
        "\n".join(line for line in folded("", value, "", "    ") if line.strip())
        for value in values
    ]
    return "\n".join([head, ",\n".join(lines), "};"])


# What every header in fixed point has.


def _guarded(name: str, parts: Sequence[str]) -> str:
    return "\n\n".join([f"#ifndef {name}\n#define {name}", *parts, f"#endif /* {name} */"])


@cache
def code_types(prefix: str, macro: str, width: int, form: str = "") -> str:
    """Types of vectors, guarded for headers that are included together."""
    reader = code_reader(prefix, width, form)
    parts = [vector_type(reader, kind) for kind in (Abc, AlphaBeta, Dq, Rotation)]
    return _guarded(f"{macro}_{reader.form.upper()}_TYPES", parts)


# Operations that C has no operator for. A conversion keeps the low bits of a number, on every
# compiler for these cores; no expression over numbers says so. The root is found bit by bit.
_SAID = "what a conversion keeps is a code (those beyond wrap, on every compiler for these cores)"
_OPERATIONS = """/* The number nearest to x from -limit to limit. */
static inline {wide} {within}({wide} x, {wide} limit)
{{
    return (x > limit) ? limit : ((x < -limit) ? -limit : x);
}}

/* The code nearest to x; {said}. */
static inline {number} {saturated}({wide} x)
{{
    const {number} kept = ({number})x;

    return (kept == x) ? kept : (({number})((x < 0) ? {least} : {top}));
}}

/* Largest integer whose square is not above x. */
static inline {wide} {root}({wide} x)
{{
    {uwide} rest = ({uwide})x;
    {uwide} root = 0U;
    {uwide} bit = ({uwide})1 << {highest};

    while (bit > rest) {{
        bit >>= 2;
    }}
    while (bit != 0U) {{
        const {uwide} trial = root + bit;

        root >>= 1;
        if (rest >= trial) {{
            rest -= trial;
            root += bit;
        }}
        bit >>= 2;
    }}
    return ({wide})root;
}}"""


def _operations(reader: CodeReader) -> str:
    width, words = reader.words.width, reader.words
    names = {name: reader.function_name(name) for name in ("within", "saturated", "root")}
    literal = int64_literal if width > 16 else int32_literal
    return _OPERATIONS.format(
        wide=words.wide,
        uwide=f"u{words.wide}",
        number=words.of("code"),
        least=literal(-(1 << (width - 1))),
        top=literal((1 << (width - 1)) - 1),
        highest=2 * width - 2,
        said=_SAID,
        **names,
    )


def basics_reader(prefix: str, width: int, form: str = "", error: str = "") -> CodeReader:
    """Functions of `code_basics`, for readers of what calls them.

    Args:
        prefix, width, form: As of `code_reader`.
        error: What is said of the error of sine and cosine.
    """
    reader = code_reader(prefix, width, form)
    write(reader, arithmetic.rounded, "", _ANY, _ANY)
    write(reader, arithmetic.scaled, "", Gain(_ANY, _ANY, _ANY), _ANY)
    said_of = (
        f"Cosine and sine of an angle, of which {2**width} codes are a turn{error}."
        if error
        else ""
    )
    turn = Rotation(_ANY, _ANY)
    write(reader, codes.rotation, width, _ANY, text=said_of)
    write(reader, codes.code_clarke, width, Abc(_ANY, _ANY, _ANY))
    write(reader, codes.code_clarke_inverse, width, AlphaBeta(_ANY, _ANY))
    write(reader, codes.code_park, width, AlphaBeta(_ANY, _ANY), turn)
    write(reader, codes.code_park_inverse, width, Dq(_ANY, _ANY), turn)
    return reader


@cache
def code_basics(prefix: str, macro: str, width: int, error: str, form: str = "") -> str:
    """Gains, sine and transforms behind `code_types`.

    Args:
        prefix, macro: Before names of functions and types, and before that of the guard.
        width: Bits of a code.
        error: What is said of the error of sine and cosine.
        form: Behind all names, empty for the name of the format.
    """
    reader = basics_reader(prefix, width, form, error)
    gain = vector_type(
        reader, Gain, "mantissa / 2^shift; half of what the shift leaves rounds to nearest"
    )
    parts = [gain, _operations(reader), texts(reader)]
    return _guarded(f"{macro}_{reader.form.upper()}_BASICS", parts)


def shortening_reader(prefix: str, width: int) -> CodeReader:
    """Functions of `code_shortening`, behind the basic ones."""
    reader = code_reader(prefix, width, known=basics_reader(prefix, width).functions)
    write(
        reader,
        reciprocal,
        width,
        _ANY,
        text=(
            f"2^{2 * width - 3} / m for m from 2^{width - 2} to 2^{width - 1}: a polynomial and "
            "Newton's rule."
        ),
    )
    write(
        reader,
        inverse_root,
        width,
        _ANY,
        text=f"2^{2 * width - 2} / sqrt(s) for s from 2^{2 * width - 3} on.",
    )
    write(reader, shortened, width, _ANY, _ANY, _ANY)
    return reader


@cache
def code_shortening(prefix: str, macro: str, width: int) -> str:
    """Reciprocals and shortened voltages behind `code_basics`."""
    reader = shortening_reader(prefix, width)
    return _guarded(f"{macro}_{reader.form.upper()}_SHORTENING", [texts(reader)])
