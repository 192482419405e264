"""Keys of a design by their paths: what stands there, and numbers that are read as written."""

from __future__ import annotations

import math
import random

import pytest
from design_changes import _fields

from dqforge.machines.design.schema import DesignFile
from dqforge.machines.entries.rules import EntryError, QuantityRule
from dqforge.machines.errors import dotted
from dqforge.machines.exploration.design_keys import DesignKey, design_key, no_such_key
from dqforge.machines.units.quantities import parse_quantity
from dqforge.machines.units.registry import DIMENSIONS, SYMBOLS

ALL = sorted({dotted(path) for path, _, _ in _fields(DesignFile, ())})


def key(name: str) -> DesignKey:
    found = design_key(name)
    assert found is not None
    return found


def test_every_key_of_the_schema_is_found() -> None:
    assert len(ALL) > 200
    assert [name for name in ALL if design_key(name) is None] == []


def test_what_stands_at_a_key() -> None:
    assert (key("inverter.v_dc").sort, key("inverter.v_dc").unit) == ("quantity", "V")
    assert key("machine.poles").sort == "count"
    assert key("fit.degree").sort == "whole"
    assert key("machine.saturation.a_d0").sort == "real"
    assert key("operation.strategy").words == ("mtpa", "id0")
    modulations = key("losses.modulations")
    assert modulations.listed
    assert "svpwm" in modulations.words
    assert key("losses.points[1].torque").path == ("losses", "points", 1, "torque")
    assert key("losses.points.1.torque").path == ("losses", "points", 1, "torque")
    assert key("inverter.device.on_resistance").dimension == "resistance"
    assert design_key("inverter.v_dc.unit") is None
    assert design_key("losses.points[x].torque") is None
    assert design_key("") is None


@pytest.mark.parametrize("dimension", sorted(DIMENSIONS))
def test_a_number_is_read_as_it_is_written(dimension: str) -> None:
    draw = random.Random(1)
    one = DesignKey("a.b", ("a", "b"), "quantity", dimension, rule=QuantityRule(dimension, 1, 2))
    for _ in range(100):
        number = draw.gauss(0.0, 1.0) * 10.0 ** draw.randint(-9, 6)
        found, kind = one.number(one.written(number))
        assert found == number
        assert kind is None


def test_every_spelling_of_a_unit_is_that_of_designs() -> None:
    """What a design takes for a number of a key, a study takes for the same number."""
    tried = 0
    for dimension in DIMENSIONS:
        one = DesignKey("a", ("a",), "quantity", dimension, rule=QuantityRule(dimension, 1, 2))
        for symbol in SYMBOLS:
            text = f"2.5 {symbol}"
            try:
                expected = parse_quantity(text, dimension)
            except ValueError:
                with pytest.raises(EntryError):
                    one.number(text)
            else:
                assert one.number(text)[0] == expected
                tried += 1
    assert tried > 100


def test_kinds_are_those_of_the_key() -> None:
    resistance = key("machine.resistance")
    assert resistance.number({"value": "4 mOhm", "kind": "line-to-line"}) == (4e-3, "line-to-line")
    assert resistance.number("4 mOhm") == (4e-3, None)
    assert resistance.written(4e-3, "line-to-line") == {
        "value": "0.004 Ohm",
        "kind": "line-to-line",
    }
    assert resistance.number("4 mOhm phase-to-phase") == (4e-3, "line-to-line")
    with pytest.raises(EntryError, match="did you mean 'line-to-line'"):
        resistance.number({"value": 1, "kind": "line-to-lime"})
    assert key("machine.poles").written(8.0) == 8
    assert isinstance(key("machine.poles").written(8.0), int)
    with pytest.raises(EntryError):
        key("fit.degree").number(2.5)
    # Numbers that no design may have are numbers all the same: their rows are refused.
    assert math.isclose(resistance.number("-5 MOhm")[0], -5e6)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("inverter.switching_frequncy", "inverter.switching_frequency"),
        ("machine.r_s", "machine.resistance"),
        ("inverter.vdc", "inverter.v_dc"),
        ("v_dc", "inverter.v_dc"),
        ("machne.resistance", "machine.resistance"),
        ("machine.l_q", "machine.inductance_q"),
    ],
)
def test_a_misspelt_key_is_told(name: str, meant: str) -> None:
    assert f"did you mean {meant}" in no_such_key(name)
