"""The methods of every firmware, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from dqforge.machines.loaded_by_name import LoadedByName
from dqforge.machines.names import Firmware

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.firmware_method import FirmwareMethod

METHODS: LoadedByName[Firmware, FirmwareMethod] = LoadedByName(
    {
        name: f"dqforge.optimizer.firmware.targets.{name}:{name.upper()}"
        for name in get_args(Firmware)
    }
)
