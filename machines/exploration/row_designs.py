"""The section ``vary`` of a study: keys of the design with the values that they take in turn."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from itertools import pairwise
from typing import Any, Generic, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from dqforge.machines.design.catalogue import (
    Override,
    build_design,
    parse_design,
    positioned,
    put,
    read_sections,
    value_at,
)
from dqforge.machines.design.design import Design, Reading, Recalled
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.entries.former_keys import text_with_present_names
from dqforge.machines.entries.kinds import Between, Section
from dqforge.machines.entries.rules import Quantity, not_one_of, spoken
from dqforge.machines.errors import InputError, KeyPath, Places, dotted
from dqforge.machines.exploration.design_keys import (
    DesignKey,
    complaint,
    design_key,
    known_key,
    mapping_at,
    number_at,
    only_one,
)
from dqforge.machines.exploration.study import Axis, Spacing, Study
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue, edited
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import kind_said

MOST_STEPS = 100_000
_FORMS = ("values", "range", "files")
_DISTRIBUTIONS = ("normal", "uniform", "between")
_RANGE_KEYS = ("from", "to", "count", "spacing")
_TOGETHER = "together"
Listed = Callable[[str], Sequence[str]]  # Names of the files that a pattern stands for.


@dataclass(frozen=True, slots=True)
class _Steps:
    """Values of one key in their order; SI numbers where all are numbers of one kind."""

    key: DesignKey
    values: tuple[YamlValue, ...]
    numbers: tuple[float, ...] = ()
    spacing: Spacing = ""


def read_axes(document: YamlDocument, listed: Listed) -> tuple[Axis, ...]:
    """Axes of a study, in the order of its file.

    Args:
        document: The study file.
        listed: Names of the files that a pattern stands for, beside the study.

    Raises:
        InputError: A key is none of a design, a value none of its key, or keys in step differ in
            length.
    """
    section = document.data.get("vary", {})
    axes = []
    for name, entry in section.items() if isinstance(section, dict) else ():
        path: KeyPath = ("vary", name)
        if name == _TOGETHER:
            axes.append(_in_step(document, path, entry, listed))
        elif isinstance(entry, dict) and _TOGETHER in entry:
            mapping_at(document, path, entry, (_TOGETHER,), "together: {key: [...], key: [...]}")
            inner = (*path, _TOGETHER)
            axes.append(_in_step(document, inner, entry[_TOGETHER], listed))
        else:
            axes.append(_axis(document, path, [_steps(document, path, entry, listed)]))
    return tuple(axes)


def _in_step(document: YamlDocument, path: KeyPath, entry: YamlValue, listed: Listed) -> Axis:
    """Several keys that take their values in step."""
    example = "{machine.inductance_d: [...], machine.inductance_q: [...]}"
    names = tuple(entry) if isinstance(entry, dict) else ()
    keys = mapping_at(document, path, entry, names, example)
    parts = [_steps(document, (*path, name), inner, listed) for name, inner in keys.items()]
    counts = [len(part.values) for part in parts]
    for part, count in zip(parts, counts, strict=True):
        if count != counts[0]:
            raise complaint(
                document,
                (*path, part.key.name),
                f"{count} values in step with {counts[0]} of {parts[0].key.name}; write as many",
                key=True,
            )
    return _axis(document, path, parts)


def _axis(document: YamlDocument, path: KeyPath, parts: Sequence[_Steps]) -> Axis:
    """One axis; raises `InputError` where a step is there twice."""
    steps = tuple(zip(*(part.values for part in parts), strict=True))
    numeric = all(part.numbers for part in parts)
    numbers = tuple(zip(*(part.numbers for part in parts), strict=True)) if numeric else ()
    seen: dict[str, int] = {}
    for index, step in enumerate(numbers or steps):
        text = json.dumps(step, sort_keys=True)
        if text in seen:
            raise complaint(
                document, path, f"value {index + 1} is value {seen[text] + 1} again; remove one"
            )
        seen[text] = index
    spacing = parts[0].spacing if len(parts) == 1 else ""
    return Axis(tuple(part.key.name for part in parts), steps, numbers, spacing)


def _steps(document: YamlDocument, path: KeyPath, entry: YamlValue, listed: Listed) -> _Steps:
    """Values of one key."""
    key = known_key(document, path)
    if isinstance(entry, list):
        return _of_list(document, path, key, entry)
    if not isinstance(entry, dict):
        raise complaint(
            document,
            path,
            f"expected values, a range or files, got {spoken(entry)}; write [...] with the values, "
            "or put the key under set",
        )
    for word in _DISTRIBUTIONS:
        if word in entry:
            raise complaint(
                document, (*path, word), "a distribution is drawn; write it under tolerances"
            )
    allowed = (*_FORMS, "one_by_one")
    mapping_at(document, path, entry, allowed, "{values: [...]}")
    form = only_one(document, path, entry, _FORMS)
    if form == "values":
        return _of_values(document, path, key, entry)
    if "one_by_one" in entry:
        raise complaint(document, (*path, "one_by_one"), "goes with values", key=True)
    if form == "range":
        return _of_range(document, (*path, form), key, entry[form])
    return _of_files(document, (*path, form), key, entry[form], listed)


def _of_values(
    document: YamlDocument, path: KeyPath, key: DesignKey, entry: dict[str, YamlValue]
) -> _Steps:
    """``{values: [...]}`` or ``{values: all}``, of a list each entry by itself if asked."""
    values, apart = entry["values"], entry.get("one_by_one", False)
    inner: KeyPath = (*path, "values")
    if not isinstance(apart, bool):
        raise complaint(
            document, (*path, "one_by_one"), f"expected true or false, got {spoken(apart)}"
        )
    if apart and not key.listed:
        raise complaint(document, (*path, "one_by_one"), "goes with a key that holds a list")
    if values == "all":
        if not key.words:
            raise complaint(document, inner, "expected a list, got all; only words can be all")
        if key.listed and not apart:
            raise complaint(
                document, inner, "all entries at once are one value; write one_by_one: true beside"
            )
        values = list(key.words)
    if not isinstance(values, list):
        raise complaint(document, inner, f"expected a list, got {spoken(values)}; write [...]")
    if not apart:
        return _of_list(document, inner, key, values)
    for index, value in enumerate(values):
        _check_word(document, (*inner, index), key, value)
    _check_count(document, inner, len(values))
    return _Steps(key, tuple([value] for value in values))


def _of_list(
    document: YamlDocument, path: KeyPath, key: DesignKey, values: list[YamlValue]
) -> _Steps:
    _check_count(document, path, len(values))
    if not key.is_number:
        for index, value in enumerate(values):
            if key.sort == "word":
                _check_word(document, (*path, index), key, value)
        return _Steps(key, tuple(values))
    _check_commas(document, path, key, values)
    found = [number_at(document, (*path, index), key, value) for index, value in enumerate(values)]
    kinds = {kind for _, kind in found}
    if len(kinds) > 1:
        return _Steps(key, tuple(values))
    return _Steps(key, tuple(values), tuple(number + 0.0 for number, _ in found))


def _check_commas(
    document: YamlDocument, path: KeyPath, key: DesignKey, values: list[YamlValue]
) -> None:
    """Refuse ``[12,5 V]``, which YAML takes for 12 and 5 V; raises `InputError`."""
    if not key.unit:
        return
    for index, (whole, rest) in enumerate(pairwise(values)):
        bare = isinstance(whole, int) and not isinstance(whole, bool) and whole != 0
        if bare and isinstance(rest, str) and re.match(r"\d+\s*[^\d\s.,]", rest):
            raise complaint(
                document,
                (*path, index),
                f"{whole} has no unit and {spoken(rest)} has one; write {whole}.{rest} for one "
                f"number, or {whole} {key.unit}, {rest} for two",
            )


def _check_word(document: YamlDocument, path: KeyPath, key: DesignKey, value: YamlValue) -> None:
    if key.words and value not in key.words:
        raise complaint(document, path, not_one_of(value, key.words))


def _check_count(document: YamlDocument, path: KeyPath, count: int) -> None:
    if not 1 <= count <= MOST_STEPS:
        raise complaint(document, path, f"expected 1 to {MOST_STEPS} values, got {count}")


def _of_range(document: YamlDocument, path: KeyPath, key: DesignKey, entry: YamlValue) -> _Steps:
    """``{from, to, count, spacing}``: numbers at equal distances, or at equal ratios."""
    if not key.is_number:
        raise complaint(document, path, "a range goes with a number; write values: [...]", key=True)
    example = "{from: 8 kHz, to: 100 kHz, count: 20}"
    given = mapping_at(document, path, entry, _RANGE_KEYS, example)
    for name in ("from", "to", "count"):
        if name not in given:
            raise complaint(document, path, f"needs the key '{name}'; write {example}", key=True)
    (low, kind), (high, other) = (
        number_at(document, (*path, name), key, given[name]) for name in ("from", "to")
    )
    if kind != other:
        raise complaint(document, (*path, "to"), "both ends are of one kind; write the same kind")
    count, spacing = given["count"], given.get("spacing", "linear")
    if isinstance(count, bool) or not isinstance(count, int):
        raise complaint(document, (*path, "count"), f"expected a whole number, got {spoken(count)}")
    if not 2 <= count <= MOST_STEPS:
        raise complaint(document, (*path, "count"), f"expected 2 to {MOST_STEPS}, got {count}")
    if spacing not in ("linear", "log"):
        message = not_one_of(spacing, ("linear", "log"))
        raise complaint(document, (*path, "spacing"), message)
    if low == high:
        raise complaint(document, (*path, "to"), "both ends are equal; write values: [...]")
    if spacing == "log" and not (low > 0.0 and high > 0.0):
        end = "from" if low <= 0.0 else "to"
        raise complaint(document, (*path, end), "spacing: log needs positive ends")
    numbers = _spaced(low, high, count, spacing == "log")
    if key.sort in ("count", "whole") and any(number != int(number) for number in numbers):
        broken = next(number for number in numbers if number != int(number))
        raise complaint(
            document,
            (*path, "count"),
            f"gives {broken:.6g}, which is no whole number; count in "
            "whole steps, or write values: [...]",
        )
    values = tuple(key.written(number, kind) for number in numbers)
    return _Steps(key, values, numbers, "log" if spacing == "log" else "linear")


def _spaced(low: float, high: float, count: int, logarithmic: bool) -> tuple[float, ...]:
    """Numbers from low to high, both ends as they are."""
    share = np.arange(count) / (count - 1)
    if logarithmic:
        found = low * np.exp(share * math.log(high / low))
    else:
        found = low + share * (high - low)
    return (low + 0.0, *(float(number) for number in found[1:-1]), high + 0.0)


def _of_files(
    document: YamlDocument, path: KeyPath, key: DesignKey, entry: YamlValue, listed: Listed
) -> _Steps:
    """``files: devices/*.json`` or a list of names: a file in each step."""
    whole = "file" in key.parts and key.path == ("inverter", "device")
    if not whole and key.path[-1] not in ("file", "mission"):
        inside = f"{key.name}.file" if "file" in key.parts else "inverter.device"
        raise complaint(
            document, path, f"no file stands at this key; write it of {inside}", key=True
        )
    names: list[str] = []
    patterns = entry if isinstance(entry, list) else [entry]
    for index, pattern in enumerate(patterns):
        place = (*path, index) if isinstance(entry, list) else path
        if not isinstance(pattern, str):
            message = f"expected the name of a file, got {spoken(pattern)}"
            raise complaint(document, place, message)
        try:
            found = listed(pattern)
        except InputError as error:
            raise complaint(document, place, error.message) from None
        names.extend(found)
    _check_count(document, path, len(names))
    return _Steps(key, tuple({"file": name} if whole else name for name in names))


# What a study asks as one mapping, and its digest: the same for every way to write it.


def canonical(value: object) -> str:
    """JSON with sorted keys and the shortest floats."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def study_digest(study: Study) -> str:
    """SHA-256 in hexadecimal of what decides the rows of a study and their order.

    A study with more rows behind the others has the same digest: how many are drawn counts only
    where there is a grid, and how many generations a search has, not at all.
    """
    asked = asked_of(study)
    if len(study.axes) == 0:
        asked.pop("draw.count", None)
    asked.pop("search.generations", None)
    return hashlib.sha256(canonical(asked).encode()).hexdigest()


def asked_of(study: Study) -> dict[str, Any]:
    """What a study asks by dotted keys, in SI units: to compare two studies, and to be written.

    Its name and text are left out.
    """
    maker = DesignMaker(study)
    asked: dict[str, Any] = {"design": _design(study, maker)}
    for name, content in study.named:
        asked[f"files.{name}"] = hashlib.sha256(content).hexdigest()
    for place, axis in enumerate(study.axes):
        steps = axis.numbers or [
            _step(study, maker, place, step) for step in range(len(axis.steps))
        ]
        # A grid is its steps; a search goes between the ends of a range as it is spaced.
        between = [axis.spacing] if study.search is not None else []
        asked[f"vary.{' and '.join(axis.keys)}"] = [place, [list(s) for s in steps], *between]
    for tolerance in study.tolerances:
        asked[f"tolerances.{tolerance.key}"] = asdict(tolerance)
    for section in ("draw", "search"):
        given = getattr(study, section)
        if given is not None:
            asked |= {f"{section}.{key}": value for key, value in asdict(given).items()}
    for section in ("limits", "accept"):
        for bound in getattr(study, section):
            asked[f"{section}.{bound.output}"] = asdict(bound)
    if study.header:
        asked["header"] = [
            [name, hashlib.sha256(content).hexdigest()] for name, content in study.header_files
        ] or study.header
    plain = {
        "outputs": study.outputs,
        "sensitivity": study.sensitivity,
        "pareto": [[goal.output, goal.minimise] for goal in study.goals],
    }
    return asked | {key: list(value) for key, value in plain.items() if value}


def _design(study: Study, maker: DesignMaker) -> str:
    """Digest of the design with what the study sets, less what varies."""
    assigned = {
        key: value
        for axis in study.axes
        for key, value in zip(axis.keys, axis.steps[0], strict=True)
    }
    values = _values(maker, assigned)
    if values is None:
        # Where the first row is none that a design may have, the text itself is what is asked.
        sets = canonical([list(pair) for pair in study.sets])
        return hashlib.sha256(study.design_text + sets.encode()).hexdigest()
    for name in assigned:
        key = design_key(name)
        values = values if key is None else values.without(key.path)
    return hashlib.sha256(canonical(plain_values(values)).encode()).hexdigest()


def _values(maker: DesignMaker, assigned: dict[str, YamlValue]) -> ResolvedValues | None:
    try:
        return resolved_values(maker.file(assigned))
    except InputError:
        return None


def _step(study: Study, maker: DesignMaker, place: int, step: int) -> list[Any]:
    """One step of an axis of words or sections."""
    axes = study.axes
    assigned = {
        key: value
        for index, axis in enumerate(axes)
        for key, value in zip(axis.keys, axis.steps[step if index == place else 0], strict=True)
    }
    values = _values(maker, assigned)
    return [_part(values, assigned, key) for key in axes[place].keys]


def _part(values: ResolvedValues | None, assigned: dict[str, YamlValue], name: str) -> Any:
    key = design_key(name)
    if values is None or key is None:
        return assigned[name]
    return plain_values(values.below(key.path))


def plain_values(values: ResolvedValues) -> list[Any]:
    """Numbers and words by their dotted paths, in the order of the paths."""
    numbers = {dotted(path): number for path, number in values.numbers.items()}
    words = {dotted(path): word for path, word in values.words.items()}
    return [sorted(numbers.items()), sorted(words.items(), key=lambda item: item[0])]


# What the sections of a design say once they are read: numbers in SI units and words by their
# paths, the same for every way to write them.

_OF_NO_MEANING = ("name", "about")  # Keys that change no number of a row.


@dataclass(frozen=True, slots=True)
class ResolvedValues:
    """Numbers (SI units) and words (kinds, names, what is left out) of a design by their paths."""

    numbers: Mapping[KeyPath, float]
    words: Mapping[KeyPath, str | bool | None]

    def below(self, path: KeyPath) -> ResolvedValues:
        """Those of one part."""
        length = len(path)
        return ResolvedValues(
            {key: value for key, value in self.numbers.items() if key[:length] == path},
            {key: value for key, value in self.words.items() if key[:length] == path},
        )

    def without(self, path: KeyPath) -> ResolvedValues:
        """All but those of one part."""
        length = len(path)
        return ResolvedValues(
            {key: value for key, value in self.numbers.items() if key[:length] != path},
            {key: value for key, value in self.words.items() if key[:length] != path},
        )

    def plus(self, other: ResolvedValues) -> ResolvedValues:
        """Those of both."""
        return ResolvedValues({**self.numbers, **other.numbers}, {**self.words, **other.words})


def resolved_values(file: DesignFile) -> ResolvedValues:
    """All values of a design that change what comes out of it.

    Names, origins and notes are left out; a key that the file leaves out stands with its default.
    """
    numbers: dict[KeyPath, float] = {}
    words: dict[KeyPath, str | bool | None] = {}
    for path, value in _single_values(file, ()):
        if isinstance(value, float):
            numbers[path] = value + 0.0  # -0 is 0
        else:
            words[path] = value
    return ResolvedValues(numbers, words)


def _single_values(
    value: object, path: KeyPath
) -> Iterator[tuple[KeyPath, float | str | bool | None]]:
    """Single values with their paths."""
    if isinstance(value, Quantity):
        yield path, float(value.si)
        # The unit tells a share from a time.
        yield (*path, "kind"), f"{value.kind or ''} {value.unit}"
    elif isinstance(value, Between):
        yield from _single_values(value.low, (*path, "from"))
        yield from _single_values(value.high, (*path, "to"))
    elif isinstance(value, Section):
        yield path, type(value).__name__
        for name in type(value).model_fields:
            if path or name not in _OF_NO_MEANING:
                yield from _single_values(getattr(value, name), (*path, name))
    elif isinstance(value, tuple):
        yield path, f"list of {len(value)}"
        for index, part in enumerate(value):
            yield from _single_values(part, (*path, index))
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path, float(value)
    else:
        yield path, value if value is None or isinstance(value, bool) else str(value)


# What was made of the studies used last: made once for each, and kept while it is in use.

_Made = TypeVar("_Made")
_MOST = 4


class Recent(Generic[_Made]):
    """Things made of studies, known by the study itself and not by what it says."""

    def __init__(self, make: Callable[[Study], _Made]) -> None:
        self._make = make
        self._kept: list[tuple[Study, _Made]] = []

    def of(self, study: Study) -> _Made:
        """What is made of a study; of the last few it is there already."""
        for known, made in self._kept:
            if known is study:
                return made
        made = self._make(study)
        self._kept.append((study, made))
        del self._kept[:-_MOST]
        return made


# Designs of the rows of a study: the design that it starts from, read once, with keys replaced.
#
# A row's design is read, checked and built as a file with these values would be. What a key of the
# study has set is named in messages by its position in the study.

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
        kept = ((name, _kept_kind(self._stands(name), new)) for name, new in assignments.items())
        return self._changed(self._base, kept)

    def _stands(self, name: str) -> YamlValue:
        """What the design of the study has at a key, None where it has nothing."""
        key = design_key(name)
        return None if key is None else value_at(self._base.data, key.path)

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


def _kept_kind(old: YamlValue, new: YamlValue) -> YamlValue:
    """A value of a row for an entry of the design that rows vary; where it is but a number, the
    convention of the old one holds on, whether it stands beside the value or in its text.
    """
    if isinstance(new, (dict, list)) or (isinstance(new, str) and kind_said(new)):
        return new
    entry = old if isinstance(old, dict) and "value" in old else {"value": old}
    said = [kind_said(text) for text in (entry["value"],) if isinstance(text, str)]
    named = [kind for kind in (entry.get("kind"),) if isinstance(kind, str)]
    kinds = " ".join(dict.fromkeys(part for part in (*said, *named) if part))
    return {"value": new, "kind": kinds} if kinds else new


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
        study: As `dqforge.machines.exploration.study_checks.read_study` reads it.
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
