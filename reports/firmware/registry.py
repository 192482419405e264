"""The firmware whose files are written and read, by name."""

from __future__ import annotations

from dqforge.machines.names import Firmware
from dqforge.reports.firmware.infineon.target import TARGET as INFINEON
from dqforge.reports.firmware.moteus.target import TARGET as MOTEUS
from dqforge.reports.firmware.nxp.target import TARGET as NXP
from dqforge.reports.firmware.odrive.target import TARGET as ODRIVE
from dqforge.reports.firmware.simplefoc.target import TARGET as SIMPLEFOC
from dqforge.reports.firmware.st.target import TARGET as ST
from dqforge.reports.firmware.target import Target
from dqforge.reports.firmware.ti.target import TARGET as TI
from dqforge.reports.firmware.vesc.target import TARGET as VESC

TARGETS: dict[Firmware, Target] = {
    target.method.name: target
    for target in (
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
