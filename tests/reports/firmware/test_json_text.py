"""JSON of others: lines for complaints, bounds before anything is read, values replaced where they
stand.
"""

from __future__ import annotations

import json
import random
from typing import Any

import pytest

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.json_text import parsed_json, with_json_values

FILE = """{
  "axis0": {
    "motor": {"config": {"pole_pairs": 7, "phase_resistance": 5.0e-2, "list": [1, {"a": null}]}},
    "name": "a \\"b\\" {"
  },
  "vbus": 1.50e0, "on": true
}
"""


def test_values_have_their_lines_and_their_texts() -> None:
    found = parsed_json(FILE, "o.json")
    config = ("axis0", "motor", "config")
    assert found.number(*config, "phase_resistance") == 0.05
    assert found.written(*config, "phase_resistance") == "5.0e-2"
    assert found.whole(*config, "pole_pairs") == 7
    assert found.line(*config, "pole_pairs") == 3
    assert found.line("axis0", "name") == 4
    assert found.value(*config, "list", 1, "a") is None
    assert (*config, "list", 1, "a") in found.spans
    assert found.number("nothing", "here") is None


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (("axis0", "name"), "o.json:4: axis0.name is"),
        (("on",), "o.json:6: on is 'true', not a number"),
        (("axis0",), "o.json:2: axis0 is 'dict', not a number"),
    ],
)
def test_other_things_than_numbers_are_refused_with_their_line(
    path: tuple[str, ...], message: str
) -> None:
    with pytest.raises(InputError) as refused:
        parsed_json(FILE, "o.json").number(*path)
    assert str(refused.value).startswith(message)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("[" * 100_000, 1, "levels"),
        ('{"a":\n' * 40 + "1" + "}" * 40, 33, "levels"),
        ("[" + "1," * 200_000 + "1]", 1, "values"),
        ('{"a": 1,\n "b": }', 2, "not JSON"),
        ('{"a": 1,\n "a": 2}', 2, "twice"),
        ('{"a":\n NaN}', 2, "NaN"),
        ('{"a": ' + "1" * 10_000 + "}", 1, "digits"),
        ('"', 1, "not JSON"),
    ],
)
def test_hostile_texts_are_refused_in_one_line(text: str, line: int | None, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        parsed_json(text, "o.json")
    assert refused.value.line == line
    assert "\n" not in str(refused.value)


def test_numbers_beyond_all_bounds_are_refused() -> None:
    found = parsed_json('{"a": 1e999, "b": 1.5}', "o.json")
    with pytest.raises(InputError, match="a is beyond"):
        found.number("a")
    with pytest.raises(InputError, match="write a whole number"):
        found.whole("b")


def test_values_are_replaced_where_they_stand() -> None:
    values = {
        ("axis0", "motor", "config", "pole_pairs"): 15,
        ("axis0", "controller", "config", "vel_gain"): 0.5,
        ("new",): "x",
    }
    new = with_json_values(FILE, "o.json", values)
    wanted: Any = json.loads(FILE)
    wanted["axis0"]["motor"]["config"]["pole_pairs"] = 15
    wanted["axis0"]["controller"] = {"config": {"vel_gain": 0.5}}
    wanted["new"] = "x"
    assert json.loads(new) == wanted
    assert '"phase_resistance": 5.0e-2, "list": [1, {"a": null}]' in new
    assert '"vbus": 1.50e0, "on": true' in new


def test_a_value_takes_no_keys() -> None:
    with pytest.raises(InputError, match=r"o.json:6: vbus is no object"):
        with_json_values(FILE, "o.json", {("vbus", "a"): 1})


def _random(generator: random.Random, depth: int) -> Any:
    kind = generator.randrange(6 if depth else 4)
    if kind == 4:
        return {f"k{k}": _random(generator, depth - 1) for k in range(generator.randrange(4))}
    if kind == 5:
        return [_random(generator, depth - 1) for _ in range(generator.randrange(4))]
    return (generator.random(), generator.randrange(-9, 9), 'a "[,:{\\', None)[kind]


def test_spans_hold_what_they_are_said_to_hold() -> None:
    """Over random values every span is the text of the value at its path."""
    generator = random.Random(5)
    for _ in range(200):
        value = {"root": _random(generator, 4)}
        text = json.dumps(value, indent=generator.choice([None, 1, 4]))
        found = parsed_json(text, "o.json")
        for path, (start, end) in found.spans.items():
            assert json.loads(text[start:end]) == found.value(*path)
