"""Random drives that start, and how many of two hundred do."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import StartUpMethodName
from dqforge.reports.estimator_comparison.random_starts import (
    RandomBench,
    random_bench,
    recorded_starts,
)
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    TEAL,
    new_figure,
    save,
    style,
)

_COUNT = 24


_METHODS: tuple[tuple[StartUpMethodName, str, str], ...] = (
    ("i-f", "current that turns", BLUE),
    ("v-f", "voltage that turns", ORANGE),
    ("direct", "into the observer", TEAL),
)


def _speeds(
    bench: RandomBench, method: StartUpMethodName, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Speed over its reference and error of the observed angle in deg, shape (drives, times)."""
    speeds, errors = [], []
    for rows in recorded_starts(bench, method, 0.3):
        gap = rows["theta_e_observed"] - rows["theta_e"]
        wrapped = (gap + np.pi) % (2.0 * np.pi) - np.pi
        error = np.where(rows["state"] == 7.0, np.degrees(wrapped), np.nan)
        speeds.append(np.interp(time, rows["t"], rows["omega_m"] / rows["reference"]))
        place = np.minimum(np.searchsorted(rows["t"], time), rows["t"].size - 1)
        errors.append(error[place])
    return np.stack(speeds), np.stack(errors)


@style()
def random_starts(path: Path) -> None:
    """Speed over its reference of random drives by three methods, and the observer's error."""
    time = np.linspace(0.0, 2.2, 221)
    figure = new_figure(
        "start-up-bench", 3.7, "Speeds and angle errors of random drives by method", arranged=True
    )
    axes = figure.subplots(2, 3, sharex=True, sharey="row")
    with random_bench(_COUNT) as bench:
        for column, (method, words, colour) in enumerate(_METHODS):
            speeds, errors = _speeds(bench, method, time)
            top, bottom = axes[0, column], axes[1, column]
            top.plot(time, speeds.T, color=colour, linewidth=0.6, alpha=0.7)
            top.axhline(1.0, color=INK, linewidth=0.8, linestyle=(0, (3.0, 2.0)))
            bottom.plot(time, errors.T, color=colour, linewidth=0.6, alpha=0.7)
            bottom.axhspan(-30.0, 30.0, color=FAINT, alpha=0.5, linewidth=0.0)
            top.set_title(f"{method}: {words}", fontsize=7.5)
            top.set_ylim(-0.3, 1.6)
            bottom.set_ylim(-60.0, 60.0)
            bottom.set_xlabel("Time in s")
    axes[0, 0].set_ylabel("Speed over reference")
    axes[1, 0].set_ylabel("Angle error in deg")
    save(figure, path)


if __name__ == "__main__":
    random_starts(Path(__file__).resolve().parents[1] / "figures" / "start-up-bench.svg")
