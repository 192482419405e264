"""TI's motor blocks read: files with many motors, older labs, damaged and hostile files."""

from __future__ import annotations

import math

import pytest

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.targets.ti import INSTASPIN, OLDER_LAB, VERSION
from dqforge.reports.firmware.ti import read, recognise

BLOCK = """#define USER_MOTOR1_TYPE                   MOTOR_TYPE_PM
#define USER_MOTOR1_NUM_POLE_PAIRS         (4)
#define USER_MOTOR1_Rr_Ohm                 (NULL)
#define USER_MOTOR1_Rs_Ohm                 (0.393955578f)
#define USER_MOTOR1_Ls_d_H                 (0.000190442806f)
#define USER_MOTOR1_Ls_q_H                 (0.000190442806f)
#define USER_MOTOR1_RATED_FLUX_VpHz        (0.0399353318f)   // V/Hz
#define USER_MOTOR1_MAGNETIZING_CURRENT_A  (NULL)
#define USER_MOTOR1_MAX_CURRENT_A          (6.6f)
#define USER_MOTOR1_INERTIA_Kgm2           (7.06154e-06)
#define USER_MOTOR1_RATED_VOLTAGE_V        (24.0f)
#define USER_MOTOR1_FREQ_MAX_Hz            (600.0f)
#if defined(MOTOR1_ESMO)
#define USER_MOTOR1_SPEED_LPF_FC_Hz        (150.0f)
#endif
"""

CIRCLE = """#define USER_MOTOR1_Rs_Ohm USER_MOTOR1_Ls_d_H
#define USER_MOTOR1_Ls_d_H USER_MOTOR1_Rs_Ohm
"""

MANY = f"""#if defined(BOARD_A)
#define USER_MOTOR1 one_motor
#endif
#if defined(BOARD_B)
#define USER_MOTOR1 Teknic_like
#endif
#define USER_M1_PWM_FREQ_kHz        (15.0f)
#define USER_M1_NUM_ISR_TICKS_PER_SPEED_TICK (10)
#if (USER_MOTOR1 == one_motor)
#define USER_MOTOR1_TYPE                   MOTOR_TYPE_INDUCTION
#define USER_MOTOR1_NUM_POLE_PAIRS         (2)
#define USER_MOTOR1_Rs_Ohm                 (1.0f)
#define USER_MOTOR1_RATED_FLUX_VpHz        (0.8165*220.0/60.0)
#elif (USER_MOTOR1 == Teknic_like)
{BLOCK}#else
#error none
#endif
"""


def test_a_block_alone_with_where_everything_stands() -> None:
    found = read(BLOCK, "my_motor.h")
    assert (found.name, found.version) == ("my_motor", VERSION)
    assert found.drive.pole_pairs == 4
    assert found.drive.psi_pm == pytest.approx(0.0399353318 / (2.0 * math.pi))
    assert found.drive.omega_m_max == pytest.approx(2.0 * math.pi * 600.0 / 4.0)
    assert found.drive.t_s is None
    origin = found.origins["psi_pm"]
    assert (origin.key, origin.line) == ("USER_MOTOR1_RATED_FLUX_VpHz", 7)
    assert origin.text == "(0.0399353318f)"
    assert "2 pi" in origin.conversion
    assert "USER_MOTOR1_Rr_Ohm" not in found.own
    assert found.own["USER_MOTOR1_SPEED_LPF_FC_Hz"] == 150.0
    assert any("V/Hz induce" in words or "induce" in words for words in found.contradictions)
    assert any("Teknic M2310" in words for words in found.contradictions)


def test_several_motors_ask_which() -> None:
    with pytest.raises(InputError) as refused:
        read(MANY, "user_mtr1.h")
    message = str(refused.value)
    assert message.startswith("user_mtr1.h:9")
    assert "one_motor, Teknic_like" in message
    assert "#define USER_MOTOR1 NAME" in message


def test_the_motor_that_is_chosen_is_read() -> None:
    found = read("#define USER_MOTOR1 Teknic_like\n" + MANY, "user_mtr1.h")
    assert found.name == "Teknic_like"
    assert found.drive.r_s == 0.393955578
    assert found.drive.t_s == pytest.approx(1.0 / 15e3)
    assert found.drive.t_speed == pytest.approx(10.0 / 15e3)
    assert found.origins["r_s"].line == 19


def test_the_only_motor_that_a_board_chooses_is_read() -> None:
    only = MANY.replace("#define USER_MOTOR1 one_motor", "// #define USER_MOTOR1 one_motor")
    assert read(only, "user_mtr1.h").name == "Teknic_like"


def test_induction_motors_are_refused() -> None:
    with pytest.raises(InputError, match=r"MOTOR_TYPE_INDUCTION.*permanent magnets"):
        read("#define USER_MOTOR1 one_motor\n" + MANY, "user_mtr1.h")


def test_a_motor_that_is_not_there() -> None:
    with pytest.raises(InputError, match="which this file does not hold"):
        read("#define USER_MOTOR1 third\n" + MANY, "user_mtr1.h")


def test_the_lab_of_2021_has_other_constants() -> None:
    older = BLOCK.replace("FREQ_MAX_Hz ", "FREQ_MAX_HZ ")
    now, then = read(BLOCK, "a.h"), read(older, "a.h")
    assert then.version == OLDER_LAB
    assert then.origins["omega_m_max"].key == "USER_MOTOR1_FREQ_MAX_HZ"
    assert now.current_q is not None
    assert then.current_q is not None
    assert then.current_q.kp == pytest.approx(2.0 * now.current_q.kp)


def test_an_older_user_h_gives_the_machine_without_gains() -> None:
    text = (
        "#define USER_MOTOR_TYPE MOTOR_Type_Pm\n#define USER_MOTOR_NUM_POLE_PAIRS (4)\n"
        "#define USER_MOTOR_Rs (2.303403)\n#define USER_MOTOR_Ls_d (0.008464367)\n"
        "#define USER_MOTOR_Ls_q (0.008464367)\n#define USER_MOTOR_RATED_FLUX (0.38)\n"
        "#define USER_MOTOR_MAX_CURRENT (3.82)\n#define USER_PWM_FREQ_kHz (15.0)\n"
    )
    found = read(text, "user.h")
    assert found.version == INSTASPIN
    assert found.drive.r_s == 2.303403
    assert found.drive.psi_pm == pytest.approx(0.38 / (2.0 * math.pi))
    assert found.drive.i_max == 3.82
    assert found.current_q is None
    assert "current_q.kp" not in found.origins


def test_a_second_motor_has_its_own_macros() -> None:
    text = BLOCK.replace("USER_MOTOR1_", "USER_MOTOR2_")
    found = read(text, "user_mtr2.h")
    assert found.drive == read(BLOCK, "a.h").drive
    assert found.origins["r_s"].key == "USER_MOTOR2_Rs_Ohm"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("int main(void) { return 0; }\n", "holds no USER_MOTOR1_"),
        (BLOCK.replace("(6.6f)", "(six)"), "USER_MOTOR1_MAX_CURRENT_A is '(six)'"),
        (BLOCK.replace("(4)", "(4.5)"), "write a whole number"),
        (BLOCK.replace("(4)", "(400000)"), "0 to 65535"),
        (BLOCK.replace("(0.393955578f)", "(1e400)"), "not a number"),
        (BLOCK[: BLOCK.index("#endif")], "#endif"),
        (BLOCK.replace("// V/Hz", "/* V/Hz"), "comment"),
        (
            CIRCLE,
            "not a number",
        ),
        ("#define USER_MOTOR1_Rs_Ohm " + "(" * 5000 + "1" + ")" * 5000 + "\n", "not a number"),
        ("#define USER_MOTOR1_KSLIDE_MAX (1.0f)\n", "no values"),
    ],
    ids=["none", "word", "half", "large", "beyond", "cut", "comment", "circle", "deep", "empty"],
)
def test_bad_files_are_refused_in_one_line(text: str, words: str) -> None:
    with pytest.raises(InputError) as refused:
        read(text, "bad.h")
    message = str(refused.value)
    assert message.startswith("bad.h")
    assert "\n" not in message
    assert words in message
    assert len(message) < 500


def test_what_is_of_others_is_not_recognised() -> None:
    assert recognise("user_mtr1.h", BLOCK)
    assert not recognise("a.h", "#define MCCONF_FOC_MOTOR_R 1\n")
    assert not recognise("a.json", BLOCK)
