"""Designs with one key changed: every word it may be, both ends of its range, left out,
and values that are wrong.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

import yaml
from pydantic import BaseModel

from dqforge.machines.design import catalogue
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.entries.rules import CountRule, QuantityRule

Path = tuple[str | int, ...]
_OFTEN_WRONG: tuple[object, ...] = (
    None,
    True,
    -1,
    0,
    "word",
    "1 furlong",
    1e300,
    [],
    {},
    [1, 2, 3],
    "nan",
    "3 V",
    1e-9,
)


@dataclass(frozen=True, slots=True)
class Change:
    """A design of the library with one key changed; ``what`` names the change.

    Its text is made on demand.
    """

    drive: str
    what: str
    base: dict[str, Any]
    path: Path
    value: object
    leave_out: bool = False

    @property
    def text(self) -> bytes:
        """The changed file."""
        changed = copy.deepcopy(self.base)
        inner: Any = changed
        for part in self.path[:-1]:
            if isinstance(inner, dict) and not isinstance(inner.get(str(part)), (dict, list)):
                inner[str(part)] = {}
            inner = inner[part]
        if self.leave_out:
            del inner[self.path[-1]]
        else:
            inner[self.path[-1]] = self.value
        return yaml.safe_dump(changed, sort_keys=False, allow_unicode=True).encode()


def document(drive: str) -> dict[str, Any]:
    """A design of the library, or the template, as plain data."""
    text = catalogue.template() if drive == "template" else catalogue.read_text(drive)
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def permitted(drive: str) -> Iterator[Change]:
    """Every word and both ends of the range of each key of the schema, and each
    key of the design left out.
    """
    base = document(drive)
    for path in sorted(key_paths(base), key=str):
        yield _change(drive, base, path, "left out", None, leave_out=True)
    for path, annotation, metadata in _fields(DesignFile, ()):
        for value in _values(annotation, metadata):
            yield _change(drive, base, path, f"is {value!r}", value)


def wrong(drive: str) -> Iterator[Change]:
    """Each key of the design with values that are mostly wrong, left out,
    or beside a key that nobody knows.
    """
    base = document(drive)
    for path in sorted(key_paths(base), key=str):
        yield _change(drive, base, path, "left out", None, leave_out=True)
        for value in _OFTEN_WRONG:
            yield _change(drive, base, path, f"is {value!r}", value)
        if isinstance(_at(base, path), (int, float, str)):
            for factor in (1e-6, 1e-3, 0.3, -1.0, 10.0, 1e3, 1e6):
                yield from _scaled(drive, base, path, factor)


def _scaled(drive: str, base: dict[str, Any], path: Path, factor: float) -> Iterator[Change]:
    value = _at(base, path)
    number, _, unit = str(value).partition(" ")
    try:
        scaled = float(number) * factor
    except ValueError:
        return
    if isinstance(value, int) and scaled == round(scaled):
        changed: object = int(scaled)
    else:
        changed = f"{scaled:g} {unit}" if unit else float(f"{scaled:g}")
    yield _change(drive, base, path, f"times {factor:g}", changed)


def _change(
    drive: str,
    base: dict[str, Any],
    path: Path,
    what: str,
    value: object,
    *,
    leave_out: bool = False,
) -> Change:
    return Change(drive, f"{'.'.join(map(str, path))} {what}", base, path, value, leave_out)


def _at(base: Any, path: Path) -> Any:
    for part in path:
        base = base[part]
    return base


def key_paths(node: Any, path: Path = ()) -> list[Path]:
    """All keys and list entries, those of sections included."""
    items = (
        node.items()
        if isinstance(node, dict)
        else enumerate(node)
        if isinstance(node, list)
        else ()
    )
    return [
        found for key, value in items for found in ((*path, key), *key_paths(value, (*path, key)))
    ]


def _fields(model: type[BaseModel], path: Path) -> Iterator[tuple[Path, Any, list[Any]]]:
    """Path, type and constraints of every key that is no section.

    Lists of sections are left out.
    """
    for name, field in model.model_fields.items():
        inner = [
            part
            for part in _parts(field.annotation)
            if isinstance(part, type) and issubclass(part, BaseModel)
        ]
        listed = any(get_origin(part) is tuple for part in _parts(field.annotation))
        if inner and not listed:
            for section in inner:
                yield from _fields(section, (*path, name))
        elif not inner:
            yield (*path, name), field.annotation, list(field.metadata)


def _parts(annotation: Any) -> list[Any]:
    """An annotation and everything inside it."""
    return [annotation, *(part for inner in get_args(annotation) for part in _parts(inner))]


def _values(annotation: Any, metadata: list[Any]) -> list[object]:
    """Words, truth values and ends of ranges that the type of a key permits."""
    parts = _parts(annotation)
    listed = any(get_origin(part) is tuple for part in parts)
    found: list[object] = []
    for part in parts:
        if get_origin(part) is Literal:
            found += [word for word in get_args(part) if isinstance(word, str)]
        elif part is bool:
            found += [True, False]
        for rule in [part, *metadata, *getattr(part, "__metadata__", ())]:
            found += _ends(rule)
    unique = [value for index, value in enumerate(found) if value not in found[:index]]
    return [[value] for value in unique] if listed else unique


def _ends(rule: object) -> list[object]:
    if isinstance(rule, QuantityRule):
        kinds = [{"value": rule.high, "kind": kind} for kind in rule.kinds]
        return [rule.low, rule.high, *([0.0] if rule.zero else []), *kinds]
    if isinstance(rule, CountRule):
        return [rule.low, rule.high]
    ends = (getattr(rule, name, None) for name in ("ge", "gt", "le", "lt"))
    return [end for end in ends if isinstance(end, (int, float))]
