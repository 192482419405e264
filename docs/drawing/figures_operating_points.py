"""Figures of the page on operating points within the voltage limit."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from matplotlib.ticker import FuncFormatter

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.operating_points.characteristics import (
    characteristics,
    envelope,
    envelope_speeds,
    operating_map,
    voltage_limit,
)
from dqforge.optimizer.operating_points.points import optimal_points
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.reports.current_reference.figures import plot_fit, plot_mtpa
from dqforge.reports.operating_points.figures import plot_operating_map
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, PALE, new_figure, save, style

_DRIVE = "paper000-ipmsm-100kw"


def mtpa(path: Path) -> None:
    """Currents of least copper loss over the torque."""
    design = catalogue.load(_DRIVE)
    save(plot_mtpa(design, solve_curves(design)), path)


def fit(path: Path) -> None:
    """The polynomials beside those currents, and their errors."""
    design = catalogue.load(_DRIVE)
    save(plot_fit(design, solve_fit(design).fit), path)


def operating_points_map(path: Path) -> None:
    """Torque-speed map of paper 000's drive."""
    design = catalogue.load(_DRIVE)
    machine, i_max = design.machine, design.i_max
    limit = voltage_limit(design.inverter, "svpwm")
    figures = characteristics(machine, limit.v_max, i_max)
    fastest = machine.omega_m_max or 3.0 * figures.base_speed
    torque, speed = np.linspace(0.0, figures.torque_max, 80), np.linspace(0.0, fastest, 100)
    chart = operating_map(machine, design.inverter, limit, torque, speed, i_max)
    edge = envelope(
        machine, limit.v_max, envelope_speeds(machine, limit.v_max, fastest, i_max), i_max
    )
    save(plot_operating_map(figures, edge, chart), path)


def _measured(counts: list[int], speeds: int | None) -> FloatArray:
    """Least seconds of some runs for random points, at ``speeds`` different speeds
    or each at its own (None).
    """
    design = catalogue.load(_DRIVE)
    seconds = []
    for count in counts:
        generator = np.random.default_rng(0)
        torque = generator.uniform(-200.0, 200.0, count)
        some = generator.uniform(-900.0, 900.0, speeds or count)
        omega = generator.choice(some, count) if speeds else some
        runs = []
        for _ in range(5 if count < 300_000 else 1):
            start = time.perf_counter()
            optimal_points(design.machine, torque, omega, v_max=288.7)
            runs.append(time.perf_counter() - start)
        seconds.append(min(runs))
    return np.array(seconds)


def time_over_points(path: Path) -> None:
    """Time of the batched solver over the number of points.

    The times are those of the machine that draws it.
    """
    counts = [1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000]
    with style():
        figure = new_figure(
            "time", 3.2, "Time of the solver over the number of operating points, both logarithmic"
        )
        axes = figure.add_axes((0.09, 0.14, 0.7, 0.77))
        for speeds, colour, text in (
            (None, ORANGE, "a speed for each point"),
            (201, BLUE, "201 speeds"),
        ):
            seconds = _measured(counts, speeds)
            axes.plot(
                counts,
                seconds[-1] * np.array(counts) / counts[-1],
                color=PALE,
                linewidth=1.0,
                linestyle="dashed",
            )
            axes.plot(counts, seconds, "o-", color=colour, markersize=3.5)
            rate = float(f"{counts[-1] / seconds[-1]:.2g}")
            axes.annotate(
                f"{text}:\n{rate:,.0f} points/s",
                (counts[-1], float(seconds[-1])),
                xytext=(8, 0),
                textcoords="offset points",
                color=colour,
                va="center",
            )
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="Operating points",
            ylabel="Time in s",
            title="Linear machine, one core",
        )
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.minorticks_off()
        axes.text(
            0.98,
            0.05,
            "dashed: proportional",
            transform=axes.transAxes,
            ha="right",
            color=MUTED,
            fontsize=7.5,
        )
    save(figure, path)
