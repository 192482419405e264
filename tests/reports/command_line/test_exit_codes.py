"""How a command ends where a system speaks another language than this one."""

from __future__ import annotations

import errno
import sys

import pytest

from dqforge.reports.command_line import flags as exit_codes
from dqforge.reports.operating_system import system


@pytest.mark.parametrize(
    ("windows", "error", "code"),
    [
        (True, OSError(errno.EINVAL, "Invalid argument"), 0),
        (False, OSError(errno.EINVAL, "Invalid argument"), 1),
        (True, OSError(errno.EINVAL, "Invalid argument", "a<b.h"), 1),
        (True, OSError(errno.ENOSPC, "No space left on device"), 1),
    ],
)
def test_a_reader_that_has_left_is_no_fault(
    windows: bool,
    error: OSError,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Windows has no broken pipe: to write into one is an invalid argument."""

    def fails() -> None:
        raise error

    monkeypatch.setattr(system, "WINDOWS", windows)
    monkeypatch.setattr(exit_codes, "_drop_output", lambda: None)
    assert exit_codes.exit_code(fails, lambda _: None) == code
    assert bool(capsys.readouterr().err) == bool(code)
    assert sys.stdout is not None


@pytest.mark.parametrize("number", [errno.ECONNRESET, errno.EAGAIN, errno.EPIPE, None])
def test_only_files_and_disks_are_called_full(
    number: int | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails() -> None:
        raise OSError("lost") if number is None else ConnectionError(number, "lost")

    monkeypatch.setattr(exit_codes, "_drop_output", lambda: None)
    assert exit_codes.exit_code(fails, lambda _: None) == 1
    assert "disk" not in capsys.readouterr().err
