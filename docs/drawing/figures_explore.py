"""Figures of the page on studies: the front of the shipped study of modules and modulators, and the
yield of a shipped header.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_checks import read_study
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.reports.answers.explore import view_of
from dqforge.reports.exploration.part_file import encode_part
from dqforge.reports.exploration.part_store import PartStore, study_header
from dqforge.reports.exploration.study_view import StudyView
from dqforge.reports.pages.figures_style import BLUE, ORANGE, PALE, TEAL, new_figure, save, style

_DRAWN = 20_000
_BINS = 60


def shipped(name: str) -> Study:
    """A study that ships with the package."""
    folder = resources.files("dqforge.machines") / "library" / "studies"
    with resources.as_file(folder / f"{name}.yaml") as path:
        return read_study(path)


@contextmanager
def viewed(study: Study) -> Iterator[StudyView]:
    """A study computed here, in this process, and what its rows say."""
    plan = StudyPlan(study)
    header = study_header(study, plan)
    with TemporaryDirectory() as folder, PartStore.open(Path(folder), header) as store:
        for part in range(header.parts):
            first = part * header.batch
            block = plan.rows(first, first + header.rows_of(part))
            store.write(part, encode_part(block, plan.columns, header.digest))
        yield view_of(store, study, store.survey().audited)


@style()
def front(path: Path) -> None:
    """Losses and ripple of every module, frequency and modulator; the front among the allowed."""
    with viewed(shipped("modules-and-modulators")) as view:
        rows = view.pictured
        losses, ripple = (rows.columns[goal.column] for goal in view.question.goals)
        found = view.summary.front
    assert found is not None
    figure = new_figure("study-front", 3.6, "Losses and ripple, and the front", arranged=True)
    axes = figure.subplots()
    for state, colour, words in (("limit", PALE, "beyond a limit"), ("ok", BLUE, "allowed")):
        own = rows.states == STATES.index(state)
        axes.plot(losses[own], ripple[own], ".", color=colour, markersize=3, label=words)
    steps = found.goals[np.argsort(found.goals[:, 0])]
    axes.plot(*steps.T, "o-", color=TEAL, markersize=4, linewidth=1, label="front")
    axes.set(xscale="log", xlabel="Losses in W, weighted mean of three points")
    axes.set(ylabel="Largest ripple current in A", ylim=(0.0, 6.0))
    axes.legend()
    save(figure, path)


@style()
def yields(path: Path) -> None:
    """Torque error and loss penalty of drawn machines under one header, with what is accepted."""
    study = shipped("production-yield")
    assert study.draw is not None
    with viewed(replace(study, draw=replace(study.draw, count=_DRAWN))) as view:
        spread = dict(zip(view.question.spread, view.summary.spread, strict=True))
        bounds = {each.column: each.below for each in view.question.accept}
    figure = new_figure("study-yield", 2.8, "Errors of drawn machines", arranged=True)
    for axes, (name, words) in zip(
        figure.subplots(1, 2),
        (("torque_error", "Largest torque error in %"), ("loss_penalty", "Loss penalty in %")),
        strict=True,
    ):
        column = f"out.reference.{name}"
        edges, counts = spread[column].coarser(_BINS)
        axes.stairs(counts / 1e-2 / np.sum(counts), 100.0 * edges, fill=True, color=BLUE)
        bound = bounds[column]
        assert bound is not None
        axes.axvline(100.0 * bound, color=ORANGE)
        axes.set(xlabel=words, ylabel="Machines in %", xlim=(0.0, 100.0 * edges[-1]))
    save(figure, path)
