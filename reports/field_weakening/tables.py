"""Two-dimensional references on the terminal and in the report."""

from __future__ import annotations

from dqforge.optimizer.field_weakening.fit import SurfaceTrial, WeakeningFit
from dqforge.reports.field_weakening.text import (
    domain_text,
    errors_text,
    least_voltage_text,
    nominal_text,
    percent,
    proof_text,
)
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import (
    count,
    symbols,
)
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData

_COLUMNS = (
    "degree in torque",
    "in excess flux linkage",
    "constants",
    "code and constants",
    "error over budget",
    "torque error",
    "voltage excess",
    "current excess",
    "extra loss",
)


def _cells(trial: SurfaceTrial) -> tuple[str, ...]:
    errors = trial.errors
    shown: tuple[str, ...] = ("",) * 4
    if errors is not None and trial.voltage is not None:
        voltage = trial.voltage
        values = (
            errors.torque_relative,
            voltage.voltage_excess,
            errors.current_excess,
            voltage.loss_relative,
        )
        shown = tuple(percent(value) for value in values)
    size = (
        f"{trial.degrees[0]}",
        f"{trial.degrees[1]}",
        f"{trial.coefficients}",
        f"{trial.flash} B",
    )
    return (*size, f"{trial.grid_error:.2f}", *shown)


def weakening_tables(fit: WeakeningFit | None) -> list[Table]:
    """What was tried, in order of size, for the terminal.

    Nothing where no such reference is asked for.
    """
    if fit is None:
        return []
    note = (
        "error over budget on the grid of the fit; measured in float32 where that is below 0.95; "
        "the last is emitted"
    )
    rows = tuple(_cells(trial) for trial in fit.trials)
    proven = proof_text(fit)
    bounds = "no bounds are proven" if proven is None else f"proven bounds: {proven}"
    largest = f"largest errors: {errors_text(fit)}"
    notes = (domain_text(fit), largest, nominal_text(fit), bounds, note)
    return [Table("Field weakening: surfaces tried for the budget", _COLUMNS, rows, notes)]


def weakening_html(fit: WeakeningFit) -> HtmlTable:
    """What was tried, in order of size, for the report."""
    rows = tuple(Row(_cells(trial), "chosen" if trial.chosen else "") for trial in fit.trials)
    return HtmlTable(
        "Surfaces tried for the budget, by size", tuple(symbols(text) for text in _COLUMNS), rows
    )


def weakening_part(fit: WeakeningFit, prefix: str) -> PlainData:
    """The part of the report on field weakening."""
    return {
        "domain": domain_text(fit),
        "errors": errors_text(fit),
        "nominal": nominal_text(fit),
        "proven": proof_text(fit),
        "samples": count(fit.errors.samples + fit.voltage.samples),
        "least_voltage": least_voltage_text(fit),
        "table": weakening_html(fit),
        "prefix": prefix,
    }
