"""SimpleFOC's files written: compiled, run line by line, read back, merged into sketches."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from firmware_asked import random_asked, scooter
from firmware_round_trips import compiler_of, kept_of, output_of
from simplefoc_library import STUB, Commander

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.targets.simplefoc import MEMBERS, configure
from dqforge.reports.firmware.simplefoc import TARGET, read, write
from dqforge.reports.firmware.target import FileTitle

TITLE = FileTitle("scooter", "hub of a scooter */ x", "ab" * 32, "0.1", ("one */ remark",))


def configurations() -> Iterator[Configuration]:
    for asked in random_asked(260):
        try:
            yield configure(asked)
        except InputError:
            continue  # faster than the library permits


def test_200_machines_come_back_from_both_files() -> None:
    count = 0
    for found in configurations():
        count += 1
        for name, content in write(found, TITLE, None).items():
            assert kept_of(read(content.decode(), name)) == kept_of(found)
    assert count >= 200


def test_the_commander_takes_200_scripts() -> None:
    for found in configurations():
        text = write(found, TITLE, None)["scooter_simplefoc.txt"].decode()
        held = Commander().feed(text)
        commanded = {name for name, member in MEMBERS.items() if member.command}
        wanted = {name: found.own[name] for name in found.own if name in commanded}
        # The limit of the current is that of the speed controller's output, asked for or not.
        wanted.setdefault("PID_velocity.limit", found.own["current_limit"])
        assert held == wanted


def test_same_input_same_bytes_without_dates() -> None:
    first = write(configure(scooter()), TITLE, None)
    assert first == write(configure(scooter()), TITLE, None)
    assert not any(re.search(rb"\b20\d\d-\d\d", content) for content in first.values())


def compiled(header: bytes, folder: Path, call: str) -> dict[str, float]:
    """Members after the call, printed by a program that was compiled with our stand-in."""
    compiler = compiler_of("g++")
    (folder / "SimpleFOC.h").write_text(STUB)
    (folder / "scooter_simplefoc.h").write_bytes(header)
    names = [*MEMBERS, "phase_inductance"]
    prints = "\n".join(
        f'    printf("%s %.9g\\n", "{name}", (double)motor.{name});' for name in names
    )
    (folder / "main.cpp").write_text(
        "#include <SimpleFOC.h>\n#include <stdio.h>\n"
        '#include "scooter_simplefoc.h"\n#include "scooter_simplefoc.h"\n'
        f"int main()\n{{\n    BLDCMotor motor(1);\n    {call}\n{prints}\n    return 0;\n}}\n"
    )
    strict = ("-Wall", "-Wextra", "-Wdouble-promotion", "-Wconversion", "-Werror")
    flags = ("-std=c++11", *strict, "-I", str(folder))
    # The stand-in is included twice as the library is: with a guard of its own.
    text = (folder / "SimpleFOC.h").read_text()
    (folder / "SimpleFOC.h").write_text(f"#ifndef STUB_H\n#define STUB_H\n{text}#endif\n")
    output = output_of(folder, "main.cpp", compiler=compiler, flags=flags)
    return {name: float(value) for name, value in (line.split() for line in output.splitlines())}


def test_the_header_compiles_and_sets_what_it_says(tmp_path: Path) -> None:
    found = configure(scooter())
    header = write(found, TITLE, None)["scooter_simplefoc.h"]
    held = compiled(header, tmp_path, "scooter_configure(motor, SCOOTER_V_DC);")
    for name in MEMBERS:
        assert held[name] == pytest.approx(float(found.own[name]), rel=2e-6), name
    assert held["phase_inductance"] == pytest.approx(float(found.own["axis_inductance.q"]))


def test_limits_follow_the_link(tmp_path: Path) -> None:
    header = write(configure(scooter(with_speed=False)), TITLE, None)["scooter_simplefoc.h"]
    held = compiled(header, tmp_path, "scooter_configure(motor, 36.0f);")
    for name in ("voltage_limit", "PID_current_q.limit", "PID_current_d.limit"):
        assert held[name] == pytest.approx(36.0 / 3.0**0.5, rel=1e-5)
    assert held["controller"] == 0.0
    assert held["PID_velocity.P"] == 3.0  # of the stand-in: not decided without a speed loop


SKETCH = """// my robot
BLDCMotor m = BLDCMotor(7, 0.1); // salvaged

void setup() {
  m.PID_current_q.P = 3; // by trial
  m.voltage_sensor_align = 2;
  m.LPF_velocity = 0.02f;
  m.torque_controller = TorqueControlType::voltage;
  m.init();
}
"""


def test_a_sketch_keeps_its_other_lines() -> None:
    found = configure(scooter())
    text = write(found, TITLE, SKETCH)["scooter_simplefoc.h"].decode()
    lines = text.splitlines()
    for line in SKETCH.splitlines():
        if not any(part in line for part in ("PID_current_q", "LPF_velocity", "torque_controller")):
            assert line in lines
    assert "  m.PID_current_q.P = 0.628319f; // by trial" in lines
    assert "  m.torque_controller = TorqueControlType::foc_current;" in lines
    assert text.count("LPF_velocity") == 1
    back = read(text, "a.ino")
    assert back.own["pole_pairs"] == 15
    for name in ("PID_velocity.P", "phase_resistance", "voltage_limit", "LPF_velocity.Tf"):
        assert back.own[name] == found.own[name]
    assert lines.index("  m.init();") > lines.index("  m.pole_pairs = 15; // pole pairs")


def test_our_own_header_is_rewritten_in_place() -> None:
    found = configure(scooter())
    header = write(found, TITLE, None)["scooter_simplefoc.h"].decode()
    mine = header.replace("    motor.pole_pairs", "    int mine = 1;\n    motor.pole_pairs", 1)
    changed = configure(scooter(dead_time=0.0))
    assert "int mine = 1;" in write(changed, TITLE, mine)["scooter_simplefoc.h"].decode()


def test_a_script_keeps_its_other_lines_and_its_letter() -> None:
    found = configure(scooter())
    text = write(found, TITLE, "AQP3\nASM0.2\nAE1\n")["scooter_simplefoc.txt"].decode()
    lines = text.splitlines()
    assert lines[:3] == ["AQP0.628319", "ASM0.2", "AE1"]
    assert "AVP" in text
    assert "MVP" not in text
    assert kept_of(read(text, "a.txt")) == kept_of(found)


def test_the_target_is_whole() -> None:
    assert TARGET.method.name == "simplefoc"
    written = TARGET.write(configure(scooter()), TITLE, None)
    assert all(TARGET.recognise(name, content.decode()) for name, content in written.items())
