"""Reading a study file: YAML, schema, keys of the design, what is drawn and asked, and whether
any of its rows is a design.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from math import prod
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.devices import catalogue as devices
from dqforge.machines.entries.complaints import read_model
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.asked_outputs import (
    check_names,
    read_bounds,
    read_goals,
)
from dqforge.machines.exploration.design_keys import DesignKey, design_key
from dqforge.machines.exploration.drawn_values import read_draw, read_tolerances
from dqforge.machines.exploration.resolved_values import resolved_values
from dqforge.machines.exploration.row_designs import DesignMaker
from dqforge.machines.exploration.study import Axis, Search, Study
from dqforge.machines.exploration.study_checks import (
    check_overlaps,
    check_search,
    check_sensitivity,
    check_size,
    place_of,
)
from dqforge.machines.exploration.study_digest import study_digest
from dqforge.machines.exploration.study_entries import complaint, known_key
from dqforge.machines.exploration.study_folder import StudyFolder
from dqforge.machines.exploration.study_schema import StudyFile
from dqforge.machines.exploration.varied_values import read_axes
from dqforge.machines.files.positioned_yaml import (
    YamlDocument,
    YamlValue,
    parse_yaml,
    read_bytes,
)
from dqforge.machines.places import Places

_MOST_TRIED = 128  # Rows of which one must be a design.
_NAMES_FILES = frozenset({"file", "files", "psi_q_file", "torque_file", "mission"})


def read_study(path: str | Path) -> Study:
    """Study in a file.

    Raises:
        InputError: The file cannot be read, its content is wrong, or none of its rows is a design;
            with the position where there is one.
    """
    study = study_of_text(read_bytes(path), str(path), Path(path).parent)
    if study.places is None:
        return study
    # Messages of rows are stored: where the file lay when it was read is no part of them.
    return replace(study, places=replace(study.places, source=Path(path).name))


def study_of_text(text: bytes, source: str, folder: Path | None = None) -> Study:
    """Study in the bytes of a file.

    Args:
        text: Content, UTF-8.
        source: File name for messages.
        folder: Where the files lie that the study names; None where it may name none.

    Raises:
        InputError: As `read_study`.
    """
    document = _parsed(text, source)
    file = read_model(document, StudyFile)
    files = StudyFolder(folder, document)
    design_text, design_source = _design(file.design, files, document)
    study = Study(
        name=file.name,
        about=file.about,
        design_text=design_text,
        design_source=design_source,
        digest="",
        sets=_sets(document),
        axes=read_axes(document, files.listed),
        header=file.header or "",
        header_files=files.header(file.header),
        outputs=tuple(sorted(file.outputs)),
        limits=read_bounds(document, "limits"),
        accept=read_bounds(document, "accept"),
        goals=read_goals(document, file),
        sensitivity=file.sensitivity,
        search=_search(file),
        places=Places(source, document.keys, document.values, tuple(StudyFile.model_fields)),
    )
    for section in ("outputs", "sensitivity"):
        check_names(document, section, getattr(file, section))
    check_overlaps(document, study)
    maker = DesignMaker(study, files)
    places = _first_design(study, maker, files)
    first = maker.file(_assigned(study.axes, places))
    values = resolved_values(first)

    def value_of(key: DesignKey) -> float | None:
        return values.numbers.get(key.path)

    tolerances = read_tolerances(document, first, value_of)
    draw = read_draw(document, file, tolerances)
    study = replace(study, tolerances=tolerances, draw=draw)
    check_overlaps(document, study)
    check_search(document, study)
    check_sensitivity(document, study)
    check_size(document, study)
    _check_steps(document, study, maker, files, places)
    study = replace(study, named=files.named())
    return replace(study, digest=study_digest(study))


def _parsed(text: bytes, source: str) -> YamlDocument:
    """The file as YAML; raises `InputError` also for a design in the place of a study."""
    if not text.strip():
        raise InputError(
            "the file is empty; a study begins with dqforge_study: 1",
            source=source,
            line=1,
            column=1,
        )
    document = parse_yaml(text, source)
    if "dqforge" in document.data and "dqforge_study" not in document.data:
        raise document.error(
            "this is a design; a study begins with dqforge_study: 1 and names it under design",
            ("dqforge",),
            key=True,
        )
    return document


def _design(name: str, files: StudyFolder, document: YamlDocument) -> tuple[bytes, str]:
    """Bytes and name of the design: a drive of the library, or a file beside the study."""
    if name in catalogue.names():
        return catalogue.read_text(name), f"{name}.yaml"
    if not name.endswith((".yaml", ".yml")):
        try:
            catalogue.read_text(name)
        except InputError as error:
            message = f"{error.message}; a file beside the study ends with .yaml"
            raise complaint(document, ("design",), message) from None
    return files.design(name)


def _sets(document: YamlDocument) -> tuple[tuple[str, YamlValue], ...]:
    """Keys that the study sets; raises `InputError` where a design has none such."""
    given = document.data.get("set", {})
    found = []
    for name, value in sorted(given.items()) if isinstance(given, dict) else ():
        known_key(document, ("set", name))
        found.append((name, value))
    return tuple(found)


def _search(file: StudyFile) -> Search | None:
    given = file.search
    if given is None:
        return None
    return Search(given.method, given.population, given.generations, given.seed)


def _assigned(axes: tuple[Axis, ...], places: tuple[int, ...]) -> dict[str, YamlValue]:
    """Values of the keys that vary at a point of the grid."""
    return {
        key: value
        for axis, place in zip(axes, places, strict=True)
        for key, value in zip(axis.keys, axis.steps[place], strict=True)
    }


def _tried(axes: tuple[Axis, ...]) -> Iterator[tuple[int, ...]]:
    """Points of the grid: both ends, and others from all over it; all of a small grid."""
    counts = [len(axis.steps) for axis in axes]
    whole = prod(counts)
    stride = max(1, whole // _MOST_TRIED)
    places = dict.fromkeys([0, whole - 1, *range(0, whole, stride)])
    for index in places:
        found, left = [], index
        for count in reversed(counts):
            left, place = divmod(left, count)
            found.append(place)
        yield tuple(reversed(found))


def _first_design(study: Study, maker: DesignMaker, files: StudyFolder) -> tuple[int, ...]:
    """Point of the grid of the first row that is a design.

    Raises `InputError` where none of those tried is one, with what is said of the first.
    """
    refusals: list[InputError] = []
    for places in islice(_tried(study.axes), 2 * _MOST_TRIED):
        try:
            maker.design(_assigned(study.axes, places))
        except InputError as error:
            if files.missing:
                raise
            refusals.append(error)
        else:
            return places
    if len(refusals) > 1:
        refusals[0].message = f"no row is a design, the first: {refusals[0].message}"
    raise refusals[0]


def _check_steps(
    document: YamlDocument,
    study: Study,
    maker: DesignMaker,
    files: StudyFolder,
    places: tuple[int, ...],
) -> None:
    """Check that every value that is no number may stand at its key, and read the files that the
    rows name.

    Raises `InputError`. A design that has other reasons to be refused is a row of that state.
    """
    for index, axis in enumerate(study.axes):
        if axis.numbers:
            continue
        for place in range(len(axis.steps)):
            assigned = _assigned(study.axes, (*places[:index], place, *places[index + 1 :]))
            maker.file(assigned)
            own = {key: assigned[key] for key in axis.keys}
            for key, value in own.items():
                _check_device(document, key, value)
            if any(_names_files(key, value) for key, value in own.items()):
                try:
                    maker.design(assigned)
                except InputError:
                    if files.missing:
                        raise


def _check_device(document: YamlDocument, key: str, value: YamlValue) -> None:
    """Refuse a device that the library does not have; raises `InputError`."""
    found = design_key(key)
    if found is None or found.path[:2] != ("inverter", "device"):
        return
    name = value.get("name") if isinstance(value, dict) else value
    if isinstance(name, str) and (isinstance(value, dict) or found.path[2:] == ("name",)):
        try:
            devices.read_text(name)
        except InputError as error:
            raise complaint(document, place_of(document, "vary", key), error.message) from None


def _names_files(key: str, value: YamlValue) -> bool:
    """Whether a value may name a file."""
    if isinstance(value, dict):
        return any(_names_files(inner, part) for inner, part in value.items())
    if isinstance(value, list):
        return any(_names_files(key, part) for part in value)
    return key.rpartition(".")[2] in _NAMES_FILES
