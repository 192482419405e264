"""Every command answers in one way: tables or JSON, a figure, files with their hashes,
and stages on a terminal.
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError
from dqforge.reports import answers
from dqforge.reports.command_line.designs import respond
from dqforge.reports.pages import answer
from dqforge.reports.pages.answer import LOADING, Answer, Files, Table, shares, stage

BENCH, IPM = "paper001-pmsm-bench", "paper000-ipmsm-100kw"
COMMANDS = sorted(
    entry.callback.__name__ for entry in cli.app.registered_commands if entry.callback
)
# fmt: off
OF_A_DESIGN = (
    "check", "dqy", "estimators", "export", "fit", "losses", "mtpa", "run", "simulate", "tune",
)
# fmt: on

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Call:
    """One command in an empty folder: its exit code and what it printed."""
    monkeypatch.chdir(tmp_path)

    def called(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return stop.value.code, captured.out, captured.err

    return called


def plain(call: Call, *arguments: object) -> dict[str, Any]:
    """The JSON that a command prints; its envelope is checked."""
    code, out, err = call(*arguments, "--json")
    assert (code, err) == (0, "")
    document: dict[str, Any] = json.loads(out)
    assert document.pop("command") == arguments[0]
    assert document.pop("format") == 1
    del document["dqforge"]
    return document


def check_files(document: dict[str, Any]) -> set[str]:
    """Names of the files that were written; each has the hash that was printed."""
    folder = Path(document["out"])
    for entry in document["files"]:
        assert hashlib.sha256((folder / entry["name"]).read_bytes()).hexdigest() == entry["sha256"]
    return {entry["name"] for entry in document["files"]}


def test_the_command_line_is_short() -> None:
    assert cli.__file__ is not None
    # A command with all its options and what its help says takes some twenty lines, and there are
    # as many commands; nothing else stands there. The values of a data sheet are one
    # parameter of `new`.
    assert len(Path(cli.__file__).read_text(encoding="utf-8").splitlines()) <= 400


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_json_and_short_help(call: Call, command: str) -> None:
    code, out, _ = call(command, "-h")
    assert code == 0
    assert "--json" in out
    assert "-h, --help" in out
    assert call(command, "--help")[1] == out
    assert ("--set KEY=VALUE" in out) == (command in (*OF_A_DESIGN, "compare", "new"))
    assert ("{DESIGN}" in out) == (command in OF_A_DESIGN)


def test_help_of_the_whole_is_short_too(call: Call) -> None:
    assert call("-h") == call("--help")


def test_every_answer_has_its_module() -> None:
    for name in answers.__all__:
        assert getattr(answers, name).__name__ == f"dqforge.reports.answers.{name}"
    folder = Path(str(answers.__file__)).parent
    assert sorted(answers.__all__) == sorted(path.stem for path in folder.glob("[a-z]*.py"))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = answers.nothing


@pytest.mark.slow
def test_new_and_the_library_as_json(call: Call, tmp_path: Path) -> None:
    made = plain(call, "new", "mine")
    assert check_files(made) == {"design.yaml", "design.schema.json"}
    assert made["next"] == "dqforge check mine/design.yaml"
    listed = plain(call, "machines")
    drives = listed["machines"]
    assert [motor["name"] for motor in listed["motors"]] == catalogue.motors()
    assert [drive["name"] for drive in drives] == catalogue.names()
    assert all(set(drive) == {"name", "drive", "about"} for drive in drives)
    assert plain(call, "machines", BENCH)["text"].encode() == catalogue.read_text(BENCH)
    found = plain(call, "machines", "--search", "hoverboard")
    assert found["next"] == "dqforge new my-hoverboard-hub --machine hoverboard-hub"
    assert plain(call, *found["next"].split()[1:])["next"]
    schema = json.loads(call("schema")[1], parse_float=lambda text: float(f"{float(text):.9g}"))
    assert plain(call, "schema")["schema"] == schema


@pytest.mark.slow
def test_export_and_verify_as_json(call: Call) -> None:
    made = plain(call, "export", BENCH, "-o", "out")
    names = check_files(made)
    assert {"bench001.h", "bench001_vectors.h", "result.json"} <= names
    found = plain(call, "verify", "out")
    checks = found["verification"]["checks"]
    assert made["verification"]["checks"] == checks
    per_header = {entry["name"]: entry["results"] for entry in found["headers"]}
    assert set(per_header) == {"current reference", "speed observer"}
    assert [check["compared"] for check in checks] == [sum(per_header.values())] * 2
    assert [check["standard"] for check in checks] == ["c99", "c++11"]
    assert found["headers"][0]["standards"] == ["c99", "c++11"]
    assert found["recomputation"]["files"] == len(names)
    assert found["recomputation"]["entries"] > 1000
    header = Path("out/bench001.h")
    header.write_text(header.read_text().replace("1.7", "1.8", 1))
    code, out, err = call("verify", "out", "--json")
    assert (code, out, err.count("\n")) == (1, "", 1)


@pytest.mark.slow
def test_without_verification_json_says_null(call: Call) -> None:
    assert plain(call, "export", BENCH, "-o", "out", "--no-verify")["verification"] is None


SETTINGS = (
    "machine.resistance=2.5 Ohm",
    "fit.max_torque=1.2 N m",
    "losses.points.0.torque=0.4 N m",
)


@pytest.mark.slow
def test_what_is_set_is_in_the_folder_and_verifies(call: Call, tmp_path: Path) -> None:
    """The design of the folder has the keys: another run of it gives the same bytes."""
    options = [word for setting in SETTINGS for word in ("--set", setting)]
    assert call("export", BENCH, "-o", "out", *options)[0] == 0
    code, out, _ = call("verify", "out")
    assert code == 0
    assert "bit for bit" in out
    kept = (tmp_path / "out" / "dqforge-input" / "design.yaml").read_bytes()
    assert load_text(kept, "d.yaml").fit.torque_max == pytest.approx(1.2)
    again = plain(call, "export", "out/dqforge-input/design.yaml", "-o", "again", "--no-verify")
    assert check_files(again)
    assert (tmp_path / "again" / "result.json").read_bytes() == (
        tmp_path / "out" / "result.json"
    ).read_bytes()


def test_the_result_is_that_of_an_edited_file(call: Call, tmp_path: Path) -> None:
    """But for the digest of the file, and the source of the quantity that was set."""
    text = catalogue.template().decode()
    edits = [("resistance: 2.35 Ohm", "machine.resistance=2.5 Ohm"), ("degree: 2 ", "fit.degree=3")]
    for old, setting in edits:
        assert text.count(old) == 1
        text = text.replace(old, f"{old.split(':')[0]}: {setting.split('=')[1]} ")
    (tmp_path / "hand.yaml").write_text(text)
    (tmp_path / "design.yaml").write_bytes(catalogue.template())
    options = [word for _, setting in edits for word in ("--set", setting)]
    assert call("export", "hand.yaml", "-o", "hand", "--no-verify")[0] == 0
    assert call("export", "design.yaml", "-o", "set", "--no-verify", *options)[0] == 0
    hand, found = (json.loads(Path(name, "result.json").read_text()) for name in ("hand", "set"))
    sources = {}
    for document in (hand, found):
        document["input"].pop("digest")
        for value in document["input"]["values"]:
            source = value.pop("source")
            sources[value["path"]] = source
    assert hand == found
    assert sources["machine.resistance"] == "command line"


def test_check_tells_what_was_set(call: Call) -> None:
    code, out, _ = call(
        "check", BENCH, "--set", "machine.resistance=2.5 Ohm", "--set", "fit.degree=3"
    )
    assert code == 0
    assert "set on the command line: machine.resistance, fit.degree" in out
    row = next(line for line in out.splitlines() if "machine.resistance " in line)
    assert row.rstrip().endswith("command line")
    assert plain(call, "check", BENCH, "--set", "fit.degree=3")["set"] == ["fit.degree"]
    assert "set" not in plain(call, "check", BENCH)


@pytest.mark.parametrize("command", OF_A_DESIGN)
def test_every_command_refuses_a_wrong_key_in_one_line(
    call: Call, tmp_path: Path, command: str
) -> None:
    code, out, err = call(command, BENCH, "--set", "machine.resitance=1 Ohm")
    assert (code, out) == (2, "")
    assert err == (
        "dqforge: --set machine.resitance: unknown key 'resitance'; did you mean 'resistance' or "
        "'ac_resistance'?\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_compare_sets_keys_of_the_second(call: Call) -> None:
    found = plain(call, "compare", BENCH, BENCH, "--set", "machine.resistance=4.7 Ohm")[
        "comparison"
    ]
    row = next(row for row in found["rows"] if row["quantity"] == "phase resistance")
    assert (row["a"], row["b"]) == (2.35, 4.7)
    assert found["b"]["source"].endswith("--set machine.resistance=4.7 Ohm")
    code, _, err = call("compare", BENCH, "somewhere.json", "--set", "machine.poles=4")
    assert code == 2
    assert "--set changes a design" in err


class Terminal(io.StringIO):
    """A standard error that a person looks at."""

    def isatty(self) -> bool:
        return True

    def waits_for(self, text: str) -> bool:
        end = time.monotonic() + 120.0
        while text not in self.getvalue() and time.monotonic() < end:
            time.sleep(0.01)
        return text in self.getvalue()


def test_stages_are_named_as_they_come(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("dqforge.reports.command_line.designs.QUICK_S", 0.0)

    def ask() -> Answer:
        assert terminal.waits_for(LOADING)
        stage("solving [all]")
        assert terminal.waits_for("solving [all]")
        told = shares()
        assert told is not None
        told(0.25)
        assert terminal.waits_for("solving [all], 25 %")
        return Answer("x", (), {}, notes=("done",))

    respond("fit", ask)
    assert capsys.readouterr().out == "done\n"
    assert shares() is None


class Named:
    """A display that remembers the stages."""

    def __init__(self) -> None:
        self.stages: list[str] = []

    def name(self, text: str) -> None:
        self.stages.append(text)

    def move(self, share: float) -> None:
        del share


@pytest.mark.parametrize(
    ("words", "stages"),
    [
        (("check", BENCH), [LOADING, "reading the design", "checking", "evaluating the start"]),
        (("machines",), [LOADING]),
        (("compare", BENCH, BENCH), [LOADING, "reading the files", "comparing"]),
        (("mtpa", IPM, "--torque", "10 N m"), [LOADING, "reading the design", "solving"]),
    ],
)
def test_every_command_names_what_it_does(
    words: tuple[str, ...], stages: list[str], monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    named = Named()

    @contextmanager
    def watched(text: str, after: float = 0.0) -> Iterator[None]:
        del after
        named.stages.append(text)
        token = answer._shown.set(named)
        try:
            yield
        finally:
            answer._shown.reset(token)

    monkeypatch.setattr("dqforge.reports.command_line.designs.status", watched)
    call(*words)
    assert list(dict.fromkeys(each for each in named.stages if each in stages)) == stages


def test_a_bar_has_the_name_of_its_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")

    def ask() -> Answer:
        stage("compiling")
        assert terminal.waits_for("compiling")
        return Answer("x", (), {})

    respond("simulate", ask, bar="simulating")


def test_a_pipe_sees_no_stage(capsys: pytest.CaptureFixture[str]) -> None:
    def ask() -> Answer:
        stage("solving")
        assert shares() is None
        return Answer("x", (), {"key": [1.5]})

    respond("fit", ask, json=True)
    captured = capsys.readouterr()
    assert captured.err == ""
    assert json.loads(captured.out)["key"] == [1.5]


def test_files_are_written_before_anything_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = Table("A table", ("key",), (("value",),))
    files = Files({"a.txt": b"content"}, "")
    respond(
        "new",
        lambda: Answer("x", [table], {}, files=files, notes=("a note",)),
        out=tmp_path / "out",
    )
    printed = capsys.readouterr().out
    assert (
        printed.index("A table")
        < printed.index("a note")
        < printed.index(f"written: {tmp_path}/out/a.txt")
    )
    assert (tmp_path / "out" / "a.txt").read_bytes() == b"content"


def test_a_figure_that_cannot_be_written_is_refused_before_the_question(tmp_path: Path) -> None:
    def never() -> Answer:
        raise AssertionError("asked")

    with pytest.raises(InputError, match="no folder"):
        respond("fit", never, plot=tmp_path / "missing" / "x.svg")
