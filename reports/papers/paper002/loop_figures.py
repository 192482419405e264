"""Figures 6.9 to 6.18 of paper 002 with the emitted C in the loop, circuits side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.paper002.bench_currents import BenchCurves
from dqforge.reports.papers.paper002.closed_loops import RPM, LoopRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_BESIDE = ("diodes_pi", "legs_pi", "legs_table")


_STEPS = ("diodes_pi", "legs_pi", "legs_table", "star_table")


_SHORT = {
    "diodes_pi": "Diodes, dqy with PI (the bench)",
    "legs_pi": "Four legs, dqy with PI",
    "legs_table": "Four legs, table",
    "star_table": "Star, dqx table",
}


def _definition(axes: Axes, degrees: FloatArray, values: FloatArray) -> None:
    axes.plot(
        degrees, values, color=MUTED, linewidth=0.8, linestyle=(0, (4.0, 2.0)), label="definition"
    )


def _rows(column: tuple[Axes, ...], run: LoopRun, curves: BenchCurves) -> None:
    q, plane, zero, phase = column
    found, degrees, wanted = run.curves, np.degrees(run.curves.theta), np.degrees(curves.theta)
    q.plot(degrees, found.dqy[1], color=BLUE, label="i_qy (6.9)")
    q.plot(degrees, found.dqx[1], color=ORANGE, linewidth=0.9, label="i_qx (6.10)")
    q.set_title(_SHORT[run.case.name], fontsize=7.5)
    q.set(ylim=(1.7, 2.5))
    plane.plot(degrees, found.stationary[0], color=BLUE, label="i_\u03b1 (6.11)")
    plane.plot(degrees, found.stationary[1], color=ORANGE, label="i_\u03b2 (6.12)")
    plane.set(ylim=(-2.2, 3.4))
    zero.plot(degrees, found.stationary[2], color=TEAL, label="i_0 (6.13)")
    _definition(zero, wanted, curves.stationary[2])
    zero.set(ylim=(-0.36, 0.55))
    phase.plot(degrees, found.phase_a, color=BLUE, label="i_a (6.16)")
    _definition(phase, wanted, curves.currents[1])
    phase.set(ylim=(-1.7, 2.5), xlabel="Electrical angle in deg")
    for axes in column:
        axes.set(xlim=(0.0, 360.0), xticks=np.arange(0, 361, 120))
        axes.legend(frameon=False, loc="upper right", ncols=2, fontsize=6.0, handlelength=1.2)


def _paths(plane: Axes, space: Axes, run: LoopRun) -> None:
    alpha, beta, zero = run.curves.stationary
    plane.plot(alpha, beta, color=BLUE, linewidth=0.9)
    plane.set(xlim=(-2.2, 2.2), ylim=(-2.2, 2.2), aspect="equal", xlabel="i_\u03b1 in A")
    space.plot(beta, zero, color=TEAL, linewidth=0.9)
    space.set(xlim=(-2.2, 2.2), ylim=(-0.36, 0.36), xlabel="i_\u03b2 in A")


def plot_loops(runs: tuple[LoopRun, ...], curves: BenchCurves) -> Figure:
    """Currents at 750 rpm and 1 N m: the circuit of the thesis beside four legs."""
    by_name = {run.case.name: run for run in runs}
    with style():
        figure = new_figure(
            "paper-002-loops", 10.2, "Currents in the loop: diodes beside four legs, 750 rpm, 1 N m"
        )
        for place, name in enumerate(_BESIDE):
            across, run = 0.085 + 0.313 * place, by_name[name]
            column = tuple(
                figure.add_axes((across, 0.855 - 0.148 * row, 0.255, 0.112)) for row in range(4)
            )
            _rows(column, run, curves)
            plane = figure.add_axes((across + 0.03, 0.2, 0.205, 0.141))
            space = figure.add_axes((across, 0.045, 0.255, 0.09))
            _paths(plane, space, run)
            plane.set_title("Figure 6.14", fontsize=7.0)
            space.set_title("Figure 6.15, seen along \u03b1", fontsize=7.0)
            if place == 0:
                for axes in (*column, space):
                    axes.set_ylabel("A")
                plane.set_ylabel("i_\u03b2 in A")
                space.set_ylabel("i_0 in A")
    return figure


def plot_step(runs: tuple[LoopRun, ...]) -> Figure:
    """Torque and speed at a load step: Figures 6.17 and 6.18."""
    by_name = {run.case.name: run for run in runs}
    with style():
        figure = new_figure(
            "paper-002-step", 4.6, "Torque and speed at a load step of 1 N m, 750 rpm"
        )
        for place, name in enumerate(_STEPS):
            run, row, column = by_name[name], place // 2, place % 2
            axes = figure.add_axes((0.08 + 0.305 * column, 0.58 - 0.48 * row, 0.235, 0.33))
            axes.plot(1e3 * run.curves.time, run.curves.torque, color=BLUE, linewidth=0.7)
            axes.set(xlim=(-10.0, 300.0), ylim=(-0.1, 1.6), xlabel="Time in ms")
            axes.set_title(_SHORT[name], fontsize=7.0)
            if column == 0:
                axes.set_ylabel("6.17: torque in N m")
        speed = figure.add_axes((0.735, 0.1, 0.24, 0.81))
        for name, colour, dashes in zip(
            _STEPS, (ORANGE, BLUE, TEAL, MUTED), ("-", "-", "--", ":"), strict=True
        ):
            curves = by_name[name].curves
            speed.plot(
                1e3 * curves.time,
                curves.speed / RPM,
                color=colour,
                linestyle=dashes,
                linewidth=1.0,
                label=_SHORT[name],
            )
        speed.set(title="Figure 6.18, all alike", ylabel="Speed in rpm", xlabel="Time in ms")
        speed.set(xlim=(-10.0, 300.0), ylim=(640.0, 790.0))
        speed.legend(frameon=False, loc="upper right", fontsize=6.0)
    return figure
