"""Keys that have another name by now: a file that uses the former one is read as before.

The former name stands beside the field that has replaced it, ``json_schema_extra=former("...")``;
everything else follows from there: reading, remarks, options of the command line, the schema.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from dqforge.machines.entries.rules import EntryError, not_one_of, spoken, unknown_key
from dqforge.machines.errors import InputError, KeyPath, Position, dotted
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue
from dqforge.machines.names import FORMAT_VERSION

_MARK = "former"


def former(name: str) -> dict[str, Any]:
    """For ``Field(json_schema_extra=...)``: the name that the key had in earlier versions."""
    return {_MARK: name}


@cache
def former_keys(model: type[BaseModel]) -> dict[KeyPath, str]:
    """The present name of the last part of each path that a file may still use."""
    return dict(_former_keys(model, ()))


def _former_keys(model: type[BaseModel], path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    for name, field in model.model_fields.items():
        extra = field.json_schema_extra
        if isinstance(extra, dict) and _MARK in extra:
            yield (*path, str(extra[_MARK])), name
        for inner in models_in(field.annotation):
            yield from _former_keys(inner, (*path, name))


def present_path(path: KeyPath, model: type[BaseModel]) -> KeyPath:
    """The path of a key by its present names."""
    known = former_keys(model)
    for length in range(1, len(path) + 1):
        if path[:length] in known:
            path = (*path[: length - 1], known[path[:length]], *path[length:])
    return path


def with_present_names(document: YamlDocument, model: type[BaseModel]) -> YamlDocument:
    """A file with former names replaced, which it lists in ``renamed``; positions stay.

    Raises:
        InputError: A key stands there by both of its names.
    """
    found = {path: present_path(path, model) for path in document.values}
    renamed = {new: old for old, new in found.items() if old[-1:] != new[-1:]}
    if not renamed:
        return document
    for new, old in renamed.items():
        if new in document.values:
            raise document.error(
                f"{dotted(old)} is the former name of {dotted(new)}, which stands here as well; "
                "remove one of the two",
                old,
                key=True,
            )

    def moved(table: dict[KeyPath, Position]) -> dict[KeyPath, Position]:
        return {found.get(path, path): place for path, place in table.items()}

    data = _renamed_data(document.data, (), found)
    assert isinstance(data, dict)
    keys, values = moved(document.keys), moved(document.values)
    return replace(document, data=data, keys=keys, values=values, renamed=renamed)


def _renamed_data(value: YamlValue, path: KeyPath, found: dict[KeyPath, KeyPath]) -> YamlValue:
    if isinstance(value, list):
        return [_renamed_data(each, (*path, k), found) for k, each in enumerate(value)]
    if not isinstance(value, dict):
        return value
    inner = {key: (*path, key) for key in value}
    return {
        str(found.get(inner[key], inner[key])[-1]): _renamed_data(each, inner[key], found)
        for key, each in value.items()
    }


def text_with_present_names(text: str, document: YamlDocument) -> str:
    """The text of a file with the former names that ``document`` lists replaced, and no more."""
    lines = text.split("\n")
    places = {new: document.keys[new] for new in document.renamed}
    for new, place in sorted(places.items(), key=lambda item: item[1], reverse=True):
        line, old = lines[place.line - 1], str(document.renamed[new][-1])
        start = line.index(old, place.column - 1)  # behind a quotation mark, where there is one
        lines[place.line - 1] = f"{line[:start]}{new[-1]}{line[start + len(old) :]}"
    return "\n".join(lines)


def renamed_remarks(document: YamlDocument) -> list[str]:
    """A sentence for each former name that the file uses."""
    return [
        f"{dotted(new)} is written by its former name {old[-1]}; files of format 1 may keep it"
        for new, old in document.renamed.items()
    ]


def deprecated_properties(schema: dict[str, Any]) -> dict[str, Any]:
    """Properties of a JSON Schema, each former name behind the one that has replaced it."""
    found: dict[str, Any] = {}
    for name, entry in schema.items():
        old = entry.get(_MARK) if isinstance(entry, dict) else None
        found[name] = {key: part for key, part in entry.items() if key != _MARK} if old else entry
        if old:
            found[old] = found[name] | {
                "description": f"former name of {name}",
                "deprecated": True,
            }
    return found


# From a YAML document to the schema's models, with every complaint in plain English
# at its place in the file.

_Model = TypeVar("_Model", bound=BaseModel)

# What engineers call the keys elsewhere.
SYNONYMS = {
    "motor": "machine",
    "drive": "inverter",
    "converter": "inverter",
    "controller": "control",
    "loss": "losses",
    "version": "dqforge",
    "title": "name",
    "description": "about",
    "p": "pole_pairs",
    "n_p": "pole_pairs",
    "pp": "pole_pairs",
    "polepairs": "pole_pairs",
    "pole_number": "poles",
    "r": "resistance",
    "rs": "resistance",
    "r_s": "resistance",
    "ld": "inductance_d",
    "l_d": "inductance_d",
    "lq": "inductance_q",
    "l_q": "inductance_q",
    "psi": "magnet_flux",
    "psi_pm": "magnet_flux",
    "flux": "magnet_flux",
    "flux_linkage": "magnet_flux",
    "ke": "back_emf_constant",
    "k_e": "back_emf_constant",
    "k_v": "kv",
    "speed_constant": "kv",
    "velocity_constant": "kv",
    "l": "inductance",
    "ls": "inductance",
    "l_s": "inductance",
    "phase_inductance": "inductance",
    "phase_resistance": "resistance",
    "kt": "torque_constant",
    "k_t": "torque_constant",
    "i_max": "max_current",
    "imax": "max_current",
    "current_limit": "max_current",
    "current": "max_current",
    "n_max": "max_speed",
    "speed": "max_speed",
    "j": "inertia",
    "b": "friction",
    "vdc": "v_dc",
    "udc": "v_dc",
    "u_dc": "v_dc",
    "dc_voltage": "v_dc",
    "voltage": "v_dc",
    "fsw": "switching_frequency",
    "f_sw": "switching_frequency",
    "pwm_frequency": "switching_frequency",
    "frequency": "switching_frequency",
    "deadtime": "dead_time",
    "f_s": "sampling_frequency",
    "sampling": "sampling_frequency",
    "order": "degree",
    "e_on": "turn_on_energy",
    "e_off": "turn_off_energy",
    "e_rr": "reverse_recovery_energy",
    "rds_on": "on_resistance",
    "r_ds_on": "on_resistance",
    "r_th": "thermal_resistance",
    "rth": "thermal_resistance",
    "omega": "speed",
    "omega_m": "speed",
}

# What to write for keys that every design needs.
_EXAMPLES = {
    "dqforge": f"dqforge: {FORMAT_VERSION}",
    "dqforge_study": "dqforge_study: 1",
    "name": "name: My first drive",
    "design": "design: design.yaml, a file beside the study or a drive of the library",
    "count": "count: 100000",
    "seed": "seed: 1",
    "resistance": "resistance: 2.35 Ohm",
    "axes": "axes: magnet-d",
    "file": "file: map.csv",
    "magnet_temperature": "magnet_temperature: 20 degC",
    "max_current": "max_current: 12 A",
    "v_dc": "v_dc: 48 V",
    "switching_frequency": "switching_frequency: 10 kHz",
    "pole": "pole: 400 rad/s",
    "duration": "duration: 1 s",
    "time": "time: 0.2 s",
    "points": "points: [{torque: 1 N m, speed: 1500 rpm}]",
    "torque": "torque: 1 N m",
    "speed": "speed: 1500 rpm",
    "min_frequency": "min_frequency: 8 kHz",
    "max_frequency": "max_frequency: 20 kHz",
    "min": "min: 8 kHz",
    "max": "max: 10 kHz",
    "kind": "kind: mosfet",
    "on_resistance": "on_resistance: 9.5 mOhm",
    "turn_on_energy": "turn_on_energy: 0.8 mJ",
    "turn_off_energy": "turn_off_energy: 0.8 mJ",
    "reference_current": "reference_current: 100 A",
    "reference_voltage": "reference_voltage: 400 V",
    "thermal_resistance": "thermal_resistance: 0.3 K/W",
}


def read_model(document: YamlDocument, model: type[_Model]) -> _Model:
    """Sections of a file of one kind.

    Raises:
        InputError: With the position of the first fault in the file: an unknown, missing or empty
            key, a value of the wrong type or unit, or one that is not plausible; with the others.
    """
    empty = _empty_parts(document)
    if empty:
        raise _all_of(empty)
    try:
        return model.model_validate(document.data)
    except ValidationError as error:
        faults = error.errors(include_url=False, include_input=False)
    faults = _without_echoes(faults)
    found = [_complaint(fault, document, model) for fault in faults]
    first = min(found, key=_place)
    if faults[found.index(first)]["type"] == "missing":
        rest = [
            (fault, complaint)
            for fault, complaint in zip(faults, found, strict=True)
            if fault["type"] == "missing" and complaint is not first
        ]
        lacking = [
            _to_write(tuple(part for part in fault["loc"] if part not in TAGS)) for fault, _ in rest
        ]
        first.message += f"; and also {', '.join(lacking)}" if lacking else ""
        said = [complaint for _, complaint in rest]
        found = [complaint for complaint in found if complaint not in said]
    raise _all_of(found) from None


def _all_of(found: list[InputError]) -> InputError:
    """The first of several faults, with the others."""
    first, *others = sorted(found, key=_place)
    first.others = tuple(others)
    return first


def _place(error: InputError) -> tuple[int, int]:
    return (error.line or 0, error.column or 0)


def _empty_parts(document: YamlDocument) -> list[InputError]:
    """Complaints about keys without a value: nobody can tell whether the default is meant."""
    found = []
    for path in document.values:
        if path and _lookup(document.data, path) is None:
            cut = _cut_number(document, path)
            message = cut or f"{dotted(path)} has no value; write one, or remove the line"
            found.append(document.error(message, path, key=True))
    return found


def _cut_number(document: YamlDocument, path: KeyPath) -> str:
    """Complaint about {time: 0,2 s}, which is a time of 0 and a key "2 s";
    nothing for other keys.
    """
    around, key = (
        _lookup(document.data, path[:-1]) if len(path) > 1 else document.data,
        str(path[-1]),
    )
    if not isinstance(around, dict) or not key[:1].isdigit():
        return ""
    names = [str(name) for name in around]
    before = names[names.index(key) - 1] if names.index(key) > 0 else ""
    value = around.get(before)
    if isinstance(value, bool) or not isinstance(value, int):
        return ""
    return (
        f"{dotted((*path[:-1], before))}: '{value},{key}' has a decimal comma; write {value}.{key}"
    )


def _lookup(data: YamlValue, path: KeyPath) -> YamlValue:
    """Value at a path, or None when there is none."""
    for part in path:
        if isinstance(data, dict) and isinstance(part, str):
            data = data.get(part)
        elif isinstance(data, list) and isinstance(part, int) and part < len(data):
            data = data[part]
        else:
            return None
    return data


def _without_echoes(faults: list[ErrorDetails]) -> list[ErrorDetails]:
    """Faults without those that others cause.

    A missing key beside an unknown one is likely the same, misspelt, and one that is unknown
    elsewhere stands there; a list with a wrong entry is also reported as too short.
    """
    unknown = [fault["loc"] for fault in faults if fault["type"] == "extra_forbidden"]
    misspelt, moved = {place[:-1] for place in unknown}, {place[-1] for place in unknown}
    parents = {fault["loc"][:length] for fault in faults for length in range(len(fault["loc"]))}
    return [
        fault
        for fault in faults
        if not (
            fault["type"] == "missing"
            and (fault["loc"][:-1] in misspelt or fault["loc"][-1] in moved)
        )
        and not (fault["type"] == "too_short" and fault["loc"] in parents)
    ]


def _complaint(fault: ErrorDetails, document: YamlDocument, root: type[BaseModel]) -> InputError:
    """One fault of the model in plain English, with its position."""
    tagged: KeyPath = tuple(fault["loc"])
    path: KeyPath = tuple(part for part in tagged if part not in TAGS)
    cause = fault.get("ctx", {}).get("error")
    if isinstance(cause, EntryError) and path != ("dqforge",):
        part = path if cause.key is None else (*path, cause.key)
        return document.error(
            f"{dotted(path)}: {cause.message}",
            part if part in document.values else path,
            key=cause.at_key,
        )
    if fault["type"] == "extra_forbidden":
        said = _unknown(tagged, root, by_option=_is_set(path, document))
        return document.error(said, path, key=True)
    if fault["type"] == "missing":
        return document.error(_missing(path), path[:-1], key=not isinstance(path[-1], int))
    value = _lookup(document.data, path)
    said = _expected(fault, value, tagged, root)
    said = said.replace(_BELOW, _IN_BRACES) if _is_set(path, document) else said
    return document.error(f"{dotted(path)}: {said}", path)


def _is_set(path: KeyPath, document: YamlDocument) -> bool:
    """Whether an option set a key, so that there is no line to indent."""
    return any(path[:length] in document.options for length in range(1, len(path) + 1))


def _unknown(path: KeyPath, root: type[BaseModel], *, by_option: bool) -> str:
    """What to say on a key that its section does not have; of an option there is no line."""
    *section, last = path
    key, inside = str(last), tuple(section)
    shown_path = dotted(tuple(part for part in inside if part not in TAGS))
    where = f"{shown_path}: " if shown_path else ""
    allowed = tuple(_section(inside, root).model_fields)
    found = _homes(key, root)
    found = [home for home in found if len(home) == 1] or found
    # Of another kind of this section the keys that it takes say more than where it is at home.
    homes = [dotted(home) or "the top level" for home in found if dotted(home) != shown_path]
    if homes and SYNONYMS.get(key) not in allowed:
        advice = f"write --set {homes[0]}.{key}=..." if by_option else "check the indentation"
        return f"{where}unknown key '{key}'; it belongs in {' or '.join(homes[:3])}, {advice}"
    return where + unknown_key(key, allowed, SYNONYMS)


def _homes(key: str, model: type[BaseModel], path: KeyPath = ()) -> list[KeyPath]:
    """Sections that have a key."""
    found = [path] if key in model.model_fields else []
    for name, field in model.model_fields.items():
        for inner in models_in(field.annotation):
            found += _homes(key, inner, (*path, name))
    return found


def _to_write(path: KeyPath) -> str:
    """A further key that is missing, with an example of its value."""
    *section, key = path
    example = _EXAMPLES.get(key, f"{key}: ...") if isinstance(key, str) else ""
    around = dotted(tuple(section))
    return f"{around}.{example}" if around and example else example or dotted(path)


def _missing(path: KeyPath) -> str:
    *section, key = path
    if isinstance(key, int):
        return f"{dotted(tuple(section))}: the list ends too early, entry {key + 1} is missing"
    name = key
    if not section and name in ("machine", "inverter"):
        return f"the section '{name}' is missing; write '{name}:' and its keys indented below"
    example = _EXAMPLES.get(name, f"{name}: ...")
    return f"{dotted(tuple(section)) or 'the file'} needs the key '{name}'; write {example}"


_COMMAS = r"\s*[,;]\s*"
_BELOW, _IN_BRACES = "write its keys indented below", "write {key: value, ...}"
_TEMPLATES = {
    "bool_type": "expected true or false, got {got}",
    "int_type": "expected a whole number, got {got}",
    "int_from_float": "expected a whole number, got {got}",
    "float_type": "expected a number without a unit, got {got}",
    "string_type": "expected a text, got {got}; put it in quotes",
    "string_too_short": "the text is empty; write one",
    "model_type": "expected a section with keys, got {got}; write its keys indented below",
    "model_attributes_type": (
        "expected a section with keys, got {got}; write its keys indented below"
    ),
    "dict_type": "expected a mapping, got {got}; write its keys indented below",
    "tuple_type": "expected a list such as [1, 2], got {got}",
    "greater_than": "expected a number greater than {gt:g}, got {got}",
    "greater_than_equal": "expected a number of at least {ge:g}, got {got}",
    "less_than": "expected a number less than {lt:g}, got {got}",
    "less_than_equal": "expected a number of at most {le:g}, got {got}",
    "too_short": "expected a list of at least {min_length}, got {actual_length}",
    "too_long": "expected a list of at most {max_length}, got {actual_length}",
}


def _expected(fault: ErrorDetails, value: YamlValue, path: KeyPath, root: type[BaseModel]) -> str:
    """What was expected instead of a value, and what to write."""
    got = spoken(value)
    if path in (("dqforge",), ("dqforge_study",)):
        return (
            f"this program reads version {FORMAT_VERSION} of the format, got {got}; write "
            f"{path[0]}: {FORMAT_VERSION}"
        )
    if fault["type"] == "literal_error":
        return not_one_of(value, _choices(path, root))
    model = str(fault["type"]).startswith("model_")
    if model and path[:2] == ("inverter", "device") and isinstance(value, str):
        return f"expected a section with keys, got {got}; write {{name: {value}}}"
    if model and isinstance(value, str) and "file" in _section(path, root).model_fields:
        return f"expected a section with keys, got {got}; write {{file: {value}}}"
    if fault["type"] == "tuple_type" and isinstance(value, str):
        return f"expected a list, got {got}; write [{', '.join(re.split(_COMMAS, value.strip()))}]"
    template = _TEMPLATES.get(fault["type"], "{got} is not understood here")
    return template.format(got=got, **fault.get("ctx", {}))


def _section(path: KeyPath, root: type[BaseModel]) -> type[BaseModel]:
    """Model of the section at a path; of two forms of a section the one that its tag names."""
    model: type[BaseModel] = root
    forms = [model]
    for part in path:
        if part in TAGS:
            model = forms[TAGS.index(str(part))]
        elif isinstance(part, str):
            forms = models_in(model.model_fields[part].annotation)
            model = forms[0]
    return model


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """Sections that a type permits."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in models_in(inner)]


def _choices(path: KeyPath, root: type[BaseModel]) -> tuple[str, ...]:
    """Values that the ``Literal`` at a path allows."""
    keys = tuple(part for part in path if isinstance(part, str))
    annotation = _section(keys[:-1], root).model_fields[keys[-1]].annotation
    return _texts_in(annotation)


def _texts_in(annotation: Any) -> tuple[str, ...]:
    if isinstance(annotation, str):
        return (annotation,)
    return tuple(text for inner in get_args(annotation) for text in _texts_in(inner))


# How the two forms of ``inverter.device`` are told apart in the paths of faults; no key can be
# called so.
TAGS = ("(constants)", "(reference)")
