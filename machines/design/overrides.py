"""Keys of a design that the command line sets: read as in the file, checked as in the file,
written as in the file.

An option ``--set machine.resistance=12 mOhm`` changes what the file says before anything is
checked. The changed design is a design file like any other: its text, digest and results are those
of a file that was edited by hand, but for the source ``command line`` of every quantity that was
set.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NoReturn

from dqforge.machines.design.schema import DesignFile
from dqforge.machines.entries.complaints import read_model
from dqforge.machines.entries.former_keys import present_path
from dqforge.machines.entries.kinds import quantities
from dqforge.machines.errors import InputError
from dqforge.machines.files.positioned_yaml import MAX_DEPTH, YamlDocument, YamlValue, parse_value
from dqforge.machines.files.yaml_edit import edited, written
from dqforge.machines.places import KeyPath, Position, dotted
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import kind_said
from dqforge.machines.wording import shown

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
    """Set the value; returns the paths that were made for it, that of the key itself last."""
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
        node[int(last)] = _kept_kind(node[int(last)], override.value)
    else:
        node[str(last)] = _kept_kind(node.get(str(last)), override.value)
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


def _is_entry(value: YamlValue) -> bool:
    """Whether a value is a quantity written as a mapping."""
    return isinstance(value, dict) and "value" in value and all(key in _ENTRY_KEYS for key in value)


def _kept_kind(old: YamlValue, new: YamlValue) -> YamlValue:
    """A new value for an entry; where it is but a number, the convention of the old one holds
    on, whether it stands beside the value or in its text.
    """
    if isinstance(new, (dict, list)) or (isinstance(new, str) and kind_said(new)):
        return new
    entry = old if isinstance(old, dict) and _is_entry(old) else {"value": old}
    said = [kind_said(text) for text in (entry["value"],) if isinstance(text, str)]
    named = [kind for kind in (entry.get("kind"),) if isinstance(kind, str)]
    kinds = " ".join(dict.fromkeys(part for part in (*said, *named) if part))
    if kinds:
        return {"value": new, "kind": kinds}
    return {"value": new} if entry is old else new


def positioned(
    document: YamlDocument, data: dict[str, YamlValue], options: dict[KeyPath, str]
) -> YamlDocument:
    """The changed document; what an option set has no position in the file."""

    def stands(path: KeyPath) -> bool:
        return not any(path[:length] in options for length in range(1, len(path) + 1))

    set_parts = [inner for path in options for inner in _parts(_at(data, path), path)]
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


def _at(data: YamlValue, path: KeyPath) -> YamlValue:
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
            old = _at(data, entry)
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
    around = _at(data, path[:-1])
    return path[-1] in _SIDES and isinstance(around, dict) and {*around} <= {*_SIDES, *_ORIGIN_KEYS}


def _replace(data: dict[str, YamlValue], path: KeyPath, value: YamlValue) -> None:
    around = _at(data, path[:-1])
    if isinstance(around, dict):
        around[str(path[-1])] = value
    elif isinstance(around, list):
        around[int(path[-1])] = value
