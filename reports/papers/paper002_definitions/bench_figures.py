"""Figures 6.2 to 6.7 and 6.9 to 6.16 of paper 002 as they follow from the definitions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.figures_style import BLUE, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.paper002_definitions.bench_currents import HIGHEST_ORDER, BenchCurves

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS = (BLUE, ORANGE, TEAL)


_FIRST_BAR = 1e-4  # of the fundamental: less is rounding


def _over_angle(axes: Axes, labels: bool = True) -> None:
    axes.set(xlim=(0.0, 360.0), xticks=np.arange(0, 361, 60), xlabel="Electrical angle in deg")
    if labels:
        axes.legend(frameon=False, loc="best", ncols=3)


def _bars(axes: Axes, lines: FloatArray, colours: tuple[str, ...], factor: float) -> None:
    """Amplitudes by order, shape (K, H), side by side; what is rounding left out."""
    orders = np.arange(1, HIGHEST_ORDER + 1)
    width = 0.72 / len(lines)
    for place, (row, colour) in enumerate(zip(lines, colours, strict=True)):
        values = factor * row[1 : HIGHEST_ORDER + 1]
        shown = values > _FIRST_BAR * np.max(values)
        offset = width * (place - 0.5 * (len(lines) - 1))
        axes.bar(orders[shown] + offset, values[shown], 0.95 * width, color=colour)
    axes.set(xlabel="Order", yscale="log", xticks=orders[::2], xlim=(0.0, HIGHEST_ORDER + 1.0))


def plot_machine(curves: BenchCurves) -> Figure:
    """Back-EMF, frames and currents of phase a: Figures 6.2 to 6.7."""
    degrees = np.degrees(curves.theta)
    angles = curves.angles
    with style():
        figure = new_figure(
            "paper-002-machine", 6.6, "Back-EMF, frames and currents of phase a, inferred machine"
        )
        places = (
            (0.08, 0.73),
            (0.575, 0.73),
            (0.08, 0.4),
            (0.575, 0.4),
            (0.08, 0.07),
            (0.575, 0.07),
        )
        emf, spectrum, turned, factors, current, lines = (
            figure.add_axes((x, y, 0.4, 0.215)) for x, y in places
        )
        for values, colour, label in zip(1e3 * curves.flux, _COLOURS, "abc", strict=True):
            emf.plot(degrees, values, color=colour, label=label)
        emf.set(
            title="Figure 6.2: back-EMF over speed, inferred",
            ylabel="mV s/rad",
            ylim=(-230.0, 320.0),
        )
        _bars(spectrum, curves.flux_harmonics[np.newaxis], (BLUE,), 1e3)
        spectrum.set(title="Figure 6.3: its harmonics", ylabel="mV s/rad")
        turned.plot(degrees, degrees, color=TEAL, label="θ_r")
        total = degrees + np.degrees(angles.theta_x)
        turned.plot(degrees, total, color=ORANGE, linestyle="dashed", label="θ_r + θ_x")
        turned.plot(degrees, np.degrees(angles.theta_y), color=BLUE, label="θ_y")
        turned.set(title="Figure 6.4: angles", ylabel="deg")
        factors.plot(degrees, angles.a_x, color=ORANGE, label="a_x")
        factors.plot(degrees, angles.a_y, color=BLUE, label="a_y")
        factors.set(title="Figure 6.5: factors", ylim=(0.86, 0.93))
        for values, colour, label in zip(
            curves.currents, (ORANGE, BLUE), ("dqx", "dqy"), strict=True
        ):
            current.plot(degrees, values, color=colour, label=label)
        current.set(title="Figure 6.6: phase a at 1 N m", ylabel="A")
        _bars(lines, curves.harmonics, (ORANGE, BLUE), 1e3)
        lines.set(title="Figure 6.7: its harmonics", ylabel="mA")
        for axes in (emf, turned, factors, current):
            _over_angle(axes)
    return figure


def plot_currents(curves: BenchCurves) -> Figure:
    """Currents of dqy in every frame, and their path: Figures 6.9 to 6.16."""
    degrees = np.degrees(curves.theta)
    alpha, beta, zero = curves.stationary
    with style():
        figure = new_figure(
            "paper-002-currents", 6.6, "Currents of dqy in every frame at 1 N m, inferred machine"
        )
        rows = (0.73, 0.4, 0.07)
        q, plane, nought, phase = (
            figure.add_axes((x, y, 0.4, 0.215))
            for x, y in ((0.08, rows[0]), (0.575, rows[0]), (0.08, rows[1]), (0.575, rows[1]))
        )
        q.plot(degrees, curves.dqy[1], color=BLUE, label="i_qy (6.9)")
        q.plot(degrees, curves.dqx[1], color=ORANGE, label="i_qx (6.10)")
        q.set(title="Figures 6.9, 6.10", ylabel="A", ylim=(1.95, 2.06))
        plane.plot(degrees, alpha, color=BLUE, label="i_\u03b1 (6.11)")
        plane.plot(degrees, beta, color=ORANGE, label="i_β (6.12)")
        plane.set(title="Figures 6.11, 6.12", ylabel="A", ylim=(-2.1, 2.8))
        nought.plot(degrees, zero, color=TEAL)
        nought.set(title="Figure 6.13: i_0", ylabel="A")
        phase.plot(degrees, curves.currents[1], color=BLUE)
        phase.set(title="Figure 6.16: i_a", ylabel="A")
        for axes, labels in ((q, True), (plane, True), (nought, False), (phase, False)):
            _over_angle(axes, labels)
        path = figure.add_axes((0.08, rows[2], 0.22, 0.235))
        path.plot(np.append(alpha, alpha[0]), np.append(beta, beta[0]), color=BLUE)
        path.set(title="Figure 6.14", xlabel="i_\u03b1 in A", ylabel="i_β in A", aspect="equal")
        for place, (across, colour, label) in enumerate(
            ((alpha, BLUE, "i_\u03b1 in A"), (beta, ORANGE, "i_β in A"))
        ):
            view = figure.add_axes((0.41 + 0.33 * place, rows[2], 0.235, 0.235))
            view.plot(np.append(across, across[0]), np.append(zero, zero[0]), color=colour)
            title = "Figure 6.15, seen along β" if place == 0 else "and along \u03b1"
            view.set(title=title, xlabel=label, ylabel="i_0 in A")
    return figure
