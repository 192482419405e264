"""The command for studies, called in this process."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dqforge import cli

Call = Callable[..., tuple[int, str, str]]


def explore_call(capsys: pytest.CaptureFixture[str]) -> Call:
    """A function that calls the command: its exit code and what it printed, never a traceback."""

    def called(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            cli.main(["explore", *(str(argument) for argument in arguments)])
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return int(stop.value.code or 0), captured.out, captured.err

    return called
