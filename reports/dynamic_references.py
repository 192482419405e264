"""What is said of references that move, for the terminal and the report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.capability import Capability, Outcome, Passage, ReportPart
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import LOOPS

if TYPE_CHECKING:
    from dqforge.optimizer.dynamic_references import DynamicReferences, OffMap, VoltageFeedback
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData


TITLE = "Dynamic references"


def reference_rows(found: DynamicReferences) -> list[tuple[str, str]]:
    """Label and text of everything that is known of them."""
    rows = []
    settings = found.settings
    if settings.torque_slope is not None:
        time = format_quantity(found.torque_time, "s", 3)
        text = f"{settings.torque_slope:.4g} N m/s; {time} to the largest torque"
        rows.append(("torque slope", text))
    if not math.isnan(found.speed_step):
        step = format_quantity(found.speed_step, "rpm", 3)
        text = f"steps of up to {step} settle; ramp the speed reference beyond"
        rows.append(("with the speed loop", text))
    if settings.current_slope is not None:
        most = f"the voltage permits {_slope(found.slope_at_rest)} of i_q at rest"
        rows.append(("current slope", f"{_slope(settings.current_slope)}; {most}"))
    return rows if found.feedback is None else [*rows, *_feedback_rows(found.feedback)]


def _slope(value: float) -> str:
    return f"{1e-3 * value:.4g} kA/s" if value >= 1e3 else f"{value:.4g} A/s"


def _feedback_rows(found: VoltageFeedback) -> list[tuple[str, str]]:
    low, high = (rate / (2.0 * math.pi) for rate in found.bandwidth)
    margin = (
        f"{found.gain_margin:.3g} times the gain"
        if math.isfinite(found.gain_margin)
        else "more than a hundred times the gain"
    )
    rows = [
        ("voltage feedback", f"adds up to {found.current:.3g} A of demagnetising current"),
        ("its bandwidth at the voltage limit", f"{low:.3g} to {high:.3g} Hz"),
        (
            "with both current loops",
            f"largest pole {found.largest_pole:.4f} at every corner; stable up to {margin}",
        ),
    ]
    return rows if found.worst is None else [*rows, *_off_rows(found.worst)]


def _off_rows(off: OffMap) -> list[tuple[str, str]]:
    where = f"{off.torque:.4g} N m at {format_quantity(off.omega_m, 'rpm', 4)}"
    lack = f"{off.text}: {off.missing:.3g} V are missing for {where}"
    if math.isnan(off.current):
        return [("references of the map alone", lack), ("with feedback", "it is not enough")]
    kept = f"{off.current:.3g} A more, and {100.0 * off.kept:.3g} % of that torque"
    return [("references of the map alone", lack), ("with feedback", kept)]


def reference_tables(found: DynamicReferences) -> list[Table]:
    """For the terminal."""
    return [Table(TITLE, ("", ""), tuple(reference_rows(found)))]


def reference_html(found: DynamicReferences) -> list[HtmlTable]:
    """For the report."""
    rows = tuple(Row((symbols(label), symbols(text))) for label, text in reference_rows(found))
    return [HtmlTable(TITLE, ("", "value"), rows, text_columns=2)]


def plain_references(found: DynamicReferences) -> PlainData:
    """As plain data, in SI units; null where there is none or no number."""
    feedback = found.feedback
    return {
        "torque_slope_Nm_per_s": found.settings.torque_slope,
        "current_slope_A_per_s": found.settings.current_slope,
        "torque_time_s": found.torque_time,
        "slope_at_rest_A_per_s": found.slope_at_rest,
        "speed_step_rad_per_s": None if math.isnan(found.speed_step) else found.speed_step,
        "voltage_feedback": None if feedback is None else _plain_feedback(feedback),
    }


def _plain_feedback(found: VoltageFeedback) -> PlainData:
    off = found.worst
    return {
        "gain_A_per_V": found.gain,
        "current_A": found.current,
        "bandwidth_rad_per_s": list(found.bandwidth),
        "largest_pole": found.largest_pole,
        "gain_margin": found.gain_margin if math.isfinite(found.gain_margin) else None,
        "worst": None
        if off is None
        else {
            "drive": off.text,
            "torque_Nm": off.torque,
            "omega_m_rad_per_s": off.omega_m,
            "missing_V": off.missing,
            "current_A": None if math.isnan(off.current) else off.current,
            "torque_kept": off.kept,
        },
    }


# References that move, as a record.


def _of(outcome: Outcome) -> DynamicReferences | None:
    gains = outcome.solution.loops
    return None if gains is None else gains.references


def _parts(_: Solution, found: DynamicReferences) -> list[ReportPart]:
    return [Passage(tables=reference_html(found), kind="loops").of(LOOPS)]


DYNAMIC_REFERENCES = Capability(
    name="dynamic_references",
    title="slopes of the references and voltage feedback",
    of=_of,
    plain=lambda _, found: plain_references(found),
    always=False,
    summary=lambda _, found: reference_rows(found),
    tables=lambda _, found: reference_tables(found),
    parts=_parts,
)
