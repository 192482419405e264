"""Signs of life on a terminal: only there, only for work that takes its time, and one at a time."""

from __future__ import annotations

import io
import sys
import time

import pytest

from dqforge.reports.pages.answer import Table, progress, show, status


class Terminal(io.StringIO):
    """A standard error that a person looks at."""

    def isatty(self) -> bool:
        return True


def looked_at(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """A terminal in place of standard error, from within the test: a fixture's would be captured
    again.
    """
    found = Terminal()
    monkeypatch.setattr(sys, "stderr", found)
    monkeypatch.setenv("TERM", "xterm")
    return found


def shown(terminal: Terminal, text: str) -> bool:
    """Whether a text appears within some seconds."""
    end = time.monotonic() + 120.0
    while text not in terminal.getvalue() and time.monotonic() < end:
        time.sleep(0.01)
    return text in terminal.getvalue()


def test_quick_work_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = looked_at(monkeypatch)
    with status("reading", after=60.0):
        pass
    assert terminal.getvalue() == ""


def test_work_that_takes_its_time_is_seen_and_leaves_no_trace_of_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = looked_at(monkeypatch)
    with status("reading", after=0.02):
        assert shown(terminal, "reading")
    with status("solving"):
        assert shown(terminal, "solving")


def test_within_another_sign_of_life_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = looked_at(monkeypatch)
    with status("outer"), status("inner"), progress("bar") as report:
        assert report is None
        assert shown(terminal, "outer")
    assert "inner" not in terminal.getvalue()
    with progress("bar") as report:
        assert report is not None
        report(0.5)
    assert "bar" in terminal.getvalue()


def test_a_pipe_stays_silent(capsys: pytest.CaptureFixture[str]) -> None:
    with status("reading"), progress("bar") as report:
        assert report is None
    assert capsys.readouterr().err == ""


def test_an_error_ends_the_sign_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = looked_at(monkeypatch)
    with pytest.raises(ValueError, match="wrong"), status("reading"):
        raise ValueError("wrong")
    with progress("bar") as report:
        assert report is not None
    assert "bar" in terminal.getvalue()


def test_words_are_not_broken(capsys: pytest.CaptureFixture[str]) -> None:
    """A name beside columns of several words keeps its line, the longest one too."""
    sentence = "one two three four five six " * 4
    for name in ("symmetrical-optimum", "x" * 200):
        rows = tuple((name, sentence, sentence, "1.5") for _ in range(2))
        show([Table("title", ("method", "first words", "second words", "M_s"), rows, ())])
        lines = capsys.readouterr().out.splitlines()
        assert sum(name in line for line in lines) >= len(rows)
        assert max(len(line) for line in lines if name not in line) <= max(160, len(name) + 24)
        words = "\n".join(lines).split()
        assert words.count("six") == 4 * 2 * len(rows)
