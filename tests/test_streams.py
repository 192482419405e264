"""Standard streams that cannot be written: one line and a sensible exit code,
and the output folder is whole.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dqforge.reports.output.folder import find_manifest, sha256
from dqforge.reports.run_folder import MANIFEST

BENCH = "paper001-pmsm-bench"
FULL = Path("/dev/full")

MORE = ("--help", "schema", f"check {BENCH}", f"check {BENCH} --json")

needs_full = pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")


def dqforge(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """A shell command in which ``dqforge`` is this interpreter's."""
    text = command.replace("dqforge", f"'{sys.executable}' -m dqforge.cli")
    return subprocess.run(
        ["bash", "-c", f"set -o pipefail; {text}"],
        cwd=folder,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.thinned
@needs_full
@pytest.mark.parametrize(
    "command",
    ["--version", "--help", f"machines {BENCH}", f"check {BENCH}", f"check {BENCH} --json"],
)
def test_a_full_disk_under_standard_output_is_one_line(command: str, tmp_path: Path) -> None:
    done = dqforge(f"dqforge {command} > /dev/full", tmp_path)
    assert done.stderr == "dqforge: standard output cannot be written: No space left on device\n"
    assert done.returncode == 1


@pytest.mark.slow
@needs_full
def test_files_are_whole_where_standard_output_is_full(tmp_path: Path) -> None:
    done = dqforge(f"dqforge export {BENCH} --no-verify -o out > /dev/full", tmp_path)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    manifest = find_manifest(tmp_path / "out")
    assert manifest is not None
    assert all(
        sha256((tmp_path / "out" / name).read_bytes()) == digest
        for name, digest in manifest.files.items()
    )
    assert (tmp_path / "out" / MANIFEST).exists()


@pytest.mark.parametrize(
    "command", [f"machines {BENCH}", *(pytest.param(more, marks=pytest.mark.slow) for more in MORE)]
)
def test_a_reader_that_leaves_is_no_error(command: str, tmp_path: Path) -> None:
    done = dqforge(f"dqforge {command} | true", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("command", "code"),
    [
        pytest.param(f"check {BENCH} >&-", 0, marks=pytest.mark.slow),
        pytest.param(f"check {BENCH} >&- 2>&-", 0, marks=pytest.mark.slow),
        ("--version >&- 2>&-", 0),
        ("check nowhere 2>&-", 2),
        pytest.param(
            "check nowhere > /dev/full 2> /dev/full", 2, marks=[needs_full, pytest.mark.slow]
        ),
    ],
)
def test_closed_streams_change_nothing_but_the_text(
    command: str, code: int, tmp_path: Path
) -> None:
    done = dqforge(f"dqforge {command}", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")
