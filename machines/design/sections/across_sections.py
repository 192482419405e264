"""What sections of a design ask of each other: the topology of the inverter of choke, capacitors
and modulator, the program around the functions of what it calls, a six-step drive of
everything.
"""

from __future__ import annotations

from dqforge.machines.design.sections.control import ControlSection
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.sections.inverter import InverterSection
from dqforge.machines.design.sections.modulation_choice import ChoiceSection
from dqforge.machines.design.sections.operation import OperationSection
from dqforge.machines.design.sections.simulation import SimulationSection
from dqforge.machines.errors import InputError, KeyPath
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import SIX_STEP_METHODS, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, contradiction


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
            f"modulation_choice: {inverter.topology} has a modulator of its own, so that there is "
            "none to choose; remove the section"
        )
        raise document.error(message, ("modulation_choice",), key=True)


def _check_neutral(inverter: InverterSection, used_by: str, document: YamlDocument) -> None:
    """Check that the neutral's parts are there where they are needed, and nowhere else."""
    rule, name = TOPOLOGIES[inverter.topology], inverter.topology
    if inverter.neutral_inductance is not None and "n" not in rule.legs:
        raise _misplaced("neutral_inductance", "neutral on a leg of its own", name, document)
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


def check_application(
    control: ControlSection, export: ExportSection, document: YamlDocument, *, any_back_emf: bool
) -> None:
    """Check that the program around the functions has what it calls.

    ``any_back_emf`` says that the machine is one of model: waveform. Raises `InputError` with a
    position.
    """
    if export.application is None:
        return
    loop = control.speed_loop
    if any_back_emf:
        message = "the program is for machines with a sinusoidal back-EMF; remove it"
    elif "float32" not in export.control or loop is None:
        message = (
            "the program calls the speed control in float32; write export.control: float32 and "
            "control.speed_loop"
        )
    elif control.six_step is not None or (control.start_up is None and loop.measurement is None):
        message = (
            "the program needs control.start_up, or an encoder by control.speed_loop.measurement; "
            "write one of them"
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
        (bool(file.export.control), ("export", "control"), "it has control functions of its own"),
        (bool(file.export.firmware), ("export", "firmware"), "that firmware runs vector control"),
        ("field_weakening" in file.named, ("field_weakening",), "blocks weaken no field"),
        ("losses" in file.named, ("losses",), "the loss budget is that of sinusoidal currents"),
        ("modulation_choice" in file.named, ("modulation_choice",), "it has one modulator"),
        (control.references is not None, ("control", "references"), "it has no dq references"),
        (control.firmware is not None, ("control", "firmware"), "that firmware has no blocks"),
        (control.tolerances is not None, ("control", "tolerances"), "they are not judged here"),
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
                "control.observer: {method: zero-crossing} or emf-integration, or leave it out",
                path,
                key=True,
            )
        return False
    for where, why in (*_refusals(file), *_simulated(file)):
        raise document.error(
            f"{'.'.join(map(str, where))}: a six-step drive (control.observer: {method}) does not "
            f"use it: {why}; leave it out, or write another observer",
            where,
            key=True,
        )
    sampling, switching = control.sampling_frequency, file.inverter.switching_frequency
    if sampling is not None and abs(sampling.si / switching.si - 1.0) > 1e-9:
        raise document.error(
            f"control.sampling_frequency: {sampling.text}: a six-step drive samples once per "
            f"carrier period, in its middle; write {switching.text}, or leave it out",
            ("control", "sampling_frequency"),
        )
    return True
