"""What is said of a measured speed, for the terminal, the report and JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import symbols
from dqforge.reports.pages.labels import significant
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.measured_speed_loop import MeasuredSpeed
    from dqforge.reports.plain_data import PlainData

TITLE = "Speed loop on the measured speed"


_COLUMNS = ("speed", "delay ms", "one count or tick rpm", "phase margin deg")


_METHODS = {
    "counts": "edges counted over a speed period",
    "capture": "time between the last two edges",
    "mixed": "edges over the time that they took",
}


def measured_rows(found: MeasuredSpeed) -> list[tuple[str, str]]:
    """Label and text of what holds at every speed."""
    own = found.settings
    encoder = f"{own.lines} lines, {own.edges} of 4 edges"
    rows = [("speed measured by", f"{_METHODS[own.method]}; {encoder}")]
    if own.method != "counts":
        clock = format_quantity(own.clock, "Hz", 4)
        rows.append(("timer", f"{clock}, {own.counter_bits} bits"))
        least = format_quantity(found.edges.least, "rpm", 3)
        most = format_quantity(found.edges.largest, "rpm", 3)
        rows.append(("range", f"{least} (below: at rest) to {most} (one tick)"))
    required = f"{math.degrees(found.required):.3g} deg"
    lowest = format_quantity(found.lowest, "rpm", 3)
    rows.append(("speed loop", f"{required} of phase margin or more from {lowest} on"))
    return rows


def speed_rows(found: MeasuredSpeed) -> list[tuple[str, ...]]:
    """A row per speed: delay, resolution, margin."""
    return [
        (
            format_quantity(float(omega), "rpm", 4),
            significant(1e3 * float(delay), 3),
            significant(float(step) * 30.0 / math.pi, 3),
            f"{math.degrees(margin):.1f}",
        )
        for omega, delay, step, margin in zip(
            found.omega_m, found.delay, found.resolution, found.phase_margin, strict=True
        )
    ]


def measured_tables(found: MeasuredSpeed) -> list[Table]:
    """For the terminal."""
    notes = tuple(f"{label}: {text}" for label, text in measured_rows(found))
    return [Table(TITLE, _COLUMNS, tuple(speed_rows(found)), notes)]


def measured_html(found: MeasuredSpeed) -> list[HtmlTable]:
    """For the report."""
    rows = tuple(Row(tuple(symbols(cell) for cell in row)) for row in speed_rows(found))
    notes = tuple(symbols(f"{label}: {text}") for label, text in measured_rows(found))
    return [HtmlTable(TITLE, _COLUMNS, rows, notes=notes)]


def plain_measured(found: MeasuredSpeed) -> PlainData:
    """As plain data, in SI units."""
    own = found.settings
    return {
        "method": own.method,
        "lines": own.lines,
        "edges_per_line": own.edges,
        "clock_Hz": own.clock if own.clock > 0.0 else None,
        "counter_bits": own.counter_bits if own.clock > 0.0 else None,
        "period_s": found.edges.period,
        "omega_m_rad_per_s": found.omega_m,
        "delay_s": found.delay,
        "resolution_rad_per_s": found.resolution,
        "phase_margin_rad": found.phase_margin,
        "least_rad_per_s": found.edges.least,
        "largest_rad_per_s": found.edges.largest if math.isfinite(found.edges.largest) else None,
        "lowest_rad_per_s": found.lowest,
        "required_phase_margin_rad": found.required,
    }
