"""Keys of a design by their dotted paths: which there are, what stands there, and the number that
a value is in SI units.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from dqforge.machines.design.schema import DesignFile
from dqforge.machines.entries.complaints import SYNONYMS
from dqforge.machines.entries.former_keys import present_path
from dqforge.machines.entries.rules import CountRule, EntryError, QuantityRule, Rule, spoken
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.places import KeyPath
from dqforge.machines.records import dataclass
from dqforge.machines.units.registry import DIMENSIONS
from dqforge.machines.wording import close_matches

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
