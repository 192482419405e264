"""Measured losses or efficiencies over torque and speed, in a text table of any layout."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_table import TextTable, read_table
from dqforge.machines.losses.machine_budget import column_in_si, kind_of_title
from dqforge.machines.records import dataclass

Whose = Literal["machine", "drive"]

# Titles, in lower case with blanks, of what is measured and of whom; alone they do not say whose.
_MEASURED = ("efficiency", "eta", "loss", "losses", "wirkungsgrad", "verlust", "verluste")
_WHOSE: dict[str, Whose] = {
    "machine": "machine", "motor": "machine", "maschine": "machine",
    "drive": "drive", "system": "drive", "antrieb": "drive",
}  # fmt: skip
_POWER: dict[str, Whose] = {
    "p_el": "machine", "p_elec": "machine", "electrical power": "machine",
    "p_dc": "drive", "dc power": "drive", "p_in": "drive", "input power": "drive",
}  # fmt: skip
_MOST_ROWS = 20_000
_SAY = (
    "head it 'machine efficiency', 'drive efficiency', 'machine loss [W]', 'drive loss [W]', "
    "'electrical power [W]' (into the machine) or 'dc power [W]'"
)


@dataclass(frozen=True, slots=True)
class MeasuredLosses:
    """Losses of the machine, or of inverter and machine, at N points.

    Args:
        source: Name of the file.
        whose: What the losses are of.
        torque, omega_m: At the shaft, in N m and rad/s, shape (N,).
        loss: In W, shape (N,); of efficiencies and powers what they say of it.
        lines: Line of each point in the file, shape (N,).
        findings: Sentences on units that were taken.
    """

    source: str
    whose: Whose
    torque: FloatArray
    omega_m: FloatArray
    loss: FloatArray
    lines: NDArray[np.intp]
    findings: tuple[str, ...]


def read_measured(content: bytes, source: str) -> MeasuredLosses:
    """Measured losses of a text table whose titles name torque, speed and whose loss, efficiency or
    power.

    An efficiency is shaft power over electrical power where torque drives, and the reverse where it
    brakes.

    Args:
        content: Bytes of the file.
        source: Its name, for messages.

    Raises:
        InputError: With file and line: no table, a missing column, one that does not say whose it
            is, a cell without a number, an efficiency that is none, or too many rows.
    """
    table = read_table(content, source)
    if table.lines.size > _MOST_ROWS:
        raise InputError(
            f"{table.lines.size} rows, at most {_MOST_ROWS} are read; take fewer", source=source
        )
    found: dict[str, int] = {}
    whose: Whose | None = None
    for column, title in enumerate(table.names):
        word = " ".join(title.replace("_", " ").split()).lower()
        of = _whose(word) or _POWER.get(title.strip().lower())
        if of is not None and "measured" not in found:
            found["measured"], whose = column, of
        elif (kind := kind_of_title(title)) in ("torque", "speed"):
            found[kind] = column
    head = max(int(table.lines[0]) - 1, 1)
    for kind, unit in (("torque", "N m"), ("speed", "rpm")):
        if kind not in found:
            raise InputError(
                f"no column for the {kind}; head one '{kind} [{unit}]'",
                source=source,
                line=head,
            )
    if whose is None:
        bare = next((name for name in table.names if name.lower().strip() in _MEASURED), None)
        what = f"'{bare}' does not say whose it is" if bare else "no column of what was measured"
        raise InputError(f"{what}; {_SAY}", source=source, line=head)
    findings: list[str] = []
    torque, omega_m = (
        column_in_si(table, kind, found[kind], findings) for kind in ("torque", "speed")
    )
    loss = _loss(table, found["measured"], torque * omega_m)
    return MeasuredLosses(source, whose, torque, omega_m, loss, table.lines, tuple(findings))


def _whose(word: str) -> Whose | None:
    parts = word.split()
    if len(parts) == 2 and any(part in _MEASURED for part in parts):
        return next((_WHOSE[part] for part in parts if part in _WHOSE), None)
    return None


def _loss(table: TextTable, column: int, shaft: FloatArray) -> FloatArray:
    """What a column says of the loss in W."""
    title, unit, values = table.names[column].lower(), table.units[column], table.values[:, column]
    (holes,) = np.nonzero(~np.isfinite(values))
    if holes.size:
        raise InputError(
            f"no number in column '{table.names[column]}'; write one, or remove the line",
            source=table.source,
            line=int(table.lines[holes[0]]),
        )
    if any(name in title for name in ("efficiency", "eta", "wirkungsgrad")):
        share = values / (100.0 if unit == "%" or float(np.max(values)) > 1.5 else 1.0)
        (wrong,) = np.nonzero((share <= 0.0) | (share > 1.0))
        if wrong.size:
            raise InputError(
                f"an efficiency of {100.0 * share[wrong[0]]:.4g} %; write more than 0 and at most "
                "100 %, and leave out points without power",
                source=table.source,
                line=int(table.lines[wrong[0]]),
            )
        return np.where(shaft >= 0.0, shaft * (1.0 / share - 1.0), -shaft * (1.0 - share))
    watts = column_in_si(table, "power", column, [])
    is_loss = any(name in title for name in ("loss", "verlust"))
    return watts if is_loss else np.asarray(watts - shaft)
