"""Commands that are killed, starved or met by another: wholly old or wholly new, and one line."""

from __future__ import annotations

import signal
from pathlib import Path

import drawn_cases
import pytest
from faults import AT_A_MOMENT, COMMANDS, FAULTS, Case, drawn, tried

from dqforge import cli
from dqforge.reports.command_line.flags import exit_code
from dqforge.reports.operating_system.system import undisturbed

QUICK = ("schema", "new")


def test_a_case_is_what_its_line_says() -> None:
    cases = list(drawn(3 * len(COMMANDS) * len(FAULTS), "any"))
    assert [str(Case.read(str(case))) for case in cases] == [str(case) for case in cases]
    assert {case.command for case in cases} == {*COMMANDS}
    assert {case.fault for case in cases} == {*FAULTS}


@pytest.mark.parametrize(
    ("number", "code", "line"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "ended by SIGTERM")],
)
def test_what_ends_a_command_is_told_and_waits_for_its_files(
    number: int, code: int, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    written = []

    def command() -> None:
        with undisturbed():
            signal.raise_signal(number)
            written.append("all")
        written.append("more")

    assert exit_code(command, lambda _: None) == code
    assert capsys.readouterr().err == f"dqforge: {line}\n"
    assert written == ["all"]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_a_library_makes_of_an_interrupt_is_one(
    number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """CasADi's functions have the wrong arguments where a signal cuts their call off."""

    def command() -> None:
        try:
            signal.raise_signal(number)
        except KeyboardInterrupt:
            raise NotImplementedError from None

    assert exit_code(command, lambda _: None) == 128 + number
    assert capsys.readouterr().err.count("\n") == 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_comes_while_an_object_is_destroyed_is_not_lost(
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Destroyed:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGTERM)

    def command() -> None:
        Destroyed()
        signal.pause()

    assert exit_code(command, lambda _: None) == 143
    assert capsys.readouterr().err == "dqforge: ended by SIGTERM\n"


def test_a_few_faults_leave_old_or_new(tmp_path: Path) -> None:
    """Drawn by the commit; `make faults` draws as many as one likes, of all commands."""
    failed = {
        str(case): wrong
        for case in drawn(16, drawn_cases.seed(), QUICK)
        # What comes at a moment is the campaign's: tests know no time.
        if case.fault not in AT_A_MOMENT and (wrong := tried(str(case), tmp_path))
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


# Writes on a request, what `new` writes and in the same way (tests/reports/browser).
_ON_REQUEST = ("serve",)
_PLACES = {"out", "figures", "csv", "export", "into", "folder"}


def test_every_command_that_writes_is_met_by_faults() -> None:
    """By each option that names a place, and by its figure where it writes nothing else."""
    words = [about.words.split() for about in COMMANDS.values()]
    missing = []
    for name, command in cli._command().commands.items():
        given = {each.name: each.opts for each in command.params}
        places = {key for key in given if key in _PLACES} or {"plot"} & given.keys()
        if name == "verify" or name in _ON_REQUEST:
            continue
        for place in places:
            met = [line for line in words if line[0] == name]
            option = [flag for flag in given[place] if flag.startswith("-")]
            if not any(not option or {*option} & {*line} for line in met):
                missing.append((name, place))
    assert missing == []
