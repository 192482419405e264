"""A number without its unit is refused by every option that has one, and by every question."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer
from data_sheets import SCOOTER

from dqforge.cli import app, main
from dqforge.machines.design.sheet_judged import read_alone
from dqforge.machines.design.sheet_values import SHEET_VALUES, SheetValue
from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import parse_quantity

COMMANDS = vars(typer.main.get_command(app))["commands"]

# What a command needs besides the option.
REST = {
    "mtpa": ["abb-ipmsm-2k2"],
    "dqy": ["paper002-phase-waveforms"],
    "losses": ["abb-ipmsm-2k2", "--map", "3x3"],
    "bemf": ["capture.csv"],
}


def with_units() -> list[tuple[str, str, str]]:
    """Command, option and number of every option whose help shows a number with a unit."""
    found = []
    for name, command in COMMANDS.items():
        for option in command.params:
            shown = re.search(
                r"e\.g\. '([\d.e-]+) ?([^\d%',][^%',]*)[',]", getattr(option, "help", "") or ""
            )
            if shown is not None:
                found.append((name, option.opts[0], shown[1]))
    return found


def test_all_options_with_units_are_found() -> None:
    found = {(name, flag) for name, flag, _ in with_units()}
    of_new = {flag for name, flag in found if name == "new"}
    assert of_new == {value.flag for value in SHEET_VALUES if value.dimension}
    others = found - {("new", flag) for flag in of_new}
    assert others == {
        (name, flag)
        for flag, names in {
            "--speed": ("mtpa", "dqy", "bemf"),
            "--torque": ("mtpa", "dqy"),
            "--frequencies": ("losses",),
            "--interval": ("bemf",),
        }.items()
        for name in names
    }


@pytest.mark.parametrize(("name", "flag", "number"), with_units())
def test_a_number_without_unit_is_refused(
    name: str,
    flag: str,
    number: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("capture.csv").write_text("t;a;b;c\n0;1;2;3\n", encoding="utf-8")
    with pytest.raises(SystemExit) as caught:
        main([name, *REST.get(name, ["made"]), flag, number])
    said = capsys.readouterr().err
    assert caught.value.code == 2
    assert said.startswith(f"dqforge: {flag}: '{number}' has no unit; write '{number} ")
    assert not Path("made").exists()


@pytest.mark.parametrize("value", [each for each in SHEET_VALUES if each.dimension], ids=str)
def test_what_is_proposed_is_read(value: SheetValue) -> None:
    for number in ("0.7", "60", "3000"):
        with pytest.raises(InputError, match="has no unit") as caught:
            read_alone(value.key, number)
        assert caught.value.source == value.label
        for text in re.findall(r"'([^']+)'", caught.value.message)[1:]:
            assert parse_quantity(text, value.dimension) != 0.0


@pytest.mark.parametrize(
    ("flag", "number", "written"),
    [
        ("--inductance", "0.7", "'0.7 mH' or '0.7 H'"),
        ("--inductance", "60", "'60 uH' or '60 mH'"),
        ("--inductance", "0.7 line-to-line", "'0.7 mH line-to-line' or '0.7 H line-to-line'"),
        ("--resistance", "0.38", "'0.38 Ohm'"),
        ("--kv", "0.3", "'0.3 rpm/V'"),
        ("--max-current", "20 rms", "'20 A rms'"),
        ("--switching-frequency", "20", "'20 kHz'"),
        ("--magnet-flux", "6.1", "'6.1 mWb'"),
    ],
)
def test_the_usual_units_are_proposed(
    flag: str,
    number: str,
    written: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["new", "made", *SCOOTER.flags, flag, number])
    assert capsys.readouterr().err == f"dqforge: {flag}: '{number}' has no unit; write {written}\n"


def test_zero_needs_no_unit() -> None:
    found = read_alone("machine.friction", "0")
    assert found is not None
    assert found.si == 0.0


def test_frequencies_have_the_limits_of_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["losses", "abb-ipmsm-2k2", "--map", "3x3", "--frequencies", "8 kHz, 20 Hz"])
    said = capsys.readouterr().err
    assert said.startswith("dqforge: --frequencies: '20 Hz' is outside 100 Hz to 10 MHz")


def test_what_is_implausible_stands_first_and_blames_what_was_typed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = dict(zip(SCOOTER.flags[::2], SCOOTER.flags[1::2], strict=True))
    flags |= {"--inductance": "0.7 H", "--kv": "60000 rpm/V"}
    with pytest.raises(SystemExit) as caught:
        main(["new", "made", *(word for pair in flags.items() for word in pair)])
    assert not caught.value.code
    said = capsys.readouterr().out
    keys = re.findall(r"^implausible: (\S+):", said, re.MULTILINE)
    assert "machine.kv" in keys
    assert {key.rpartition(".")[2] for key in keys} <= {"kv", "resistance", "inductance"}
    assert said.rindex("implausible:") < said.index("assumed:")
