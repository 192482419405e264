"""One value of a design with its origin, as it is shown and traced."""

from __future__ import annotations

from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class InputValue:
    """One value of the design as it was read.

    ``path`` is the dotted key, ``text`` what the file says, ``si`` the value in SI with its
    ``unit``, ``source`` where the author says it comes from, ``inferred`` whether it was deduced,
    ``note`` what was converted or assumed.
    """

    path: str
    text: str
    si: float
    unit: str
    source: str = ""
    inferred: bool = False
    note: str = ""
