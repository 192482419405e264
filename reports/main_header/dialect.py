"""A dialect of the main header: the names and scales of one firmware, with a template."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dqforge.machines.records import dataclass
from dqforge.reports.c_code.harness import Constant, ConstantGroup
from dqforge.reports.plain_data import PlainData


@dataclass(frozen=True, slots=True)
class Entry:
    """A constant as the header prints it: name without prefix, value and comment."""

    name: str
    value: float
    comment: str


@dataclass(frozen=True, slots=True)
class Dialect:
    """How one firmware writes the header.

    Args:
        name: That of its folder.
        template: The header (``main_header/dialects/<name>/<file>``, or the path of a file). It
            sees the groups and includes ``main_header/evaluator.j2``.
        entry: A constant in its names and units; None where it has none of that kind. Names without
            the prefix, which the template puts before them; the ends of the torque domain
            (``limit.``) need one, because the evaluator compares with them.
    """

    name: str
    template: str
    entry: Callable[[Constant], Entry | None]


def entries_of(dialect: Dialect, groups: Sequence[ConstantGroup]) -> list[PlainData]:
    """Groups as the template prints them, less constants that the dialect does not have."""
    return [
        {
            "title": group.title,
            "comment": group.comment,
            "entries": [
                entry for constant in group.constants if (entry := dialect.entry(constant))
            ],
        }
        for group in groups
    ]


def names_of(dialect: Dialect, groups: Sequence[ConstantGroup]) -> dict[str, str]:
    """Names by quantity: the evaluator asks for those of the ends of its domain."""
    found = [
        (constant, dialect.entry(constant)) for group in groups for constant in group.constants
    ]
    return {constant.quantity: entry.name for constant, entry in found if entry is not None}
