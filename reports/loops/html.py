"""Loops in the report."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.reports.loops.firmware_text import (
    FIRMWARE_COLUMNS,
    firmware_notes,
    firmware_rows,
    firmware_title,
)
from dqforge.reports.loops.judged_text import (
    JUDGED_TITLE,
    judged_columns,
    judged_notes,
    judged_rows,
)
from dqforge.reports.loops.proven_text import box_notes, changing_notes
from dqforge.reports.loops.robustness_text import ROBUST_COLUMNS, robust_notes, robust_rows
from dqforge.reports.loops.schedule_text import SCHEDULE_COLUMNS, schedule_notes, schedule_rows
from dqforge.reports.loops.stability_text import stability_notes
from dqforge.reports.observers.speed_loop_text import observed_notes
from dqforge.reports.pages.html_table import HtmlTable, Row, heading_cells
from dqforge.reports.pages.html_text import (
    NARROW,
    decibel,
    degrees,
    number,
    quantity,
    symbols,
)

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.integer_gains import PerUnitGains
    from dqforge.optimizer.loops.loop_gains import LoopGains


LOOP_TEXT = {"i_d": "i_d", "i_q": "i_q", "i_0": "i_0", "speed": "speed"}


_KP_UNITS = {"i_d": "V/A", "i_q": "V/A", "i_0": "V/A", "speed": f"N{NARROW}m{NARROW}s/rad"}


_KI_UNITS = {"i_d": "V/(A s)", "i_q": "V/(A s)", "i_0": "V/(A s)", "speed": f"N{NARROW}m/rad"}


def _loop_cells(gains: LoopGains, scaled: PerUnitGains) -> tuple[str, ...]:
    per_unit_text = f"{number(scaled.kp, 5)}, {number(scaled.ki_ts, 5)}"
    if scaled.integers is not None:
        per_unit_text += " = " + ", ".join(
            f"{found.mantissa} in Q{found.shift}" for found in scaled.integers
        )
    poles = ", ".join(_pole_text(complex(pole)) for pole in gains.poles)
    delay = (
        f"{quantity(gains.delay_margin, 's', 3)} ({number(gains.delay_margin_samples, 3)} samples)"
    )
    return (
        gains.method,
        quantity(gains.t_s, "s"),
        f"{number(gains.kp, 6)}{NARROW}{_KP_UNITS[gains.loop]}",
        f"{number(gains.ki, 6)}{NARROW}{_KI_UNITS[gains.loop]}",
        quantity(gains.t_i, "s", 5),
        ", ".join(number(value, 6) for value in gains.velocity),
        per_unit_text,
        quantity(gains.crossover / (2.0 * math.pi), "Hz"),
        degrees(gains.phase_margin)
        if gains.stable
        else f"{degrees(gains.phase_margin)} (unstable)",
        decibel(gains.gain_margin),
        delay,
        number(gains.max_sensitivity, 3),
        _disturbance_text(gains),
        poles,
        symbols("; ".join(observed_notes(gains))),
    )


def _pole_text(pole: complex) -> str:
    if abs(pole.imag) < 1e-9:
        return number(pole.real, 5)
    sign = "+" if pole.imag > 0.0 else "\u2212"
    return f"{number(pole.real, 4)}{NARROW}{sign}{NARROW}j{number(abs(pole.imag), 4)}"


def _disturbance_text(gains: LoopGains) -> str:
    response = gains.disturbance
    if gains.observed is not None:
        return "not computed with the observer"
    unit = "A per V" if gains.loop != "speed" else "rad/s per N m"
    finite = math.isfinite(response.settling_time)
    settled = (
        f"settled in {quantity(response.settling_time, 's', 3)}"
        if finite
        else "settles later than was computed"
    )
    return f"{number(response.peak, 3)} {unit}, {settled}"


def loop_table(gains: GainSet) -> HtmlTable:
    """Gains, margins and poles, one column per loop."""
    columns = [_loop_cells(loop, gains.per_unit[loop.loop]) for loop in gains.loops]
    names = [f"{loop.loop} loop" for loop in gains.loops]
    labels = heading_cells(
        "method",
        "sampled every",
        "proportional gain k_p",
        "integral gain k_i",
        "integral time T_i of the series form",
        "velocity form: q_0, q_1",
        "per unit: k_p, k_i T_s",
        "crossover",
        "phase margin",
        "gain margin",
        "delay margin",
        "largest sensitivity M_s",
        "largest deviation after a unit disturbance",
        "closed-loop poles in z",
        "speed from",
    )
    rows = tuple(
        Row((label, *cells)) for label, *cells in zip(labels, *columns, strict=True) if any(cells)
    )
    caption = "Gains and margins of the sampled loops"
    if gains.schedule is None:
        caption = "; ".join((caption, *changing_notes(gains)))
    return HtmlTable(symbols(caption), ("", *heading_cells(*names)), rows)


def _table(
    caption: str, columns: tuple[str, ...], rows: tuple[tuple[str, ...], ...], text_columns: int
) -> HtmlTable:
    cells = tuple(Row(tuple(symbols(cell) for cell in row)) for row in rows)
    return HtmlTable(
        symbols(caption), tuple(symbols(column) for column in columns), cells, text_columns
    )


def firmware_tables(gains: GainSet) -> list[HtmlTable]:
    """The loops as the firmware that the design names runs them; none without one."""
    if gains.firmware is None:
        return []
    table = _table(
        firmware_title(gains.firmware), FIRMWARE_COLUMNS, firmware_rows(gains.firmware), 2
    )
    return [replace(table, notes=tuple(map(symbols, firmware_notes(gains.firmware))))]


def judged_tables(gains: GainSet) -> list[HtmlTable]:
    """How fast the currents of a phase machine forget; none of all others."""
    if gains.phases is None or gains.phases.judged is None:
        return []
    caption = f"{JUDGED_TITLE}; {'; '.join(judged_notes(gains.phases))}"
    judged = gains.phases.judged
    return [_table(caption, judged_columns(judged), judged_rows(judged), 1)]


def tolerance_tables(gains: GainSet, pole_pairs: int) -> list[HtmlTable]:
    """Worst margins within the tolerances, and scheduled beside constant gains.

    None where none are asked for.
    """
    tables = []
    if gains.robust is not None:
        notes = (
            *robust_notes(gains.robust),
            *box_notes(gains),
            *stability_notes(gains, pole_pairs),
        )
        caption = f"Worst within control.tolerances; {'; '.join(notes)}"
        tables.append(
            _table(caption, ROBUST_COLUMNS, robust_rows(gains.robust), len(ROBUST_COLUMNS))
        )
    if gains.schedule is not None:
        caption = (
            "Scheduled gains along the current reference. "
            f"{'; '.join((*schedule_notes(gains.schedule), *changing_notes(gains)))}"
        )
        tables.append(_table(caption, SCHEDULE_COLUMNS, schedule_rows(gains.schedule), 1))
    return tables
