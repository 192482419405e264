"""The table of values: each is a key of the design, and what is asked for leads to a design."""

from __future__ import annotations

import pytest
from data_sheets import MOTORS, DataSheet

from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.sections.inverter import InverterSection
from dqforge.machines.design.sections.machine_schema import MachineSection, RatedSection
from dqforge.machines.design.sheet_judged import read_alone
from dqforge.machines.design.sheet_values import (
    BY_KEY,
    SHEET_VALUES,
    SheetValue,
    as_command,
    assumed_frequency,
    missing,
    must_be_answered,
    next_asked,
)
from dqforge.machines.entries.kinds import Section

SIX = {
    "machine.pole_pairs",
    "machine.kv",
    "inverter.v_dc",
    "machine.max_current",
    "machine.resistance",
    "machine.inductance",
}


@pytest.mark.parametrize("value", SHEET_VALUES, ids=lambda value: value.label)
def test_each_is_a_key_of_the_design_and_its_example_is_read(value: SheetValue) -> None:
    *section, key = value.key.split(".")
    models: dict[tuple[str, ...], type[Section]] = {
        (): DesignFile,
        ("machine",): MachineSection,
        ("machine", "rated"): RatedSection,
        ("inverter",): InverterSection,
    }
    assert key in models[tuple(section)].model_fields
    found = read_alone(value.key, value.example)
    assert (found is None) == (value.key == "name")
    if found is not None and value.kinds:
        assert found.kind_given
        assert found.kind in [kind for kind, _ in value.kinds]


@pytest.mark.parametrize(
    "value", [value for value in SHEET_VALUES if value.kinds], ids=lambda value: value.label
)
def test_each_kind_that_may_be_chosen_is_read(value: SheetValue) -> None:
    number = value.example.partition(" ")[0]
    unit = {"back-emf-constant": "V/krpm", "torque-constant": "N m/A"}.get(value.label, "")
    unit = unit or value.example.split()[1]
    for kind, meaning in value.kinds:
        found = read_alone(value.key, f"{number} {unit} {kind}")
        assert found is not None
        assert (found.kind, found.kind_given) == (kind, True)
        assert meaning


def test_flags_and_labels_are_different_and_needs_have_ways() -> None:
    flags = [value.flag for value in SHEET_VALUES]
    assert len(set(flags)) == len({value.label for value in SHEET_VALUES}) == len(SHEET_VALUES)
    assert {"--kv", "--back-emf", "--inductance-d", "--rated-torque", "--v-dc"} <= set(flags)
    for value in SHEET_VALUES:
        assert set(value.instead) <= set(BY_KEY)
        assert value.use or value.need or value.convention


def test_what_is_missing_follows_the_way_that_was_begun() -> None:
    assert {value.key for value in missing(())} == SIX
    assert missing(SIX) == []
    begun = (SIX - {"machine.inductance"}) | {"machine.inductance_q"}
    assert [value.key for value in missing(begun)] == ["machine.inductance_d"]
    assert missing((SIX - {"machine.kv"}) | {"machine.magnet_flux"}) == []
    assert missing((SIX - {"machine.pole_pairs"}) | {"machine.poles"}) == []


def asked(known: set[str], empty: set[str], *, needed_only: bool = False) -> list[str]:
    """Keys that are asked for in turn, where some answers are empty."""
    known, skipped, order = set(known), list[str](), list[str]()
    while value := next_asked(known, skipped, needed_only=needed_only):
        order.append(value.key)
        if value.key in empty:
            assert not must_be_answered(value, known, skipped), value.key
            skipped.append(value.key)
        else:
            known.add(value.key)
    assert missing(known) == []
    return order


def test_every_value_is_asked_for_once_and_needless_ones_never() -> None:
    order = asked(set(), set())
    assert set(order) >= SIX
    assert not {"machine.poles", "machine.back_emf_constant", "machine.inductance_d"} & set(order)
    assert "machine.torque_constant" in order  # held against Kv
    assert order[:2] == ["name", "machine.pole_pairs"]


def test_an_empty_answer_leads_to_another_way_and_the_last_must_be_answered() -> None:
    empty = {"machine.pole_pairs", "machine.kv", "machine.inductance"}
    order = asked(set(), empty | {"machine.back_emf_constant", "machine.torque_constant"})
    assert {"machine.poles", "machine.magnet_flux", "machine.inductance_d"} <= set(order)
    first = {"machine.kv", "machine.back_emf_constant", "machine.torque_constant"}
    assert must_be_answered(BY_KEY["machine.magnet_flux"], (), tuple(first))
    assert must_be_answered(BY_KEY["machine.inductance_q"], (), ("machine.inductance",))
    assert must_be_answered(BY_KEY["inverter.v_dc"], (), ())
    assert not must_be_answered(BY_KEY["machine.inertia"], (), ())


def test_beside_what_is_given_only_needs_are_asked_for() -> None:
    order = asked({"machine.kv", "inverter.v_dc"}, set(), needed_only=True)
    assert set(order) == SIX - {"machine.kv", "inverter.v_dc"}
    assert asked(
        {"machine.inductance_d"} | (SIX - {"machine.inductance"}), set(), needed_only=True
    ) == ["machine.inductance_q"]


@pytest.mark.parametrize("motor", MOTORS.values(), ids=MOTORS)
def test_the_command_names_all_that_was_said(motor: DataSheet) -> None:
    words = as_command("DIR", motor.values)
    assert words[:3] == ["dqforge", "new", "DIR"]
    said = dict(zip(words[3::2], words[4::2], strict=True))
    assert said == dict(zip(motor.flags[::2], motor.flags[1::2], strict=True))


def test_the_switching_frequency_follows_the_voltage() -> None:
    assert assumed_frequency(None)[0] == assumed_frequency(120.0)[0] == "20 kHz"
    assert assumed_frequency(325.0)[0] == "10 kHz"
