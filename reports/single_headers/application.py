"""The C of the program around the emitted functions, and its settings in words."""

from __future__ import annotations

import math
from textwrap import wrap

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.application import ApplicationPlan
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.harness import title
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.capability import Capability, Passage, ReportPart
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import LOOPS, render
from dqforge.reports.plain_data import PlainData

SUFFIXES = ("hardware.h", "application.h", "main.c")  # Ends of the names of its files.


def _settings(plan: ApplicationPlan, t_s: float) -> list[tuple[str, str]]:
    """Values in C and what they are, in the order of the structure."""
    common = [
        (f"{plan.offset_samples}U", "offset_samples"),
        (float_literal(plan.offset_limit), "offset_A"),
        (float_literal(plan.trip_current), "trip_A"),
        (float_literal(plan.v_dc_min), "v_dc_min_V"),
        (float_literal(plan.v_dc_max), "v_dc_max_V"),
    ]
    if plan.kind == "start-up":
        return common
    turn = 2.0 * math.pi * plan.pole_pairs / plan.counts
    return [
        *common,
        (f"{plan.ratio}U", "ratio"),
        (float_literal(plan.align_current), "align_A"),
        (f"{plan.align_samples}U", "align_samples"),
        (float_literal(plan.align_damping), "align_damping"),
        (f"{plan.counts}", "counts"),
        (float_literal(turn), "turn"),
        (float_literal(plan.stop_step), "stop_step"),
        (float_literal(plan.rest), "rest"),
        *_counted_speed(plan, turn, t_s),
    ]


def _counted_speed(plan: ApplicationPlan, turn: float, t_s: float) -> list[tuple[str, str]]:
    """The speed of one count in a speed period, before the observer runs."""
    if plan.kind != "observer":
        return []
    return [(float_literal(turn / (plan.pole_pairs * plan.ratio * t_s)), "count_speed")]


def application_context(solution: Solution, plan: ApplicationPlan) -> PlainData:
    """What the templates of the program need."""
    design, gains = solution.design, solution.gains
    start, position = solution.start_up, gains.position
    lines = [
        line
        for label, text in application_rows(plan)
        for line in wrap(f"{label[0].upper()}{label[1:]}: {text}.", 110)
    ]
    return {
        **title(design),
        "preamble": lines,
        "settings": _settings(plan, design.control.t_s),
        "start_up": plan.kind == "start-up",
        "encoder": plan.kind != "start-up",
        "edges": plan.kind == "edges",
        "observed": plan.kind == "observer",
        "code": "" if position is None else position.method.code,
        "low": "" if start is None or start.low is None else start.low.tracker.code,
        "f_sw": format_quantity(design.inverter.f_sw, "Hz"),
        "t_s": format_quantity(design.control.t_s, "s"),
    }


def application_files(solution: Solution, plan: ApplicationPlan) -> dict[str, bytes]:
    """Names and bytes of the program's files."""
    context, prefix = application_context(solution, plan), solution.design.export.prefix
    return {
        f"{prefix}_{name}": render(f"single_headers/application/{name}.j2", context).encode("ascii")
        for name in SUFFIXES
    }


# What is said of the program around the emitted functions.

TITLE = "Program around the functions"


_KINDS = {
    "start-up": "without an encoder, by the start-up",
    "edges": "by an encoder whose edges are captured",
    "counts": "by an encoder that is counted",
    "observer": "by an encoder that is counted, the speed by the observer",
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


# The program around the emitted functions, as a record.


def _parts(_: Solution, plan: ApplicationPlan) -> list[ReportPart]:
    return [Passage(tables=application_html(plan), kind="loops").of(LOOPS)]


APPLICATION = Capability(
    name="application",
    title="program around the functions",
    of=lambda outcome: outcome.solution.application,
    plain=lambda _, plan: plain_application(plan),
    always=False,
    summary=lambda _, plan: application_rows(plan)[:1],
    tables=lambda _, plan: application_tables(plan),
    parts=_parts,
    emitted=application_files,
)
