"""moteus among the firmware whose files are written and read."""

from __future__ import annotations

from dqforge.optimizer.firmware.targets.moteus import MOTEUS
from dqforge.reports.firmware.moteus.reader import read, recognise
from dqforge.reports.firmware.moteus.writer import write
from dqforge.reports.firmware.target import Target

TARGET = Target(MOTEUS, "moteus (mjbots, ABI 0x010e and later)", write, recognise, read)
