"""The studies that ship with the package, to start from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.files.library_files import STUDIES

if TYPE_CHECKING:
    from dqforge.machines.exploration.study import Study


def names() -> list[str]:
    """Names of the studies in the library, in alphabetical order."""
    return STUDIES.names()


def read_text(name: str) -> bytes:
    """Bytes of a study in the library; raises `InputError` when there is none of this name."""
    return STUDIES.read(name)


def load(name: str) -> Study:
    """Study from the library; raises `InputError` when there is none of this name."""
    from dqforge.machines.exploration.study_reader import study_of_text

    return study_of_text(read_text(name), STUDIES.source(name))
