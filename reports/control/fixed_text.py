"""The control functions in fixed point in C, written from their steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dqforge.optimizer.fixed_control.transforms import (
    IDLE,
    Control,
    ControlGains,
    FixedControl,
    FixedDecoupling,
    FixedPi,
    Measured,
    Pi,
    PiForm,
    PiVelocity,
    ReducedOrder,
    code_load_turn,
    control_at_rest,
    decoupling,
    duty,
    pi_gains,
    pi_integral,
    pi_output,
    pi_step,
    pi_update,
    pi_velocity_step,
    reduced_order_gains,
    reduced_order_step,
    speed_loop,
)
from dqforge.optimizer.steps.code_vectors import Abc, AlphaBeta, Dq, Duties, Feedforward
from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.steps.code_reader import Code, CodeReader
from dqforge.reports.steps.code_text import (
    NO_GAIN,
    basics_reader,
    code_reader,
    constant_of,
    record_type,
    shortening_reader,
    texts,
    vector_type,
    write,
)
from dqforge.reports.steps.record_text import comment

# Stand for any, where names and types of members are asked for alone.
_ANY: Any = Code("number", kind="wide")
_PI_GAINS = pi_gains(16, IDLE)
_DECOUPLING = FixedDecoupling(NO_GAIN, NO_GAIN, NO_GAIN)
_GAINS = ControlGains(
    _PI_GAINS, _PI_GAINS, _DECOUPLING, NO_GAIN, NO_GAIN, NO_GAIN, _PI_GAINS, 0, 0, 0
)
_DQ, _ALPHA_BETA, _ABC = Dq(_ANY, _ANY), AlphaBeta(_ANY, _ANY), Abc(_ANY, _ANY, _ANY)
_MEASURED = Measured(_ABC, _ANY, _ANY, _ANY)


def _state() -> Control[Any]:
    return control_at_rest(_ANY)


def pi_reader(prefix: str, width: int) -> CodeReader:
    """Functions of PI controllers behind the basic ones."""
    reader = code_reader(prefix, width, known=basics_reader(prefix, width).functions)
    state: Any = Pi(_ANY)
    write(reader, pi_integral, _PI_GAINS, state, _ANY)
    write(reader, pi_output, _PI_GAINS, _ANY, _ANY)
    write(reader, pi_update, _PI_GAINS, state, _ANY, _ANY)
    write(reader, pi_step, _PI_GAINS, state, _ANY, _ANY)
    write(reader, pi_velocity_step, _PI_GAINS, PiVelocity(_ANY, _ANY), _ANY, _ANY)
    return reader


def pi_text(
    prefix: str,
    macro: str,
    width: int,
    loops: Mapping[str, Mapping[PiForm, FixedPi]],
    said: Sequence[str],
) -> str:
    """PI controllers: types, functions and the gains of loops.

    Args:
        prefix, macro: Before the names of functions and types, and of constants.
        width: Bits of a code.
        loops: Controllers in their forms by the names of their constants.
        said: Lines about them.
    """
    reader = pi_reader(prefix, width)
    form = reader.form.upper()
    head = "PI controllers: ki and tracking lead to a state that has so many more bits than a code."
    lines = [f"/* {head}", *(f" * {comment_text(line)}" for line in said), " */"]
    gains = record_type(reader, _PI_GAINS).split("\n")
    typed = "\n".join([*lines, *gains[gains.index("typedef struct {") :]])
    constants = [
        constant_of(reader, f"{macro}_{name}_{between}GAINS_{form}", pi_gains(width, own))
        for name, forms in loops.items()
        for between, own in (("", forms["parallel"]), ("VELOCITY_", forms["velocity"]))
    ]
    types = [record_type(reader, like) for like in (Pi(_ANY), PiVelocity(_ANY, _ANY))]
    return "\n\n".join([typed, *types, "\n".join(constants), texts(reader)])


def _observer_text(control: FixedControl, prefix: str, macro: str) -> list[str]:
    """The reduced-order observer."""
    assert control.observer is not None
    width = control.width
    reader = code_reader(prefix, width, known=basics_reader(prefix, width).functions)
    gains = reduced_order_gains(width, control.observer)
    state: Any = ReducedOrder(_ANY, _ANY, _DQ)
    write(reader, reduced_order_step, width, gains, state, _DQ, _DQ)
    name, kind = f"{macro}_REDUCED_ORDER_GAINS_{reader.form.upper()}", reader.words
    start = [
        f"static inline void {reader.function_name('reduced_order_start')}(",
        f"    {reader.type_name('reduced_order')} *state, {kind.of('code')} omega_m)",
        "{",
        f"    state->zeta = ({kind.wide})omega_m * (({kind.wide})1 << {name}.fraction);",
        "    state->omega_m = omega_m;",
        "    state->i.d = 0;",
        "    state->i.q = 0;",
        "}",
    ]
    return [
        record_type(reader, gains),
        record_type(reader, state),
        constant_of(reader, name, gains),
        "\n".join(start),
        texts(reader),
    ]


def _start(reader: CodeReader) -> str:
    """What puts the state of the control at rest."""
    members = [
        *(f"{own}.integral" for own in ("d", "q", "speed")),
        *(f"{own}.{axis}" for own in ("reference", "i", "v_dq") for axis in ("d", "q")),
        *("v.alpha", "v.beta", "filtered", "omega_m", "torque"),
    ]
    name = reader.function_name("control_start")
    return "\n".join(
        [
            *comment(
                "Everything at rest: no torque, no voltage. Call it before the first sample and "
                "after every pulse lock."
            ),
            f"static inline void {name}({reader.type_name('control')} *state)",
            "{",
            *(f"    state->{member} = 0;" for member in members),
            "    state->count = 0U;",
            "}",
        ]
    )


def control_text(control: FixedControl, prefix: str, macro: str) -> str:
    """Everything of the control behind its PI controllers.

    Args:
        control: The integers.
        prefix, macro: Before the names of functions and types, and of constants.
    """
    width, steps, rule = control.width, control.steps, control.modulator
    known = pi_reader(prefix, width).known_functions
    reader = code_reader(prefix, width, known=shortening_reader(prefix, width).functions)
    reader.known_functions.take(known)
    parts = [
        record_type(reader, _DECOUPLING),
        vector_type(reader, Feedforward, "What the feedforward adds to the voltage."),
    ]
    write(reader, decoupling, width, _DECOUPLING, _ANY, _DQ)
    parts.append(texts(reader))
    reader.functions.texts.clear()
    if control.observer is not None:
        parts += _observer_text(control, prefix, macro)
    write(reader, duty, width, _ANY)
    write(reader, steps.duties.shares, _ALPHA_BETA, _ANY)
    if rule.compared == "load angle":
        write(reader, code_load_turn, width, _ALPHA_BETA, _ALPHA_BETA)
    said = f"Duty cycles with the zero sequence of {rule.name}; v_dc must be positive."
    write(reader, steps.duties.duties, _ALPHA_BETA, _ANY, _ABC, text=said)
    parts.append(texts(reader))
    reader.functions.texts.clear()
    gains = control.gains
    parts += [
        record_type(reader, gains),
        record_type(reader, _state()),
        record_type(reader, _MEASURED),
        constant_of(reader, f"{macro}_CONTROL_GAINS_{reader.form.upper()}", gains),
        _start(reader),
    ]
    write(reader, steps.current_control, gains, _state(), _MEASURED, _DQ)
    write(reader, speed_loop, width, gains, _state(), _ANY, _ANY)
    if control.reference is not None:
        reader.known_functions.argument_kinds["reference"] = [reader.words.of("code")] * 3
        write(reader, steps.torque_control, gains, _state(), _MEASURED, _ANY)
        write(reader, steps.speed_control, gains, _state(), _MEASURED, _ANY)
    return "\n\n".join([*parts, texts(reader)])


def duties_type(prefix: str, width: int) -> str:
    """The type of duty cycles."""
    said = f"Duty cycles of the upper switches; {2 ** (width - 1)} is 1."
    return vector_type(code_reader(prefix, width), Duties, said)
