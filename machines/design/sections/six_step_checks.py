"""What a six-step drive cannot do, and where the design file asks for it."""

from __future__ import annotations

from dqforge.machines.design.sections.control import ControlSection
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.sections.inverter import InverterSection
from dqforge.machines.design.sections.simulation_schema import SimulationSection
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import SIX_STEP_METHODS
from dqforge.machines.places import KeyPath
from dqforge.machines.records import dataclass


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
