"""Figures of the pages on studies: what varies and is drawn, what rows share, the parts of a
folder, and what a large study waits for. Small studies are cut from those that ship.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby, product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from figures_explore import shipped, viewed

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Axis, Sampling, Study
from dqforge.optimizer.exploration.block_rows import ExactSteps
from dqforge.optimizer.exploration.row_block import STATES, row_inputs
from dqforge.optimizer.exploration.row_outputs import loss_drive
from dqforge.optimizer.exploration.variation import key_of
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    MUTED,
    ORANGE,
    PALE,
    PAPER,
    SERIES,
    SKY,
    TEAL,
    new_figure,
    save,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DRAWN, _SHORTER = 96, 24

_ROWS, _RATE = 1e8, 7e3
"""Rows of the plan of docs/studies/cluster.md, and rows per second and core."""

_BATCH_MS = (11.0, 27.0)
"""Least and most time per batch in ms, from its table."""

_BATCH_TIMES = {
    "own process": (12.0, 24.0),
    "2 processes": (11.0, 70.0),
    "workers apart": (27.0, 54.0),
}
"""Time per batch in ms, alone and on a machine with eight times the work, from its table."""


def _cut(study: Study, places: Sequence[Sequence[int]]) -> Study:
    """A grid study with some of the steps of its axes."""
    axes = []
    for axis, chosen in zip(study.axes, places, strict=True):
        steps = tuple(axis.steps[place] for place in chosen)
        numbers = tuple(axis.numbers[place] for place in chosen) if axis.numbers else ()
        axes.append(Axis(axis.keys, steps, numbers, axis.spacing))
    return replace(study, axes=tuple(axes))


def _drawn(sampling: Sampling) -> tuple[FloatArray, FloatArray]:
    """Link voltage in V and q inductance in mH of the first machines of the shipped study."""
    study = shipped("production-yield")
    assert study.draw is not None
    draw = replace(study.draw, count=_DRAWN, sampling=sampling)
    found = row_inputs(replace(study, draw=draw, sensitivity=()), 0, _DRAWN)
    voltage, inductance = found["inverter.v_dc"], found["machine.inductance_q"]
    return np.asarray(voltage, dtype=float), 1e3 * np.asarray(inductance, dtype=float)


@style()
def sampling(path: Path) -> None:
    """A grid of modules and carriers, and drawn machines by both samplings."""
    figure = new_figure(
        "study-sampling", 2.7, "A grid, random draws and points of a Sobol sequence", arranged=True
    )
    grid, *panels = figure.subplots(1, 3)
    device, carrier, _ = shipped("modules-and-modulators").axes
    kilohertz = 1e-3 * np.array(carrier.numbers)[:, 0]
    for place in range(len(device.steps)):
        grid.plot(kilohertz, np.full(kilohertz.size, place + 1), ".", color=TEAL, markersize=3.5)
    grid.set(xscale="log", xlabel="Carrier in kHz", ylabel="Module", title="vary: a grid")
    grid.set_xticks([10, 20, 50, 100], ["10", "20", "50", "100"])
    grid.minorticks_off()
    for axes, kind in zip(panels, ("random", "sobol"), strict=True):
        voltage, inductance = _drawn("random" if kind == "random" else "sobol")
        later = slice(_SHORTER, None)
        axes.plot(voltage[later], inductance[later], ".", color=SKY, markersize=3.5)
        axes.plot(voltage[:_SHORTER], inductance[:_SHORTER], ".", color=ORANGE, markersize=5)
        axes.set(xlabel="DC link in V", title=f"sampling: {kind}", ylim=(0.5, 0.7))
        axes.set_yticks([0.5, 0.55, 0.6, 0.65, 0.7], ["0.50", "0.55", "0.60", "0.65", "0.70"])
    panels[0].set_ylabel("$L_q$ in mH")
    save(figure, path)


def _designs(study: Study) -> Iterator[Design]:
    """The designs of a grid study in the order of their rows."""
    for row in product(*(axis.steps for axis in study.axes)):
        assigned = [
            pair
            for axis, values in zip(study.axes, row, strict=True)
            for pair in zip(axis.keys, values, strict=True)
        ]
        yield design_of(study, dict(assigned))


def _loss_key(design: Design) -> Hashable:
    """What a budget depends on that is made for all carriers and modulators of a study."""
    losses = design.losses
    assert losses is not None
    return key_of((loss_drive(design, f_sw=1.0), losses.points, losses.strategies))


def _runs(keys: Sequence[Hashable]) -> Iterator[tuple[int, int, int]]:
    """First row, number of rows and number of the result of each run of equal keys."""
    order = list(dict.fromkeys(keys))
    first = 0
    for key, run in groupby(keys):
        count = len(list(run))
        yield first, count, order.index(key)
        first += count


def _strip(axes: Axes, place: int, keys: Sequence[Hashable], *, given: bool) -> None:
    """A line of blocks, one for each run of rows with the same value or result."""
    for first, count, number in _runs(keys):
        colour = (FAINT, PALE, SKY, MUTED)[number] if given else SERIES[number]
        axes.broken_barh(
            [(first, count)], (place - 0.36, 0.72), facecolor=colour, edgecolor=PAPER, linewidth=0.8
        )


@style()
def shared_steps(path: Path) -> None:
    """What goes into 24 rows, and which rows share the result of each step."""
    study = _cut(shipped("modules-and-modulators"), (range(3), (0, 6, 13, 19), (3, 10)))
    designs, steps = list(_designs(study)), ExactSteps()
    places = list(product(*(range(len(axis.steps)) for axis in study.axes)))
    lines: list[tuple[str, list[Hashable]]] = [
        (name, [row[place] for row in places])
        for place, name in enumerate(("module", "carrier", "modulator"))
    ]
    for name, key in (
        ("largest torque", lambda design: steps.key("limit", design)),
        ("fit", lambda design: steps.key("fit", design)),
        ("loops", lambda design: steps.key("speed-loop", design)),
        ("losses", _loss_key),
    ):
        lines.append((name, [key(design) for design in designs]))
    figure = new_figure(
        "study-shared-steps", 2.6, "Values of 24 rows, and the steps that they share",
        arranged=True,
    )  # fmt: skip
    axes = figure.add_subplot()
    for place, (name, keys) in enumerate(lines):
        _strip(axes, place, keys, given=place < 3)
        count = len(set(keys))
        words = f"{count} values" if place < 3 else f"computed {count} time{'s' * (count > 1)}"
        axes.text(24.3, place, words, va="center", label=f"_{name}")
    axes.axhline(2.5, color=INK, linewidth=0.8)
    axes.set_yticks(range(len(lines)), [name for name, _ in lines])
    axes.set(xlabel="Row", xlim=(0.0, 29.5), ylim=(len(lines) - 0.5, -0.5))
    axes.set_xticks(range(0, 25, 4))
    axes.grid(visible=False)
    save(figure, path)


@style()
def parts(path: Path) -> None:
    """Rows of a small study in its parts, how they ended, and which are on the front."""
    whole = shipped("modules-and-modulators")
    study = _cut(whole, (range(6), (0, 6, 13, 19), (0, 3, 5, 10, 11)))
    with viewed(study) as view:
        states, batch = view.pictured.states, view.batch
        front = view.summary.front
    assert front is not None
    figure = new_figure("study-parts", 2.7, "The rows of a study in its parts", arranged=True)
    axes = figure.add_subplot()
    colours = {"ok": BLUE, "limit": PALE, "no-solution": ORANGE}
    told: set[str] = set()
    for part in range(-(-states.size // batch)):
        own = [STATES[state] for state in states[part * batch : (part + 1) * batch]]
        first = 0
        for state, run in groupby(own):
            count = len(list(run))
            label = f"_{state}" if state in told else state
            told.add(state)
            cells = [(first + place, 1) for place in range(count)]
            axes.broken_barh(
                cells, (part - 0.4, 0.8), facecolor=colours[state], edgecolor=PAPER,
                linewidth=0.6, label=label,
            )  # fmt: skip
            first += count
        axes.text(
            batch + 0.4, part, f"{part * batch} to {part * batch + len(own) - 1}", va="center"
        )
    winners = np.asarray(front.index)
    axes.plot(
        winners % batch + 0.5, winners // batch, "o", color=PAPER, markeredgecolor=INK,
        markersize=4.5, label="on the front",
    )  # fmt: skip
    axes.set_yticks(
        range(-(-states.size // batch)),
        [f"part-{part:06d}.parquet" for part in range(-(-states.size // batch))],
    )
    axes.invert_yaxis()
    axes.set(xlabel="Row within the part", xlim=(0.0, batch + 4.0))
    axes.set_xticks(range(0, batch + 1, 5))
    axes.grid(visible=False)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    save(figure, path)


@style()
def cluster(path: Path) -> None:
    """Time of 1e8 rows over the cores, beside that of writing them; time per batch."""
    figure = new_figure(
        "study-cluster", 2.9, "Time of a large study over its cores, and time per batch",
        arranged=True,
    )  # fmt: skip
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    cores = np.geomspace(1.0, 128.0, 60)
    left.loglog(cores, _ROWS / _RATE / 60.0 / cores, color=BLUE, label="computing")
    for rows, colour in ((1_000, ORANGE), (10_000, TEAL)):
        low, high = (_ROWS / rows * 1e-3 * time / 60.0 for time in _BATCH_MS)
        left.fill_between(
            cores, low, high, color=colour, alpha=0.35, linewidth=0.0,
            label=f"writing parts of {rows:,}",
        )  # fmt: skip
    left.set(xlabel="Cores", ylabel="Time of 1e8 rows in min", xlim=(1.0, 128.0))
    left.set_xticks([1, 2, 4, 8, 16, 32, 64, 128], ["1", "2", "4", "8", "16", "32", "64", "128"])
    left.set_yticks([1, 3, 10, 30, 100, 300], ["1", "3", "10", "30", "100", "300"])
    left.minorticks_off()
    left.legend(loc="upper right")
    places = np.arange(len(_BATCH_TIMES))
    for shift, words, colour, column in ((-0.2, "alone", BLUE, 0), (0.2, "busy", PALE, 1)):
        times = [found[column] for found in _BATCH_TIMES.values()]
        right.barh(places + shift, times, height=0.38, color=colour, label=words)
    right.set_yticks(places, list(_BATCH_TIMES))
    right.invert_yaxis()
    right.set_xlabel("Time per batch in ms")
    right.legend(loc="upper right")
    save(figure, path)
