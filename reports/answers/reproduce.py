"""What `dqforge reproduce` answers: a paper recomputed beside its printed values."""

from __future__ import annotations

from dqforge.reports.output.folder import FIGURES
from dqforge.reports.pages.answer import Answer, Files, stage
from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.papers.reproduction import reproduce


def answer_reproduce(paper: str, *, figures: bool) -> Answer:
    """Recompute a paper by its number, with its figures where they are wanted; as `reproduce`."""
    stage("recomputing")
    found, files = reproduce(paper, figures=figures), None
    if figures:
        stage("drawing")
        drawn = {name: to_svg(draw()).encode("utf-8") for name, draw in found.figures.items()}
        files = Files(drawn | found.sources, FIGURES, named=False)
    return Answer(f"paper {paper}", found.tables, found.plain, files=files)
