"""Figures of the page on operating points within the voltage limit."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dqforge.machines import catalogue
from dqforge.optimizer.characteristics import characteristics, envelope, operating_map, voltage_limit
from dqforge.optimizer.operating_points import optimal_points
from dqforge.reports.figures import save
from dqforge.reports.figures_characteristics import plot_operating_map


def operating_points_map(path: Path) -> None:
    """Torque-speed map of paper 000's drive."""
    design = catalogue.load("paper000-ipmsm-100kw")
    limit = voltage_limit(design.inverter, "svpwm")
    figures = characteristics(design.machine, limit.v_max, design.i_max)
    fastest = design.machine.omega_m_max or 3.0 * figures.base_speed
    torque, speed = np.linspace(0.0, figures.torque_max, 80), np.linspace(0.0, fastest, 100)
    chart = operating_map(design.machine, design.inverter, limit, torque, speed, design.i_max)
    edge = envelope(design.machine, limit.v_max, np.linspace(0.0, fastest, 241), design.i_max)
    save(plot_operating_map(figures, edge, chart), path)


def time_over_points(path: Path) -> None:
    """Time of the batched solver over the number of points; the times are those of the machine that draws it."""
    design = catalogue.load("paper000-ipmsm-100kw")
    counts, seconds = [1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000], []
    for count in counts:
        generator = np.random.default_rng(0)
        torque = generator.uniform(-200.0, 200.0, count)
        speed = generator.choice(np.linspace(-900.0, 900.0, 201), count)
        start = time.perf_counter()
        optimal_points(design.machine, torque, speed, v_max=288.7)
        seconds.append(time.perf_counter() - start)
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.loglog(counts, seconds, "o-", label="measured")
    axes.loglog(counts, seconds[-1] * np.array(counts) / counts[-1], "--", color="0.6", label="proportional")
    axes.set(xlabel="Operating points", ylabel="Time in s")
    axes.legend(frameon=False)
    save(figure, path)
