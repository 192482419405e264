"""What `dqforge new`, `machines` and `schema` answer: the library of drives,
and the form of a design file.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.design.schema import json_schema
from dqforge.machines.errors import InputError
from dqforge.reports.firmware_files.design_made import design_from_files
from dqforge.reports.firmware_files.plain import plain_configuration
from dqforge.reports.pages.answer import Answer, Files
from dqforge.reports.pages.table import Table

_FILE = "design.yaml"


def answer_new(
    folder: Path,
    machine: str | None,
    files: Sequence[Path] | None = None,
    settings: Sequence[str] | None = None,
) -> Answer:
    """A commented design file to start from: of the library, or of files of other firmware.

    Raises
    ------
    InputError
        The library has no such drive, or the folder has a design file already; or as
        `answer_new_from`.
    """
    if files:
        if machine is not None:
            raise InputError("--machine: leave it out with --from, which says what machine it is")
        return answer_new_from(folder, files, settings)
    if settings:
        raise InputError("--set: goes with --from; edit the design file that is written instead")
    content, path = catalogue.template(machine), folder / _FILE
    if path.exists():
        raise InputError(f"{path} exists already and is kept; choose another folder")
    note = f"{path} written; next: dqforge check {path}"
    made = Files({_FILE: content}, "", named=False)
    return Answer(machine or "", (), {"next": f"dqforge check {path}"}, files=made, notes=(note,))


def answer_new_from(
    folder: Path, files: Sequence[Path], settings: Sequence[str] | None = None
) -> Answer:
    """A design file from the configuration that files of a firmware hold.

    Parameters
    ----------
    folder:
        Folder to make; it gets a file design.yaml.
    files:
        Files of one firmware.
    settings:
        Keys that the files do not say, or that shall be others, as those of ``--set``.

    Raises
    ------
    InputError
        A file is of no known firmware, a value in it is none that a design can have, or the folder
        has a design file already.
    """
    path = folder / _FILE
    if path.exists():
        raise InputError(f"{path} exists already and is kept; choose another folder")
    made = design_from_files(files, settings or ())
    notes = [f"{path} written, from {', '.join(file.name for file in files)}"]
    notes += [f"contradiction: {sentence}" for sentence in made.configuration.contradictions]
    notes += [
        f"missing: {key}; write it, or give --set {key}='{example}'"
        for key, example in (*made.missing, *made.wanted)
    ]
    notes.append(f"next: dqforge {'check' if made.missing else 'tune'} {path}")
    plain = {
        "next": f"dqforge check {path}",
        "missing": [key for key, _ in made.missing],
        "wanted": [key for key, _ in made.wanted],
        "configuration": plain_configuration(made.configuration),
    }
    contents = Files({_FILE: made.text.encode("utf-8")}, "", named=False)
    return Answer(made.configuration.name, (), plain, files=contents, notes=tuple(notes))


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
