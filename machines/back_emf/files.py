"""Files of captures: text, gzip and MATLAB, one with all channels or one for each,
with their headings beside them.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import PurePath

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.columns import BemfCapture, CaptureOptions, capture_from_tables
from dqforge.machines.errors import InputError
from dqforge.machines.files.named_arrays import NamedArray
from dqforge.machines.files.number_table import read_table
from dqforge.machines.files.text_blocks import Progress
from dqforge.machines.files.text_formats import decoded_text
from dqforge.machines.files.text_table import TextTable

MOST_BYTES = 256_000_000  # Bytes of a capture, packed and unpacked.
_MOST_HEADING = 1_000_000
_TIME_LIKE = re.compile(r"t|time.*|zeit.*|theta.*|angle.*|x", re.IGNORECASE)
_LEAST_SAMPLES = 2


def read_captures(
    names: Sequence[str],
    read: Callable[[str], bytes],
    exists: Callable[[str], bool],
    options: CaptureOptions,
    progress: Progress | None = None,
) -> BemfCapture:
    """Samples of one capture in one file, or in several with some of the channels each.

    Args:
        names: Names of the files: text of any layout, .mat, or one of these with .gz behind it.
            Where oscilloscopes write the heading into a file of its own (cap.csv beside
            cap.Wfm.csv), either name will do.
        read: Content of a file of at most `MOST_BYTES`.
        exists: Whether there is a file.
        options: What the user says about the columns.
        progress: Told the share that is read.

    Raises:
        InputError: A file is not what it claims to be, with the line where that begins, or the
            files make no capture.
    """
    if len(set(names)) < len(names):
        raise InputError("one file is given twice; name one for each channel", source=names[-1])
    tables = []
    for place, name in enumerate(names):

        def share(done: float, place: int = place) -> None:
            if progress is not None:
                progress((place + done) / len(names))

        data, heading = _pair(name, exists)
        table = _table(read(data), data, share)
        tables.append(table if heading is None else _headed(table, read(heading), heading))
    return capture_from_tables(tables, options)


def _pair(name: str, exists: Callable[[str], bool]) -> tuple[str, str | None]:
    """Names of the file with the samples and of that with their heading, if there are two."""
    if (split := re.fullmatch(r"(.*)\.wfm\.csv", name, re.IGNORECASE)) is not None:
        headings = (f"{split[1]}.csv", f"{split[1]}.CSV")
        return name, next((heading for heading in headings if exists(heading)), None)
    if name.lower().endswith(".csv"):
        samples = (f"{name[:-4]}.Wfm.csv", f"{name[:-4]}.Wfm.CSV")
        return next(((data, name) for data in samples if exists(data)), (name, None))
    return name, None


def _headed(table: TextTable, content: bytes, source: str) -> TextTable:
    """Table with the lines of its heading's file before its own."""
    if len(content) > _MOST_HEADING:
        raise InputError(
            f"a heading has at most {_MOST_HEADING / 1e6:g} MB; check the file", source=source
        )
    lines = [line.strip() for line in decoded_text(content, source).split("\n")]
    return replace(table, preamble=(*(line for line in lines if line), *table.preamble))


def _table(content: bytes, source: str, progress: Progress) -> TextTable:
    """Table of a file by its suffix."""
    path = PurePath(source)
    if path.suffix.lower() == ".gz":
        content, path = _unpacked(content, source), path.with_suffix("")
    return (
        _matlab(content, source)
        if path.suffix.lower() == ".mat"
        else read_table(content, source, progress)
    )


def _unpacked(content: bytes, source: str) -> bytes:
    """Content of a gzip file, of one or several members; what it claims to be is not believed."""
    if content[:2] != b"\x1f\x8b":
        raise InputError("this is no gzip file; give it the suffix of its format", source=source)
    damaged = InputError("the gzip file is cut off or damaged; pack it again", source=source)
    parts, room = [], MOST_BYTES + 1
    while content:
        member = zlib.decompressobj(wbits=31)
        try:
            parts.append(member.decompress(content, room))
        except zlib.error as error:
            raise damaged from error
        room -= len(parts[-1])
        if room <= 0:
            message = (
                f"the file has more than {MOST_BYTES / 1e6:g} MB once unpacked; save fewer columns "
                "or samples"
            )
            raise InputError(message, source=source)
        if not member.eof:
            raise damaged
        content = member.unused_data.lstrip(b"\0")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _matlab(content: bytes, source: str) -> TextTable:
    """Vectors of a MATLAB file as the columns of a table, its single numbers as settings.

    Lines count the samples.
    """
    arrays = [
        array
        for array in _arrays(content, source)
        if array.numeric and array.values.dtype.kind != "c"
    ]
    settings = tuple(
        f"{array.name},{array.values.item()!r}" for array in arrays if array.values.size == 1
    )
    columns = [column for array in arrays for column in _vectors(array)]
    sizes = [values.size for _, values in columns]
    count = max(sizes, key=lambda size: (sizes.count(size), size), default=0)
    if count < _LEAST_SAMPLES:
        raise InputError(
            "the file holds no vectors of numbers; save times and voltages as vectors",
            source=source,
        )
    columns = [(name, values) for name, values in columns if values.size == count]
    columns.sort(key=lambda column: _TIME_LIKE.fullmatch(column[0]) is None)
    table = np.empty((count, len(columns)))
    for place, (_, values) in enumerate(columns):
        table[:, place] = values
    names = tuple(name for name, _ in columns)
    return TextTable(source, names, ("",) * len(names), table, np.arange(1, count + 1), settings)


def _arrays(content: bytes, source: str) -> list[NamedArray]:
    """Arrays of a MATLAB file of any version, of a bounded size."""
    from dqforge.machines.files.archives import arrays_of_hdf5
    from dqforge.machines.files.matlab_arrays import arrays_of_mat4, arrays_of_mat5

    if any(content[place : place + 8] == b"\x89HDF\r\n\x1a\n" for place in (0, 512, 1024, 2048)):
        return arrays_of_hdf5(content, source)
    reader = arrays_of_mat5 if content[124:128] in (b"\0\1IM", b"\1\0MI") else arrays_of_mat4
    return reader(content, source)


def _vectors(array: NamedArray) -> list[tuple[str, FloatArray]]:
    """Vectors of an array of one or two dimensions, the longer of which runs over the samples."""
    values = np.squeeze(array.values)
    if values.ndim == 1:
        return [(array.name, values)]
    if values.ndim != 2:
        return []
    rows = values if values.shape[0] < values.shape[1] else values.T
    return [(f"{array.name}({place})", row) for place, row in enumerate(rows, start=1)]
