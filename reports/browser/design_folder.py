"""The one state of `dqforge serve`: a design file in a folder, with what was uploaded beside it."""

from __future__ import annotations

import copy
import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from dqforge.machines.design import catalogue
from dqforge.machines.design.sheet_values import SHEET_VALUES
from dqforge.machines.errors import InputError
from dqforge.machines.files.library_files import DESIGN_SCHEMA, schema_bytes
from dqforge.machines.files.positioned_yaml import YamlValue, edited, parse_yaml, written
from dqforge.machines.records import dataclass
from dqforge.reports.pages.answer import write_atomically

NEW_DESIGN = "design.yaml"

# Bytes of the largest file that is taken: maps and captures.
LARGEST_UPLOAD = 64_000_000

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,99}")


class ChangedElsewhereError(Exception):
    """The design file is no longer what the page shows."""


@dataclass(frozen=True, slots=True)
class DesignFolder:
    """A folder and its design file."""

    folder: Path

    @property
    def path(self) -> Path:
        """The design file, which may not be there yet."""
        return self.folder / NEW_DESIGN

    def text(self) -> str:
        """What it says; empty where it is not there."""
        return self.path.read_text(encoding="utf-8-sig") if self.path.is_file() else ""

    def revision(self) -> str:
        """What tells one text from another."""
        return hashlib.sha256(self.text().encode("utf-8")).hexdigest()[:16]

    def save(self, text: str, revision: str) -> None:
        """Keep a text that is a design.

        Raises:
            ChangedElsewhereError: The file is not of that revision.
            InputError: The text is no design; says where and why.
        """
        self._require(revision)
        catalogue.load_text(text.encode("utf-8"), str(self.path), self.folder)
        self._write(text)

    def change(self, settings: Sequence[str], revision: str) -> None:
        """Set keys of the design, as ``--set`` does; comments stay. Raises as `save`."""
        self._require(revision)
        data = catalogue.parse_design(self.text().encode("utf-8"), str(self.path)).data
        changed = copy.deepcopy(data)
        for setting in settings:
            catalogue.put(changed, catalogue.read_override(setting))
        self.save(edited(self.text(), data, changed), revision)

    def begin(self, sheet: Mapping[str, str], revision: str) -> None:
        """Make the design of a data sheet. Raises as `save`."""
        from dqforge.machines.design.sheet_judged import checked_text

        known = {value.key for value in SHEET_VALUES} | {"machine.flux_map"}
        given = {key: text.strip() for key, text in sheet.items() if text.strip()}
        unknown = sorted(set(given) - known)
        if unknown:
            raise InputError(f"a data sheet has no {unknown[0]}")
        self._require(revision)
        self._write(checked_text(given, self.folder, {}))

    def template(self, machine: str, revision: str) -> None:
        """Begin with a drive or motor of the library. Raises as `save`."""
        self._require(revision)
        self._write(catalogue.template(machine).decode("utf-8"))

    def upload(self, name: str, content: bytes) -> str:
        """Keep a file beside the design, such as a flux map; its name.

        Raises:
            InputError: The name is no plain file name, or another file has it.
        """
        if not _NAME.fullmatch(name) or name in {NEW_DESIGN, DESIGN_SCHEMA}:
            raise InputError(
                f"{name!r} cannot be the name of a file here; rename it: letters, digits"
            )
        path = self.folder / name
        if path.exists() and path.read_bytes() != content:
            raise InputError(f"{name} is there with another content; rename one of the two")
        write_atomically(path, content)
        return name

    def _require(self, revision: str) -> None:
        if revision != self.revision():
            raise ChangedElsewhereError

    def _write(self, text: str) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        write_atomically(self.folder / DESIGN_SCHEMA, schema_bytes(DESIGN_SCHEMA))
        write_atomically(self.path, text.encode("utf-8"))


# The form: each key of the design with what the schema says of it.


@dataclass(frozen=True, slots=True)
class Field:
    """A key with its value as it is written, what it is, and its choices, empty for any."""

    key: str
    value: str
    help: str
    choices: tuple[str, ...]
    whole: bool


def fields_of(text: str) -> list[Field]:
    """A field for each value of a design's text."""
    if not text:
        return []
    data = parse_yaml(text.encode("utf-8"), NEW_DESIGN).data
    schema = _schema()
    return [
        _field(schema, path, value) for path, value in _leaves(data, ()) if path[0] != "dqforge"
    ]


def known_keys() -> list[dict[str, str]]:
    """Every key that a design can have, with what it is."""
    schema = _schema()
    return [
        {"key": ".".join(path), "help": node.get("description", "")}
        for path, node in _paths(schema, schema, (), 0)
    ]


def _schema() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(schema_bytes(DESIGN_SCHEMA))
    return found


def _leaves(value: YamlValue, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], YamlValue]]:
    """Values by their paths; one with a kind or an origin beside it is one value."""
    if isinstance(value, dict) and value and "value" not in value:
        for key, part in value.items():
            yield from _leaves(part, (*path, str(key)))
    elif path:
        yield path, value


def _field(schema: dict[str, Any], path: tuple[str, ...], value: YamlValue) -> Field:
    node, more = _at(schema, path), ""
    if isinstance(value, dict) and value:
        more = "".join(f"; {key}: {part}" for key, part in value.items() if key != "value")
        value = value["value"]
    choices = tuple(str(one) for one in node.get("enum", ()))
    whole = isinstance(value, int) and "integer" in _types(node)
    text = "" if value is None else written(value)
    about = node.get("description", "") + more
    return Field(".".join(path), text, about.removeprefix("; "), choices, whole)


def _types(node: dict[str, Any]) -> set[str]:
    found: set[str] = set()
    for part in (node, *node.get("anyOf", ())):
        kinds = part.get("type", [])
        found.update([kinds] if isinstance(kinds, str) else kinds)
    return found


def _resolved(schema: dict[str, Any], node: dict[str, Any]) -> list[dict[str, Any]]:
    """A node of the schema and what it may be instead, references followed."""
    parts = [node, *node.get("anyOf", ()), *node.get("oneOf", ()), *node.get("allOf", ())]
    found = []
    for part in parts:
        target = part.get("$ref", "").rpartition("/")[2]
        found.append({**schema["$defs"][target], **part} if target else part)
    return found


def _at(schema: dict[str, Any], path: tuple[str, ...]) -> dict[str, Any]:
    """The node of a key; empty where the schema has none."""
    node = schema
    for part in path:
        below = [one.get("properties", {}) for one in _resolved(schema, node)]
        node = next((properties[part] for properties in below if part in properties), {})
    return node


def _paths(
    schema: dict[str, Any], node: dict[str, Any], path: tuple[str, ...], depth: int
) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    sections = [one for one in _resolved(schema, node) if one.get("properties")]
    if path and (not sections or depth >= _DEEPEST):
        yield path, node
        return
    seen: set[str] = set()
    for section in sections:
        for key, part in section["properties"].items():
            if key not in seen and (path or key != "dqforge"):
                seen.add(key)
                yield from _paths(schema, part, (*path, key), depth + 1)


_DEEPEST = 4
