"""Settings in SI units from a section of the design file, field by field."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

from dqforge.machines.entries.kinds import Section
from dqforge.machines.entries.rules import Quantity

_Settings = TypeVar("_Settings")


def settings_from(settings: type[_Settings], section: Section, **given: Any) -> _Settings:
    """Settings whose fields are the keys of a section.

    Args:
        settings: A dataclass. A field that bears the name of a key takes its value, a quantity in
            SI units; a key that the file leaves out leaves the field at its default.
        section: The section of the file.
        given: Fields that are more than their key, or have another name than it.

    Raises:
        TypeError: A field without a default is neither a key nor given.
    """
    values = dict(given)
    for field in fields(settings):  # type: ignore[arg-type]
        if field.name in values or field.name not in type(section).model_fields:
            continue
        value = getattr(section, field.name)
        if value is not None:
            values[field.name] = _in_si(value)
    return settings(**values)


def _in_si(value: Any) -> Any:
    if isinstance(value, Quantity):
        return value.si
    if isinstance(value, tuple):
        return tuple(_in_si(part) for part in value)
    return value
