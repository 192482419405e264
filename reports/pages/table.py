"""Tables for the terminal: results become rows of text here, and nowhere are they computed."""

from __future__ import annotations

from dataclasses import field

from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Table:
    """A titled table of text: ``columns`` are the headings with units, ``rows`` the cells,
    ``notes`` lines below.
    """

    title: str
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)
