"""The one place where an answer is shown: as tables or JSON on stdout, as a figure,
and as files.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.reports.pages.answer import Answer, Files
from dqforge.reports.pages.console import LOADING, QUICK_S, progress, show, stage, status
from dqforge.reports.pages.files import check_figure_path, write_all

if TYPE_CHECKING:
    from dqforge.reports.plain_data import PlainData


def respond(
    command: str,
    ask: Callable[[], Answer],
    json: bool = False,
    plot: Path | None = None,
    out: Path | None = None,
    *,
    bar: str = "",
    silent: bool = False,
) -> int:
    """Ask, and show the answer; its exit code.

    Parameters
    ----------
    command:
        Its name, for JSON.
    ask:
        Reads and computes; names its stages by `dqforge.reports.pages.console.stage`.
    json:
        Whether JSON is printed instead of tables.
    plot:
        File to draw into; refused before anything is computed where it could not be written.
    out:
        Folder for files, where the command writes any.
    bar:
        Name of what moves a bar, for commands that tell the share that is done;
        else a spinner turns.
    silent:
        Whether nothing moves.
    """
    if plot is not None:
        check_figure_path(plot, out)
    moving: AbstractContextManager[object]
    moving = progress(bar) if bar else status(LOADING, after=QUICK_S)
    with nullcontext() if silent else moving:
        answer = ask()
        paths = _write(answer.files, out)
        _draw(answer, plot)
    if json:
        from dqforge.reports.pages.envelope import to_text

        sys.stdout.write(to_text(command, answer.name, answer.plain | _listed(answer.files, out)))
    else:
        _print(answer, paths)
    sys.stdout.flush()
    return answer.exit_code


def _write(files: Files | None, out: Path | None) -> list[Path]:
    if files is None or out is None:
        return []
    stage("writing the files")
    if not files.part:
        return write_all(out, files.contents)
    from dqforge.reports.output.folder import write_output

    return write_output(out, files.part, files.contents, files.design)


def _listed(files: Files | None, out: Path | None) -> PlainData:
    """What was written, with hashes; nothing for commands that write nothing."""
    if files is None or out is None:
        return {}
    from dqforge.reports.output.manifest import sha256

    contents = files.contents.items()
    listed = [{"name": name, "sha256": sha256(content)} for name, content in contents]
    return {"out": str(out), "files": listed}


def _draw(answer: Answer, plot: Path | None) -> None:
    if plot is None or answer.figure is None:
        return
    from dqforge.reports.operating_system.own_process import prepare_drawing
    from dqforge.reports.pages.figures_style import save

    stage("drawing")
    prepare_drawing()
    save(answer.figure(), plot)


def _print(answer: Answer, paths: list[Path]) -> None:
    show(answer.tables)
    lines = list(answer.notes)
    if answer.files is not None and answer.files.named:
        lines.append("written: " + " ".join(str(path) for path in paths))
    sys.stdout.write("".join(f"{line}\n" for line in lines))
