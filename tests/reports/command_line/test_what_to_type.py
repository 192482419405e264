"""What a slip on the command line is answered with: the words to type instead."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dqforge.cli import main
from dqforge.machines.design import catalogue
from dqforge.reports.verification.cross_tools import TARGETS, core_named

Told = Callable[..., str]


@pytest.fixture
def told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Told:
    """Runs a command that is refused, beside a folder with a design; the line that it says."""
    monkeypatch.chdir(tmp_path)
    Path("made").mkdir()
    Path("made/design.yaml").write_bytes(catalogue.read_text("abb-ipmsm-2k2"))

    def run(*words: str) -> str:
        with pytest.raises(SystemExit) as caught:
            main(words)
        assert caught.value.code == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        return said.removeprefix("dqforge: ").rstrip("\n")

    return run


@pytest.mark.parametrize("command", ["check", "tune", "fit", "run", "mtpa", "losses", "simulate"])
def test_a_folder_with_a_design_names_it(told: Told, command: str) -> None:
    inside = Path("made") / "design.yaml"
    assert told(command, "made") == f"made: this is a folder; write {inside}"


@pytest.mark.parametrize(
    ("typed", "folder"), [("new/design.yaml", "new"), ("made/design.yaml", "made"), ("a.yml", "a")]
)
def test_a_new_design_is_given_its_folder(told: Told, typed: str, folder: str) -> None:
    said = told("new", typed, "--machine", "abb-ipmsm-2k2")
    assert said.endswith(f"write 'dqforge new {folder}'")
    assert "-o" not in said.split()
    assert not Path("new").exists()


def test_a_design_is_not_explained_but_checked(told: Told) -> None:
    said = told("explain", "made/design.yaml")
    assert said.endswith("this is a dqforge design; write 'dqforge check made/design.yaml'")


@pytest.mark.parametrize(
    ("key", "home"),
    [("inverter.inertia", "machine"), ("machine.v_dc", "inverter")],
)
def test_a_key_of_another_section_is_told_without_lines(told: Told, key: str, home: str) -> None:
    said = told("check", "made/design.yaml", "--set", f"{key}=2")
    assert said.startswith(f"--set {key}: unknown key")
    assert "indentation" not in said
    assert said.endswith(f"write --set {home}.{key.rpartition('.')[2]}=...")


@pytest.mark.parametrize("value", ["{a: b: c}", "[a: b: c]", "{a: [b}", "a: b"])
def test_a_value_that_is_no_yaml_is_told_without_lines(told: Told, value: str) -> None:
    said = told("check", "made/design.yaml", "--set", f"control={value}")
    assert said.startswith("--set control: ")
    assert "indentation" not in said


def test_in_a_file_the_section_alone_is_named(told: Told) -> None:
    path = Path("made/design.yaml")
    text = path.read_text(encoding="utf-8").replace("inverter:\n", "inverter:\n  inertia: 1\n")
    path.write_text(text, encoding="utf-8")
    assert "it belongs in machine, check the indentation" in told("check", str(path))


@pytest.mark.parametrize("name", ["vsec", "VSEC", "simplefco"])
def test_a_near_name_of_a_firmware_is_offered(told: Told, name: str) -> None:
    said = told("export", "made/design.yaml", "--for", name, "-o", "out")
    assert said.endswith(f"did you mean '{'simplefoc' if name[0] == 's' else 'vesc'}'?")


def test_the_case_of_a_firmware_does_not_matter() -> None:
    text = catalogue.read_text("abb-ipmsm-2k2")
    design = catalogue.load_text(text, "f", settings=["export.firmware=VESC"])
    assert design.export.firmware == ("vesc",)


def test_cores_by_their_other_names() -> None:
    for name in TARGETS:
        assert core_named(name) == core_named(name.upper()) == name
    assert [core_named(each) for each in ("cortex-m4f", "m7", "Cortex-M0+", "cortex-m33f")] == [
        "cortex-m4", "cortex-m7", "cortex-m0plus", "cortex-m33",
    ]  # fmt: skip
    assert core_named("cortex-m5") == "cortex-m5"
