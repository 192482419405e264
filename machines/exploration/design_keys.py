"""Keys of a design by their dotted paths: which there are, what stands there, and the number that
a value is in SI units.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel

from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.sections.machine import FLUX_KEYS
from dqforge.machines.entries.former_keys import SYNONYMS, present_path
from dqforge.machines.entries.kinds import Between
from dqforge.machines.entries.rules import (
    CountRule,
    EntryError,
    Quantity,
    QuantityRule,
    Rule,
    spoken,
    unknown_key,
)
from dqforge.machines.errors import InputError, KeyPath, close_matches, dotted, shown
from dqforge.machines.exploration.study import Draw, StudyFile, Tolerance
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import read_quantity
from dqforge.machines.units.registry import DIMENSIONS

KeySort = Literal["quantity", "count", "whole", "real", "word", "other"]

_ANY = 1e300


@dataclass(frozen=True, slots=True)
class DesignKey:
    """What stands at a key of a design.

    Args:
        name: The dotted path as the study writes it.
        path: Its parts; entries of lists as numbers.
        sort: ``quantity``, ``count`` (a whole number of things), ``whole`` and ``real`` (numbers
            without a unit), ``word`` (one of ``words``), ``other`` (sections, lists, texts).
        dimension: Of a quantity, a key of `dqforge.machines.units.registry.DIMENSIONS`.
        words: What may stand there, or in the list that stands there where ``listed``.
        parts: Keys of the section that stands there.
    """

    name: str
    path: KeyPath
    sort: KeySort
    dimension: str = ""
    words: tuple[str, ...] = ()
    listed: bool = False
    parts: tuple[str, ...] = ()
    rule: Rule | None = None

    @property
    def unit(self) -> str:
        """SI unit; empty for numbers without one."""
        return DIMENSIONS[self.dimension].unit if self.dimension else ""

    @property
    def is_number(self) -> bool:
        """Whether a single number stands there."""
        return self.sort in ("quantity", "count", "whole", "real")

    def number(self, value: YamlValue) -> tuple[float, str | None]:
        """A value in SI units and the kind that it names, whether a design may have it or not.

        Raises `EntryError` where it is no number of this key.
        """
        if isinstance(self.rule, QuantityRule):
            anything = replace(self.rule, low=-_ANY, high=_ANY, zero=True, kind_open=True)
            found = anything.read(value)
            return found.si, found.kind if found.kind_given else None
        if isinstance(self.rule, CountRule):
            return replace(self.rule, low=-(10**9), high=10**9).read(value).si, None
        whole = self.sort == "whole"
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            what = "a whole number" if whole else "a number without a unit"
            raise EntryError(f"expected {what}, got {spoken(value)}")
        return float(value), None

    def written(self, number: float, kind: str | None = None) -> YamlValue:
        """A number in SI units as a design file writes it: read again it is the same float."""
        value: YamlValue = float(number)
        if self.sort == "quantity":
            value = f"{number!r} {self.unit}".strip()
        elif self.sort != "real" and number == int(number):
            value = int(number)
        return value if kind is None else {"value": value, "kind": kind}


@cache
def design_key(name: str) -> DesignKey | None:
    """The key of a dotted path such as ``losses.points[0].torque``; None for no key of a design."""
    written = re.sub(r"\[(\d+)\]", r".\1", name).split(".")
    parts = [str(part) for part in present_path(tuple(written), DesignFile)]
    return next(iter(_found(parts, DesignFile, name)), None)


def no_such_key(name: str) -> str:
    """What to say of a path that is none, with the key that was probably meant."""
    if name.rpartition(".")[2] in ("value", "kind", "source", "inferred", "note"):
        entry = name.rpartition(".")[0]
        if design_key(entry) is not None:
            return f"belongs to the entry {entry}; write {entry}: {{value: ..., kind: ...}}"
    known = _names()
    section, _, last = name.rpartition(".")
    meant = SYNONYMS.get(last.casefold(), last)
    beside = [key for key in known if key.rpartition(".")[0] == section]
    alike = [key for key in known if key == f"{section}.{meant}"]
    alike = alike or close_matches(name, beside, limit=1)
    alike = alike or [key for key in known if key.rpartition(".")[2] == meant][:2]
    alike = alike or close_matches(name, known)
    hint = f"did you mean {' or '.join(alike)}?" if alike else "'dqforge schema' lists the keys"
    return f"no such key in a design; {hint}"


@cache
def _names() -> tuple[str, ...]:
    """Every dotted path without those inside lists; sections too."""
    return tuple(dict.fromkeys(_paths(DesignFile, "")))


def _paths(model: type[BaseModel], before: str) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield f"{before}{name}"
        for annotation, _ in _forms(field.annotation, field.metadata):
            if _is_model(annotation):
                yield from _paths(annotation, f"{before}{name}.")


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _forms(annotation: Any, metadata: list[Any]) -> Iterator[tuple[Any, list[Any]]]:
    """Alternatives of a type, each with the rules that it carries."""
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *more = get_args(annotation)
        yield from _forms(inner, [*metadata, *more])
    elif origin in (Union, UnionType):
        for part in get_args(annotation):
            if part is not type(None):
                yield from _forms(part, metadata)
    else:
        yield annotation, metadata


def _found(parts: list[str], model: type[BaseModel], name: str) -> Iterator[DesignKey]:
    """Keys at a path below a section; of two forms of a section both may have it."""
    field = model.model_fields.get(parts[0])
    if field is None:
        return
    forms = list(_forms(field.annotation, list(field.metadata)))
    yield from _below((parts[0],), parts[1:], forms, name)


def _below(
    path: KeyPath, rest: list[str], forms: list[tuple[Any, list[Any]]], name: str
) -> Iterator[DesignKey]:
    if not rest:
        yield _leaf(path, forms, name)
        return
    for annotation, _ in forms:
        if _is_model(annotation):
            for found in _found(rest, annotation, name):
                yield replace(found, path=(*path, *found.path))
        elif get_origin(annotation) is tuple and re.fullmatch(r"0|[1-9]\d{0,5}", rest[0]):
            inner = list(_forms(get_args(annotation)[0], []))
            yield from _below((*path, int(rest[0])), rest[1:], inner, name)


def _leaf(path: KeyPath, forms: list[tuple[Any, list[Any]]], name: str) -> DesignKey:
    """What stands at the end of a path."""
    rule = next(
        (
            part
            for _, metadata in forms
            for part in metadata
            if isinstance(part, (QuantityRule, CountRule))
        ),
        None,
    )
    if isinstance(rule, QuantityRule):
        return DesignKey(name, path, "quantity", rule.dimension, rule=rule)
    if rule is not None:
        return DesignKey(name, path, "count", rule=rule)
    annotations = [annotation for annotation, _ in forms]
    for number, sort in ((int, "whole"), (float, "real")):
        if annotations == [number]:
            return DesignKey(name, path, "whole" if sort == "whole" else "real")
    listed = all(get_origin(annotation) is tuple for annotation in annotations)
    inner = (
        [form for annotation in annotations for form, _ in _forms(get_args(annotation)[0], [])]
        if listed
        else annotations
    )
    if inner and all(get_origin(annotation) is Literal for annotation in inner):
        words = tuple(str(word) for annotation in inner for word in get_args(annotation))
        return DesignKey(name, path, "other" if listed else "word", words=words, listed=listed)
    models = [annotation for annotation in annotations if _is_model(annotation)]
    keys = tuple(dict.fromkeys(key for model in models for key in model.model_fields))
    return DesignKey(name, path, "other", parts=keys, listed=listed)


# The sections ``tolerances`` and ``draw`` of a study: what is drawn, and how often.

_KINDS = ("normal", "uniform", "between")
_SECTION = "tolerances"
_EXAMPLE = "{normal: 5 %}"

# Keys of a design that its ``control.tolerances`` are about.
_BOX: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("r_s", ("machine.resistance",)),
    ("l_d", ("machine.inductance_d",)),
    ("l_q", ("machine.inductance_q",)),
    ("psi_pm", tuple(f"machine.{key}" for key in FLUX_KEYS)),
    ("inertia", ("machine.inertia",)),
    ("v_dc", ("inverter.v_dc",)),
)

# Value of the design at a key in SI units, None where it has none.
ValueOf = Callable[[DesignKey], float | None]


def read_tolerances(
    document: YamlDocument, file: DesignFile, value_of: ValueOf
) -> tuple[Tolerance, ...]:
    """What is drawn, in the order of the keys.

    Args:
        document: The study file.
        file: The design that it starts from, with what the study sets.
        value_of: Its value at a key.

    Raises:
        InputError: A key is none of a design, or has no distribution; a width is of another unit,
            or negative.
    """
    section = document.data.get(_SECTION, {})
    path: KeyPath = (_SECTION,)
    if section == "design":
        section = {"design": "uniform"}
    elif not isinstance(section, dict):
        message = f"expected keys of the design, or the word design, got {spoken(section)}"
        raise complaint(document, path, message)
    drawn = {}
    if "design" in section:
        if section["design"] != "uniform":
            message = f"expected uniform, got {spoken(section['design'])}"
            raise complaint(document, (*path, "design"), message)
        drawn = {found.key: found for found in _box(document, file, value_of)}
    for name, entry in section.items():
        if name != "design":
            drawn[name] = _tolerance(document, (*path, name), entry, value_of)
    return tuple(drawn[name] for name in sorted(drawn))


def _box(document: YamlDocument, file: DesignFile, value_of: ValueOf) -> list[Tolerance]:
    """Uniform distributions over the box of the design's own tolerances."""
    path: KeyPath = (_SECTION, "design") if (_SECTION, "design") in document.keys else (_SECTION,)
    given = file.control.tolerances
    if given is None:
        raise complaint(
            document, path, "the design has no control.tolerances; write the keys here", key=True
        )
    found = []
    for name, choices in _BOX:
        deviation = getattr(given, name)
        if deviation is None:
            continue
        at = next(
            ((key, value) for key in choices if (value := _value(key, value_of)) is not None), None
        )
        if at is None:
            raise complaint(
                document,
                path,
                f"control.tolerances.{name} has no key to draw: the design has no {choices[0]}",
                key=True,
            )
        found.append(_deviation(deviation, *at))
    if not found:
        raise complaint(
            document, path, "control.tolerances of the design have no key to draw", key=True
        )
    return found


def _value(name: str, value_of: ValueOf) -> float | None:
    key = design_key(name)
    return None if key is None else value_of(key)


def _deviation(deviation: Quantity | Between, name: str, centre: float) -> Tolerance:
    if isinstance(deviation, Between):
        ends = sorted(centre * (1.0 + side.si) for side in (deviation.low, deviation.high))
        return Tolerance(name, "between", low=ends[0], high=ends[1], centre=centre)
    return Tolerance(name, "uniform", width=deviation.si, centre=centre)


def _tolerance(
    document: YamlDocument, path: KeyPath, entry: YamlValue, value_of: ValueOf
) -> Tolerance:
    """One key that is drawn."""
    key = known_key(document, path)
    if key.sort not in ("quantity", "real"):
        what = {"word": "a word", "count": "a whole number", "whole": "a whole number"}
        name = what.get(key.sort, "a list" if key.listed else "a section")
        raise complaint(
            document, path, f"{name} has no distribution; write values: [...] under vary", key=True
        )
    given = mapping_at(document, path, entry, (*_KINDS, "cut"), _EXAMPLE)
    kind = only_one(document, path, given, _KINDS)
    if "cut" in given and kind != "normal":
        raise complaint(document, (*path, "cut"), "goes with normal", key=True)
    centre = value_of(key)
    if kind == "between":
        return _between(document, (*path, kind), key, given[kind], centre)
    width, relative = _width(document, (*path, kind), key, given[kind])
    if centre is None or (relative and centre == 0.0):
        lack = "has no value in" if centre is None else "is 0 in"
        raise complaint(
            document,
            path,
            f"{key.name} {lack} the design, so that there is nothing to deviate from; write "
            "between: [..., ...]",
            key=True,
        )
    found = Tolerance(key.name, "uniform", width, relative, centre=centre)
    if kind == "uniform":
        return found
    return replace(found, kind="normal", cut=_cut(document, (*path, "cut"), given.get("cut", 3.0)))


def _cut(document: YamlDocument, path: KeyPath, value: YamlValue) -> float:
    """Standard deviations at which a normal distribution ends."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise complaint(
            document, path, f"expected a number of standard deviations, got {spoken(value)}"
        )
    if not 0.1 <= value <= 8.0:
        raise complaint(document, path, f"expected 0.1 to 8, got {spoken(value)}; write e.g. 3")
    return float(value)


def _width(
    document: YamlDocument, path: KeyPath, key: DesignKey, value: YamlValue
) -> tuple[float, bool]:
    """Width of a distribution, and whether it is a share of the design's value."""
    share = share_of(value)
    if share is not None:
        width, relative = share, True
    else:
        if key.dimension == "temperature" and isinstance(value, str):
            # A difference: 5 K are not -268 degC.
            value = value.strip().removesuffix("degC").removesuffix("°C").removesuffix("K").strip()
        width, relative = number_at(document, path, key, value)[0], False
    if width < 0.0:
        raise complaint(document, path, f"{shown(value)} is negative; write a positive width")
    if width == 0.0:
        raise complaint(document, path, "nothing is drawn of a width of 0; remove the key")
    if relative and width > 10.0:
        raise complaint(document, path, f"{shown(value)} is more than 1000 %; check the number")
    return width, relative


def _between(
    document: YamlDocument, path: KeyPath, key: DesignKey, value: YamlValue, centre: float | None
) -> Tolerance:
    """``between: [low, high]``; shares are of the design's value."""
    if not isinstance(value, list) or len(value) != 2:
        raise complaint(
            document, path, f"expected two ends, got {spoken(value)}; write [low, high]"
        )
    ends = []
    for index, end in enumerate(value):
        place, share = (*path, index), share_of(end)
        if share is None:
            ends.append(number_at(document, place, key, end)[0])
        elif centre is None or centre == 0.0:
            message = (
                f"a share needs a value of {key.name} in the design; write both ends as values"
            )
            raise complaint(document, place, message)
        else:
            ends.append(centre * (1.0 + share))
    low, high = ends
    if not low < high:
        raise complaint(document, path, "the first end is not below the second; exchange them")
    return Tolerance(key.name, "between", low=low, high=high, centre=centre or 0.0)


def read_draw(
    document: YamlDocument, file: StudyFile, tolerances: Sequence[Tolerance]
) -> Draw | None:
    """How often is drawn, None where nothing is.

    Raises:
        InputError: One of ``tolerances`` and ``draw`` is missing, or correlations contradict each
            other.
    """
    if file.draw is None:
        if tolerances:
            raise complaint(
                document,
                (_SECTION,),
                "the number of draws is not given; write draw: {count: 100000, seed: 1}",
                key=True,
            )
        return None
    if not tolerances:
        raise complaint(
            document, ("draw",), "nothing is drawn; write tolerances, or remove draw", key=True
        )
    names = [tolerance.key for tolerance in tolerances]
    triples: list[tuple[str, str, float]] = []
    for index, pair in enumerate(file.draw.correlations):
        path: KeyPath = ("draw", "correlations", index)
        for part, name in enumerate(pair.keys):
            if name not in names:
                raise complaint(
                    document, (*path, "keys", part), f"'{name}' is not drawn; add it to tolerances"
                )
        one, other = sorted(pair.keys)
        if one == other or any(triple[:2] == (one, other) for triple in triples):
            message = "both keys are one" if one == other else "this pair is there twice"
            raise complaint(document, (*path, "keys"), message)
        triples.append((one, other, pair.rho))
    if triples and not _possible(names, triples):
        raise complaint(
            document,
            ("draw", "correlations"),
            "no numbers have these correlations together; make them smaller",
        )
    draw = file.draw
    return Draw(draw.count, draw.seed, draw.sampling, tuple(sorted(triples)))


def _possible(names: list[str], triples: Sequence[tuple[str, str, float]]) -> bool:
    """Whether the matrix of all correlations is positive definite."""
    matrix = np.eye(len(names))
    for one, other, rho in triples:
        places = names.index(one), names.index(other)
        matrix[places] = matrix[places[::-1]] = rho
    return bool(np.linalg.eigvalsh(matrix)[0] > 1e-9)


# Mappings of a study file whose keys are keys of a design or names of outputs: read one by one,
# with every complaint at its place.

MOST = 1e300


def complaint(
    document: YamlDocument, path: KeyPath, message: str, *, key: bool = False
) -> InputError:
    """An error that names the key and points to it."""
    return document.error(f"{dotted(path)}: {message}", path, key=key)


def mapping_at(
    document: YamlDocument, path: KeyPath, value: YamlValue, allowed: tuple[str, ...], example: str
) -> dict[str, YamlValue]:
    """A mapping with known keys.

    Raises:
        InputError: It is none, is empty, or has a key that is not allowed.
    """
    if not isinstance(value, dict) or not value:
        got = spoken(value) if not isinstance(value, dict) else "an empty mapping"
        raise complaint(document, path, f"expected a mapping, got {got}; write {example}")
    for name in value:
        if name not in allowed:
            message = f"{dotted(path)}: {unknown_key(name, allowed)}"
            raise document.error(message, (*path, name), key=True)
    return value


def only_one(
    document: YamlDocument, path: KeyPath, found: Iterable[str], choices: tuple[str, ...]
) -> str:
    """The one of several keys that stands there; raises `InputError` for none and for two."""
    there = [name for name in found if name in choices]
    if len(there) != 1:
        got = " and ".join(there) if there else "none"
        expected = f"one of {', '.join(choices)}"
        raise complaint(document, path, f"expected {expected}, got {got}", key=True)
    return there[0]


def known_key(document: YamlDocument, path: KeyPath) -> DesignKey:
    """The key of a design that the last part of a path names; raises `InputError` for no such."""
    name = str(path[-1])
    if name == "dqforge":
        message = "the version of the format is the same in every design; remove the key"
        raise complaint(document, path, message, key=True)
    key = design_key(name)
    if key is None:
        raise complaint(document, path, no_such_key(name), key=True)
    return key


def number_at(
    document: YamlDocument, path: KeyPath, key: DesignKey, value: YamlValue
) -> tuple[float, str | None]:
    """A value of a key of a design in SI units and its kind; raises `InputError` for no number."""
    try:
        return key.number(value)
    except EntryError as error:
        part = path if error.key is None else (*path, error.key)
        place = part if part in document.values else path
        raise document.error(f"{dotted(path)}: {error.message}", place, key=error.at_key) from None


def quantity_at(
    document: YamlDocument,
    path: KeyPath,
    dimension: str,
    value: YamlValue,
    low: float = -MOST,
    high: float = MOST,
) -> float:
    """A quantity in SI units; raises `InputError` where it has another dimension, or is outside."""
    try:
        return (
            QuantityRule(dimension, low, high)
            .read(value if not isinstance(value, dict) else [value])
            .si
        )
    except EntryError as error:
        raise complaint(document, path, error.message) from None


def share_of(value: YamlValue) -> float | None:
    """A share that is written in per cent, None for what is written otherwise."""
    if not isinstance(value, str) or not value.strip().endswith("%"):
        return None
    try:
        return read_quantity(value, "number").si
    except InputError:
        return None
