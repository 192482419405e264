"""What every command returns: tables and lines for people, plain data for programs, a figure,
and files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqforge.machines.design.design import Design
    from dqforge.reports.pages.table import Table
    from dqforge.reports.plain_data import PlainData


@dataclass(frozen=True, slots=True)
class Files:
    """Files that a command writes.

    Args:
        contents: Bytes by name.
        part: The part of an output folder that they are (`dqforge.reports.output.folder`); empty
            for files that are put into a folder without a list of hashes.
        design: What they were made from, None where that is no design.
        named: Whether their paths are printed behind the tables.
        options: Options of the command on which the files depend, for `dqforge verify`.
        given: Further files that they were made from, by name.
        follow: What to do next with them, ``{out}`` for their folder.
    """

    contents: Mapping[str, bytes]
    part: str
    design: Design | None = None
    named: bool = True
    options: Mapping[str, str] = field(default_factory=dict)
    given: Mapping[str, bytes] = field(default_factory=dict)
    follow: str = ""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer of a command, not yet shown.

    Args:
        name: What was asked about: the design, a paper, a capture.
        tables: For the terminal.
        plain: For ``--json``, by the keys of docs/reference/json.md.
        figure: Draws the figure of ``--plot``; None where there is none.
        files: To be written; None where there are none.
        notes: Lines for the terminal, behind the tables.
        exit_code: With which the command ends.
    """

    name: str
    tables: Sequence[Table]
    plain: PlainData
    figure: Callable[[], Figure] | None = None
    files: Files | None = None
    notes: tuple[str, ...] = ()
    exit_code: int = 0
