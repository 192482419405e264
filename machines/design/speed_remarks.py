"""Speeds that a design file writes without a unit: they are in rad/s,
where rpm may have been meant.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel

from dqforge.machines.entries.kinds import Section, quantities
from dqforge.machines.entries.rules import Quantity, QuantityRule
from dqforge.machines.places import dotted
from dqforge.machines.units.quantities import format_quantity

# How far above the largest speed a speed without a unit is taken for one in rpm (30/pi = 9.5 lies
# between them).
FACTOR = 3.0


def bare_speed_remarks(file: Section, largest: Quantity | None) -> tuple[str, ...]:
    """Sentences on speeds of a file without a unit that lie far above the ``largest`` one,
    and on a largest one without a unit.
    """
    remarks = []
    for parts, quantity in quantities(file):
        if quantity.dimension != "speed" or not quantity.bare:
            continue
        path = dotted(parts)
        if path == "machine.max_speed":
            remarks.append(f"{path} {_bare(quantity)}")
        elif largest is not None and abs(quantity.si) > FACTOR * largest.si:
            times = abs(quantity.si) / largest.si
            remarks.append(f"{path} {_bare(quantity)}; that is {times:.3g} times the largest speed")
    return tuple(remarks)


def bare_speed_hint(quantity: Quantity) -> str:
    """What to write for a speed that is too large: the unit, where it has none."""
    if not quantity.bare:
        return "correct one of them"
    return (
        f"'{quantity.text}' has no unit and is taken as rad/s; write '{quantity.text} rpm' if that "
        "is meant"
    )


def _bare(quantity: Quantity) -> str:
    speed = format_quantity(quantity.si, "rpm")
    return (
        f"has no unit and is taken as {quantity.text} rad/s, {speed}; write '{quantity.text} rpm' "
        "if that is meant"
    )


def speed_keys(model: type[BaseModel], path: str = "") -> Iterator[str]:
    """Paths of all keys of a schema that hold a speed; ``[]`` stands for the entries of a list."""
    for name, field in model.model_fields.items():
        place = f"{path}.{name}" if path else name
        if any(
            isinstance(part, QuantityRule) and part.dimension == "speed" for part in field.metadata
        ):
            yield place
        yield from _inside(field.annotation, place)


def _inside(annotation: Any, place: str) -> Iterator[str]:
    if isinstance(annotation, QuantityRule) and annotation.dimension == "speed":
        yield place
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield from speed_keys(annotation, place)
    several = getattr(annotation, "__origin__", None) is tuple
    for part in get_args(annotation):
        yield from _inside(part, place + "[]" if several else place)
