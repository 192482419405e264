"""ST's MCSDK among the firmware whose files are written and read."""

from __future__ import annotations

from dqforge.optimizer.firmware.targets.st import ST
from dqforge.reports.firmware.st.reader import read, read_several, recognise
from dqforge.reports.firmware.st.writer import write
from dqforge.reports.firmware.target import Target

TARGET = Target(
    ST,
    "ST MCSDK (headers of 5.4 to 6.4, motor file of Workbench 6, project of Workbench 5)",
    write,
    recognise,
    read,
    read_several,
)
