"""Tables read in blocks against the same tables read whole."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.files import text_table as text_blocks
from dqforge.machines.files.text_table import TextTable, read_table


@pytest.fixture
def in_blocks(monkeypatch: pytest.MonkeyPatch) -> Callable[[bytes], TextTable]:
    """Reads a small table as if it were a large one."""

    def read(content: bytes) -> TextTable:
        with monkeypatch.context() as small:
            small.setattr(text_blocks, "_HEAD", 900)
            small.setattr(text_blocks, "_BLOCK", 300)
            small.setattr(text_blocks, "_FIRST_ROWS", 10)
            small.setattr("dqforge.machines.files.text_table.LARGE", 1000)
            return read_table(content, "scope.csv")

    return read


def table(delimiter: str, decimal: str, count: int = 200) -> list[str]:
    """A heading and rows of a time, an amplitude with an exponent and a whole number."""
    generator = np.random.default_rng(4)
    rows = [
        f"{k * 1e-3:.4f}|{generator.normal():.5e}|{generator.integers(-9, 9)}" for k in range(count)
    ]
    lines = ["made by a tool", "t [s]|u [V]|n", *rows]
    return [line.replace(".", decimal).replace("|", delimiter) for line in lines]


def edited(name: str, lines: list[str]) -> bytes:
    """The same table as tools write it, or with something odd far from its beginning."""
    text = "\n".join(lines) + "\n"
    delimiter = next(
        mark
        for mark in (";", ",", "\t", " ")
        if mark in lines[1].replace("t [s]", "").replace("u [V]", "")
    )
    odd: dict[str, Callable[[], bytes]] = {
        "plain": text.encode,
        "end of line": text.replace("\n", "\r\n").encode,
        "carriage returns": text.replace("\n", "\r").encode,
        "utf-16": lambda: text.encode("utf-16"),
        "no last line feed": text.rstrip("\n").encode,
        "blank lines": lambda: "\n\n".join(lines).encode(),
        "comment": lambda: "\n".join([*lines[:120], "# a remark", *lines[120:]]).encode(),
        "hole": lambda: "\n".join(
            [*lines[:120], f"0{delimiter}{delimiter}3", *lines[120:]]
        ).encode(),
        "nan": lambda: "\n".join(
            [*lines[:120], f"0{delimiter}nan{delimiter}3", *lines[120:]]
        ).encode(),
        "marks at the ends": lambda: "\n".join(
            [*lines[:2], *(f"{line}{delimiter}" for line in lines[2:])]
        ).encode(),
        "text": lambda: "\n".join(
            [*lines[:120], f"0{delimiter}overload{delimiter}3", *lines[120:]]
        ).encode(),
        "short row": lambda: "\n".join([*lines[:120], f"0{delimiter}1", *lines[120:]]).encode(),
        "cut off": text[: text.rindex(delimiter)].encode,
        "footer": (text + "end of data\n").encode,
        "infinite": lambda: "\n".join(
            [*lines[:120], f"0{delimiter}1e999{delimiter}3", *lines[120:]]
        ).encode(),
        "binary": lambda: "\n".join([*lines[:120], "\0\0", *lines[120:]]).encode(),
        "second table": lambda: "\n".join([*lines, *lines[1:]]).encode(),
    }
    return odd[name]()


NAMES = (
    "plain",
    "end of line",
    "carriage returns",
    "utf-16",
    "no last line feed",
    "blank lines",
    "comment",
    "hole",
)
FAULTS = ("text", "short row", "cut off", "footer", "infinite", "binary", "second table")


@pytest.mark.parametrize("name", [*NAMES, "nan", "marks at the ends"])
@pytest.mark.parametrize(
    ("delimiter", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]
)
def test_blocks_make_the_same_table(
    name: str, delimiter: str, decimal: str, in_blocks: Callable[[bytes], TextTable]
) -> None:
    content = edited(name, table(delimiter, decimal))
    whole, parts = read_table(content, "scope.csv"), in_blocks(content)
    np.testing.assert_array_equal(parts.values, whole.values)
    np.testing.assert_array_equal(parts.lines, whole.lines)
    assert (parts.names, parts.units, parts.preamble) == (whole.names, whole.units, whole.preamble)


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), (";", ",")])
def test_faults_have_the_same_line(
    name: str, delimiter: str, decimal: str, in_blocks: Callable[[bytes], TextTable]
) -> None:
    content = edited(name, table(delimiter, decimal))
    with pytest.raises(InputError) as whole:
        read_table(content, "scope.csv")
    with pytest.raises(InputError) as parts:
        in_blocks(content)
    assert str(parts.value) == str(whole.value)


def test_too_many_numbers_are_refused_before_they_are_parsed(
    monkeypatch: pytest.MonkeyPatch, in_blocks: Callable[[bytes], TextTable]
) -> None:
    monkeypatch.setattr(text_blocks, "MOST_NUMBERS", 500)
    with pytest.raises(
        InputError, match=r"rows of 3 columns, at most 0\.0005 million numbers can be read"
    ):
        in_blocks(edited("plain", table(",", ".")))


def test_the_share_that_is_read_ascends_to_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dqforge.machines.files.text_table.LARGE", 1000)
    monkeypatch.setattr(text_blocks, "_HEAD", 900)
    monkeypatch.setattr(text_blocks, "_BLOCK", 300)
    told: list[float] = []
    read_table(edited("plain", table(",", ".")), "scope.csv", told.append)
    assert len(told) > 10
    assert told == sorted(told)
    assert told[-1] == 1.0
