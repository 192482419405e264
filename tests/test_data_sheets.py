"""`dqforge new` from a data sheet: options, questions in a terminal, and what is made of it."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from data_sheets import MOTORS, SCOOTER, DataSheet
from pseudo_terminals import END, INTERRUPT, PseudoTerminal

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.machines.exploration import study_checks as studies
from dqforge.machines.files.library_files import (
    DESIGN_SCHEMA,
    STUDY_SCHEMA,
    schema_bytes,
    with_modeline,
)
from dqforge.reports.firmware.target import TARGETS

Call = Callable[..., tuple[int, str, str]]
terminal = pytest.mark.skipif(sys.platform == "win32", reason="there is no pseudo-terminal")


@pytest.fixture
def call(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Call:
    """One command in an empty folder: its exit code and what it printed."""
    monkeypatch.chdir(tmp_path)

    def called(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            cli.main(list(arguments))
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return stop.value.code, captured.out, captured.err

    return called


@pytest.mark.parametrize("motor", MOTORS.values(), ids=MOTORS)
def test_options_make_a_design_that_is_tuned(call: Call, tmp_path: Path, motor: DataSheet) -> None:
    code, out, err = call("new", "made", *motor.flags)
    assert (code, err) == (0, "")
    path = tmp_path / "made" / "design.yaml"
    assert (tmp_path / "made" / DESIGN_SCHEMA).read_bytes() == schema_bytes(DESIGN_SCHEMA)
    assert path.read_text().startswith(f"# yaml-language-server: $schema={DESIGN_SCHEMA}\n")
    assert out.endswith("made/design.yaml written; next: dqforge tune made/design.yaml\n")
    checked = call("check", "made/design.yaml")[1]
    assert out.startswith(checked)
    code, tuned, err = call("tune", "made/design.yaml", "--json")
    assert (code, err) == (0, "")
    gains = json.loads(tuned)["gains"]
    loops = ["i_d", "i_q", *(["speed"] if "machine.inertia" in motor.values else [])]
    for loop in loops:
        assert gains[loop]["stable"]
        assert gains[loop]["phase_margin_rad"] > math.radians(45.0)
    assert (gains["speed"] is not None) == ("speed" in loops)


@pytest.mark.slow
@pytest.mark.parametrize("motor", MOTORS.values(), ids=MOTORS)
def test_options_make_a_design_that_is_run(call: Call, motor: DataSheet) -> None:
    assert call("new", "made", *motor.flags)[0] == 0
    code, out, err = call("run", "made/design.yaml", "-o", "out")
    assert (code, err) == (0, "")
    assert "equal the model bit for bit" in out


INERTIAS = {
    "scooter": "0.02 kg m^2",
    "drone": "2e-5 kg m^2",
    "servo": "2.9 kg cm^2",
    "industrial": "0.5 kg cm^2",
}

# What else a firmware needs to be told, and says so.
WANTED = {
    "st": ["inverter.current_sensing={shunt: 1 mOhm, gain: 20, reference: 3.3 V, bits: 12}"],
    "nxp": ["machine.max_speed=4500 rpm"],
}


def exported(call: Call, motor: str, firmware: str) -> None:
    """A new design with its inertia, as the files of a firmware whose loops settle."""
    flags = [*MOTORS[motor].flags, "--inertia", INERTIAS[motor]]
    assert call("new", "made", *flags)[0] == 0
    words = [word for setting in WANTED.get(firmware, []) for word in ("--set", setting)]
    code, out, err = call("export", "made/design.yaml", "--for", firmware, *words)
    assert (code, err) == (0, "")
    assert "large speed step at rest" in out
    assert f"the loops of {firmware} settle" in out


def test_a_new_design_is_exported_for_vesc(call: Call) -> None:
    """Its phase-locked loop filters the speed; the fastest speed loop oscillates on it."""
    exported(call, "scooter", "vesc")


@pytest.mark.slow
@pytest.mark.parametrize("firmware", list(TARGETS))
@pytest.mark.parametrize("motor", MOTORS)
def test_a_new_design_is_exported(call: Call, motor: str, firmware: str) -> None:
    exported(call, motor, firmware)


def test_json_has_what_check_has(call: Call) -> None:
    code, out, _ = call("new", "made", *SCOOTER.flags, "--json")
    made = json.loads(out)
    assert code == 0
    assert made["next"] == "dqforge tune made/design.yaml"
    assert [entry["name"] for entry in made["files"]] == ["design.yaml", DESIGN_SCHEMA]
    assert made["input"] == json.loads(call("check", "made/design.yaml", "--json")[1])["input"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--kv", "60 rpm/V"], "a design needs more of the data sheet; give --pole-pairs 7 --v-dc"),
        ([*SCOOTER.flags, "--kv", "60 V"], "--kv: "),
        ([*SCOOTER.flags, "--torque-constant", "1 Nm/Arms"], "--torque-constant: "),
        ([*SCOOTER.flags, "--template"], "--pole-pairs and --template both define"),
        (["--template", "--machine", "thor-pmsyrm-5k"], "--machine and --template both define"),
        ([*SCOOTER.flags, "--study", "production-yield"], "--pole-pairs and --study both define"),
        (["--study", "yield"], "did you mean production-yield?"),
        ([*SCOOTER.flags, "--inductance-d", "1 mH"], "inductance"),
        ([*SCOOTER.flags, "--poles", "14"], "--poles"),
        ([*SCOOTER.flags, "--name", "a */ b"], "--name: the text contains '*/'"),
    ],
)
def test_wrong_options_are_one_line_and_nothing_is_written(
    call: Call, tmp_path: Path, words: list[str], message: str
) -> None:
    code, out, err = call("new", "made", *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("dqforge: ")
    assert message in err
    assert list(tmp_path.iterdir()) == []


def test_in_a_pipe_nothing_is_asked(call: Call, tmp_path: Path) -> None:
    for name, words in (("a", []), ("b", ["--template"]), ("c", ["--yes"])):
        assert call("new", name, *words)[0] == 0
        written = (tmp_path / name / "design.yaml").read_bytes()
        assert written == with_modeline(catalogue.template(), DESIGN_SCHEMA)


def test_a_study_of_the_library_is_written_with_its_schema(call: Call, tmp_path: Path) -> None:
    for name in studies.names():
        assert call("new", name, "--study", name)[0] == 0
        written = (tmp_path / name / "study.yaml").read_bytes()
        assert written == with_modeline(studies.read_text(name), STUDY_SCHEMA)
        assert (tmp_path / name / STUDY_SCHEMA).read_bytes() == schema_bytes(STUDY_SCHEMA)
    code, out, err = call("new", name, "--study", name)
    assert (code, out, "exists already" in err) == (2, "", True)
    assert call("explore", f"{name}/study.yaml", "--dry-run", "-o", "out")[0] == 0


def test_a_design_that_is_there_is_kept(call: Call, tmp_path: Path) -> None:
    assert call("new", "made", *SCOOTER.flags)[0] == 0
    before = (tmp_path / "made" / "design.yaml").read_bytes()
    code, _, err = call("new", "made", *SCOOTER.flags)
    assert (code, "exists already and is kept" in err) == (2, True)
    assert (tmp_path / "made" / "design.yaml").read_bytes() == before


@terminal
def test_questions_in_a_terminal(tmp_path: Path) -> None:
    with PseudoTerminal(tmp_path, ["new", "made"]) as person:
        assert "Ctrl-C ends with nothing written" in person.answer("name (", "Hub motor")
        person.answer("pole-pairs (", "15")
        person.answer("kv (", "sixty")
        assert "is not a number with a unit" in person.answer("kv (", "60")
        assert "write '60 rpm/V'" in person.answer("kv (", "60 rpm/V")
        person.answer("torque-constant (", "")
        person.answer("v-dc (", "48 V")
        person.answer("max-current (", "40 A rms")
        person.answer("resistance (", "100 mOhm")
        assert "1 line-to-line: between two terminals" in person.answer("number [1]: ", "")
        person.answer("inductance (", "200 uH ll")
        for name in ("switching-frequency", "max-speed", "rated-torque", "rated-speed"):
            person.answer(f"{name} (", "")
        for name in ("rated-current", "inertia", "friction"):
            person.answer(f"{name} (", "")
        shown, code = person.rest()
    assert code == 0
    assert "dqforge new made --name 'Hub motor' --pole-pairs 15 --kv '60 rpm/V'" in shown
    assert "Hub motor: valid" in shown
    assert "made/design.yaml written" in shown
    text = (tmp_path / "made" / "design.yaml").read_text()
    assert "resistance: 100 mOhm line-to-line" in text


@pytest.mark.slow
@terminal
def test_options_leave_only_what_is_missing_to_ask(tmp_path: Path) -> None:
    words = [*SCOOTER.flags]
    at = words.index("--v-dc")
    del words[at : at + 2]
    with PseudoTerminal(tmp_path, ["new", "made", *words]) as person:
        person.answer("v-dc (", "48 V")
        shown, code = person.rest()
    assert (code, "My drive: valid" in shown) == (0, True)
    with PseudoTerminal(tmp_path, ["new", "whole", *SCOOTER.flags]) as person:
        shown, code = person.rest()
    assert (code, "My drive: valid" in shown, "the same without" in shown) == (0, True, False)


@terminal
@pytest.mark.parametrize(
    "key",
    [INTERRUPT, pytest.param(END, marks=pytest.mark.slow)],
    ids=["Ctrl-C", "Ctrl-D"],
)
def test_leaving_writes_nothing(tmp_path: Path, key: str) -> None:
    with PseudoTerminal(tmp_path, ["new", "made"]) as person:
        person.answer("name (", "x")
        person.press("pole-pairs (", key)
        shown, code = person.rest()
    assert code == 130
    assert shown.endswith("\nnothing is written\ndqforge: interrupted\n")
    assert "Traceback" not in shown
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@terminal
def test_a_folder_with_a_design_is_refused_before_the_first_question(tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "design.yaml").write_text("mine")
    with PseudoTerminal(tmp_path, ["new", "made"]) as person:
        shown, code = person.rest()
    assert (code, shown.strip()) == (
        2,
        "dqforge: made/design.yaml exists already and is kept; choose another folder",
    )
