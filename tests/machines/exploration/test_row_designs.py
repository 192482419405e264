"""Designs of rows: those of files that say the same, with the study's places, maps read once."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from broken_studies import BASE, changed

from dqforge.machines.design import catalogue as designs
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.sections import machine, machine_files
from dqforge.machines.devices import catalogue as devices
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.row_designs import (
    design_of,
    design_text_of,
    maker_of,
)
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_checks import read_study, study_of_text
from dqforge.machines.files.positioned_yaml import YamlValue

CASES: tuple[tuple[str, dict[str, YamlValue]], ...] = (
    ("paper000-ipmsm-100kw", {"machine.resistance": "3 mOhm", "fit.degree": 2}),
    ("paper000-ipmsm-100kw", {"inverter.device": {"name": "sirectifier-sii400s12"}}),
    ("paper000-ipmsm-100kw", {"losses.points[0].torque": "20 N m", "control.observer.pole": 900.0}),
    ("baldor-pmsyrm-5k6", {"inverter.v_dc": "300 V", "machine.inertia": 0.02}),
    ("abb-syrm-6k7-saturated", {"operation.strategy": "mtpa", "fit.segments": 1}),
    ("paper001-pmsm-bench", {"machine.magnet_flux": "0.05 Wb"}),
    ("vdyno-trampa-6340", {"machine.max_speed": "3000 rpm"}),
)


def study_on(name: str) -> Study:
    return Study("trial", "", designs.read_text(name), f"{name}.yaml", "")


def without_origin(design: Design) -> Design:
    values = tuple(replace(value, source="", text="") for value in design.values)
    return replace(design, values=values, digest="", given=None, places=None, assumptions=())


@pytest.mark.parametrize(("name", "assigned"), CASES)
def test_a_row_is_the_design_of_a_file_that_says_so(
    name: str, assigned: dict[str, YamlValue]
) -> None:
    study = study_on(name)
    found = design_of(study, assigned)
    text = design_text_of(study, assigned)
    again = load_text(text, "again.yaml")
    assert repr(without_origin(found)) == repr(without_origin(again))
    assert text.count(b"#") >= study.design_text.count(b"#") // 2
    # What it was read from can be read again.
    assert found.given is not None
    assert repr(without_origin(load_text(found.given.text, "given.yaml"))) == repr(
        without_origin(found)
    )


def test_a_value_keeps_the_kind_of_its_entry() -> None:
    text = designs.read_text("paper000-ipmsm-100kw").replace(
        b"{value: 2 mOhm, kind: phase", b"{value: 4 mOhm, kind: line-to-line"
    )
    study = Study("trial", "", text, "drive.yaml", "")
    assert design_of(study, {}).machine.r_s == 2e-3
    assert design_of(study, {"machine.resistance": "6 mOhm"}).machine.r_s == 3e-3
    own: dict[str, YamlValue] = {"value": "6 mOhm", "kind": "phase"}
    assert design_of(study, {"machine.resistance": own}).machine.r_s == 6e-3


def test_rows_leave_the_design_as_it_is() -> None:
    study = study_on("paper000-ipmsm-100kw")
    before = repr(without_origin(design_of(study, {})))
    design_of(study, {"losses.points[0].torque": "1 N m", "machine.resistance": 1.0})
    with pytest.raises(InputError):
        design_of(study, {"machine.resistance": "1 V"})
    assert repr(without_origin(design_of(study, {}))) == before
    assert design_of(study, {}).digest != design_of(study, {"fit.degree": 3}).digest


def test_maps_and_tables_are_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = Mock(wraps=devices.load)
    monkeypatch.setattr(devices, "load", read)
    study = study_on("paper000-ipmsm-100kw")
    first, second = (
        design_of(
            study,
            {"inverter.device": {"name": "sirectifier-sii400s12"}, "machine.resistance": value},
        )
        for value in ("2 mOhm", "3 mOhm")
    )
    read.assert_called_once_with("sirectifier-sii400s12")
    assert first.inverter.device == second.inverter.device
    assert first.assumptions == second.assumptions

    made = Mock(wraps=machine._saturation_map)
    monkeypatch.setattr(machine, "_saturation_map", made)
    saturated = study_on("baldor-pmsyrm-5k6")
    machines = [design_of(saturated, {"inverter.v_dc": v_dc}).machine for v_dc in (300.0, 310.0)]
    assert made.call_count == 1
    assert machines[0] == machines[1]
    design_of(saturated, {"machine.max_current": "10 A"})
    assert made.call_count == 2


def test_a_flux_map_is_read_once_and_told_in_every_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = ["id,iq,psid,psiq"]
    for i_d in range(-20, 1, 4):
        lines += [f"{i_d},{i_q},{0.1 + 2e-3 * i_d},{6e-3 * i_q}" for i_q in range(-20, 21, 4)]
    (tmp_path / "map.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "drive.yaml").write_text(
        "dqforge: 1\nname: a\nmachine:\n  model: flux-map\n  pole_pairs: 3\n  resistance: 0.2 Ohm\n"
        "  flux_map: {file: map.csv, axes: magnet-d}\n  max_current: 15 A\n"
        "inverter: {v_dc: 100 V, switching_frequency: 10 kHz}\n",
        encoding="utf-8",
    )
    (tmp_path / "study.yaml").write_text(
        "dqforge_study: 1\nname: a\ndesign: drive.yaml\nvary: {inverter.v_dc: [90, 100, 110]}\n",
        encoding="utf-8",
    )
    study = read_study(tmp_path / "study.yaml")
    assert [name for name, _ in study.named] == ["map.csv"]
    # Workers have no folder: what the study names travels with it.
    study = pickle.loads(pickle.dumps(study))
    (tmp_path / "map.csv").unlink()
    made = Mock(wraps=machine_files._one_map)
    monkeypatch.setattr(machine_files, "_one_map", made)
    found = [design_of(study, {"inverter.v_dc": v_dc}) for v_dc in (90.0, 100.0, 110.0)]
    assert [call.args[1] for call in made.call_args_list] == ["map.csv"]
    assert [design.inverter.v_dc for design in found] == [90.0, 100.0, 110.0]
    assert found[0].flux_evidence == found[2].flux_evidence != ()
    assert found[0].machine == found[2].machine
    given = found[2].given
    assert given is not None
    assert [name for name, _ in given.named] == ["map.csv"]


def test_files_of_rows_lie_beside_the_study(tmp_path: Path) -> None:
    (tmp_path / "devices").mkdir()
    for name in ("a", "b"):
        content = devices.read_text("sirectifier-sii400s12")
        (tmp_path / "devices" / f"{name}.yaml").write_bytes(content)
    (tmp_path / "study.yaml").write_text(
        changed(
            (
                "operation.strategy: [mtpa, id0]",
                "inverter.device: {files: devices/*.yaml}",
            )
        ),
        encoding="utf-8",
    )
    study = read_study(tmp_path / "study.yaml")
    assert [step[0] for step in study.axes[1].steps] == [
        {"file": "devices/a.yaml"},
        {"file": "devices/b.yaml"},
    ]
    assert [name for name, _ in study.named] == ["devices/a.yaml", "devices/b.yaml"]
    design = design_of(study, {"inverter.device": study.axes[1].steps[1][0]})
    assert design.inverter.device_model == devices.load("sirectifier-sii400s12")


def test_refusals_name_the_place_in_the_study() -> None:
    study = study_of_text(BASE.encode(), "study.yaml")
    with pytest.raises(InputError) as caught:
        design_of(study, {"inverter.switching_frequency": "1e9 Hz"})
    assert str(caught.value).startswith(
        "study.yaml:5:3: vary.inverter.switching_frequency: '1e9 Hz' is outside"
    )
    with pytest.raises(InputError) as caught:
        design_of(study, {"inverter.v_dc": "0.5 V"})
    assert str(caught.value).startswith("study.yaml:11:3: tolerances.inverter.v_dc: ")
    # What the design itself says is named by its own place.
    low: dict[str, YamlValue] = {"inverter.switching_frequency": "10 kHz"}
    with pytest.raises(InputError) as caught:
        design_of(study, low)
    assert str(caught.value).startswith("paper000-ipmsm-100kw.yaml:")
    assert "control.sampling_frequency 100 kHz does not belong" in str(caught.value)


def test_the_maker_is_kept_for_its_study() -> None:
    study = study_on("paper000-ipmsm-100kw")
    assert maker_of(study) is maker_of(study)
    assert maker_of(study) is not maker_of(replace(study, name="another"))
