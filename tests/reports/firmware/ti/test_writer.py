"""TI's motor blocks written: compiled, read back, put into files that hold other motors."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from firmware_asked import random_asked, scooter
from firmware_round_trips import kept_of, output_of

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.targets.ti import configure
from dqforge.reports.firmware.target import FileTitle
from dqforge.reports.firmware.ti import TARGET, read, write

TITLE = FileTitle("scooter", "hub */ of a scooter", "ab" * 32, "0.1", ("one */ #error remark",))
NAME = "scooter_user_mtr1.h"


def text_of(found: Configuration, existing: str | None = None) -> str:
    return write(found, TITLE, existing)[NAME].decode()


def test_200_machines_come_back() -> None:
    for asked in random_asked(200):
        found = configure(asked)
        assert kept_of(read(text_of(found), NAME)) == kept_of(found)


def plain(text: str) -> dict[str, str]:
    """Macros of a header of ours, by a reader of its own: the last definition of each name."""
    return dict(re.findall(r"^#define (USER_\w+) (.+)$", text, re.MULTILINE))


def test_the_scooters_block_says_what_its_data_sheet_says() -> None:
    values = plain(text_of(configure(scooter())))
    assert values["USER_MOTOR1_TYPE"] == "MOTOR_TYPE_PM"
    assert values["USER_MOTOR1_NUM_POLE_PAIRS"] == "(15)"
    assert values["USER_MOTOR1_Rs_Ohm"] == "(0.05f)"
    assert values["USER_MOTOR1_Ls_q_H"] == "(0.0001f)"
    # 60 rpm/V: 1 V of peak line-to-line voltage at 15 Hz electrical.
    assert values["USER_MOTOR1_RATED_FLUX_VpHz"] == f"({1 / 3**0.5 / 15:.7g}f)"
    assert values["USER_MOTOR1_MAX_CURRENT_A"] == "(56.56854f)"
    for text in values.values():
        assert re.fullmatch(r"\(\d+\)|\(-?\d+(\.\d+)?(e[+-]\d\d)?f\)|MOTOR_TYPE_PM", text), text


def test_same_input_same_bytes_without_dates() -> None:
    first = text_of(configure(scooter()))
    assert first == text_of(configure(scooter()))
    assert not re.search(r"\b20\d\d-\d\d|\r", first)


def test_the_headers_are_c(tmp_path: Path) -> None:
    """Included behind other values of the same names, ours count; ten machines in one program."""
    lines = ["#include <stdio.h>", "#define MOTOR_TYPE_PM 2", "#define USER_MOTOR1_Rs_Ohm (9.0f)"]
    expected: list[float] = []
    bodies = []
    for index, asked in enumerate(random_asked(10)):
        found = configure(asked)
        header = write(found, FileTitle(f"m{index}", "x", "0", "0"), None)
        (tmp_path / f"m{index}.h").write_bytes(header[f"m{index}_user_mtr1.h"])
        lines.append(f'#include "m{index}.h"')
        lines.append(f"static void print_{index}(void)\n{{")
        for macro, value in found.own.items():
            lines.append(f'    printf("%.9g\\n", (double){macro});')
            expected.append(2.0 if isinstance(value, str) else float(value))
        lines.append("}")
        bodies.append(f"    print_{index}();")
    lines += ["int main(void)\n{", *bodies, "    return 0;\n}"]
    (tmp_path / "main.c").write_text("\n".join(lines) + "\n")
    output = output_of(tmp_path, "main.c")
    assert [float(line) for line in output.split()] == pytest.approx(expected, rel=1e-7)


# Laid out as the lab's own file, with motors and words of our own.
LAB = """#ifndef USER_MTR1_H
#define USER_MTR1_H
#if defined(BOARD_A)
#define USER_M1_NOMINAL_DC_BUS_VOLTAGE_V         (24.0f)
#else
#define USER_M1_NOMINAL_DC_BUS_VOLTAGE_V         (36.0f)   // our board
#endif
#define USER_M1_PWM_FREQ_kHz        (15.0f)
#define USER_M1_PWM_PERIOD_usec     (1000.0f / USER_M1_PWM_FREQ_kHz)
//#define USER_MOTOR1 first_motor
#define USER_MOTOR1 second_motor

#if (USER_MOTOR1 == first_motor)
#define USER_MOTOR1_TYPE                   MOTOR_TYPE_PM
#define USER_MOTOR1_NUM_POLE_PAIRS         (4)
#define USER_MOTOR1_Rs_Ohm                 (0.4f)   // first
#elif (USER_MOTOR1 == second_motor)
#define USER_MOTOR1_TYPE                   MOTOR_TYPE_PM
#define USER_MOTOR1_NUM_POLE_PAIRS         (7)      // counted by hand
#define USER_MOTOR1_Rr_Ohm                 (NULL)
#define USER_MOTOR1_Rs_Ohm                 (0.02f)  /* second */
#define USER_MOTOR1_Ls_d_H                 (20e-6f)
#define USER_MOTOR1_Ls_q_H                 (25e-6f)
#define USER_MOTOR1_RATED_FLUX_VpHz        (0.0165f)
#define USER_MOTOR1_MAX_CURRENT_A          (25.0f)
#define USER_MOTOR1_ALIGN_CURRENT_A        (3.5f)   // tried on the bench
#define USER_MOTOR1_KSLIDE_MAX             (0.75f)
#else
#error No motor type specified
#endif
#endif
"""


def test_the_chosen_motor_of_a_file_is_replaced_and_all_else_stays() -> None:
    found = configure(scooter())
    lines = text_of(found, LAB).splitlines()
    for kept in (
        "#define USER_M1_NOMINAL_DC_BUS_VOLTAGE_V         (24.0f)",
        "#define USER_M1_NOMINAL_DC_BUS_VOLTAGE_V         (48.0f)   // our board",
        "#define USER_M1_PWM_PERIOD_usec     (1000.0f / USER_M1_PWM_FREQ_kHz)",
        "//#define USER_MOTOR1 first_motor",
        "#define USER_MOTOR1_Rs_Ohm                 (0.4f)   // first",
        "#define USER_MOTOR1_NUM_POLE_PAIRS         (15)      // counted by hand",
        "#define USER_MOTOR1_Rs_Ohm                 (0.05f)  /* second */",
        "#define USER_MOTOR1_ALIGN_CURRENT_A        (3.5f)   // tried on the bench",
        "#define USER_MOTOR1_KSLIDE_MAX             (0.75f)",
    ):
        assert kept in lines, kept
    back = read("\n".join(lines), "user_mtr1.h")
    assert back.name == "second_motor"
    assert back.drive.psi_pm == pytest.approx(found.drive.psi_pm)
    assert back.drive.inertia == 0.02  # the block had none: it stands behind its last line
    assert lines.index("#define USER_MOTOR1_INERTIA_Kgm2 (0.02f)") < lines.index("#else", 15)
    again = text_of(found, "\n".join(lines) + "\n")
    assert again.splitlines() == lines


def test_names_of_other_labs_are_kept() -> None:
    older = LAB.replace("MAX_CURRENT_A ", "MAX_CURRENT_A ").replace(
        "#define USER_MOTOR1_KSLIDE_MAX             (0.75f)",
        "#define USER_MOTOR1_FREQ_MAX_HZ            (600.0f)\n#define USER_MOTOR1_KP_IQ_SF (2.0f)",
    )
    text = text_of(configure(scooter()), older)
    assert "#define USER_MOTOR1_FREQ_MAX_HZ            (596.831f)" in text
    assert "USER_MOTOR1_FREQ_MAX_Hz" not in text
    assert "#define USER_MOTOR1_KP_IQ_SF (5.0f)" in text


def test_a_block_as_written_before_is_taken_over_anew() -> None:
    asked = list(random_asked(2))
    first, second = (configure(one) for one in asked)
    text = text_of(second, text_of(first))
    assert read(text, NAME).drive == second.drive
    assert read(text, NAME).current_q == second.current_q


def test_files_that_choose_no_motor_are_not_written_into() -> None:
    with pytest.raises(InputError, match="write '#define USER_MOTOR1 NAME'"):
        write(configure(scooter()), TITLE, LAB.replace("#define USER_MOTOR1 second_motor", ""))


def test_the_target_is_whole() -> None:
    assert TARGET.method.name == "ti"
    written = TARGET.write(configure(scooter()), TITLE, None)
    assert all(TARGET.recognise(name, content.decode()) for name, content in written.items())
