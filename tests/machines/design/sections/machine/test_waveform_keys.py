"""A machine of any back-EMF: its inductances as measured, and what is said without them."""

from __future__ import annotations

import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError

DESIGN = """dqforge: 1
name: a motor
machine:
  pole_pairs: 7
  resistance: 50 mOhm phase
  max_current: 20 A peak
  model: waveform
  back_emf: {harmonics: [{order: 1, amplitude: 6 mWb}, {order: 5, share: 5 %}]}
  INDUCTANCE
inverter:
  v_dc: 48 V
  switching_frequency: 20 kHz
"""


def of(*lines: str) -> str:
    return DESIGN.replace("INDUCTANCE", "\n  ".join(lines))


@pytest.mark.parametrize(
    ("lines", "used"),
    [
        (("self_inductance: 100 uH",), 100e-6),
        (("self_inductance: 80 uH", "mutual_inductance: -20 uH"), 100e-6),
        (("self_inductance: 200 uH line-to-line",), 100e-6),
        (("self_inductance: 200 uH terminal", "mutual_inductance: -20 uH"), 100e-6),
    ],
)
def test_between_two_terminals_lies_twice_the_difference(
    lines: tuple[str, ...], used: float
) -> None:
    found = load_text(of(*lines).encode(), "f")
    assert found.machine.l_d == pytest.approx(used)
    told = any(each.startswith("machine.mutual_inductance is 0") for each in found.assumptions)
    assert told == (len(lines) == 1)


@pytest.mark.parametrize("value", ["0.1 mH", "200 uH line-to-line"])
def test_an_inductance_of_the_axes_is_written_as_one_of_the_phases(value: str) -> None:
    with pytest.raises(InputError) as caught:
        load_text(of(f"inductance: {value}").encode(), "f")
    assert f"in its place self_inductance: {value}, with mutual_inductance" in str(caught.value)
    load_text(of(f"self_inductance: {value}").encode(), "f")
