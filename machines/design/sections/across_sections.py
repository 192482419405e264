"""What sections of a design ask of each other: the topology of the inverter, the program around
the functions, a six-step drive, a regulator that switches the bridge, and the control of
phases.
"""

from __future__ import annotations

import math
from typing import get_args

from dqforge.machines.design.sections.control import ControlSection
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.sections.inverter import InverterSection
from dqforge.machines.design.sections.modulation_choice import ChoiceSection
from dqforge.machines.design.sections.observer import SixStepSection
from dqforge.machines.design.sections.operation import OperationSection
from dqforge.machines.design.sections.simulation import SimulationSection
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError, KeyPath
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    ANALOGUE_METHODS,
    SIX_STEP_METHODS,
    SPEED_OBSERVER,
    FeedbackMethod,
    Topology,
)
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine, SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import (
    TOPOLOGIES,
    FrameChoice,
    choose_frame,
    contradiction,
    controlled_frame,
    frame_obstacle,
    neutral_balance,
    tables_obstacle,
    uses_zero_sequence,
    zero_sequence_inductance,
)


def check_topology(
    inverter: InverterSection,
    operation: OperationSection,
    choice: ChoiceSection | None,
    used_by: str,
    document: YamlDocument,
) -> None:
    """Check the keys that only some topologies have.

    ``used_by`` names what the midpoint of a split link is needed for, empty where for nothing.
    Raises `InputError` with a position.
    """
    _check_neutral(inverter, used_by, document)
    if TOPOLOGIES[inverter.topology].modulated:
        return
    found = contradiction("operation.modulation", inverter.topology, operation.modulation)
    if found:
        raise document.error(found, ("operation", "modulation"))
    if choice is not None:
        message = (
            f"modulation_choice: {inverter.topology} has its own modulator, so there is "
            "none to choose; remove the section"
        )
        raise document.error(message, ("modulation_choice",), key=True)


def _check_neutral(inverter: InverterSection, used_by: str, document: YamlDocument) -> None:
    """Check that the neutral's parts are there where they are needed, and nowhere else."""
    rule, name = TOPOLOGIES[inverter.topology], inverter.topology
    if inverter.neutral_inductance is not None and "n" not in rule.legs:
        raise _misplaced("neutral_inductance", "neutral on a fourth leg", name, document)
    conducting = "n" in rule.legs or rule.midpoint or rule.diodes
    if inverter.neutral_resistance is not None and not conducting:
        raise document.error(
            f"inverter.neutral_resistance: {name} has no conductor from the star point; remove the "
            "key",
            ("inverter", "neutral_resistance"),
            key=True,
        )
    if inverter.midpoint_capacitance is not None and not rule.midpoint:
        raise _misplaced("midpoint_capacitance", "link in two halves", name, document)
    if rule.midpoint and used_by and inverter.midpoint_capacitance is None:
        message = (
            f"inverter.topology: {name} needs midpoint_capacitance for {used_by}; write "
            "midpoint_capacitance: 4.7 mF, both halves of the link together"
        )
        raise document.error(message, ("inverter", "topology"))


def _misplaced(key: str, what: str, name: Topology, document: YamlDocument) -> InputError:
    other = next(
        topology
        for topology, rule in TOPOLOGIES.items()
        if (rule.midpoint if key == "midpoint_capacitance" else "n" in rule.legs)
    )
    return document.error(
        f"inverter.{key}: {name} has no {what}; remove the key, or write topology: {other}",
        ("inverter", key),
        key=True,
    )


# What ``export.application`` needs of the other sections.


def _sees_the_angle(control: ControlSection) -> bool:
    """Whether the observer makes the speed from the angle of an encoder."""
    return control.observer is not None and control.observer.method == SPEED_OBSERVER


def check_application(
    control: ControlSection,
    export: ExportSection,
    document: YamlDocument,
    *,
    any_back_emf: bool,
    lines: int,
) -> None:
    """Check that the program around the functions has what it calls.

    ``any_back_emf`` says that the machine is one of model: waveform; ``lines`` are those of the
    simulated encoder, 0 without one. Raises `InputError` with a position.
    """
    if export.application is None:
        return
    loop = control.speed_loop
    if any_back_emf:
        message = "the program is for machines with a sinusoidal back-EMF; remove it"
    elif "float32" not in export.formats or loop is None:
        message = (
            "the program calls the speed control in float32; write export.control: float32 and "
            "control.speed_loop"
        )
    elif control.six_step is not None or not (
        control.start_up or loop.measurement or (_sees_the_angle(control) and lines)
    ):
        message = (
            "the program needs control.start_up, or an encoder by control.speed_loop.measurement, "
            "or by simulation.encoder.lines where control.observer makes the speed; write one of "
            "them"
        )
    else:
        return
    raise document.error(f"export.application: {message}", ("export", "application"))


# What a six-step drive cannot do, and where the design file asks for it.


@dataclass(frozen=True, slots=True)
class BlockSections:
    """The sections of a design file that a six-step drive looks at; ``named`` are those that the
    file has.
    """

    control: ControlSection
    inverter: InverterSection
    export: ExportSection
    simulation: SimulationSection | None
    named: frozenset[str]


def _refusals(file: BlockSections) -> list[tuple[KeyPath, str]]:
    """Keys that a six-step drive does not use, with what to write instead."""
    control, inverter = file.control, file.inverter
    loop, speed = control.current_loop, control.speed_loop
    found: list[tuple[bool, KeyPath, str]] = [
        (bool(file.export.control), ("export", "control"), "it has its own control functions"),
        (bool(file.export.firmware), ("export", "firmware"), "that firmware runs vector control"),
        ("field_weakening" in file.named, ("field_weakening",), "blocks weaken no field"),
        ("losses" in file.named, ("losses",), "the loss budget is that of sinusoidal currents"),
        ("modulation_choice" in file.named, ("modulation_choice",), "it has one modulator"),
        (control.references is not None, ("control", "references"), "it has no dq references"),
        (control.firmware is not None, ("control", "firmware"), "that firmware has no blocks"),
        (control.tolerances is not None, ("control", "tolerances"), "they are not evaluated here"),
        (not control.gains, ("control", "gains"), "its loops are tuned"),
        (loop.schedule, ("control", "current_loop", "schedule"), "its gains are constant"),
        (inverter.topology != "three-wire", ("inverter", "topology"), "the star point floats"),
        (
            speed is not None and speed.method not in ("symmetrical-optimum", "given"),
            ("control", "speed_loop", "method"),
            "write symmetrical-optimum or given",
        ),
        (
            speed is not None and speed.filter_time is not None,
            ("control", "speed_loop", "filter_time"),
            "the speed comes six times per turn, unfiltered",
        ),
    ]
    return [(path, why) for refused, path, why in found if refused]


def _simulated(file: BlockSections) -> list[tuple[KeyPath, str]]:
    """The same of its simulation, which starts at rest without an encoder."""
    wanted = file.simulation
    if wanted is None:
        return []
    found: list[tuple[bool, KeyPath, str]] = [
        (wanted.current is not None, ("simulation", "current"), "write speed or torque"),
        (wanted.sensorless is not None, ("simulation", "sensorless"), "it never has an encoder"),
        (
            "encoder" in wanted.model_fields_set,
            ("simulation", "encoder"),
            "it never has an encoder",
        ),
        (
            wanted.speed is not None and file.control.speed_loop is None,
            ("simulation", "speed"),
            "write control.speed_loop",
        ),
    ]
    return [(path, why) for refused, path, why in found if refused]


def _check_diodes(section: SixStepSection, document: YamlDocument) -> None:
    for name in ("voltage_noise", "filter_time"):
        if getattr(section, name) is not None:
            raise document.error(
                f"control.six_step.{name}: the observer diode-conduction sees whether a diode "
                "conducts, not a voltage; omit it",
                ("control", "six_step", name),
                key=True,
            )


def check_six_step(file: BlockSections, document: YamlDocument) -> bool:
    """Check what a six-step drive cannot do, and say whether the design is one.

    Raises `InputError` with a position.
    """
    control, path = file.control, ("control", "six_step")
    method = None if control.observer is None else control.observer.method
    if method not in SIX_STEP_METHODS:
        if control.six_step is not None:
            raise document.error(
                "control.six_step is for the observers that make a six-step drive; write "
                "control.observer: {method: zero-crossing}, emf-integration or diode-conduction, "
                "or omit it",
                path,
                key=True,
            )
        return False
    if method == "diode-conduction" and control.six_step is not None:
        _check_diodes(control.six_step, document)
    for where, why in (*_refusals(file), *_simulated(file)):
        raise document.error(
            f"{'.'.join(map(str, where))}: a six-step drive (control.observer: {method}) does not "
            f"use it: {why}; omit it, or write another observer",
            where,
            key=True,
        )
    sampling, switching = control.sampling_frequency, file.inverter.switching_frequency
    if sampling is not None and abs(sampling.si / switching.si - 1.0) > 1e-9:
        raise document.error(
            f"control.sampling_frequency: {sampling.text}: a six-step drive samples once per "
            f"carrier period, in its middle; write {switching.text}, or omit it",
            ("control", "sampling_frequency"),
        )
    return True


# Current loops that switch the bridge themselves: which keys they take, and what they exclude.

_PATH = ("control", "current_loop")

# The keys that a method takes beside ``method``.
_KEYS: dict[str, tuple[str, ...]] = {
    "hysteresis": ("band",),
    "ramp-comparison": ("kp", "ki", "carrier", "comparator_band"),
    "look-up-table": ("band", "outer_band", "sampling"),
    "trajectory": ("sampling", "pulses"),
    "circle": ("band", "sampling"),
    "predictive": ("sampling",),
}


_OWN = ("band", "outer_band", "carrier", "comparator_band", "sampling", "pulses")


@dataclass(frozen=True, slots=True)
class Asked:
    """Sections of a file on which current-feedback PWM bears."""

    control: ControlSection
    inverter: InverterSection
    operation: OperationSection
    export: ExportSection
    simulation: SimulationSection | None


def check_feedback(
    file: Asked, machine: Machine, document: YamlDocument, *, any_back_emf: bool
) -> None:
    """Check the keys of current-feedback PWM, and what does not go with it.

    Raises `InputError` with a position.
    """
    loop = file.control.current_loop
    if loop.method not in get_args(FeedbackMethod):
        for key in _OWN:
            if getattr(loop, key) is not None:
                users = " or ".join(name for name, keys in _KEYS.items() if key in keys)
                raise document.error(
                    f"control.current_loop: the method '{loop.method}' does not use '{key}'; "
                    f"write method: {users}, or remove the key",
                    (*_PATH, key),
                    key=True,
                )
        return
    _check_keys(file, document)
    _check_drive(file, machine, document, any_back_emf=any_back_emf)
    _check_rest(file, document)
    _check_simulation(file, document)


def _check_keys(file: Asked, document: YamlDocument) -> None:
    loop = file.control.current_loop
    used = _KEYS[loop.method]
    for key in sorted(loop.model_fields_set - {"method", *used}):
        raise document.error(
            f"control.current_loop: the method '{loop.method}' does not use '{key}'; remove it (it "
            f"uses {', '.join(used)})",
            (*_PATH, key),
            key=True,
        )
    if loop.band is not None and loop.outer_band is not None and loop.outer_band.si < loop.band.si:
        raise document.error(
            f"control.current_loop.outer_band {loop.outer_band.text} is less than band "
            f"{loop.band.text}; write band or more",
            (*_PATH, "outer_band"),
        )
    if loop.pulses is not None and loop.pulses % 2 == 0:
        raise document.error(
            f"control.current_loop.pulses {loop.pulses} is even; patterns of a leg have odd "
            f"numbers of pulses: write {loop.pulses - 1} or {loop.pulses + 1}",
            (*_PATH, "pulses"),
        )
    if loop.sampling is not None and loop.sampling.si < 2.0 * file.inverter.switching_frequency.si:
        raise document.error(
            f"control.current_loop.sampling {loop.sampling.text} is too slow to switch by; write "
            "twice the switching frequency or more",
            (*_PATH, "sampling"),
        )


def _check_drive(
    file: Asked, machine: Machine, document: YamlDocument, *, any_back_emf: bool
) -> None:
    method = file.control.current_loop.method
    wrong = ""
    if any_back_emf or not isinstance(machine, LinearMachine):
        wrong = "works on a machine of model: linear; write another method"
    elif file.inverter.topology != "three-wire":
        wrong = f"works on topology: three-wire, not {file.inverter.topology}; write another method"
    elif not machine.l_d > 0.0 or not machine.l_q > 0.0:
        wrong = "needs positive inductances"
    if wrong:
        raise document.error(
            f"control.current_loop: the method '{method}' {wrong}", (*_PATH, "method")
        )


def _check_rest(file: Asked, document: YamlDocument) -> None:
    """Sections that need the gains of PI current loops, or a modulator."""
    control, method = file.control, file.control.current_loop.method
    asked: list[tuple[bool, KeyPath, str]] = [
        (control.observer is not None, ("control", "observer"), "remove it"),
        (control.tolerances is not None, ("control", "tolerances"), "remove it"),
        (control.references is not None, ("control", "references"), "remove it"),
        (control.firmware is not None, ("control", "firmware"), "remove it"),
        (control.six_step is not None, ("control", "six_step"), "remove it"),
        (control.start_up is not None, ("control", "start_up"), "remove it"),
        (
            control.speed_loop is not None and control.speed_loop.measurement is not None,
            ("control", "speed_loop", "measurement"),
            "remove it",
        ),
        (
            control.speed_loop is None and bool(file.export.control),
            ("export", "control"),
            "remove it, or add the speed loop that it would hold",
        ),
        (
            not set(file.export.control) <= {"float32"},
            ("export", "control"),
            "write float32, which has the speed loop over the regulator",
        ),
        (bool(file.export.firmware), ("export", "firmware"), "remove it"),
        (file.operation.overmodulation != "none", ("operation", "overmodulation"), "remove it"),
    ]
    for wanted, path, remedy in asked:
        if wanted:
            raise document.error(
                f"{'.'.join(map(str, path))} needs PI current loops and a modulator, and "
                f"control.current_loop is by '{method}'; {remedy}",
                path,
                key=True,
            )


def _check_simulation(file: Asked, document: YamlDocument) -> None:
    """What a simulation of such a drive cannot have."""
    wanted, method = file.simulation, file.control.current_loop.method
    if wanted is None:
        return
    sensor, analogue = wanted.current_sensor, method in ANALOGUE_METHODS
    asked: list[tuple[bool, KeyPath, str]] = [
        (
            "inverter" in wanted.model_fields_set and wanted.inverter == "averaged",
            ("simulation", "inverter"),
            "has no duty cycles to average; write switched, or remove it",
        ),
        (
            wanted.sensorless is not None,
            ("simulation", "sensorless"),
            "has no position observer; remove it",
        ),
        (
            analogue and sensor.bits > 0,
            ("simulation", "current_sensor", "bits"),
            "compares the currents themselves, before any converter; remove it",
        ),
        (
            analogue and sensor.noise is not None and sensor.noise.si > 0.0,
            ("simulation", "current_sensor", "noise"),
            "compares at every instant, and the noise is that of samples; remove it",
        ),
    ]
    for refused, path, why in asked:
        if refused:
            raise document.error(
                f"{'.'.join(map(str, path))}: control.current_loop by '{method}' {why}",
                path,
                key=True,
            )


# The keys of ``control.current_loop`` that are for machines with any back-EMF: what they need, and
# what is said of them.

# Keys of ``control.current_loop`` that other machines have no use for.
PHASE_KEYS = ("frame", "feedforward", "axis_gains", "harmonic_integrators", "limited_waveforms")

_MODULATORS: dict[Topology, str] = {
    "three-wire": "duty cycles centred between the highest and the lowest phase voltage",
    "four-leg": "duty cycles centred between the highest and the lowest of all phase voltages and "
    "zero, the neutral's leg with them",
    "six-leg": "each phase on its own full bridge, half its voltage on either leg",
    "six-leg-isolated": "full bridges on separate links, voltages centred between the highest "
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
        gains = "its own gains" if loop.axis_gains == "own" else "the gains of the q axis"
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
