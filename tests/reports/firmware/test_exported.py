"""Files of several parts read back where one of them says less than all do together."""

from __future__ import annotations

import pytest
from firmware_files import scooter

from dqforge.machines.names import Firmware
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.solve import solve_firmware
from dqforge.reports.firmware.target import TARGETS
from dqforge.reports.firmware.written_files import firmware_files, read_files


@pytest.mark.parametrize("name", tuple(TARGETS))
@pytest.mark.parametrize("l_q", ["0.14 mH", "0.07 mH"])
def test_salient_machines_are_written_for_every_firmware(name: Firmware, l_q: str) -> None:
    design = scooter(f"machine.inductance_q={l_q}")
    fit = solve_firmware(design, solve_gains(design), [name])[0]
    files = firmware_files(design, fit)
    read = read_files(files, TARGETS[fit.name])
    assert (read.drive.l_d, read.drive.l_q) == (
        fit.configuration.drive.l_d,
        fit.configuration.drive.l_q,
    )
