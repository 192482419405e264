"""Devices by file and by name in a design: derived constants, remarks, digest and faults."""

from __future__ import annotations

from pathlib import Path

import pytest
from simple_losses import loss_budget

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.schema import json_schema
from dqforge.machines.devices import catalogue as device_catalogue
from dqforge.machines.errors import InputError

TEXT = catalogue.read_text("paper000-ipmsm-100kw").decode()
START, END = TEXT.index("  device:\n"), TEXT.index("control:\n")


def design(device: str, folder: Path | None = None) -> Design:
    return load_text((TEXT[:START] + device + TEXT[END:]).encode(), "f.yaml", folder)


NAMED = """  device:
    name: microchip-mscsm70am10ct3ag
    junction_temperature: 112.32 degC
    reference_current: 206.55 A
    thermal_resistance: 0.306 K/W
"""


def test_named_device_has_the_losses_of_the_constants() -> None:
    """The paper's module by name gives the loss of table 4's first column like the
    constants of the shipped design.
    """
    named, inline = design(NAMED), load_text(TEXT.encode(), "f.yaml")
    assert named.inverter.device_model == device_catalogue.load("microchip-mscsm70am10ct3ag")
    assert inline.inverter.device_model is None
    assert named.inverter.device is not None
    assert inline.inverter.device is not None
    assert named.inverter.device.switching_energy == pytest.approx(
        inline.inverter.device.switching_energy, rel=1e-12
    )
    assert named.inverter.device.thermal_resistance == inline.inverter.device.thermal_resistance
    losses = [
        loss_budget(drive.machine, drive.inverter, 0.0, 206.55, 300.0, "spwm").total
        for drive in (named, inline)
    ]
    assert losses[0] == pytest.approx(losses[1], rel=1e-9)
    assert losses[0] == pytest.approx(1064.0, abs=1.0)


def test_remarks_say_where_the_tables_were_made_constants() -> None:
    sentences = design("  device: {name: microchip-mscsm70am10ct3ag}\n").assumptions
    assert any("made constants at 283 A, 500 V and 100 degC" in sentence for sentence in sentences)
    assert any(
        "outside the tables of on-state voltage, turn-on energy" in sentence
        for sentence in sentences
    )
    assert any(
        "0.2174 K/W by its data, from junction to case alone" in sentence for sentence in sentences
    )
    assert any("no data for the diode" in sentence for sentence in sentences)


def test_file_beside_the_design(shared_data: Path, tmp_path: Path) -> None:
    name = "Fuji_2MBI300XBE120-50.json"
    (tmp_path / name).write_bytes((shared_data / "devices" / name).read_bytes())
    drive = design(f"  device: {{file: {name}, junction_temperature: 125 degC}}\n", tmp_path)
    device, model = drive.inverter.device, drive.inverter.device_model
    assert device is not None
    assert model is not None
    assert (device.kind, model.name) == ("igbt", "Fuji_2MBI300XBE120-50")
    assert device.thermal_resistance == pytest.approx(0.08 + 0.025, rel=1e-3)
    assert device == model.switch_device(283.0, 500.0, 125.0)


def test_digest_covers_the_device(tmp_path: Path) -> None:
    text = device_catalogue.read_text("sirectifier-sii400s12")
    entry = "  device: {file: d.yaml}\n"
    (tmp_path / "d.yaml").write_bytes(text)
    first = design(entry, tmp_path)
    (tmp_path / "d.yaml").write_bytes(text.replace(b"32 mJ", b"33 mJ"))
    second = design(entry, tmp_path)
    assert first.digest != second.digest
    assert first.inverter.device != second.inverter.device
    assert design(NAMED).digest != design(NAMED.replace("112.32", "112.33")).digest


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("  device: {name: sirectifier-sii400}\n", "did you mean sirectifier-sii400s12"),
        ("  device: {name: a, file: b}\n", "write either file or name"),
        ("  device: {file: nothing.json}\n", "no file 'nothing.json'"),
        ("  device: {file: ../d.json}\n", "outside the folder"),
        ("  device: {file: d.json}\n", "d.json:1:2: not JSON"),
        ("  device: {file: d.txt}\n", "write .json"),
        ("  device: {file: e.json}\n", "e.json: switch"),
        ("  device: {name: ti-csd19505ktt}\n", "above the 80 V"),
        (
            "  device: {name: ti-csd19505ktt, on_resistance: 1 mOhm}\n",
            "unknown key 'on_resistance'",
        ),
        (
            "  device: {name: ti-csd19505ktt, junction_temperature: 400 degC}\n",
            "inverter.device.junction_temperature",
        ),
        (
            "  device: {kind: mosfet, on_resistance: 1 mOhm}\n",
            "inverter.device needs the key 'turn_on_energy'",
        ),
        ("  device: {kind: mosfet, rds_on: 1 mOhm}\n", "did you mean 'on_resistance'"),
        (
            TEXT[START:END].replace("kind: mosfet", "kind: triac"),
            "inverter.device.kind: expected one of mosfet, igbt",
        ),
        ("  device: [1]\n", "inverter.device: expected a section"),
    ],
)
def test_faults_are_named_with_their_place(device: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "d.json").write_text("{")
    (tmp_path / "d.txt").write_text("{")
    (tmp_path / "e.json").write_text('{"type": "IGBT", "switch": [], "diode": null}')
    with pytest.raises(InputError) as caught:
        design(device, tmp_path)
    text = str(caught.value)
    assert words in text
    assert caught.value.line is not None
    assert "(constants)" not in text
    assert "(reference)" not in text


def test_schema_offers_both_forms() -> None:
    inverter = json_schema()["$defs"]["InverterSection"]["properties"]["device"]
    assert {part["$ref"].rpartition("/")[2] for part in inverter["oneOf"]} == {
        "DeviceSection",
        "DeviceReference",
    }
