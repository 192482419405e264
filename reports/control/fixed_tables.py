"""Control functions in fixed point on the terminal and in the report: integers, margins,
dead bands, ranges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from dqforge.optimizer.fixed_control.design import FixedControlFit
from dqforge.reports.observers.speed_loop_text import margin_words
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import symbols
from dqforge.reports.pages.table import Table

_COLUMNS = (
    "loop",
    "kp",
    "error of kp",
    "ki t_s",
    "error of ki t_s",
    "error of q0 + q1",
    "largest pole",
    "phase margin deg",
    "with real gains",
    "dead band",
    "in one word",
)


def _rows(fit: FixedControlFit) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, loop in fit.loops.items():
        band = fit.dead_bands.get(name)
        rows.append(
            (
                name,
                loop.kp.text(),
                f"{loop.kp.error:+.1e}",
                loop.ki_ts.text(),
                f"{loop.ki_ts.error:+.1e}",
                f"{loop.velocity_ki_error:+.1e}",
                f"{abs(loop.found.poles[0]):.6f}" if loop.exact.observed is None else "-",
                f"{math.degrees(loop.found.phase_margin):.2f}"
                if loop.exact.observed is None
                else "-",
                margin_words(loop.exact)
                if loop.exact.observed
                else f"{math.degrees(loop.exact.phase_margin):.2f}",
                "none" if band is None else f"{band.largest}",
                "none" if band is None else f"{fit.word_dead_bands[name].largest}",
            )
        )
    return rows


def _title(fit: FixedControlFit) -> str:
    return f"Control in fixed point, {fit.control.format}: gains as integers"


def _bands(fit: FixedControlFit) -> str:
    """Dead bands in physical units, in one line."""
    parts = [
        f"{name} {fit.physical_band(name):.3g} {'rad/s' if name == 'speed' else 'A'}"
        for name in fit.dead_bands
    ]
    if "speed" in fit.loops:
        parts.append(f"speed filter {fit.filter_band:.3g} rad/s")
        parts.append(f"torque in steps of {fit.control.one_code[3]:.3g} N m")
    if fit.observer_band is not None:
        parts.append(f"speed observer {fit.observer_band:.3g} rad/s")
    return f"dead bands: {', '.join(parts) or 'none'};"


def _notes(fit: FixedControlFit) -> tuple[str, ...]:
    fullest, (current, _, speed, _) = fit.fullest, fit.control.one_code
    return (
        (
            f"{len(fit.reaches)} products and sums proven not to overflow; '{fullest.name}' "
            f"reaches {fullest.share:.3%}"
        ),
        (
            "dead band: smallest error in codes that moves the integral; in one word: an integral "
            "without fractional bits;"
        ),
        _bands(fit),
        (
            f"one code is {current:.3g} A, or {speed:.3g} rad/s; q0 + q1 is the integral gain of "
            "the velocity form"
        ),
    )


def control_fixed_tables(fits: Sequence[FixedControlFit]) -> list[Table]:
    """One table per fixed-point format, for the terminal."""
    return [Table(_title(fit), _COLUMNS, tuple(_rows(fit)), _notes(fit)) for fit in fits]


def control_fixed_html(fits: Sequence[FixedControlFit]) -> list[HtmlTable]:
    """One table per fixed-point format, for the report."""
    headings = tuple(symbols(text) for text in _COLUMNS)
    return [
        HtmlTable(_title(fit), headings, tuple(Row(row, "") for row in _rows(fit))) for fit in fits
    ]
