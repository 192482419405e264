"""Options of commands that are written as text."""

from __future__ import annotations

import re

from dqforge.machines.errors import InputError

_MOST_CELLS = 2000


def map_size(text: str) -> tuple[int, int]:
    """Numbers of torques and speeds of the option --map.

    An `InputError` where it is not understood.
    """
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text.strip(), re.IGNORECASE)
    sizes = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(2 <= size <= _MOST_CELLS for size in sizes):
        raise InputError(
            f"--map: expected NxM with 2 to {_MOST_CELLS} torques and speeds such as 40x60, got "
            f"'{text}'"
        )
    return sizes
