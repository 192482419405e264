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
from dqforge.reports.pages.files import OUT, check_figure_path, write_all

if TYPE_CHECKING:
    from dqforge.reports.output.folder import Written
    from dqforge.reports.plain_data import PlainData


def respond(
    command: str,
    ask: Callable[[], Answer],
    json: bool = False,
    plot: Path | None = None,
    out: Path | None = None,
    *,
    default: bool = False,
    bar: str = "",
    silent: bool = False,
) -> int:
    """Ask, and show the answer; its exit code.

    Args:
        command: Its name, for JSON.
        ask: Reads and computes; names its stages by `dqforge.reports.pages.console.stage`.
        json: Whether JSON is printed instead of tables.
        plot: File to draw into; refused before anything is computed where it could not be written.
        out: Folder for files, where the command writes any; None for none.
        default: Whether files go into the folder of their design where ``out`` is None.
        bar: Name of what moves a bar, for commands that tell the share that is done; else a spinner
            turns.
        silent: Whether nothing moves.
    """
    if plot is not None:
        check_figure_path(plot, Path(OUT) if default and out is None else out)
    moving: AbstractContextManager[object]
    moving = progress(bar) if bar else status(LOADING, after=QUICK_S)
    with nullcontext() if silent else moving:
        answer = ask()
        out = _default(answer.files) if default and out is None else out
        written = _write(answer.files, out)
        _draw(answer, plot)
    if json:
        from dqforge.reports.pages.envelope import to_text

        listed = _listed(answer.files, out, written)
        sys.stdout.write(to_text(command, answer.name, answer.plain | listed))
    else:
        _print(answer, written, out)
    sys.stdout.flush()
    return answer.exit_code


def _default(files: Files | None) -> Path | None:
    if files is None or files.design is None:
        return None
    from dqforge.reports.output.folder import default_folder

    return default_folder(files.design)


def _write(files: Files | None, out: Path | None) -> Written | None:
    if files is None or out is None:
        return None
    stage("writing the files")
    from dqforge.reports.output.folder import Written, put_output

    if files.part:
        return put_output(
            out,
            files.part,
            files.contents,
            files.design,
            options=files.options,
            given=files.given,
        )
    there = tuple(name for name in files.contents if (out / name).exists())
    return Written(write_all(out, files.contents), there)


def _listed(files: Files | None, out: Path | None, written: Written | None) -> PlainData:
    """What was written, with hashes; nothing for commands that write nothing."""
    if files is None or out is None or written is None:
        return {}
    from dqforge.reports.output.manifest import sha256

    contents = files.contents.items()
    listed = [{"name": name, "sha256": sha256(content)} for name, content in contents]
    changed = {"replaced": written.replaced, "removed": written.removed, "kept": written.kept}
    named = {key: list(names) for key, names in changed.items() if names}
    return {"out": str(out), "files": listed} | named


def _draw(answer: Answer, plot: Path | None) -> None:
    if plot is None or answer.figure is None:
        return
    from dqforge.reports.operating_system.own_process import prepare_drawing
    from dqforge.reports.pages.figures_style import save

    stage("drawing")
    prepare_drawing()
    save(answer.figure(), plot)


def _print(answer: Answer, written: Written | None, out: Path | None) -> None:
    show(answer.tables)
    lines = list(answer.notes)
    if written is not None:
        if answer.files is not None and answer.files.named:
            lines.append("written: " + " ".join(str(path) for path in written.paths))
        changed = (
            ("replaced", written.replaced),
            ("removed, as this run no longer writes it", written.removed),
            ("kept, of the design as it was before", written.kept),
        )
        lines += [f"{what}: {' '.join(names)}" for what, names in changed if names]
        if answer.files is not None and answer.files.follow:
            lines.append(f"next: {answer.files.follow.format(out=out)}")
    sys.stdout.write("".join(f"{line}\n" for line in lines))
