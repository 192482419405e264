"""What is said of frame tables: summary, terminal, report, plain data."""

from __future__ import annotations

from dataclasses import asdict

from dqforge.optimizer.frame_tables.fit import FrameCandidate, FrameTables
from dqforge.reports.pages.html_table import HtmlTable, Row
from dqforge.reports.pages.html_text import ceiling, share
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData

_COLUMNS = ("intervals", "bytes", "torque dqx %", "torque dqy %", "coupling %", "back-EMF %")


def _candidates(found: FrameTables) -> tuple[FrameCandidate, ...]:
    """The emitted one first."""
    return (found.chosen, *reversed(found.coarser))


def _shares(entry: FrameCandidate) -> tuple[float, ...]:
    errors = entry.errors
    return (errors.torque_x, errors.torque_y, errors.coupling, errors.emf)


def _size(entry: FrameCandidate) -> tuple[str, str]:
    return f"{entry.table.size * entry.table.parts}", f"{entry.table.flash}"


def frame_rows(found: FrameTables) -> list[tuple[str, str]]:
    """The summary of a run."""
    intervals, flash = _size(found.chosen)
    worst = 100.0 * found.chosen.errors.torque
    return [("frame tables", f"{intervals} intervals, {flash} B, torque within {worst:.2g} %")]


def frame_table(found: FrameTables) -> Table:
    """Sizes with their largest errors, the emitted one first."""
    rows = tuple(
        (*_size(entry), *(f"{100.0 * value:.2g}" for value in _shares(entry)))
        for entry in _candidates(found)
    )
    return Table("Frame tables dqx and dqy: largest errors found", _COLUMNS, rows)


def frame_part(found: FrameTables, prefix: str) -> PlainData:
    """The part of the report."""
    rows = tuple(
        Row(
            (*_size(entry), *(share(ceiling(value), 3) for value in _shares(entry))),
            "chosen" if entry is found.chosen else "muted",
        )
        for entry in _candidates(found)
    )
    columns = tuple(name.removesuffix(" %") for name in _COLUMNS)
    return {
        "text": (
            f"{prefix}_frames.h holds factors, angles, their derivatives and the coupling of dqy "
            "over the angle, for those who implement the frames of paper 002 themselves."
        ),
        "table": HtmlTable("Tables by size, the emitted one first: largest errors", columns, rows),
    }


def plain_frames(found: FrameTables) -> PlainData:
    """Sizes and errors as fractions."""
    return {
        "phi_m_Wb": found.scale,
        "turns": found.turns,
        "tolerance": found.tolerance,
        "candidates": [
            {
                "intervals": entry.table.size * entry.table.parts,
                "constants_B": entry.table.flash,
                "errors": asdict(entry.errors),
            }
            for entry in _candidates(found)
        ],
    }
