"""Parameters of motor-ctrl-lib written: two functions that assign them, or the values in a file
that assigns them already.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.optimizer.firmware.firmware_method import FLOAT32_DIGITS
from dqforge.optimizer.firmware.infineon_format import (
    KEYS,
    TABLE,
    TABLE_KEYS,
    TABLE_POINTS,
    Key,
    Kind,
    Place,
)
from dqforge.optimizer.firmware.targets.infineon import INFINEON
from dqforge.reports.firmware.c_macros import with_values
from dqforge.reports.firmware.infineon.reader import assignments, member, read, recognise
from dqforge.reports.firmware.target import Target, c_float
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, OwnValue
    from dqforge.reports.firmware.target import FileTitle


_EXISTING = "existing file"


_PER_LINE = 8


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_params.h``.

    Args:
        found: The configuration; of its own values those that a design decides are written.
        title: What stands at the head of the file.
        existing_text: A ParamsDefault.c or a header as written before: what it assigns to members
            that the design decides is replaced, but for those for starting the motor; everything
            else stays. None without one.
    """
    name = f"{title.prefix}_params.h"
    if existing_text is not None:
        return {name: _with_values(existing_text, found).encode("utf-8")}
    own = found.own
    points = str(own.get(TABLE, "")).split(", ") if TABLE in own else []
    text = render(
        "firmware/infineon/params.h.j2",
        {
            "title": title,
            "guard": f"{title.prefix.upper()}_PARAMS_H",
            "any": _lines(own, "any"),
            "rotor": _lines(own, "rotor"),
            "gains": _lines(own, "gains"),
            "table": [_line(own, name, key) for name, key in TABLE_KEYS.items() if name in own],
            "width": TABLE_POINTS,
            "points": [
                ", ".join(
                    c_float(float(point), FLOAT32_DIGITS)
                    for point in points[start : start + _PER_LINE]
                )
                for start in range(0, len(points), _PER_LINE)
            ],
        },
    )
    return {name: text.encode("utf-8")}


def _lines(own: Mapping[str, OwnValue], place: Place) -> list[tuple[str, str, str]]:
    return [
        _line(own, name, key) for name, key in KEYS.items() if key.place == place and name in own
    ]


def _line(own: Mapping[str, OwnValue], name: str, key: Key) -> tuple[str, str, str]:
    """What is assigned, its text, and its unit with what it means."""
    words = f"{key.unit}: {key.says}" if key.unit else key.says
    return name.replace("params.", "params->", 1), printed(own[name], key.kind), words


def printed(value: OwnValue, kind: Kind) -> str:
    """A value as the library's members take it."""
    if isinstance(value, str):
        return value
    if kind == "count" and isinstance(value, int):
        return f"{value:d}U"
    return c_float(value, FLOAT32_DIGITS)


def _with_values(text: str, found: Configuration) -> str:
    """The text with the design's values behind what it assigns; the table stays what the library
    makes of it.
    """
    there = assignments(text, _EXISTING)
    wanted = {
        name: printed(value, KEYS[name].kind)
        for name, value in found.own.items()
        if name in KEYS and not KEYS[name].start
    }
    values = {
        assigned: wanted[name]
        for assigned in there
        if (name := member(assigned)) is not None and name in wanted
    }
    return with_values(text, there, values)


# Infineon's motor-ctrl-lib among the firmware whose files are written and read.

TARGET = Target(
    INFINEON, "Infineon motor-ctrl-lib (ParamsDefault.c, release 4.5)", write, recognise, read
)
