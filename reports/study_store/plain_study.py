"""A study as plain data, with the files from which it is read again; and the way back."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from posixpath import normpath
from typing import Any

from dqforge.machines.exploration.study import (
    Axis,
    Bound,
    Draw,
    Goal,
    Search,
    Study,
    Tolerance,
)
from dqforge.reports.plain_data import PlainData

INPUT = "study-input"  # Folder in an explored folder that holds what the study was read from.
INPUT_DESIGN = f"{INPUT}/design.yaml"
_FILES, _HEADER = f"{INPUT}/files", f"{INPUT}/header"
_CONTENTS = ("design_text", "named", "header_files", "places")


def plain_study(study: Study) -> PlainData:
    """The whole of a study but for contents of files, of which it holds the names."""
    plain = {
        each.name: _plain(getattr(study, each.name))
        for each in fields(study)
        if each.name not in _CONTENTS
    }
    plain["design_sha256"] = hashlib.sha256(study.design_text).hexdigest()
    plain["named"] = [name for name, _ in study.named]
    plain["header_files"] = [name for name, _ in study.header_files]
    return plain


def _plain(value: Any) -> Any:
    """A value of a record as JSON holds it."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def study_inputs(study: Study) -> dict[str, bytes]:
    """The files from which a study can be read again, by their names in its folder."""
    named = {_named_place(name): content for name, content in study.named}
    own = {f"{_HEADER}/{name}": content for name, content in study.header_files}
    return {INPUT_DESIGN: study.design_text} | named | own


def _named_place(name: str) -> str:
    """Where a file lies that the design names, which is always beside or below it."""
    return f"{_FILES}/{normpath(name)}"


def input_names(plain: PlainData) -> tuple[str, ...]:
    """Names of `study_inputs` of a study that is plain."""
    named = [_named_place(name) for name in plain.get("named", ())]
    own = [f"{_HEADER}/{name}" for name in plain.get("header_files", ())]
    return (INPUT_DESIGN, *dict.fromkeys(named), *own)


def study_from(plain: PlainData, contents: Mapping[str, bytes]) -> Study:
    """A study again.

    Args:
        plain: As `plain_study` made it.
        contents: As `study_inputs` made them.
    """
    found = {key: _frozen(value) for key, value in plain.items() if key != "design_sha256"}
    found |= {
        "design_text": contents[INPUT_DESIGN],
        "named": tuple((name, contents[_named_place(name)]) for name in plain["named"]),
        "header_files": tuple(
            (name, contents[f"{_HEADER}/{name}"]) for name in plain["header_files"]
        ),
        "sets": tuple((key, value) for key, value in plain["sets"]),
        "axes": tuple(_axis(axis) for axis in plain["axes"]),
        "tolerances": tuple(Tolerance(**entry) for entry in plain["tolerances"]),
        "draw": None if plain["draw"] is None else _draw(plain["draw"]),
        "limits": tuple(_bound(entry) for entry in plain["limits"]),
        "accept": tuple(_bound(entry) for entry in plain["accept"]),
        "goals": tuple(Goal(**entry) for entry in plain["goals"]),
        "search": None if plain["search"] is None else Search(**plain["search"]),
    }
    return Study(**found)


def _frozen(value: Any) -> Any:
    return tuple(_frozen(entry) for entry in value) if isinstance(value, list) else value


def _axis(plain: PlainData) -> Axis:
    steps = tuple(tuple(step) for step in plain["steps"])
    return Axis(tuple(plain["keys"]), steps, _frozen(plain["numbers"]), plain.get("spacing", ""))


def _draw(plain: PlainData) -> Draw:
    return Draw(**(plain | {"correlations": _frozen(plain["correlations"])}))


def _bound(plain: PlainData) -> Bound:
    return Bound(**(plain | {"point": _frozen(plain["point"])}))
