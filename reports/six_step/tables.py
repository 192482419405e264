"""A six-step drive as tables, as plain data, and in the report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import symbols
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.optimizer.six_step.design import SixStepDesign
    from dqforge.reports.plain_data import PlainData

_ERROR_COLUMNS = ("speed", "offset", "noise, 3 sigma", "grid", "saliency", "together")


_ERRORS = "Error of a commutation, electrical"


def _degrees(value: float) -> str:
    return f"{math.degrees(value):.3g} deg"


def _hertz(omega: float) -> str:
    return format_quantity(omega / (2.0 * math.pi), "Hz", 4)


def range_words(found: SixStepDesign) -> str:
    """Electrical frequencies between which the drive is handed on by its voltages."""
    return f"{_hertz(found.limits.low)} to {_hertz(found.limits.high)}"


def block_rows(found: SixStepDesign) -> list[tuple[str, str]]:
    """Label and text of what was designed.

    Args:
        found: The six-step drive.
    """
    shape, limits, start = found.shape, found.limits, found.start
    rows = [
        ("commutation", found.method),
        ("from crossing to commutation", _degrees(shape.delay)),
        ("integral in between", f"{shape.threshold:.5g} V s"),
        ("torque over current", f"{shape.torque:.5g} N m/A"),
        ("torque ripple of ideal blocks, peak to peak", f"{100.0 * shape.ripple:.3g} %"),
        ("range (electrical)", range_words(found)),
        ("least speed by the error", _hertz(limits.by_error[0])),
        ("least speed by the duty cycle", _hertz(limits.by_duty)),
        ("largest speed by freewheeling", _hertz(limits.by_freewheeling)),
        ("freewheeling at the current limit", _degrees(limits.freewheeling)),
        (
            "current, two phases in series",
            f"kp {found.gains.kp:.4g} V/A, ki t_s {found.gains.ki_ts:.4g} V/A",
        ),
        (
            "start",
            (
                f"{start.current:.4g} A, aligned in {start.align_time:.3g} s, "
                f"ramp of {start.ramp_time:.3g} s"
            ),
        ),
        ("hand-over (electrical)", _hertz(start.omega)),
        ("largest load at the start", format_quantity(start.load, "N m", 4)),
    ]
    if found.speed is not None:
        rows.append(
            (
                "speed at the least speed",
                (
                    f"{1e3 * found.speed.delay:.3g} ms late, {_degrees(found.speed.margin)} of "
                    f"margin at {found.speed.crossover:.4g} rad/s"
                ),
            )
        )
    return rows


def _error_lines(found: SixStepDesign) -> list[tuple[str, ...]]:
    errors = found.errors
    columns = (errors.offset, 3.0 * errors.noise, errors.grid, errors.saliency, errors.largest)
    return [
        (_hertz(float(omega)), *(_degrees(float(column[k])) for column in columns))
        for k, omega in enumerate(errors.omega)
    ]


def block_tables(found: SixStepDesign) -> list[Table]:
    """Tables for the terminal.

    Args:
        found: The six-step drive.
    """
    return [
        Table("Six-step drive", ("", ""), tuple(block_rows(found))),
        Table(_ERRORS, _ERROR_COLUMNS, tuple(_error_lines(found))),
    ]


def block_html(found: SixStepDesign) -> list[HtmlTable]:
    """The same for the report.

    Args:
        found: The six-step drive.
    """
    rows = tuple(Row((symbols(name), symbols(text))) for name, text in block_rows(found))
    lines = tuple(Row(line) for line in _error_lines(found))
    return [
        HtmlTable("Six-step drive", ("", ""), rows, 2),
        HtmlTable(_ERRORS, _ERROR_COLUMNS, lines, 0),
    ]


def block_summary(found: SixStepDesign) -> list[tuple[str, str]]:
    """Rows of the summary of a run.

    Args:
        found: The six-step drive.
    """
    limits = found.limits
    return [
        (
            "six-step drive",
            f"{found.method}, {_hertz(limits.low)} to {_hertz(limits.high)} (electrical)",
        )
    ]


def plain_blocks(found: SixStepDesign) -> PlainData:
    """As plain data, in SI units.

    Args:
        found: The six-step drive.
    """
    shape, limits, start, errors = found.shape, found.limits, found.start, found.errors
    return {
        "method": found.method,
        "delay_rad": shape.delay,
        "spread_rad": shape.spread,
        "threshold_Vs": shape.threshold,
        "torque_Nm_per_A": shape.torque,
        "ripple": shape.ripple,
        "omega_low_rad_per_s": limits.low,
        "omega_high_rad_per_s": limits.high,
        "limits": {
            "error_rad_per_s": list(limits.by_error),
            "duty_rad_per_s": limits.by_duty,
            "freewheeling_rad_per_s": limits.by_freewheeling,
            "freewheeling_rad": limits.freewheeling,
        },
        "errors": {
            "omega_rad_per_s": errors.omega.tolist(),
            "offset_rad": errors.offset.tolist(),
            "noise_rms_rad": errors.noise.tolist(),
            "grid_rad": errors.grid.tolist(),
            "saliency_rad": errors.saliency.tolist(),
            "largest_rad": errors.largest.tolist(),
        },
        "start": {
            "current_A": start.current,
            "align_s": start.align_time,
            "ramp_s": start.ramp_time,
            "hand_over_rad_per_s": start.omega,
            "load_Nm": start.load,
        },
        "speed_loop": None
        if found.speed is None
        else {
            "kp": found.speed.kp,
            "ki": found.speed.ki,
            "delay_s": found.speed.delay,
            "crossover_rad_per_s": found.speed.crossover,
            "margin_rad": found.speed.margin,
        },
    }
