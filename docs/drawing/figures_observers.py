"""Figures of the page on position observers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.names import LEARNED_OBSERVERS
from dqforge.optimizer.observers.conditions import conditions
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.tuning import tune_position_observer
from dqforge.reports.pages.figures_style import MUTED, new_figure, save, style


@style()
def position_errors(path: Path) -> None:
    """Angle error by parameters, dead time and noise at the worst load.

    Machine of paper 001, two tunings.
    """
    design = catalogue.load("paper001-pmsm-bench")
    machine, t_s = linearised(design.machine), design.control.t_s
    omega_max = design.control.bases.speed * machine.pole_pairs
    figure = new_figure("position-observers", 3.3, "Errors of position observers", arranged=True)
    axes = figure.subplots(1, 2, sharey=True)
    for ax, tuning in zip(axes, ("named", "optimised"), strict=True):
        for name in METHODS:
            if name in LEARNED_OBSERVERS:  # docs/methods/learned-correction.md has their figure
                continue
            wanted = ObserverSettings(method=name, tuning=tuning)  # type: ignore[arg-type]
            known = conditions(design, omega_max)
            judged = tune_position_observer(
                machine, wanted, t_s, design.inverter.v_dc, omega_max, known
            ).judgement
            shown = (judged.omega <= omega_max) & np.isfinite(judged.steady)
            error = np.where(shown, np.degrees(judged.steady), np.nan)  # a gap where it is lost
            ax.loglog(judged.omega / (2.0 * np.pi), error, label=name)
        ax.axhline(10.0, color=MUTED, linewidth=0.8)
        ax.set(title=tuning.capitalize(), xlabel="Electrical frequency in Hz", ylim=(0.3, 200.0))
    axes[0].set_ylabel("Angle error in deg r.m.s.")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=6)
    save(figure, path)
