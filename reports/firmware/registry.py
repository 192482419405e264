"""The firmware whose files are written and read, by name."""

from __future__ import annotations

from dqforge.machines.names import Firmware
from dqforge.reports.firmware.st.target import TARGET as ST
from dqforge.reports.firmware.target import Target

TARGETS: dict[Firmware, Target] = {
    target.method.name: target
    for target in (
        # A line per firmware.
        ST,
    )
}
