"""Figures of the page on simulation: the bench drive in the loop, and what a dead
time costs at little current.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.scenario import InverterModel, Scenario, constant
from dqforge.reports.pages.figures_style import MUTED, new_figure, save, style
from dqforge.reports.simulation.design_run import simulate_design
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import simulate, simulator
from dqforge.reports.simulation.tables import plot_simulation

_RL = LinearMachine(pole_pairs=1, r_s=1.0, l_d=1e-3, l_q=1e-3, psi_pm=0.0, i_max=60.0)
_T_S, _DEAD_TIME = 1e-4, 2e-6


def bench(path: Path) -> None:
    """Start and reversal of paper 001's drive under its emitted controller."""
    save(plot_simulation(simulate_design(catalogue.load("paper001-pmsm-bench"))), path)


@style()
def dead_time(path: Path) -> None:
    """Voltage that a dead time takes from phase a, averaged and switch by switch,
    while 60 A flow from b to c.
    """
    drive = Drive(_RL, Inverter(300.0, 1.0 / _T_S), _T_S)
    steps = np.linspace(-0.015, 0.05, 66)
    figure = new_figure("dead-time", 2.9, "Voltage that a dead time takes", arranged=True)
    axes = figure.add_subplot()
    ways: tuple[tuple[InverterModel, str], ...] = (("switched", "o"), ("averaged", ""))
    with simulator() as plant:
        for inverter, marker in ways:
            current = []
            for step in steps:
                duties = constant(0.5 + float(step)), constant(0.7 - float(step) / 2.0)
                scenario = Scenario(
                    0.15,
                    "open-loop",
                    *duties,
                    shaft=constant(0.0),
                    inverter=inverter,
                    dead_time=_DEAD_TIME,
                )
                current.append(float(np.mean(simulate(plant, drive, scenario).i_d[-200:])))
            lost = 300.0 * steps - np.array(current)
            look = {"marker": marker, "linestyle": "", "markersize": 3.0} if marker else {}
            axes.plot(current, lost, label=inverter, **look)
    full = 2.0 / 3.0 * _DEAD_TIME / _T_S * 300.0
    for level in (-full, 0.0, full):
        axes.axhline(level, color=MUTED, linewidth=0.8)
    axes.set(
        xlabel="Current in phase a in A", ylabel="Voltage lost in V", ylim=(-1.2 * full, 1.2 * full)
    )
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.12))
    save(figure, path)
