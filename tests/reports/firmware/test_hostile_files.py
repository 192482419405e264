"""Files of every firmware, cut off, changed and made hostile: read, or refused in one line."""

from __future__ import annotations

import os
import random
import re
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import pytest
from firmware_files import scooter, scooter_files, scooter_fit

from dqforge import cli
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.firmware.solve import FirmwareFit, explain
from dqforge.reports.firmware.design_made import design_from_files, design_of, read_file, recognised
from dqforge.reports.firmware.target import TARGETS, decoded_file, read_text_file
from dqforge.reports.firmware.written_files import firmware_files

FIRMWARE = tuple(name for name, _ in TARGETS.items())  # loaded before the network is refused
STEPS = 40
CHANGES = 12


@pytest.fixture(autouse=True)
def without_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever opens a connection fails."""

    def refused(*_: Any, **__: Any) -> NoReturn:
        raise AssertionError("a file was asked for over a network")

    monkeypatch.setattr(socket, "socket", refused)


def outcome(content: bytes, name: str, *, judged: bool = False) -> str:
    """What becomes of a file: a word, or the one line that refuses it; anything else raises."""
    try:
        file = decoded_file(content, name)
        target = recognised(file)
        if target is None:
            return "unknown"
        found = read_file(target, file)
        design_of(found, [name])
        if judged:
            explain(found)
    except InputError as error:
        message = str(error)
        assert "\n" not in message
        assert message.startswith(name)
        return message
    return "read"


@pytest.mark.parametrize("name", FIRMWARE)
def test_whole_files_are_read(name: Any) -> None:
    """At least one file of each firmware is known by its reader, whatever it is called."""
    files = scooter_files(name).items()
    found = [outcome(content, file, judged=True) for file, content in files]
    assert "read" in found
    assert set(found) <= {"read", "unknown"}


@pytest.mark.parametrize("name", FIRMWARE)
def test_files_that_are_cut_off_are_read_or_refused(name: Any) -> None:
    for file, content in scooter_files(name).items():
        step = max(1, len(content) // STEPS)
        outcomes = {outcome(content[:end], file) for end in range(0, len(content), step)}
        assert len(outcomes) > 1


NUMBER = re.compile(rb"(?<![\w.])[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w.])")
INSTEAD = [b"inf", b"-inf", b"nan", b"1e309", b"1" + b"0" * 400, b"1e300", b"1e-300", b"0", b"-1"]
INSTEAD += [b"", b"text", b"0.5"]
PLACED = re.compile(r"(.+?):(\d+)(:\d+)?: .+", re.ASCII)


def mutants(content: bytes, generator: random.Random, count: int) -> list[bytes]:
    """A file with one of its numbers replaced, or a line left out, doubled or cut, or its end."""
    found, numbers, lines = [], [*NUMBER.finditer(content)], content.split(b"\n")
    for _ in range(count):
        start, end = generator.choice(numbers).span()
        found.append(content[:start] + generator.choice(INSTEAD) + content[end:])
        k = generator.randrange(len(lines))
        half = lines[k][: len(lines[k]) // 2]
        instead = generator.choice([[], [lines[k]] * 2, [half]])
        behind = [] if generator.random() < 0.2 else lines[k + 1 :]
        found.append(b"\n".join([*lines[:k], *instead, *behind]))
    return found


@pytest.mark.parametrize("count", [2, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FIRMWARE)
def test_refusals_name_file_and_line(name: Any, count: int, tmp_path: Path) -> None:
    """Whatever became of a file, `new --from` and `export --into` read it, or say in one line where
    and what is wrong, and what to write.
    """
    generator, fit = random.Random(f"{name} {count}"), scooter_fit(name)
    for file, content in scooter_files(name).items():
        path = tmp_path / file
        for mutant in [*INJURED.get(file, ()), *mutants(content, generator, count)]:
            path.write_bytes(mutant)
            for read in (new_from, into):
                said = refusal(read, path, fit)
                placed = PLACED.fullmatch(said)
                assert placed is not None or not said, said
                if placed is not None:
                    assert placed[1] == str(path)
                    assert 1 <= int(placed[2]) <= mutant.count(b"\n") + 1
                    assert re.search(r"; |expected|give |write ", said), said


def refusal(read: Callable[[Path, FirmwareFit], None], path: Path, fit: FirmwareFit) -> str:
    """What a reader says against a file, "" where it takes it."""
    try:
        read(path, fit)
    except InputError as error:
        return str(error)
    return ""


def new_from(path: Path, fit: FirmwareFit) -> None:
    del fit
    made = design_from_files([path])
    if made.missing:
        design_from_files([path], [f"{key}={example}" for key, example in made.missing])


def into(path: Path, fit: FirmwareFit) -> None:
    with suppress(VerificationError):  # which says that the file keeps something else
        firmware_files(scooter(), fit, read_text_file(path))


# What reached a user without a line, or ended in an OverflowError.
INJURED: dict[str, list[bytes]] = {
    "scooter_params.h": [
        b"#ifdef A\nparams.motor.P = 8.0f;\n",
        b"params.motor.P = 1" + b"0" * 400 + b";\n",
    ],
    "scooter_mcconf.h": [b"#define MCCONF_FOC_MOTOR_R 1" + b"0" * 400 + b"\n"],
    "scooter_mcconf.xml": [
        b"<MCConfiguration>\n<foc_f_zv>1e-309</foc_f_zv>\n</MCConfiguration>",
    ],
}


@pytest.mark.parametrize("changes", [CHANGES, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FIRMWARE)
def test_files_that_are_changed_are_read_or_refused(name: Any, changes: int) -> None:
    """Bytes overwritten, lines doubled, lines left out and numbers made absurd; in the campaign
    their loops are judged, too.
    """
    judged, generator = changes > CHANGES, random.Random(3)
    absurd = [b"1e308", b"-1e308", b"nan", b"0", b"-1", b"1e-300", b"x", b"", b"9" * 400, b"{}"]
    for file, content in scooter_files(name).items():
        for _ in range(changes):
            changed = bytearray(content)
            for _ in range(generator.randrange(1, 4)):
                changed[generator.randrange(len(changed))] = generator.randrange(256)
            outcome(bytes(changed), file, judged=judged)
            lines = content.split(b"\n")
            place = generator.randrange(len(lines))
            outcome(b"\n".join(lines[:place] + lines[place + 1 :]), file, judged=judged)
            outcome(b"\n".join([*lines[:place], lines[place], *lines[place:]]), file, judged=judged)
            numbers = [k for k in range(len(content)) if content[k : k + 1].isdigit()]
            at = generator.choice(numbers)
            outcome(
                content[:at] + generator.choice(absurd) + content[at + 1 :], file, judged=judged
            )


LAUGHS = '<!DOCTYPE l [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;">]>\n<{root}>&b;</{root}>'
HOSTILE: dict[str, bytes] = {
    "laughs.xml": LAUGHS.format(root="MCConfiguration").encode(),
    "laughs.stmcx": LAUGHS.format(root="system").encode(),
    "outside.xml": b'<!DOCTYPE a SYSTEM "http://127.0.0.1/a"><MCConfiguration/>',
    "deep.json": b"[" * 100_000,
    "deep.xml": b"<MCConfiguration>" + b"<a>" * 100_000,
    "keys.json": b'{"axis0": {"motor": {"config": []}}}',
    "numbers.json": b'{"axis0": {"motor": {"config": {"pole_pairs": "x"}}}}',
    "number.json": b"5",
    "text.json": b'"axis0"',
    "twice.h": b"#define M1_PMSM 1\n" * 30_000,
    "grows.h": b"".join(
        b"#define MCCONF_FOC_MOTOR_%d MCCONF_FOC_MOTOR_%d MCCONF_FOC_MOTOR_%d\n" % (k, k + 1, k + 1)
        for k in range(100)
    ),
    "binary.h": bytes(range(256)) * 100,
    "empty.xml": b"",
    "blank.cfg": b"\n\n \n",
    "conf.cfg": b"conf set motor.poles " + b"9" * 5000 + b"\n",
    "word.cfg": b"conf set motor.poles fourteen\nconf set motor.resistance_ohm\n",
    "plain.txt": b"Dear reader,\n",
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("command", ["new", "explain", "compare", "export"])
def test_hostile_files_end_in_one_line(
    name: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(HOSTILE[name])
    drive = "paper001-pmsm-bench"
    words = {
        "new": ["new", str(tmp_path / "made"), "--from", str(path)],
        "explain": ["explain", str(path)],
        "compare": ["compare", str(path), str(path)],
        "export": ["export", drive, "--for", FIRMWARE[0], "--into", str(path), "--no-verify"],
    }[command]
    code, out, err = run(words, capsys)
    assert (code, out) == (2, "")
    assert err.startswith("dqforge: ")
    assert err.count("\n") == 1
    assert len(err) < 1500
    assert path.read_bytes() == HOSTILE[name]
    assert not (tmp_path / "made").exists()


def run(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    printed = capsys.readouterr()
    assert isinstance(end.value.code, int)
    return end.value.code, printed.out, printed.err


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.write(b"<MCConfiguration>")
        os.truncate(file.fileno(), 100_000_000)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (_sparse, "the file has 100 MB, at most 8 MB can be read"),
        (os.mkfifo, "this is a named pipe"),
        (lambda path: path.symlink_to(path), "its links lead in a circle"),
        (lambda _: None, "there is no such file"),
        (lambda path: path.symlink_to("/dev/zero"), "this is a device"),
    ],
)
def test_what_is_no_plain_file_is_refused_unread(
    make: Callable[[Path], None],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "a.xml"
    make(path)
    for command in (["new", str(tmp_path / "made"), "--from"], ["explain"]):
        code, _, err = run([*command, str(path)], capsys)
        assert code == 2
        assert f"{path}: {words}" in err


def test_the_answer_to_an_unknown_file_lists_what_is_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("Dear reader,\n")
    _, _, err = run(["explain", str(path)], capsys)
    for target in TARGETS.values():
        assert target.title in err
    assert "result.json of dqforge" in err
