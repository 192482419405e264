"""Texts of others: bounded, decoded in every encoding, binary refused, and given back as they
were.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.target import MOST_BYTES, decoded_file, plain_number, read_text_file

TEXT = "foc_motor_r = 0.05 # Ω\nnext\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_every_encoding_is_read_and_given_back_to_the_byte(encoding: str, ends: str) -> None:
    content = TEXT.replace("\n", ends).encode(encoding)
    file = decoded_file(content, "a.txt")
    assert file.text == TEXT
    assert file.encoded(file.text) == content


def test_latin_1_is_what_no_utf_8_is() -> None:
    content = "R = 5 mΩ; 20 °C\n".replace("Ω", "O").encode("latin-1")
    file = decoded_file(content, "a.txt")
    assert file.text == "R = 5 mO; 20 °C\n"
    assert file.encoded(file.text) == content


def test_what_an_encoding_cannot_hold_is_written_as_utf_8() -> None:
    file = decoded_file(b"20 \xb0C\n", "a.txt")
    assert file.encoded("Ω\n") == "Ω\n".encode()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "a.h:1: the file is empty"),
        (b" \n\t", "a.h:1: the file is empty"),
        (b"#define A 1\n\x00\x01", "a.h:2: this is binary data"),
        (b"\xff\xfeA", "a.h: the UTF-16 text is damaged"),
    ],
)
def test_what_is_no_text_is_refused_with_its_line(content: bytes, message: str) -> None:
    with pytest.raises(InputError) as refused:
        decoded_file(content, "a.h")
    assert str(refused.value).startswith(message)


def test_a_hundred_megabytes_are_refused_by_their_size(tmp_path: Path) -> None:
    """The file is sparse: nothing of it is there to be read, and nothing is."""
    path = tmp_path / "large.xml"
    with path.open("wb") as file:
        os.truncate(file.fileno(), 100_000_000)
    with pytest.raises(InputError, match=r"large.xml: the file has 100 MB, at most 8 MB"):
        read_text_file(path)
    assert MOST_BYTES == 8_000_000


def test_folders_pipes_and_nothing_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name, message in (("", "folder"), ("pipe", "named pipe"), ("none", "no such file")):
        with pytest.raises(InputError, match=message):
            read_text_file(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1.0),
        (" -2.5e-3 ", -2.5e-3),
        (".5", 0.5),
        ("5.", 5.0),
        ("1_000", None),
        ("nan", None),
        ("inf", None),
        ("1e999", None),
        ("0x10", None),
        ("", None),
        ("٣", None),
        ("1" * 61, None),
    ],
)
def test_numbers_are_decimal_and_finite(text: str, value: float | None) -> None:
    assert plain_number(text) == value
