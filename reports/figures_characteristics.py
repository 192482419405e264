"""Figures of operating points over speed: currents at one speed, and the torque-speed map with its regions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.characteristics import Characteristics, Envelope, OperatingMap, VoltageLimit
from dqforge.optimizer.operating_points import OptimalPoints
from dqforge.reports.figures_style import AXIS_COLOURS, FAINT, INK, MUTED, ORANGE, label_in_unit, new_figure, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_RPM = 30.0 / math.pi
_LEVELS = (0.5, 0.7, 0.8, 0.85, 0.9, 0.92, 0.94, 0.95, 0.96, 0.97, 0.98, 0.985, 0.99, 0.995)
_SHADES = ("#f4f7fb", "#e3ecf6", "#cfdff0", "#b5cfe8", "#97bbdd", "#7aa7d1")


def plot_speed(points: OptimalPoints, limit: VoltageLimit) -> Figure:
    """Currents and voltage over torque at one speed; points are those of one speed, torque ascending."""
    kept = points.reached
    with style():
        figure = new_figure("speed", 3.6, "Currents and phase voltage over torque at one speed")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
        figure.subplots_adjust(left=0.1, right=0.94, top=0.92, bottom=0.13, hspace=0.14)
        for axis, current in (("d", points.i_d), ("q", points.i_q)):
            upper.plot(points.torque[kept], current[kept], color=AXIS_COLOURS[axis], linewidth=1.6)
            end = (float(points.torque[kept][-1]), float(current[kept][-1]))
            upper.annotate(
                f"$i_{axis}$", end, xytext=(5, 0), textcoords="offset points", color=AXIS_COLOURS[axis], va="center"
            )
        upper.axhline(0.0, color=MUTED, linewidth=0.8)
        upper.set_title(f"{points.omega_m[0] * _RPM:.5g} rpm")
        label_in_unit(upper.yaxis, "Current in {} (peak)", float(np.max(np.abs(points.i_q))), "A")
        lower.plot(points.torque[kept], points.voltage[kept], color=INK, linewidth=1.3)
        lower.axhline(limit.v_max, color=ORANGE, linewidth=1.0, linestyle=(0, (4.0, 2.0)))
        lower.text(
            float(points.torque[0]), limit.v_max, f" {limit.modulation} limit", color=ORANGE, va="bottom", fontsize=7
        )
        lower.set(ylim=(0.0, 1.25 * limit.v_max), ylabel="Voltage in V")
        label_in_unit(lower.xaxis, "Torque in {}", float(np.max(points.torque)), "N m")
    return figure


def _filled(efficiency: FloatArray) -> FloatArray:
    """Efficiency in percent with the last value of each speed carried on to where there is none, for drawing alone."""
    percent = 100.0 * efficiency
    for row in range(1, percent.shape[0]):
        percent[row] = np.where(np.isnan(percent[row]), percent[row - 1], percent[row])
    for row in range(percent.shape[0] - 2, -1, -1):
        percent[row] = np.where(np.isnan(percent[row]), percent[row + 1], percent[row])
    return percent


def _draw_efficiency(axes: Axes, chart: OperatingMap, envelope: Envelope, top: float) -> None:
    best = np.nanmax(chart.efficiency, initial=0.0)
    levels = [100.0 * level for level in _LEVELS if level < best][-6:]
    if not levels:
        return
    speed, percent = chart.omega_m[1:] * _RPM, np.ma.masked_invalid(_filled(chart.efficiency.copy())[:, 1:])
    axes.contourf(speed, chart.torque, percent, levels=[0.0, *levels, 100.0][-7:], colors=_SHADES, zorder=1)
    real = np.ma.masked_invalid(100.0 * chart.efficiency[:, 1:])
    lines = axes.contour(speed, chart.torque, real, levels=levels, colors=MUTED, linewidths=0.6, zorder=2)
    axes.clabel(lines, fmt="%g %%", fontsize=6.5, inline_spacing=2)
    axes.fill_between(
        envelope.points.omega_m * _RPM, envelope.points.torque, top, color="white", linewidth=0, zorder=2.5
    )


def plot_operating_map(figures: Characteristics, envelope: Envelope, chart: OperatingMap) -> Figure:
    """Efficiency over speed and torque, the envelope with what holds it, and the line where field weakening begins."""
    speed, top = chart.omega_m * _RPM, 1.12 * figures.torque_max
    with style():
        figure = new_figure("map", 4.2, "Efficiency over speed and torque within the limits of current and voltage")
        axes = figure.add_axes((0.09, 0.115, 0.885, 0.845))
        _draw_efficiency(axes, chart, envelope, top)
        begin = envelope.weakening_speed * _RPM
        axes.plot(
            begin,
            envelope.weakening_torque,
            color=ORANGE,
            linewidth=1.2,
            linestyle="dashed",
            label="field weakening begins",
            zorder=3,
        )
        axes.plot(
            envelope.points.omega_m * _RPM,
            envelope.points.torque,
            color=INK,
            linewidth=1.6,
            label="most torque",
            zorder=3,
        )
        if figures.base_speed * _RPM < speed[-1]:
            axes.plot([figures.base_speed * _RPM], [figures.torque_max], "o", color=INK, markersize=4, zorder=4)
            axes.annotate(
                f"base speed {figures.base_speed * _RPM:.4g} rpm",
                (figures.base_speed * _RPM, figures.torque_max),
                xytext=(6, 4),
                textcoords="offset points",
                fontsize=7.5,
            )
        axes.set(xlim=(0.0, float(speed[-1])), ylim=(0.0, top), xlabel="Speed in rpm")
        label_in_unit(axes.yaxis, "Torque in {}", figures.torque_max, "N m")
        axes.grid(visible=False)
        axes.legend(loc="upper right", frameon=True, facecolor="white", edgecolor=FAINT, fontsize=7.5)
    return figure
