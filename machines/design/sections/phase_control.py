"""The keys of ``control.current_loop`` that are for machines with any back-EMF: what they need,
and what is said of them.
"""

from __future__ import annotations

import math

from dqforge.machines.design.sections.control import ControlSection
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine, SalientPhaseMachine
from dqforge.machines.topologies import (
    TOPOLOGIES,
    FrameChoice,
    choose_frame,
    controlled_frame,
    frame_obstacle,
    neutral_balance,
    tables_obstacle,
    uses_zero_sequence,
    zero_sequence_inductance,
)

# Keys of ``control.current_loop`` that other machines have no use for.
PHASE_KEYS = ("frame", "feedforward", "axis_gains", "harmonic_integrators", "limited_waveforms")

_MODULATORS: dict[Topology, str] = {
    "three-wire": "duty cycles centred between the highest and the lowest phase voltage",
    "four-leg": "duty cycles centred between the highest and the lowest of all phase voltages and "
    "zero, the neutral's leg with them",
    "six-leg": "each phase on a full bridge of its own, half its voltage on either leg",
    "six-leg-isolated": "full bridges on links of their own, voltages centred between the highest "
    "and the lowest",
    "split-capacitor": "each leg against the midpoint, whose measured voltage enters",
    "diode-neutral": "duty cycles as without a neutral, whose diodes carry no wanted current",
}


def check_phase_control(
    section: ControlSection,
    machine: AnyPhaseMachine | None,
    topology: Topology,
    export: ExportSection,
    document: YamlDocument,
) -> None:
    """Check the keys that are for machines with any back-EMF.

    ``machine`` is None for all others, ``export`` what is emitted.
    Raises `InputError` with a position.
    """
    loop, path = section.current_loop, ("control", "current_loop")
    obstacle = tables_obstacle(machine)
    if export.frame_tables and obstacle:
        message = f"export.frame_tables: {obstacle}"
        raise document.error(message, ("export", "frame_tables"), key=True)
    if machine is None:
        for key in PHASE_KEYS:
            if key in loop.model_fields_set:
                raise document.error(
                    f"control.current_loop.{key}: it serves machines of model: waveform; remove it",
                    (*path, key),
                    key=True,
                )
        return
    if loop.frame is not None:
        obstacle = frame_obstacle(loop.frame, machine, topology)
        if obstacle:
            message = f"control.current_loop.frame: {obstacle}"
            raise document.error(message, (*path, "frame"))
    if loop.feedforward == "measured" and not set(export.control) <= {"float32"}:
        message = (
            "control.current_loop.feedforward: measured is not there in fixed point; write "
            "references, or export.control: float32"
        )
        raise document.error(message, (*path, "feedforward"))
    if isinstance(machine, SalientPhaseMachine) and not set(export.control) <= {"float32"}:
        message = (
            "export.control: machines with inductance_harmonics are controlled in float32 alone; "
            "write float32"
        )
        raise document.error(message, ("export", "control"), key=True)
    frame = controlled_frame(loop.frame, machine, topology)
    if loop.limited_waveforms and frame != "table":
        raise document.error(
            "control.current_loop.limited_waveforms: currents that the link limits are a table "
            f"over the angle, the frame is {frame}; write frame: table, or remove it",
            (*path, "limited_waveforms"),
            key=True,
        )
    if loop.limited_waveforms and isinstance(machine, SalientPhaseMachine):
        raise document.error(
            "control.current_loop.limited_waveforms needs inductances that do not vary with the "
            "angle, this machine has inductance_harmonics; remove it",
            (*path, "limited_waveforms"),
            key=True,
        )


def phase_control_remarks(
    loop: CurrentLoopSettings, machine: AnyPhaseMachine | None, inverter: Inverter
) -> list[str]:
    """Sentences on the frame, the modulator and the zero sequence of a machine with any back-EMF.

    Empty for all others.
    """
    if machine is None:
        return []
    topology = inverter.topology
    choice = choose_frame(machine, topology)
    if loop.frame is not None:
        choice = FrameChoice(loop.frame, "as written")
    remarks = [
        f"control.current_loop.frame is {choice.frame}: {choice.reason}",
        f"inverter.topology {topology}: {_MODULATORS[topology]}",
    ]
    if TOPOLOGIES[topology].neutral:
        current = (
            "follows the reference of the torque"
            if uses_zero_sequence(choice.frame, topology)
            else "is held at zero"
        )
        gains = "gains of its own" if loop.axis_gains == "own" else "the gains of the q axis"
        remarks.append(f"the zero-sequence current {current}, by a PI controller with {gains}")
    if TOPOLOGIES[topology].midpoint and inverter.midpoint_capacitance is None:
        remarks.append(
            "inverter.midpoint_capacitance is not given: the midpoint of the link is taken as held"
        )
    if TOPOLOGIES[topology].midpoint and uses_zero_sequence(choice.frame, topology):
        remarks += _pulses_of_the_neutral(machine, inverter)
    return remarks


def _pulses_of_the_neutral(machine: AnyPhaseMachine, inverter: Inverter) -> list[str]:
    """A sentence where the pulses cost more copper in the neutral than its current saves."""
    if isinstance(machine, SalientPhaseMachine):
        return []
    l_0 = zero_sequence_inductance(machine, inverter.neutral_inductance)
    found = neutral_balance(machine, inverter.topology, inverter.v_dc, inverter.f_sw, l_0)
    torque = found.break_even
    saves = f"below {torque:.3g} N m" if math.isfinite(torque) else "at any torque"
    sentence = (
        f"inverter.topology {inverter.topology}: at standstill the pulses drive "
        f"{found.ripple:.3g} A (r.m.s.) through the neutral, {found.cost:.3g} W of copper; the "
        f"zero sequence saves {found.saved:.3g} W per (N m)^2, so that {saves} it costs more than "
        "it saves (frame dqx, or a larger inverter.switching_frequency, avoids that)"
    )
    return [sentence]
