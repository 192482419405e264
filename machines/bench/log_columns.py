"""Columns of a run: which column of a log is which quantity, in which unit, converted to SI."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.bench.bench_file import RunKindName
from dqforge.machines.bench.log_files import LogTable
from dqforge.machines.errors import InputError, close_matches, shown
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import parse_quantity
from dqforge.machines.units.registry import DIMENSIONS

# Quantities of logs and their dimensions.
QUANTITIES: Mapping[str, str] = {
    "time": "time",
    "i_d": "current",
    "i_q": "current",
    "current": "current",
    "u_d": "voltage",
    "u_q": "voltage",
    "u_q_less_drop": "voltage",
    "voltage": "voltage",
    "line_voltage": "voltage",
    "v_dc": "voltage",
    "speed": "speed",
    "electrical_speed": "speed",
    "torque": "torque",
    "temperature": "temperature",
    "encoder_offset": "angle",
    "psi_d": "flux",
    "psi_q": "flux",
    "duty": "number",
}
# Words before or after a unit of speed that say that it counts electrical revolutions.
_ELECTRICAL = ("electrical ", " electrical", "el. ")
_ERPM = "erpm"
# Units that logs write and handbooks do not.
_SPELLINGS = {"turns/s": "rev/s", "turn/s": "rev/s", "turns": "rev", "turn": "rev", "Nm": "N m"}


@dataclass(frozen=True, slots=True)
class RunKind:
    """What a kind of run needs.

    Args:
        about: What was done, for messages.
        needs: Quantities; of a tuple one is enough.
        may: Further ones that are used.
        currents: Whether its currents must be those that flowed.
    """

    about: str
    needs: tuple[tuple[str, ...], ...]
    may: tuple[str, ...] = ()
    currents: bool = True

    @property
    def quantities(self) -> tuple[str, ...]:
        """All that it takes."""
        return (*(name for group in self.needs for name in group), *self.may)


KINDS: Mapping[RunKindName, RunKind] = {
    "constant-speed": RunKind(
        "points or rows with currents, voltages and speed",
        (("i_q",), ("u_q",), ("speed",)),
        ("i_d", "u_d", "time", "temperature", "v_dc", "duty", "torque", "electrical_speed"),
    ),
    "flux-points": RunKind(
        "a grid of currents at constant speed, for a flux map",
        (("i_d",), ("i_q",), ("u_d",), ("u_q",), ("speed",)),
        ("temperature", "v_dc", "duty", "torque", "electrical_speed"),
    ),
    "speed-sweep": RunKind(
        "levels of current, each at several speeds",
        (("i_d",), ("u_q", "u_q_less_drop"), ("speed",)),
        ("i_q", "u_d", "temperature"),
    ),
    "offset-sweep": RunKind(
        "encoder offset swept, shaft driven, no current",
        (("encoder_offset",), ("u_d", "u_q"), ("speed",)),
        ("psi_d", "psi_q"),
        currents=False,
    ),
    "voltage-speed": RunKind(
        "steps of a direct voltage, speed free", (("time",), ("voltage",), ("speed",)), ("v_dc",),
        currents=False,
    ),
    "locked-torque": RunKind(
        "torque bursts of a locked shaft", (("time",), ("current", "i_q"), ("torque",)),
        ("temperature",),
    ),
    "locked-voltage": RunKind(
        "steps, pulses or sines of a voltage on a locked shaft",
        (("time",), ("i_d", "i_q"), ("u_d", "u_q")), ("temperature",),
    ),
    "spin-up": RunKind(
        "shaft accelerated by a current, without load", (("time",), ("i_q",), ("speed",))
    ),
    "spin-down": RunKind("coasting without current", (("time",), ("speed",)), currents=False),
    "back-emf": RunKind(
        "capture of the open terminals while the shaft is driven",
        (("time",), ("line_voltage",)), ("speed",), currents=False,
    ),
    "inverter-table": RunKind(
        "voltage error of the inverter over current", (("current",), ("voltage",)), ("v_dc",)
    ),
}  # fmt: skip


class ColumnFault(Exception):  # noqa: N818 - it becomes an error once its place is known
    """What is wrong with the columns of a run, and the keys under them that lead to it."""

    def __init__(self, message: str, path: tuple[str, ...] = ()) -> None:
        self.message = message
        self.path = path
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Wanted:
    """A column as the bench file asks for it."""

    quantity: str
    column: str
    unit: str
    scale: float


def wanted(
    columns: Mapping[str, Any], kind: RunKindName, preset: Mapping[str, tuple[str, str]]
) -> tuple[list[Wanted], dict[str, Any]]:
    """Columns that a run asks for, of its file or of what the format knows, and quantities that
    stood still, as they are written.

    Raises:
        ColumnFault: A quantity is unknown, or an entry is not what it should be.
    """
    found, still = {}, {}
    taken = KINDS[kind].quantities
    for quantity, (column, unit) in preset.items():
        if quantity in taken:
            found[quantity] = Wanted(quantity, column, unit, 1.0)
    for quantity, raw in columns.items():
        if quantity not in QUANTITIES:
            close = close_matches(quantity, QUANTITIES)
            hint = f"did you mean {close[0]}?" if close else f"write one of {', '.join(taken)}"
            raise ColumnFault(f"no quantity is called {shown(quantity)}; {hint}", (quantity,))
        if quantity not in taken:
            raise ColumnFault(
                f"a run of kind {kind} takes no {quantity}; it takes {', '.join(taken)}",
                (quantity,),
            )
        entry = {"column": raw} if isinstance(raw, str) else raw
        if not isinstance(entry, dict):
            raise ColumnFault(
                f"expected the name of a column, or a mapping, got {shown(raw)}; write e.g. "
                "{column: name, unit: A}",
                (quantity,),
            )
        for key in entry:
            if key not in ("column", "unit", "scale", "value"):
                raise ColumnFault(
                    f"unknown key {shown(key)}; a column has column, unit, scale or value",
                    (quantity,),
                )
        if "value" in entry:
            still[quantity] = entry["value"]
            found.pop(quantity, None)
            continue
        found[quantity] = _entry(quantity, entry)
    return list(found.values()), still


def _entry(quantity: str, entry: Mapping[str, Any]) -> Wanted:
    name, unit, scale = entry.get("column"), entry.get("unit", ""), entry.get("scale", 1.0)
    if not isinstance(name, str) or not isinstance(unit, str):
        raise ColumnFault(
            "a column needs its name; write e.g. {column: name, unit: A}", (quantity,)
        )
    if isinstance(scale, bool) or not isinstance(scale, (int, float)) or not scale:
        raise ColumnFault(f"scale: expected a number, got {shown(scale)}", (quantity, "scale"))
    return Wanted(quantity, name, unit, float(scale))


def value_of(quantity: str, raw: object, pole_pairs: int) -> float:
    """A quantity that stood still, in SI units; an electrical speed becomes that of the shaft."""
    if isinstance(raw, bool) or not isinstance(raw, (int, float, str)):
        raise ColumnFault(f"expected a quantity, got {shown(raw)}", (quantity, "value"))
    text = str(raw)
    try:
        text, factor = _mechanical(text, quantity, pole_pairs)
        return factor * parse_quantity(text, QUANTITIES[quantity])
    except InputError as error:
        raise ColumnFault(error.message, (quantity, "value")) from None


def in_si(table: LogTable, asked: Wanted, pole_pairs: int) -> FloatArray | None:
    """A column in SI units, shape (rows,); None where the log has none of this name.

    Raises:
        ColumnFault: Neither file nor bench file give a unit, or it is one of another dimension.
    """
    place = _place(table, asked.column)
    if place is None:
        return None
    path = (asked.quantity,)
    unit = asked.unit or table.units[place]
    dimension = QUANTITIES[asked.quantity]
    if not unit and dimension != "number":
        raise ColumnFault(
            f"the column {shown(asked.column)} has no unit in {table.source}; write "
            f"{{column: {asked.column}, unit: {DIMENSIONS[dimension].unit}}}",
            path,
        )
    try:
        offset, factor = _conversion(unit, asked.quantity, pole_pairs)
    except InputError as error:
        raise ColumnFault(f"unit of {shown(asked.column)}: {error.message}", path) from None
    return offset + factor * asked.scale * table.values[:, place]


def not_found(tables: Sequence[LogTable], asked: Wanted) -> ColumnFault:
    """What is said of a column that no log of the run has."""
    names = [name for table in tables for name in (*table.names, *table.others)]
    close = close_matches(asked.column, names)
    hint = f"did you mean {shown(close[0])}?" if close else f"it has {', '.join(_listed(names))}"
    sources = " or ".join(table.source for table in tables)
    return ColumnFault(f"no column {shown(asked.column)} in {sources}; {hint}", (asked.quantity,))


_MOST_LISTED = 12


def _listed(names: Sequence[str]) -> Iterator[str]:
    yield from names[:_MOST_LISTED]
    if len(names) > _MOST_LISTED:
        yield f"and {len(names) - _MOST_LISTED} more"


def _place(table: LogTable, name: str) -> int | None:
    if name in table.names:
        return table.names.index(name)
    labels = [f"{one} [{unit}]" for one, unit in zip(table.names, table.units, strict=True)]
    return labels.index(name) if name in labels else None


def _conversion(unit: str, quantity: str, pole_pairs: int) -> tuple[float, float]:
    """Value of 0 in SI units, and the step from 0 to 1 (temperatures have another zero)."""
    if not unit:
        return 0.0, 1.0
    unit, factor = _mechanical(unit, quantity, pole_pairs)
    dimension = QUANTITIES[quantity]
    unit = _SPELLINGS.get(unit, unit)
    zero, one = (parse_quantity(f"{number} {unit}", dimension) for number in (0, 1))
    return factor * zero, factor * (one - zero)


def _mechanical(text: str, quantity: str, pole_pairs: int) -> tuple[str, float]:
    """A unit of speed without what says that it is electrical, and the factor that follows."""
    if quantity not in ("speed", "electrical_speed"):
        return text, 1.0
    factor = 1.0 / pole_pairs if quantity == "speed" else 1.0
    if _ERPM in text:
        return text.replace(_ERPM, "rpm"), factor
    for words in _ELECTRICAL:
        if words in text:
            return text.replace(words, "").strip(), factor
    return text, 1.0


# What is looked for in the columns themselves.

# Words of columns that hold what was asked for and not what flowed.
_REQUESTED = ("req", "ref", "cmd", "command", "demand", "target", "setpoint", "soll")


def looks_requested(asked: Wanted) -> bool:
    """Whether the name of a current column says that it was requested."""
    current = QUANTITIES[asked.quantity] == "current"
    return current and any(word in asked.column.casefold() for word in _REQUESTED)


def dead(values: FloatArray) -> bool:
    """Whether a channel holds one and the same number in every row."""
    finite = values[np.isfinite(values)]
    return finite.size > 1 and bool(np.ptp(finite) == 0.0)
