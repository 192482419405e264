"""The papers by number: tables, plain data and figures of what can be computed of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import TYPE_CHECKING, Any

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.reports.pages.answer import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    from dqforge.reports.papers.paper000 import figures as plain
    from dqforge.reports.papers.paper000 import whole_paper as tables
    from dqforge.reports.papers.paper000.whole_paper import reproduce_whole

    found = reproduce_whole()
    drawn: dict[str, Callable[[], Figure]] = {}
    if figures:
        from dqforge.reports.papers.paper000.figures import figures_of

        drawn = figures_of(found)
    return Reproduced(
        tables.whole_tables(found), plain.plain_whole(found), drawn, found.header.files
    )


def _paper001(*, figures: bool) -> Reproduced:
    from dqforge.reports.papers.paper001 import tables
    from dqforge.reports.papers.paper001.bench_transients import reproduce_paper

    found = reproduce_paper()
    drawn: dict[str, Callable[[], Figure]] = {}
    if figures:
        from dqforge.reports.papers.paper001.emitted_control import (
            plot_at_1200,
            plot_climbs,
            plot_reversal,
        )
        from dqforge.reports.papers.paper001.tables import plot_bench, plot_without_encoder

        runs = found.program.runs
        drawn["figures-8.3-to-8.13.svg"] = lambda: plot_at_1200(runs)
        drawn["figures-8.14-to-8.20.svg"] = lambda: plot_climbs(runs)
        drawn["figures-8.21-to-8.28.svg"] = lambda: plot_reversal(runs)
        drawn["figures-8.29-to-8.33.svg"] = lambda: plot_without_encoder(found.runs)
        drawn["figures-8.3-to-8.31.svg"] = lambda: plot_bench(found.runs)
    return Reproduced(tables.reproduction_tables(found), tables.plain_reproduction(found), drawn)


def _paper002(*, figures: bool) -> Reproduced:
    from dqforge.reports.papers.paper002 import tables

    found = tables.reproduce_paper()
    drawn: dict[str, Callable[[], Figure]] = {}
    if figures:
        from dqforge.reports.papers.paper002.tables import figures_of

        drawn = figures_of(found)
    return Reproduced(tables.reproduction_tables(found), tables.plain_reproduction(found), drawn)


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
