"""The control functions in C, written from their steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from dqforge.machines.modulation.registry import METHODS, MODULATORS
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.optimizer.float_control.current_control import ControlSteps
from dqforge.optimizer.float_control.duties import Duties, centred_duties
from dqforge.optimizer.float_control.hexagon_step import overmodulation_step
from dqforge.optimizer.float_control.records import (
    NUMBERS,
    Control,
    ControlGains,
    Measured,
    Pi,
    PiGains,
    at_rest,
)
from dqforge.optimizer.float_control.speed_loop import speed_loop
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Dq, Rotation
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import member_name, record_structs
from dqforge.reports.steps.state_text import vector
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression

# Functions that steps call by their names: of `dqforge.reports.steps.control_types`, and those of
# `duty_functions`.
_SHARED_FUNCTIONS: dict[str, type[Any] | None] = {"small_rotation": Rotation, "turned": Rotation}
_DUTY_FUNCTIONS: dict[str, type[Any] | None] = {"centred_duties": Abc, "duties": Abc}

# That of `overmodulation_function`.
_OVERMODULATION: dict[str, type[Any] | None] = {"overmodulated": AlphaBeta}

_NUMBER: Any = 0.0  # Stands for any, where names and types of members are asked for alone.
_PI_GAINS = PiGains(_NUMBER, _NUMBER, _NUMBER)
_MEASURED = Measured(Abc(_NUMBER, _NUMBER, _NUMBER), _NUMBER, _NUMBER, _NUMBER)


def control_structs(gains: ControlGains, state: Control, prefix: str) -> dict[str, str]:
    """Types of the control: those of ``gains``, and those of ``state`` and samples; members that
    are None have no place.
    """
    known = set[str]()

    def text(*likes: Any) -> str:
        structs = (part for like in likes for part in record_structs(like, prefix, known=known))
        return "\n\n".join("\n".join(lines) for lines in structs)

    return {"gains": text(gains), "state": text(state, _MEASURED)}


def control_start(state: Control) -> list[str]:
    """Statements that put a state at rest."""
    return list(_zeros(state, "state->"))


def _zeros(record: Any, place: str) -> Iterator[str]:
    for member in fields(record):
        value, name = getattr(record, member.name), place + member_name(type(record), member.name)
        if is_dataclass(value):
            yield from _zeros(value, f"{name}.")
        elif isinstance(value, tuple):
            yield from (f"{name}.{axis} = 0.0F;" for axis in value._fields)  # type: ignore[attr-defined]
        elif value is not None:
            yield f"{name} = {'0U' if value.dtype == np.uint32 else '0.0F'};"


def control_functions(steps: ControlSteps, gains: ControlGains, state: Control, prefix: str) -> str:
    """Control of current, torque and speed, behind the duty cycles."""
    functions = Functions(results=_SHARED_FUNCTIONS | _DUTY_FUNCTIONS | _OVERMODULATION)
    reader = StepReader(prefix, functions, Block("", set()))
    reference, number = vector(Dq, "reference"), Expression("number")
    reader.write("current_control", steps.current_control, [gains, state, _MEASURED, reference])
    reader.write("torque_control", steps.torque_control, [gains, state, _MEASURED, number])
    reader.write("speed_control", steps.speed_control, [gains, state, _MEASURED, number])
    return "\n\n".join(functions.texts.values())


def pi_structs(prefix: str) -> str:
    """Types of a PI controller: gains and state."""
    likes: list[Any] = [_PI_GAINS, Pi(_NUMBER)]
    return "\n\n".join("\n".join(part) for like in likes for part in record_structs(like, prefix))


def speed_loop_functions(prefix: str) -> str:
    """The speed loop and the functions of its controller, for gains and state of any control that
    has its members.
    """
    functions = Functions()
    reader = StepReader(prefix, functions, Block("", set()))
    numbers = dict.fromkeys(NUMBERS, _NUMBER)
    gains = ControlGains(_PI_GAINS, _PI_GAINS, _PI_GAINS, ratio=_NUMBER, **numbers)
    number = Expression("number")
    reader.write("speed_loop", speed_loop, [gains, at_rest(1, None), number, number])
    return "\n\n".join(functions.texts.values())


def duty_functions(modulation: ModulationName, prefix: str) -> str:
    """Duty cycles of three legs by a modulator."""
    rule, functions = MODULATORS[modulation], Functions()
    reader = StepReader(prefix, functions, Block("", set()))
    voltage, i, v_dc = vector(AlphaBeta, "voltage"), vector(AlphaBeta, "i"), Expression("v_dc")
    begin = f"Duty cycles 0 to 1 of the upper switches by {rule.name}, for a voltage in V"
    if rule.kind == "centred":
        said = (
            f"{begin} that is 0 where v_dc is not above 0; {rule.text}; one half each without "
            "voltage."
        )
        reader.write("centred_duties", centred_duties, [voltage, v_dc], said)
        said = "The same for any voltage; one half each without DC-link voltage."
    else:
        said = f"{begin} and currents in A; {rule.text}; one half each without DC-link voltage."
    reader.write("duties", Duties(modulation).duties, [voltage, v_dc, i], said)
    return "\n\n".join(functions.texts.values())


def overmodulation_function(name: OvermodulationName, prefix: str) -> str:
    """The voltage that the duty cycles make of one beyond the circle in the hexagon, empty where
    none goes there.
    """
    step = overmodulation_step(name)
    if step is None:
        return ""
    said = (
        "Voltage in V that the duty cycles make of one that may lie beyond the circle in the "
        f"voltage hexagon, by {name}: {METHODS[name].text}. Its fundamental is the one asked for, "
        "up to six-step operation. Within the circle, without DC-link voltage and for what is not "
        "a number nothing is changed."
    )
    functions = Functions()
    reader = StepReader(prefix, functions, Block("", set()))
    voltage = vector(AlphaBeta, "voltage"), Expression("v_dc")
    reader.write("overmodulated", step, voltage, said)
    return functions.texts["overmodulated"]
