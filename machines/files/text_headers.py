"""Names, units and settings that stand above or beside the rows of a text table."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dqforge.machines.files.text_cells import Cells
from dqforge.machines.files.text_formats import BLANKS, SAMPLE, SHOW, TEXT, IndexArray, Layout
from dqforge.machines.records import dataclass
from dqforge.machines.units.registry import COMPOUNDS, SYMBOLS

_UNDERSCORE_UNITS = frozenset(
    {"A", "mA", "kA", "V", "mV", "kV", "s", "ms", "us", "ns", "rad", "deg", "rpm", "Hz"}
)


_UNDERSCORE_UNITS |= {"Wb", "mWb", "Vs", "mVs", "Nm", "W"}


_PHASES = ("ABC", "UVW")


_UNIT_WORDS = frozenset(
    {"volt", "volts", "ampere", "amperes", "amp", "amps", "second", "seconds", "sec", "weber"}
)


_UNIT_WORDS |= {
    "degree",
    "degrees",
    "radian",
    "radians",
    "newtonmeter",
    "watt",
    "watts",
    "hertz",
    "sequence",
    "u/min",
}


_OTHERWISE = ("U", "r", "tr", "F")


_UNIT_PARTS = re.compile(r"[\s/*·^().-]+|\d+")


_BRACKETED = re.compile(r"(.*?)(?:\[([^\[\]]*)\]|\(([^()]*)\))")


_SEPARATED = re.compile(r"(.+?)\s*(?:/|,|\sin\s)\s*(.+)")


_WRAPPED = re.compile(r"[\[(](.*)[\])]")


_OPENING = re.compile(r" (?=[\[(])")


_CHANNEL_UNIT = re.compile(r"\b[A-Za-z]+\d+:([^\s,;:]+)")


_SCOPE_UNITS = re.compile(r"(horizontal|vertical) units?\W*[,;:=\t ]\s*(.*)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Header:
    """What stands above the rows about some of the file's columns."""

    columns: IndexArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    preamble: tuple[str, ...]


def read_header(layout: Layout, start: int, kept: IndexArray) -> Header:
    """Names and units of columns from the lines above the rows.

    The other lines there are the preamble.
    """
    above = layout.said_above(start).tolist()
    row = _units_row(layout, above[-1], kept) if above else None
    found = _title_line(layout, above[:-1] if row else above, kept)
    if row and not found and not all(_WRAPPED.fullmatch(cell) for cell in row if cell):
        row, found = None, _title_line(layout, above, kept)
    place, titles = found or (None, [""] * kept.size)
    used = {place, above[-1] if row else None}
    settings = _settings_beside(
        layout, [line for line in (place, above[-1] if row else None) if line is not None], kept
    )
    parts = [_name_and_unit(title.translate(SHOW), titles) for title in titles]
    given = [_WRAPPED.sub(r"\1", cell).strip("-") for cell in row or [""] * kept.size]
    return Header(
        kept,
        tuple(
            name or f"column {column + 1}" for (name, _), column in zip(parts, kept, strict=True)
        ),
        tuple(unit or own for unit, (_, own) in zip(given, parts, strict=True)),
        (
            *(layout.lines[line].translate(SHOW).strip() for line in above if line not in used),
            *settings,
        ),
    )


def _settings_beside(layout: Layout, lines: Sequence[int], kept: IndexArray) -> list[str]:
    """What a title and perhaps a unit line hold beside the columns: 'Increment,2e-5' or 'tInc =
    2e-5'.
    """
    if layout.form.delimiter == " ":
        return []
    rows = [layout.form.split(layout.lines[line].lstrip("#% ")) for line in lines]
    others = sorted(set(range(max(map(len, rows), default=0))) - set(kept.tolist()))
    texts = [
        ",".join(row[column] for row in rows if column < len(row) and row[column])
        for column in others
    ]
    return [text.translate(SHOW) for text in texts if any(map(str.isdigit, text))]


def _title_line(
    layout: Layout, above: Sequence[int], kept: IndexArray
) -> tuple[int, list[str]] | None:
    """The nearest line of content or comment that has a title for each column, and the titles."""
    nearest = {layout.comment[line]: line for line in above}
    for loosely in (False, True):
        for line in sorted(nearest.values(), reverse=True):
            titles = titles_in(layout, line, kept, loosely=loosely)
            if titles:
                return line, titles
    return None


def titles_in(layout: Layout, line: int, kept: IndexArray, *, loosely: bool) -> list[str] | None:
    """Titles that a line has for columns, None if it has too few, too many or numbers among them.

    A header may be parted in another way than the rows; `loosely` tries that too.
    """
    text = layout.lines[line].lstrip("#% ") if layout.comment[line] else layout.lines[line]
    joined = _OPENING.sub("", BLANKS.sub(" ", text))
    splits = [layout.form.split(joined if layout.form.delimiter == " " else text)]
    if loosely and layout.width > 1:
        others = [
            [cell.strip() for cell in text.split(mark)] for mark in ("\t", ";", "|", ",", "  ")
        ]
        splits += [cells for cells in [*others, joined.split()] if len(cells) == layout.width]
    for cells in ([cell.rstrip(",;") for cell in split] for split in splits):
        # Some write settings behind the titles ('t0 = -1e-3').
        while cells and (not cells[-1] or (len(cells) > layout.width and "=" in cells[-1])):
            cells.pop()
        if not kept[-1] < len(cells) <= layout.width:
            continue
        titles = [cells[column] for column in kept]
        if any(titles) and all(layout.form.number(title) is None for title in titles if title):
            return titles
    return None


def _units_row(layout: Layout, line: int, kept: IndexArray) -> list[str] | None:
    """Cells of a line for columns if all are units, '-' or empty."""
    text = layout.lines[line].lstrip("#% ") if layout.comment[line] else layout.lines[line]
    cells = layout.form.split(text)
    if len(cells) <= kept[-1]:
        return None
    row = [cells[column].translate(SHOW) for column in kept]
    plain = [_WRAPPED.sub(r"\1", cell) for cell in row]
    units = [_is_unit(cell) for cell in plain if cell not in ("", "-")]
    return row if units and all(units) else None


def _is_unit(text: str) -> bool:
    """Whether a text is a unit, or a product or quotient of units; alone U is
    a phase, r a radius and F a force.
    """
    if text in _OTHERWISE:
        return False
    parts = [part for part in _UNIT_PARTS.split(text) if part]
    known = all(
        part in SYMBOLS or part in COMPOUNDS or part.lower() in _UNIT_WORDS for part in parts
    )
    return (bool(parts) and known) or text.lower() in _UNIT_WORDS


def _name_and_unit(title: str, titles: Sequence[str]) -> tuple[str, str]:
    """Part a title such as 'id [A]', 'psi_d (mVs)', 'Time, s', 't / s' or
    'id_A' into name and unit.

    In 'I_A' beside 'I_B' or 'U_V' beside 'U_W' the letter is a phase.
    """
    title = " ".join(title.strip(" \"'").split())
    bracketed = _BRACKETED.fullmatch(title)
    if bracketed and (bracketed[2] is not None or _is_unit(bracketed[3])):
        return bracketed[1].rstrip(" _,/"), (bracketed[2] or bracketed[3] or "").strip(" -")
    separated = _SEPARATED.fullmatch(title)
    if separated and _is_unit(separated[2]):
        return separated[1], separated[2]
    name, mark, unit = title.rpartition("_")
    phases = [
        f"{name}_{letter}"
        for group in _PHASES
        if unit in group
        for letter in group
        if letter != unit
    ]
    if name and mark and unit in _UNDERSCORE_UNITS and not set(phases) & set(titles):
        return name, unit
    return title, ""


def texts_beside(
    layout: Layout, rows: IndexArray, kinds: Cells, kept: IndexArray
) -> tuple[str, ...]:
    """Texts in the columns left out, where few rows have any: one line of text per row."""
    left_out = np.setdiff1d(np.arange(layout.width), kept)
    lines = rows[np.any(kinds[:, left_out] == TEXT, axis=1)]
    if lines.size > SAMPLE or 2 * lines.size > rows.size:
        return ()
    cells = [
        [layout.form.split(layout.lines[line])[column] for column in left_out] for line in lines
    ]
    return tuple(",".join(cell for cell in row if cell).translate(SHOW) for row in cells)


def scope_units(preamble: Sequence[str], count: int) -> tuple[str, ...]:
    """Units that an oscilloscope gives as 'Horizontal Units' and 'Vertical Units',
    '' where there are none.
    """
    found = {match[1].lower(): match[2] for match in map(_SCOPE_UNITS.match, preamble) if match}
    time = re.split(r"[,;\t]", found.get("horizontal", ""))[0].strip(" \"'")
    vertical = found.get("vertical", "")
    channels = _CHANNEL_UNIT.findall(vertical) or re.split(r"[,;\t]", vertical)
    channels = [unit for part in channels if (unit := part.strip(" \"'"))]
    if len(channels) == 1:
        channels *= count - 1
    return (time, *channels) if len(channels) == count - 1 else (time, *[""] * (count - 1))
