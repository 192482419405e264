"""Errors as a person sees them: the line of the file below, a mark under the place, in colour; and
as a program does: one line.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pseudo_terminals import PseudoTerminal
from rich.cells import cell_len

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import remember
from dqforge.reports.command_line.flags import exit_code
from dqforge.reports.pages.answer import excerpt, tell

ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
COLOURED = {"TERM": "xterm-256color", "COLUMNS": "100", "NO_COLOR": ""}
DESIGN = """\
dqforge: 1
name: Hobby motor
machine:
  poles: 14
  resistance: 100 mOhm phase-to-phase
  inductance: 60 uX terminal
  kv: 190
  max_current: 20 Arms
inverter: {v_dc: 24 V, switching_frequency: 20 kHz}
"""


def rows(line: str, column: int | None, room: int = 80) -> list[str]:
    remember("f.yaml", f"first\n{line}\n".encode("utf-8", "surrogatepass"))
    error = InputError("is wrong", source="f.yaml", line=2, column=column)
    return [row for row, _ in excerpt(error, room)]


def test_the_mark_stands_under_the_column() -> None:
    assert rows("  inductance: 60 uX", 15) == [
        "    2 |   inductance: 60 uX",
        "      |               ^",
    ]
    assert rows("\tkey: 5", 2) == ["    2 |  key: 5", "      |  ^"]
    assert rows("name: 電機 5", 10) == ["    2 | name: 電機 5", "      |            ^"]
    assert rows("short", 60)[1].index("^") == len("    2 | short")
    assert rows("no column", None) == ["    2 | no column"]
    assert rows("", 1) == rows("   ", 1) == []


def test_long_lines_are_cut_round_the_place() -> None:
    line = "".join(chr(ord("a") + k % 26) for k in range(5000))
    for column in (1, 5, 60, 2500, 4990, 5000):
        shown, mark = rows(line, column, 60)
        assert len(shown) == 60
        assert shown[mark.index("^")] == line[column - 1]
        part = shown.partition("| ")[2]
        assert part.strip(".") in line
        assert part.startswith("...") == (column > 30)
        assert part.endswith("...") == (column < 4970)


@given(
    st.text(st.characters(exclude_characters="\n\r"), max_size=300),
    st.integers(1, 320),
    st.integers(10, 120),
)
@settings(max_examples=200, deadline=None)
def test_whatever_a_line_holds_it_moves_no_cursor(line: str, column: int, room: int) -> None:
    for row in rows(line, column, room):
        assert row.isprintable()
        assert cell_len(row) <= max(room, 28) + 1


def seen(folder: Path, *words: str, **environment: str) -> str:
    """What a terminal shows of a refused command, behind all signs of life."""
    with PseudoTerminal(folder, words, COLOURED | environment) as terminal:
        shown, code = terminal.rest()
    assert code == 2
    begin = re.search(r"(\x1b\[1;31m)?dqforge: ", shown)
    assert begin is not None, shown
    return shown[begin.start() :]


def test_a_terminal_shows_the_line_and_colours(tmp_path: Path) -> None:
    (tmp_path / "d.yaml").write_text(DESIGN)
    shown = seen(tmp_path, "check", "d.yaml")
    assert shown.startswith(
        "\x1b[1;31mdqforge: \x1b[0m\x1b[1md.yaml:6:15\x1b[0m: machine.inductance: "
    )
    first, line, mark, end = ESCAPE.sub("", shown).split("\n")
    assert first.endswith("expected an inductance such as '1.61 mH'")
    assert line == "    6 |   inductance: 60 uX terminal"
    assert mark == "      |               ^"
    assert end == ""


def test_without_colour_it_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "d.yaml").write_text(DESIGN)
    shown = seen(tmp_path, "check", "d.yaml", NO_COLOR="1")
    assert shown.startswith("dqforge: d.yaml:6:15: machine.inductance: unknown unit 'uX'")
    assert shown.count("\n") == 1


@pytest.mark.parametrize("case", [{"TERM": "dumb"}, {"NO_COLOR": "1"}, {"pipe": "1"}])
def test_where_nobody_looks_it_is_one_line(
    case: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TERM", case.get("TERM", "xterm"))
    monkeypatch.setenv("NO_COLOR", case.get("NO_COLOR", ""))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: "pipe" not in case)
    remember("f.yaml", b"one\ntwo\n")
    tell("f.yaml:2:1: wrong", InputError("wrong", source="f.yaml", line=2, column=1))
    assert capsys.readouterr().err == "dqforge: f.yaml:2:1: wrong\n"


def test_the_lines_of_studies_and_of_data_files(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    # A file of the same name where the command runs is not the one that was read.
    (tmp_path / "map.csv").write_text("i_d,i_q\ndecoy\ndecoy\ndecoy\n")
    (inside / "map.csv").write_text(
        "i_d [A],i_q [A],psi_d [Wb],psi_q [Wb]\n0,0,1,0\n1,0,\x1b[31m,0\n"
    )
    design = DESIGN.replace(
        "inductance: 60 uX terminal", "model: flux-map\n  flux_map: {file: map.csv}"
    )
    (inside / "d.yaml").write_text(design.replace("  kv: 190\n", ""))
    shown = seen(tmp_path, "check", "inside/d.yaml")
    assert "decoy" not in shown
    assert "\x1b[31m" not in shown
    assert ESCAPE.sub("", shown).splitlines()[1:] == ["    3 | 1,0,?[31m,0"]
    (tmp_path / "s.yaml").write_text(
        "dqforge_study: 1\nname: a\ndesign: abb-syrm-6k7\nvary:\n  machine.resistence: [1, 2]\n"
    )
    text = ESCAPE.sub("", seen(tmp_path, "explore", "s.yaml", "--out", "out"))
    assert "    5 |   machine.resistence: [1, 2]\n      |   ^\n" in text


@pytest.mark.parametrize("count", [1, 2, 5, 13])
def test_every_fault_of_a_file_is_told_at_once(
    count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unknown keys in two sections and a wrong unit, in the order of the file; ten at most."""
    text = DESIGN.replace("60 uX", "60 uH" if count < 3 else "60 uX")
    added = count if count < 3 else count - 1
    machine, inverter = added - added // 2, added // 2
    text = text.replace(
        "  poles: 14\n",
        "  poles: 14\n" + "".join(f"  strange_{chr(97 + k)}: 1\n" for k in range(machine)),
    )
    text = text.replace(
        "{v_dc: 24 V,",
        "{v_dc: 24 V, " + "".join(f"strange_{chr(97 + k)}: 1, " for k in range(inverter)),
    )
    path = tmp_path / "f.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        catalogue.load_design(path)
    assert 1 + len(caught.value.others) == count

    def loads() -> None:
        catalogue.load_design(path)

    assert exit_code(loads, lambda _: None) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == min(count, 11)
    places = [
        (int(row), int(column))
        for row, column in re.findall(r"f\.yaml:(\d+):(\d+): ", "\n".join(lines))
    ]
    assert len(places) == min(count, 10)
    assert places == sorted(set(places))
    assert (lines[-1] == "dqforge: and 3 more faults") == (count == 13)
