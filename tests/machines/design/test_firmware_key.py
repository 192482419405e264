"""The key ``control.firmware``: a name, or a mapping with what is not to be chosen."""

from __future__ import annotations

from pathlib import Path

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.settings import FirmwareSettings
from dqforge.machines.errors import InputError

DESIGN = """\
dqforge: 1
name: hub
machine:
  model: linear
  pole_pairs: 15
  resistance: {value: 100 mOhm, kind: line-to-line}
  inductance_d: {value: 200 uH, kind: line-to-line}
  inductance_q: {value: 200 uH, kind: line-to-line}
  back_emf_constant: {value: "60 rpm/V", kind: line-to-line peak}
  max_current: {value: 40 A, kind: rms}
inverter: {v_dc: 48 V, switching_frequency: 20 kHz}
control:
"""


def write(folder: Path, *lines: str) -> Path:
    path = folder / "design.yaml"
    path.write_text(DESIGN + "".join(f"  {line}\n" for line in lines), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("vesc", FirmwareSettings("vesc")),
        ("{name: odrive}", FirmwareSettings("odrive")),
        ("{name: vesc, pll_kp: 2000, pll_ki: 3e4}", FirmwareSettings("vesc", (2000.0, 30000.0))),
    ],
)
def test_it_is_a_name_or_a_mapping(text: str, expected: FirmwareSettings, tmp_path: Path) -> None:
    assert load_design(write(tmp_path, f"firmware: {text}")).control.firmware == expected


def test_without_it_there_is_none(tmp_path: Path) -> None:
    assert load_design(write(tmp_path, "sampling_frequency: 20 kHz")).control.firmware is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("vecs", "13:13: control.firmware: expected one of vesc, simplefoc, moteus"),
        ("vecs", "did you mean 'vesc'?"),
        ("{name: foo}", "13:20: control.firmware.name: expected one of vesc"),
        ("[vesc]", "13:13: control.firmware: expected a section with keys, got a list"),
        ("{nam: vesc}", "unknown key 'nam'; did you mean 'name'?"),
        ("{name: st, pll_kp: 2000}", "13:24: control.firmware: pll_kp and pll_ki belong together"),
        ("{name: st, pll_kp: -1, pll_ki: 1}", "control.firmware.pll_kp: expected a number greater"),
    ],
)
def test_what_it_cannot_be_is_refused_where_it_stands(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_design(write(tmp_path, f"firmware: {text}"))
    assert said in str(caught.value)


def test_it_needs_gains(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"control\.firmware needs gains"):
        load_design(write(tmp_path, "gains: false", "firmware: vesc"))


def test_machines_of_any_back_emf_are_refused() -> None:
    with pytest.raises(InputError, match=r"machines of model: waveform"):
        catalogue.load("paper002-phase-waveforms", ["control.firmware=vesc"])
