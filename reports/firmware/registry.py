"""The firmware whose files are written and read, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from dqforge.machines.loaded_by_name import LoadedByName
from dqforge.machines.names import Firmware

if TYPE_CHECKING:
    from dqforge.reports.firmware.target import Target

TARGETS: LoadedByName[Firmware, Target] = LoadedByName(
    {name: f"dqforge.reports.firmware.{name}.target:TARGET" for name in get_args(Firmware)}
)
