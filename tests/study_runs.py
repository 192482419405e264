"""Studies of artificial rows run in a folder, and what came out of them as bytes."""

from __future__ import annotations

import hashlib
from pathlib import Path

from dqforge.machines.exploration.study import Study
from dqforge.optimizer.exploration.row_block import RowSource
from dqforge.reports.exploration.contained_rows import EngineSettings, StudyOutcome
from dqforge.reports.exploration.part_store import PartStore, study_header
from dqforge.reports.exploration.run_study import run_study

_STUDY = Study("Artificial rows", "", b"machine: {}\n", "made up", "00")


def opened(folder: Path, source: RowSource) -> PartStore:
    """The store of artificial rows; to be closed."""
    return PartStore.open(folder, study_header(_STUDY, source))


def run_in(
    folder: Path, source: RowSource, settings: EngineSettings | None = None, **asked: object
) -> StudyOutcome:
    """Run rows into a folder, on one worker unless asked otherwise."""
    found = EngineSettings(**asked) if settings is None else settings  # type: ignore[arg-type]
    with opened(folder, source) as store:
        return run_study(source, store, found)


def parts_hash(folder: Path) -> str:
    """SHA-256 over all parts of a folder, in their order, with their names."""
    digest = hashlib.sha256()
    for path in sorted((folder / "parts").iterdir()):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def rows_there(folder: Path) -> list[int]:
    """Index of each row of a folder, in the order of the files."""
    store = PartStore.existing(folder)
    return [part.first + n for part in store.read([]) for n in range(part.count)]
