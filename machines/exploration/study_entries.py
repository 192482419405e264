"""Mappings of a study file whose keys are keys of a design or names of outputs: read one by one,
with every complaint at its place.
"""

from __future__ import annotations

from collections.abc import Iterable

from dqforge.machines.entries.rules import EntryError, QuantityRule, spoken, unknown_key
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.design_keys import DesignKey, design_key, no_such_key
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue
from dqforge.machines.places import KeyPath, dotted
from dqforge.machines.units.quantities import read_quantity

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
