"""Reading a design file: YAML, schema, data-sheet conventions, cross-checks,
and the design in SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dqforge.machines.design import datasheet
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import located
from dqforge.machines.design.overrides import overridden
from dqforge.machines.design.plausibility.design import implausibilities
from dqforge.machines.design.provenance import input_values, kind_assumptions
from dqforge.machines.design.reading import Reading
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.sections.application import check_application
from dqforge.machines.design.sections.control import (
    check_loops,
    check_observer_format,
    check_sampling,
    read_control,
    read_gain_wish,
)
from dqforge.machines.design.sections.current_feedback import Asked, check_feedback
from dqforge.machines.design.sections.export import read_export
from dqforge.machines.design.sections.field_weakening import read_weakening
from dqforge.machines.design.sections.firmware import check_firmware
from dqforge.machines.design.sections.fit import check_fit, read_fit
from dqforge.machines.design.sections.inverter import (
    DEFAULT_COOLANT,
    check_inverter,
    read_inverter,
)
from dqforge.machines.design.sections.losses import (
    check_losses,
    read_losses,
    read_machine_loss,
    read_winding_heat,
)
from dqforge.machines.design.sections.machine.cross_checks import check_halves, check_machine
from dqforge.machines.design.sections.machine.model import read_machine
from dqforge.machines.design.sections.modulation_choice import read_choice
from dqforge.machines.design.sections.operation import (
    check_operation,
    check_overmodulation,
    read_operation,
)
from dqforge.machines.design.sections.phase_control import (
    check_phase_control,
    phase_control_remarks,
)
from dqforge.machines.design.sections.references import check_references
from dqforge.machines.design.sections.simulation.reading import read_scenario
from dqforge.machines.design.sections.six_step_checks import BlockSections, check_six_step
from dqforge.machines.design.sections.start_up import check_start_up
from dqforge.machines.design.sections.topology import check_topology
from dqforge.machines.design.sections.waveform import check_waveform, read_waveform
from dqforge.machines.design.settings import ControlSettings
from dqforge.machines.design.speed_remarks import bare_speed_remarks
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.complaints import read_model
from dqforge.machines.entries.former_keys import (
    renamed_remarks,
    text_with_present_names,
    with_present_names,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.files.library_files import DESIGNS
from dqforge.machines.files.positioned_yaml import YamlDocument, parse_yaml, read_bytes
from dqforge.machines.places import Places
from dqforge.machines.units.quantities import format_quantity


def load_design(path: str | Path, settings: Sequence[str] = ()) -> Design:
    """Design in a file.

    Args:
        path: The file.
        settings: Keys that are set instead of what the file says, such as ``machine.resistance=12
            mOhm``.

    Raises:
        InputError: The file cannot be read, or its content is wrong; with the position where there
            is one.
    """
    return load_text(read_bytes(path, DESIGNS.names), str(path), Path(path).parent, settings)


def load_text(
    text: bytes, source: str, folder: Path | None = None, settings: Sequence[str] = ()
) -> Design:
    """Design in the bytes of a file.

    Args:
        text: Content, UTF-8.
        source: File name for messages.
        folder: Where the files lie that the design names; None where it may name none.
        settings: Keys that are set instead of what the file says, such as ``machine.resistance=12
            mOhm``.

    Raises:
        InputError: The content is wrong; with the position of the first fault, or the option that
            is at fault.
    """
    document = parse_design(text, source)
    if settings:
        present = text_with_present_names(text.decode("utf-8-sig"), document)
        document, changed = overridden(document, present, settings)
        text = changed.encode("utf-8")
    return build_design(read_sections(document), Reading(document, text, folder))


def build_design(file: DesignFile, reading: Reading) -> Design:
    """Design of sections that are read already, such as those of a document changed in memory.

    Raises:
        InputError: The content is wrong; with the position of the first fault in
            ``reading.document``.
    """
    document = reading.document
    places = Places(
        document.source,
        document.keys,
        document.values,
        tuple(DesignFile.model_fields),
        document.options,
    )
    try:
        with located(places, "machine"):
            return _design(file, reading, places)
    except NoSolutionError as error:
        # Nothing has been asked of the design yet: what it says is wrong.
        raise InputError(
            error.message, source=error.source, line=error.line, column=error.column
        ) from error


def _design(file: DesignFile, reading: Reading, places: Places) -> Design:
    """Build all parts in an order in which each check has what it needs."""
    document, remarks = reading.document, reading.remarks
    remarks.extend(renamed_remarks(document))
    found = read_machine(file.machine, reading)
    machine = found.machine
    check_machine(file.machine, machine, document)
    check_inverter(file.inverter, document)
    check_sampling(file.control, file.inverter.switching_frequency.si, document)
    check_losses(file.losses, file.inverter.device is not None, machine, document)
    check_loops(file.control, machine, document)
    check_observer_format(file.control, file.export, document)
    named_sections = frozenset(file.model_fields_set)
    blocks = check_six_step(
        BlockSections(file.control, file.inverter, file.export, file.simulation, named_sections),
        document,
    )
    check_application(file.control, file.export, document, any_back_emf=found.phases is not None)
    asked = Asked(
        file.control, file.inverter, file.operation, file.export, file.simulation is not None
    )
    check_feedback(asked, machine, document, any_back_emf=found.phases is not None)
    check_references(
        file.control.references,
        machine,
        file.export,
        document,
        any_back_emf=found.phases is not None,
    )
    check_start_up(
        file.control,
        machine,
        file.export.control,
        document,
        any_back_emf=found.phases is not None,
    )
    check_firmware(
        file.control.firmware,
        document,
        any_back_emf=found.phases is not None,
        gains=file.control.gains,
    )
    inverter = read_inverter(file.inverter, machine.i_max, reading)
    check_overmodulation(
        file.operation, inverter, file.export.control, found.phases is not None, document
    )
    operation = read_operation(file.operation)
    inverter = replace(
        inverter,
        overmodulation=operation.overmodulation,
        overmodulation_limit=operation.overmodulation_limit,
    )
    i_max = machine.i_max if inverter.i_max is None else min(machine.i_max, inverter.i_max)
    check_halves(file.machine, file.fit, document)
    check_operation(file.operation, file.field_weakening is not None, machine, document)
    check_fit(file.fit, file.operation, machine, i_max, document)
    simulated = file.simulation is not None
    check_waveform(file.waveform, file.machine, file.inverter, document)
    used_by = "export.control" * bool(file.export.control) or "simulation" * simulated
    check_topology(file.inverter, file.operation, file.modulation_choice, used_by, document)
    check_phase_control(file.control, found.phases, file.inverter.topology, file.export, document)
    rated_speed = si_of(file.machine.rated.speed)
    control = read_control(
        file.control,
        machine,
        inverter,
        i_max,
        rated_speed,
        reading,
        any_back_emf=found.phases is not None,
    )
    needed = bool(file.export.control or file.export.firmware) or simulated
    named = "control" in file.model_fields_set
    wish = "none" if blocks else read_gain_wish(file.control, named, needed, document)
    control = replace(control, gains=wish)
    remarks.extend(_remarks(file, machine, inverter, control))
    if control.gains != "none":
        remarks.extend(phase_control_remarks(control.current_loop, found.phases, inverter))
    remarks.extend(bare_speed_remarks(file, file.machine.max_speed or file.machine.rated.speed))
    strategy = file.operation.strategy
    weakening = read_weakening(file.field_weakening, strategy, machine, reading)
    choice = read_choice(file.modulation_choice, strategy, inverter, machine, i_max, reading)
    losses = read_losses(file.losses, machine, reading)
    scenario = read_scenario(
        file.simulation,
        machine,
        inverter,
        control,
        reading,
        waveform=found.phases is not None,
        program=file.export.application is not None,
    )
    design = Design(
        name=file.name,
        about=file.about,
        machine=machine,
        machine_loss=read_machine_loss(file.machine, reading),
        phase_machine=found.phases,
        inverter=inverter,
        control=control,
        operation=operation,
        fit=read_fit(file.fit, machine, control.bases, reading),
        losses=losses,
        waveform=read_waveform(file.waveform),
        export=read_export(file.export),
        values=(*input_values(file, reading.converted), *reading.derived),
        assumptions=(*kind_assumptions(file), *remarks),
        digest=reading.digest(),
        given=reading.given(),
        weakening=weakening,
        winding=read_winding_heat(file.machine, inverter.coolant_temperature),
        simulation=scenario,
        modulation_choice=choice,
        flux_evidence=tuple(reading.flux_evidence),
        halves=found.halves,
        places=places,
    )
    return replace(design, assumptions=(*design.assumptions, *implausibilities(design, file)))


def _remarks(
    file: DesignFile, machine: Machine, inverter: Inverter, control: ControlSettings
) -> list[str]:
    """Sentences on defaults that change the result."""
    remarks = []
    if machine.omega_m_max is not None:
        warning = datasheet.back_emf_warning(
            machine.pole_pairs,
            machine.psi_pm,
            machine.omega_m_max,
            inverter.v_dc,
            inverter.topology,
        )
        remarks += [warning] if warning else []
    if "strategy" not in file.operation.model_fields_set:
        remarks.append("operation.strategy is mtpa: the least current for each torque")
    operation = file.operation
    if operation.overmodulation != "none" and operation.overmodulation_limit is None:
        remarks.append(
            "operation.overmodulation_limit is 95.14 % of six-step operation: a vector that "
            "follows the hexagon"
        )
    if file.fit.max_torque is None:
        remarks.append("fit.max_torque is the largest torque within the current limit")
    if "prefix" not in file.export.model_fields_set:
        remarks.append(f"export.prefix is {file.export.prefix}")
    if file.machine.friction is None and (control.speed_loop or control.observer):
        remarks.append("machine.friction is taken as 0")
    if file.inverter.device is not None and file.inverter.coolant_temperature is None:
        remarks.append(
            f"inverter.coolant_temperature is {format_quantity(DEFAULT_COOLANT, 'degC')}"
        )
    return remarks


def parse_design(text: bytes, source: str) -> YamlDocument:
    """A design file as a document with the present names of its keys.

    Raises:
        InputError: The bytes are no YAML, or a key stands there by its former and its present name.
    """
    return with_present_names(parse_yaml(text, source), DesignFile)


def read_sections(document: YamlDocument) -> DesignFile:
    """Sections of a design file; raises `InputError` like `read_model`."""
    return read_model(document, DesignFile)
