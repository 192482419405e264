"""Measured losses beside the budget: tables, and plain data."""

from __future__ import annotations

import numpy as np

from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.losses.measured_comparison import MeasuredComparison
from dqforge.reports.pages.answer import Table
from dqforge.reports.plain_data import PlainData, finite

_COLUMNS = ("line", "torque", "speed", "measured", "model", "left", "of the measured")
_SHOWN = 12


def measured_tables(found: MeasuredComparison) -> list[Table]:
    """The points with the largest rests, and what all of them say."""
    measured, left = found.measured, found.left
    size = np.where(found.reached, np.abs(left), -1.0)
    order = np.argsort(-size, kind="stable")[: min(_SHOWN, int(found.reached.sum()))]
    rows = tuple(
        (
            str(measured.lines[n]),
            format_quantity(float(measured.torque[n]), "N m", 4),
            format_quantity(float(measured.omega_m[n]), "rpm", 4),
            f"{measured.loss[n]:.4g} W",
            f"{found.model[n]:.4g} W",
            f"{left[n]:+.3g} W",
            f"{100.0 * left[n] / measured.loss[n]:+.3g} %" if measured.loss[n] > 0.0 else "-",
        )
        for n in order.tolist()
    )
    return [Table(f"Measured losses of the {measured.whose}", _COLUMNS, rows, _notes(found))]


def _notes(found: MeasuredComparison) -> tuple[str, ...]:
    measured, reached = found.measured, found.reached
    share = found.rms / float(np.sqrt(np.mean(measured.loss[reached] ** 2)))
    mean = float(np.mean(found.left[reached]))
    first = (
        f"{int(reached.sum())} of {reached.size} points are reached; left of them {found.rms:.3g} "
        f"W r.m.s., {100.0 * share:.3g} % of what was measured, on average {mean:+.3g} W"
    )
    notes = [first]
    if found.below.any():
        worst = int(np.nanargmin(np.where(found.below, found.left, np.nan)))
        notes.append(
            f"below zero at {int(found.below.sum())} points, most on line {measured.lines[worst]} "
            f"({found.left[worst]:.3g} W): less was measured than the model loses there; check the "
            "resistance, the temperature of the winding, the losses of the design and the meters"
        )
    notes += [
        f"what is left goes with a {one.label}: {one.value:.3g} {one.unit} "
        f"(95 %: {one.low:.3g} to {one.high:.3g})"
        for one in found.goes_with
        if not one.low <= 0.0 <= one.high
    ]
    return (*notes, *measured.findings)


def plain_measured_losses(found: MeasuredComparison) -> PlainData:
    """The same in SI units, with every point."""
    measured = found.measured
    return {
        "of": measured.whose,
        "line": measured.lines,
        "torque_Nm": measured.torque,
        "omega_m_rad_per_s": measured.omega_m,
        "speed_rpm": in_rpm(measured.omega_m),
        "measured_W": measured.loss,
        "model_W": [finite(float(value)) for value in found.model],
        "left_W": [finite(float(value)) for value in found.left],
        "left_rms_W": found.rms,
        "below_zero": int(found.below.sum()),
        "goes_with": [
            {
                "key": one.key,
                "value": one.value,
                "unit": one.unit,
                "interval_95": [one.low, one.high],
            }
            for one in found.goes_with
        ],
    }
