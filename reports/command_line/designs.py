"""Designs by what the command line names: a file, a drive of the library, one to be made."""

from __future__ import annotations

from collections.abc import Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.errors import DqforgeError


NEW_DESIGN, NEW_STUDY = "design.yaml", "study.yaml"  # Names of the files that `dqforge new` makes.

# Designs that the command under way has loaded: its refusals name their place in the file.
_loaded: ContextVar[tuple[Design, ...]] = ContextVar("_loaded", default=())


def load(name: str, settings: Sequence[str] | None = None) -> Design:
    """Load a design file, or a library drive where no such file exists and that is its name.

    Args:
        name: File, or name in the library.
        settings: Keys that are set instead of what the file says, such as ``machine.resistance=12
            mOhm``.

    Raises:
        InputError: There is no such design, or it is wrong.
    """
    from dqforge.machines.design import catalogue, loader
    from dqforge.reports.pages.console import stage

    stage("reading the design")
    from_library = not Path(name).exists() and name in catalogue.names()
    loaded = (catalogue.load if from_library else loader.load_design)(name, settings or ())
    _loaded.set((*_loaded.get(), loaded))
    return loaded


def new_file(folder: Path, name: str) -> Path:
    """A file to be made in a folder; raises `InputError` where there is one of its name."""
    from dqforge.machines.errors import InputError

    path = folder / name
    if path.exists():
        raise InputError(f"{path} exists already and is kept; choose another folder")
    return path


def forget() -> None:
    """Begin a command, of which no design has been loaded."""
    _loaded.set(())


def locate(error: DqforgeError) -> None:
    """Give a refusal its place in the design of the command; of two, each has done so by itself."""
    designs = _loaded.get()
    if len(designs) == 1 and designs[0].places is not None:
        designs[0].places.locate(error)
