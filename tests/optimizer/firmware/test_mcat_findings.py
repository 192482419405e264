"""What is found in files of MCAT: rounded inputs, edited gains, filters, coarse integers."""

from __future__ import annotations

import math
from dataclasses import replace

import nxp_published as published
import pytest
from firmware_asked import numbers_of

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
    # 62.5 us and 1 ms; without the input the coefficient says the cut-off.
    without = {key: x for key, x in published.FLOAT_2022.inputs.items() if "CutOff" not in key}
    alone = _found(replace(published.FLOAT_2022, inputs=without)).contradictions
    for said in (found[0], " ".join(alone)):
        for part in ("cut-off of 100 Hz", "(62.5 us)", "(1 ms)", "cuts off at 6.25 Hz"):
            assert part in said


def test_a_gain_that_its_integer_cuts_off_is_named() -> None:
    found = _found(published.FIXED_2022, M1_SPEED_PI_INTEG_GAIN=0.000446804).contradictions
    assert any("14 steps of 2^-15" in words and "4.4 %" in words for words in found)
    # Of 40.9 steps 2.2 % are lost, of 50.9 steps 1.8 %.
    for steps, told in ((40.9, True), (50.9, False)):
        words = _found(published.FIXED_2022, M1_SPEED_PI_INTEG_GAIN=steps / 2**15).contradictions
        assert any(f"{int(steps)} steps of 2^-15" in text for text in words) == told


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
        if "parametersNnom" in data.inputs:
            rated = 2.0 * math.pi * data.inputs["parametersNnom"] / 60.0
            assert drive.omega_m_max == pytest.approx(rated, rel=1e-4)


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


@pytest.mark.parametrize(
    ("changed", "reach"),
    [
        ({}, None),
        ({"parametersUdcbUnder": 25.9, "parametersUdcbOver": 26.1}, None),
        ({"parametersUdcbUnder": 26.1}, "outside of 26.1 to 32 V"),
        ({"parametersUdcbOver": 25.9}, "outside of 16 to 25.9 V"),
        ({"parametersUdcbOver": 0.0}, None),
        ({"parametersUdcbUnder": 0.0, "parametersUdcbOver": 20.0}, "outside of 0 to 20 V"),
        ({"parametersUdcbUnder": 30.0, "parametersUdcbOver": 0.0}, "outside of 30 to 0 V"),
    ],
)
def test_a_link_that_the_firmware_takes_for_a_fault_is_none(
    changed: dict[str, float], reach: str | None
) -> None:
    """sqrt(3) times 15 V is 25.98 V."""
    found = _found(published.FLOAT_2025, **changed)
    said = " ".join(found.conventions)
    if reach is None:
        assert found.drive.v_dc == pytest.approx(15.0 * math.sqrt(3.0))
        assert "stands for it" in said
    else:
        assert found.drive.v_dc is None
        assert f"parametersUphNom 15 V is one at which the firmware switches off, {reach}" in said


@pytest.mark.parametrize(
    ("data", "amperes", "full"),
    [(published.FLOAT_2025, 1.0, 1.0), (published.FIXED_2022, 8.0, 2.0 * math.pi * 4400 / 60 * 4)],
)
def test_limits_that_are_not_those_of_the_inputs_count_as_they_stand(
    data: published.Published, amperes: float, full: float
) -> None:
    limits = {"M1_SPEED_LOOP_HIGH_LIMIT": 0.25, "M1_N_NOM": 0.5}
    drive = _found(data, **limits).drive
    assert drive.i_max == pytest.approx(0.25 * amperes)
    assert drive.omega_m_max == pytest.approx(0.5 * full / data.inputs["parametersPP"])
    assert _found(data).drive.i_max == data.inputs["speedLoopUpperLimit"]


def test_more_edited_constants_than_eight_are_counted() -> None:
    names = [f"M1_{name}" for name in list(published.FLOAT_2025.constants)[12:22]]
    values = {name: 1.1 * float(published.FLOAT_2025.constants[name[3:]]) for name in names}
    found = _found(published.FLOAT_2025, **values).contradictions
    assert len(found) == 9
    assert "2 more constants do not follow" in found[-1]


def test_inputs_that_are_said_to_be_meant_make_the_constants() -> None:
    """The middle of what is said of L_d, L_q, R and J/Kt, put in, leaves nothing to say."""
    data = published.ROUNDED_INPUTS
    scales = {"parametersLd": 1e-3, "parametersLq": 1e-3, "parametersRs": 1.0}
    meant: dict[str, float] = {}
    for text in _found(data).contradictions:
        numbers = numbers_of([text], "")
        key = text.split()[0]
        if key in scales:
            assert numbers[0] == pytest.approx(data.inputs[key] / scales[key], rel=1e-5)
            meant[key] = 0.5 * scales[key] * (numbers[1] + numbers[2])
        else:
            meant["parametersJ"] = data.inputs["parametersJ"] * numbers[0] / numbers[1]
    assert "parametersJ" in meant
    assert len(meant) == len(_found(data).contradictions)
    exact = replace(data, inputs=data.inputs | meant)
    wrong = _found(exact).contradictions
    assert not any("J/Kt" in text or "among the inputs" in text for text in wrong)


@pytest.mark.parametrize(
    "data",
    [
        published.FLOAT_2025,
        published.FLOAT_2022,
        published.FIXED_2022,
        published.COMMENTED_2019,
        published.SERVO_2025,
        published.HIGH_VOLTAGE,
    ],
)
def test_the_age_of_a_file_follows_from_what_stands_in_it(data: published.Published) -> None:
    own = _file(data).own
    edition = EDITIONS[data.version]
    found = McatFile.read("m", own, {}, fixed=edition.fixed, commented=edition.commented)
    assert found.edition.version == data.version


@pytest.mark.parametrize(
    ("own", "version"),
    [
        ({"M1_Q_IIR_ZC_B0": 0.1}, "2025"),
        ({"parametersKt": 0.1}, "2025"),
        ({"parametersKt": 0.1, "parametersKe": 0.1}, "2022"),
        ({}, "2022"),
    ],
)
def test_without_integral_gains_what_newer_files_have_says_their_age(
    own: dict[str, float], version: str
) -> None:
    found = McatFile.read("m", own, {}, fixed=False, commented=False)
    assert found.edition.version == version


@pytest.mark.parametrize(
    ("under", "over", "fastest", "kept"),
    [
        (0.95, 1.05, 1.01, ""),
        (1.01, 1.05, 1.01, "voltage"),
        (0.95, 0.99, 1.01, "voltage"),
        (0.95, 1.05, 0.99, "speed"),
    ],
)
def test_a_project_keeps_its_board_but_for_what_the_design_outgrows(
    under: float, over: float, fastest: float, kept: str
) -> None:
    """Of 25.98 V and 837.8 rad/s (electrical)."""
    ours = _file(published.FLOAT_2025)
    volts = {"Under": under * 25.9808, "Over": over * 25.9808, "Trip": 1.02 * 25.9808}
    theirs = _file(
        published.FLOAT_2025,
        parametersImax=11.0,
        parametersUdcbMax=70.0,
        parametersNover=5000.0,
        M1_I_MAX=11.0,
        M1_N_OVERSPEED=fastest * 837.758,
        M1_Q_KP_GAIN=7.0,
        **{f"parametersUdcb{name}": value for name, value in volts.items()},
        M1_U_DCB_UNDERVOLTAGE=volts["Under"],
    )
    found = ours.in_project(theirs)
    mine, board = (ours.own, theirs.own)
    for key in ("parametersImax", "parametersUdcbMax", "M1_I_MAX"):
        assert found.own[key] == board[key]
    for name in (*(f"parametersUdcb{name}" for name in volts), "M1_U_DCB_UNDERVOLTAGE"):
        assert found.own[name] == (mine if kept == "voltage" else board)[name], name
    for name in ("parametersNover", "M1_N_OVERSPEED"):
        assert found.own[name] == (mine if kept == "speed" else board)[name], name
    assert found.own["M1_Q_KP_GAIN"] == mine["M1_Q_KP_GAIN"]
    # With other periods the constants of the board are made anew.
    slow = McatFile("m", theirs.edition, {**theirs.own, "speedLoopSampleTime": 0.002})
    made = ours.in_project(slow).own["M1_SPEED_RAMP_UP"]
    assert made == pytest.approx(2.0 * math.pi / 60.0 * 2 * 10000 * 0.001, rel=1e-5)
