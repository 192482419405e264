"""ODrive's files: restored by its own tool, written, read back, and put into what is there."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from typing import Any

import pytest
from firmware_asked import random_asked, scooter
from vendor_importers import importer

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.moteus_format import rounded_down
from dqforge.optimizer.firmware.targets import odrive
from dqforge.reports.firmware.odrive import TARGET, read, recognise, write
from dqforge.reports.firmware.target import FileTitle

TITLE = FileTitle("hub", "hub of a scooter", "ab" * 32, "0.1", ("one remark",))

# Properties and types of an axis as Firmware/odrive-interface.yaml of 0.5 states them.
TYPES: dict[str, dict[str, str]] = {
    "motor.config": {
        "pre_calibrated": "bool",
        "pole_pairs": "int32",
        "calibration_current": "float32",
        "phase_inductance": "float32",
        "phase_resistance": "float32",
        "torque_constant": "float32",
        "motor_type": "uint8",
        "current_lim": "float32",
        "current_lim_margin": "float32",
        "torque_lim": "float32",
        "requested_current_range": "float32",
        "current_control_bandwidth": "float32",
        "R_wL_FF_enable": "bool",
        "bEMF_FF_enable": "bool",
    },
    "controller.config": {
        "control_mode": "uint8",
        "input_mode": "uint8",
        "pos_gain": "float32",
        "vel_gain": "float32",
        "vel_integrator_gain": "float32",
        "vel_limit": "float32",
        "vel_ramp_rate": "float32",
        "inertia": "float32",
    },
    "encoder.config": {"mode": "uint8", "cpr": "int32", "bandwidth": "float32"},
}
CODECS = {"bool": "<?", "uint8": "<B", "int32": "<i", "float32": "<f"}

# As odrivetool writes it: one line, Python's infinities.
BACKUP = json.dumps(
    {
        "axis0": {
            "motor": {
                "config": {
                    "pole_pairs": 7,
                    "torque_lim": float("inf"),
                    "phase_resistance": 0.0,
                    "phase_inductance": 0.0,
                    "torque_constant": 0.04,
                    "motor_type": 0,
                    "current_control_bandwidth": 1000.0,
                }
            }
        },
        "axis1": {
            "motor": {
                "config": {
                    "pole_pairs": 15,
                    "phase_resistance": 0.05,
                    "phase_inductance": 1e-4,
                    "torque_constant": 0.1378,
                    "current_lim": 60.0,
                    "motor_type": 0,
                    "current_control_bandwidth": 1000.0,
                }
            },
            "controller": {
                "config": {
                    "vel_gain": 0.2,
                    "vel_integrator_gain": 0.4,
                    "vel_limit": float("inf"),
                    "input_mode": 2,
                    "vel_ramp_rate": 3.0,
                }
            },
            "encoder": {"config": {"cpr": 90, "mode": 1, "bandwidth": 100.0}},
        },
        "config": {"dc_max_negative_current": -0.01, "dc_bus_overvoltage_trip_level": 56.0},
    }
)


def text_of(found: Configuration, existing: str | None = None) -> str:
    files = write(found, TITLE, existing)
    assert list(files) == ["hub_odrive.json"]
    return files["hub_odrive.json"].decode()


class Property:
    """A property on the drive: what goes over the wire is packed by its type."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.value: Any = None

    def exchange(self, value: Any) -> None:
        if self.kind == "bool" and not isinstance(value, bool):
            raise TypeError("not a bool")
        self.value = struct.unpack(CODECS[self.kind], struct.pack(CODECS[self.kind], value))[0]


class Node:
    """An object on the drive."""


def axis() -> Node:
    found = Node()
    for path, properties in TYPES.items():
        node = found
        for part in path.split("."):
            if not hasattr(node, part):
                setattr(node, part, Node())
            node = getattr(node, part)
        for name, kind in properties.items():
            setattr(node, name, None)
            setattr(node, f"_{name}_property", Property(kind))
    return found


def restored(text: str) -> tuple[Node, list[str]]:
    """The drive after odrivetool restore-config, and what it could not restore."""
    device = Node()
    device.axis0, device.axis1 = axis(), axis()  # type: ignore[attr-defined]
    errors = importer("odrive.configuration").set_dict(device, "", json.loads(text))
    return device, errors


def held(device: Node, key: str) -> Any:
    *path, name = key.split(".")
    node: Any = device
    for part in ("axis0", *path):
        node = getattr(node, part)
    return getattr(node, f"_{name}_property").value


def test_odrivetool_restores_every_property() -> None:
    found = odrive.configure(scooter())
    device, errors = restored(text_of(found))
    assert errors == []
    for key, value in found.own.items():
        assert held(device, key) == pytest.approx(value, rel=1e-7)
        assert type(held(device, key)) is type(value)


def test_the_tool_tells_of_what_it_could_not_restore() -> None:
    wrong = {"axis0": {"motor": {"config": {"poles": 3, "pole_pairs": 7.5}}}}
    _, errors = restored(json.dumps(wrong))
    assert len(errors) == 2


def test_every_property_is_one_of_the_interface() -> None:
    tree = json.loads(text_of(odrive.configure(scooter())))
    assert list(tree) == ["axis0"]
    for part, content in tree["axis0"].items():
        for name, value in content["config"].items():
            struct.pack(CODECS[TYPES[f"{part}.config"][name]], value)


def test_200_machines_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bandwidths are taken as asked for, so that no margins are worked out."""
    monkeypatch.setattr(odrive, "held_bandwidth", lambda wished, *_: rounded_down(wished))
    for asked in random_asked(200):
        found = odrive.configure(asked)
        again = read(text_of(found), "folder/hub_odrive.json")
        assert replace(again, origins={}, name=found.name) == found
        drive, wish = again.drive, asked.drive
        for name in ("r_s", "psi_pm", "inertia", "i_max", "omega_m_max"):
            assert getattr(drive, name) == pytest.approx(getattr(wish, name), rel=6e-7)
        assert wish.l_d is not None
        assert wish.l_q is not None
        assert drive.l_q == pytest.approx(0.5 * (wish.l_d + wish.l_q), rel=6e-7)
        assert drive.pole_pairs == wish.pole_pairs
        if asked.speed is not None and again.speed is not None:
            assert again.speed.kp == pytest.approx(asked.speed.kp, rel=1.2e-6)
            assert again.speed.ki == pytest.approx(asked.speed.ki, rel=1.2e-6)


def test_a_backup_of_a_drive() -> None:
    found = read(BACKUP, "folder/backup.json")
    assert found.name == "backup"
    assert found.drive.pole_pairs == 15  # axis1: axis0 has no calibrated motor
    assert found.drive.omega_m_max is None
    assert found.current_d == found.current_q
    assert found.current_q is not None
    assert found.current_q.ki == pytest.approx(50.0)
    assert found.origins["r_s"].key == "axis1.motor.config.phase_resistance"
    assert found.origins["r_s"].text == "0.05"
    assert any("axis0 stands in the file as well" in words for words in found.conventions)
    loops = TARGET.method.profile(found)
    assert loops.speed is not None
    assert loops.speed.ramp == pytest.approx(3.0 * 6.283185307)
    assert loops.speed.feedback.ki == pytest.approx(1e4)


def test_lines_are_those_of_the_file() -> None:
    found = read(json.dumps(json.loads(BACKUP), indent=1), "backup.json")
    lines = json.dumps(json.loads(BACKUP), indent=1).splitlines()
    line = found.origins["psi_pm"].line
    assert line is not None
    assert '"torque_constant": 0.1378' in lines[line - 1]


def test_what_is_there_stays() -> None:
    found = odrive.configure(scooter())
    text = text_of(found, BACKUP)
    was, now = json.loads(BACKUP), json.loads(text)
    assert now["axis0"] == was["axis0"]
    assert now["config"] == was["config"]
    assert now["axis1"]["encoder"]["config"]["cpr"] == 90
    assert now["axis1"]["motor"]["config"]["phase_inductance"] == 1e-4
    assert "Infinity" in text
    again = read(text, "a.json")
    kept = {key: value for key, value in again.own.items() if key in found.own}
    assert kept == found.own
    assert text_of(found, text) == text


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ('{"axis0": {', 1, "not JSON"),
        ('{\n"axis0": {"motor": {"config": {\n"pole_pairs": 7.5}}}}', 3, "write a whole number"),
        ('{"axis0": {"motor": {"config": {\n"phase_resistance": "0.05"}}}}', 2, "not a number"),
        ('{"axis0": {"motor": {"config": {\n"phase_resistance": NaN}}}}', 2, "axis0.motor.config"),
        ('{"axis0": {"motor": {"config": {\n"phase_resistance": -1}}}}', 2, "from zero on"),
        ('{"axis0": {"motor": {"config": {\n"R_wL_FF_enable": 1}}}}', 2, "no truth value"),
        ('{"axis0": {"motor": {"config": {\n"motor_type": 2}}}}', 2, "gimbal"),
        ('{"axis0": {"motor": {\n"config": 3}}}', 2, "is no object"),
        ('{"axis2": {}}', 1, "neither axis0 nor axis1"),
        ("[1, 2]", 1, "is no object"),
        ('{"axis0":\n {"can": {}}}', 2, "holds nothing of motor.config"),
        ('{"axis0": {"config":\n {"motor": {"pole_pairs": 7}}}}', 2, "of ODrive 0.6"),
        ('{"serial": 1,\n"axis0.config.motor.pole_pairs": 7}', 2, "of ODrive 0.6"),
        ('{"axis0": {"motor": {"config": {"pole_pairs": 7, "pole_pairs": 8}}}}', 1, "twice"),
    ],
)
def test_bad_files(text: str, line: int | None, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        read(text, "bad.json")
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert refusal.value.line == line


def test_files_are_recognised() -> None:
    assert recognise("backup.json", BACKUP)
    assert recognise("x.json", '{"axis0.config.motor.pole_pairs": 7}')
    assert recognise("hub_odrive.json", "{}")
    assert not recognise("motor.json", '{"polePairs": 7}')
    assert not recognise("hub_odrive.json", "axis0")
