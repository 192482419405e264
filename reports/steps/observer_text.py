"""A position observer in C, from its step: types, start, step and gains."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from struct import pack
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from dqforge.optimizer.observers.parts import FirmwareStep, ObserverState
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import (
    c_name,
    comment,
    record_numbers,
    record_structs,
    record_values,
    sentence,
    struct,
    vector_struct,
)
from dqforge.reports.steps.state_text import Assignment, assignments, ordered, vector
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression, expression, folded

if TYPE_CHECKING:
    from dqforge.machines.transforms import Reals
    from dqforge.optimizer.estimators import Signal, Tracker, TrackerSteps
    from dqforge.optimizer.observers.parts import ObserverMethod, StateMembers
    from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Pair


_SPEED = ("float omega_e", "estimated electrical speed, rad/s")


def _emitted(method: ObserverMethod) -> FirmwareStep:
    return FirmwareStep(method.code, method.gains, method.start, method.step, method.members)


def observer_text(method: ObserverMethod, gains: Any, prefix: str, macro: str) -> str:
    """What stands in a header behind the types that control and observers share.

    Args:
        method: The observer.
        gains: Its gains.
        prefix, macro: Before the names of functions and types, and before that of the gains.
    """
    return step_text(_emitted(method), gains, prefix, macro)


def step_text(method: FirmwareStep, gains: Any, prefix: str, macro: str) -> str:
    """As `observer_text`, of an observer of any kind."""
    code, functions = method.code, Functions()
    if c_name(method.gains) != f"{code}_gains":
        raise ValueError(f"{method.gains.__name__} is not named like {code}")
    first, then = (_path(method, gains, prefix, functions, started) for started in (False, True))
    state, own = f"{prefix}_{code}_t", f"{prefix}_{code}_gains_t"
    parts = [
        *(vector_struct(kind, prefix) for kind in functions.vectors.values()),
        *record_structs(gains, prefix, functions.members),
        struct(state, _state_members(method, prefix)),
        _start(method, prefix, state),
        *([text] for text in functions.texts.values()),
        _step(method, prefix, first, then),
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
        _path(_emitted(method), gains, "", functions, started)
    numbers = list(record_numbers(gains, functions.members))
    return pack(f"={len(numbers)}f", *numbers)


def _first(method: FirmwareStep) -> ObserverState:
    return method.start(np.ones(1), np.ones(1))


def _kinds(method: FirmwareStep) -> list[type[Any]]:
    """Types of the vectors of the state."""
    return [_kind(pair) for pair in _first(method).vectors]


def _kind(pair: Any) -> type[Any]:
    return type(pair) if hasattr(pair, "_fields") else AlphaBeta


def _state_members(method: FirmwareStep, prefix: str) -> list[tuple[str, str]]:
    members = method.members
    vectors = zip(members.vectors, _kinds(method), strict=True)
    return [
        *((f"{prefix}_{c_name(kind)}_t {n}", own.text) for (n, own), kind in vectors),
        *((f"float {n}", own.text) for n, own in members.scalars),
        ("int started", "0 before the first step"),
        ("float theta_e", members.angle.text),
        _SPEED,
    ]


def _start(method: FirmwareStep, prefix: str, state: str) -> list[str]:
    """The first state, whose vectors and scalars depend on nothing."""
    first, vectors = _first(method), zip(method.members.vectors, _kinds(method), strict=True)
    targets = [f"{n}.{axis}" for (n, _), kind in vectors for axis in kind._fields]
    targets += [n for n, _ in method.members.scalars]
    values = [part for pair in first.vectors for part in pair] + list(first.scalars)
    head = f"static inline void {prefix}_{method.code}_start("
    return [
        *comment(method.started),
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
    method: FirmwareStep, gains: Any, prefix: str, functions: Functions, started: bool
) -> Path:
    block = Block("        ", {"gains", "observer", "v", "i", *method.further})
    reader = StepReader(prefix, functions, block)
    _, own = reader.parameter("gains", gains)
    vectors = zip(method.members.vectors, _kinds(method), strict=True)
    state = ObserverState(
        tuple(vector(kind, f"observer->{n}", state=True) for (n, _), kind in vectors),
        _member("theta_e"),
        _member("omega_e"),
        started,
        tuple(_member(n) for n, _ in method.members.scalars),
    )
    further = map(Expression, method.further)
    seen = vector(AlphaBeta, "v"), vector(AlphaBeta, "i")
    result = method.step(own, state, *seen, reader, *further)
    if reader.branches is None:
        return Path(block.lines, _written(method.members, result, reader, block.indent))
    condition, branches = reader.branches
    lines = [*folded("if (", condition, ") {", block.indent)]
    for n, (inner, after) in enumerate(branches):
        written = _written(method.members, after, reader, inner.indent)
        gap = [""] if inner.lines else []
        lines += [*([f"{block.indent}}} else {{"] if n else []), *inner.lines, *gap, *written]
    return Path(block.lines, [*lines, f"{block.indent}}}"])


def _member(name: str) -> Any:
    return Expression(f"observer->{name}", reads=frozenset({f"observer->{name}"}))


def _written(
    members: StateMembers, after: ObserverState, reader: StepReader, indent: str
) -> list[str]:
    """Assignments to what changes, none before another one that reads the old value."""
    open_ = list[Assignment]()
    names = [*(n for n, _ in members.scalars), "theta_e", "omega_e"]
    for (n, _), pair in zip(members.vectors, after.vectors, strict=True):
        place, parts = f"observer->{n}", list(map(expression, pair))
        reader.take(parts)
        kind = _kind(pair)
        before = vector(kind, place, state=True)
        open_ += assignments(place, kind(*parts), parts, before)
    for n, value in zip(names, (*after.scalars, after.theta_e, after.omega_e), strict=True):
        part = expression(value)
        reader.take([part])
        open_ += assignments(f"observer->{n}", part, [part], _member(n))
    return in_order(open_, indent)


def in_order(writes: list[Assignment], indent: str) -> list[str]:
    """Assignments to members of a state, none before another one that reads the old value.

    Args:
        indent: Of the lines.

    Raises:
        ValueError: There is no such order.
    """
    block = Block(indent, set())
    ordered(writes, block)
    return block.lines


def _step(method: FirmwareStep, prefix: str, first: Path, then: Path) -> list[str]:
    both, branches, after = merged(first, then)
    name = f"{prefix}_{method.code}"
    arguments = [
        f"const {name}_gains_t *gains",
        f"{name}_t *observer",
        *(f"{prefix}_alphabeta_t {n}" for n in ("v", "i")),
        *(f"float {n}" for n in method.further),
    ]
    body = [
        "    if (observer->started == 0) {",
        *branches[0],
        "        observer->started = 1;",
        "    } else {",
        *branches[1],
        "    }",
        *after,
    ]
    names = set(re.findall(r"\w+", " ".join([*both, *body])))
    return [
        *comment(method.stepped),
        *folded(f"static inline void {name}_step(", ", ".join(arguments), ")", ""),
        "{",
        *both,
        *gap(both),
        *(f"    (void){n};" for n in ("v", "i", *method.further) if n not in names),
        *body,
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
        if line.endswith((";", "{", "}")) and not line.endswith("= {"):
            found.append([])
    return [part for part in found if part]


_DECLARED = re.compile(
    r"\s*(?:const [^=]*?(\w+)(?:\[\d+\])? =|(?:float|unsigned int|\w+_t) (\w+)[;\[])"
)


def _declared(lines: Sequence[str]) -> set[str]:
    """Names of the constants and variables that lines declare."""
    return {found[1] or found[2] for line in lines if (found := _DECLARED.match(line))}


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


# A tracker of the position in C, from its step.

_NAMES: dict[Signal, str] = {
    "sum-voltage": "u",
    "voltage-a": "v_a",
    "voltage-b": "v_b",
    "voltage-c": "v_c",
}


def tracker_text(tracker: Tracker, gains: Any, prefix: str, macro: str) -> str:
    """What stands in a header behind the types that control and observers share.

    Args:
        tracker: With ``members``; the C says of its functions what their docstrings begin with.
        gains: Its gains.
        prefix, macro: Before the names of functions and types, and before that of the gains.
    """
    if tracker.steps is not None:
        return _steps_text(tracker.code, tracker.steps(gains), gains, prefix, macro)
    assert tracker.members is not None

    def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
        return cast("ObserverState", tracker.start(gains, theta_e, omega_e))

    def step(
        own: Any, state: ObserverState, v: Pair, i: Pair, o: Arithmetic, *heard: Reals
    ) -> ObserverState:
        return cast("ObserverState", tracker.step(own, state, v, i, heard, o))

    emitted = FirmwareStep(
        tracker.code,
        tracker.gains,
        start,
        step,
        tracker.members,
        sentence(tracker.start),
        sentence(tracker.step),
        tuple(_NAMES[signal] for signal in tracker.hears),
    )
    return step_text(emitted, gains, prefix, macro)


def _steps_text(code: str, steps: TrackerSteps, gains: Any, prefix: str, macro: str) -> str:
    """Macros, types, functions and gains of a tracker with a state of its own."""
    for kind, name in ((type(gains), f"{code}_gains"), (type(steps.state), code)):
        if c_name(kind) != name:
            raise ValueError(f"{kind.__name__} is not named like {code}")
    functions = Functions(names=steps.names)
    reader = StepReader(prefix, functions, Block("", set()))
    number = Expression("number")
    reader.write(f"{code}_start", steps.start, [steps.state, number, number])
    seen = [vector(AlphaBeta, name) for name in ("v", "i")]
    reader.write(f"{code}_step", steps.step, [gains, steps.state, *seen])
    parts = [
        [f"#define {macro}_{name} {value} /* {says} */" for name, value, says in steps.counts],
        *record_structs(gains, prefix, functions.members),
        *record_structs(steps.state, prefix),
        *([text] for text in functions.texts.values()),
        [
            f"static const {prefix}_{code}_gains_t {macro}_{code.upper()}_GAINS = {{",
            *record_values(gains, functions.members),
            "};",
        ],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)
