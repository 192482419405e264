"""The section ``vary`` of a study: keys of the design with the values that they take in turn."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from dqforge.machines.entries.rules import not_one_of, spoken
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.design_keys import DesignKey
from dqforge.machines.exploration.study import Axis, Spacing
from dqforge.machines.exploration.study_entries import (
    complaint,
    known_key,
    mapping_at,
    number_at,
    only_one,
)
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue
from dqforge.machines.places import KeyPath
from dqforge.machines.records import dataclass

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
