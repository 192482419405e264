"""The current measurement in a design: units, full scale, and what is refused."""

from __future__ import annotations

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import CurrentSensing
from dqforge.machines.errors import InputError

BASE = catalogue.template().decode()
PLACE = "  dead_time: 1 us"


def design(entry: str) -> Design:
    assert BASE.count(PLACE) == 1
    text = BASE.replace(PLACE, f"  current_sensing: {entry}\n{PLACE}")
    return load_text(text.encode(), "d.yaml")


def test_what_is_written_is_what_is_measured() -> None:
    drive = design("{shunt: 5 mOhm, gain: 20, reference: 3.3 V, bits: 14}")
    assert drive.inverter.current_sensing == CurrentSensing(5e-3, 20.0, 3.3, 14)
    sensing = drive.inverter.current_sensing
    assert sensing is not None
    assert sensing.full_scale == pytest.approx(16.5)  # 1.65 V over 0.1 V/A
    assert sensing.step == pytest.approx(33.0 / 2**14)
    paths = {value.path: value.si for value in drive.values}
    assert paths["inverter.current_sensing.shunt"] == 5e-3


def test_an_offset_leaves_the_smaller_direction() -> None:
    sensing = design(
        "{shunt: 10 mOhm, gain: 10, reference: 3.3 V, offset: 1.9 V}"
    ).inverter.current_sensing
    assert sensing is not None
    assert sensing.bits == 12
    assert sensing.full_scale == pytest.approx(14.0)


def test_without_the_key_nothing_is_known() -> None:
    assert load_text(BASE.encode(), "d.yaml").inverter.current_sensing is None


@pytest.mark.parametrize(
    ("entry", "phrase"),
    [
        ("{gain: 20, reference: 3.3 V}", "inverter.current_sensing needs the key 'shunt'"),
        ("{shunt: 5 mA, gain: 20, reference: 3.3 V}", "inverter.current_sensing.shunt"),
        ("{shunt: 5 mOhm, gain: 20 V, reference: 3.3 V}", "inverter.current_sensing.gain"),
        ("{shunt: 5 mOhm, gain: 20, reference: 3300 V}", "inverter.current_sensing.reference"),
        ("{shunt: 5 mOhm, gain: 20, reference: 3 V, bits: 3}", "inverter.current_sensing.bits"),
        (
            "{shunt: 5 mOhm, gain: 20, reference: 3.3 V, offset: 3.4 V}",
            "offset 3.4 V is not below the reference 3.3 V",
        ),
    ],
)
def test_what_is_wrong_is_told_in_one_line_with_its_place(entry: str, phrase: str) -> None:
    with pytest.raises(InputError) as caught:
        design(entry)
    assert phrase in caught.value.message
    assert "\n" not in caught.value.message
    assert caught.value.line is not None
