"""What `dqforge new`, `machines` and `schema` answer: the library of drives,
and the form of a design file.
"""

from __future__ import annotations

import json
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.design.schema import json_schema
from dqforge.machines.errors import InputError
from dqforge.reports.pages.answer import Answer, Files
from dqforge.reports.pages.table import Table

_FILE = "design.yaml"


def answer_new(folder: Path, machine: str | None) -> Answer:
    """A commented design file to start from.

    Raises
    ------
    InputError
        The library has no such drive, or the folder has a design file already.
    """
    content, path = catalogue.template(machine), folder / _FILE
    if path.exists():
        raise InputError(f"{path} exists already and is kept; choose another folder")
    note = f"{path} written; next: dqforge check {path}"
    files = Files({_FILE: content}, "", named=False)
    return Answer(machine or "", (), {"next": f"dqforge check {path}"}, files=files, notes=(note,))


def answer_machines(name: str | None) -> Answer:
    """The drives of the library, or the design file of one."""
    if name is not None:
        text = catalogue.read_text(name).decode("utf-8")
        return Answer(name, (), {"text": text}, notes=(text.removesuffix("\n"),))
    loaded = [(entry, catalogue.load(entry)) for entry in catalogue.names()]
    rows = tuple((entry, design.name, design.about) for entry, design in loaded)
    note = "dqforge new DIR --machine NAME starts from one"
    table = Table("Library drives", ("name", "drive", "about"), rows, (note,))
    drives = [dict(zip(table.columns, row, strict=True)) for row in rows]
    return Answer("", [table], {"machines": drives})


def answer_schema() -> Answer:
    """The JSON Schema of the design file."""
    schema = json_schema()
    return Answer("", (), {"schema": schema}, notes=(json.dumps(schema, indent=1),))
