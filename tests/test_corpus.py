"""What every reader reads soundly, and what failed once: inputs that a reader did not answer
(`make fuzz`), faults that a command did not withstand (`make faults`), forged folders that were not
found (`make forged`).
"""

from __future__ import annotations

from pathlib import Path

import command_lines
import faults
import forged_folders
import pytest
from fuzz import CORPUS, READERS, seeds, tried

# Commands that compute next to nothing.
QUICK = ("schema", "new")


@pytest.mark.parametrize("reader", READERS)
def test_inputs_are_answered_or_refused(reader: str) -> None:
    for data in (b"", b"\0", b"\xff\xfe", *seeds(reader)):
        tried(reader, data)


def test_kept_inputs_belong_to_a_reader() -> None:
    kept = {path.name for path in CORPUS.iterdir()} if CORPUS.is_dir() else set()
    assert kept <= {*READERS, *(one.KEPT.name for one in (faults, forged_folders, command_lines))}


def _by_default(line: str) -> bool:
    """Whether a line is quick, and its fault comes at a step and not at a moment."""
    return line.startswith(QUICK) and line.split()[1] not in faults.AT_A_MOMENT


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.mark.parametrize(
    "line",
    [
        pytest.param(line, marks=[] if _by_default(line) else [pytest.mark.slow])
        for line in faults.KEPT.kept()
    ],
)
def test_faults_that_did_harm_once_do_none(line: str, place: Path) -> None:
    assert faults.tried(line, place) == ""


@pytest.mark.slow
@pytest.mark.parametrize("line", forged_folders.KEPT.kept())
def test_forged_folders_that_passed_once_are_found(line: str, place: Path) -> None:
    assert forged_folders.found(line, place)
