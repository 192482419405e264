"""The start-up in C, written from its steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, make_dataclass
from typing import Any, NamedTuple

from dqforge.machines.names import Feedforward
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import leaves
from dqforge.optimizer.float_control.records import (
    NUMBERS,
    Control,
    ControlGains,
    Pi,
    PiGains,
    References,
)
from dqforge.optimizer.start_up.parts import Neighbours
from dqforge.optimizer.start_up.records import (
    FAULTS,
    STATES,
    Followed,
    FollowedFromRest,
    Startup,
    StartupFault,
    StartupOutput,
    StartupSample,
    StartupSettings,
    StartupState,
    blank,
)
from dqforge.optimizer.start_up.step import StartupSteps
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Dq
from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.local_records import RecordReader
from dqforge.reports.steps.record_text import (
    c_name,
    comment,
    record_structs,
    record_values,
    said,
    sentence,
)
from dqforge.reports.steps.symbols import Expression

_NUMBER: Any = 0.0  # Stands for any, where names and types of members are asked for alone.


class Duties(NamedTuple):
    """Duty cycles of a control over the angle."""

    a: Any
    b: Any
    c: Any


@dataclass(frozen=True, slots=True)
class StartupForm:
    """What the C of a start-up depends on, beside its settings.

    Args:
        code: Part of C names of the estimator at speed; ``low`` that of the one from standstill on,
            empty without one.
        hears: Whether the estimator at speed is told the sum of the phase voltages.
        feedforward: That of the control over the angle, None for field-oriented control.
        by_torque: Whether that control makes its currents of the torque.
        moving: Which references of the control have slopes: those of torque and of current.
    """

    code: str
    low: str = ""
    hears: bool = False
    feedforward: Feedforward | None = None
    by_torque: bool = False
    moving: tuple[bool, bool] = (False, False)


def startup_text(form: StartupForm, settings: StartupSettings, prefix: str, macro: str) -> str:
    """What stands in the header behind what it includes.

    Args:
        form: What the start-up is made of.
        settings: Values of the design.
        prefix, macro: Before the names of functions and types, and before those of macros.
    """
    drive, duty = _drive(form), Abc if form.feedforward is None else Duties
    sample = StartupSample(Abc(_NUMBER, _NUMBER, _NUMBER), _NUMBER, _NUMBER if form.hears else None)
    output = StartupOutput(duty(_NUMBER, _NUMBER, _NUMBER), _NUMBER)
    functions = _functions(form, settings, drive, sample, prefix, duty)
    known = {c_name(type(record)) for record, _ in leaves(drive)} - {"startup"}
    known |= {"control", "references"}
    parts = [
        *_enumerations(prefix, macro),
        *record_structs(settings, prefix),
        *record_structs(sample, prefix),
        *record_structs(output, prefix),
        *record_structs(drive, prefix, known=known),
        _constants(settings, prefix, macro),
        *([text] for text in functions.texts.values()),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)


def _drive(form: StartupForm) -> Startup:
    """The members of the memory, whose records are named as in the headers of control and
    estimators.
    """
    torque, current = form.moving
    moving = References(
        _NUMBER if torque else None, Dq(_NUMBER, _NUMBER) if current else None, None, None
    )
    turn = AlphaBeta(_NUMBER, _NUMBER)
    control = Control(
        *(Pi(_NUMBER) for _ in range(3)),
        reference=Dq(_NUMBER, _NUMBER),
        v=turn,
        omega_m=_NUMBER,
        torque=_NUMBER,
        count=_NUMBER,
        added=turn if form.low else None,
        held=Dq(_NUMBER, _NUMBER),
        references=moving if torque or current else None,
    )
    observer = _named(form.code, Followed)(_NUMBER, _NUMBER)
    low = _named(form.low, FollowedFromRest)(turn, turn, _NUMBER, _NUMBER) if form.low else None
    return blank(control, observer, low, _NUMBER)


def _named(code: str, kind: type[Any], end: str = "") -> type[Any]:
    """A record of another name, that of an estimator in C."""
    name = "".join(part.capitalize() for part in code.split("_"))
    return make_dataclass(f"{name}{end}", [], bases=(kind,), frozen=bool(end))


@dataclass(frozen=True, slots=True)
class _Gains:
    """Those of an estimator, which are handed on."""


def _functions(
    form: StartupForm,
    settings: StartupSettings,
    drive: Startup,
    sample: StartupSample,
    prefix: str,
    duty: type[Any],
) -> Functions:
    steps = StartupSteps(Neighbours(), form.hears, form.feedforward, form.by_torque, duty)
    own = [name for name in dir(StartupSteps) if callable(getattr(StartupSteps, name))]
    names = {name: f"startup_{name}" for name in own if not name.startswith("_")}
    around = {"observer": form.code, "standstill": form.low}
    parts = [(begin, end) for begin in around for end in ("start", "step")]
    names |= {f"{begin}_{end}": f"{around[begin]}_{end}" for begin, end in parts}
    functions = Functions(names=names)
    _declare(functions, form, drive, duty)
    reader = RecordReader(prefix, functions, Block("", set()))
    pi = PiGains(_NUMBER, _NUMBER, _NUMBER)
    gains = ControlGains(pi, pi, pi, ratio=_NUMBER, **dict.fromkeys(NUMBERS, _NUMBER))
    number, run = Expression("number"), Expression("run", kind="uint32_t")
    observer = _named(form.code, _Gains, "Gains")()
    reader.write("startup_init", steps.init, [drive])
    if form.low:
        low, step = _named(form.low, _Gains, "Gains")(), steps.step_from_standstill
        given = [gains, settings, observer, low, drive, sample, number, run]
        reader.write("startup_step", step, given, sentence(steps.step))
    else:
        given = [gains, settings, observer, drive, sample, number, run]
        reader.write("startup_step", steps.step, given)
    return functions


def _declare(functions: Functions, form: StartupForm, drive: Startup, duty: type[Any]) -> None:
    """Functions of the other headers, with what they change of their arguments."""
    none, nothing = type(None), frozenset[str]()
    control = frozenset(_places(drive.control))
    observer = frozenset(_places(drive.observer))
    told = [nothing] * (3 if form.hears else 2)
    known: dict[str, tuple[type[Any], list[frozenset[str]]]] = {
        "control_start": (none, [control]),
        "reset_integrals": (none, [frozenset({"d.integral", "q.integral"})]),
        "current_control": (duty, [nothing, control, nothing, nothing]),
        "speed_control": (duty, [nothing, control, nothing, nothing]),
        "duties": (duty, []),
        f"{form.code}_start": (none, [observer, nothing, nothing]),
        f"{form.code}_step": (none, [nothing, observer, *told]),
    }
    if drive.low is not None:
        low = frozenset(_places(drive.low))
        known[f"{form.low}_start"] = (none, [low, nothing, nothing])
        known[f"{form.low}_step"] = (none, [nothing, low, nothing, nothing])
    for name, (result, changes) in known.items():
        functions.results[name] = result
        functions.changes[name] = changes


def _places(record: Any, before: str = "") -> Iterator[str]:
    """Members of a record that are no records, as they are reached through it."""
    for member in fields(record):
        value = getattr(record, member.name)
        if hasattr(value, "__dataclass_fields__"):
            yield from _places(value, f"{before}{member.name}.")
        elif value is not None:
            yield f"{before}{member.name}"


def _enumerations(prefix: str, macro: str) -> Iterator[list[str]]:
    kinds: list[tuple[type[Any], Mapping[Any, str]]] = [
        (StartupState, STATES),
        (StartupFault, FAULTS),
    ]
    for kind, texts in kinds:
        names = [f"{macro}_STARTUP_{one.name}" for one in kind]
        names[0] += " = 0"
        names = [f"{name}," for name in names[:-1]] + names[-1:]
        most = max(map(len, names))
        lines = [
            f"    {name:{most}} /* {text} */" if text else f"    {name}"
            for name, text in zip(names, texts.values(), strict=True)
        ]
        yield [
            *comment(sentence(kind)),
            "typedef enum {",
            *lines,
            f"}} {prefix}_{c_name(kind)}_t;",
        ]


def _constants(settings: StartupSettings, prefix: str, macro: str) -> list[str]:
    """The settings of the design, each with its name and what it is."""
    lines = []
    for member, line in zip(fields(settings), record_values(settings, None), strict=True):
        text = said(StartupSettings, member.name)
        behind = f"{member.name}: {text}" if text else member.name
        lines.append(f"{line} /* {comment_text(behind)} */")
    return [
        f"static const {prefix}_startup_settings_t {macro}_STARTUP_SETTINGS = {{",
        *lines,
        "};",
    ]
