"""Lines of files that were read: kept as they were, and never of what is no text, or large."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import line_of, read_regular_file, remember


def test_lines_are_those_that_were_read(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("\ufeffone\r\nzwei ä\nthree".encode())
    read_regular_file(path, 1000, "a.csv")
    path.write_bytes(b"changed since\n")
    lines = [line_of("a.csv", number) for number in range(5)]
    assert lines == [None, "one", "zwei ä", "three", None]
    assert line_of(str(path), 1) is None  # messages call it otherwise
    path.unlink()
    with pytest.raises(InputError):
        read_regular_file(path, 1000, "a.csv")
    assert line_of("a.csv", 1) == "one"


def test_what_is_no_text_or_large_is_not_kept() -> None:
    for content in (gzip.compress(b"one\ntwo"), b"PK\x03\x04one", b"a\x00b", b"x" * 4_000_001):
        remember("b", b"before")
        remember("b", content)
        assert line_of("b", 1) is None
    remember("c", b"\xff\xfe caf\xe9\n")
    assert line_of("c", 1) == "\ufffd\ufffd caf\ufffd"


def test_few_files_are_kept() -> None:
    for number in range(20):
        remember(f"file {number}", b"text")
    assert [number for number in range(20) if line_of(f"file {number}", 1)] == [*range(12, 20)]
