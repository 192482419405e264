"""What is said of a start without encoder, for the terminal, the report and JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.c_code.harness import HeaderKind
from dqforge.reports.capability import Capability, Outcome, Passage, ReportPart
from dqforge.reports.observers.position_header import tracker_from
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import LOOPS
from dqforge.reports.start_up.header import (
    method_words,
    plain_start_observer,
    plain_start_up,
    start_observer_files,
    start_up_files,
)
from dqforge.reports.start_up.tried import (
    start_observer_programme,
    start_up_from,
    start_up_programme,
)

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution
    from dqforge.optimizer.start_up.solve import StartUp
    from dqforge.reports.plain_data import PlainData


TITLE = "Start without encoder"


def _rpm(found: StartUp, omega: float) -> str:
    return format_quantity(omega / found.plan.pole_pairs, "rpm", 4)


def _amperes(value: float) -> str:
    return format_quantity(value, "A", 4)


def _seconds(value: float) -> str:
    return format_quantity(value, "s", 3)


def _first_rows(found: StartUp) -> list[tuple[str, str]]:
    """Alignment and ramp, or the search for the axis."""
    plan, rows = found.plan, []
    if plan.alignment == "voltage":
        volts = format_quantity(plan.align_voltage, "V", 4)
        rows.append(("alignment", f"{volts} in {_seconds(plan.align_time)}"))
    elif plan.alignment != "none":
        current = _amperes(plan.align_current)
        rows.append(("alignment", f"{plan.alignment}, {current} in {_seconds(plan.align_time)}"))
    if plan.method == "saliency":
        low = "" if found.low is None else f" by {found.low.tracker.title}"
        rows.append(("axis", f"in {_seconds(plan.search_time)}{low}"))
        held = _amperes(plan.held_current)
        rows.append(("d current until the observer takes over", held))
    elif plan.method == "direct":
        held = _amperes(plan.held_current)
        rows.append(("d current that fades", f"{held} in {_seconds(plan.fade_time)}"))
    else:
        slope = format_quantity(plan.ramp_acceleration / plan.pole_pairs, "", 4).strip()
        sine = f"sin delta {plan.load_angle_sine:.3g} at the largest load"
        rows.append(("ramp", f"{_amperes(plan.ramp_current)}, {slope} rad/s^2; {sine}"))
        damping = f"{plan.damping * plan.psi_pm:.3g}" if plan.damping > 0.0 else "none"
        rows.append(("its damping", damping))
    return rows


def start_rows(found: StartUp) -> list[tuple[str, str]]:
    """Label and text of everything that is known of a start.

    Args:
        found: The start.
    """
    plan = found.plan
    band = f"back below {_rpm(found, plan.back_below)}"
    lifted = f"{found.largest_load:.4g} N m; {plan.load_torque:.4g} N m are requested"
    retries = f"{plan.retries} more, {_seconds(plan.retry_pause)} apart"
    return [
        ("method", method_words(found)),
        *_first_rows(found),
        ("the observer takes over from", f"{_rpm(found, plan.hand_over)}, {band}"),
        ("largest load torque", lifted),
        *(
            (f"... by {name} at the current limit", f"{torque:.4g} N m")
            for name, torque in found.largest_loads.items()
        ),
        ("tries", retries),
        ("trips at", _amperes(plan.trip_current)),
    ]


def start_summary(found: StartUp) -> list[tuple[str, str]]:
    """Row for the summary of a run.

    Args:
        found: The start.
    """
    plan = found.plan
    text = (
        f"{plan.method}, up to {found.largest_load:.4g} N m; the observer takes over from "
        f"{_rpm(found, plan.hand_over)}"
    )
    return [("start", text)]


def start_tables(found: StartUp) -> list[Table]:
    """For the terminal.

    Args:
        found: The start.
    """
    return [Table(TITLE, ("", ""), tuple(start_rows(found)))]


def start_html(found: StartUp) -> list[HtmlTable]:
    """For the report.

    Args:
        found: The start.
    """
    rows = tuple(Row((symbols(label), symbols(text))) for label, text in start_rows(found))
    return [HtmlTable(TITLE, ("", "value"), rows, text_columns=2)]


def plain_start(found: StartUp) -> PlainData:
    """As plain data: the plan in SI units, angles and speeds electrical, and what it lifts.

    Args:
        found: The start.
    """
    low = found.low
    return {
        "plan": asdict(found.plan),
        "load_angle_sine": found.plan.load_angle_sine,
        "hand_over_Hz": found.plan.hand_over / (2.0 * math.pi),
        "largest_load_Nm": found.largest_load,
        "largest_loads_Nm": dict(found.largest_loads),
        "observer": None
        if low is None
        else {"method": low.tracker.name, "gains": asdict(low.gains)},
    }


# The start-up, as a record.


def _of(outcome: Outcome) -> StartUp | None:
    return outcome.solution.start_up


def _parts(_: Solution, found: StartUp) -> list[ReportPart]:
    return [Passage(tables=start_html(found), kind="loops").of(LOOPS)]


START_UP = Capability(
    name="start_up",
    title="from standstill to speed without an encoder",
    of=_of,
    plain=lambda _, found: plain_start(found),
    always=False,
    summary=lambda _, found: start_summary(found),
    tables=lambda _, found: start_tables(found),
    parts=_parts,
    headers=(
        HeaderKind(
            name="startup",
            files=start_up_files,
            plain=plain_start_up,
            read=start_up_from,
            programme=start_up_programme,
            vectors=False,
        ),
        HeaderKind(
            name="start_observer",
            files=start_observer_files,
            plain=lambda _, found: plain_start_observer(found),
            read=lambda own, _: tracker_from(own),
            programme=start_observer_programme,
            vectors=False,
        ),
    ),
)
