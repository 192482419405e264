"""What a design lacks for other firmware is said at once, with text that mends it when pasted."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations

import pytest
from firmware_files import SCOOTER, scooter_fit

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.names import Firmware
from dqforge.optimizer.firmware.firmware_method import (
    METHODS,
    FirmwareMethod,
    check_drivable,
    drive_values,
)
from dqforge.optimizer.firmware.solve import solve_firmware

REMOVABLE = ("  max_speed", "  inertia", "  current_sensing")
EVERY = [kept for count in range(4) for kept in combinations(REMOVABLE, count)]


def lines_without(removed: tuple[str, ...]) -> list[str]:
    """The scooter's design without some keys, nor a speed loop, which needs an inertia."""
    return [line for line in SCOOTER.split("\n") if not line.startswith((*removed, "  speed_loop"))]


def text_to_paste(design: Design, method: FirmwareMethod) -> list[str]:
    """Lines that the refusal of a design proposes, none where it is taken."""
    try:
        check_drivable(design, [method])
    except InputError as error:
        return re.findall(r"'([a-z_]+: [^']+)'", str(error))
    return []


@pytest.mark.parametrize("name", [name for name, _ in METHODS.items()])
def test_everything_is_missed_at_once_and_pasted_text_mends_it(name: Firmware) -> None:
    for removed in EVERY:
        lines = lines_without(removed)
        design = load_text("\n".join(lines).encode(), "d.yaml")
        for text in text_to_paste(design, METHODS[name]):
            section = "inverter:" if text.startswith("current_sensing") else "machine:"
            lines.insert(lines.index(section) + 1, f"  {text}")
        design = load_text("\n".join(lines).encode(), "d.yaml")
        assert text_to_paste(design, METHODS[name]) == []
        # Nothing else is missing: with the gains of the whole design it can be configured.
        wanted = replace(scooter_fit(name).asked, design=design, drive=drive_values(design))
        METHODS[name].configure(replace(wanted, speed=None))


def test_several_firmwares_miss_in_one_line() -> None:
    """Before anything is tuned, and with the key that comes first."""
    design = load_text("\n".join(lines_without(REMOVABLE)).encode(), "d.yaml")
    with pytest.raises(InputError, match=r"max_speed: .*inertia: .*current_sensing: ") as refused:
        solve_firmware(design, None, ["st", "nxp", "ti"])
    assert refused.value.message.startswith("machine.max_speed: ")
