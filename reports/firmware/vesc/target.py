"""VESC among the firmware whose files are written and read."""

from __future__ import annotations

from dqforge.optimizer.firmware.targets.vesc import VESC
from dqforge.reports.firmware.target import Target
from dqforge.reports.firmware.vesc.reader import read, recognise
from dqforge.reports.firmware.vesc.writer import OF_PROJECT, write

TARGET = Target(
    VESC,
    "VESC (bldc firmware and VESC Tool, parameters of 7.01)",
    write,
    recognise,
    read,
    of_project=frozenset(OF_PROJECT),
    one_meaning=True,
)
