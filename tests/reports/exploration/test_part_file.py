"""Parts of a study: the same bytes wherever they are made, and no change of them unseen."""

from __future__ import annotations

import hashlib
import io
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from study_blocks import COLUMNS, DEVICES, Rows

from dqforge.optimizer.exploration.row_block import STATES, ColumnSpec, RowBlock
from dqforge.reports.exploration.part_file import (
    PartError,
    check_seal,
    encode_part,
    part_about,
    part_columns,
)

DIGEST = "ab" * 32
BLOCK = Rows(1000).rows(200, 300)
PART = encode_part(BLOCK, COLUMNS, DIGEST)


def small(values: np.ndarray, name: str = "out.x") -> bytes:
    count = len(values)
    block = RowBlock(
        0, {name: values}, np.zeros((count, 16), np.uint8), np.zeros(count, np.int8), ("",) * count
    )
    return encode_part(block, (ColumnSpec(name),), DIGEST)


def test_what_goes_in_comes_out() -> None:
    names = [column.name for column in COLUMNS]
    found = part_columns(PART, [*names, "key", "message"], COLUMNS)
    assert (found.first, found.count) == (200, 100)
    for name in names:
        assert np.array_equal(found.columns[name], BLOCK.columns[name], equal_nan=True), name
        assert found.columns[name].dtype == BLOCK.columns[name].dtype
    assert np.array_equal(found.keys, BLOCK.keys)
    assert np.array_equal(found.states, BLOCK.states)
    assert found.messages == BLOCK.messages
    assert part_about(PART).digest == DIGEST
    assert part_about(encode_part(Rows(9).rows(0, 9), COLUMNS, DIGEST)).audited == {
        "losses.total": 1e-15
    }


def test_options_of_the_file() -> None:
    about = parquet.ParquetFile(io.BytesIO(PART)).metadata
    assert (about.format_version, about.num_row_groups, about.num_rows) == ("2.6", 1, 100)
    group = about.row_group(0)
    for place in range(group.num_columns):
        column = group.column(place)
        assert column.compression == "ZSTD"
        assert column.has_dictionary_page == (
            column.path_in_schema in ("state", "in.inverter.device")
        )
    assert b"ARROW:schema" not in about.metadata
    assert b'"out.losses.total":"W"' in about.metadata[b"dqforge.columns"]


def test_nan_and_zero_have_one_spelling() -> None:
    payload = np.array([0x7FF8000000000123, 0xFFF8000000000000], np.uint64).view(np.float64)
    strange = small(np.array([payload[0], payload[1], -0.0, 1.0]))
    assert strange == small(np.array([np.nan, np.nan, 0.0, 1.0]))


def test_words_are_sorted_whatever_their_places() -> None:
    words = ("b", "a", "c")
    codes = np.array([0, 1, 1, -1], np.int32)
    block = RowBlock(
        0, {"in.w": codes}, np.zeros((4, 16), np.uint8), np.zeros(4, np.int8), ("",) * 4
    )
    data = encode_part(block, (ColumnSpec("in.w", "", "choice", words),), DIGEST)
    resorted = replace(block, columns={"in.w": np.array([1, 0, 0, -1], np.int32)})
    other = encode_part(resorted, (ColumnSpec("in.w", "", "choice", ("a", "b", "c")),), DIGEST)
    assert data == other
    assert parquet.read_table(pa.BufferReader(data))["in.w"].to_pylist() == ["b", "a", "a", None]


@pytest.mark.parametrize("count", [0, 1])
def test_parts_of_no_row_and_of_one(count: int) -> None:
    data = encode_part(Rows(1000).rows(3, 3 + count), COLUMNS, DIGEST)
    found = part_columns(data, ["in.inverter.device", "message"], COLUMNS)
    assert (found.count, len(found.messages)) == (count, count)


def test_texts_that_utf_8_cannot_hold_and_many_lines() -> None:
    block = replace(
        Rows(9).rows(0, 2), messages=("a\ud800b\n\0c", "dqforge.sha256\x18@" + "0" * 64)
    )
    data = encode_part(block, COLUMNS, DIGEST)
    check_seal(data)
    assert part_columns(data, ["message"], COLUMNS).messages == (
        "a?b\n\0c",
        "dqforge.sha256\x18@" + "0" * 64,
    )


def test_a_column_too_many_or_too_short_is_refused() -> None:
    with pytest.raises(ValueError, match="a block has the columns"):
        encode_part(BLOCK, COLUMNS[:-1], DIGEST)
    short = dict(BLOCK.columns) | {"out.losses.total": np.zeros(3)}
    with pytest.raises(ValueError, match=r"another length than 100: out\.losses\.total"):
        encode_part(replace(BLOCK, columns=short), COLUMNS, DIGEST)


def test_every_flipped_bit_of_a_small_part_is_found() -> None:
    data = bytearray(small(np.array([1.0, 2.0, np.nan])))
    check_seal(bytes(data))
    missed = []
    for place in range(len(data)):
        for bit in range(8):
            data[place] ^= 1 << bit
            try:
                check_seal(bytes(data))
            except PartError:
                pass
            else:
                missed.append((place, bit))
            data[place] ^= 1 << bit
    assert missed == []


def test_every_truncation_of_a_small_part_is_found() -> None:
    data = small(np.array([1.0, 2.0, np.nan]))
    for length in range(len(data)):
        with pytest.raises(PartError):
            part_columns(data[:length], ["out.x"], (ColumnSpec("out.x"),))
    for strange in (b"", b"PAR1" * 4, b"\xff" * 12 + b"PAR1", data + b"\0", b"PAR1" + data):
        with pytest.raises(PartError):
            check_seal(strange)


def test_pages_have_checksums_beside_the_seal() -> None:
    """Who reads a part with another program finds a change of values as well."""
    place = PART.index(b"PAR1", 0) + len(PART) // 2
    changed = bytearray(PART)
    changed[place] ^= 1
    with pytest.raises(OSError, match=r"(?i)checksum|crc"):
        parquet.ParquetFile(io.BytesIO(bytes(changed)), page_checksum_verification=True).read()


def test_the_same_bytes_in_other_processes_and_with_other_threads() -> None:
    script = (
        "import hashlib, sys; sys.path.insert(0, sys.argv[1]); import pyarrow as pa\n"
        "pa.set_cpu_count(int(sys.argv[2]))\n"
        "from study_blocks import COLUMNS, Rows\n"
        "from dqforge.reports.exploration.part_file import encode_part\n"
        "part = encode_part(Rows(1000).rows(200, 300), COLUMNS, 'ab' * 32)\n"
        "print(hashlib.sha256(part).hexdigest())\n"
    )
    tests = Path(__file__).parents[2]
    for threads, seed in (("1", "0"), ("8", "77")):
        done = subprocess.run(
            [sys.executable, "-c", script, str(tests), threads],
            env=os.environ | {"PYTHONHASHSEED": seed, "OMP_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.strip() == hashlib.sha256(PART).hexdigest()


def test_states_are_all_written() -> None:
    states = np.arange(len(STATES), dtype=np.int8)
    block = replace(Rows(9).rows(0, len(STATES)), states=states)
    data = encode_part(block, COLUMNS, DIGEST)
    assert tuple(parquet.read_table(pa.BufferReader(data))["state"].to_pylist()) == STATES
    assert np.array_equal(part_columns(data, [], COLUMNS).states, states)


def test_a_word_that_the_study_does_not_know_is_refused() -> None:
    others = tuple(
        replace(column, choices=DEVICES[:2]) if column.kind == "choice" else column
        for column in COLUMNS
    )
    with pytest.raises(PartError, match="a word unknown to the study"):
        part_columns(PART, ["in.inverter.device"], others)
