"""The library of complete designs that ships with the package, and the file that
a new design starts from.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NoReturn, get_args

from dqforge.machines.design import design as datasheet
from dqforge.machines.design.design import Design, InputValue, Reading
from dqforge.machines.design.numerical import located
from dqforge.machines.design.plausibility import implausibilities
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.sections.across_sections import (
    Asked,
    BlockSections,
    check_application,
    check_feedback,
    check_phase_control,
    check_six_step,
    check_topology,
    phase_control_remarks,
)
from dqforge.machines.design.sections.control import (
    check_loops,
    check_observer_format,
    check_sampling,
    read_control,
    read_gain_wish,
)
from dqforge.machines.design.sections.export import read_export
from dqforge.machines.design.sections.field_weakening import read_weakening
from dqforge.machines.design.sections.firmware import check_firmware
from dqforge.machines.design.sections.fit import check_fit, read_fit
from dqforge.machines.design.sections.inverter import DEFAULT_COOLANT, check_inverter, read_inverter
from dqforge.machines.design.sections.losses import (
    check_losses,
    read_losses,
    read_machine_loss,
    read_winding_heat,
)
from dqforge.machines.design.sections.machine import check_halves, check_machine, read_machine
from dqforge.machines.design.sections.modulation_choice import read_choice
from dqforge.machines.design.sections.observer import check_on_line
from dqforge.machines.design.sections.operation import (
    check_operation,
    check_overmodulation,
    read_operation,
)
from dqforge.machines.design.sections.references import check_references
from dqforge.machines.design.sections.simulation import read_scenario
from dqforge.machines.design.sections.start_up import check_start_up
from dqforge.machines.design.sections.waveform import check_waveform, read_waveform
from dqforge.machines.design.settings import ControlSettings, bare_speed_remarks
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.former_keys import (
    present_path,
    read_model,
    renamed_remarks,
    text_with_present_names,
    with_present_names,
)
from dqforge.machines.entries.kinds import Section, quantities
from dqforge.machines.entries.rules import si_of
from dqforge.machines.errors import (
    InputError,
    KeyPath,
    NoSolutionError,
    Places,
    Position,
    dotted,
    shown,
)
from dqforge.machines.files.library_files import (
    DESIGNS,
    MOTORS,
    TEMPLATE,
    design_names,
    read_design,
)
from dqforge.machines.files.positioned_yaml import (
    MAX_DEPTH,
    YamlDocument,
    YamlValue,
    edited,
    parse_value,
    parse_yaml,
    read_bytes,
    written,
)
from dqforge.machines.names import FeedbackMethod
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity


def names() -> list[str]:
    """Names of the drives in the library, in alphabetical order: those of papers and benches."""
    return DESIGNS.names()


def motors() -> list[str]:
    """Names of the motors in the library, in alphabetical order: those that people have."""
    return MOTORS.names()


def is_known(name: str) -> bool:
    """Whether the library has a drive or a motor of this name."""
    return name in design_names()


def read_text(name: str) -> bytes:
    """Bytes of a drive or a motor in the library; raises `InputError` when there is none of this
    name.
    """
    return read_design(name)


def load(name: str, settings: Sequence[str] = ()) -> Design:
    """Design from the library, with keys set as by `load_text`.

    Raises `InputError` when there is none of this name.
    """
    return load_text(read_text(name), DESIGNS.source(name), settings=settings)


def template(machine: str | None = None) -> bytes:
    """Bytes of a commented design file to start from: one of the library, or a general one.

    Raises:
        InputError: There is no design of this name.
    """
    return DESIGNS.read_unlisted(TEMPLATE) if machine is None else read_text(machine)


# Reading a design file: YAML, schema, data-sheet conventions, cross-checks,
# and the design in SI units.


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
    return load_text(read_bytes(path, design_names), str(path), Path(path).parent, settings)


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
    check_application(
        file.control,
        file.export,
        document,
        any_back_emf=found.phases is not None,
        lines=0 if file.simulation is None else file.simulation.encoder.lines,
    )
    asked = Asked(file.control, file.inverter, file.operation, file.export, file.simulation)
    check_feedback(asked, machine, document, any_back_emf=found.phases is not None)
    check_references(
        file.control.references,
        machine,
        file.export,
        document,
        any_back_emf=found.phases is not None,
    )
    left_out = (
        found.phases is not None
        or blocks
        or file.control.current_loop.method in get_args(FeedbackMethod)
    )
    check_on_line(
        file.control.online_estimation,
        file.control.commissioning,
        machine,
        document,
        left_out=left_out,
    )
    check_start_up(
        file.control,
        machine,
        file.export.formats,
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
        file.operation, inverter, file.export.formats, found.phases is not None, document
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
    used_by = "export.control" * bool(file.export.formats) or "simulation" * simulated
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
    needed = bool(file.export.formats or file.export.firmware) or simulated
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
        machine_loss=read_machine_loss(file.machine, machine, reading),
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


# Keys of a design that the command line sets: read as in the file, checked as in the file,
# written as in the file.
#
# An option ``--set machine.resistance=12 mOhm`` changes what the file says before anything is
# checked. The changed design is a design file like any other: its text, digest and results are
# those of a file that was edited by hand, but for the source ``command line`` of every quantity
# that was set.

OPTION = "--set"
SOURCE = "command line"
_EXAMPLE = "write e.g. --set machine.resistance='12 mOhm'"
_LONGEST_KEY, _LONGEST_VALUE = 200, 10_000
_ORIGIN_KEYS = ("source", "inferred", "note")
_ENTRY_KEYS = ("value", "kind", *_ORIGIN_KEYS)
_SIDES = ("from", "to")
# Where what was set counts as standing: behind the file, so that it is what contradicts.
_BEHIND = Position(1 << 30, 1)


@dataclass(frozen=True, slots=True)
class Override:
    """One key that is set: the parts of its path as they were written, its value,
    and the option for messages.
    """

    parts: tuple[str, ...]
    value: YamlValue
    option: str

    def refuse(self, message: str) -> NoReturn:
        """Raise an error on this option."""
        raise InputError(message, source=self.option)


def read_override(text: str) -> Override:
    """One option ``key=value``.

    Raises:
        InputError: There is no ``=``, the key is empty, too long or too deep, or the value is none
            of YAML.
    """
    key, equals, value = text.partition("=")
    key = key.strip()
    if not equals:
        raise InputError(f"{OPTION}: expected key=value, got {shown(text)}; {_EXAMPLE}")
    parts = tuple(re.sub(r"\[(\d+)\]", r".\1", key).split("."))
    if not all(parts):
        raise InputError(
            f"{OPTION}: {shown(text)} has {'an empty part in its key' if key else 'no key'}; "
            f"{_EXAMPLE}"
        )
    if len(key) > _LONGEST_KEY or len(parts) > MAX_DEPTH:
        raise InputError(
            f"{OPTION}: {shown(key)} is no key of a design, which has at most six parts; {_EXAMPLE}"
        )
    option = f"{OPTION} {shown(key, _LONGEST_KEY)[1:-1]}"
    if len(value) > _LONGEST_VALUE:
        raise InputError(
            f"the value has {len(value)} characters; write at most {_LONGEST_VALUE}", source=option
        )
    try:
        found = parse_value(value.strip(), option)
    except InputError as error:
        raise InputError(error.message, source=option) from None
    if found is None:
        raise InputError(
            "there is no value behind '='; write one, or leave the option out", source=option
        )
    present = present_path(parts, DesignFile)
    return Override(tuple(map(str, present)), found, option)


def overridden(
    document: YamlDocument, text: str, settings: Sequence[str]
) -> tuple[YamlDocument, str]:
    """A design file with keys set from outside.

    Args:
        document: What the file says.
        text: Its text, without byte order mark.
        settings: Options ``key=value``; a key is dotted, entries of a list by their number from 0.
            Their order is of no meaning.

    Returns:
        What the file then says, with the positions of what it says itself, and a text that says it.

    Raises:
        InputError: An option is not understood, two set the same key or one a part of the other's,
            or the outcome is no design.
    """
    if not settings:
        return document, text
    data = copy.deepcopy(document.data)
    options: dict[KeyPath, str] = {}
    paths: list[KeyPath] = []
    overrides = [read_override(setting) for setting in settings]
    _refuse_overlaps(overrides)
    for override in overrides:
        made = put(data, override)
        paths.append(made[-1])
        options.update(dict.fromkeys(made, override.option))
    changed = positioned(document, data, options)
    _name_sources(changed, paths)
    return changed, edited(text, document.data, data)


def _refuse_overlaps(overrides: Sequence[Override]) -> None:
    """Refuse to set a part twice: which of the two is meant must not depend on their order."""
    for one, other in pairwise(sorted(overrides, key=lambda override: override.parts)):
        if one.parts == other.parts:
            other.refuse("the key is set twice; leave one of the two out")
        if other.parts[: len(one.parts)] == one.parts:
            other.refuse(
                f"{'.'.join(one.parts)} is set as well, which holds it; set all of it in one option"
            )


def put(data: dict[str, YamlValue], override: Override) -> list[KeyPath]:
    """Set the value in place of all that stands there, its kind and its source too; returns the
    paths that were made for it, that of the key itself last.
    """
    node: dict[str, YamlValue] | list[YamlValue] = data
    path: KeyPath = ()
    made: list[KeyPath] = []
    for part in override.parts[:-1]:
        key = _key(node, part, path, override)
        path = (*path, key)
        if isinstance(node, dict) and node.get(str(key)) is None:
            node[str(key)] = {}
            made.append(path)
        inner = node[int(key)] if isinstance(node, list) else node[str(key)]
        if not isinstance(inner, (dict, list)):
            override.refuse(_no_keys(path, inner, ".".join(override.parts[len(path) :])))
        node = inner
    last = _key(node, override.parts[-1], path, override)
    if isinstance(node, list):
        node[int(last)] = override.value
    else:
        node[str(last)] = override.value
    return [*made, (*path, last)]


def _no_keys(path: KeyPath, value: YamlValue, rest: str) -> str:
    """What to say of a key into a single value."""
    name = dotted(path)
    if rest == "value":
        advice = f"write {OPTION} {name}=..."
    elif rest in _ENTRY_KEYS:
        advice = f"write {OPTION} {name}='{{value: {written(value)}, {rest}: ...}}'"
    else:
        advice = "set the key itself, or another one"
    return f"{name} is {shown(value)} and has no keys; {advice}"


def _key(
    node: dict[str, YamlValue] | list[YamlValue], part: str, path: KeyPath, override: Override
) -> str | int:
    """A part of a path as the key of a mapping, or as the number of an entry that is there."""
    if isinstance(node, dict):
        return part
    if not re.fullmatch(r"0|[1-9]\d{0,5}", part, re.ASCII) or int(part) >= len(node):
        name, count = dotted(path), len(node)
        numbers = f"{count} entries, numbered from 0" if count != 1 else "one entry, number 0"
        override.refuse(
            f"{name} is a list of {numbers}; write one of these, or {name}='[...]' for all of it"
        )
    return int(part)


def positioned(
    document: YamlDocument, data: dict[str, YamlValue], options: dict[KeyPath, str]
) -> YamlDocument:
    """The changed document; what an option set has no position in the file."""

    def stands(path: KeyPath) -> bool:
        return not any(path[:length] in options for length in range(1, len(path) + 1))

    set_parts = [inner for path in options for inner in _parts(value_at(data, path), path)]
    keys = {path: place for path, place in document.keys.items() if stands(path)}
    values = {path: place for path, place in document.values.items() if stands(path)}
    behind = dict.fromkeys(set_parts, _BEHIND)
    return YamlDocument(document.source, data, keys, values | behind, options)


def _parts(value: YamlValue, path: KeyPath) -> Iterator[KeyPath]:
    """The path of a value and those of everything in it."""
    yield path
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, inner in items:
        yield from _parts(inner, (*path, key))


def value_at(data: YamlValue, path: KeyPath) -> YamlValue:
    """Value at a path, None where there is none."""
    for part in path:
        if isinstance(data, dict):
            data = data.get(str(part))
        elif isinstance(data, list) and isinstance(part, int) and part < len(data):
            data = data[part]
        else:
            return None
    return data


def _name_sources(document: YamlDocument, paths: Sequence[KeyPath]) -> None:
    """Give every quantity that was set its source.

    Raises `InputError` where the outcome is no design.
    """
    data = document.data
    found = (path for path, _ in quantities(read_model(document, DesignFile)))
    entries = dict.fromkeys(path[:-1] if _is_side(data, path) else path for path in found)
    for entry in entries:
        whole = any(entry[: len(path)] == path for path in paths)
        if whole or any((*entry, key) in paths for key in ("value", *_SIDES)):
            kept = (
                _ORIGIN_KEYS
                if whole
                else tuple(key for key in _ORIGIN_KEYS if (*entry, key) in paths)
            )
            old = value_at(data, entry)
            new = _with_source(old, kept)
            _replace(data, entry, new)
            for key in {*old} - {*new} if isinstance(old, dict) else ():
                document.values.pop((*entry, key), None)


def _with_source(entry: YamlValue, kept: tuple[str, ...]) -> dict[str, YamlValue]:
    """An entry from the command line.

    Of what it says of its origin only ``kept`` is about this value.
    """
    if not isinstance(entry, dict):
        return {"value": entry, "source": SOURCE}
    new = {key: value for key, value in entry.items() if key not in _ORIGIN_KEYS or key in kept}
    return new | {"source": f"{SOURCE}: {new['source']}" if new.get("source") else SOURCE}


def _is_side(data: YamlValue, path: KeyPath) -> bool:
    """Whether a path leads to one side of a deviation ``{from: ..., to: ...}``,
    whose source stands beside both.
    """
    around = value_at(data, path[:-1])
    return path[-1] in _SIDES and isinstance(around, dict) and {*around} <= {*_SIDES, *_ORIGIN_KEYS}


def _replace(data: dict[str, YamlValue], path: KeyPath, value: YamlValue) -> None:
    around = value_at(data, path[:-1])
    if isinstance(around, dict):
        around[str(path[-1])] = value
    elif isinstance(around, list):
        around[int(path[-1])] = value


# Where the values of a design come from, and what was taken for granted.

_ALTERNATIVE = {
    "phase": "write kind: line-to-line if it was measured between two terminals",
    "peak": "write kind: rms if it is an r.m.s. value",
    "line-to-line peak": "write kind: line-to-line rms, phase peak or phase rms otherwise",
}


_SHOWN = {"speed": "rpm"}


_WHAT = {
    "phase": "a phase value",
    "peak": "a peak value",
    "line-to-line peak": "rpm per volt between two terminals at its peak, as that of hobby motors",
}


def input_values(
    file: Section, converted: Mapping[str, tuple[float, str]]
) -> tuple[InputValue, ...]:
    """Each quantity of the file with its origin.

    Args:
        file: The file's content.
        converted: For the paths of values that were converted: the value that is used, in SI units,
            and what was done.
    """
    values = []
    for parts, quantity in quantities(file):
        path = dotted(parts)
        si, conversion = converted.get(path, (quantity.si, ""))
        kind = f" ({quantity.kind})" if quantity.kind and quantity.kind_given else ""
        note = "; ".join(text for text in (conversion, quantity.note) if text)
        values.append(
            InputValue(
                path,
                quantity.text + kind,
                si,
                quantity.unit,
                quantity.source,
                quantity.inferred,
                note,
            )
        )
    return tuple(values)


def kind_assumptions(file: Section) -> tuple[str, ...]:
    """Sentences on conventions that the file does not name, and on values
    that it marks as inferred.
    """
    sentences = []
    for parts, quantity in quantities(file):
        path = dotted(parts)
        if quantity.remark:
            used = (
                f", {format_quantity(quantity.si, _SHOWN.get(quantity.dimension, quantity.unit))}"
            )
            sentences.append(f"{path}: {quantity.remark}{used}")
        if quantity.kind is not None and not quantity.kind_given and quantity.si != 0.0:
            what, otherwise = _WHAT[quantity.kind], _ALTERNATIVE[quantity.kind]
            sentences.append(f"{path} is taken as {what}; {otherwise}")
        if quantity.inferred:
            reason = quantity.note or quantity.source or "no reason is given"
            sentences.append(f"{path} is inferred: {reason}")
    return tuple(sentences)
