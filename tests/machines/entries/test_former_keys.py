"""Keys by their former names: read as the present ones, told, and edited where they stand."""

from __future__ import annotations

from pathlib import Path

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.schema import DesignFile, json_schema
from dqforge.machines.entries.former_keys import (
    former_keys,
    text_with_present_names,
    with_present_names,
)
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.design_keys import design_key
from dqforge.machines.files.positioned_yaml import parse_yaml

PRESENT = catalogue.read_text("paper000-ipmsm-100kw").decode()
FORMER = PRESENT.replace("max_torque: ", "torque_max: ")
LOOP = "control: {current_loop: {method: bandwidth, bandwidth: 300 Hz, 'phase_margin_min': 40 deg}}"
SMALL = f"""\
dqforge: 1
name: Small
machine: {{pole_pairs: 3, resistance: 2.35 Ohm, inductance_d: 1.6 mH, inductance_q: 1.7 mH,
  magnet_flux: 0.06 Wb, max_current: 6.4 A}}
inverter: {{v_dc: 180 V, switching_frequency: 10 kHz}}
{LOOP}
fit: {{torque_max: 1.5 N m}}
"""


def test_the_sentence_on_the_former_name_is_all_that_differs() -> None:
    assert FORMER != PRESENT
    now, before = (load_text(text.encode(), "d.yaml") for text in (PRESENT, FORMER))
    remark = (
        "fit.max_torque is written by its former name torque_max; files of format 1 may keep it"
    )
    assert set(before.assumptions) - set(now.assumptions) == {remark}
    assert set(now.assumptions) <= set(before.assumptions)
    assert before.fit == now.fit
    assert before.control == now.control
    assert before.values == now.values
    assert before.digest != now.digest  # that of the file as it is


def test_all_former_keys_are_read_where_they_stand() -> None:
    design = load_text(SMALL.encode(), "d.yaml")
    assert design.fit.torque_max == pytest.approx(1.5)
    assert design.control.current_loop.min_phase_margin == pytest.approx(0.6981317)
    assert sum("former name" in text for text in design.assumptions) == 2
    wrong = SMALL.replace("1.5 N m", "1.5 A")
    with pytest.raises(InputError, match=r"^d\.yaml:7:19: fit\.max_torque: "):
        load_text(wrong.encode(), "d.yaml")


def test_both_names_at_once_are_refused() -> None:
    both = SMALL.replace("{torque_max: 1.5 N m}", "{max_torque: 1 N m, torque_max: 1.5 N m}")
    with pytest.raises(InputError, match=r"^d\.yaml:7:26: fit\.torque_max is the former name of "):
        load_text(both.encode(), "d.yaml")


@pytest.mark.parametrize("name", ["fit.torque_max", "fit.max_torque"])
@pytest.mark.parametrize("text", [SMALL, SMALL.replace("torque_max", "max_torque")])
def test_options_and_studies_set_a_key_by_either_name(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "d.yaml").write_text(text, encoding="utf-8")
    design = load_design(tmp_path / "d.yaml", [f"{name}=1.2 N m"])
    assert design.fit.torque_max == pytest.approx(1.2)
    assert design.given is not None
    assert load_text(design.given.text, "again").fit.torque_max == pytest.approx(1.2)
    key = design_key(name)
    assert key is not None
    assert key.path == ("fit", "max_torque")


def test_only_the_keys_of_the_text_change() -> None:
    document = with_present_names(parse_yaml(SMALL.encode(), "d.yaml"), DesignFile)
    changed = text_with_present_names(SMALL, document)
    wanted = SMALL.replace("torque_max", "max_torque").replace(
        "'phase_margin_min'", "'min_phase_margin'"
    )
    assert changed == wanted
    same = parse_yaml(wanted.encode(), "d.yaml")
    assert with_present_names(same, DesignFile) is same


def test_the_schema_knows_former_names_as_deprecated() -> None:
    texts = json_schema()["$defs"]
    for *section, old in former_keys(DesignFile):
        present = former_keys(DesignFile)[(*section, old)]
        holders = [
            each["properties"] for each in texts.values() if old in each.get("properties", {})
        ]
        assert holders, old
        for properties in holders:
            assert properties[old]["deprecated"] is True
            assert "former" not in properties[present]
            assert "deprecated" not in properties[present]
