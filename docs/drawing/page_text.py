"""What a page of the documentation says, for figures that draw it: one fact has one place."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]


def table(page: str, corner: str) -> dict[str, dict[str, str]]:
    """Cells by row and column of the first table of a page whose head begins with ``corner``."""
    lines = iter((DOCS / page).read_text(encoding="utf-8").splitlines())
    head = next(cells for cells in map(_cells, lines) if cells and cells[0] == corner)
    next(lines)
    rows: dict[str, dict[str, str]] = {}
    for cells in map(_cells, lines):
        if not cells:
            break
        rows[cells[0]] = dict(zip(head[1:], cells[1:], strict=True))
    return rows


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("|")[1:-1]] if line[:1] == "|" else []


def written_file(page: str, name: str) -> str:
    """Text of the file that a page has its reader write: the block with that caption."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = re.search(
        rf"^:caption: {re.escape(name)}\n\n(.*?)^```$", text, re.DOTALL | re.MULTILINE
    )
    if found is None:
        raise ValueError(f"{page}: no block with the caption {name}")
    return found.group(1)
