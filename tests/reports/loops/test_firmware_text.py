"""The loops as VESC runs them: table, words and plain data of the e-scooter's hub."""

from __future__ import annotations

import json
import math
from functools import cache

import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.reports.loops.firmware_text import (
    FIRMWARE_COLUMNS,
    firmware_notes,
    firmware_rows,
    firmware_title,
    firmware_words,
)
from dqforge.reports.loops.proven_text import gains_tables, plain_gains

DRIVE = """\
dqforge: 1
name: hub
machine:
  model: linear
  pole_pairs: 15
  resistance: {value: 100 mOhm, kind: line-to-line}
  inductance_d: {value: 200 uH, kind: line-to-line}
  inductance_q: {value: 200 uH, kind: line-to-line}
  back_emf_constant: {value: 60 rpm/V, kind: line-to-line peak}
  max_current: {value: 40 A, kind: rms}
  max_speed: 2500 rpm
  inertia: 0.002 kg m^2
inverter: {v_dc: 48 V, switching_frequency: 20 kHz}
control:
  current_loop: {method: bandwidth, bandwidth: 1000 Hz}
  speed_loop: {ratio: 20, method: bandwidth, bandwidth: 30 Hz}
"""


@cache
def solved(more: str = "") -> tuple[Design, GainSet]:
    design = load_text((DRIVE + more).encode(), "hub.yaml")
    return design, solve_gains(design)


def test_each_loop_stands_beside_that_of_the_header() -> None:
    _, gains = solved("  firmware: vesc\n")
    assert gains.firmware is not None
    rows = firmware_rows(gains.firmware)
    assert [row[:2] for row in rows] == [
        ("i_d", "vesc"),
        ("", "the header"),
        ("i_q", "vesc"),
        ("", "the header"),
        ("speed", "vesc"),
        ("", "the header"),
    ]
    assert all(len(row) == len(FIRMWARE_COLUMNS) for row in rows)
    assert rows[4][2].endswith("A s/rad")
    assert rows[5][2].endswith("N m s/rad")
    of_vesc, of_header = (float(row[5]) for row in rows[4:])
    assert of_vesc == pytest.approx(48.1, abs=0.2)
    assert of_header == pytest.approx(69.8, abs=0.2)
    notes = " ".join(firmware_notes(gains.firmware))
    assert "PLL of the speed: kp 2000 1/s, ki 1e+06 1/s^2, poles at -1000 and -1000 rad/s" in notes
    assert "one pair of gains for both axes" in notes
    assert "both current loops together up to the largest speed" in notes
    assert firmware_words(gains.firmware).startswith("i_d 72.0 deg")


def test_tables_and_json_are_there_with_the_key_alone() -> None:
    design, gains = solved("  firmware: vesc\n")
    plain = json.loads(json.dumps(plain_gains(design, gains)))["firmware"]
    assert gains.firmware is not None
    assert gains.speed is not None
    assert plain["name"] == "vesc"
    assert plain["pll"] == {"kp": 2000.0, "ki": 1e6}
    assert plain["speed"]["header"]["kp"] == pytest.approx(gains.speed.kp)
    assert math.degrees(plain["speed"]["phase_margin_rad"]) == pytest.approx(48.1, abs=0.2)
    assert plain["turning"]["unstable_from_rad_per_s"] is None
    titles = [table.title for table in gains_tables(design, gains)]
    assert firmware_title(gains.firmware) in titles
    design, gains = solved()
    assert "firmware" not in plain_gains(design, gains)
    assert not any(table.title.startswith("As ") for table in gains_tables(design, gains))


def test_the_default_pll_is_refused_with_what_would_hold() -> None:
    with pytest.raises(NoSolutionError) as caught:
        solved("  firmware: {name: vesc, pll_kp: 2000, pll_ki: 30000}\n")
    message = str(caught.value)
    assert "hub.yaml:16:3: control.speed_loop: as vesc" in message
    assert "with a PLL of 2000/30000, the speed loop by method 'bandwidth' is unstable" in message
    assert "write pll_ki: 1e+06 (kp^2/4)" in message
    with pytest.raises(InputError, match=r"control\.firmware\.pll_ki"):
        solved("  firmware: {name: vesc, pll_kp: 2000, pll_ki: 3e8}\n")


def test_worst_margins_are_shown_where_tolerances_are_named() -> None:
    _, gains = solved("  firmware: vesc\n  tolerances: {l_q: 10 %, l_d: 10 %}\n")
    assert gains.firmware is not None
    rows = firmware_rows(gains.firmware)
    assert [row[1] for row in rows[:3]] == ["vesc", "at worst", "the header"]
    assert float(rows[1][5]) < float(rows[0][5])
