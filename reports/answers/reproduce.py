"""What `dqforge reproduce` answers: a paper recomputed beside its printed values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import TYPE_CHECKING, Any

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.reports.output.folder import FIGURES
from dqforge.reports.pages.answer import Answer, Files, Table, stage
from dqforge.reports.pages.figures_style import to_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def answer_reproduce(paper: str, *, figures: bool) -> Answer:
    """Recompute a paper by its number, with its figures where they are wanted; as `reproduce`."""
    stage("recomputing")
    found, files = reproduce(paper, figures=figures), None
    if figures:
        stage("drawing")
        drawn = {name: to_svg(draw()).encode("utf-8") for name, draw in found.figures.items()}
        files = Files(drawn | found.sources, FIGURES, named=False)
    return Answer(f"paper {paper}", found.tables, found.plain, files=files)


# The papers by number: tables, plain data and figures of what can be computed of each.

PAPERS = ("000", "001", "002")


@dataclass(frozen=True, slots=True)
class Reproduced:
    """Tables for people, plain data for programs, figures by file name, drawn when called, and C
    files that lie beside them.
    """

    tables: list[Table]
    plain: dict[str, Any]
    figures: dict[str, Callable[[], Figure]] = field(default_factory=dict)
    sources: dict[str, bytes] = field(default_factory=dict)


def _paper000(*, figures: bool) -> Reproduced:
    from dqforge.reports.papers import paper000_figures as plain
    from dqforge.reports.papers import paper000_whole_paper as tables
    from dqforge.reports.papers.paper000_whole_paper import reproduce_whole

    found = reproduce_whole()
    drawn: dict[str, Callable[[], Figure]] = {}
    if figures:
        from dqforge.reports.papers.paper000_figures import figures_of

        drawn = figures_of(found)
    return Reproduced(
        tables.whole_tables(found), plain.plain_whole(found), drawn, found.header.files
    )


def _paper001(*, figures: bool) -> Reproduced:
    from dqforge.reports.papers import paper001_tables
    from dqforge.reports.papers.paper001_bench_transients import reproduce_paper

    found = reproduce_paper()
    drawn: dict[str, Callable[[], Figure]] = {}
    if figures:
        from dqforge.reports.papers.paper001_emitted_control import (
            plot_at_1200,
            plot_climbs,
            plot_reversal,
        )
        from dqforge.reports.papers.paper001_tables import plot_bench, plot_without_encoder

        runs = found.program.runs
        drawn["figures-8.3-to-8.13.svg"] = lambda: plot_at_1200(runs)
        drawn["figures-8.14-to-8.20.svg"] = lambda: plot_climbs(runs)
        drawn["figures-8.21-to-8.28.svg"] = lambda: plot_reversal(runs)
        drawn["figures-8.29-to-8.33.svg"] = lambda: plot_without_encoder(found.runs)
        drawn["figures-8.3-to-8.31.svg"] = lambda: plot_bench(found.runs)
    return Reproduced(
        paper001_tables.reproduction_tables(found), paper001_tables.plain_reproduction(found), drawn
    )


def _paper002(*, figures: bool) -> Reproduced:
    from dqforge.reports.papers import paper002_tables

    found = paper002_tables.reproduce_paper()
    drawn: dict[str, Callable[[], Figure]] = {}
    if figures:
        from dqforge.reports.papers.paper002_tables import figures_of

        drawn = figures_of(found)
    return Reproduced(
        paper002_tables.reproduction_tables(found), paper002_tables.plain_reproduction(found), drawn
    )


def reproduce(paper: str, *, figures: bool) -> Reproduced:
    """Recompute a paper by its number; with ``figures`` also what is only drawn,
    and simulated for that.

    Raises:
        InputError: There is no such paper.
        VerificationError: A simulation needs a compiler that is not there.
    """
    made = dict(zip(PAPERS, (_paper000, _paper001, _paper002), strict=True))
    if paper not in made:
        raise InputError(
            f"paper {paper!r} cannot be reproduced; write: dqforge reproduce 000, 001 or 002"
        )
    return made[paper](figures=figures)
