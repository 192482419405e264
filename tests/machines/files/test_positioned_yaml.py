"""YAML with positions: plain values, limits, and complaints that point to the right place."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from dqforge.machines.errors import InputError, Position, dotted
from dqforge.machines.files.positioned_yaml import MAX_BYTES, parse_yaml, read_bytes


def _refused(content: bytes) -> InputError:
    with pytest.raises(InputError) as caught:
        parse_yaml(content, "f.yaml")
    return caught.value


def _message(content: bytes) -> str:
    """Message on a file that is wrong, or an empty text."""
    try:
        parse_yaml(content, "f")
    except InputError as error:
        return error.message
    return ""


def test_plain_scalars_follow_the_core_schema() -> None:
    text = b"""
    int: 12
    signed: -3
    leading: 010
    float: 1.5
    point: .5
    exponent: 1e5
    yes_word: yes
    time: 12:30
    date: 2020-01-01
    octal: 0o17
    hexadecimal: 0x1F
    grouped: 1_000
    infinite: .inf
    truth: true
    falsehood: False
    nothing: ~
    quoted: '5'
    """
    assert parse_yaml(text, "f").data == {
        "int": 12,
        "signed": -3,
        "leading": 10,
        "float": 1.5,
        "point": 0.5,
        "exponent": 1e5,
        "yes_word": "yes",
        "time": "12:30",
        "date": "2020-01-01",
        "octal": "0o17",
        "hexadecimal": "0x1F",
        "grouped": "1_000",
        "infinite": ".inf",
        "truth": True,
        "falsehood": False,
        "nothing": None,
        "quoted": "5",
    }


def test_positions_of_keys_and_values() -> None:
    document = parse_yaml(b"a:\n  b: [1, {c: x}]\n  d: >\n    text\n", "f")
    assert document.data == {"a": {"b": [1, {"c": "x"}], "d": "text\n"}}
    assert document.position(("a",), key=True) == Position(1, 1)
    assert document.position(("a", "b")) == Position(2, 6)
    assert document.position(("a", "b"), key=True) == Position(2, 3)
    assert document.position(("a", "b", 0)) == Position(2, 7)
    assert document.position(("a", "b", 1, "c")) == Position(2, 14)
    assert document.position(("a", "d")) == Position(3, 6)


def test_position_of_a_missing_part_is_its_section() -> None:
    document = parse_yaml(b"a:\n  b: 1\n", "f")
    assert document.position(("a", "x")) == Position(1, 1)
    assert document.position(("a", "x", "y")) == Position(1, 1)
    assert document.position(("x",)) == Position(1, 1)


def test_error_without_position_gets_one() -> None:
    document = parse_yaml(b"a:\n  b: 1\n", "dir/f.yaml")
    with (
        pytest.raises(InputError, match=r"dir/f\.yaml:2:6: a\.b: too small"),
        document.at(("a", "b")),
    ):
        raise InputError("too small")
    with pytest.raises(InputError, match=r"^other:7:8: x$"), document.at(("a", "b")):
        raise InputError("x", source="other", line=7, column=8)


def test_byte_order_mark_and_windows_line_ends() -> None:
    document = parse_yaml(b"\xef\xbb\xbfa: 1\r\nb: 2\r\n", "f")
    assert document.data == {"a": 1, "b": 2}
    assert document.position(("b",)) == Position(2, 4)


def test_not_utf8_behind_a_byte_order_mark_counts_columns_without_it() -> None:
    error = _refused(b"\xef\xbb\xbfa: \xff\n")
    assert (error.line, error.column) == (1, 4)


def test_duplicate_keys_in_different_sections_are_fine() -> None:
    assert parse_yaml(b"a: {x: 1}\nb: {x: 2}\n", "f").data == {"a": {"x": 1}, "b": {"x": 2}}


@pytest.mark.slow
def test_limits_stop_early() -> None:
    assert "32 levels" in _refused(b"[" * 200_000).message
    assert "more than 20000" in _refused(b"a: [" + b"1," * 500_000 + b"]").message
    assert "larger than" in _refused(b"a" * (MAX_BYTES + 1)).message


def test_depth_at_the_limit_is_read() -> None:
    assert parse_yaml(b"a: " + b"[" * 31 + b"]" * 31, "f").data


@pytest.mark.parametrize(
    ("content", "phrase"),
    [
        (b"a: 'x\n---\n", "quoted text is not closed"),
        (b"%YAML 3.0\n---\na: 1\n", "not YAML"),
        (b'a: "\\q"\n', "use single quotes"),
        (b"a: - b\n", "put it on its own indented line"),
        (b"  a: 1\nb: 2\n", "line up the keys"),
        (b"a: 1\n...\nb: 2\n", "does not continue the mapping above"),
        (b"a: [1, 2\nb: 3\n", "'[' is not closed"),
        (b"~\n", "the file is empty"),
    ],
)
def test_faults_in_plain_english(content: bytes, phrase: str) -> None:
    error = _refused(content)
    assert phrase in error.message
    assert "\n" not in str(error)
    assert str(error).startswith("f.yaml:")


@given(st.binary(max_size=200))
@settings(max_examples=400, deadline=None)
def test_any_bytes_are_read_or_refused_in_one_line(content: bytes) -> None:
    assert _message(content).isprintable()


@given(st.text(alphabet="ab:-{}[],&*!|>'\"%@`#?\n\t 1.~<=", max_size=60))
@settings(max_examples=400, deadline=None)
def test_any_punctuation_is_read_or_refused_in_one_line(text: str) -> None:
    assert _message(text.encode()).isprintable()


@pytest.mark.parametrize(
    "fault",
    [
        yaml.YAMLError("something\nunforeseen"),
        yaml.MarkedYAMLError(problem="something\nunforeseen"),
    ],
)
def test_unforeseen_fault_of_the_library(
    fault: yaml.YAMLError, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise fault

    monkeypatch.setattr(yaml, "parse", fail)
    assert str(_refused(b"a: 1\n")).startswith("f.yaml: not YAML: ")
    assert "unforeseen" in _message(b"a: 1\n")


def test_missing_file_suggests_a_similar_one(tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text("a: 1\n")
    with pytest.raises(InputError) as caught:
        read_bytes(tmp_path / "drvie.yaml")
    assert str(caught.value) == f"{tmp_path}/drvie.yaml: no such file; did you mean drive.yaml?"


def test_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="its folder does not exist either"):
        read_bytes(tmp_path / "no" / "drive.yaml")


def test_folder_instead_of_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="this is a folder; name the design file in it"):
        read_bytes(tmp_path)


def test_source_is_the_path_as_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        read_bytes("./x.yaml")
    assert caught.value.source == "./x.yaml"


def test_permission_error_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(InputError, match="check its permissions"):
        read_bytes(tmp_path / "x.yaml")


def test_path_that_no_file_can_have() -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_bytes("a\0b")


def test_huge_file_is_not_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "huge.yaml"
    with path.open("wb") as stream:
        stream.truncate(1 << 34)
    with pytest.raises(
        InputError, match=r"the file has 1\.718e\+04 MB, at most 1\.049 MB can be read"
    ):
        read_bytes(path)


def test_symbolic_links_are_followed(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_bytes(b"a: 1\n")
    (tmp_path / "b.yaml").symlink_to(tmp_path / "a.yaml")
    assert read_bytes(tmp_path / "b.yaml") == b"a: 1\n"


def test_dotted_paths_are_printable() -> None:
    assert dotted(("losses", "points", 0, "torque")) == "losses.points[0].torque"
    assert dotted(("\x1b[31m",)).isprintable()
