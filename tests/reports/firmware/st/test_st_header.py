"""The header of ST's MCSDK through a C compiler: its macros, and the table of currents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from firmware_round_trips import C_FLAGS, output_of
from random_st_drives import random_asked, value

from dqforge.optimizer.firmware.st_keys import table_currents
from dqforge.optimizer.firmware.st_scales import integers
from dqforge.optimizer.firmware.targets.st import ST
from dqforge.reports.firmware.st import TARGET
from dqforge.reports.firmware.target import FileTitle

# What the firmware brings: logarithm of a divider, unit of speeds, widths of the numbers. Ours.
PROGRAMME = """
#include <stdint.h>
#include <stdio.h>
#define SPEED_UNIT 10
#define LOG2(x) ((x) == 65535 ? 16 : __builtin_ctz(x))
#include "drive_st_parameters.h"
int main(void)
{
    const int32_t slopes[8] = ANGC, offsets[8] = OFST;
    printf("%d %d %d %d\\n", (int16_t)PID_TORQUE_KP_DEFAULT, (int16_t)PID_SPEED_KI_DEFAULT,
           1 << TF_KPDIV_LOG, 1 << PLL_KIDIV_LOG);
    printf("%d %.9g %.9g\\n", (int16_t)GAIN1, (double)ID_DEMAG_A, (double)RSHUNT);
    for (int32_t i_q = 0; i_q < 32768; ++i_q) {
        int32_t segment = i_q / SEGDIV;
        segment = segment > 7 ? 7 : segment;
        printf("%d\\n", (int)(((slopes[segment] * i_q) >> 15) + offsets[segment]));
    }
    return 0;
}
"""


def test_a_compiler_reads_what_was_written(tmp_path: Path) -> None:
    wish = next(wish for wish in random_asked(9, 43, tables=9) if wish.speed is not None)
    found = ST.configure(wish)
    files = TARGET.write(found, FileTitle("drive", "a drive", "0" * 64, "1"), None)
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "main.c").write_text(PROGRAMME, encoding="ascii")
    first, second, *table = output_of(tmp_path, "main.c", flags=(*C_FLAGS, "-O1")).splitlines()
    assert [int(text) for text in first.split()] == [
        value(found, "PID_TORQUE_KP_DEFAULT"),
        value(found, "PID_SPEED_KI_DEFAULT"),
        value(found, "TF_KPDIV"),
        65536,
    ]
    assert [float(text) for text in second.split()] == [
        value(found, name) for name in ("GAIN1", "ID_DEMAG_A", "RSHUNT")
    ]
    slopes, offsets = integers(found.own["ANGC"]), integers(found.own["OFST"])
    assert slopes is not None
    assert offsets is not None
    wanted = table_currents(int(value(found, "SEGDIV")), slopes, offsets, np.arange(32768))
    assert [int(text) for text in table] == wanted.tolist()
