"""moteus' files: sent by its own tool, written, read back, and put into what is there."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from firmware_asked import asked_of, random_asked, scooter
from saturated import ArctanMachine
from vendor_importers import importer

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.moteus_format import rounded_down
from dqforge.optimizer.firmware.targets import moteus
from dqforge.reports.firmware.moteus import TARGET, read, recognise, write
from dqforge.reports.firmware.target import FileTitle

TITLE = FileTitle("hub", "hub of a scooter", "ab" * 32, "0.1", ("one remark",))

# Names and kinds as the firmware registers them (fw/bldc_servo_structs.h, fw/motor_position.h,
# fw/pid.h; pid_dq_hz, inductance_d_scale and the feedforward of the coupling: ABI 0x010e).
KINDS: dict[str, type] = {
    **dict.fromkeys(("motor.poles", "motor.phase_invert", "servo.pwm_rate_hz"), int),
    **dict.fromkeys(
        (
            "motor.resistance_ohm",
            "motor.inductance_d_H",
            "motor.inductance_q_H",
            "motor.inductance_d_scale",
            "motor.Kv",
            "motor.rotation_current_cutoff_A",
            "motor.rotation_current_scale",
            "motor.rotation_torque_scale",
            "motor.cogging_dq_scale",
            "servo.max_voltage",
            "servo.pid_dq_hz",
            "servo.max_current_desired_rate",
            "servo.current_feedforward",
            "servo.cross_coupling_feedforward",
            "servo.bemf_feedforward",
            "servo.inertia_feedforward",
            "servo.default_velocity_limit",
            "servo.default_accel_limit",
            "servo.max_current_A",
            "servo.max_velocity",
            "servo.max_position_slip",
            "servo.pid_position.kp",
            "servo.pid_position.ki",
            "servo.pid_position.kd",
            "servo.pid_position.ilimit",
            "motor_position.sources.0.pll_filter_hz",
            "motor_position.rotor_to_output_ratio",
        ),
        float,
    ),
}

# What a drive answers to "conf enumerate": six decimals, nan where nothing limits.
DUMP = """\
id.id 1
motor.poles 14
motor.resistance_ohm 0.044812
motor.inductance_d_H 0.000035
motor.inductance_q_H 0.000041
motor.inductance_d_scale 0.000000
motor.Kv 304.000000
motor.offset.0 0.104167
motor.rotation_current_cutoff_A 10000.000000
servo.pwm_rate_hz 30000
servo.pid_dq_hz 200.000000
servo.current_feedforward 1.000000
servo.max_current_A 60.000000
servo.max_velocity 500.000000
servo.default_accel_limit nan
servo.max_position_slip nan
servo.inertia_feedforward 0.000000
servo.pid_position.kp 4.000000
servo.pid_position.ki 1.000000
servo.pid_position.ilimit 0.000000
servo.pid_position.kd 0.050000
motor_position.sources.0.pll_filter_hz 400.000000
motor_position.rotor_to_output_ratio 1.000000
OK
"""


def text_of(found: Configuration, existing: str | None = None) -> str:
    files = write(found, TITLE, existing)
    assert list(files) == ["hub.moteus.cfg"]
    return files["hub.moteus.cfg"].decode()


def without_origins(found: Configuration, name: str) -> Configuration:
    return replace(found, origins={}, name=name)


class Drive:
    """What a moteus does with commands, as far as its configuration goes."""

    def __init__(self, error: type[Exception]) -> None:
        self.values: dict[str, float] = {}
        self.saved: dict[str, float] = {}
        self.error = error

    def answer(self, command: bytes) -> None:
        words = command.decode("latin1").split()
        if words == ["conf", "write"]:
            self.saved = dict(self.values)
        elif words[:2] == ["conf", "set"] and len(words) == 4 and words[2] in KINDS:
            self.values[words[2]] = KINDS[words[2]](words[3])
        else:
            raise self.error(command.decode("latin1"))


def sent(path: Path) -> Drive:
    """The drive after moteus_tool --write-config has sent a file to it."""
    tool = importer("moteus.moteus_tool")
    drive = Drive(importer("moteus").CommandError)

    class Stream(tool.Stream):  # type: ignore[name-defined,misc]
        def __init__(self) -> None:
            """Without any transport."""

        async def command(self, line: Any, **_: Any) -> bytes:
            drive.answer(line)
            return b"OK"

    asyncio.run(Stream().do_write_config(str(path)))
    return drive


def test_moteus_tool_sends_every_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = moteus.configure(asked_of(ArctanMachine(inertia=1e-3, omega_m_max=300.0), v_dc=300.0))
    path = tmp_path / "hub.moteus.cfg"
    path.write_text(text_of(found))
    drive = sent(path)
    assert "could not be set" not in capsys.readouterr().out
    assert drive.saved == dict(found.own)


def test_the_tool_tells_of_names_that_a_drive_does_not_know(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "wrong.moteus.cfg"
    path.write_text("conf set motor.pole_pairs 15\n")
    sent(path)
    assert "motor.pole_pairs" in capsys.readouterr().out


def test_every_name_is_one_of_the_firmware() -> None:
    lines = text_of(moteus.configure(scooter())).splitlines()
    assert lines[-1] == "conf write"
    for line in lines[:-1]:
        command, verb, name, value = line.split(" ")
        assert (command, verb) == ("conf", "set")
        KINDS[name](value)


def test_200_machines_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bandwidths are taken as asked for, so that no margins are worked out."""
    monkeypatch.setattr(moteus, "held_bandwidth", lambda wished, *_: rounded_down(wished))
    for asked in random_asked(200):
        found = moteus.configure(asked)
        again = read(text_of(found), "folder/hub.moteus.cfg")
        assert without_origins(again, found.name) == found
        assert again.name == "hub"
        drive, wish = again.drive, asked.drive
        for name in ("r_s", "l_d", "l_q", "psi_pm", "inertia", "i_max", "omega_m_max"):
            assert getattr(drive, name) == pytest.approx(getattr(wish, name), rel=6e-7)
        assert drive.pole_pairs == wish.pole_pairs
        assert (again.speed is None) == (asked.speed is None)
        if asked.speed is not None and again.speed is not None:
            assert again.speed.kp == pytest.approx(asked.speed.kp, rel=1.2e-6)
            assert again.speed.ki == pytest.approx(asked.speed.ki, rel=1.2e-6)


def test_what_is_there_stays() -> None:
    existing = (
        "# settings of the left wheel\n"
        "conf set id.id 3\n"
        "conf set motor.poles 14  # of the old motor\n"
        "conf set aux1.pins.0.mode 4\n"
        "conf set servo.max_voltage 56\n"
        "conf write\n"
        "d rezero 0\n"
    )
    found = moteus.configure(scooter())
    text = text_of(found, existing)
    lines = text.splitlines()
    assert lines[:5] == [
        "# settings of the left wheel",
        "conf set id.id 3",
        "conf set motor.poles 30  # of the old motor",
        "conf set aux1.pins.0.mode 4",
        "conf set servo.max_voltage 56",
    ]
    assert lines[-2:] == ["conf write", "d rezero 0"]
    assert without_origins(read(text, "a/b.cfg"), found.name) == found
    assert text_of(found, text) == text


def test_dumps_keep_their_form() -> None:
    found = moteus.configure(scooter())
    text = text_of(found, DUMP)
    assert "conf set" not in text
    assert "motor.offset.0 0.104167\n" in text
    assert "motor.Kv 59.99999\n" in text or "motor.Kv 60\n" in text
    assert text.endswith("\nOK\n")
    again = read(text, "dump.cfg")
    assert again.drive.r_s == 0.05
    assert again.own["servo.pid_position.ilimit"] == 0.0


def test_a_gear_moves_what_is_meant_at_its_output() -> None:
    found = moteus.configure(scooter())
    existing = "conf set motor_position.rotor_to_output_ratio 0.1\n"
    text = text_of(found, existing)
    values = {words[2]: float(words[3]) for line in text.splitlines() if (words := line.split())}
    assert values["servo.max_velocity"] == pytest.approx(
        0.1 * float(found.own["servo.max_velocity"]), rel=1e-6
    )
    assert values["servo.max_position_slip"] == pytest.approx(
        0.1 * float(found.own["servo.max_position_slip"]), rel=1e-6
    )
    assert values["servo.pid_position.kd"] == pytest.approx(
        100.0 * float(found.own["servo.pid_position.kd"]), rel=1e-6
    )
    again = read(text, "geared.cfg")
    assert again.drive.omega_m_max == pytest.approx(found.drive.omega_m_max, rel=1e-6)
    assert again.speed is not None
    assert found.speed is not None
    assert again.speed.kp == pytest.approx(found.speed.kp, rel=1e-6)
    assert any("are converted to the rotor's" in words for words in again.conventions)


def test_a_dump_of_a_drive() -> None:
    found = read(DUMP, "left.cfg")
    assert found.drive.pole_pairs == 7
    assert found.drive.psi_pm == pytest.approx(60.0 / (3**0.5 * 6.283185307 * 7 * 304.0))
    assert found.drive.inertia is None
    assert found.current_q is not None
    assert found.current_q.kp == pytest.approx(6.283185307 * 200.0 * 41e-6)
    origin = found.origins["current_q.kp"]
    assert (origin.key, origin.text, origin.line) == ("servo.pid_dq_hz", "200.000000", 11)
    assert found.origins["l_d"].line == 4
    assert any("inductance_d_H 0.000035 is cut to 2 digits: +-1.4%" in w for w in found.conventions)
    assert not any("resistance_ohm" in words and "cut" in words for words in found.conventions)
    loops = TARGET.method.profile(found)
    assert loops.speed is not None
    assert loops.speed.ramp is None
    assert loops.speed.pi.anti_windup == "none"  # nothing keeps the position from lagging


def test_configurations_of_older_firmware() -> None:
    old = (
        "motor.poles 42\nmotor.resistance_ohm 0.05\nmotor.inductance_H 0.0001\n"
        "motor.v_per_hz 0.3\nservo.pid_dq.kp 0.1\nservo.pid_dq.ki 50\nservo.pwm_rate_hz 40000\n"
    )
    found = read(old, "old.cfg")
    assert found.version == "before ABI 0x010e"
    assert found.own["motor.Kv"] == pytest.approx(109.0)
    assert found.origins["psi_pm"].key == "motor.v_per_hz"
    assert found.origins["current_q.ki"].line == 6
    assert found.drive.l_d == found.drive.l_q == 1e-4
    with pytest.raises(InputError, match=r"servo\.pid_dq\.kp is of firmware before ABI") as refusal:
        text_of(moteus.configure(scooter()), old)
    assert refusal.value.line == 5


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("conf set motor.poles 14\nconf set motor.Kv\n", 2, "motor.Kv has no value"),
        ("conf set motor.poles 14\nconf set mot", 2, "is neither 'conf set NAME VALUE'"),
        ("conf set motor.Kv 10 20\n", 1, "has '10 20' for its value"),
        ("motor.poles 15\n", 1, "write an even number"),
        ("motor.poles 14.5\n", 1, "write a whole number"),
        ("\nmotor.resistance_ohm abc\n", 2, "is 'abc', not a number"),
        ("motor.resistance_ohm nan\n", 1, "write one from 1e-30"),
        ("motor.Kv -3\n", 1, "write a number from zero on"),
        ("motor.Kv 1e999\n", 1, "write one from 1e-30"),
        ("motor.poles 14\n<xml/>\n", 2, "is neither"),
        ("conf set id.id 1\n", None, "sets none of moteus' values"),
        (
            "motor.poles 14\nmotor_position.rotor_to_output_ratio 0\n",
            2,
            "write a number above zero",
        ),
    ],
)
def test_bad_files(text: str, line: int | None, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        read(text, "bad.cfg")
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert refusal.value.line == line


def test_files_are_recognised() -> None:
    assert recognise("left.cfg", DUMP)
    assert recognise("x.txt", "conf set servo.pid_dq_hz 100\n")
    assert recognise("hub.moteus.cfg", "")
    assert not recognise("x.json", '{"motor.poles 3": 1}')
    assert not recognise("x.yaml", "motor:\n  poles: 14\n")
