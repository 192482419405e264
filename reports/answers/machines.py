"""What `dqforge machines` answers: the library of drives, by the heads of its files.

Nothing heavy is imported, and no drive is loaded: a list is there at once.
"""

from __future__ import annotations

from dqforge.machines.files.library_files import DESIGNS
from dqforge.reports.pages.answer import Answer, Table


def answer_machines(name: str | None) -> Answer:
    """The drives of the library, or the design file of one."""
    if name is not None:
        text = DESIGNS.read(name).decode("utf-8")
        return Answer(name, (), {"text": text}, notes=(text.removesuffix("\n"),))
    rows = tuple((entry.key, entry.name, entry.about) for entry in DESIGNS.entries())
    note = "dqforge new DIR --machine NAME starts from one"
    table = Table("Library drives", ("name", "drive", "about"), rows, (note,))
    drives = [dict(zip(table.columns, row, strict=True)) for row in rows]
    return Answer("", [table], {"machines": drives})
