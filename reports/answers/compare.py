"""What `dqforge compare` answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dqforge.machines.design.design import Design
from dqforge.machines.design.overrides import OPTION
from dqforge.machines.errors import InputError
from dqforge.reports.command_line.designs import load
from dqforge.reports.comparison.sides_compared import compare_sides
from dqforge.reports.comparison.sources import is_written, read_side
from dqforge.reports.comparison.tables import comparison_tables, plain_comparison
from dqforge.reports.pages.answer import Answer
from dqforge.reports.pages.console import stage


def answer_compare(first: str, second: str, settings: Sequence[str] | None = None) -> Answer:
    """Compare two designs or results.

    Parameters
    ----------
    first, second:
        Designs, or what an earlier run wrote.
    settings:
        Keys of the second, as those of `load`: what changes with them if both are the same.

    Raises
    ------
    InputError
        As `read_side`; or keys are set of what an earlier run wrote.
    """

    def load_second(name: str) -> Design:
        return load(name, settings)

    stage("solving")
    if settings and is_written(second):
        raise InputError(
            f"{OPTION} changes a design, and {second!r} is what a run wrote; give its design as B"
        )
    b = read_side(second, load_second)
    said = " ".join([second, *(f"{OPTION} {setting}" for setting in settings or ())])
    found = compare_sides(read_side(first, load), replace(b, source=said))
    names = f"{found.a.name} | {found.b.name}"
    return Answer(names, comparison_tables(found), {"comparison": plain_comparison(found)})
