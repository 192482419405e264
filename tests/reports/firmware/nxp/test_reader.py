"""Headers of MCAT read: every age, with and without inputs, damaged and hostile."""

from __future__ import annotations

import math
import re

import nxp_published as published
import pytest
from nxp_headers import header

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.nxp import read, recognise

PLACE = "m1_pmsm_appconfig.h"

AGES = {
    "2025": published.FLOAT_2025,
    "2022": published.FLOAT_2022,
    "2022 fixed point": published.FIXED_2022,
    "2019": published.COMMENTED_2019,
    "2019 fixed point": published.COMMENTED_FIXED,
}


@pytest.mark.parametrize("version", AGES)
@pytest.mark.parametrize("inputs", [True, False])
def test_the_age_is_found_and_every_constant_kept(version: str, *, inputs: bool) -> None:
    data = AGES[version]
    text = header(data, inputs=inputs)
    assert recognise(PLACE, text)
    found = read(text, PLACE)
    assert found.version == version
    for name, written in data.constants.items():
        assert found.own[f"M1_{name}"] == float(written), name
    if inputs:
        for key, value in data.inputs.items():
            assert found.own[key] == value, key


def test_values_have_their_lines_and_texts() -> None:
    text = header(published.FLOAT_2025)
    found = read(text, PLACE)
    lines = text.split("\n")
    origin = found.origins["current_d.kp"]
    assert (origin.key, origin.text) == ("M1_D_KP_GAIN", "(1.24646F)")
    assert lines[(origin.line or 0) - 1] == "#define M1_D_KP_GAIN (1.24646F)"
    origin = found.origins["r_s"]
    assert (origin.key, origin.text) == ("parametersRs", "0.45")
    assert '"parametersRs": 0.45' in lines[(origin.line or 0) - 1]
    assert found.name == "Linix"


def test_line_comments_of_the_older_age_are_inputs_with_lines() -> None:
    text = header(published.COMMENTED_2019)
    found = read(text, PLACE)
    assert found.own["speedLoopF0"] == 28
    assert found.own["sensorlessBemfObsrvF0"] == 300
    line = found.origins["speedLoopF0"].line or 0
    assert "= 28 [Hz]" in text.split("\n")[line - 1]
    assert found.drive.l_q == 0.000512
    assert found.drive.t_speed == 0.001
    # What the rule makes of them stands there; only the speed filter runs slower than meant.
    assert len(found.contradictions) == 1
    assert "M1_SPEED_IIR_B0" in found.contradictions[0]


def test_another_spelling_and_the_second_motor_are_read() -> None:
    text = header(published.FLOAT_2025, motor=2).replace("parametersPP", "parametersPp")
    found = read(text, "m2_pmsm_appconfig.h")
    assert found.drive.pole_pairs == 2
    assert found.own["parametersPP"] == 2
    assert found.own["M1_D_KP_GAIN"] == 1.24646
    assert found.origins["current_d.kp"].key == "M2_D_KP_GAIN"


def test_empty_inputs_and_empty_macros_are_left_out() -> None:
    text = header(published.FLOAT_2025).replace('"speedLoopF0": 5', '"speedLoopF0": ""')
    text = text.replace("M1_SPEED_IIR_ZC_B0 (0.00779278F)", "M1_SPEED_IIR_ZC_B0 ")
    found = read(text, PLACE)
    assert "speedLoopF0" not in found.own
    assert "M1_SPEED_IIR_ZC_B0" not in found.own
    assert found.speed is not None


def test_constants_that_are_formulas_are_worked_out() -> None:
    text = (
        "#define Ld (0.000116467F)\n#define Rs (0.1105F)\n#define F0 (400.0F)\n"
        "#define M1_MOTOR_PP (3.0F)\n#define M1_TO_THETA_GAIN (0.000015625F / FLOAT_PI)\n"
        "#define M1_D_KP_GAIN ((2 * 2 * FLOAT_PI * F0 * Ld) - Rs)\n"
        "#define M1_D_KI_GAIN (0.00574742F)\n#define M1_Q_KP_GAIN (0.565531F)\n"
        "#define M1_Q_KI_GAIN (0.00663691F)\n#define M1_Q_IIR_ZC_B0 (0.0115996F)\n"
        "#define M1_FAULT_DURATION (uint16_t)(2.0F / 0.00025F)\n"
    )
    found = read(text, PLACE)
    assert found.version == "2025"
    assert found.current_d is not None
    assert found.current_d.kp == pytest.approx(0.474927, rel=1e-6)
    assert found.drive.t_s == pytest.approx(15.625e-6)


GOOD = header(published.FLOAT_2025)


@pytest.mark.parametrize(
    ("text", "words", "line"),
    [
        ("int main(void) { return 0; }\n", "none of MCAT's macros", None),
        (GOOD.replace("(1.24646F)", "(fast)"), "M1_D_KP_GAIN is '(fast)', not a number", True),
        (GOOD.replace("(2)", "(2) +"), "M1_MOTOR_PP", True),
        (GOOD.replace('"parametersRs": 0.45', '"parametersRs": "much"'), "parametersRs", True),
        (GOOD.replace('"parametersRs": 0.45', '"parametersRs": 1e999'), "parametersRs", True),
        (GOOD.replace('"parametersRs": 0.45,', '"parametersRs": 0.45'), "not JSON", True),
        (GOOD[: GOOD.index("#endif")], "no #endif", True),
        (GOOD[:400], "none of MCAT's macros", None),
        (GOOD + "/* and on", "comment is not closed", True),
        (GOOD.replace("(2)", "(" * 10_000), "M1_MOTOR_PP", True),
        (
            header(published.COMMENTED_2019).replace("= 288 [Hz]", "= quick [Hz]"),
            "Loop bandwidth is 'quick', not a number",
            True,
        ),
        (
            GOOD.replace("{", "{" * 2000, 1),
            "",
            None,
        ),
    ],
)
def test_damaged_files_are_refused_in_one_line(text: str, words: str, line: bool | None) -> None:
    with pytest.raises(InputError) as caught:
        read(text, PLACE)
    said = str(caught.value)
    assert "\n" not in said
    assert words in said
    assert len(said) < 400
    if line:
        assert caught.value.line is not None


@pytest.mark.parametrize(
    ("name", "text", "is_one"),
    [
        (PLACE, GOOD, True),
        ("M1_PMSM_APPCONFIG.H", GOOD, True),
        ("design.yaml", GOOD, False),
        (PLACE, "#define MCCONF_L_CURRENT_MAX 60\n", False),
        ("user_mtr1.h", "#define USER_MOTOR1_TYPE 1\n", False),
    ],
)
def test_files_of_others_are_told_apart(name: str, text: str, *, is_one: bool) -> None:
    assert recognise(name, text) is is_one


# As people keep a header by hand; of our own making.
BY_HAND = """#define M1_MOTOR_PP (3)
#define M1_R (0.5F)
#define M1_LD (0.0004F)
#define M1_LQ (0.0006F)
#define M1_N_NOM (3000.0F) /* [RPM] */
#define M1_N_NOM_RAD (2*PI*M1_N_NOM*M1_MOTOR_PP/60.0)
#define M1_PWM_FREQ (20000.0)
#define M1_FAST_LOOP_FREQ (float_t)(M1_PWM_FREQ/2)
#define M1_CLOOP_FREQ (200.0F)
#define M1_CLOOP_ATT (1.0F)
#define M1_D_KP_GAIN (2*M1_CLOOP_ATT*2*PI*M1_CLOOP_FREQ*M1_LD - M1_R)
#define M1_D_KI_GAIN (2*PI*M1_CLOOP_FREQ*2*PI*M1_CLOOP_FREQ*M1_LD/M1_FAST_LOOP_FREQ)
#define M1_Q_KP_GAIN (2*M1_CLOOP_ATT*2*PI*M1_CLOOP_FREQ*M1_LQ - M1_R)
#define M1_Q_KI_GAIN (2*PI*M1_CLOOP_FREQ*2*PI*M1_CLOOP_FREQ*M1_LQ/M1_FAST_LOOP_FREQ)
#define M1_UDCB_IIR_B0 WARP(100.0F, M1_FAST_LOOP_FREQ)
#define M1_UDCB_IIR_A1 (1.0F - M1_UDCB_IIR_B0)
"""


def test_a_header_of_expressions_is_read_as_far_as_it_defines_its_names() -> None:
    found = read(BY_HAND, PLACE)
    w_0 = 2.0 * math.pi * 200.0
    assert found.drive.r_s == 0.5
    assert found.drive.l_q == 0.0006
    assert found.drive.t_s == pytest.approx(1e-4)
    assert found.drive.omega_m_max == pytest.approx(3000.0 * math.pi / 30.0)
    assert found.current_q is not None
    assert found.current_q.kp == pytest.approx(2.0 * w_0 * 0.0006 - 0.5)
    assert found.current_q.ki == pytest.approx(w_0**2 * 0.0006)
    assert not {"M1_UDCB_IIR_B0", "M1_UDCB_IIR_A1"} & found.own.keys()
    assert found.origins["r_s"].key == "M1_R"


def test_a_header_of_an_induction_machine_is_refused() -> None:
    text = BY_HAND + "#define M1_R_R (23.0F)\n"
    with pytest.raises(InputError, match="M1_R_R makes this the header of an induction machine"):
        read(text, PLACE)


def test_a_link_voltage_at_which_the_firmware_switches_off_is_not_taken() -> None:
    text = header(published.FLOAT_2025)
    assert read(text, PLACE).drive.v_dc is not None
    text = re.sub(r'("parametersUdcbUnder": )[\d.]+', r"\g<1>180", text)
    text = re.sub(r'("parametersUdcbOver": )[\d.]+', r"\g<1>420", text)
    found = read(text, PLACE)
    assert found.drive.v_dc is None
    assert any("outside of 180 to 420 V: give it" in said for said in found.conventions)
