"""What every command returns: tables and lines for people, plain data for programs, a figure,
and files.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, WritingError
from dqforge.machines.files.input_files import read_regular_file
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


# Writing results: whole or not at all.

OUT = "out"  # Folder in which those of designs and studies are made where none is named.
LARGEST_FILE = 64_000_000  # Bytes of the largest file that dqforge writes, many times over.

# Bytes of the largest JSON that is read: once decoded it takes some twenty times as much memory.
LARGEST_JSON = 16_000_000


def read_output(path: Path, wanted: str, most_bytes: int = LARGEST_FILE) -> bytes:
    """A file that dqforge wrote.

    ``wanted`` says in the message what to give instead of one that cannot be read.

    Raises:
        InputError: The file cannot be read, is no regular file, or is far larger than anything that
            dqforge writes.
    """
    try:
        return read_regular_file(path, most_bytes)
    except InputError as error:
        reason = error.message.partition(";")[0]
        raise InputError(f"cannot be read ({reason}); give {wanted}", source=str(path)) from None


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file through a temporary one beside it: flushed to disk, then renamed over the
    target.

    Raises:
        InputError: The folder cannot be written.
    """
    temporary = _beside(path, content)
    try:
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise _refusal(path, error) from error


def _refusal(path: Path, error: OSError) -> InputError:
    return WritingError(f"cannot write {path}: {error.strerror}; choose another file with -o")


def _beside(path: Path, content: bytes) -> Path:
    """A temporary file beside a path with its content, flushed to disk."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise WritingError(
            f"cannot write {path}: {error.strerror}; choose another folder with -o"
        ) from error
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.chmod(0o644)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise _refusal(path, error) from error
    return temporary


FIGURE_SUFFIXES = (".svg", ".png", ".pdf", ".csv")


def check_figure_path(path: Path, made: Path | None = None) -> None:
    """Refuse a figure's file name before anything is computed for it.

    Args:
        path: The file.
        made: A folder that will be there by the time the figure is written.

    Raises:
        InputError: The suffix is not .svg, .png, .pdf or .csv, or the folder is not there.
    """
    if path.suffix.lower() not in FIGURE_SUFFIXES:
        got = f"the suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise InputError(
            f"a figure is written as .svg, .png or .pdf, its data as .csv; {path.name!r} has {got}"
        )
    if not path.parent.is_dir() and path.parent != made:
        raise InputError(
            f"cannot write {path}: there is no folder {path.parent}; make it, or choose another "
            "file"
        )


def write_all(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    """Write several files into a folder, which is made if missing.

    Nothing is replaced before all of them lie beside their places, flushed to disk.

    Raises:
        InputError: The folder cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WritingError(
            f"cannot make the folder {folder}: {error.strerror}; choose another one with -o"
        ) from error
    paths = [folder / name for name in contents]
    made: list[Path] = []
    try:
        for path, content in zip(paths, contents.values(), strict=True):
            if path.is_dir():
                raise WritingError(f"cannot write {path}: it is a folder; choose another with -o")
            made.append(_beside(path, content))
        for temporary, path in zip(made, paths, strict=True):
            temporary.replace(path)
    except OSError as error:
        raise _refusal(folder, error) from error
    finally:
        for temporary in made:
            temporary.unlink(missing_ok=True)
    return paths
