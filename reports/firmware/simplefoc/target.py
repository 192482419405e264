"""SimpleFOC among the firmware whose files are written and read."""

from __future__ import annotations

from dqforge.optimizer.firmware.targets.simplefoc import SIMPLEFOC
from dqforge.reports.firmware.simplefoc.reader import read, recognise
from dqforge.reports.firmware.simplefoc.writer import write
from dqforge.reports.firmware.target import Target

TARGET = Target(SIMPLEFOC, "SimpleFOC (Arduino-FOC 2.4)", write, recognise, read)
