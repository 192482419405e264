"""Files of other firmware in an output folder, read back and held against what the design gives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.reports.firmware_files.exported import firmware_files, read_back, target_named
from dqforge.reports.pages.files import read_output

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution

_WRITTEN = "the folder that 'dqforge run' or 'dqforge export' wrote"


def written_firmware(folder: Path, solution: Solution) -> dict[str, tuple[str, ...]]:
    """By firmware the files in a folder that read back as the configuration of the design.

    Args:
        folder: What 'dqforge run' or 'export' wrote.
        solution: What the design in the folder gives.

    Raises:
        InputError: A file cannot be read, or is not what its firmware writes.
        VerificationError: A file says something else.
    """
    found: dict[str, tuple[str, ...]] = {}
    for fit in solution.firmware:
        names = firmware_files(solution.design, fit)
        contents = {name: read_output(folder / name, _WRITTEN) for name in names}
        found[fit.name] = read_back(contents, fit.configuration, target_named(fit))
    return found


def read_back_text(name: str, files: Sequence[str]) -> str:
    """What was read back, in one line."""
    return f"{name}: {', '.join(files)} read back as the configuration that the design gives"
