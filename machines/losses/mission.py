"""Mission profiles: torque and speed over time from a text table, with
faults named by file and line.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.number_table import read_table
from dqforge.machines.files.text_table import TextTable
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import Reading, read_quantity

# What files call the columns; single letters count with their case, T is a torque and t a time.
_NAMES: dict[str, tuple[str, ...]] = {
    "time": ("t", "time", "zeit", "seconds"),
    "speed": (
        "n",
        "speed",
        "rpm",
        "omega",
        "omega_m",
        "w",
        "w_m",
        "drehzahl",
        "n_m",
        "rotational speed",
    ),
    "torque": (
        "T",
        "M",
        "torque",
        "drehmoment",
        "moment",
        "t_e",
        "t_m",
        "t_ref",
        "m_ref",
        "tq",
        "trq",
    ),
}

_SI = {"time": "s", "speed": "rad/s", "torque": "N m"}

# Revolutions per minute as drives people write them, beyond the vocabulary of units.
_PER_MINUTE = re.compile(
    r"(?:1|u|r|rev|umdr\.?)\s*/\s*min|min\s*(?:\^|\*\*)?\s*[-\N{MINUS SIGN}]\s*1|min⁻¹",
    re.IGNORECASE,
)

_MOST_ROWS = 200_000
MOST_BYTES = 50_000_000  # Bytes of the largest file of a mission.


@dataclass(frozen=True, slots=True)
class Mission:
    """Torque and speed over time; what stands in a row holds until the time of the next.

    Args:
        time: Instants in s, shape (N + 1,), strictly ascending.
        torque, omega_m: In N m and rad/s (mechanical) from each instant to the next, shape (N,).
        lines: Line of the file of each interval, shape (N,).
        source: Name of the file.
        findings: Sentences on what was assumed.
    """

    time: FloatArray
    torque: FloatArray
    omega_m: FloatArray
    lines: NDArray[np.intp]
    source: str
    findings: tuple[str, ...] = ()

    @property
    def length(self) -> FloatArray:
        """Lengths of the intervals in s, shape (N,)."""
        return np.diff(self.time)


def _kind_of(name: str) -> str | None:
    """Which quantity a title names."""
    word = " ".join(name.split())
    for kind, names in _NAMES.items():
        if word in names or (len(word) > 1 and word.lower() in names):
            return kind
    if word in ("N", "m"):
        return "speed" if word == "N" else "torque"
    return None


def _columns(table: TextTable) -> dict[str, int]:
    """Column of each quantity: by its title, else by its unit, else the first three in order."""
    found: dict[str, int] = {}
    for column, (name, unit) in enumerate(zip(table.names, table.units, strict=True)):
        kind = _kind_of(name) or _kind_of_unit(unit)
        if kind is None:
            continue
        if kind in found:
            first = table.names[found[kind]]
            message = (
                f"columns '{first}' and '{name}' both look like the {kind}; leave one of them out"
            )
            raise InputError(message, source=table.source, line=_head_line(table))
        found[kind] = column
    untitled = all(name.startswith("column ") for name in table.names)
    if not found and untitled and len(table.names) == 3:
        return {"time": 0, "speed": 1, "torque": 2}
    missing = [kind for kind in _NAMES if kind not in found]
    if missing:
        titles = ", ".join(f"'{name}'" for name in table.names)
        message = f"no column for the {' and the '.join(missing)} among {titles}"
        raise InputError(
            f"{message}; write a head row such as: time [s]; speed [rpm]; torque [N m]",
            source=table.source,
            line=_head_line(table),
        )
    return found


def _kind_of_unit(unit: str) -> str | None:
    for kind in _SI:
        if unit and _factor(kind, unit) is not None:
            return kind
    return None


def _head_line(table: TextTable) -> int:
    return max(int(table.lines[0]) - 1, 1)


def _unit(kind: str, unit: str) -> Reading:
    """One of a unit as a quantity; raises where it is none of this kind."""
    return read_quantity(
        "1 rpm" if kind == "speed" and _PER_MINUTE.fullmatch(unit.strip()) else f"1 {unit}", kind
    )


def _factor(kind: str, unit: str) -> float | None:
    """SI value of one of a unit, None where it is none of this quantity."""
    try:
        return _unit(kind, unit).si
    except InputError:
        return None


def _column(table: TextTable, kind: str, column: int, findings: list[str]) -> FloatArray:
    """Values of a column in SI units; the first cell without a number is an error."""
    values, unit = table.values[:, column], table.units[column]
    (holes,) = np.nonzero(~np.isfinite(values))
    if holes.size:
        message = (
            f"no number for the {kind} in column '{table.names[column]}'; write one, or remove the "
            "line"
        )
        raise InputError(message, source=table.source, line=int(table.lines[holes[0]]))
    if not unit:
        if table.names[column].lower() == "rpm":
            unit = "rpm"
        else:
            findings.append(f"{kind} without a unit, taken as {_SI[kind]}")
            return values
    factor = _factor(kind, unit)
    if factor is None:
        message = (
            f"unit '{unit}' of column '{table.names[column]}' is none of a {kind}; write "
            f"{_SI[kind]}"
        )
        message += " or rpm" if kind == "speed" else ""
        raise InputError(message, source=table.source, line=_head_line(table))
    remark = _unit(kind, unit).remark
    findings.extend([f"{kind}: {remark}"] if remark else [])
    return values * factor


def read_mission(content: bytes, source: str, *, omega_max: float | None = None) -> Mission:
    """Read a mission profile: time, speed and torque in a text table of any
    delimiter and decimal sign.

    Titles name the columns (time, speed, torque, t, n, M, ...), and units beside them are honoured;
    without units the numbers are SI. Without titles the columns are time, speed and torque. The
    last row ends the mission.

    Args:
        content: Bytes of the file.
        source: Name of the file, for messages.
        omega_max: Largest permitted mechanical speed in rad/s, or None.

    Raises:
        InputError: With file and line: no table, a missing or doubled column, a foreign unit, a
            cell without a number, times that do not ascend, a speed above the largest, or too many
            rows.
    """
    table = read_table(content, source)
    if table.lines.size > _MOST_ROWS:
        message = (
            f"the mission has {table.lines.size} rows, at most {_MOST_ROWS} are read; resample it"
        )
        raise InputError(message, source=source)
    columns, findings = _columns(table), list[str]()
    time, omega_m, torque = (
        _column(table, kind, columns[kind], findings) for kind in ("time", "speed", "torque")
    )
    (stuck,) = np.nonzero(np.diff(time) <= 0.0)
    if stuck.size:
        k = int(stuck[0])
        message = (
            f"time {time[k + 1]:.6g} s does not lie after the {time[k]:.6g} s of the row before"
        )
        raise InputError(
            f"{message}; sort the rows, and keep each time once",
            source=source,
            line=int(table.lines[k + 1]),
        )
    if omega_max is not None:
        (fast,) = np.nonzero(np.abs(omega_m) > omega_max * (1.0 + 1e-9))
        if fast.size:
            k, rpm = int(fast[0]), 9.549296585513721
            message = (
                f"speed {omega_m[k] * rpm:.5g} rpm is above machine.max_speed "
                f"{omega_max * rpm:.5g} rpm"
            )
            bare = not table.units[columns["speed"]] and abs(omega_m[k]) > 3.0 * omega_max
            hint = (
                "the column has no unit and is taken as rad/s, write speed [rpm]"
                if bare
                else "correct one of them"
            )
            raise InputError(f"{message}; {hint}", source=source, line=int(table.lines[k]))
    return Mission(time, torque[:-1], omega_m[:-1], table.lines[:-1], source, tuple(findings))
