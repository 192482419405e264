"""A position observer in integers in C, from its step: types, gains, start and step.

The step is run on numbers that know their text and their range (`integers`), by `integer_reader`.
Ranges are those of the proof (`observer_reaches`) with both vectors in all
codes of 32 bits, so that the text is the same behind a control of either format.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from dqforge.machines.transforms import Pair
from dqforge.optimizer.fixed_observers.kit import WIDTH, FixedMethod, TrackedState, shown
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Range
from dqforge.reports.c_code.numbers import int32_literal, int64_literal
from dqforge.reports.steps.blocks import Block
from dqforge.reports.steps.code_arrays import sizes
from dqforge.reports.steps.integer_reader import (
    VECTORS,
    Functions,
    IntegerReader,
    Lines,
    member_type,
    record,
    whole_of,
)
from dqforge.reports.steps.integers import CODES, INT32, INT64, UINT32, WORD, Number
from dqforge.reports.steps.observer_text import Path, gap, in_order, merged, statements
from dqforge.reports.steps.record_text import comment, said, sentence, struct
from dqforge.reports.steps.state_text import Assignment
from dqforge.reports.steps.symbols import folded


def integer_observer_text(
    method: FixedMethod, gains: Any, width: int, prefix: str, macro: str
) -> str:
    """What stands in a header behind the functions of all observers in fixed point.

    Args:
        method, gains: The observer.
        width: Bits of a code of the control.
        prefix, macro: Before the names of functions and types, and before that of the gains.
    """
    form, code = f"q{width - 1}", method.code
    functions = Functions(prefix, form, method)
    for dry in (True, False):
        paths = [_path(method, gains, functions, dry=dry, started=s) for s in (False, True)]
    first, then = paths
    own, state = f"{prefix}_{code}_gains_{form}_t", f"{prefix}_{code}_{form}_t"
    records = dict(_record_structs(gains, functions))
    parts = [
        *records.values(),
        struct(state, _state_members(method, functions, width)),
        [
            f"static const {own} {macro}_{code.upper()}_GAINS_{form.upper()} = {{",
            *_lines_of(gains),
            "};",
        ],
        _start(method, functions, width),
        *functions.structs.values(),
        *([text] for text in functions.texts.values()),
        _step(method, functions, width, first, then),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)


def _record_structs(like: Any, functions: Functions) -> Iterator[tuple[str, list[str]]]:
    """Types of a record of integers and of those in it, by name."""
    lines = []
    for member in fields(like):
        value, says = getattr(like, member.name), said(type(like), member.name)
        if isinstance(value, FixedGain):
            lines.append((f"{functions.core('gain')} {member.name}", says))
        elif is_dataclass(value):
            yield from _record_structs(value, functions)
            lines.append((f"{functions.record(type(value))} {member.name}", says))
        else:
            kind = INT32 if isinstance(value, tuple) else member_type(type(like), member.name)
            lines.append((f"{kind} {member.name}{sizes(value)}", says))
    name = functions.record(type(like))
    yield name, [*comment(sentence(type(like))), *struct(name, lines)]


def _lines_of(like: Any) -> list[str]:
    """Lines of an initialiser, without the outermost braces."""
    found = list[str]()
    for member in fields(like):
        text = _initial(type(like), member.name, getattr(like, member.name))
        inner = text.startswith("{ ")
        begin, end = ("{ ", " }") if inner else ("", "")
        found.append("\n".join(folded(begin, text[2:-2] if inner else text, end, "    ")))
    return ",\n".join(found).split("\n")


def _initial(kind: type[Any], name: str, value: Any) -> str:
    if isinstance(value, FixedGain):
        half = int64_literal(value.half) if value.shift > 31 else int32_literal(value.half)
        return f"{{ {int32_literal(value.mantissa)}, {value.shift}U, {half} }}"
    if is_dataclass(value):
        parts = [_initial(type(value), f.name, getattr(value, f.name)) for f in fields(value)]
        return f"{{ {', '.join(parts)} }}"
    if isinstance(value, tuple):
        return f"{{ {', '.join(_initial(kind, name, item) for item in value)} }}"
    own = INT32 if kind is tuple else member_type(kind, name)
    if own == UINT32:
        return f"{value}U"
    return int64_literal(value) if own == INT64 else int32_literal(value)


# State, start and step.


def _words(method: FixedMethod) -> list[tuple[str, str, str]]:
    """Members of the state beside angle and speed: type, declaration and what it is."""
    found: dict[str, tuple[str, str, str]] = {}
    for word in method.words:
        name, _, part = word.name.partition(".")
        array, _, _ = name.partition("[")
        if part:
            vector = next(k for k, names in VECTORS.items() if part in names)
            found.setdefault(name, (vector, name, word.meaning))
        elif array != name:
            count = sum(other.name.startswith(f"{array}[") for other in method.words)
            found.setdefault(array, (word.type, f"{array}[{count}]", word.meaning))
        else:
            found[name] = (word.type, name, word.meaning)
    return list(found.values())


def _state_members(method: FixedMethod, functions: Functions, width: int) -> list[tuple[str, str]]:
    words = [
        (f"{functions.core(kind) if kind in VECTORS else kind} {name}", says)
        for kind, name, says in _words(method)
    ]
    return [
        (f"uint{width}_t theta_e", f"estimated electrical angle, 2^{width} codes of a turn"),
        (f"int{width}_t omega_m", "estimated mechanical speed in codes of its full scale"),
        ("uint32_t theta", "both with all their bits"),
        ("int32_t omega", ""),
        ("uint8_t started", "0 before the first step"),
        *words,
    ]


def _start(method: FixedMethod, functions: Functions, width: int) -> list[str]:
    rest = WIDTH - width
    head = f"static inline void {functions.prefix}_{method.code}_start_{functions.form}("
    state = functions.own(method.code)
    parameters = f"{state} *observer, uint{width}_t theta_e, int{width}_t omega_m"
    return [
        *comment("Start from an angle and a speed in codes, at the instant of the first step."),
        *folded(head, parameters, ")", ""),
        "{",
        "    observer->theta_e = theta_e;",
        "    observer->omega_m = omega_m;",
        f"    observer->theta = (uint32_t)theta_e{f' << {rest}' if rest else ''};",
        f"    observer->omega = (int32_t)omega_m{f' * {2**rest}' if rest else ''};",
        "    observer->started = 0U;",
        *(f"    observer->{word.name} = 0;" for word in method.words),
        "}",
    ]


def _of_state(name: str, kind: str, range_: Range) -> Number:
    text = f"observer->{name}"
    whole = text.rpartition(".")[0] if "." in name else ""
    return Number(text, kind, range_, free=True, reads=frozenset({text}), whole=whole)


def _path(
    method: FixedMethod, gains: Any, functions: Functions, *, dry: bool, started: bool
) -> Path:
    block = Lines("        ", {"gains", "observer", "v", "i", "voltage", "current"})
    reader = IntegerReader(functions, block, dry=dry, noting=dry)
    own = record(functions, gains, "gains", "gains->")
    limits = zip(method.words, method.limits(gains), strict=True)
    state = TrackedState(
        _of_state("theta", UINT32, WORD),
        _of_state("omega", INT32, CODES),
        tuple(_of_state(word.name, word.type, limit) for word, limit in limits),
    )
    codes = [Number("", INT32, CODES)] * 2
    v, i = (
        reader.members(Pair, name, VECTORS["alphabeta"], codes, whole=name)
        for name in ("voltage", "current")
    )
    after = (method.step if started else method.begin)(reader, own, state, v, i)
    if dry:
        return Path([], [])
    if reader.branches is None:
        written = _written(method, after, block.indent)
    else:
        condition, branches = reader.branches
        written = folded("if (", condition, ") {", block.indent)
        for n, (inner, state_after) in enumerate(branches):
            own = _written(method, state_after, inner.indent)
            begin = [f"{block.indent}}} else {{"] if n else []
            written += [*begin, *inner.lines, *(gap(own) if inner.lines else []), *own]
        written.append(f"{block.indent}}}")
    text = "\n".join([*block.lines, *written])
    kind, widened = functions.core("alphabeta"), f"{functions.prefix}_widened_{functions.form}"

    def taken(name: str, short: str) -> list[str]:
        return [f"{block.indent}const {kind} {name} = {widened}({short});"]

    found = [*taken("current", "i")] if re.search(r"\bcurrent\b", text) else []
    for statement in statements(block.lines):
        if (
            re.search(r"\bvoltage\b", "\n".join(statement))
            and taken("voltage", "v")[0] not in found
        ):
            found += taken("voltage", "v")
        found += statement
    return Path(found, written)


def _written(method: FixedMethod, after: TrackedState[Any], indent: str) -> list[str]:
    """Assignments to what changes."""
    found = list[Assignment]()
    words = [(word.name, word.type) for word in method.words]
    names = [*words, ("theta", UINT32), ("omega", INT32)]
    values = [*after.words, after.theta, after.omega]
    at = 0
    while at < len(names):
        (name, kind), value = names[at], values[at]
        place = f"observer->{name}"
        vector, _, part = place.rpartition(".")
        pair = (Dq if part == "d" else Pair)(value, values[min(at + 1, len(values) - 1)])
        whole = whole_of(pair) if part in ("alpha", "d") else ""
        value.bare()
        if whole and value.text.endswith(f".{part}") and {p.kind for p in pair} == {INT32}:
            targets = {place, f"observer->{names[at + 1][0]}"}
            found.append(Assignment(vector, whole, pair.x.reads | pair.y.reads, targets))
            at += 2
        else:
            found.append(Assignment(place, value.written(kind), value.reads, {place}))
            at += 1
    return in_order([item for item in found if item.place != item.text], indent)


def _shown(functions: Functions, width: int) -> list[str]:
    """What is shown of angle and speed, at the end of a step."""
    block = Block("    ", set())
    reader: Any = IntegerReader(functions, block, dry=False)
    state = TrackedState(_of_state("theta", UINT32, WORD), _of_state("omega", INT32, CODES), ())
    theta, omega = shown(reader, state, width)
    block.add("observer->theta_e = ", theta.written(f"uint{width}_t"))
    block.add("observer->omega_m = ", omega.written(f"int{width}_t"))
    block.add("observer->started = ", "1U")
    return block.lines


def _step(
    method: FixedMethod, functions: Functions, width: int, first: Path, then: Path
) -> list[str]:
    both, branches, after = merged(first, then)
    prefix, form, code = functions.prefix, functions.form, method.code
    vector = f"{prefix}_alphabeta_{form}_t"
    parameters = (
        f"const {functions.own(f'{code}_gains')} *gains, {functions.own(code)} *observer, "
        f"{vector} v, {vector} i"
    )
    branch = (
        ["    if (observer->started == 0U) {", *branches[0], "    } else {", *branches[1], "    }"]
        if branches[0]
        else ["    if (observer->started != 0U) {", *branches[1], "    }"]
    )
    return [
        *comment(sentence(method.step).replace("`", "")),
        *folded(f"static inline void {prefix}_{code}_step_{form}(", parameters, ")", ""),
        "{",
        *both,
        *gap(both),
        *branch,
        *after,
        *_shown(functions, width),
        "}",
    ]
