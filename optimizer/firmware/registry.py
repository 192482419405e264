"""The methods of every firmware, by name."""

from __future__ import annotations

from dqforge.machines.names import Firmware
from dqforge.optimizer.firmware.firmware_method import FirmwareMethod
from dqforge.optimizer.firmware.targets.infineon import INFINEON
from dqforge.optimizer.firmware.targets.moteus import MOTEUS
from dqforge.optimizer.firmware.targets.nxp import NXP
from dqforge.optimizer.firmware.targets.odrive import ODRIVE
from dqforge.optimizer.firmware.targets.simplefoc import SIMPLEFOC
from dqforge.optimizer.firmware.targets.st import ST
from dqforge.optimizer.firmware.targets.ti import TI
from dqforge.optimizer.firmware.targets.vesc import VESC

METHODS: dict[Firmware, FirmwareMethod] = {
    method.name: method
    for method in (
        # A line per firmware.
        VESC,
        SIMPLEFOC,
        MOTEUS,
        ODRIVE,
        NXP,
        ST,
        TI,
        INFINEON,
    )
}
