"""A changed text holds what was wanted, and everything else in it is as it was."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.files.positioned_yaml import (
    YamlValue,
    edited,
    parse_value,
    parse_yaml,
    written,
)

TEXT = """\
# a comment
name: x   # of the name
machine:
  poles: 6          # counted
  rated: {torque: 1 N m, current: {value: 2 A, kind: rms}}
  # between
  table:
    value: 3 Ohm
    source: |
      a text
      in lines
  empty:
points:
  - {torque: 1}
  - torque: 2
    speed: 3
list: [1, 2]
none: {}
"""


def changed(text: str, path: tuple[str | int, ...], value: YamlValue) -> str:
    old = parse_yaml(text.encode(), "x").data
    new: Any = copy.deepcopy(old)
    inner = new
    for part in path[:-1]:
        inner = inner[part]
    inner[path[-1]] = value
    found = edited(text, old, new)
    assert parse_yaml(found.encode(), "x").data == new
    return found


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        (("name",), "y: z", 'name: "y: z"   # of the name'),
        (("machine", "poles"), 8, "  poles: 8          # counted"),
        (
            ("machine", "rated", "current", "value"),
            "3 A",
            "  rated: {torque: 1 N m, current: {value: 3 A, kind: rms}}",
        ),
        (
            ("machine", "rated", "current", "source"),
            "me",
            "  rated: {torque: 1 N m, current: {value: 2 A, kind: rms, source: me}}",
        ),
        (("machine", "table"), 4.5, "    4.5"),
        (("machine", "table", "source"), "z", "    source: z"),
        (("machine", "empty"), True, "  empty: true"),
        (("points", 0, "torque"), -1, "  - {torque: -1}"),
        (("points", 1, "torque"), 1e-9, "  - torque: 1e-09"),
        (("points", 1, "new"), [1, "a"], "  - new: [1, a]"),
        (("list", 1), None, "list: [1, null]"),
        (("list",), [3], "list: [3]"),
        (("none", "a"), {"b": "1e3"}, 'none: {a: {b: "1e3"}}'),
        (("new",), False, "new: false"),
    ],
)
def test_one_value_changes_and_its_line_alone(
    path: tuple[str | int, ...], value: YamlValue, line: str
) -> None:
    found = changed(TEXT, path, value)
    assert line in found.splitlines()
    assert all(comment in found for comment in ("# a comment", "# of the name", "# counted"))
    kept = [before for before in TEXT.splitlines() if before in found.splitlines()]
    assert len(kept) >= len(TEXT.splitlines()) - (5 if path == ("machine", "table") else 3)


def test_true_is_not_one_and_one_is_not_a_float() -> None:
    for value in (1, 1.0, True, "1"):
        found = parse_yaml(changed("a: 2\nb: 1\n", ("a",), value).encode(), "x").data["a"]
        assert (type(found), found) == (type(value), value)
        assert "b: 1" in changed("a: 2\nb: 1\n", ("a",), value)
    for old, new in ((1, True), (True, 1), (1, 1.0)):
        assert edited(f"a: {written(old)}", {"a": old}, {"a": new}) == f"a: {written(new)}"


def test_what_is_the_same_is_the_same_text() -> None:
    data = parse_yaml(TEXT.encode(), "x").data
    assert edited(TEXT, data, copy.deepcopy(data)) == TEXT


@pytest.mark.parametrize(
    "text", ["? a\n: 1\n? b\n: {c: 2}\n", "{a: 1, b: {c: 2}}", "a: 1\r\nb: {c: 2}\r\n"]
)
def test_unusual_ways_to_write_a_mapping(text: str) -> None:
    changes: list[tuple[tuple[str, ...], YamlValue]] = [
        (("a",), 3),
        (("b", "c"), "x"),
        (("b", "d"), 4),
        (("new",), [1]),
    ]
    for path, value in changes:
        changed(text, path, value)


@pytest.mark.parametrize(
    "value",
    ["", " ", "a", "12 mOhm", "true", "null", "~", "1", "1e3", "a: b", "a #b", "- a", "'", '"',
     "\\", "é", "\U0001f600", "\t", "a\nb", "\u2028", "\x85", "[a]", "{a}", "a, b", "*a", "&a",
     "!a", "%a", "@a", "`a", "-5 %", "a ", "a:", "?", "<<"],
)  # fmt: skip
def test_every_text_is_read_back(value: str) -> None:
    assert parse_value(written(value), "x") == value
    assert parse_value(written([value, {"key": value}]), "x") == [value, {"key": value}]


def test_numbers_of_the_template_change_without_touching_its_comments() -> None:
    text = catalogue.template().decode()
    found = changed(text, ("machine", "poles"), 8)
    assert found.replace("poles: 8", "poles: 6", 1) == text
