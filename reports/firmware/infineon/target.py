"""Infineon's motor-ctrl-lib among the firmware whose files are written and read."""

from __future__ import annotations

from dqforge.optimizer.firmware.targets.infineon import INFINEON
from dqforge.reports.firmware.infineon.reader import read, recognise
from dqforge.reports.firmware.infineon.writer import write
from dqforge.reports.firmware.target import Target

TARGET = Target(
    INFINEON, "Infineon motor-ctrl-lib (ParamsDefault.c, release 4.5)", write, recognise, read
)
