"""What is said of the keys of other firmware: only of those that a file has."""

from __future__ import annotations

from typing import get_args

import pytest

from dqforge.machines.names import Firmware
from dqforge.optimizer.firmware.configuration import Configuration, DriveValues, Origin
from dqforge.reports.firmware_keys import conventions_here, meaning, next_steps

SENTENCES = (
    "currents are peak values",
    "l_max_erpm and s_pid_kp count electrical revolutions",
    "s_pid_kp is 20 times the share of l_current_max",
    "the file does not say foc_observer_type: 3 is taken",
)


def configuration(*keys: str) -> Configuration:
    origins = {key: Origin(key, "1", 1) for key in keys}
    own = dict.fromkeys(keys, 1.0)
    return Configuration(
        "vesc", "7", "hub", DriveValues(), own=own, origins=origins, conventions=SENTENCES
    )


def test_conventions_of_keys_that_are_not_there_are_left_out() -> None:
    found = conventions_here(configuration("l_current_max"))
    assert found == (SENTENCES[0], SENTENCES[3])


def test_conventions_of_keys_that_are_there_stay() -> None:
    assert conventions_here(configuration("s_pid_kp")) == SENTENCES
    assert conventions_here(configuration("l_max_erpm")) == (*SENTENCES[:2], SENTENCES[3])


def test_without_a_file_all_stay() -> None:
    assert conventions_here(configuration()) == SENTENCES


@pytest.mark.parametrize("firmware", get_args(Firmware))
def test_every_firmware_says_what_comes_next(firmware: Firmware) -> None:
    lines = next_steps(firmware)
    assert len(lines) == 2
    assert any("small" in line for line in lines)


def test_keys_have_a_meaning() -> None:
    assert meaning("vesc", "foc_observer_gain") == "gain of the flux observer, 1/(s Wb^2)"
    assert meaning("infineon", "params.motor.T_max") == "largest torque, N m"
    assert meaning("simplefoc", "KV_rating").startswith("rev/min per volt")
    assert meaning("vesc", "unheard_of") == ""
