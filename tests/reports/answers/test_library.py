"""What `dqforge schema` answers, and which files `dqforge new` makes."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text, template
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import study_json_schema
from dqforge.machines.files.library_files import DESIGN_SCHEMA, schema_bytes
from dqforge.reports.answers.library import (
    CapturedFlux,
    NewRequest,
    answer_new,
    answer_schema,
    recorded,
)


def test_the_command_prints_it() -> None:
    answer = answer_schema(study=True)
    assert answer.plain == {"schema": study_json_schema()}
    assert json.loads(answer.notes[0]) == study_json_schema()
    assert answer_schema().plain != answer.plain


def test_a_schema_goes_into_a_file_and_the_modeline_is_said() -> None:
    answer = answer_schema(out=Path("there") / "mine.json")
    assert answer.files is not None
    assert answer.files.contents == {"mine.json": schema_bytes(DESIGN_SCHEMA)}
    assert "# yaml-language-server: $schema=mine.json" in answer.notes[0]


def test_a_new_design_brings_the_schema_that_it_names(tmp_path: Path) -> None:
    for machine in (None, "paper001-pmsm-bench"):
        answer = answer_new(tmp_path, NewRequest(machine))
        assert answer.files is not None
        design, schema = answer.files.contents.values()
        assert list(answer.files.contents) == ["design.yaml", "design.schema.json"]
        first, _, rest = design.partition(b"\n")
        assert first == b"# yaml-language-server: $schema=design.schema.json"
        assert rest == catalogue.template(machine)
        assert schema == schema_bytes(DESIGN_SCHEMA)


SHEET = {
    "machine.pole_pairs": "7",
    "machine.resistance": "35 mOhm phase",
    "machine.max_current": "40 A peak",
    "inverter.v_dc": "24 V",
}


def _capture(path: Path, *, channels: int) -> Path:
    """A machine of 10 mWb and a tenth of it in the fifth harmonic, wire to wire, 100 Hz."""
    theta = 2.0 * np.pi * 100.0 * np.arange(2000) * 25e-6
    phases = [
        np.sin(theta - k * 2.0 * np.pi / 3.0) + 0.1 * np.sin(5.0 * (theta - k * 2.0 * np.pi / 3.0))
        for k in range(3)
    ]
    size = 0.01 * 2.0 * np.pi * 100.0
    lines = [size * (phases[k] - phases[(k + 1) % 3]) for k in range(channels)]
    rows = np.column_stack([np.arange(2000) * 25e-6, *lines])
    head = ",".join(["t_s", "ab_V", "bc_V", "ca_V"][: channels + 1])
    np.savetxt(path, rows, delimiter=",", header=head, comments="")
    return path


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_a_capture_gives_the_magnet_flux(tmp_path: Path, channels: int) -> None:
    file = _capture(tmp_path / "scope.csv", channels=channels)
    sheet = SHEET | {"machine.inductance": "30 uH phase"}
    captured = CapturedFlux([file], line_to_line=True)
    answer = answer_new(tmp_path / "hub", NewRequest(sheet=sheet, capture=captured))
    assert answer.files is not None
    text = answer.files.contents["design.yaml"]
    assert b"# fundamental of the capture 'scope.csv'" in text
    psi_pm = load_text(text, "design.yaml").machine.psi_pm
    assert psi_pm == pytest.approx(0.01, rel=1e-3)
    (ripple,) = [note for note in answer.notes if "10.0% of order 5: torque ripple" in note]
    # What it says to write makes the design with that ripple.
    section = re.search(r"back_emf: (\{.*\}) in place", ripple)
    assert section is not None
    changed = re.sub(rb"  magnet_flux: .*", b"  back_emf: " + section[1].encode(), text)
    changed = changed.replace(b"  inductance: 30", b"  model: waveform\n  self_inductance: 30")
    if channels > 1:
        shaped = load_text(changed, "design.yaml", tmp_path)
        assert shaped.phase_machine is not None
        assert shaped.machine.psi_pm == pytest.approx(psi_pm, rel=1e-3)


def test_names_of_files_stay_text(tmp_path: Path) -> None:
    file = _capture(tmp_path / "a\nname: b # c.csv", channels=1)
    sheet = SHEET | {"machine.inductance": "30 uH phase"}
    capture = CapturedFlux([file], line_to_line=True)
    files = answer_new(tmp_path / "hub", NewRequest(sheet=sheet, capture=capture)).files
    assert files is not None
    design = load_text(files.contents["design.yaml"], "design.yaml")
    assert design.name == "My drive"


def test_a_capture_that_contradicts_the_data_sheet_is_refused(tmp_path: Path) -> None:
    file = _capture(tmp_path / "scope.csv", channels=3)
    sheet = SHEET | {"machine.inductance": "30 uH phase", "machine.kv": "190 rpm/V"}
    with pytest.raises(InputError, match="magnet"):
        answer_new(
            tmp_path / "hub",
            NewRequest(sheet=sheet, capture=CapturedFlux([file], line_to_line=True)),
        )


def test_a_flux_map_is_copied_beside_the_design(tmp_path: Path) -> None:
    lines = [
        f"{d};{q};{10 + 0.03 * d:.2f};{0.05 * q:.2f}"
        for d in range(-40, 1, 8)
        for q in range(0, 41, 8)
    ]
    file = tmp_path / "map.csv"
    file.write_text("\n".join(["i_d [A];i_q [A];psi_d [mVs];psi_q [mVs]", *lines]), "ascii")
    unknown = tmp_path / "unknown.csv"
    unknown.write_text("one,two,three,four\n0,0,0.1,0\n1,0,0.11,0\n0,1,0.1,0.02\n1,1,0.1,0.02\n")
    asked = NewRequest(sheet=SHEET, flux_map=file)
    answer = answer_new(tmp_path / "hub", asked)
    assert answer.files is not None
    contents = answer.files.contents
    assert contents["map.csv"] == file.read_bytes()
    machine = load_text(contents["design.yaml"], "design.yaml", tmp_path).machine
    assert machine.psi_pm == pytest.approx(0.01, rel=1e-3)
    # In its own folder nothing is copied; a file of its name in the other is kept.
    inside = answer_new(tmp_path, asked).files
    assert inside is not None
    assert "map.csv" not in inside.contents
    (tmp_path / "hub").mkdir()
    (tmp_path / "hub" / "map.csv").write_text("mine", "ascii")
    with pytest.raises(InputError, match="exists already"):
        answer_new(tmp_path / "hub", asked)
    for bad, words in (
        (replace(asked, axes="q"), "--axes: expected one of magnet-d, reluctance"),
        (replace(asked, flux_map=tmp_path / "none.csv"), "--map: there is no file 'none.csv'"),
        (replace(asked, flux_map=unknown), "'dqforge new' reads the headings: name them in the"),
        (replace(asked, machine="vdyno-trampa-6340"), "both define the design"),
    ):
        with pytest.raises(InputError, match=words):
            answer_new(tmp_path / "other", bad)


@pytest.mark.parametrize(
    ("given", "flag"),
    [
        ((None, None, "reluctance", None, False), "--map"),
        ((None, None, None, "1,1,1", False), "--capture"),
        ((None, None, None, None, True), "--capture"),
    ],
)
def test_what_is_said_of_a_file_needs_the_file(given: tuple[Any, ...], flag: str) -> None:
    *files, line_to_line = given
    with pytest.raises(InputError, match=f"write {flag} FILE"):
        recorded(*files, line_to_line=line_to_line)


MAP_WITHOUT_UNIT = "\n".join(
    ["i_d [A];i_q [A];psi_d;psi_q"]
    + [
        f"{d};{q};{60 + 0.2 * d:.2f};{0.3 * q:.2f}"
        for d in range(-40, 1, 8)
        for q in range(0, 41, 8)
    ]
)


def test_keys_of_a_flux_map_are_set_beside_it(tmp_path: Path) -> None:
    """The unit that its headings lack."""
    file = tmp_path / "map.csv"
    file.write_text(MAP_WITHOUT_UNIT, "ascii")
    asked = NewRequest(sheet=SHEET, flux_map=file)
    with pytest.raises(InputError, match=r"write --set machine\.flux_map\.flux_unit=mWb"):
        answer_new(tmp_path / "hub", asked)
    files = answer_new(
        tmp_path / "hub", replace(asked, settings=["machine.flux_map.flux_unit=mWb"])
    ).files
    assert files is not None
    found = load_text(files.contents["design.yaml"], "design.yaml", tmp_path).machine
    assert found.psi_pm == pytest.approx(0.06, rel=1e-3)


def test_keys_are_set_beside_the_values_of_a_data_sheet(tmp_path: Path) -> None:
    sheet = {key: text for key, text in SHEET.items() if key != "machine.max_current"}
    settings = ["machine.max_current=9 A", "machine.inductance=80 uH", "machine.kv=190 rpm/V"]
    files = answer_new(tmp_path / "hub", NewRequest(sheet=sheet, settings=settings)).files
    assert files is not None
    found = load_text(files.contents["design.yaml"], "design.yaml", None)
    assert found.machine.i_max == 9.0
    assert b"command line" in files.contents["design.yaml"]
    with pytest.raises(InputError, match=r"--set fit\.degre: unknown key"):
        answer_new(tmp_path / "hub", NewRequest(sheet=sheet, settings=[*settings, "fit.degre=3"]))


def test_own_values_replace_those_of_a_motor_of_the_library(tmp_path: Path) -> None:
    own = {"machine.resistance": "0.4 Ohm line-to-line", "machine.magnet_flux": "25 mWb"}
    asked = NewRequest("hoverboard-hub", sheet=own, settings=["machine.max_current=8 A"])
    answer = answer_new(tmp_path / "hub", asked)
    assert answer.files is not None
    text = answer.files.contents["design.yaml"]
    found = load_text(text, "design.yaml", None).machine
    assert (found.r_s, found.psi_pm, found.i_max) == (0.2, 0.025, 8.0)
    assert found.l_d == 0.336e-3  # of the library
    assert b"kv:" not in text
    assert text.count(b"\n#") == template("hoverboard-hub").count(b"\n#") + 1
    told = "\n".join(answer.notes)
    assert "--resistance '0.4 Ohm line-to-line' replaces machine.resistance: 0.179 Ohm" in told
    assert "--magnet-flux '25 mWb' replaces machine.kv: 16 rpm/V of hoverboard-hub" in told
    bare = NewRequest("hoverboard-hub", sheet={"machine.resistance": "0.4"})
    with pytest.raises(InputError, match=r"--resistance: '0\.4' has no unit"):
        answer_new(tmp_path / "x", bare)


def test_one_axis_of_its_own_leaves_the_other(tmp_path: Path) -> None:
    asked = NewRequest("abb-ipmsm-2k2", sheet={"machine.inductance_d": "20 mH phase"})
    files = answer_new(tmp_path / "abb", asked).files
    assert files is not None
    found = load_text(files.contents["design.yaml"], "design.yaml", None).machine
    before = load_text(template("abb-ipmsm-2k2"), "design.yaml", None).machine
    assert (found.l_d, found.l_q) == (0.02, before.l_q)
