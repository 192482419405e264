"""The C header of the start-up, as text; functions and types are written from its steps."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, fields, is_dataclass, make_dataclass
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np

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
from dqforge.optimizer.start_up.start_parts import Neighbours
from dqforge.optimizer.start_up.start_records import (
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
)
from dqforge.optimizer.start_up.step import StartupSteps
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic, Dq
from dqforge.reports.c_code.harness import title
from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.observers.float32_model import EmittedTracker
from dqforge.reports.observers.position_header import plain_tracker_gains, tracker_files
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.emitted_integers import phase_control_of
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.start_up.float32_reading import MEMBERS
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import (
    c_name,
    enumeration,
    record_structs,
    record_values,
    said,
    sentence,
    whole_of,
)
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Condition, Expression

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.solution import Solution
    from dqforge.optimizer.start_up.plan import StartUpPlan
    from dqforge.optimizer.start_up.solve import StartUp


_P = ParamSpec("_P")
_T = TypeVar("_T")

_NUMBER: Any = 0.0  # Stands for any, where names and types of members are asked for alone.

LOW_FILE = "start_observer"  # End of the file name of the estimator from standstill on.

_WORDS = {
    "i-f": "a current that turns, at the angle of the ramp",
    "v-f": "a voltage that turns, at the angle of the ramp",
    "direct": "from the alignment into the observer",
    "saliency": "the rotor found by its saliency",
}

_ALIGNMENT_WORDS = {
    "none": "no alignment",
    "one-step": "alignment in one step",
    "two-step": "alignment in two steps",
    "voltage": "alignment by a voltage",
}


def method_words(found: StartUp) -> str:
    """How the drive starts, in words.

    Args:
        found: The start.
    """
    plan = found.plan
    flying = "; a rotor that turns already is caught" if plan.flying else ""
    return f"{_WORDS[plan.method]} ({plan.method}), {_ALIGNMENT_WORDS[plan.alignment]}{flying}"


def load_words(found: StartUp) -> str:
    """Largest load torques, in words.

    Args:
        found: The start.
    """
    others = ", ".join(f"{name} {torque:.4g} N m" for name, torque in found.largest_loads.items())
    return (
        f"largest load torque {found.largest_load:.4g} N m ({found.plan.load_torque:.4g} N m asked "
        f"for); at the current limit: {others}"
    )


def _preamble(found: StartUp, prefix: str) -> list[str]:
    plan = found.plan
    hertz = plan.hand_over / (2.0 * math.pi)
    return [
        *wrap(f"Start: {method_words(found)}; the observer rules from {hertz:.4g} Hz.", 110),
        *wrap(f"It lifts: {load_words(found)}.", 110),
        "",
        f"Call {prefix}_startup_init() once, then {prefix}_startup_step() at every current sample:",
        "it replaces the speed control and calls the observer. State and fault are members of the",
        "structure, which is yours. All settings can be changed: copy the constant structure.",
        "Compile with -ffp-contract=off to equal the model bit for bit.",
    ]


def estimator_at_speed(gains: GainSet) -> tuple[str, bool]:
    """Part of C names of the estimator that a drive runs on after its start, and whether it is told
    the sum of the phase voltages.

    Args:
        gains: Of the design.
    """
    if gains.tracker is not None:
        return gains.tracker.tracker.code, bool(gains.tracker.tracker.hears)
    assert gains.position is not None, "a start has an estimator of the position"
    return gains.position.method.code, False


def _form(solution: Solution, found: StartUp) -> StartupForm:
    """What the C of a start depends on."""
    control, references = phase_control_of(solution), solution.gains.references
    code, hears = estimator_at_speed(solution.gains)
    moving = (False, False)
    if references is not None:
        moving = math.isfinite(references.torque_step), math.isfinite(references.current_step)
    return StartupForm(
        code,
        low="" if found.low is None else found.low.tracker.code,
        hears=hears,
        feedforward=None if control is None else control.feedforward,
        by_torque=control is not None and control.frame != "dq",
        moving=moving,
    )


def start_up_files(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_startup.h``.

    Args:
        solution: The solved design.
        found: Its start.
    """
    prefix = solution.design.export.prefix
    form, settings = _form(solution, found), StartupSettings.of(found.plan)
    files = ["control", "observer", *(["start_observer"] if found.low is not None else [])]
    context: PlainData = {
        **title(solution.design),
        "part": "startup",
        "subject": "from standstill to speed without an encoder,",
        "preamble": _preamble(found, prefix),
        "includes": [
            *(f'"{prefix}_{name}.h"' for name in files),
            "<math.h> /* sqrtf, fabsf */",
            "<stdbool.h>",
            "<stdint.h>",
        ],
        "body": startup_text(form, settings, prefix, prefix.upper()),
        "vectors": False,
    }
    return {f"{prefix}_startup.h": render("c_code/header.h.j2", context).encode("ascii")}


def start_observer_files(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_start_observer.h``; none without an estimator from standstill.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return {} if found.low is None else tracker_files(solution.design, found.low, LOW_FILE)


def every_start_file(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Names and bytes of the headers of a start.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return start_up_files(solution, found) | start_observer_files(solution, found)


def plain_start_up(solution: Solution, found: StartUp) -> PlainData:
    """The settings, and what the state machine is tried with, as plain data of float32 values.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return {
        "v_dc": solution.design.inverter.v_dc,
        "settings": {
            name: value if isinstance(value, int) else shortest(np.float32(value))
            for name, value in settings_of(found.plan).items()
        },
    }


def plain_start_observer(found: StartUp) -> PlainData | None:
    """The estimator from standstill on as plain data, None without one.

    Args:
        found: The start.
    """
    low = found.low
    return None if low is None else plain_tracker_gains(EmittedTracker(low.tracker, low.gains))


def settings_of(plan: StartUpPlan) -> dict[str, float]:
    """Values of all members by name, whole numbers as int.

    Args:
        plan: What the start needs.
    """
    return asdict(StartupSettings.of(plan))


def settings_bytes(plan: StartUpPlan) -> bytes:
    """Bytes of ``<prefix>_startup_settings_t`` on this machine.

    Args:
        plan: What the start needs.
    """
    values = settings_of(plan)
    form = "".join("I" if member.whole else "f" for member in MEMBERS)
    return struct.pack(f"={form}", *(values[member.name] for member in MEMBERS))


# The text of the C: its types, constants and functions.


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
    drive = _drive(form)
    duty: type[Any] = Abc if form.feedforward is None else Duties
    sample = StartupSample(Abc(_NUMBER, _NUMBER, _NUMBER), _NUMBER, _NUMBER if form.hears else None)
    output = StartupOutput(duty(_NUMBER, _NUMBER, _NUMBER), _NUMBER)
    functions = _functions(form, settings, drive, sample, prefix, duty)
    known = {c_name(type(record)) for record, _ in leaves(drive)} - {"startup"}
    known |= {"control", "references"}
    parts = [
        enumeration(StartupState, STATES, prefix),
        enumeration(StartupFault, FAULTS, prefix),
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
        d=Pi(_NUMBER),
        q=Pi(_NUMBER),
        speed=Pi(_NUMBER),
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
    return Startup.blank(control, observer, low, _NUMBER)


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


# Records that a function of the C keeps for itself.


class RecordReader(StepReader):
    """A reader whose functions declare records by `let`, in their outermost block; they change
    them, hand them on by their address and return them.
    """

    def inside(self, function: Callable[..., Any], names: Sequence[str]) -> StepReader:  # noqa: ARG002
        """The reader of a function with parameters of these names."""
        return RecordReader(self.prefix, self.functions, Block("    ", set(names)))

    def _named(self, name: str, value: Any, meaning: str) -> Any:
        if not is_dataclass(value) or isinstance(value, Condition):
            return self._local(name, value, meaning)
        self.block.take(name)
        self.block.variable(self.type_name(c_name(type(value))), name)
        found = self._record(value, f"&{name}", f"{name}.", frozenset())
        for member in fields(value):
            setattr(found, member.name, getattr(value, member.name))
        self.write_state()
        return found

    def _local(self, name: str, value: Any, meaning: str) -> Any:
        """A constant where declarations still stand, behind statements a variable that is set."""
        vector = isinstance(value, tuple) and hasattr(value, "_fields")
        if self.block.declared is None or not (vector or isinstance(value, Expression | Condition)):
            found = super()._named(name, value, meaning)
            _written(value)
            return found
        kind = self._kind(value)
        self.block.take(name)
        self.block.variable(kind, name)
        self._assign(name, value)
        return self.vector(type(value), name) if vector else self.number_of(name, kind)

    def _assign(self, name: str, value: Any) -> None:
        super()._assign(name, value)
        _written(value)

    def call(
        self,
        function: Callable[Concatenate[Arithmetic, _P], _T],
        *args: _P.args,
        **kwargs: _P.kwargs,
    ) -> _T:
        """A call, whose result may be a condition."""
        found = super().call(function, *args, **kwargs)
        if isinstance(found, Condition) and self._open is not None:
            (self._open,) = found.terms
            self._open.uses[0] = 0
        return found

    def write_state(self) -> None:
        """Write what the step has made of its state, vectors of calls as a whole."""
        for kept in self._kept:
            if kept.set_to is not kept.value:
                _written(kept.set_to)
        super().write_state()

    def returned(self, result: Any, into: Sequence[str] = ()) -> tuple[str, list[str]]:
        """Type of what a function returns, and the statements that return it."""
        place = self._place(result)
        if place is None:
            return super().returned(result, into)
        name = place[0].removeprefix("&")
        return self.type_name(c_name(type(result))), [f"{self.block.indent}return {name};"]


def _written(value: Any) -> None:
    """Count that a vector of a call has been written as a whole."""
    if isinstance(value, tuple) and whole_of(value):
        value[0].uses[0] += 1
