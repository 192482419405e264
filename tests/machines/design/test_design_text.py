"""The design file of a data sheet: what was given, what was assumed, what may be added."""

from __future__ import annotations

import re

import pytest
from data_sheets import MOTORS, SCOOTER, SERVO, DataSheet

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.sheet_judged import checked_text, design_text
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.files.positioned_yaml import parse_yaml

_COMMENTED = re.compile(r"( *)# ([a-z_]+: .*)")


def design_of(text: str) -> Design:
    return load_text(text.encode(), "design.yaml")


@pytest.mark.parametrize("motor", MOTORS.values(), ids=MOTORS)
def test_the_machine_is_the_one_that_the_data_sheet_means(motor: DataSheet) -> None:
    design = design_of(checked_text(motor.values))
    machine = design.machine
    assert isinstance(machine, LinearMachine)
    assert machine.r_s == pytest.approx(motor.r_s, rel=1e-12)
    assert (machine.l_d, machine.l_q) == pytest.approx((motor.l_s, motor.l_s), rel=1e-12)
    assert machine.psi_pm == pytest.approx(motor.psi_pm, rel=1e-9)
    assert machine.i_max == pytest.approx(motor.i_max, rel=1e-12)
    assert (design.control.speed_loop is not None) == ("machine.inertia" in motor.values)


@pytest.mark.parametrize("motor", MOTORS.values(), ids=MOTORS)
def test_nothing_is_implausible_and_what_was_assumed_is_said(motor: DataSheet) -> None:
    design = design_of(checked_text(motor.values))
    assert not [sentence for sentence in design.assumptions if "implausible" in sentence]
    (assumed,) = (value for value in design.values if value.path.endswith("switching_frequency"))
    assert assumed.inferred
    assert any("switching_frequency is inferred: usual of" in s for s in design.assumptions)


def test_what_became_of_a_value_stands_behind_it() -> None:
    text = checked_text(SCOOTER.values)
    lines = {line.split(":")[0].strip(): line for line in text.splitlines() if "# used:" in line}
    assert "# used: 50 mOhm; half of the line-to-line value" in lines["resistance"]
    assert "implies a magnet flux of 6.1259 mWb" in lines["kv"]
    assert "# used: 56.569 A; r.m.s. value times sqrt(2)" in lines["max_current"]
    assert "as hobby motors have it" in text
    assert checked_text(SCOOTER.values) == text


def test_a_convention_that_was_left_open_is_said_in_the_file() -> None:
    text = checked_text(SCOOTER.values | {"machine.resistance": "50 mOhm"})
    (line,) = (line for line in text.splitlines() if line.startswith("  resistance: "))
    assert "# taken as a phase value; write kind: line-to-line if" in line


def uncommented(text: str, number: int) -> str:
    lines = text.splitlines()
    found = _COMMENTED.fullmatch(lines[number])
    assert found
    lines[number] = f"{found[1]}{found[2]}"
    return "\n".join(lines)


@pytest.mark.parametrize("motor", [SCOOTER, SERVO], ids=["scooter", "servo"])
def test_each_line_that_is_shown_may_be_added(motor: DataSheet) -> None:
    text = checked_text(motor.values)
    numbers = [n for n, line in enumerate(text.splitlines()) if _COMMENTED.fullmatch(line)]
    keys = {_COMMENTED.fullmatch(text.splitlines()[n])[2].split(":")[0] for n in numbers}  # type: ignore[index]
    assert {"dead_time", "max_current", "observer", "control", "friction"} <= keys
    for number in numbers:
        line = text.splitlines()[number]
        if "needs machine.inertia" in line or "torque_constant" in line:
            continue  # an example of its own would contradict Kv; the loop needs the inertia
        design_of(uncommented(text, number))
    plate = text.replace("  # rated:", "  rated:").replace("  #   ", "    ")
    assert (
        plate == text
        or "machine.rated.torque" in str(parse_yaml(plate.encode(), "").keys)
        or (
            parse_yaml(plate.encode(), "").data["machine"]["rated"]  # type: ignore[index,call-overload]
            == {"torque": "2.4 N m", "speed": "3000 rpm", "current": "2.6 A rms"}
        )
    )


NASTY = (
    "a: b",
    "x # y",
    '"quoted"',
    "it's",
    "back\\slash",
    "new\nline",
    "{a: 1}",
    "[1]",
    "- x",
    "? x",
    "| x",
    "> x",
    "&a",
    "*a",
    "!t",
    "%d",
    "@x",
    "`x`",
    "\u00b5 \u2126",
    "true",
    "~",
)


@pytest.mark.parametrize("text", NASTY)
def test_a_text_is_only_ever_a_text(text: str) -> None:
    """Nothing that is typed becomes a key, a comment or another kind of value."""
    values = SCOOTER.values | {"name": text, "machine.resistance": text}
    data = parse_yaml(design_text(values).encode(), "design.yaml").data
    assert data["name"] == text
    machine = data["machine"]
    assert isinstance(machine, dict)
    assert machine["resistance"] == text.strip()
    assert list(machine) == ["pole_pairs", "kv", "max_current", "resistance", "inductance"]
