"""Folders for a while: gone afterwards, whatever refuses to let them go or cuts it off."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from dqforge.machines.files.scratch import cleared_up, scratch_folder


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


class Trouble:
    """Raises when files are removed, so many times."""

    def __init__(self, error: BaseException, times: int) -> None:
        self.error, self.times, self.remove = error, times, os.unlink

    def __call__(self, *given: Any, **named: Any) -> None:
        if self.times:
            self.times -= 1
            raise self.error
        self.remove(*given, **named)


def filled(folder: Path) -> None:
    (folder / "below").mkdir()
    (folder / "below" / "file").write_text("one", encoding="ascii")
    (folder / "other").write_text("two", encoding="ascii")


def test_it_goes_with_all_that_it_holds_also_after_an_error(place: Path) -> None:
    def fails() -> None:
        with scratch_folder() as folder:
            filled(folder)
            assert folder.stat().st_mode & 0o777 == 0o700
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    assert [*place.iterdir()] == []


@pytest.mark.parametrize("times", [1, 2])
def test_a_removal_that_is_refused_is_tried_again(
    times: int, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "unlink", Trouble(OSError(5, "Input/output error"), times))
    with scratch_folder() as folder:
        filled(folder)
    assert [*place.iterdir()] == []


@pytest.mark.parametrize("times", [1, 2])
def test_a_removal_that_is_cut_off_is_finished_and_told(
    times: int, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "unlink", Trouble(KeyboardInterrupt(), times))
    with pytest.raises(KeyboardInterrupt), scratch_folder() as folder:
        filled(folder)
    assert [*place.iterdir()] == []


def test_what_refuses_for_long_goes_at_the_end_of_the_command(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with cleared_up():
        with monkeypatch.context() as patched:
            patched.setattr(shutil, "rmtree", lambda *_, **__: None)
            with scratch_folder() as folder:
                filled(folder)
        assert [*place.iterdir()] == [folder]
    assert [*place.iterdir()] == []


def test_what_is_left_goes_at_the_end_of_the_process_that_made_it(place: Path) -> None:
    code = (
        "import os, sys\n"
        "from dqforge.machines.files.scratch import scratch_folder\n"
        "held = scratch_folder()\n"
        "folder = held.__enter__()\n"
        "if os.fork() == 0:\n"
        "    sys.exit()\n"
        "os.wait()\n"
        "sys.stdout.write(str(folder.is_dir()))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"TMPDIR": str(place)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert (done.stdout, done.stderr) == ("True", "")
    assert [*place.iterdir()] == []
