"""What a page of `dqforge serve` asks for, computed in a process of its own."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dqforge.machines.design import catalogue
from dqforge.machines.errors import DqforgeError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.records import dataclass
from dqforge.reports import answers

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.reports.pages.answer import Answer

Options = Mapping[str, str]


def _point(options: Options) -> tuple[str | None, str | None]:
    """Speed and torque, None where they are not given."""
    return options.get("speed") or None, options.get("torque") or None


def _check(design: Design, _: Options) -> Answer:
    return answers.check.answer_check(design)


def _mtpa(design: Design, options: Options) -> Answer:
    request = answers.mtpa.Request(*_point(options), None, "svpwm", "0 %")
    return answers.mtpa.answer_mtpa(design, request)


def _tune(design: Design, _: Options) -> Answer:
    return answers.tune.answer_tune(design)


def _losses(design: Design, _: Options) -> Answer:
    chart = None if design.losses is not None else ""
    return answers.losses.answer_losses(design, answers.losses.LossRequest(chart), choice=False)


def _dqy(design: Design, options: Options) -> Answer:
    speed, torque = _point(options)
    return answers.dqy.answer_dqy(design, answers.dqy.WaveformRequest(torque, speed, None, None))


def _simulate(design: Design, _: Options) -> Answer:
    return answers.simulate.answer_simulate(design, None, switched=False)


# What can be asked for, in the order of its buttons.
ASKED: dict[str, Callable[[Design, Options], Answer]] = {
    "check": _check,
    "mtpa": _mtpa,
    "tune": _tune,
    "losses": _losses,
    "dqy": _dqy,
    "simulate": _simulate,
}


@dataclass(frozen=True, slots=True)
class Sent:
    """What a form holds for a new design.

    Args:
        sheet: By the dotted key, what a data sheet says.
        flux_map: Name and content, or None.
        captures: Files of a capture of the back-EMF by their names.
        axes, scale, line_to_line: As the options of `dqforge new`.
    """

    sheet: Mapping[str, str]
    flux_map: tuple[str, bytes] | None
    captures: Mapping[str, bytes]
    axes: str | None
    scale: str | None
    line_to_line: bool


def begun(folder: Path, sent: Sent) -> dict[str, Any]:
    """Files of a new design, and what `dqforge new` says of it; or ``error``, what is wrong.

    What was sent is read outside the folder, which gets nothing before the design is one.
    """
    if not (sent.sheet or sent.flux_map or sent.captures):
        return {"error": "the form is empty; write what the data sheet says"}
    with scratch_folder() as place:
        try:
            answer = answers.library.answer_new(folder, _request(folder, place, sent))
        except DqforgeError as error:
            return {"error": _as_named(str(error), place)}
        assert answer.files is not None
        notes = [_as_named(note, place) for note in answer.notes]
        return {"contents": dict(answer.files.contents), "notes": notes}


def _request(folder: Path, place: Path, sent: Sent) -> answers.library.NewRequest:
    captures = [_laid(place, name, content) for name, content in sent.captures.items()]
    flux_map = None
    if sent.flux_map is not None:
        name, content = sent.flux_map
        there = folder / name
        same = there.is_file() and there.read_bytes() == content
        flux_map = there if same else _laid(place / "map", name, content)
    measured = answers.library.recorded(
        captures, flux_map, sent.axes, sent.scale, line_to_line=sent.line_to_line
    )
    return answers.library.NewRequest(None, None, None, dict(sent.sheet), False, None, *measured)


def _laid(place: Path, name: str, content: bytes) -> Path:
    place.mkdir(exist_ok=True)
    path = place / name
    path.write_bytes(content)
    return path


def _as_named(text: str, place: Path) -> str:
    """A sentence with files as they were named where they came from."""
    return text.replace(f"{place / 'map'}{os.sep}", "").replace(f"{place}{os.sep}", "")


def answered(path: str, kind: str, settings: Sequence[str], options: Options) -> dict[str, Any]:
    """An answer as tables of text, notes, and a figure as SVG; or ``error``, what is wrong.

    Args:
        path: The design file.
        kind: A name in `ASKED`.
        settings: Keys that are set for this answer alone, as by ``--set``.
        options: ``speed`` and ``torque`` as texts with units.
    """
    from dqforge.reports.pages.figures_style import to_svg

    try:
        answer = ASKED[kind](catalogue.load_design(path, settings), options)
        figure = None if answer.figure is None else to_svg(answer.figure())
    except DqforgeError as error:
        return {"error": str(error)}
    tables = [
        {"title": table.title, "columns": table.columns, "rows": table.rows, "notes": table.notes}
        for table in answer.tables
    ]
    return {"tables": tables, "notes": answer.notes, "figure": figure, "name": answer.name}


def files_of(path: str, firmware: str) -> dict[str, Any]:
    """A ZIP archive of headers, or of another firmware's files; or ``error``."""
    try:
        design = catalogue.load_design(path)
        answer = answers.run.answer_export(
            design, verify=True, firmware=[firmware] if firmware else None
        )
    except DqforgeError as error:
        return {"error": str(error)}
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted((answer.files.contents if answer.files else {}).items()):
            archive.writestr(zipfile.ZipInfo(name), content)
    name = f"{design.export.prefix}_{firmware or 'headers'}.zip"
    return {"name": name, "content": packed.getvalue()}


def report_of(path: str) -> dict[str, Any]:
    """The report of a whole run; or ``error``."""
    try:
        answer = answers.run.answer_run(catalogue.load_design(path), verify=True)
    except DqforgeError as error:
        return {"error": str(error)}
    assert answer.files is not None
    return {"content": answer.files.contents["report.html"]}


def warm() -> None:
    """Load what every answer needs, before the first is asked for."""
    import dqforge.reports.pages.figures_style  # noqa: F401

    assert answers.tune is not None
