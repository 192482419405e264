"""ST's MCSDK among the firmware whose files are written and read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.optimizer.firmware.firmware_method import number
from dqforge.optimizer.firmware.st_keys import (
    COUNTED,
    DRIVE,
    LOGARITHMS,
    MOTOR,
    MOTOR_FILE,
    OTHERWISE,
    SPEED_GAINS,
    STAGE,
    TABLE,
)
from dqforge.optimizer.firmware.st_scales import FULL, current_scale, printed
from dqforge.optimizer.firmware.targets.st import ST
from dqforge.reports.firmware.c_macros import Macros, with_values
from dqforge.reports.firmware.json_text import with_json_values
from dqforge.reports.firmware.st.reader import (
    MILLIHENRIES,
    is_project,
    parameter_macros,
    read,
    read_several,
    recognise,
    with_variables,
)
from dqforge.reports.firmware.target import Target
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, OwnValue
    from dqforge.reports.firmware.target import FileTitle


# Files of ST's MCSDK written: a header of its macros, the motor file, values in other files.

_EXISTING = "existing file"


_GROUPS = (
    ("machine (pmsm_motor_parameters.h)", MOTOR),
    ("power stage (power_stage_parameters.h, parameters_conversion.h)", STAGE),
    ("drive (drive_parameters.h)", DRIVE),
    ("currents of least loss (drive_parameters.h)", TABLE),
)


def write(found: Configuration, title: FileTitle, existing_text: str | None) -> dict[str, bytes]:
    """``<prefix>_st_parameters.h`` and ``<prefix>_st_motor.json``.

    Args:
        found: The configuration.
        title: What stands at the head of the header.
        existing_text: A header of a project, a motor file, or a project of Workbench 5 (then a
            further file, ``<prefix>_st.stmcx``) whose other values and comments stay; None without
            one. Only macros and variables that it has are changed.
    """
    files = {
        f"{title.prefix}_st_parameters.h": _header(found, title),
        f"{title.prefix}_st_motor.json": _motor_file(found, title),
    }
    if existing_text is None:
        pass
    elif is_project(existing_text):
        files[f"{title.prefix}_st.stmcx"] = with_variables(existing_text, found.own)
    elif existing_text.lstrip().startswith("{"):
        values = _motor_values(found)
        merged = with_json_values(existing_text, _EXISTING, _kept(existing_text, values, found))
        files[f"{title.prefix}_st_motor.json"] = merged
    else:
        files[f"{title.prefix}_st_parameters.h"] = _with_macros(existing_text, found.own)
    return {name: text.encode("utf-8") for name, text in files.items()}


def _header(found: Configuration, title: FileTitle) -> str:
    groups = []
    for name, keys in _GROUPS:
        lines = [
            (macro, _macro(macro, found.own[macro]), _says(macro, says, found.own))
            for macro, says in keys.items()
            if macro in found.own
        ]
        if lines:
            groups.append((name, _with_logarithms(lines)))
    context = {
        "title": title,
        "guard": f"{title.prefix.upper()}_ST_PARAMETERS_H",
        "groups": groups,
        "table": "SEGDIV" in found.own,
        "version": found.version,
    }
    return render("firmware/st/parameters.h.j2", context)


def _macro(name: str, value: OwnValue) -> str:
    """A value as it stands behind its macro."""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    if name in SPEED_GAINS:
        return f"{text}/(SPEED_UNIT/10)"
    return f"({text})" if text.startswith("-") else text


def _says(name: str, says: str, own: Mapping[str, OwnValue]) -> str:
    """The comment of a macro, with the counts of currents."""
    value, full = number(own, name), current_scale(own)
    if name in COUNTED and value is not None and full is not None:
        return f"{says}; {COUNTED[name]} {round(value * FULL / full)} in counts"
    return says


def _with_logarithms(lines: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    found = []
    for name, text, says in lines:
        found.append((name, text, says))
        if name in LOGARITHMS:
            found.append((f"{name}_LOG", f"LOG2(({text}))", ""))
    return found


def _with_macros(text: str, own: Mapping[str, OwnValue]) -> str:
    """The header with the values behind the macros that it has, in the unit that it has them in."""
    macros = parameter_macros(text, _EXISTING)
    full = current_scale(own)
    values: dict[str, str] = {}
    for name in (*MOTOR, *STAGE, *DRIVE, *TABLE):
        value = own.get(name)
        if value is None:
            continue
        _put(values, macros, name, value)
        counted = COUNTED.get(name)
        if counted is not None and counted in macros and full is not None:
            values[counted] = str(round((number(own, name) or 0.0) * FULL / full))
    return with_values(text, macros, values)


def _put(values: dict[str, str], macros: Macros, name: str, value: OwnValue) -> None:
    for spelled in (name, OTHERWISE.get(name, "")):
        if spelled and spelled in macros:
            values[spelled] = _macro(name, value)
            if name in LOGARITHMS and f"{name}_LOG" in macros:
                values[f"{name}_LOG"] = f"LOG2(({_macro(name, value)}))"


def _motor_values(found: Configuration) -> dict[tuple[str, ...], object]:
    """Values of the motor file by their paths; the inductance in mH."""
    values: dict[tuple[str, ...], object] = {}
    for key, macro in MOTOR_FILE.items():
        value = number(found.own, macro)
        if value is not None:
            scaled = printed(1e3 * value) if key == "ls" else value
            values[(key,)] = int(scaled) if float(scaled).is_integer() else scaled
    ratio = number(found.own, "ld_lq_ratio")
    values[("magneticStructure", "type")] = "SM-PMSM" if ratio is None else "I-PMSM"
    if ratio is not None:
        values[("magneticStructure", "ld_lq_ratio")] = ratio
    return values


def _kept(
    text: str, values: dict[tuple[str, ...], object], found: Configuration
) -> dict[tuple[str, ...], object]:
    """The values for an existing motor file: its inductance stays in the unit that it is in."""
    from dqforge.reports.firmware.st.reader import read

    was, inductance = read(text, _EXISTING), number(found.own, "LS")
    henries = any("in H," in words for words in was.conventions)
    if henries and inductance is not None:
        values[("ls",)] = inductance
    return values


def _motor_file(found: Configuration, title: FileTitle) -> str:
    content: dict[str, object] = {
        "id": title.prefix,
        "label": title.name,
        "description": f"made by dqforge {title.version}; {MILLIHENRIES}",
        "hardwareFamily": "MOTOR",
    }
    for path, value in _motor_values(found).items():
        if len(path) == 1:
            content[path[0]] = value
        else:
            inner = content.setdefault(path[0], {})
            assert isinstance(inner, dict)
            inner[path[1]] = value
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


# ST's MCSDK among the firmware whose files are written and read.

TARGET = Target(
    ST,
    "ST MCSDK (headers of 5.4 to 6.4, motor file of Workbench 6, project of Workbench 5)",
    write,
    recognise,
    read,
    read_several,
)
