"""Gains over the current as rows of text, notes and plain data."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.loops.robustness_text import plain_loop_robustness, robust_text

if TYPE_CHECKING:
    from dqforge.optimizer.loops.schedule.gain_schedule import AxisSchedule, GainSchedule
    from dqforge.reports.plain_data import PlainData

SCHEDULE_COLUMNS = (
    "loop",
    "i_q A",
    "inductance mH",
    "kp V/A",
    "ki t_s V/A",
    "crossover Hz",
    "phase margin deg",
    "M_s",
    "constant gains: crossover Hz",
    "phase margin deg",
    "M_s",
)


_SHOWN = 6


def _margin_cells(axis: AxisSchedule, row: int) -> list[str]:
    cells = []
    for margins in (axis.scheduled, axis.constant):
        cells += [
            f"{margins.crossover[row] / (2.0 * math.pi):.4g}",
            f"{math.degrees(abs(margins.phase_margin[row])):.1f}",
            f"{margins.max_sensitivity[row]:.2f}",
        ]
    return cells


def schedule_rows(schedule: GainSchedule) -> tuple[tuple[str, ...], ...]:
    """Gains and margins of both axes at a few currents, beside those of the constant gains."""
    rows = []
    places = np.unique(np.linspace(0, schedule.i_q.size - 1, _SHOWN).round().astype(int)).tolist()
    emitted = schedule.fit.evaluator.gains(schedule.i_q.astype(np.float32))
    for column, axis in enumerate(schedule.axes):
        for place in places:
            start = [
                axis.axis if place == 0 else "",
                f"{schedule.i_q[place]:.4g}",
                f"{axis.inductance[place] * 1e3:.4g}",
            ]
            gains = [
                f"{value:.5g}" for value in emitted[place, 2 * column : 2 * column + 2].tolist()
            ]
            rows.append((*start, *gains, *_margin_cells(axis, place)))
    return tuple(rows)


def schedule_lines(schedule: GainSchedule) -> list[str]:
    """How the gains are evaluated, how far they may be off, and the least
    margins with and without them.
    """
    fit, evaluator = schedule.fit, schedule.fit.evaluator
    kind = (
        f"a table of {next(iter(evaluator.tables.values())).size} currents"
        if evaluator.tables
        else "polynomials"
    )
    kind = kind if evaluator.tables or evaluator.polynomials else "constant"
    others = [
        f"{form} {size} B"
        for form, size in fit.flash.items()
        if size is not None and form != evaluator.form
    ]
    than = f" ({', '.join(others)})" if others else ""
    error = rounded_up(100.0 * max(fit.errors.values()), 2)
    lines = [
        (
            f"Gains over |i_q| are {kind}, about {evaluator.flash} bytes{than}; off by at most "
            f"{error} %."
        )
    ]
    for axis in schedule.axes:
        least = [float(np.min(np.abs(m.phase_margin))) for m in (axis.scheduled, axis.constant)]
        slowest = [
            float(np.nanmin(m.crossover)) / (2.0 * math.pi) for m in (axis.scheduled, axis.constant)
        ]
        lines.append(
            f"{axis.axis}: least phase margin {math.degrees(least[0]):.1f} deg "
            f"(constant gains {math.degrees(least[1]):.1f}), slowest crossover {slowest[0]:.4g} Hz "
            f"({slowest[1]:.4g})."
        )
    return lines


def schedule_notes(schedule: GainSchedule) -> tuple[str, ...]:
    """The lines of `schedule_lines`, and what holds over the tolerances and off the reference."""
    notes = [line.rstrip(".") for line in schedule_lines(schedule)]
    for axis in schedule.axes:
        phase, pole = axis.off_reference
        notes.append(
            f"{axis.axis}: from the reference to the end of field weakening phase margin "
            f"{math.degrees(phase):.1f} deg or more, largest pole {pole:.4f}"
        )
        if axis.robust is not None:
            notes.append(
                f"{axis.axis}: at all currents within control.tolerances {robust_text(axis.robust)}"
            )
    return tuple(notes)


def plain_schedule(schedule: GainSchedule | None) -> PlainData:
    """Currents, gains and margins of both axes as plain data.

    An empty mapping without a schedule.
    """
    if schedule is None:
        return {}
    plain: PlainData = {
        "i_d_A": schedule.i_d,
        "i_q_A": schedule.i_q,
        "form": schedule.fit.evaluator.form,
        "flash_B": schedule.fit.evaluator.flash,
        "flash_of_forms_B": dict(schedule.fit.flash),
        "errors": dict(schedule.fit.errors),
    }
    for axis in schedule.axes:
        of_axis: PlainData = {"inductance_H": axis.inductance, "kp": axis.kp, "ki": axis.ki}
        for name, margins in (("scheduled", axis.scheduled), ("constant", axis.constant)):
            of_axis[name] = {
                "crossover_rad_per_s": margins.crossover,
                "phase_margin_rad": margins.phase_margin,
                "gain_margin": margins.gain_margin,
                "max_sensitivity": margins.max_sensitivity,
                "largest_pole": margins.radius,
            }
        of_axis["off_reference"] = {
            "phase_margin_rad": axis.off_reference[0],
            "largest_pole": axis.off_reference[1],
        }
        if axis.robust is not None:
            of_axis["tolerances"] = plain_loop_robustness(axis.robust)
        plain[axis.axis] = of_axis
    return {"schedule": plain}
