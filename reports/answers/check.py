"""What `dqforge check` answers: every value with its origin, and what was assumed."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.design import Design
from dqforge.machines.design.overrides import OPTION
from dqforge.optimizer.current_reference.integer_form import FIXED_WIDTHS
from dqforge.optimizer.dynamic_references.voltage_feedback import require_feedback
from dqforge.optimizer.fixed_control.design import require_scales
from dqforge.reports.pages.answer import Answer
from dqforge.reports.result import plain_design
from dqforge.reports.summary import check_tables


def answer_check(design: Design) -> Answer:
    """List what was read.

    Raises
    ------
    InputError
        The bases of fixed-point control do not hold the largest values, or the voltage feedback
        of the references has nothing to do or turns the flux.
    """
    require_feedback(design)
    if set(design.export.control) & set(FIXED_WIDTHS):
        require_scales(design)
    first, *others = check_tables(design)
    options = () if design.places is None else dict.fromkeys(design.places.options.values())
    keys = tuple(option.removeprefix(f"{OPTION} ") for option in options)
    if keys:
        first = replace(first, notes=(f"set on the command line: {', '.join(keys)}", *first.notes))
    plain = {"input": plain_design(design)} | ({"set": list(keys)} if keys else {})
    return Answer(design.name, [first, *others], plain)
