"""Figures in pages: their data as they stand in the links, and one without content."""

from __future__ import annotations

import base64
import csv
import html
import io
import re
from urllib.parse import unquote_to_bytes

from markupsafe import Markup
from matplotlib.figure import Figure

from dqforge.reports.pages.templating import DataFile, PageFigure

Table = dict[str, list[str]]


def blank_figure(figure: Figure, name: str) -> PageFigure:
    """In place of a drawing, where its place in the page is all that matters."""
    del figure
    return PageFigure(
        Markup("<svg></svg>"), "", Markup("[]"), DataFile(f"{name}.csv", "data:text/csv,")
    )


def linked_text(link: str) -> str:
    """The table in a link."""
    head, _, body = html.unescape(link).partition(",")
    if head.endswith(";base64"):
        return base64.b64decode(body).decode()
    return unquote_to_bytes(body).decode()


def table_of(text: str) -> Table:
    """Columns by their headings, without the empty cells at their ends."""
    heads, *rows = csv.reader(io.StringIO(text))
    assert len(set(heads)) == len(heads), heads
    assert all(len(row) == len(heads) for row in rows)
    table = {}
    for k, head in enumerate(heads):
        cells = [row[k] for row in rows]
        while cells and not cells[-1]:
            cells.pop()
        table[head] = cells
    return table


def page_tables(page: str) -> dict[str, Table]:
    """The data of every figure of a page by file name."""
    found = re.findall(r'download="([^"]*)" href="(data:[^"]*)"', page)
    return {name: table_of(linked_text(link)) for name, link in found}
