"""The configuration of another firmware as a side of a comparison: machine, limits, and gains with
the margins that its own loops have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import JudgedLoop
from dqforge.optimizer.firmware.solve import Explained, explain
from dqforge.reports.comparison.sources import Side
from dqforge.reports.firmware.target import MOST_BYTES, decoded_file
from dqforge.reports.firmware_files.plain import plain_drive_values, plain_loop, plain_pi
from dqforge.reports.firmware_files.recognised import read_file, recognised
from dqforge.reports.output.manifest import sha256
from dqforge.reports.plain_data import PlainData

_DESIGNS = (".yaml", ".yml")


def firmware_side(name: str) -> Side | None:
    """The side of a file of another firmware, None where it is none.

    Args:
        name: What the user named.

    Raises:
        InputError: It is such a file, and not what the firmware writes.
    """
    path = Path(name)
    if not path.is_file() or path.suffix.lower() in _DESIGNS:
        return None
    try:
        content = read_regular_file(path, MOST_BYTES)
        file = decoded_file(content, name)
    except InputError:
        return None  # what else it may be is refused in its own words
    target = recognised(file)
    if target is None:
        return None
    found = explain(read_file(target, file))
    return Side(name, _plain(found, target.title, sha256(content)), None, foreign=True)


def _plain(found: Explained, title: str, digest: str) -> PlainData:
    """What `quantity_rows` asks for, in the keys of ``result.json``."""
    configuration = found.configuration
    return {
        "design": f"{configuration.name} ({title})",
        "input": {"digest": digest},
        "drive": plain_drive_values(found.drive),
        "gains": {
            "i_d": _loop(configuration.current_d, found.judged.current_d),
            "i_q": _loop(configuration.current_q, found.judged.current_q),
            "speed": _loop(_per_torque(configuration), found.judged.speed),
        },
    }


def _loop(gains: PiGains | None, judged: JudgedLoop | None) -> PlainData | None:
    if gains is None:
        return None
    margins: Mapping[str, object] = plain_loop(judged) or {}
    finite = {
        key: value
        for key, value in margins.items()
        if not isinstance(value, float) or math.isfinite(value)
    }
    return {"method": "given", **(plain_pi(gains) or {}), **finite}


def _per_torque(configuration: Configuration) -> PiGains | None:
    """Gains of the speed controller in N m s/rad and N m/rad."""
    speed, drive = configuration.speed, configuration.drive
    if speed is None or drive.pole_pairs is None or not drive.psi_pm:
        return None
    constant = 1.5 * drive.pole_pairs * drive.psi_pm
    return PiGains(speed.kp * constant, speed.ki * constant)
