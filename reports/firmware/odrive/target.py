"""ODrive 0.5 among the firmware whose files are written and read."""

from __future__ import annotations

from dqforge.optimizer.firmware.targets.odrive import ODRIVE
from dqforge.reports.firmware.odrive.reader import read, recognise
from dqforge.reports.firmware.odrive.writer import write
from dqforge.reports.firmware.target import Target

TARGET = Target(ODRIVE, "ODrive (v3.x boards, firmware 0.5)", write, recognise, read)
