"""Names, values and units of columns as people read them."""

from __future__ import annotations

import math

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, OUTPUT_COLUMN, ColumnSpec

_FOR_PEOPLE = {"rad": "deg"}
_SHARES = ("torque_error", "loss_penalty", "torque_relative", "loss_relative")


def label(name: str) -> str:
    """A column without what says that it is an input or output.

    Args:
        name: Whole name of a column.
    """
    return name.removeprefix(INPUT_COLUMN).removeprefix(OUTPUT_COLUMN)


def people_unit(spec: ColumnSpec) -> str:
    """Unit of a column in tables and pictures: degrees for angles, percent for shares.

    Args:
        spec: The column.
    """
    if not spec.unit and spec.name.rpartition(".")[2] in _SHARES:
        return "%"
    return _FOR_PEOPLE.get(spec.unit, spec.unit)


def value_text(spec: ColumnSpec, value: float, digits: int = 5) -> str:
    """A value of a column with its unit; nothing where there is none.

    Args:
        spec: The column.
        value: A number in SI units, or the place of a word.
        digits: Significant digits.
    """
    if spec.kind == "choice":
        return spec.choices[int(value)] if value >= 0 else ""
    if not math.isfinite(value):
        return ""
    return format_quantity(float(value), people_unit(spec), digits)
