"""Commands that are killed, starved or met by another: wholly old or wholly new, and one line."""

from __future__ import annotations

from pathlib import Path

import drawn_cases
import pytest
from faults import COMMANDS, FAULTS, Case, drawn, tried

QUICK = ("schema", "new")


def test_a_case_is_what_its_line_says() -> None:
    cases = list(drawn(2 * len(COMMANDS) * len(FAULTS), "any"))
    assert [str(Case.read(str(case))) for case in cases] == [str(case) for case in cases]
    assert {case.command for case in cases} == {*COMMANDS}
    assert {case.fault for case in cases} == {*FAULTS}


def test_a_few_faults_leave_old_or_new(tmp_path: Path) -> None:
    """Drawn by the commit; `make faults` draws as many as one likes, of all commands."""
    failed = {
        str(case): wrong
        for case in drawn(16, drawn_cases.seed(), QUICK)
        if (wrong := tried(str(case), tmp_path))
    }
    assert failed == {}


@pytest.mark.slow
@pytest.mark.parametrize("command", ["export", "run", "figure", "explore", "table"])
def test_faults_of_a_command_leave_old_or_new(command: str, tmp_path: Path) -> None:
    failed = {
        str(case): wrong
        for case in drawn(2 * len(FAULTS), drawn_cases.seed(), (command,))
        if (wrong := tried(str(case), tmp_path))
    }
    assert failed == {}
