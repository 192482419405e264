"""One record per capability: from its result to everything that is said and emitted of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

    from dqforge.machines.design.design import Design
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.c_code.harness import HeaderKind
    from dqforge.reports.pages.answer import Table
    from dqforge.reports.pages.html_text import HtmlTable
    from dqforge.reports.pages.templating import Chapter
    from dqforge.reports.plain_data import PlainData

R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run knows when it speaks: the solution, whether the headers were compiled and
    compared, and the simulation (`DriveSimulation`), None where there is none.
    """

    solution: Solution
    verified: bool = False
    simulation: Any = None

    @property
    def design(self) -> Design:
        """The design that was solved."""
        return self.solution.design


@dataclass(frozen=True, slots=True)
class ReportPart:
    """What a capability writes into a chapter: the template (``<room>/<file>``, or the path of a
    file) and what it prints.

    The template sees ``data``, the capability's ``figures`` by name, and imports the macros of
    ``pages/parts.html.j2``. It has no heading of the chapter, which the frame of the report writes
    once; headings of its own begin with ``<h3>``. ``key`` is the key number of the chapter, which
    stands beside its heading.
    """

    chapter: Chapter
    template: str
    data: PlainData | Passage
    key: str | Markup = ""


@dataclass(frozen=True, slots=True)
class Passage:
    """What most capabilities say in a chapter, in this order; what is empty is left out.

    Args:
        title: A heading of its own.
        text: Paragraphs.
        outcome, proven: A sentence that stands out, and whether it is a proof.
        drawings: Figures by name, with their captions.
        tables, kind: Tables, and how they are laid out.
        notes: A list.
        declaration: What is to be included.
        after: Paragraphs at the end.
    """

    title: str = ""
    text: Sequence[str | Markup] = ()
    outcome: str | Markup = ""
    proven: bool = False
    drawings: Sequence[tuple[str, str]] = ()
    tables: Sequence[HtmlTable] = ()
    kind: str = ""
    notes: Sequence[str] = ()
    declaration: str = ""
    after: Sequence[str | Markup] = ()

    def of(self, chapter: Chapter, key: str | Markup = "") -> ReportPart:
        """The passage as a part of a chapter."""
        return ReportPart(chapter, "pages/part.html.j2", self, key)


@dataclass(frozen=True, slots=True)
class Tile:
    """A key number of the summary: what it is, the number, and what stands behind it."""

    label: str | Markup
    value: str
    detail: str | Markup


@dataclass(frozen=True, slots=True)
class Flashed:
    """Numbers that go into the firmware, as plain text: what they are, the numbers with units, and
    what they mean for the drive.
    """

    label: str
    value: str
    meaning: str


Value = float | str | None


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity that ``compare`` sets side by side.

    Args:
        section, label, unit: Heading, name and unit of its row (`format_quantity`); numbers are in
            SI.
        path: Keys of ``result.json`` that lead to it.
        derived: What the row shows for what stands there, where that is not the entry itself.
    """

    section: str
    label: str
    unit: str
    path: tuple[str, ...]
    derived: Callable[[Any], Value] | None = None


Rows = list[tuple[str, str]]
Draw = Callable[[], "Figure"]


def _no_rows(_solution: Solution, _found: Any) -> Rows:
    return []


def _no_texts(_solution: Solution, _found: Any) -> list[str]:
    return []


def _nothing_flashed(_solution: Solution, _found: Any) -> list[Flashed]:
    return []


def _no_tables(_solution: Solution, _found: Any) -> list[Table]:
    return []


def _no_tiles(_solution: Solution, _found: Any) -> list[Tile]:
    return []


def _no_figures(_solution: Solution, _found: Any) -> dict[str, Draw]:
    return {}


def _no_parts(_solution: Solution, _found: Any) -> list[ReportPart]:
    return []


def _no_files(_solution: Solution, _found: Any) -> dict[str, bytes]:
    return {}


@dataclass(frozen=True, slots=True)
class Capability(Generic[R]):
    """One thing that a design can ask for.

    Args:
        name: Key of its result in ``result.json``.
        title: What it is, in a few words.
        of: Its result; None where the design does not ask for it.
        plain: What stands under ``name``; None for a capability that only adds headers.
        always: Whether ``name`` and the keys of its headers stand in ``result.json`` with null
            where the design does not ask for it; else they are left out.
        flashed: What stands first in terminal and report: the numbers to flash.
        watched: What to look out for, a sentence each; it stands behind them.
        summary: Rows of evidence for the summary of a run on the terminal: label and text.
        tables: Tables for the terminal.
        sentences, tiles: What the first paragraph of the report says of it, and its key numbers.
        figures: Figures of its parts of the report, by name; each is drawn when it is called.
        parts: Its parts of the report.
        headers: Kinds of headers that it emits.
        files: Files that a run writes beside headers, result and report.
        emitted: Files that a run and an export write beside the headers, and that verification
            computes again.
        quantities: What ``compare`` sets side by side.
    """

    name: str
    title: str
    of: Callable[[Outcome], R | None]
    plain: Callable[[Solution, R], Any] | None = None
    always: bool = True
    flashed: Callable[[Solution, R], list[Flashed]] = _nothing_flashed
    watched: Callable[[Solution, R], list[str]] = _no_texts
    summary: Callable[[Solution, R], Rows] = _no_rows
    tables: Callable[[Solution, R], list[Table]] = _no_tables
    sentences: Callable[[Solution, R], list[str]] = _no_texts
    tiles: Callable[[Solution, R], list[Tile]] = _no_tiles
    figures: Callable[[Solution, R], Mapping[str, Draw]] = _no_figures
    parts: Callable[[Solution, R], list[ReportPart]] = _no_parts
    headers: tuple[HeaderKind[R, Any], ...] = ()
    files: Callable[[Solution, R], dict[str, bytes]] = _no_files
    quantities: tuple[Quantity, ...] = ()
    emitted: Callable[[Solution, R], dict[str, bytes]] = _no_files


Capabilities = Sequence[Capability[Any]]


def asked_for(capabilities: Capabilities, outcome: Outcome) -> list[tuple[Capability[Any], Any]]:
    """The capabilities that a design asks for, each with its result."""
    found = [(capability, capability.of(outcome)) for capability in capabilities]
    return [(capability, result) for capability, result in found if result is not None]


def header_kinds(capabilities: Capabilities) -> list[HeaderKind[Any, Any]]:
    """All kinds of headers beside the main one, in the order in which they are written."""
    return [kind for capability in capabilities for kind in capability.headers]
