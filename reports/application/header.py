"""The C of the program around the emitted functions, as text."""

from __future__ import annotations

import math
from textwrap import wrap

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.application.application_plan import ApplicationPlan
from dqforge.optimizer.solution import Solution
from dqforge.reports.application.words import application_rows
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.c_code.title import title
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData

SUFFIXES = ("hardware.h", "application.h", "main.c")  # Ends of the names of its files.


def _settings(plan: ApplicationPlan) -> list[tuple[str, str]]:
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
    ]


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
        "settings": _settings(plan),
        "start_up": plan.kind == "start-up",
        "encoder": plan.kind != "start-up",
        "edges": plan.kind == "edges",
        "code": "" if position is None else position.method.code,
        "low": "" if start is None or start.low is None else start.low.tracker.code,
        "f_sw": format_quantity(design.inverter.f_sw, "Hz"),
        "t_s": format_quantity(design.control.t_s, "s"),
    }


def application_files(solution: Solution, plan: ApplicationPlan) -> dict[str, bytes]:
    """Names and bytes of the program's files."""
    context, prefix = application_context(solution, plan), solution.design.export.prefix
    return {
        f"{prefix}_{name}": render(f"application/{name}.j2", context).encode("ascii")
        for name in SUFFIXES
    }
