"""Flux maps in spreadsheets (.xlsx): each sheet becomes the text that a table
of the same cells would be.

What the sheets claim is counted in the archive first: the reader lays out every cell
between the outermost ones.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Sequence
from typing import IO

from dqforge.machines.errors import InputError
from dqforge.machines.files.named_arrays import reading

_MOST_BYTES = 64_000_000


_MOST_CELLS = 2_000_000


_BLOCK = 1 << 20


_CELL = re.compile(rb'\br="([A-Z]{1,3})(\d{1,7})"')


_ROW = re.compile(rb'<(?:\w+:)?row\b[^>]*?\br="(\d{1,7})"')


_ANY_CELL = re.compile(rb"<(?:\w+:)?c[\s/>]")


def sheets(content: bytes, source: str) -> list[tuple[str, bytes]]:
    """Name of each sheet with numbers and its cells as text, tabs between
    them and one line per row.

    Raises:
        InputError: The file is no workbook, or its sheets take more than 64 MB or 2e6 cells.
    """
    from python_calamine import CalamineWorkbook

    found = []
    with reading("xlsx", source):
        _check_claims(content, source)
        book = CalamineWorkbook.from_filelike(io.BytesIO(content))
        for name in book.sheet_names:
            rows = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            if any(
                isinstance(cell, float | int) and not isinstance(cell, bool)
                for row in rows
                for cell in row
            ):
                found.append(
                    (name, "\n".join("\t".join(map(_text, row)) for row in _trimmed(rows)).encode())
                )
    if not found:
        raise InputError("no sheet holds numbers", source=source)
    return found


def _trimmed(rows: Sequence[Sequence[object]]) -> list[Sequence[object]]:
    """Rows without the columns to the left and the right that are empty throughout."""
    used = [k for row in rows for k, cell in enumerate(row) if cell != ""]
    low, high = min(used, default=0), max(used, default=0)
    return [row[low : high + 1] for row in rows]


def _text(cell: object) -> str:
    """A cell as text without tabs and line feeds."""
    return repr(cell) if isinstance(cell, float) else " ".join(str(cell).split())


def _check_claims(content: bytes, source: str) -> None:
    """Refuse workbooks that unfold to more than the limits."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        if sum(member.file_size for member in members) > _MOST_BYTES:
            message = f"the workbook takes more than {_MOST_BYTES / 1e6:g} MB once unpacked"
            raise InputError(f"{message}; save the map alone, or as CSV", source=source)
        for member in members:
            if member.filename.startswith("xl/worksheets/") and member.filename.endswith(".xml"):
                with archive.open(member) as stream:
                    columns, rows, cells = _extent(stream)
                if max(columns * rows, cells) > _MOST_CELLS:
                    message = (
                        f"{member.filename} has {cells} cells over {rows} rows and {columns} "
                        "columns"
                    )
                    raise InputError(f"{message}; save the map alone, or as CSV", source=source)


def _extent(stream: IO[bytes]) -> tuple[int, int, int]:
    """Largest column and row that cells and rows of a sheet name, and the number of cells."""
    columns = rows = 1
    cells = 0
    rest = b""
    while block := stream.read(_BLOCK):
        text = rest + block
        cells += len(_ANY_CELL.findall(text)) - len(_ANY_CELL.findall(rest))
        for letters, row in _CELL.findall(text):
            number = 0
            for letter in letters:
                number = 26 * number + letter - 64
            columns, rows = max(columns, number), max(rows, int(row))
        rows = max([rows, *map(int, _ROW.findall(text))])
        rest = text[-64:]
    return columns, rows, cells
