"""TI's universal lab among the firmware whose files are written and read."""

from __future__ import annotations

from dqforge.optimizer.firmware.targets.ti import TI
from dqforge.reports.firmware.target import Target
from dqforge.reports.firmware.ti.reader import read, recognise
from dqforge.reports.firmware.ti.writer import write

TARGET = Target(
    TI,
    "TI universal motor control lab (user_mtr1.h, labs of 2021 and 2024)",
    write,
    recognise,
    read,
)
