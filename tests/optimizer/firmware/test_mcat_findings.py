"""What is found in files of MCAT: rounded inputs, edited gains, filters, coarse integers."""

from __future__ import annotations

import nxp_published as published
import pytest

from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.mcat_numbers import EDITIONS
from dqforge.optimizer.firmware.mcat_sheet import McatFile, McatSheet, implied_spans


def _file(data: published.Published, **changed: float) -> McatFile:
    own = {f"M1_{name}": float(text) for name, text in data.constants.items()}
    return McatFile("m", EDITIONS[data.version], {**data.inputs, **own, **changed})


def _found(data: published.Published, **changed: float) -> Configuration:
    return _file(data, **changed).configuration()


def test_files_that_follow_from_their_inputs_are_left_alone() -> None:
    for data in (published.FLOAT_2025, published.SERVO_2025, published.FIXED_2022):
        assert _found(data).contradictions == ()


def test_inputs_that_were_rounded_for_display_are_told_from_edited_gains() -> None:
    found = _found(published.ROUNDED_INPUTS).contradictions
    assert len(found) == 4
    said = " ".join(found)
    assert "parametersLd is 6.01 mH" in said
    assert "6.0198" in said
    assert "2.255" in said
    assert "J/Kt" in said
    spans = implied_spans(_file(published.ROUNDED_INPUTS).sheet)
    low, high = spans["parametersLd"]
    assert low == pytest.approx(6.01984e-3, rel=5e-6)
    assert 0.0 < high - low < 2e-8
    low, high = spans["parametersRs"]
    assert low < 2.2554 < high
    assert high - low < 2e-4


def test_one_edited_gain_is_named_with_what_the_rule_makes() -> None:
    found = _found(published.FLOAT_2025, M1_D_KI_GAIN=0.08).contradictions
    assert len(found) == 1
    assert found[0].startswith("M1_D_KI_GAIN is 0.08, not 0.0599578")


def test_a_start_current_of_another_release_is_named() -> None:
    found = _found(published.FLOAT_2025, M1_OL_START_I=0.6).contradictions
    assert len(found) == 1
    assert "M1_OL_START_I is 0.6, not 0.35" in found[0]


def test_the_speed_filter_of_the_older_age_cuts_off_sixteen_times_too_low() -> None:
    found = _found(published.FLOAT_2022).contradictions
    assert len(found) == 1
    assert "100 Hz" in found[0]
    assert "6.25 Hz" in found[0]


def test_a_gain_that_its_integer_cuts_off_is_named() -> None:
    found = _found(published.FIXED_2022, M1_SPEED_PI_INTEG_GAIN=0.000446804).contradictions
    assert any("14 steps of 2^-15" in words and "4.4 %" in words for words in found)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (published.FLOAT_2025, "ki T/2 (trapezoids)"),
        (published.FLOAT_2022, "ki T (rectangles)"),
        (published.FIXED_2022, "fractions of I_MAX"),
        (published.FLOAT_2022, "has no stated kind"),
    ],
)
def test_conventions_say_how_numbers_count(data: published.Published, words: str) -> None:
    assert any(words in said for said in _found(data).conventions)


def test_without_inputs_the_machine_follows_from_the_observer() -> None:
    for data in (published.FLOAT_2025, published.FIXED_2022, published.COMMENTED_2019):
        own = {f"M1_{name}": float(text) for name, text in data.constants.items()}
        drive = McatSheet(EDITIONS[data.version], own).drive()
        assert drive.r_s == pytest.approx(data.inputs["parametersRs"], rel=2e-4)
        assert drive.l_d == pytest.approx(data.inputs["parametersLd"], rel=2e-4)
        assert drive.l_q == pytest.approx(data.inputs["parametersLq"], rel=2e-4)
        assert drive.t_s == pytest.approx(data.inputs["currentLoopSampleTime"], rel=1e-4)
        assert drive.t_speed == pytest.approx(data.inputs["speedLoopSampleTime"], rel=1e-4)


@pytest.mark.parametrize("data", [published.FLOAT_2025, published.FLOAT_2022])
def test_gains_are_those_that_place_the_poles(data: published.Published) -> None:
    found, inputs = _found(data), data.inputs
    rate = 2.0 * 3.141592653589793 * inputs["currentLoopF0"]
    for gains, key in ((found.current_d, "parametersLd"), (found.current_q, "parametersLq")):
        assert gains is not None
        assert gains.kp == pytest.approx(2 * rate * inputs[key] - inputs["parametersRs"], rel=1e-5)
        assert gains.ki == pytest.approx(rate * rate * inputs[key], rel=1e-5)


def test_fixed_point_gains_are_those_of_the_scales_and_integers() -> None:
    found, inputs = _found(published.FIXED_2022), published.FIXED_2022.inputs
    rate = 2.0 * 3.141592653589793 * inputs["currentLoopF0"]
    assert found.current_q is not None
    assert found.current_q.kp == pytest.approx(2 * rate * 0.000218 - 0.54, rel=5e-4)
    assert found.current_q.ki == pytest.approx(rate * rate * 0.000218, rel=3e-3)
    assert found.speed is not None
    assert found.speed.kp == pytest.approx(0.003 * 4, rel=1e-4)
    assert found.speed.ki == pytest.approx(0.009 * 4, rel=2e-2)


def test_the_same_loops_in_the_format_of_another_age() -> None:
    newer = _file(published.FLOAT_2025)
    older = newer.in_edition("2022")
    before, after = newer.configuration(), older.configuration()
    assert after.version == "2022"
    assert after.current_d is not None
    assert before.current_d is not None
    assert after.current_d.ki == pytest.approx(before.current_d.ki, rel=1e-5)
    assert after.speed is not None
    assert before.speed is not None
    assert after.speed.ki == pytest.approx(before.speed.ki, rel=1e-5)
    assert after.drive.psi_pm == pytest.approx(before.drive.psi_pm)
    assert older.own["M1_SPEED_IIR_B0"] == newer.own["M1_SPEED_IIR_B0"]
    back = older.in_edition("2025").configuration()
    assert back.current_q is not None
    assert before.current_q is not None
    assert back.current_q.ki == pytest.approx(before.current_q.ki, rel=1e-5)
    assert back.speed is not None
    assert back.speed.ki == pytest.approx(before.speed.ki, rel=1e-5)
