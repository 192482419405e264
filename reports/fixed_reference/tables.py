"""Current references in fixed point on the terminal and in the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.fixed_reference.text import percent
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import symbols
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit

_TITLE = "Current references in fixed point"


_COLUMNS = (
    "format",
    "cells",
    "bytes",
    "up to N m",
    "torque error",
    "voltage excess",
    "current excess",
    "currents off by A",
    "loss above the least",
    "fullest word",
)


def _cells(fit: FixedReferenceFit) -> tuple[str, ...]:
    mesh, errors = fit.reference, fit.errors
    voltage = "-" if errors.voltage_excess is None else percent(errors.voltage_excess)
    return (
        mesh.format,
        f"{mesh.rows}" if mesh.voltage is None else f"{mesh.rows} x {mesh.columns - 1}",
        f"{mesh.table_bytes}",
        f"{mesh.end_torque:.6g}",
        percent(errors.torque_relative),
        voltage,
        percent(errors.current_excess),
        rounded_up(errors.current),
        percent(errors.loss_relative),
        f"{fit.fullest.share:.3%}",
    )


def reference_tables(fits: Sequence[FixedReferenceFit]) -> list[Table]:
    """One row per fixed-point format, for the terminal."""
    note = (
        "errors against exact operating points, sampled; where the field is weakened motoring and "
        "generating at 0.8 to 1.1 of the voltage"
    )
    return [Table(_TITLE, _COLUMNS, tuple(_cells(fit) for fit in fits), (note,))]


def reference_html(fits: Sequence[FixedReferenceFit]) -> list[HtmlTable]:
    """The same for the report."""
    rows = tuple(Row(_cells(fit), "") for fit in fits)
    return [HtmlTable(_TITLE, tuple(symbols(text) for text in _COLUMNS), rows)]
