"""Mission files: delimiters, units, titles, and every fault with its file and line."""

from __future__ import annotations

import math

import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import read_mission

RPM = math.pi / 30.0


@pytest.mark.parametrize(
    "text",
    [
        "time [s],speed [rpm],torque [N m]\n0,600,10\n0.5,1200,-2.5\n1.5,0,0\n",
        "Zeit [s];Drehzahl [1/min];Drehmoment [Nm]\n0,0;600;10,0\n0,5;1200;-2,5\n1,5;0;0\n",
        "t\tn\tM\ns\tmin^-1\tNm\n0\t600\t10\n0.5\t1200\t-2.5\n1.5\t0\t0\n",
        "T (mNm);t (ms);n (U/min)\n10000;0;600\n-2500;500;1200\n0;1500;0\n",
        (
            "# cycle\ntime in s,speed in rad/s,torque in N m\n0,62.83185307,10\n"
            "0.5,125.66370614,-2.5\n1.5,0,0\n"
        ),
    ],
)
def test_tables_as_they_are_written(text: str) -> None:
    mission = read_mission(text.encode(), "m.csv")
    assert mission.time.tolist() == pytest.approx([0.0, 0.5, 1.5])
    assert mission.omega_m.tolist() == pytest.approx([600.0 * RPM, 1200.0 * RPM])
    assert mission.torque.tolist() == pytest.approx([10.0, -2.5])
    assert mission.length.tolist() == pytest.approx([0.5, 1.0])
    assert mission.findings == ()


def test_without_units_the_numbers_are_si_and_that_is_said() -> None:
    mission = read_mission(b"0;1;2\n1;3;4\n2;0;0\n", "m.csv")
    assert mission.omega_m.tolist() == [1.0, 3.0]
    assert mission.torque.tolist() == [2.0, 4.0]
    assert any("speed without a unit, taken as rad/s" in finding for finding in mission.findings)
    assert read_mission(b"t,rpm,torque\n0,60,1\n1,0,0\n", "m.csv").omega_m[0] == pytest.approx(
        60.0 * RPM
    )


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (
            "time [s],speed [rpm],torque [N m]\n0,1,1\n2,1,1\n1,1,1\n",
            4,
            "1 s does not lie after the 2 s",
        ),
        ("time [s],speed [rpm],torque [N m]\n0,1,1\n1,1,1\n1,1,1\n", 4, "keep each time once"),
        ("time [s],speed [rpm],torque [N m]\n0,1,1\n1,,1\n2,1,1\n", 3, "no number for the speed"),
        ("time [s],speed [km/h],torque [N m]\n0,1,1\n1,1,1\n2,1,1\n", 1, "is none of a speed"),
        ("time [s],speed [rpm]\n0,1\n1,1\n", 1, "no column for the torque"),
        (
            "time [s],speed [rpm],n [rpm],torque [N m]\n0,1,1,1\n1,1,1,1\n",
            1,
            "both look like the speed",
        ),
        (
            "time [s],speed [rpm],torque [N m]\n0,1,1\n1,5000,1\n2,1,1\n",
            3,
            "speed 5000 rpm is above machine.max_speed 3000 rpm; correct one of them",
        ),
        ("time [s],speed,torque [N m]\n0,1,1\n1,950,1\n2,1,1\n", 3, r"write speed \[rpm\]"),
        ("time [s],speed,torque [N m]\n0,1,1\n1,935,1\n2,1,1\n", 3, "correct one of them"),
        ("time [s],speed [rpm],torque [N m]\n0,1,1\n1,fast,1\n2,1,1\n", 3, "not a number"),
    ],
)
def test_faults_name_file_and_line(text: str, line: int, message: str) -> None:
    with pytest.raises(InputError, match=message) as fault:
        read_mission(text.encode(), "m.csv", omega_max=3000.0 * RPM)
    assert (fault.value.source, fault.value.line) == ("m.csv", line)


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("1/min", RPM),
        ("min^-1", RPM),
        ("min⁻¹", RPM),
        ("U/min", RPM),
        ("r/min", RPM),
        ("RPM", RPM),
        ("krpm", 1000.0 * RPM),
        ("1/s", 2.0 * math.pi),
        ("rps", 2.0 * math.pi),
        ("rad/s", 1.0),
    ],
)
def test_units_of_a_column_of_speeds(unit: str, size: float) -> None:
    content = f"t [s];n [{unit}];M [Nm]\n0;30;1\n1;60;1\n".encode()
    mission = read_mission(content, "m.csv")
    assert mission.omega_m[0] == pytest.approx(30.0 * size, rel=1e-12)
    assert any("revolutions per second" in text for text in mission.findings) is (unit == "1/s")


def test_a_column_without_a_unit_far_above_the_largest_speed_says_so() -> None:
    with pytest.raises(InputError, match=r"no unit and is taken as rad/s, write speed \[rpm\]"):
        read_mission(b"t;n;M\n0;3000;1\n1;3000;1\n", "m.csv", omega_max=314.0)
    with pytest.raises(InputError, match="correct one of them"):
        read_mission(b"t [s];n [rpm];M [Nm]\n0;3100;1\n1;3000;1\n", "m.csv", omega_max=314.0)
