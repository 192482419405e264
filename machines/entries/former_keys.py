"""Keys that have another name by now: a file that uses the former one is read as before.

The former name stands beside the field that has replaced it, ``json_schema_extra=former("...")``;
everything else follows from there: reading, remarks, options of the command line, the schema.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

from pydantic import BaseModel

from dqforge.machines.entries.complaints import models_in
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue
from dqforge.machines.places import KeyPath, Position, dotted

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
