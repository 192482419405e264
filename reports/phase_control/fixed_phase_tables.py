"""The control of a phase machine in fixed point on the terminal and in the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import symbols
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit

_COLUMNS = (
    "axis",
    "kp",
    "error of kp",
    "ki t_s",
    "error of ki t_s",
    "further bits of the integral",
)


def _rows(fit: FixedPhaseFit) -> list[tuple[str, ...]]:
    axes = {"d": fit.control.d, "q": fit.control.q, "0": fit.control.zero}
    return [
        (
            name,
            axis.kp.text(),
            f"{axis.kp.error:+.1e}",
            axis.ki.text(),
            f"{axis.ki.error:+.1e}",
            f"{axis.fraction}",
        )
        for name, axis in axes.items()
        if axis is not None
    ]


def _title(fit: FixedPhaseFit) -> str:
    control = fit.control
    return f"Control in fixed point, {control.format}: {control.frame}, {control.topology}"


def _notes(fit: FixedPhaseFit) -> tuple[str, ...]:
    orders = ", ".join(
        f"{part.order}{' of 0' if part.zero else ''}" for part in fit.control.harmonics
    )
    return (
        (
            f"{len(fit.reaches)} products and sums proven not to overflow; '{fit.fullest.name}' "
            f"reaches {fit.fullest.share:.3%}"
        ),
        (
            f"table of the back-EMF: {fit.control.nodes} nodes, {len(fit.control.shape)} row(s), "
            f"rounded by at most {100.0 * fit.shape_error:.2g} % of its largest value"
        ),
        f"integrators of the harmonics {orders or 'none'}",
    )


def phase_fixed_tables(fits: Sequence[FixedPhaseFit]) -> list[Table]:
    """One table per fixed-point format, for the terminal."""
    return [Table(_title(fit), _COLUMNS, tuple(_rows(fit)), _notes(fit)) for fit in fits]


def phase_fixed_html(fits: Sequence[FixedPhaseFit]) -> list[HtmlTable]:
    """One table per fixed-point format, for the report."""
    headings = tuple(symbols(text) for text in _COLUMNS)
    return [
        HtmlTable(_title(fit), headings, tuple(Row(row, "") for row in _rows(fit))) for fit in fits
    ]
