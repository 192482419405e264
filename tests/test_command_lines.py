"""Command lines that no one would write; `make fuzz-commands` draws as many as time allows."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest
from command_lines import KEPT, Place, commands, drawn, tried


@pytest.fixture
def place(tmp_path: Path) -> Place:
    (tmp_path / "root").mkdir()
    return Place(tmp_path / "root")


def test_every_command_and_option_is_drawn() -> None:
    lines = [*islice(drawn("any"), 4000)]
    missing = {
        (name, option.name)
        for name, command in commands().items()
        for option in command.params
        if option.opts[0].startswith("-")
        and not any(line[0] == name and {*option.opts} & {*line} for line in lines)
    }
    assert {line[0] for line in lines} == {*commands()}
    assert missing == set()


@pytest.mark.parametrize(
    "words",
    [
        ["schema", "-o", "../out/x.json"],
        ["mtpa", "paper001-pmsm-bench", "--speed", "nan rpm"],
        ["machines", "\udcff"],
        ["serve", "--port", "70000"],
        ["explore", "loop", "--first", "-1"],
    ],
)
def test_a_hostile_line_ends_as_documented(words: list[str], place: Place) -> None:
    assert place.tried(words) == ""


def test_what_is_written_elsewhere_is_seen(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(place, "allowed", lambda *_: [])
    assert "elsewhere: ['work/x.json']" in place.tried(["schema", "-o", "x.json"])


@pytest.mark.slow
@pytest.mark.parametrize("line", KEPT.kept())
def test_lines_that_were_not_answered_once_are(line: str, tmp_path: Path) -> None:
    assert tried(line, tmp_path) == ""
