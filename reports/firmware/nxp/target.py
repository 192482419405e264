"""NXP's motor control among the firmware whose files are written and read."""

from __future__ import annotations

from dqforge.optimizer.firmware.nxp_mcat.mcat_names import PROJECT_INPUTS, PROJECT_MACROS
from dqforge.optimizer.firmware.targets.nxp import NXP
from dqforge.reports.firmware.nxp.reader import read, recognise
from dqforge.reports.firmware.nxp.writer import write
from dqforge.reports.firmware.target import Target

TARGET = Target(
    NXP,
    "NXP motor control (MCAT: m1_pmsm_appconfig.h, 2016 to 2026)",
    write,
    recognise,
    read,
    of_project=frozenset(PROJECT_INPUTS + PROJECT_MACROS),
)
