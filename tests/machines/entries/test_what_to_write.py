"""Refusals of a value say what to write in its place, and that is read."""

from __future__ import annotations

import re
from typing import Any, get_args

import pytest

from dqforge.machines.entries import kinds
from dqforge.machines.entries.kinds import PartOrTimeRule, ShareRule
from dqforge.machines.entries.rules import EntryError, Rule
from dqforge.machines.files.positioned_yaml import parse_value


def rule(kind: Any) -> Rule:
    found = get_args(kind)[1]
    assert isinstance(found, Rule)
    return found


def refusal(of: Rule, raw: object) -> str:
    with pytest.raises(EntryError) as caught:
        of.read(raw)
    return caught.value.message


@pytest.mark.parametrize(
    ("kind", "text", "written"),
    [
        (kinds.SpeedConstant, "300 V/rpm", "300 rpm/V"),
        (kinds.MachineCurrent, "-20 A", "20 A"),
        (kinds.Speed, "-3000 rpm", "3000 rpm"),
        (kinds.Torque, "-2 N m", "2 N m"),
    ],
)
def test_what_is_the_wrong_way_round_is_offered_the_right_way(
    kind: Any, text: str, written: str
) -> None:
    said = refusal(rule(kind), text)
    assert said.endswith(f"; write '{written}'")
    assert rule(kind).read(written).si > 0.0


def test_a_back_emf_constant_is_no_speed_constant_on_its_head() -> None:
    assert refusal(rule(kinds.SpeedConstant), "60 V/krpm").endswith("which is a back-EMF constant")


def test_the_letter_r_is_an_ohm() -> None:
    assert [rule(kinds.Resistance).read(text).si for text in ("0.38 R", "0.38R")] == [0.38, 0.38]


@pytest.mark.parametrize("text", ["8 B", "20 Q", "7 LB"])
def test_a_unit_that_is_none_is_told_once(text: str) -> None:
    said = refusal(rule(kinds.MachineCurrent), text)
    assert said.count("12 A") == 1
    assert "did you mean" not in said


@pytest.mark.parametrize(
    "words", ["between two wires", "wire to wire", "two wires", "line-to-line"]
)
def test_what_two_wires_leave_open_the_instrument_tells(words: str) -> None:
    of = rule(kinds.BackEmfConstant)
    said = refusal(of, f"12.3 V at 500 rpm {words}")
    rms, peak = re.findall(r"'(12\.3 V at 500 rpm [^']+)'", said)
    assert "a multimeter on AC shows rms: '12.3 V at 500 rpm line-to-line rms'" in said
    assert of.read(peak).kind == "line-to-line peak"
    assert of.read(rms).kind == "line-to-line rms"


@pytest.mark.parametrize("of", [ShareRule(), PartOrTimeRule()], ids=["share", "time"])
@pytest.mark.parametrize(
    ("raw", "low", "high"),
    [
        ({"from": "50 %", "to": "-30 %"}, -0.3, 0.5),
        ({"min": "-10 %", "max": "10 %"}, -0.1, 0.1),
        ({"lower": "-10 %", "upper": "10 %"}, -0.1, 0.1),
        ("-10..10 %", -0.1, 0.1),
        ("-10 % to +10 %", -0.1, 0.1),
        ("-5/+10 %", -0.05, 0.1),
    ],
    ids=str,
)
def test_ends_in_another_form_are_written_out(
    of: ShareRule, raw: object, low: float, high: float
) -> None:
    (text,) = re.findall(r"\{.*\}$", refusal(of, raw))
    found = of.read(parse_value(text, "f"))
    assert (found.low.si, found.high.si) == (low, high)


def test_a_sign_of_both_ways_is_left_out() -> None:
    assert refusal(ShareRule(), "±10 %") == "'±10 %' holds both ways; write '10 %'"
    assert "has two ends" not in refusal(ShareRule(), "10,5 %")
