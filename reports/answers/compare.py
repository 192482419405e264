"""What `dqforge compare` answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dqforge.machines.design.catalogue import OPTION
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.reports.command_line.designs import load
from dqforge.reports.comparison.sides_compared import (
    compare_sides,
    comparison_tables,
    plain_comparison,
)
from dqforge.reports.comparison.sources import firmware_side, is_written, read_side
from dqforge.reports.pages.answer import Answer, stage


def answer_compare(first: str, second: str, settings: Sequence[str] | None = None) -> Answer:
    """Compare two designs or results.

    Args:
        first, second: Designs, what an earlier run wrote, or the configuration of another firmware.
        settings: Keys of the second, as those of `load`: what changes with them if both are the
            same.

    Raises:
        InputError: As `read_side`; or keys are set of what an earlier run wrote.
    """

    def load_second(name: str) -> Design:
        return load(name, settings)

    stage("reading the files")
    theirs = firmware_side(second)
    if settings and (theirs is not None or is_written(second)):
        raise InputError(
            f"{OPTION} changes a design, and {second!r} is what a run wrote; give its design as B"
        )
    ours = firmware_side(first)
    b = read_side(second, load_second) if theirs is None else theirs
    said = " ".join([second, *(f"{OPTION} {setting}" for setting in settings or ())])
    a = read_side(first, load) if ours is None else ours
    stage("comparing")
    found = compare_sides(a, replace(b, source=said))
    names = f"{found.a.name} | {found.b.name}"
    return Answer(names, comparison_tables(found), {"comparison": plain_comparison(found)})
