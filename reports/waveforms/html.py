"""Phase currents in the report: what the rules cost, and what the firmware evaluates."""

from __future__ import annotations

import math

from dqforge.optimizer.solution import Solution
from dqforge.optimizer.waveforms.comparison import RuleCurrents, WaveformComparison
from dqforge.optimizer.waveforms.confirmation import Confirmation
from dqforge.optimizer.waveforms.firmware_fit import PhaseCandidate, PhaseFit
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import (
    ceiling,
    quantity,
    share,
    symbols,
)
from dqforge.reports.plain_data import PlainData
from dqforge.reports.waveforms.tables import RULE_TEXT, optimality_note

_ROUNDING = 1e-9


def point_words(comparison: WaveformComparison) -> str:
    """Torque and speed for which the currents are shaped."""
    return f"{quantity(comparison.torque, 'N m')} at {quantity(comparison.omega_m, 'rpm')}"


def comparison_text(comparison: WaveformComparison) -> str:
    """The operating point, and what holds the currents there."""
    limits = comparison.limits
    where = point_words(comparison)
    held = (
        f"held by the limits of {', '.join(comparison.binding)}"
        if comparison.binding
        else "held by no limit"
    )
    source = (
        f"{quantity(limits.v_dc, 'V')} ({limits.topology}), at most {quantity(limits.i_max, 'A')} "
        "(peak)"
    )
    note = optimality_note(comparison)
    return (
        f"{where} from {source}; the last row is "
        f"{held}.{f' {note[0].upper()}{note[1:]}.' if note else ''}"
    )


def _cells(found: RuleCurrents) -> tuple[str, ...]:
    values, torque = found.figures, abs(float(found.figures.torque[0]))
    ripple, neutral = float(values.ripple[0]) / torque, float(values.neutral_rms[0])
    return (
        RULE_TEXT[found.rule],
        quantity(float(values.copper[0]), "W"),
        share(ripple, 3) if ripple > _ROUNDING else "0",
        quantity(float(values.rms[0]), "A"),
        quantity(float(values.peak[0]), "A"),
        quantity(neutral, "A", 3) if neutral > _ROUNDING * float(values.rms[0]) else "0",
        quantity(float(values.bus[0]), "V"),
        ", ".join(found.obstacles) or "nothing",
    )


def rules_table(comparison: WaveformComparison) -> HtmlTable:
    """One row per rule."""
    columns = ("", "copper", "ripple p-p", "r.m.s.", "peak", "neutral", "dc link", "breaks")
    rows = tuple(
        Row(
            _cells(found),
            "chosen" if found.rule == "limited" else "muted" if found.obstacles else "",
        )
        for found in comparison.rules
    )
    caption = "Phase currents by rule: copper loss, torque ripple, currents, dc link needed"
    return HtmlTable(caption, tuple(symbols(text) for text in columns), rows)


def _confirmation_cells(entry: Confirmation) -> tuple[str, ...]:
    return (
        share(entry.ripple / abs(entry.torque)) if entry.torque else "0",
        entry.verdict,
        *(
            f"{side.largest:.1e}" if math.isfinite(side.largest) else "none"
            for side in (entry.ours, entry.theirs)
        ),
        f"{100.0 * entry.loss_difference:+.0e} %"
        if math.isfinite(entry.loss_difference)
        else "none",
        f"{entry.current_difference:.1e} A" if math.isfinite(entry.current_difference) else "none",
        f"{entry.iterations}",
    )


def confirmations_table(comparison: WaveformComparison) -> HtmlTable:
    """Every quadratic programme with the residuals of both solvers."""
    columns = (
        "deviation",
        "by OSQP",
        "residual here",
        "residual of OSQP",
        "loss",
        "current",
        "iterations",
    )
    rows = tuple(
        Row(_confirmation_cells(entry), "muted" if entry.verdict == "differs" else "")
        for entry in comparison.confirmations
    )
    caption = (
        "The same programmes solved by OSQP: largest residual of the optimality conditions, "
        "differences"
    )
    return HtmlTable(caption, columns, rows, folded=True)


def _candidate_cells(entry: PhaseCandidate) -> tuple[str, ...]:
    return (
        entry.name,
        share(ceiling(entry.errors.current), 3),
        share(ceiling(entry.errors.torque), 3),
        f"{entry.flash} B",
        f"{entry.operations}",
    )


def candidates_table(fit: PhaseFit) -> HtmlTable:
    """The forms for the firmware, the emitted one first."""
    columns = ("", "current error of peak", "torque error", "constants", "operations")
    rows = tuple(
        Row(_candidate_cells(entry), "chosen" if entry is fit.chosen else "")
        for entry in fit.candidates
    )
    return HtmlTable(
        "Forms for the firmware: largest errors found",
        tuple(symbols(text) for text in columns),
        rows,
    )


def waveform_part(solution: Solution) -> PlainData | None:
    """The part of the report on phase currents; None without."""
    if solution.waveforms is None or solution.phases is None:
        return None
    return {
        "text": comparison_text(solution.waveforms),
        "tables": [
            rules_table(solution.waveforms),
            candidates_table(solution.phases),
            *(
                [confirmations_table(solution.waveforms)]
                if solution.waveforms.confirmations
                else []
            ),
        ],
        "file": f"{solution.design.export.prefix}_waveform.h",
    }
