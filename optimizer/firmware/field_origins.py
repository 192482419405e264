"""Where the fields of a configuration stand in a file, from where its own values stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Origin

# By the field of the configuration (``r_s``, ``current_d.kp``) the name in the file, or several of
# which the first one there counts, and how the value is converted.
Fields = Mapping[str, tuple[str | tuple[str, ...], str]]


def field_origins(found: Mapping[str, Origin], fields: Fields) -> dict[str, Origin]:
    """Origins by the field of the configuration, and by the file's own name.

    Args:
        found: By the file's own name.
        fields: What the fields are made of; those of which nothing is there are left out.
    """
    by_field = {}
    for field, (names, conversion) in fields.items():
        those = (names,) if isinstance(names, str) else names
        origin = next((found[name] for name in those if name in found), None)
        if origin is not None:
            by_field[field] = replace(origin, conversion=conversion)
    return by_field | dict(found)
