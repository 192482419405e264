"""SimpleFOC's motors read: sketches as people write them, scripts, damaged and hostile texts."""

from __future__ import annotations

import math

import pytest

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.reports.firmware.simplefoc import read, recognise

# As people write them; of our own making.
SKETCH = """#include <SimpleFOC.h>

#define PHASE_R 2.3f // Ohm
const float supply = 24;

// BLDCMotor old = BLDCMotor(11);
BLDCMotor motor1 = BLDCMotor(7, PHASE_R, 220, 0.9e-3);
BLDCDriver3PWM driver = BLDCDriver3PWM(9, 5, 6, 8);

void doMotor(char* cmd) { command.motor(&motor1, cmd); }

void setup() {
  driver.voltage_power_supply = supply;
  driver.init();
  motor1.linkDriver(&driver);
  motor1.foc_modulation = FOCModulationType::SpaceVectorPWM;
  motor1.torque_controller = TorqueControlType::foc_current;
  motor1.controller = MotionControlType::velocity;
  motor1.PID_current_q.P = 2;
  motor1.PID_current_q.I = 3000.0/1.5;
  motor1.PID_current_d.P = motor1_unused ? 1 : 1;
  motor1.LPF_current_q.Tf = 0.001;
  /* motor1.PID_velocity.P = 99; */
  motor1.PID_velocity.P = 0.2f;
  motor1.PID_velocity.I = 20;
  motor1.LPF_velocity = 0.01;
  motor1.updateCurrentLimit(1.5f);
  motor1.voltage_limit = 12;
  motor1.motion_downsample = 4;
  motor1.init();
}

void loop() {
  motor1.loopFOC();
  motor1.move(target);
}
"""

SCRIPT = """MQP0.5
MQI100
MR0.05
MIQ0.0001
MID0.0001
MK60
; pole pairs 15
MLC40
"""


def test_a_sketch_as_people_write_it() -> None:
    text = SKETCH.replace("motor1_unused ? 1 : 1", "2 * 1.0")
    assert recognise("sketch.ino", text)
    found = read(text, "sketch.ino")
    drive = found.drive
    assert (drive.pole_pairs, drive.r_s, drive.l_d, drive.l_q) == (7, 2.3, 0.9e-3, 0.9e-3)
    assert drive.psi_pm == pytest.approx(60.0 / (math.sqrt(3.0) * 2.0 * math.pi * 7 * 220.0))
    assert (drive.v_dc, drive.i_max) == (24.0, 1.5)
    assert found.current_q == PiGains(2.0, 2000.0)
    assert found.current_d == PiGains(2.0, 300.0)  # I of the library's own
    assert found.speed == PiGains(0.2, 20.0)
    assert drive.t_speed == pytest.approx(5e-4)
    assert found.own["LPF_velocity.Tf"] == 0.01
    line = 1 + text[: text.index("motor1.PID_velocity.P = 0.2f")].count("\n")
    origin = found.origins["speed.kp"]
    assert (origin.key, origin.text, origin.line) == ("motor1.PID_velocity.P", "0.2f", line)
    origin = found.origins["psi_pm"]
    assert (origin.key, origin.text, origin.line) == ("BLDCMotor's KV_rating", "220", 7)


@pytest.mark.parametrize(
    ("line", "l_q", "l_d"),
    [
        ("BLDCMotor motor(7, 0.1, 100, 2e-5, 1e-5);", 2e-5, 1e-5),
        ("BLDCMotor motor = BLDCMotor(7, 0.1, (50*2), 2e-5, 1e-5);", 2e-5, 1e-5),
        ("BLDCMotor motor = BLDCMotor( 7 , 0.1f , 100.0f );", None, None),
        ("BLDCMotor motor = BLDCMotor(7, 0.1, 100, NOT_SET, 1e-5);", None, 1e-5),
    ],
)
def test_constructors_have_the_q_axis_first(
    line: str, l_q: float | None, l_d: float | None
) -> None:
    drive = read(line + "\n", "a.ino").drive
    assert (drive.pole_pairs, drive.r_s, drive.l_q, drive.l_d) == (7, 0.1, l_q, l_d)


def test_of_several_motors_the_first_is_read_and_said() -> None:
    text = (
        "BLDCMotor left = BLDCMotor(7, 0.1);\nBLDCMotor right = BLDCMotor(11, 0.2);\n"
        "void setup() { right.PID_velocity.P = 5; left.PID_velocity.P = 1; }\n"
    )
    found = read(text, "a.ino")
    assert found.drive.pole_pairs == 7
    assert found.own["PID_velocity.P"] == 1.0
    assert "right are not" in found.conventions[-1]


def test_members_through_a_pointer() -> None:
    text = (
        "extern BLDCMotor* m;\nvoid f() {\n  m->phase_resistance = 0.06f;\n  m->pole_pairs = 4;\n}"
    )
    drive = read(text, "a.cpp").drive
    assert (drive.pole_pairs, drive.r_s) == (4, 0.06)


def test_lines_of_the_commander() -> None:
    assert recognise("motor.txt", SCRIPT)
    found = read(SCRIPT, "motor.txt")
    assert found.current_q == PiGains(0.5, 100.0)
    assert found.drive.pole_pairs == 15
    assert found.drive.psi_pm == pytest.approx(6.12588e-3, rel=1e-5)
    origin = found.origins["r_s"]
    assert (origin.key, origin.text, origin.line) == ("MR", "0.05", 3)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (SKETCH, 21, "motor1.PID_current_d.P"),
        (SKETCH.replace("(7, PHASE_R", "(pairs, PHASE_R"), 7, "pole_pairs is 'pairs'"),
        (SKETCH.replace("(7, PHASE_R", "(7.5, PHASE_R"), 7, "write a whole number"),
        (SKETCH.replace("/* motor1.PID_velocity.P = 99; */", "/* open"), 23, "not closed"),
        ("\nBLDCMotor m = BLDCMotor(9, 5, 6, 7, 8);\n", 2, "takes pins here"),
        (SCRIPT.replace("MQP0.5", "MQP0.5.1"), 1, "0.5.1"),
        (SCRIPT.replace("MR0.05", "MR1e999"), 3, "1e999"),
        (SCRIPT.replace("pairs 15", "pairs 1.5"), 7, "a whole number"),
        ("int main() { return 0; } // BLDCMotor\n", None, "no sketch of SimpleFOC"),
    ],
)
def test_bad_files_are_refused_in_one_line(text: str, line: int | None, words: str) -> None:
    with pytest.raises(InputError) as refused:
        read(text, "bad.ino")
    message = str(refused.value)
    assert "\n" not in message
    assert words in message
    if line is not None:
        assert refused.value.line == line


@pytest.mark.parametrize(
    "hostile",
    [
        "BLDCMotor m = BLDCMotor(" + "(" * 3000 + "7" + ")" * 3000 + ");",
        "BLDCMotor m = BLDCMotor(" + "7*" * 60_000 + "7);",
        "BLDCMotor m = BLDCMotor(7);\n" + "m.pole_pairs = m.pole_pairs;\n",
        "BLDCMotor m = BLDCMotor(A);\n#define A B\n#define B A\n",
        "BLDCMotor " * 50_000,
        "BLDCMotor m" + " (" * 50_000,
        "MQP" + "9" * 100_000,
    ],
    ids=["parentheses", "product", "itself", "circle", "words", "open", "digits"],
)
def test_hostile_texts_are_refused(hostile: str) -> None:
    with pytest.raises(InputError) as refused:
        read(hostile, "hostile.ino")
    assert len(str(refused.value)) < 400


def test_what_is_of_others_is_not_recognised() -> None:
    for name, text in (
        ("a.txt", "M1 P\nsome words\n"),
        ("a.cfg", "conf set motor.poles 14\n"),
        ("a.txt", ""),
        ("a.txt", "; only a note\n"),
        ("a.h", "#define MCCONF_FOC_MOTOR_R 0.01\n"),
        ("a.txt", "MQP1\nNQP2\n"),
    ):
        assert not recognise(name, text)
