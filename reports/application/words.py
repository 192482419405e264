"""What is said of the program around the emitted functions."""

from __future__ import annotations

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.application.application_plan import ApplicationPlan
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import symbols
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData

TITLE = "Program around the functions"


_KINDS = {
    "start-up": "without an encoder, by the start-up",
    "edges": "by an encoder whose edges are captured",
    "counts": "by an encoder that is counted",
}


def application_rows(plan: ApplicationPlan) -> list[tuple[str, str]]:
    """Label and text of everything that can be set."""
    rows = [
        ("the rotor is known", _KINDS[plan.kind]),
        (
            "offsets of the current sensors",
            (
                f"mean of {plan.offset_samples} samples, at most "
                f"{format_quantity(plan.offset_limit, 'A', 3)}"
            ),
        ),
        (
            "it stops at",
            (
                f"{format_quantity(plan.trip_current, 'A', 3)}, below "
                f"{format_quantity(plan.v_dc_min, 'V', 3)}, above "
                f"{format_quantity(plan.v_dc_max, 'V', 3)}"
            ),
        ),
    ]
    if plan.kind == "start-up":
        return rows
    align = f"{format_quantity(plan.align_current, 'A', 3)}, {plan.align_samples} samples a step"
    rest = format_quantity(plan.rest, "rpm", 3)
    return [
        *rows,
        ("alignment", f"two steps of a quarter turn; {align}"),
        ("stop", f"on a slope; gate pulses end below {rest}"),
    ]


def application_tables(plan: ApplicationPlan) -> list[Table]:
    """For the terminal."""
    return [Table(TITLE, ("", ""), tuple(application_rows(plan)))]


def application_html(plan: ApplicationPlan) -> list[HtmlTable]:
    """For the report."""
    rows = tuple(Row((symbols(label), symbols(text))) for label, text in application_rows(plan))
    return [HtmlTable(TITLE, ("", "value"), rows, text_columns=2)]


def plain_application(plan: ApplicationPlan) -> PlainData:
    """As plain data, in SI units; null where there is no encoder."""
    encoder = plan.kind != "start-up"
    return {
        "kind": plan.kind,
        "offset_samples": plan.offset_samples,
        "offset_A": plan.offset_limit,
        "trip_A": plan.trip_current,
        "v_dc_min_V": plan.v_dc_min,
        "v_dc_max_V": plan.v_dc_max,
        "align_A": plan.align_current if encoder else None,
        "align_samples": plan.align_samples if encoder else None,
        "counts": plan.counts if encoder else None,
        "rest_rad_per_s": plan.rest if encoder else None,
    }
