"""The control of a phase machine in fixed point in C, written from its steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.fixed_control.transforms import duty, speed_loop
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedPhaseControl,
    Measured,
    Vector,
    duties_type,
    phase_at_rest,
    phase_gains,
)
from dqforge.optimizer.fixed_phase_control.leg_steps import highest, lowest
from dqforge.optimizer.fixed_phase_control.phase_step import PhaseSteps
from dqforge.optimizer.fixed_phase_control.reference_steps import (
    ahead,
    bounded,
    code_product,
    control_start,
    currents_start,
    multiple,
    open_phase,
    zero,
)
from dqforge.optimizer.steps.code_vectors import Abc, AlphaBeta, Dq, Gain, Rotation
from dqforge.optimizer.steps.integer_arithmetic import magnitude
from dqforge.reports.control.fixed_text import pi_reader
from dqforge.reports.steps.code_reader import Code, CodeReader
from dqforge.reports.steps.code_text import (
    code_reader,
    constant_of,
    record_type,
    texts,
    vector_type,
    write,
)

# Stand for any, where names and types of members are asked for alone.
_ANY: Any = Code("number", kind="wide")
_GAIN, _ROTATION = Gain(_ANY, _ANY, _ANY), Rotation(_ANY, _ANY)
_VECTOR, _ABC, _DQ = Vector(_ANY, _ANY, _ANY), Abc(_ANY, _ANY, _ANY), Dq(_ANY, _ANY)
_THREE: Any = (_ANY, _ANY, _ANY)


def _measured(control: FixedPhaseControl) -> Measured[Any]:
    return Measured(_ABC, _ANY, _ANY, _ANY, _ANY if control.midpoint else None)


def phase_types(control: FixedPhaseControl, prefix: str) -> str:
    """Types of duty cycles and of vectors."""
    reader = code_reader(prefix, control.width)
    kind = duties_type(control.topology)
    said = f"Duty cycles of the legs; {2 ** (control.width - 1)} is 1."
    return "\n\n".join(
        [
            vector_type(reader, kind, said),
            vector_type(reader, Vector, "Alpha, beta and zero sequence (mean of the phases)."),
        ]
    )


def phase_text(control: FixedPhaseControl, prefix: str, macro: str) -> str:
    """Everything of the control behind its PI controllers.

    Args:
        control: The integers.
        prefix, macro: Before the names of functions and types, and of constants.
    """
    width, gains, state = control.width, phase_gains(control), phase_at_rest(control, _ANY)
    reader = code_reader(prefix, width, known=pi_reader(prefix, width).functions)
    form, form_name = reader.form.upper(), f"{macro}_SHAPE_{reader.form.upper()}"
    first = [
        record_type(reader, gains.shape),
        constant_of(reader, form_name, gains.shape),
        record_type(reader, gains.d),
        record_type(reader, gains),
        constant_of(reader, f"{macro}_CONTROL_GAINS_{form}", gains, {"shape": form_name}),
        record_type(reader, state),
        record_type(reader, _measured(control)),
    ]

    def put(function: Callable[..., Any], *arguments: Any) -> None:
        write(reader, function, *arguments)

    put(zero, width, _ABC)
    put(bounded, _ANY, _ANY, _ANY)
    put(magnitude, _ANY)
    put(code_product, width, "", _ANY, _ANY)
    put(currents_start, state)
    put(control_start, state)
    if control.has_zero:
        put(open_phase, state, _ANY)
    _write_steps(reader, control, gains, state)
    return "\n\n".join([*first, texts(reader)])


def _write_steps(reader: CodeReader, control: FixedPhaseControl, gains: Any, state: Any) -> None:
    """The functions of a sample."""
    width, steps, measured = control.width, PhaseSteps(control), _measured(control)
    references, legs = steps.references, steps.legs

    def put(function: Callable[..., Any], *arguments: Any) -> None:
        write(reader, function, *arguments)

    put(references.electrical, _ANY)
    if control.frame != "dq" or control.feedforward != "none":
        put(references.flux, gains.shape, _ANY)
        put(references.flux_vector, _ABC)
    if control.frame != "dq":
        put(references.reference_flux, gains.shape, _ANY, _ANY, _ANY)
        put(references.torque_currents, _GAIN, _ANY, _VECTOR)
    put(references.reference, gains, state, measured, _ANY, _ANY, _DQ)
    if control.harmonics:
        harmonics, turning = steps.harmonics, state.harmonic[0]
        put(harmonics.weight, _GAIN, _ANY, _ANY)
        args = gains.q, _GAIN, _ANY, turning, _ROTATION, _ROTATION, _ANY, _ANY
        put(harmonics.harmonic_voltage, *args)
        put(harmonics.harmonic_update, turning, _ANY, AlphaBeta(_ANY, _ANY), _ROTATION)
        put(multiple, width, _ANY, _ANY)
    if control.framed:
        put(steps.frames.frame, _VECTOR)
        put(steps.frames.frame_errors, _VECTOR, _VECTOR)
        put(steps.frames.frame_voltage, _VECTOR, _THREE)
    put(legs.phases, _VECTOR)
    put(highest, _THREE)
    put(lowest, _THREE)
    put(legs.demand, _THREE)
    put(legs.fitting, _VECTOR, _ANY)
    put(legs.shortened, _VECTOR, _VECTOR, _ANY)
    put(duty, width, _ANY)
    put(legs.duties, _VECTOR, _ANY, *([_ANY] if TOPOLOGIES[control.topology].midpoint else []))
    put(ahead, width, "", _ANY, _ANY)
    put(steps.shaped_control, gains, state, measured, _ANY, _DQ)
    put(steps.current_control, gains, state, measured, _DQ)
    put(references.sinusoids, gains, _ANY)
    put(speed_loop, width, gains, state, _ANY, _ANY)
    put(steps.torque_control, gains, state, measured, _ANY)
    put(steps.speed_control, gains, state, measured, _ANY)
