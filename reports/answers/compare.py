"""What `dqforge compare` and `dqforge explain` answer."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dqforge.machines.design.catalogue import OPTION
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import DriveValues
from dqforge.optimizer.firmware.firmware_method import drive_values
from dqforge.optimizer.firmware.solve import explain, explain_own, on_machine
from dqforge.reports.command_line.designs import load
from dqforge.reports.comparison.sides_compared import (
    compare_sides,
    comparison_tables,
    is_own,
    own_gains,
    plain_comparison,
)
from dqforge.reports.comparison.sources import firmware_side, is_written, read_side
from dqforge.reports.firmware.design_made import known_files, read_configuration, recognised
from dqforge.reports.firmware.target import TextFile, read_text_file
from dqforge.reports.firmware.written_files import (
    explained_tables,
    own_tables,
    plain_drive_values,
    plain_explained,
    plain_loops,
    plain_pi,
)
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


# What `dqforge explain` answers: what a file amounts to in its firmware's loops.

_MADE_HERE = "made by dqforge"
_HEAD = 2000  # Characters at the begin of a file in which it says who made it.


def answer_explain(files: Sequence[Path], machine: str | None) -> Answer:
    """What the configuration in files of a firmware, or a header or result of ours, amounts to.

    Args:
        files: One, or several of one firmware.
        machine: The design (a file, or a name of the library) whose machine it runs on, in place of
            the one that it tells of.

    Raises:
        InputError: A file is of no known firmware, or not what that writes.
    """
    if not files:
        raise InputError("explain: no file is named; write the file of a firmware")
    values = None if machine is None else drive_values(load(machine))
    stage("reading the files")
    if len(files) == 1:
        if files[0].is_dir():
            return _own(str(files[0]), values)
        first = read_text_file(files[0])
        if recognised(first) is None:
            return _own_or_refused(first, values)
    configuration, read = read_configuration(files)
    target = recognised(read[0])
    assert target is not None
    found = explain(configuration, values)
    source = ", ".join(Path(file.source).name for file in read)
    tables = explained_tables(found, source, target.title)
    return Answer(configuration.name, tables, {"explained": plain_explained(found)})


# A design file has both sections, at the beginning of a line.
_DESIGN = re.compile(r"(?ms)^machine:(?=.*^inverter:)|^inverter:(?=.*^machine:)")


def _own_or_refused(file: TextFile, machine: DriveValues | None) -> Answer:
    if is_own(file):
        return _own(file.source, machine)
    if _MADE_HERE in file.text[:_HEAD].lower():
        raise InputError(
            "is a file of dqforge without the constants of the loops; give <prefix>.h or the "
            "result.json beside it",
            source=file.source,
        )
    if _DESIGN.search(file.text):
        raise InputError(
            f"this is a dqforge design; write 'dqforge check {file.source}'", source=file.source
        )
    raise InputError(
        f"no known firmware writes this; known: {known_files()}; header and result.json of dqforge",
        source=file.source,
    )


def _own(source: str, machine: DriveValues | None) -> Answer:
    """What gains that dqforge wrote amount to."""
    side = read_side(source, _no_design)
    gains = own_gains(side)
    judged = explain_own(gains, machine)
    on = replace(gains, drive=on_machine(gains.drive, machine))
    plain = {
        "explained": {
            "configuration": None,
            "machine": plain_drive_values(on.drive),
            "current_d": plain_pi(gains.current_d),
            "current_q": plain_pi(gains.current_q),
            "speed": plain_pi(gains.speed),
            "loops": plain_loops(judged),
        }
    }
    return Answer(side.name, own_tables(on, judged, source), plain)


def _no_design(name: str) -> Design:
    raise InputError(
        "is neither a file of a firmware nor a header or result of dqforge", source=name
    )
