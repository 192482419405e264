"""Designs of the rows of a study: the design that it starts from, read once, with keys replaced.

A row's design is read, checked and built as a file with these values would be. What a key of the
study has set is named in messages by its position in the study.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Hashable, Iterable, Mapping
from functools import cache

from pydantic import TypeAdapter, ValidationError

from dqforge.machines.design.design import Design
from dqforge.machines.design.loader import build_design, parse_design, read_sections
from dqforge.machines.design.overrides import Override, positioned, put
from dqforge.machines.design.reading import Reading, Recalled
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.entries.former_keys import text_with_present_names
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.design_keys import design_key
from dqforge.machines.exploration.recent import Recent
from dqforge.machines.exploration.study import Study
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue
from dqforge.machines.files.yaml_edit import edited
from dqforge.machines.places import KeyPath, Places, dotted

Assignments = Mapping[str, YamlValue]  # Values of dotted keys as a design file writes them.
_SETTING = ("set", "vary", "tolerances")


class DesignMaker:
    """The design of a study, parsed once; maps and tables that rows share are kept.

    Args:
        study: With ``design_text``, ``sets`` and ``named``.
        supplied: Files that rows may name, by their names; those of the study unless told
            otherwise.
    """

    def __init__(self, study: Study, supplied: Mapping[str, bytes] | None = None) -> None:
        self._supplied = dict(study.named) if supplied is None else supplied
        self._options = _options(study.places)
        self._plain = parse_design(study.design_text, study.design_source)
        text = study.design_text.decode("utf-8-sig")
        self._text = text_with_present_names(text, self._plain)
        self._memory: dict[Hashable, Recalled] = {}
        self._base = self._changed(self._plain, study.sets)
        self._sections_of_base: DesignFile | None = None

    def document(self, assignments: Assignments) -> YamlDocument:
        """The design file of a row; raises `InputError` where a key cannot be set."""
        return self._changed(self._base, assignments.items())

    def file(self, assignments: Assignments) -> DesignFile:
        """Its sections; raises `InputError` where a value is none that its key may have."""
        return self._sections(self.document(assignments), assignments)

    def _sections(self, document: YamlDocument, assignments: Assignments) -> DesignFile:
        """Sections of a row: those of the base but for the ones that its keys stand in."""
        if self._sections_of_base is None:
            try:
                self._sections_of_base = read_sections(self._base)
            except InputError:
                return read_sections(document)
        changed = {name.partition(".")[0] for name in assignments}
        try:
            update = {name: _adapter(name).validate_python(document.data[name]) for name in changed}
        except ValidationError:
            return read_sections(document)  # which says what is wrong, and where
        return self._sections_of_base.model_copy(update=update)

    def design(self, assignments: Assignments) -> Design:
        """Its design; raises `InputError` as a file of these values would."""
        document = self.document(assignments)
        text = json.dumps(document.data, ensure_ascii=False).encode()
        reading = Reading(document, text, None, supplied=self._supplied, memory=self._memory)
        return build_design(self._sections(document, assignments), reading)

    def text(self, assignments: Assignments) -> bytes:
        """Its design file with the comments of the design that the study starts from."""
        return edited(self._text, self._plain.data, self.document(assignments).data).encode()

    def _changed(
        self, document: YamlDocument, values: Iterable[tuple[str, YamlValue]]
    ) -> YamlDocument:
        data = copy.deepcopy(document.data)
        options = dict(document.options)
        for name, value in values:
            key = design_key(name)
            path: KeyPath = tuple(name.split(".")) if key is None else key.path
            option = self._options.get(name, name)
            made = put(data, Override(tuple(map(str, path)), copy.deepcopy(value), option))
            options.update(dict.fromkeys(made, option))
        return positioned(document, data, options)


def _options(places: Places | None) -> dict[str, str]:
    """By dotted key of a design: what messages call the place in the study that sets it."""
    found: dict[str, str] = {}
    if places is None:
        return found
    for path, position in places.keys.items():
        if path[0] in _SETTING and len(path) > 1 and isinstance(path[-1], str):
            place = f"{places.source}:{position.line}:{position.column}: {dotted(path)}"
            found.setdefault(path[-1], place)
    return found


@cache
def _adapter(name: str) -> TypeAdapter[object]:
    """What reads one section of a design."""
    annotation = DesignFile.model_fields[name].annotation
    assert annotation is not None, name  # every section has a type
    return TypeAdapter(annotation)


_MAKERS = Recent(DesignMaker)


def maker_of(study: Study) -> DesignMaker:
    """The maker of a study's designs."""
    return _MAKERS.of(study)


def design_of(study: Study, assignments: Assignments) -> Design:
    """Design of a study with keys replaced.

    Args:
        study: As `dqforge.machines.exploration.study_reader.read_study` reads it.
        assignments: By dotted key, values as a design file writes them; a value replaces ``value``
            of an entry and keeps its ``kind``.

    Raises:
        InputError: A value is none that a design may have; with the position in the study or in its
            design.
    """
    return maker_of(study).design(assignments)


def design_text_of(study: Study, assignments: Assignments) -> bytes:
    """The file of such a design, with the comments of the design that the study starts from."""
    return maker_of(study).text(assignments)
