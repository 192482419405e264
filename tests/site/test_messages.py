"""The messages of the reference are those that the commands print, to the letter."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from message_reference import Message, messages

from dqforge import cli

DESIGN, FAMILIES = messages()
MESSAGES = [message for listed in FAMILIES.values() for message in listed]


def test_every_message_has_one_name() -> None:
    names = [message.name for message in MESSAGES]
    assert len(names) == len(set(names)) >= 40


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
def test_the_message_is_what_the_command_says(
    message: Message,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message.instead_of in DESIGN
    text = DESIGN.replace(message.instead_of, message.written) if message.instead_of else DESIGN
    Path("design.yaml").write_text(text + message.added, encoding="utf-8")
    words = shlex.split(message.command)
    assert words[0] == "dqforge"
    with pytest.raises(SystemExit) as stop:
        cli.main(words[1:])
    captured = capsys.readouterr()
    assert (captured.err, captured.out) == (f"{message.says}\n", "")
    assert stop.value.code == message.code
    assert [path.name for path in tmp_path.iterdir()] == ["design.yaml"]
