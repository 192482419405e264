"""Configurations of an ODrive 0.5 written: the JSON that ``odrivetool restore-config`` takes."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from dqforge.optimizer.firmware.odrive_format import KINDS
from dqforge.optimizer.firmware.targets.odrive import ODRIVE
from dqforge.reports.firmware.json_text import parsed_json, with_json_values
from dqforge.reports.firmware.odrive.reader import ENDING, chosen_axis, path_of, read, recognise
from dqforge.reports.firmware.target import Target

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration
    from dqforge.reports.firmware.target import FileTitle


_EXISTING = "existing file"


_NEW_AXIS = "axis0"


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_odrive.json`` with the properties that a design decides; odrivetool leaves all
    others of the drive as they are.

    Args:
        found: The configuration; of its own values those that the format holds are written.
        title: Its prefix names the file.
        existing_text: File whose other properties are to stay; None without one.
    """
    values = {key: value for key in KINDS if (value := found.own.get(key)) is not None}
    if existing_text is None:
        tree: dict[str, Any] = {}
        for key, value in values.items():
            _set(tree, path_of(_NEW_AXIS, key), value)
        text = json.dumps(tree, indent=2) + "\n"
    else:
        axis = chosen_axis(parsed_json(existing_text, _EXISTING, constants=True))
        placed = {path_of(axis, key): value for key, value in values.items()}
        text = with_json_values(existing_text, _EXISTING, placed, constants=True)
    return {f"{title.prefix}{ENDING}": text.encode("utf-8")}


def _set(tree: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    for key in path[:-1]:
        tree = tree.setdefault(key, {})
    tree[path[-1]] = value


# ODrive 0.5 among the firmware whose files are written and read.

TARGET = Target(ODRIVE, "ODrive (v3.x boards, firmware 0.5)", write, recognise, read)
