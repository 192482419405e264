"""Configurations of ODrive 0.5, read and written: the JSON of odrivetool, or parts of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, NoReturn

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration, Origin
from dqforge.optimizer.firmware.targets.odrive import (
    GIMBAL,
    HIGH_CURRENT,
    KINDS,
    ODRIVE,
    configuration,
)
from dqforge.reports.firmware.json_text import JsonText, parsed_json, with_json_values
from dqforge.reports.firmware.target import Target

if TYPE_CHECKING:
    from dqforge.reports.firmware.target import FileTitle


# Where ODrive 0.6 (Pro, S1, Micro) keeps its motor; its backups name it in one key each.
ENDING = "_odrive.json"
AXES = ("axis0", "axis1")
_LATER = ("axis0.config.motor", "axis1.config.motor")

_FIELDS = {
    "pole_pairs": "motor.config.pole_pairs",
    "r_s": "motor.config.phase_resistance",
    "l_d": "motor.config.phase_inductance",
    "l_q": "motor.config.phase_inductance",
    "psi_pm": "motor.config.torque_constant",
    "inertia": "controller.config.inertia",
    "i_max": "motor.config.current_lim",
    "omega_m_max": "controller.config.vel_limit",
    "current_d.kp": "motor.config.current_control_bandwidth",
    "current_d.ki": "motor.config.current_control_bandwidth",
    "current_q.kp": "motor.config.current_control_bandwidth",
    "current_q.ki": "motor.config.current_control_bandwidth",
    "speed.kp": "controller.config.vel_gain",
    "speed.ki": "controller.config.vel_integrator_gain",
    "pll.kp": "encoder.config.bandwidth",
    "pll.ki": "encoder.config.bandwidth",
}

_CONVERSIONS = {
    "psi_pm": "torque_constant over 1.5 pole_pairs",
    "inertia": "over 2 pi",
    "omega_m_max": "turns per second times 2 pi",
    "current_d.kp": "times phase_inductance",
    "current_d.ki": "times phase_resistance",
    "current_q.kp": "times phase_inductance",
    "current_q.ki": "times phase_resistance",
    "speed.kp": "over 2 pi and the torque constant",
    "speed.ki": "over 2 pi and the torque constant",
}

# What may be infinite: there is no such limit then.
_WITHOUT_LIMIT = ("controller.config.vel_limit", "controller.config.vel_ramp_rate")


def recognise(name: str, text: str) -> bool:
    """Whether a file is a configuration of an ODrive.

    Args:
        name: Its name.
        text: Its text.
    """
    if not text.lstrip().startswith("{"):
        return False
    return name.lower().endswith(ENDING) or any(f'"{axis}' in text for axis in AXES)


def read(text: str, place: str) -> Configuration:
    """The configuration of an axis.

    Args:
        text: The file's text.
        place: Its path, for messages.

    Raises:
        InputError: It is none, or of another version, or a value does not fit its property; with
            the line.
    """
    tree = parsed_json(text, place, constants=True)
    _refuse_later(tree)
    axis = chosen_axis(tree)
    _refuse_earlier(tree, axis)
    origins = {key: _origin(tree, axis, key) for key in KINDS if _stands(tree, axis, key)}
    values = {key: value for key in origins if (value := _value(tree, axis, key)) is not None}
    if not values:
        raise InputError(
            f"{axis} holds nothing of motor.config, controller.config or encoder.config; save it "
            "again with odrivetool backup-config",
            source=place,
            line=tree.line(axis),
        )
    _refuse_other_motors(tree, axis, values.get("motor.config.motor_type", HIGH_CURRENT))
    found = configuration(_name(place), values)
    others = tuple(
        f"{other} stands in the file as well; {axis} is the one that was read"
        for other in AXES
        if other != axis and isinstance(tree.value(other, "motor"), dict)
    )
    fields = {
        field: replace(origins[key], conversion=_CONVERSIONS.get(field, ""))
        for field, key in _FIELDS.items()
        if key in values
    }
    return replace(
        found,
        origins={key: origins[key] for key in values} | fields,
        conventions=(*found.conventions, *others),
    )


def chosen_axis(tree: JsonText) -> str:
    """The axis that a file is about: axis0, but axis1 where only that has a (calibrated) motor.

    Args:
        tree: The file.
    """
    if not isinstance(tree.root, dict):
        tree.refuse((), "is no object; save it again with odrivetool backup-config")
    present = [axis for axis in AXES if isinstance(tree.value(axis), dict)]
    if not present:
        tree.refuse(
            (), "holds neither axis0 nor axis1; save it again with odrivetool backup-config"
        )
    ready = [axis for axis in present if tree.value(axis, "motor", "config", "phase_resistance")]
    return (ready or present)[0]


def path_of(axis: str, key: str) -> tuple[str, ...]:
    """Keys that lead to a property of an axis."""
    return (axis, *key.split("."))


def _name(place: str) -> str:
    name = PurePath(place).name
    return name[: -len(ENDING)] if name.lower().endswith(ENDING) else PurePath(place).stem


def _stands(tree: JsonText, axis: str, key: str) -> bool:
    path = path_of(axis, key)
    for length in range(1, len(path)):
        inner = tree.value(*path[:length])
        if inner is not None and not isinstance(inner, dict):
            tree.refuse(path[:length], "is no object; save the file again with odrivetool")
    return tree.value(*path) is not None


def _origin(tree: JsonText, axis: str, key: str) -> Origin:
    path = path_of(axis, key)
    return Origin(".".join(path), tree.written(*path), tree.line(*path))


def _value(tree: JsonText, axis: str, key: str) -> float | int | bool | None:
    path, kind = path_of(axis, key), KINDS[key]
    raw = tree.value(*path)
    if kind is bool:
        if not isinstance(raw, bool):
            tree.refuse(path, "is no truth value; write true or false")
        return raw
    if key in _WITHOUT_LIMIT and isinstance(raw, float) and raw == float("inf"):
        return None
    value = tree.whole(*path) if kind is int else tree.number(*path)
    if value is not None and value < 0:
        tree.refuse(path, f"is {value:g}; write a number from zero on")
    return value


def _refuse_later(tree: JsonText) -> None:
    """Refuse backups of ODrive 0.6, whose tree is another and whose loops are not published."""
    if not isinstance(tree.root, dict):
        return
    for axis in AXES:
        if isinstance(tree.value(axis, "config", "motor"), dict):
            _later(tree, (axis, "config", "motor"))
    for key in tree.root:
        if str(key).startswith(_LATER):
            _later(tree, (key,))


def _refuse_earlier(tree: JsonText, axis: str) -> None:
    """Refuse backups of ODrive 0.4 by a key that 0.5 has not: its speeds are in counts."""
    path = path_of(axis, "controller.config.setpoints_in_cpr")
    if tree.value(*path) is not None:
        tree.refuse(
            path,
            "is of ODrive 0.4, whose speeds and gains are in counts of the encoder: this reads "
            "0.5; update the firmware, calibrate, and save it with odrivetool backup-config",
        )


def _later(tree: JsonText, path: tuple[str, ...]) -> NoReturn:
    tree.refuse(
        path,
        "is of ODrive 0.6 (Pro, S1, Micro), whose loops are not published: this reads 0.5; write "
        "its pole_pairs, phase_resistance, phase_inductance and torque_constant into a file of 0.5",
    )


def _refuse_other_motors(tree: JsonText, axis: str, kind: float) -> None:
    if kind == HIGH_CURRENT:
        return
    what = "a gimbal motor runs without current control" if kind == GIMBAL else "no synchronous one"
    tree.refuse(
        path_of(axis, "motor.config.motor_type"),
        f"is {kind:g}: {what}; only 0 (high current) is read",
    )


# Configurations of an ODrive 0.5 written: the JSON that ``odrivetool restore-config`` takes.

_EXISTING = "existing file"


_NEW_AXIS = "axis0"


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_odrive.json`` with the properties that a design decides; odrivetool leaves all
    others of the drive as they are.

    Args:
        found: The configuration; of its own values those that the format holds are written.
        title: Its prefix names the file.
        existing_text: File whose other properties are to stay; None without one.
    """
    values = {key: value for key in KINDS if (value := found.own.get(key)) is not None}
    if existing_text is None:
        tree: dict[str, Any] = {}
        for key, value in values.items():
            _set(tree, path_of(_NEW_AXIS, key), value)
        text = json.dumps(tree, indent=2) + "\n"
    else:
        axis = chosen_axis(parsed_json(existing_text, _EXISTING, constants=True))
        placed = {path_of(axis, key): value for key, value in values.items()}
        text = with_json_values(existing_text, _EXISTING, placed, constants=True)
    return {f"{title.prefix}{ENDING}": text.encode("utf-8")}


def _set(tree: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    for key in path[:-1]:
        tree = tree.setdefault(key, {})
    tree[path[-1]] = value


# ODrive 0.5 among the firmware whose files are written and read.

TARGET = Target(ODRIVE, "ODrive (v3.x boards, firmware 0.5)", write, recognise, read)
