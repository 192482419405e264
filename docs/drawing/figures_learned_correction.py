"""Figure of the page on the learned correction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.names import LEARNED_OBSERVERS
from dqforge.optimizer.observers.reduced_order import Training
from dqforge.optimizer.observers.solve import solve_observer
from dqforge.reports.pages.figures_style import SERIES, new_figure, save, style


def _training(method: str) -> Training:
    design = load_text(catalogue.template(), "template.yaml")
    observer = ObserverSettings(method=method)  # type: ignore[arg-type]
    _, found = solve_observer(replace(design, control=replace(design.control, observer=observer)))
    assert found is not None
    assert found.training is not None
    return found.training


@style()
def gain_over_speed(path: Path) -> None:
    """Angle errors of the template's drive over its tolerance box, with and without a correction:
    r.m.s., and the largest.
    """
    figure = new_figure(
        "learned-correction", 3.0, "Angle errors with and without a correction", arranged=True
    )
    axes = figure.subplots(1, 2, sharex=True)
    trained = {name: _training(name) for name in LEARNED_OBSERVERS}
    first = next(iter(trained.values()))
    lines = {name: (first, name) for name in ("flux observer alone", "linear regression")}
    lines |= {name: (training, "corrected") for name, training in trained.items()}
    for ax, which in zip(axes, ("rms", "largest"), strict=True):
        for colour, (label, (training, name)) in zip(SERIES, lines.items(), strict=False):
            edges = np.append(training.edges[:, 0], training.edges[-1, 1]) / (2.0 * np.pi)
            values = np.degrees(getattr(training, which)[name])
            ax.stairs(values, edges, baseline=None, label=label, edgecolor=colour, linewidth=1.2)
        ax.set(
            xscale="log",
            yscale="log",
            xlabel="Electrical frequency in Hz",
            title="r.m.s." if which == "rms" else "Largest",
        )
    axes[0].set_ylabel("Angle error in deg")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    save(figure, path)
